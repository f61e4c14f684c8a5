"""The reduced rungs of the ladder as simulations: `membrane`, `cavity`, `added_mass`
(`taichi_eye.solver.wall_stepper`).

A run without callbacks is a handful of kernel launches: milliseconds. Frames are kept, so that a run that has been made
can be filmed afterwards. Where a film shows the liquid, its velocity and pressure at a frame are those of potential
flow under the wall's own motion, computed for that frame alone: the wall of a cheap rung drives them, they do not act
back.
"""

import math
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from taichi_eye import backend
from taichi_eye.cloud.packing import Cloud, cornea_elements, pack
from taichi_eye.cloud.quality import measure
from taichi_eye.errors import RunStopped
from taichi_eye.eye.puff import Puff
from taichi_eye.eye.section import Section
from taichi_eye.eye.tissue import flexural_rigidity
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.batch import SAMPLE_MS
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.folding import Folding
from taichi_eye.solver.guards import failing, is_shell, least_stress
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.potential import LayerFlow, PotentialFlow, ring_areas
from taichi_eye.solver.rest import place_cornea
from taichi_eye.solver.wall_stepper import CLOSED, FIGURES, GREW, NOT_FINITE, PUFF_ROWS, RUNNING, SLACK, WallStepper
from taichi_eye.solver.workspace import capacity, reuse
from taichi_eye.units import MM, MM3, MMHG, MPA_S, MS

