"""Many eyes advanced together: scenes that differ in anything but their basis, each as if it were alone.

The eyes stand one after the other in the same fields (`taichi_eye.mfpm.neighbours`), and each has its own time step,
rebuilds, samples, guards and traces. Time is cut into film frames, frames into samples of at most `SAMPLE_MS`, samples
into equal steps below the stable limit of the moment; all eyes take a sample together, in one launch. At each sample
the
traces grow by a row, the guards look, and the operator weights are rebuilt once the wall has moved by
`numerics.refresh_travel` spacings since they were last. An eye that a guard stops, or that has reached its end, rests
while the others go on.

On the CPU a sample is a parallel loop over the eyes, each with all its steps on one thread, so an eye does the same
arithmetic in the same order whatever stands beside it: its traces are those of a run alone, bit for bit. What Python
does at a sample it does for all eyes at once, on arrays.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from taichi_eye import backend
from taichi_eye.cloud.packing import Cloud, pack
from taichi_eye.errors import RunStopped, SceneError
from taichi_eye.eye.puff import Puff, Puffs
from taichi_eye.eye.section import Section
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.scene import Scene
from taichi_eye.scene.budget import SAMPLE_MS
from taichi_eye.solver import guards
from taichi_eye.solver.folding import Folding
from taichi_eye.solver.rest import place_cornea
from taichi_eye.solver.survey import QUANTITIES
from taichi_eye.solver.timestep import NAMES, StepLimits
from taichi_eye.solver.workspace import borrow
from taichi_eye.units import MM, MM3, MMHG, MPA_S, MS

AT_ONCE = 2**18  # nodes that `run_batch` holds in memory, some 3 kB each


def cloud_of(scene) -> Cloud:
    """The packed node cloud of a resolved scene; SceneError where its chamber cannot be filled at its spacing."""
    return pack(Section.from_scene(scene), scene.numerics.spacing_mm * MM)


def clouds_of(scenes) -> list[Cloud]:
    """The clouds of scenes, packed once for each chamber and spacing; raises like `cloud_of`."""
    packed: dict[tuple, Cloud] = {}
    clouds = []
    for number, scene in enumerate(scenes):
        key = Section.from_scene(scene), scene.numerics.spacing_mm
        if key not in packed:
            try:
                packed[key] = cloud_of(scene)
            except SceneError as problem:
                raise SceneError(f"scene {number} of the batch: {problem}") from None
        clouds.append(packed[key])
    return clouds


@dataclass(frozen=True)
class Outcome:
    """What became of one eye: traces as arrays by column, and the guard's stop or None for an eye that got to its
    end."""

    scene: Scene
    traces: dict[str, np.ndarray]
    stop: RunStopped | None


class Batch:
    """Coupled corneas and aqueous humours of several scenes of one basis (ValueError otherwise), advanced together.

    scenes: resolved; clouds: theirs, packed here when left out (SceneError where that fails). Public, by eye: scenes,
    clouds, puffs, first (node), sample_ms, samples and samples_per_frame; steps and rebuilds so far, step_limit (the
    limit that
    set the last time step), stops (RunStopped or None), recorded (rows of the traces). For all: cornea, aqueous
    (fields),
    sample (of all eyes that still run).
    """

    def __init__(self, scenes: Sequence[Scene], clouds: Sequence[Cloud] | None = None):
        self.scenes = list(scenes)
        bases = {scene.numerics.basis for scene in self.scenes}
        if len(bases) != 1:
            raise ValueError(f"eyes of a batch share one numerics.basis, here: {', '.join(sorted(bases)) or 'no eye'}")
        self.clouds = list(clouds) if clouds is not None else clouds_of(self.scenes)
        self.puffs = [Puff.from_scene(scene) for scene in self.scenes]
        counts = [cloud.count for cloud in self.clouds]
        self.first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
        eyes = len(self.scenes)
        self.generation = backend.generation()
        workspace = borrow(self, sum(counts), eyes, bases.pop())
        self.cornea, self.aqueous, self.coupling = workspace.cornea, workspace.aqueous, workspace.coupling
        self.survey, self.sampler = workspace.survey, workspace.sampler
        for eye in range(eyes):
            self._place_at_rest(eye)
        self.samples_per_frame = np.array(
            [max(1, math.ceil(scene.camera.frame_interval_ms / SAMPLE_MS - 1e-9)) for scene in self.scenes]
        )
        self.sample_ms = np.array([scene.camera.frame_interval_ms for scene in self.scenes]) / self.samples_per_frame
        self._span = self.sample_ms * MS
        self.samples = np.array(
            [
                math.floor(scene.numerics.duration_ms / sample_ms + 1e-9)
                for scene, sample_ms in zip(self.scenes, self.sample_ms)
            ]
        )
        self.sample = 0
        self.steps, self.rebuilds, self.recorded = (np.zeros(eyes, dtype=int) for _ in range(3))
        self._binding = np.full(eyes, -1)
        self.stops: list[RunStopped | None] = [None] * eyes
        self._limits, self._course = StepLimits(self.scenes), Puffs(self.puffs)
        self._rebuild_travel = np.array(
            [scene.numerics.refresh_travel * cloud.spacing for scene, cloud in zip(self.scenes, self.clouds)]
        )
        self._calm = guards.Calm(
            QUANTITIES,
            CONDITION_LIMIT[self.scenes[0].numerics.basis],
            np.array([guards.least_stress(scene) for scene in self.scenes]),
        )
        self._dt, self._largest_work = np.zeros(eyes), np.zeros(eyes)
        # the survey of every sample, a row to an eye; the eyes that it was last taken of, those that no guard has
        # stopped
        self._history = np.zeros((self.samples.max() + 1, eyes, len(QUANTITIES)))
        self._eyes, self._going = np.arange(eyes), np.ones(eyes, dtype=bool)
        self._figures = self.sampler.figures(eyes)
        self.sampler.take(self._eyes, np.zeros(eyes, dtype=int), self._dt, self._dt, np.zeros((eyes, 1)))
        self._history[0] = self.sampler.rows[:eyes]
        self._refuse_ill_stencils()

    def _place_at_rest(self, eye: int) -> None:
        scene, cloud, first = self.scenes[eye], self.clouds[eye], int(self.first[eye])
        numerics = scene.numerics
        nodes = place_cornea(self.cornea, scene, cloud.section, self.puffs[eye], cloud.wall_count - 1, eye, first)
        self.aqueous.setup(
            cloud,
            scene.aqueous.density_kg_m3,
            scene.aqueous.viscosity_mpa_s * MPA_S,
            numerics.sound_speed_m_s,
            numerics.dissipation,
            numerics.wall_condition == "no_slip",
            scene.chamber.sealed,
            scene.chamber.compliance_mm3_mmhg * MM3 / MMHG,
            scene.chamber.globe_delay_ms * MS,
            numerics.mean_sound_speed_m_s,
            eye=eye,
            first=first,
        )
        self.coupling.setup(
            numerics.coupling == "iterated",
            numerics.relaxation == "aitken",
            numerics.relaxation_factor,
            numerics.coupling_tolerance,
            numerics.coupling_iterations_max,
            eye,
        )
        self.survey.remember_rest(cloud.section.back_height(nodes[:, 0]), eye)

    def _refuse_ill_stencils(self) -> None:
        for eye, scene in enumerate(self.scenes):
            figures = self.figures(eye)
            condition, limit = figures["worst_condition"], CONDITION_LIMIT[scene.numerics.basis]
            if not condition <= limit:
                where = self._radius_mm(eye, figures["ill_node"])
                cornea = scene.cornea
                raise SceneError(
                    f"cornea.radius_mm = {cornea.radius_mm:g}, cornea.limbus_radius_mm = "
                    f'{cornea.limbus_radius_mm:g}, numerics.basis = "{scene.numerics.basis}": the stencil at '
                    f"r = {where:.2f} mm has a condition number of {condition:.1e}, at most {limit:.0e} is "
                    "allowed; the wedge at the limbus is too sharp for the basis: bring the limbus radius nearer "
                    'to the cornea\'s, or use "quadratic"'
                )

    def _radius_mm(self, eye: int, node: float) -> float:
        return float(self.clouds[eye].points[int(node), 0]) / MM

    def run(self, on_sample: Callable[["Batch"], None] | None = None) -> list[Outcome]:
        """Run all eyes to their ends or stops; call on_sample(self) at each sample. Returns what became of each."""
        self.record()
        while True:
            if on_sample:
                on_sample(self)
            if not self.advance():
                return [Outcome(scene, self.traces(eye), self.stops[eye]) for eye, scene in enumerate(self.scenes)]
            self.record()

    def traces(self, eye: int) -> dict[str, np.ndarray]:
        """The traces of an eye so far, one array per column."""
        samples = self.recorded[eye]
        figures = dict(zip(QUANTITIES, self._history[:samples, eye].T))
        time_ms = np.arange(samples) * self.sample_ms[eye]
        return {
            "time_ms": time_ms,
            "apex_displacement_mm": (self.clouds[eye].section.apex_z - figures["apex_place"]) / MM,
            "apex_velocity_m_s": -figures["apex_velocity"],
            "puff_apex_kpa": self.puffs[eye].pressure_at_apex(time_ms * MS) * 1e-3,
            "fluid_pressure_apex_kpa": figures["fluid_pressure_apex"] * 1e-3,
            "chamber_volume_error": figures["volume_error"].copy(),
            **{
                f"{name}_uj": figures[name] * 1e6
                for name in (
                    "puff_work",
                    "cornea_elastic",
                    "cornea_kinetic",
                    "aqueous_kinetic",
                    "aqueous_elastic",
                    "viscous_loss",
                    "numerical_loss",
                    "outflow_loss",
                    "tissue_loss",
                )
            },
            "energy_error_uj": (_stored(figures) + _lost(figures) - figures["puff_work"]) * 1e6,
            "coupling_iterations": figures["coupling_sweeps"].copy(),
            "coupling_residual": figures["coupling_residual"].copy(),
            "cornea_min_stress_kpa": figures["least_stress"] * 1e-3,
        }

    @property
    def step_limit(self) -> list[str]:
        """The limit that set the last time step of each eye; empty before the first one."""
        return [NAMES[limit] if limit >= 0 else "" for limit in self._binding]

    def figures(self, eye: int) -> dict[str, float]:
        """The survey's figures of an eye at its last sample, by name."""
        return {name: float(column[eye]) for name, column in self._figures.items()}

    def advance(self) -> bool:
        """Take every eye that runs to its next sample; False where none has one."""
        backend.refuse_lost(self.generation)
        self._eyes = eyes = np.flatnonzero(self._going & (self.sample < self.samples))
        if not len(eyes):
            return False
        span = self._span[eyes]
        limit, which = self._limits.stable_steps(self._figures)
        self._binding[eyes] = which[eyes]
        steps = np.ceil(span / limit[eyes])
        dt = span / steps
        times = np.zeros((len(self.scenes), int(steps.max())))
        times[eyes] = (self.sample * span)[:, None] + dt[:, None] * np.arange(1, times.shape[1] + 1)
        before = self._dt[eyes]
        self.sample += 1
        self.sampler.take(
            eyes, steps, dt, np.where(before > 0.0, before, dt), self._course.pressure_at_apex(times)[eyes]
        )
        self._history[self.sample] = self.sampler.rows[: len(self.scenes)]
        self._dt[eyes] = dt
        self.steps[eyes] += steps.astype(int)
        return True

    def record(self) -> None:
        """Look at the eyes that were advanced last: add to their traces, stop what left its validity, rebuild
        weights."""
        backend.refuse_lost(self.generation)
        eyes, figures = self._eyes, self._figures
        self._largest_work = np.fmax(self._largest_work, np.abs(figures["puff_work"]))
        gained = _stored(figures) - figures["puff_work"]
        calm = self._calm.where(self._history[self.sample], gained, self._largest_work)
        if not calm.all():
            for eye in eyes[~calm[eyes]]:
                self._check(eye, gained[eye])
            eyes = eyes[self._going[eyes]]
        self.recorded[eyes] = self.sample + 1
        travelled = figures["wall_travel"] > self._rebuild_travel
        if travelled.any():
            due = np.zeros(len(self.scenes), dtype=np.int32)
            due[eyes] = travelled[eyes]
            self.aqueous.rebuild(due)
            self.survey.remember_build(due)
            self.rebuilds += due

    def _lobes(self, eye: int, least: float) -> int | None:
        """The lobes into which a shell folds now, asked at film frames once it is compressed enough."""
        scene = self.scenes[eye]
        if (
            self.sample % self.samples_per_frame[eye]
            or not guards.is_shell(scene)
            or least > guards.least_stress(scene)
        ):
            return None
        wall = slice(self.first[eye], self.first[eye] + self.clouds[eye].wall_count)
        inside, air = (field.to_numpy()[wall] for field in (self.aqueous.pressure, self.cornea.air_pressure))
        nodes = self.clouds[eye].section.cornea_nodes(self.clouds[eye].wall_count - 1)
        return Folding.from_scene(scene, nodes).lobes(
            self.cornea.place.to_numpy()[wall], scene.eye.iop_mmhg * MMHG + inside - air
        )

    def _check(self, eye: int, gained: float) -> None:
        figures = self.figures(eye)
        try:
            guards.check(
                figures,
                float(gained),
                float(self._largest_work[eye]),
                self.scenes[eye],
                lambda node: self._radius_mm(eye, node),
                float(self.sample * self.sample_ms[eye]),
                figures["viscous_loss"],
                figures["numerical_loss"],
                self._lobes(eye, figures["least_stress"]),
            )
        except RunStopped as stop:
            # without its traceback, which would hold on to the fields
            self.stops[eye] = stop.with_traceback(None)
            self._going[eye] = False


