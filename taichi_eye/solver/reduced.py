"""The reduced rungs of the ladder as simulations: `Membrane`, `Cavity`, `AddedMass`, and `ThinLayer` for pilots.

What each feels of the liquid is told in `taichi_eye.solver.wall_stepper`. A run without callbacks is a handful of
kernel launches: milliseconds. Frames are kept, so that a run that has been made can be filmed afterwards. Where a film
shows the liquid, its velocity and pressure at a frame are those of potential flow under the wall's own motion, computed
for that frame alone: the wall of a cheap rung drives them, they do not act back.
"""

import ast
import math
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property, lru_cache

import numpy as np

from taichi_eye import backend
from taichi_eye.cloud.packing import Cloud, cornea_elements, packed
from taichi_eye.cloud.quality import measure
from taichi_eye.errors import RunStopped
from taichi_eye.eye.jet import central_curvature
from taichi_eye.eye.puff import Puff
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.case import case_of
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.figures import at, at_rest, traces_of
from taichi_eye.solver.folding import Folding
from taichi_eye.solver.guards import Advice, Guard, energy_floor
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.potential import LayerFlow, PotentialFlow
from taichi_eye.solver.rings import ring_areas
from taichi_eye.solver.scheme import Clock
from taichi_eye.solver.state import State
from taichi_eye.solver.timestep import bending_limit, refuse_endless, shear_damping
from taichi_eye.solver.wall_stepper import PUFF_ROWS, RUNNING, WallStepper
from taichi_eye.solver.workspace import capacity, reuse
from taichi_eye.units import MM, MS

BULK_MODULUS = 2.2e9  # Pa, water
SMALLEST_WALL = 128  # nodes: walls below share one set of kernels, the coarsest pilot's and the finest offered
MAPS = "neumann", "inverse", "neumann_change", "unit"  # of the flow, as `WallStepper.load_flow` takes them
ADVICE = Advice(
    unstable='Lower numerics.cfl, or use numerics.fidelity = "mfpm".',
    back="Lower puff.peak_kpa, raise eye.iop_mmhg or chamber.depth_mm, or model the liquid that is in the way: "
    'numerics.fidelity = "mfpm".',
)


def puff_table(puff: Puff, clock: Clock) -> np.ndarray:
    """The puff's impulse [Pa s] since the start and what it gains per row, by rows of time [rows, 2], PUFF_ROWS to a
    sample (`WallStepper.advance`).

    The gain is that from half a row before to half a row after: of a pulse shorter than a row its share, and not what
    it would be at that pace. The tables of the last puffs are kept for the next runs under them: do not write to them.
    """
    # a file's puff holds arrays, by which nothing can be looked up
    return _table(puff, clock) if puff.samples is not None else _kept_table(puff, clock)


def _table(puff: Puff, clock: Clock) -> np.ndarray:
    row = clock.sample_s / PUFF_ROWS
    times = np.arange(clock.samples * PUFF_ROWS + 2) * row
    impulse = np.append(0.0, np.cumsum(puff.impulse_at_apex(times)))
    gain = puff.impulse_at_apex(np.append(times - 0.5 * row, times[-1] + 0.5 * row))
    return np.column_stack([impulse, gain])


_kept_table = lru_cache(maxsize=8)(_table)


class _Wall:
    """A cornea and its stepper, reused from one simulation to the next."""

    def __init__(self, nodes: int, flowing: bool):
        self.cornea = Cornea(nodes)
        self.stepper = WallStepper(self.cornea, flowing)


class _Liquid:
    """What shows or carries the flow under a wall."""

    def __init__(self, cornea: Cornea, nodes: int):
        self.aqueous = Aqueous(nodes, "quadratic")
        self.flow = PotentialFlow(cornea, self.aqueous, Motion(cornea, self.aqueous))