BULK_MODULUS = 2.2e9  # Pa, water
STOPS = {
    CLOSED: (
        "the cornea reached the back of the chamber",
        "Lower puff.peak_kpa, raise eye.iop_mmhg or chamber.depth_mm, or model the liquid that is in the way: "
        'numerics.fidelity = "mfpm".',
    ),
    NOT_FINITE: ("a value is not finite any more", "Lower numerics.cfl."),
    GREW: ("energy grew without work", 'Lower numerics.cfl, or use numerics.fidelity = "mfpm".'),
}


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
    """A scene under a reduced model.

    scene: resolved; model: a rung, or "layer" (thin-layer flow, a pilot's); cloud: its `cloud_of` where there is one
    already. Public: cornea (fields), section, cloud (None until a flow is asked for), traces (dict of arrays so far),
    steps, refreshes, samples of the whole run,
    frames [frame, node, 7] as `WallStepper.advance` keeps them.
    """

    def __init__(self, scene, model: str, cloud: Cloud | None = None):
        self.scene, self.model = scene, model
        self.puff = Puff.from_scene(scene)
        self.section = Section.from_scene(scene)
        self.flowing = model in ("layer", "added_mass")
        self.spacing = scene.numerics.spacing_mm * MM
        self.cloud = cloud
        if model == "added_mass" and cloud is None:
            self.cloud = pack(self.section, self.spacing)
        self.wall_count = cornea_elements(self.section, self.spacing) + 1
        size = capacity(self.wall_count, 16)
        self.generation = backend.generation()
        wall = reuse(self, (self.generation, "wall", size, self.flowing), lambda: _Wall(size, self.flowing))
        self.cornea, self.stepper = wall.cornea, wall.stepper
        self._liquid, self._layer = None, LayerFlow(self.cornea, self.section)
        self._neumann, self._refreshed_ms, self._filmed_ms = None, 0.0, 0.0
        self._lobes: int | None = None
        self._place_at_rest()
        frame = scene.camera.frame_interval_ms
        self.samples_per_frame = max(1, math.ceil(frame / SAMPLE_MS - 1e-9))
        self.sample_ms = frame / self.samples_per_frame
        self.samples = int(math.floor(scene.numerics.duration_ms / self.sample_ms + 1e-9))
        times = np.arange(self.samples * PUFF_ROWS + 2) * (self.sample_ms * MS / PUFF_ROWS)
        self._puff_table = self.puff.pressure_at_apex(times)
        self._record = np.zeros((self.samples + 1, len(FIGURES)))
        self._record[0, 0], self._record[0, 2] = self.section.apex_z, scene.eye.iop_mmhg * MMHG
        self._record[0, -1] = float(self.cornea.stress.to_numpy()[: self.wall_count - 1].min())
        count = min(scene.camera.frame_count, self.samples // self.samples_per_frame + 1)
        self.frames = np.zeros((count, self.wall_count, 7))
        self.frames[0, :, :2] = self.section.cornea_nodes(self.wall_count - 1)
        self.sample = self.reached = self.refreshes = 0

    def _place_at_rest(self) -> None:
        scene, cornea = self.scene, self.scene.cornea
        nodes = place_cornea(self.cornea, scene, self.section, self.puff, self.wall_count - 1)
        volume = self.section.volume()
        globe = scene.chamber.compliance_mm3_mmhg * MM3 / MMHG
        thickest = max(cornea.thickness_mm, cornea.limbus_thickness_mm) * MM
        thinnest = min(cornea.thickness_mm, cornea.limbus_thickness_mm) * MM
        sudden = (1.0 + cornea.viscoelastic_share) * cornea.flexural_modulus_mpa * 1e6
        rigidity = flexural_rigidity(sudden, thickest, cornea.poisson_ratio)
        bending = 0.5 * math.sqrt(cornea.density_kg_m3 * thinnest / rigidity) if rigidity > 0.0 else math.inf
        self.stepper.setup(
            self.section.back_height(nodes[:, 0]),
            volume,
            volume / BULK_MODULUS,
            globe,
            scene.chamber.globe_delay_ms * MS,
            scene.chamber.sealed and self.model != "membrane",
            scene.aqueous.density_kg_m3,
            bending,
            -math.inf if is_shell(scene) else 0.0,
        )

    @property
    def time_ms(self) -> float:
        """Simulated time of the last sample."""
        return self.sample * self.sample_ms

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return int(self.stepper.steps[None])

    @property
    def out_of_validity(self) -> bool:
        """Whether the run was stopped by what the model is not made for, and not by the numerics."""
        return self._lobes is not None or int(self.stepper.status[None]) in (SLACK, CLOSED)

    @property
    def wall_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [ms] of the frames reached and the wall's places (r, z) there [mm], [frames, nodes, 2]."""
        count = min(self.reached // self.samples_per_frame + 1, len(self.frames))
        return np.arange(count) * self.scene.camera.frame_interval_ms, self.frames[:count, :, :2] / MM

    def run(
        self,
        on_frame: Callable[["Reduced", int], None] | None = None,
        on_sample: Callable[["Reduced"], None] | None = None,
    ) -> dict[str, np.ndarray]:
        """Run to the end, then show the frames: on_frame(self, frame) and on_sample(self) at each.

        A run that has been made is only shown. Returns the traces as arrays. Raises RunStopped where the model leaves
        its validity, after the frames up to there; `traces` keeps what was computed.
        """
        backend.refuse_lost(self.generation)
        self._advance()
        if on_frame or on_sample:
            for frame in range(len(self.wall_mm[0])):
                self.sample = frame * self.samples_per_frame
                self.stepper.show(self.frames[frame])
                if on_sample:
                    on_sample(self)
                if on_frame:
                    on_frame(self, frame)
        self.sample = self.reached
        if on_sample:
            on_sample(self)
        self._check()
        return self.arrays()

    def _advance(self) -> None:
        far = self.scene.numerics.refresh_travel * self.spacing
        while self.reached < self.samples and self.stepper.status[None] == RUNNING:
            if self.flowing:
                self._refresh()
            self.reached = self.stepper.advance(
                self._puff_table,
                self.reached,
                self.samples,
                self.sample_ms * MS,
                self.scene.numerics.cfl,
                far,
                self._record,
                self.samples_per_frame,
                self.frames,
            )
        if is_shell(self.scene) and self._lobes is None:
            self._stop_where_it_folds()

    def _stop_where_it_folds(self) -> None:
        """End a shell's run at the first frame that folds (`taichi_eye.solver.guards`)."""
        nodes, iop = self.section.cornea_nodes(self.wall_count - 1), self.scene.eye.iop_mmhg * MMHG
        folding, shape, limit = (
            Folding.from_scene(self.scene, nodes),
            self.puff.radial(nodes[:, 0]),
            least_stress(self.scene),
        )
        for frame in range(len(self.wall_mm[0])):
            sample = frame * self.samples_per_frame
            if self._record[sample, FIGURES.index("least_stress")] <= limit:
                air = self.puff.pressure_at_apex(sample * self.sample_ms * MS) * shape
                self._lobes = folding.lobes(self.frames[frame, :, :2], iop + self.frames[frame, :, 6] - air)
                if self._lobes is not None:
                    self.reached = sample
                    return

    def _refresh(self) -> None:
        """New flow maps for the present wall; their rate of change is that since the last ones."""
        flow = self._flow() if self.model == "added_mass" else self._layer
        before, when = self._neumann, self._refreshed_ms
        flow.refresh()
        now = self.reached * self.sample_ms
        since = (now - when) * MS
        walls = self.wall_count - 1
        rate = (flow.neumann - before) / since if before is not None and since > 0.0 else np.zeros_like(flow.neumann)
        self._refreshed_ms, self._neumann = now, flow.neumann
        area = ring_areas(self.cornea.place.to_numpy()[: self.wall_count])[:walls]
        mass = self.cornea.mass.to_numpy()[:walls]
        neumann = flow.neumann[:walls, :walls]
        system = np.eye(walls) + self.scene.aqueous.density_kg_m3 * neumann * ((area**2).sum(1) / mass)
        inverse = np.linalg.inv(system)
        unit = inverse.sum(1) * float(self.scene.chamber.sealed)
        self.stepper.load_flow(np.ascontiguousarray(neumann), inverse, np.ascontiguousarray(rate[:walls, :walls]), unit)
        self.refreshes += 1

    def _flow(self) -> PotentialFlow:
        if self._liquid is None:
            if self.cloud is None:
                self.cloud = pack(self.section, self.spacing)
            size = capacity(self.cloud.count)
            self._liquid = reuse(
                self, (self.generation, "liquid", self.cornea, size), lambda: _Liquid(self.cornea, size)
            )
            aqueous = self.scene.aqueous
            self._liquid.aqueous.setup(
                self.cloud,
                aqueous.density_kg_m3,
                aqueous.viscosity_mpa_s * MPA_S,
                self.scene.numerics.sound_speed_m_s,
                0.0,
            )
            self._liquid.flow.setup(self.cloud)
        return self._liquid.flow

    def liquid(self):
        """Fields of the liquid at the frame shown: place, velocity, excess pressure, and how many nodes they hold.

        Potential flow under the wall's motion at that frame (see the head of this module).
        """
        backend.refuse_lost(self.generation)
        flow, fields = self._flow(), self._liquid.aqueous
        wall = self.frames[self.sample // self.samples_per_frame]
        place, velocity, acceleration = wall[:, :2], wall[:, 2:4], wall[:, 4:6]
        before, when = flow.flow, self._filmed_ms
        flow.refresh()
        self._filmed_ms = self.time_ms
        span = (self.time_ms - when) * MS
        area = ring_areas(place)
        # the area vectors are quadratic in the places: their central difference is exact
        turning = 0.5 * (ring_areas(place + velocity) - ring_areas(place - velocity))
        flux, flux_rate = (area * velocity).sum(1), (area * acceleration + turning * velocity).sum(1)
        rate = flow.flow @ flux_rate
        if before is not None and span > 0.0:
            rate += (flow.flow - before) @ (flux / span)
        size = np.linalg.norm(area, axis=1)
        flow.show(
            flow.flow @ flux, rate, float((size * wall[:, 6]).sum() / size.sum()), self.scene.aqueous.density_kg_m3
        )
        return fields.place, fields.velocity, fields.pressure, self.cloud.count

    def facts(self) -> dict:
        """What a summary tells about the discretisation and the work done."""
        facts = {"elements": self.wall_count - 1, "steps": self.steps, "flow_maps": self.refreshes}
        return facts if self.cloud is None else {**facts, "cloud": asdict(measure(self.cloud))}

    def about(self) -> str:
        """The model of the liquid in a line."""
        return {
            "membrane": "the IOP, whatever the volume",
            "cavity": "a uniform pressure that holds the volume",
            "layer": "potential flow of a thin layer",
            "added_mass": "potential flow, its map made anew every "
            f"{self.scene.numerics.refresh_travel:g} spacings of travel",
        }[self.model]

    def _check(self) -> None:
        status = int(self.stepper.status[None])
        if self._lobes is None and status == RUNNING:
            return
        nodes = self.section.cornea_nodes(self.wall_count - 1)
        radius = nodes[int(self.stepper.place_of_failure[None]), 0]
        if self._lobes is not None:
            radius = Folding.from_scene(self.scene, nodes).ring(
                self.frames[self.reached // self.samples_per_frame, :, :2]
            )
        what, advice = STOPS.get(status) or failing(
            self._record[self.reached, FIGURES.index("least_stress")], self._lobes
        )
        raise RunStopped(what, f"at r = {radius / MM:.2f} mm", self.time_ms, advice)

    @property
    def traces(self) -> dict[str, np.ndarray]:
        """The traces up to the sample shown, one array per column; SI of the kernels in the units of the names."""
        taken = {name: column for name, column in zip(FIGURES, self._record[: self.sample + 1].T)}
        time_ms = np.arange(self.sample + 1) * self.sample_ms
        energies = {
            f"{name}_uj": taken[name] * 1e6
            for name in ("puff_work", "cornea_elastic", "cornea_kinetic", "aqueous_kinetic", "aqueous_elastic")
        }
        energies["tissue_loss_uj"] = taken["tissue_loss"] * 1e6
        spent = sum(column for name, column in energies.items() if name != "puff_work_uj")
        nothing = np.zeros(self.sample + 1)
        return {
            "time_ms": time_ms,
            "apex_displacement_mm": (self.section.apex_z - taken["apex_place"]) / MM,
            "apex_velocity_m_s": -taken["apex_velocity"],
            "puff_apex_kpa": self.puff.pressure_at_apex(time_ms * MS) * 1e-3,
            "fluid_pressure_apex_kpa": taken["pressure_apex"] * 1e-3,
            "chamber_volume_error": taken["volume_error"],
            **energies,
            **{name: nothing for name in ("viscous_loss_uj", "numerical_loss_uj", "outflow_loss_uj")},
            "energy_error_uj": spent - energies["puff_work_uj"],
            "coupling_iterations": nothing,
            "coupling_residual": nothing,
            "cornea_min_stress_kpa": taken["least_stress"] * 1e-3,
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """The traces so far."""
        return self.traces