def _stored(figures):
    """Energy [J] in cornea and aqueous humour relative to rest."""
    return sum(figures[name] for name in ("cornea_elastic", "cornea_kinetic", "aqueous_kinetic", "aqueous_elastic"))


def _lost(figures):
    """Energy [J] lost or carried off since the start."""
    return figures["viscous_loss"] + figures["numerical_loss"] + figures["outflow_loss"] + figures["tissue_loss"]


def run_batch(scenes: Sequence[Scene], progress: bool = False) -> list[Outcome]:
    """Run scenes together under the full model, whatever their `numerics.fidelity`; what became of each, in their
    order.

    Scenes may differ in everything; those of one basis run side by side, AT_ONCE nodes at a time. An eye that leaves
    its validity stops alone and keeps its traces up to there. progress: a bar on the terminal. Raises SceneError where
    a
    chamber cannot be filled or its stencils are no good.
    """
    clouds = clouds_of(scenes)
    outcomes: list[Outcome | None] = [None] * len(scenes)
    with tqdm(
        total=sum(scene.numerics.duration_ms for scene in scenes),
        unit=" ms",
        disable=not progress,
        dynamic_ncols=True,
        bar_format="{desc}{percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} ms [{elapsed}<{remaining}]",
        desc=f"{len(scenes)} eyes: ",
    ) as bar:
        for chosen in _parcels(scenes, clouds):
            before = bar.n
            batch = Batch([scenes[k] for k in chosen], [clouds[k] for k in chosen])
            told = lambda batch, before=before: bar.update(
                before + float(((batch.recorded - 1) * batch.sample_ms).sum()) - bar.n
            )
            for k, outcome in zip(chosen, batch.run(told)):
                outcomes[k] = outcome
            bar.update(before + sum(scenes[k].numerics.duration_ms for k in chosen) - bar.n)
    return outcomes


def _parcels(scenes, clouds):
    """Numbers of the scenes that run side by side: one basis, AT_ONCE nodes or a single eye."""
    for basis in sorted({scene.numerics.basis for scene in scenes}):
        parcel, nodes = [], 0
        for k, (scene, cloud) in enumerate(zip(scenes, clouds)):
            if scene.numerics.basis != basis:
                continue
            if parcel and nodes + cloud.count > AT_ONCE:
                yield parcel
                parcel, nodes = [], 0
            parcel.append(k)
            nodes += cloud.count
        yield parcel