class Reduced:
    """A scene under a reduced model; a subclass says which.

    scene: resolved; cloud: its `cloud_of` where there is one already. Public: eye, clock, cornea (fields), section,
    cloud (None until a flow is asked for), traces (dict of arrays so far), steps, refreshes, frames [frame, node, 7] as
    `WallStepper.advance` keeps them, out_of_validity (whether a guard stopped the run for what the model is not made
    for, and not for its numerics), judges_folding (whether a shell is asked whether it folds; a pilot on a grid that is
    too coarse to tell sets it to False).
    """

    flowing = False  # whether the pressure varies along the wall
    holds_volume = True  # whether a sealed chamber is felt
    judges_folding = True
    words = ""  # the model of the liquid in a line

    def __init__(self, scene, cloud: Cloud | None = None):
        self.scene, self.case = scene, case_of(scene)
        self.eye, self.scheme, self.clock = self.case.eye, self.case.scheme, self.case.clock
        self.section, self.puff, self.spacing = self.eye.section, self.eye.puff, self.scheme.spacing
        self.cloud = cloud
        self.wall_count = cornea_elements(self.section, self.spacing) + 1
        refuse_endless(self.case, self.wall_count, nodes_flow=False)
        size = capacity(self.wall_count, SMALLEST_WALL)
        self.generation = backend.generation()
        kind = (self.generation, "wall", size, self.flowing)
        wall = reuse(self, kind, lambda: _Wall(size, self.flowing))
        self.cornea, self.stepper = wall.cornea, wall.stepper
        self._liquid: _Liquid | None = None
        self._neumann = self._maps = None
        # the frame last shown with its liquid, and the flow map there
        self._filmed: tuple[int, np.ndarray] | None = None
        self._place_at_rest()
        clock = self.clock
        self._puff_table = puff_table(self.puff, clock)
        self._record = at_rest(clock.samples + 1)
        self._record[0, at.apex_place], self._record[0, at.fluid_pressure_apex] = self.section.apex_z, self.eye.iop
        self._record[0, at.least_stress] = float(self.cornea.stress.to_numpy()[: self.wall_count - 1].min())
        self.frames = np.zeros((clock.frames, self.wall_count, 7))
        self.frames[0, :, :2] = self.section.cornea_nodes(self.wall_count - 1)
        self._guard = Guard([self.case], [ADVICE])
        self.stop: RunStopped | None = None
        self.out_of_validity = False
        self.sample = self.reached = self.refreshes = 0
        self._shown, self._next = 0, 0  # the frame handed to callbacks last, and the one to be handed next

    def _place_at_rest(self) -> None:
        eye = self.eye
        nodes = self.cornea.build(eye, self.wall_count - 1)
        volume = self.section.volume()
        self.stepper.setup(
            back=self.section.back_height(nodes[:, 0]),
            volume=volume,
            compliance=volume / BULK_MODULUS,
            sealed=eye.liquid.sealed and self.holds_volume,
            density=eye.liquid.density,
            bending_step=bending_limit(eye),
            shear_damping=shear_damping(eye),
            least_stress=-math.inf if eye.cornea.is_shell else 0.0,
            energy_floor=energy_floor(self.case),
        )
        self.stepper.globe.build(eye)

    @property
    def time_ms(self) -> float:
        """Simulated time of the last sample."""
        return self.sample * self.clock.sample_ms

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return int(self.stepper.steps[None])

    @property
    def wall_velocity(self):
        """Field of the wall's velocity at the frame shown [m/s], the first `wall_count` nodes."""
        return self.stepper.shown_velocity

    @property
    def wall_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [ms] of the frames reached and the wall's places (r, z) there [mm], [frames, nodes, 2]."""
        count = min(self.reached // self.clock.samples_per_frame + 1, len(self.frames))
        return np.arange(count) * self.scene.camera.frame_interval_ms, self.frames[:count, :, :2] / MM

    def run(
        self,
        on_frame: Callable[["Reduced", int], None] | None = None,
        on_sample: Callable[["Reduced"], None] | None = None,
    ) -> dict[str, np.ndarray]:
        """Run to the end; call on_sample(self) and on_frame(self, frame) at each film frame, in this order.

        A run that has been made is only shown; one that was restored goes on after the frame of its state. Returns the
        traces as arrays. Raises RunStopped where the model leaves its validity, after the frames up to there; `traces`
        keeps what was computed.
        """
        backend.refuse_lost(self.generation)
        if on_frame or on_sample:
            for frame in range(self._next, self.clock.frames):
                sample = frame * self.clock.samples_per_frame
                self._advance(sample)
                if sample > self.reached:
                    break
                self.sample, self._shown, self._next = sample, frame, frame + 1
                self.stepper.show(self.frames[frame], sample < self.reached)
                if on_sample:
                    on_sample(self)
                if on_frame:
                    on_frame(self, frame)
        self._advance(self.clock.samples)
        self.sample = self.reached
        if on_sample:
            on_sample(self)
        self._next = 0
        if self.stop is not None:
            raise RunStopped(*self.stop.args)
        return self.traces

    def _advance(self, to: int) -> None:
        """Solve up to a sample, or to where a guard stops."""
        while self.reached < to and self.stop is None:
            if self.flowing and self.stepper.aged[None]:
                self._refresh()
            self.stepper.status[None] = RUNNING
            before = self.reached
            self.reached = self.stepper.advance(
                self._puff_table,
                before,
                to,
                self.clock.sample_s,
                self.scheme.cfl,
                self.scheme.refresh_distance,
                self._record,
                self.clock.samples_per_frame,
                self.frames,
            )
            self._look(before)

    def _look(self, before: int) -> None:
        """Put the samples after `before` to the guards; a stop ends the run at the last sound one."""
        samples = np.arange(before + 1, self.reached + 1)
        rows = self._record[samples]
        at_frame = samples % self.clock.samples_per_frame == 0
        calm = self._guard.where_calm(rows, at_frame)
        for number in np.flatnonzero(~calm):
            sample = int(samples[number])
            lobes = self._lobes(sample) if at_frame[number] else None
            self.stop = self._guard.stop_of(
                0,
                number,
                rows[number],
                radius_mm=lambda node: self.section.cornea_nodes(self.wall_count - 1)[node, 0] / MM,
                time_ms=sample * self.clock.sample_ms,
                lobes=lobes,
            )
            if self.stop is not None:
                self.out_of_validity = self._guard.left_model(0, rows[number], lobes)
                self.reached = sample - 1
                return

    def _lobes(self, sample: int) -> int | None:
        """The lobes into which a shell folds at a film frame's sample, asked once it is compressed enough."""
        frame = self.clock.frame_of(sample)
        if frame is None or not self.judges_folding or not self._guard.may_fold(0, self._record[sample]):
            return None
        nodes = self.section.cornea_nodes(self.wall_count - 1)
        place = self.frames[frame, :, :2]
        spread = self.puff.on_rings(nodes[:, 0], central_curvature(place, nodes[:, 0]))
        air = self.puff.pressure_at_apex(sample * self.clock.sample_s) * spread
        net = self.eye.iop + self.frames[frame, :, 6] - air
        return self._folding.lobes(place, net)

    @cached_property
    def _folding(self) -> Folding:
        return Folding.of(self.eye, self.section.cornea_nodes(self.wall_count - 1))

    @cached_property
    def _mass(self) -> np.ndarray:
        return self.cornea.mass.to_numpy()[: self.wall_count]

    def _flow_maps(self):
        """What makes flow maps of a wall: an object with `refresh()` and `neumann`; asked for where `flowing`."""
        raise TypeError(f"{type(self).__name__} has no flow")

    def _refresh(self) -> None:
        """New flow maps for the present wall, and how they have changed since the last ones."""
        flow = self._flow_maps()
        before = self._neumann
        flow.refresh()
        walls = self.wall_count - 1
        change = flow.neumann - before if before is not None else np.zeros_like(flow.neumann)
        self._neumann = flow.neumann
        area = ring_areas(self.cornea.place.to_numpy()[: self.wall_count])[:walls]
        mass = self._mass[:walls]
        neumann = flow.neumann[:walls, :walls]
        system = np.eye(walls) + self.eye.liquid.density * neumann * ((area**2).sum(1) / mass)
        inverse = np.linalg.inv(system)
        unit = inverse.sum(1) * float(self.eye.liquid.sealed)
        self._maps = np.ascontiguousarray(neumann), inverse, np.ascontiguousarray(change[:walls, :walls]), unit
        self.stepper.load_flow(*self._maps)
        self.refreshes += 1

    def _potential_flow(self) -> PotentialFlow:
        """Potential flow on the node cloud, which is packed once it is asked for."""
        if self._liquid is None:
            if self.cloud is None:
                self.cloud = packed(self.section, self.spacing)
            size = capacity(self.cloud.count)
            kind = (self.generation, "liquid", self.cornea, size)
            self._liquid = reuse(self, kind, lambda: _Liquid(self.cornea, size))
            liquid = self.eye.liquid
            self._liquid.aqueous.setup(
                self.cloud,
                density=liquid.density,
                viscosity=liquid.viscosity,
                sound_speed=self.scheme.sound_speed,
                dissipation=0.0,
            )
            self._liquid.flow.setup(self.cloud)
        return self._liquid.flow

    def liquid(self):
        """Fields of the liquid at the frame shown: place, velocity, excess pressure, and how many nodes they hold.

        Potential flow under the wall's motion at that frame (see the head of this module).
        """
        backend.refuse_lost(self.generation)
        flow, fields = self._potential_flow(), self._liquid.aqueous
        frame = self._shown
        if frame > 0 and (self._filmed is None or self._filmed[0] != frame - 1):
            self._filmed = frame - 1, self._flow_at(frame - 1)
        wall = self.frames[frame]
        place, velocity, acceleration = wall[:, :2], wall[:, 2:4], wall[:, 4:6]
        flow.refresh()
        area = ring_areas(place)
        # the area vectors are quadratic in the places: their central difference is exact
        turning = 0.5 * (ring_areas(place + velocity) - ring_areas(place - velocity))
        flux, flux_rate = (area * velocity).sum(1), (area * acceleration + turning * velocity).sum(1)
        rate = flow.flow @ flux_rate
        if frame > 0:
            rate += (flow.flow - self._filmed[1]) @ (flux / (self.scene.camera.frame_interval_ms * MS))
        self._filmed = frame, flow.flow
        size = np.linalg.norm(area, axis=1)
        mean = float((size * wall[:, 6]).sum() / size.sum())
        flow.show(flow.flow @ flux, rate, self.stepper.shown_velocity, mean, self.eye.liquid.density)
        return fields.place, fields.velocity, fields.pressure, self.cloud.count

    def _flow_at(self, frame: int) -> np.ndarray:
        """The flow map of the wall at a frame; the wall itself stays where it is."""
        kept = np.zeros((self.wall_count, 7))
        kept[:, :2] = self.cornea.place.to_numpy()[: self.wall_count]
        kept[:, 2:4] = self.stepper.shown_velocity.to_numpy()[: self.wall_count]
        self.stepper.show(self.frames[frame], True)
        self._liquid.flow.refresh()
        self.stepper.show(kept, True)
        return self._liquid.flow.flow

    def facts(self) -> dict:
        """What a summary tells about the discretisation and the work done."""
        facts = {"elements": self.wall_count - 1, "steps": self.steps, "flow_maps": self.refreshes}
        return facts if self.cloud is None else {**facts, "cloud": asdict(measure(self.cloud))}

    def about(self) -> str:
        """The model of the liquid in a line."""
        return self.words

    def frame(self) -> np.ndarray:
        """The film's image at the frame shown, once a run is over at its last one, uint8: grey [rows, columns] of the
        slit, or RGB [rows, columns, 3] (camera.view)."""
        # the film stands on the solver: it is loaded for whoever asks to see
        from taichi_eye.recording.observer import picture

        if self._next or not self.reached:
            return picture(self)
        sample, self._shown = self.sample, len(self.wall_mm[0]) - 1
        self.sample = self._shown * self.clock.samples_per_frame
        self.stepper.show(self.frames[self._shown], True)
        try:
            return picture(self)
        finally:
            self.sample = sample

    @property
    def traces(self) -> dict[str, np.ndarray]:
        """The traces up to the sample shown, one array per column."""
        return traces_of(self._record[: self.sample + 1], self.clock, self.puff, self.section.apex_z)

    def state(self) -> State:
        """All that evolves, at the frame shown, by name; `restore` takes it up."""
        state = {
            **self.stepper.snapshot.take(self.wall_count, 1),
            "figures": self._record[: self.reached + 1].copy(),
            "frames": self.frames[: self.reached // self.clock.samples_per_frame + 1].copy(),
            "steps": np.array(self.steps),
            "shown": np.array(self._shown),
            "refreshes": np.array(self.refreshes),
            "guarded_work": self._guard.largest_work.copy(),
            "stop": np.array(repr(self.stop.args) if self.stop else ""),
            "out_of_validity": np.array(self.out_of_validity),
        }
        if self._maps is not None:
            walls = self.wall_count - 1
            carried = self.stepper.neumann.to_numpy()[:walls, :walls]
            state |= {f"map_{name}": part for name, part in zip(MAPS, (carried, *self._maps[1:]))}
            state |= {"map_whole": self._neumann, "map_aged": np.array(self.stepper.aged[None])}
        return state

    def restore(self, state: State) -> None:
        """Take up the state of a simulation of the same scene: `run` goes on after its frame. ValueError where it does
        not fit."""
        figures, frames = state["figures"], state["frames"]
        if len(figures) > len(self._record) or frames.shape[1:] != self.frames.shape[1:]:
            raise ValueError("the state belongs to another scene")
        if "map_neumann" in state:
            self._maps = tuple(state[f"map_{name}"] for name in MAPS)
            self._neumann = state["map_whole"]
            self.stepper.load_flow(*(np.ascontiguousarray(part) for part in self._maps))
            self.stepper.aged[None] = int(state["map_aged"])
        self.stepper.snapshot.put(state)
        self._record[: len(figures)], self.frames[: len(frames)] = figures, frames[: len(self.frames)]
        self.stepper.steps[None] = int(state["steps"])
        self.refreshes, self._shown = int(state["refreshes"]), int(state["shown"])
        self._next = self._shown + 1
        self.reached, self.sample = len(figures) - 1, self._shown * self.clock.samples_per_frame
        self._guard.largest_work = state["guarded_work"].copy()
        self.stop = RunStopped(*ast.literal_eval(str(state["stop"]))) if str(state["stop"]) else None
        self.out_of_validity = bool(state["out_of_validity"])


class Membrane(Reduced):
    """The cornea under a constant IOP: no liquid, no volume to hold, no inertia."""

    holds_volume = False
    words = "the IOP, whatever the volume"


class Cavity(Reduced):
    """The cornea over a uniform pressure that holds the chamber's volume."""

    words = "a uniform pressure that holds the volume"


class ThinLayer(Reduced):
    """The cornea over potential flow of a thin layer: a pilot's."""

    flowing = True
    words = "potential flow of a thin layer"

    def __init__(self, scene, cloud: Cloud | None = None):
        super().__init__(scene, cloud)
        self._layer = LayerFlow(self.cornea, self.section)

    def _flow_maps(self):
        return self._layer


class AddedMass(Reduced):
    """The cornea over incompressible potential flow on the node cloud."""

    flowing = True

    def __init__(self, scene, cloud: Cloud | None = None):
        super().__init__(scene, cloud)
        if cloud is None:
            self.cloud = packed(self.section, self.spacing)

    def _flow_maps(self):
        return self._potential_flow()

    def about(self) -> str:
        """The model of the liquid in a line."""
        return f"potential flow, its map made anew every {self.scheme.refresh_travel:g} spacings of travel"
