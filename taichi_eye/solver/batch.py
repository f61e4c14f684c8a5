"""Many eyes advanced together: scenes that differ in anything but their basis, each as if it were alone.

The eyes stand one after the other in the same fields (`taichi_eye.mfpm.neighbours`), and each has its own time step,
rebuilds, samples, guards and traces. Time is cut into film frames, frames into samples of at most `SAMPLE_MS`, samples
into equal steps below the stable limit of the moment; all eyes take a sample together, in one launch. At each sample
the traces grow by a row, the guards look, and the operator weights are rebuilt once the wall has moved by
`numerics.refresh_travel` spacings since they were last. An eye that a guard stops, or that has reached its end, rests
while the others go on.

A sample of small eyes, or of many, is a parallel loop over the eyes, each with all its steps on one thread of a CPU or
in one block of a GPU (`taichi_eye.solver.sample`), so an eye does the same arithmetic in the same order whatever stands
beside it: its traces are those of a run alone, on a CPU bit for bit. What Python does at a sample it does for all eyes
at once, on arrays.
"""

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_eye import backend
from taichi_eye.cloud.packing import Cloud
from taichi_eye.errors import RunStopped, SceneError
from taichi_eye.eye.puff import Puffs
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.scene import Scene
from taichi_eye.solver.case import case_of, clouds_of
from taichi_eye.solver.figures import at, at_rest, traces_of
from taichi_eye.solver.folding import Folding
from taichi_eye.solver.guards import Guard, liquid_advice
from taichi_eye.solver.state import State
from taichi_eye.solver.timestep import NAMES, StepLimits, refuse_endless
from taichi_eye.solver.workspace import borrow
from taichi_eye.units import MM

# a batch's own share of its state, arrays [eyes]
KEPT = ("steps", "rebuilds", "recorded", "_binding", "_dt", "_load", "_going")


@dataclass(frozen=True)
class Outcome:
    """What became of one eye: traces as arrays by column, and the guard's stop or None for an eye that got to its
    end."""

    scene: Scene
    traces: dict[str, np.ndarray]
    stop: RunStopped | None


class _Walls:
    """Places and net excess pressures of all nodes at a sample, copied from the fields once, when first asked for."""

    def __init__(self, cornea, aqueous):
        self._cornea, self._aqueous = cornea, aqueous

    @cached_property
    def place(self) -> np.ndarray:
        return self._cornea.place.to_numpy()

    @cached_property
    def excess(self) -> np.ndarray:
        return self._aqueous.pressure.to_numpy() - self._cornea.air_pressure.to_numpy()


class Batch:
    """Coupled corneas and aqueous humours of several scenes of one basis (ValueError otherwise), advanced together.

    scenes: resolved; clouds: theirs, packed here when left out (SceneError where that fails). Public, by eye: scenes,
    cases, clouds, first (node); steps and rebuilds so far, step_limit (the limit that set the last time step), stops
    (RunStopped or None), recorded (rows of the traces). For all: cornea, aqueous (fields), sample (of all eyes that
    still run). `state` and `restore` save and take up what evolves.
    """

    def __init__(self, scenes: Sequence[Scene], clouds: Sequence[Cloud] | None = None):
        self.scenes = list(scenes)
        bases = {scene.numerics.basis for scene in self.scenes}
        if len(bases) != 1:
            raise ValueError(f"eyes of a batch share one numerics.basis, here: {', '.join(sorted(bases)) or 'no eye'}")
        self.clouds = list(clouds) if clouds is not None else clouds_of(self.scenes)
        self.cases = [case_of(scene) for scene in self.scenes]
        self.clocks = [case.clock for case in self.cases]
        counts = [cloud.count for cloud in self.clouds]
        for case, count in zip(self.cases, counts):
            refuse_endless(case, count, nodes_flow=True)
        self.first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
        eyes = len(self.scenes)
        self.generation = backend.generation()
        self._workspace = workspace = borrow(self, sum(counts), eyes, bases.pop())
        self.cornea, self.aqueous, self.coupling = workspace.cornea, workspace.aqueous, workspace.coupling
        self.survey, self.sampler = workspace.survey, workspace.sampler
        for eye in range(eyes):
            self._place_at_rest(eye)
        column = lambda name: np.array([getattr(clock, name) for clock in self.clocks])
        self.sample_ms, self._span, self._samples = column("sample_ms"), column("sample_s"), column("samples")
        self._per_frame = column("samples_per_frame")
        self.sample = 0
        self.steps, self.rebuilds, self.recorded = (np.zeros(eyes, dtype=int) for _ in range(3))
        self._binding = np.full(eyes, -1)
        self.stops: list[RunStopped | None] = [None] * eyes
        self._limits = StepLimits(self.cases)
        self._course = Puffs([case.eye.puff for case in self.cases])
        self._rebuild_travel = np.array([case.scheme.refresh_distance for case in self.cases])
        self._guard = Guard(self.cases, [liquid_advice(case) for case in self.cases])
        self._dt, self._load = np.zeros((2, eyes))  # of the last step: its length [s] and the puff at its end [Pa]
        # the figures of every sample, a row to an eye; the eyes that it was last taken of, those that no guard has
        # stopped
        self._history = at_rest(self._samples.max() + 1, eyes)
        self._eyes, self._going = np.arange(eyes), np.ones(eyes, dtype=bool)
        self._figures = self.sampler.figures(eyes)
        self.sampler.take(self._eyes, np.zeros(eyes, dtype=int), self._dt, self._dt, np.zeros((eyes, 1)))
        self._history[0] = self.sampler.rows[:eyes]
        self._restored = False
        self._foldings: dict[int, Folding] = {}
        self._refuse_ill_stencils()

    def _place_at_rest(self, number: int) -> None:
        case, cloud, first = self.cases[number], self.clouds[number], int(self.first[number])
        eye, scheme = case.eye, case.scheme
        nodes = self.cornea.build(eye, cloud.wall_count - 1, number, first)
        self.aqueous.build(cloud, eye, scheme, number, first)
        self.coupling.setup(
            iterated=scheme.iterated,
            aitken=scheme.aitken,
            factor=scheme.relaxation_factor,
            tolerance=scheme.coupling_tolerance,
            sweeps_max=scheme.coupling_iterations_max,
            eye=number,
        )
        self.survey.remember_rest(cloud.section.back_height(nodes[:, 0]), number)

    def _refuse_ill_stencils(self) -> None:
        for eye, scene in enumerate(self.scenes):
            row = self._history[0, eye]
            condition, limit = row[at.worst_condition], CONDITION_LIMIT[scene.numerics.basis]
            if not condition <= limit:
                where = self._radius_mm(eye, row[at.ill_node])
                cornea = scene.cornea
                raise SceneError(
                    f"cornea.radius_mm = {cornea.radius_mm:g}, cornea.limbus_radius_mm = {cornea.limbus_radius_mm:g}, "
                    f'numerics.basis = "{scene.numerics.basis}": the stencil at r = {where:.2f} mm has a condition '
                    f"number of {condition:.1e}, at most {limit:.0e} is allowed; the wedge at the limbus is too sharp "
                    'for the basis: bring the limbus radius nearer to the cornea\'s, or use "quadratic"'
                )

    def _radius_mm(self, eye: int, node: float) -> float:
        return float(self.clouds[eye].points[int(node), 0]) / MM

    def run(self, on_sample: Callable[["Batch"], None] | None = None) -> list[Outcome]:
        """Run all eyes to their ends or stops; call on_sample(self) at each sample. Returns what became of each.

        A batch that was restored goes on after the sample of its state.
        """
        restored, self._restored = self._restored, False
        if not restored:
            self.record()
        while True:
            if on_sample and not restored:
                on_sample(self)
            restored = False
            if not self.advance():
                return [Outcome(scene, self.traces(eye), self.stops[eye]) for eye, scene in enumerate(self.scenes)]
            self.record()

    def traces(self, eye: int) -> dict[str, np.ndarray]:
        """The traces of an eye so far, one array per column."""
        case, rows = self.cases[eye], self._history[: self.recorded[eye], eye]
        return traces_of(rows, case.clock, case.eye.puff, case.eye.section.apex_z)

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
        self._eyes = eyes = np.flatnonzero(self._going & (self.sample < self._samples))
        if not len(eyes):
            return False
        span = self._span[eyes]
        limit, which = self._limits.stable_steps(self._figures)
        self._binding[eyes] = which[eyes]
        steps = np.ceil(span / limit[eyes])
        dt = span / steps
        before = self._dt[eyes]
        loads = self._loads(eyes, dt, int(steps.max()))
        self.sample += 1
        self.sampler.take(eyes, steps, dt, np.where(before > 0.0, before, dt), loads)
        self._history[self.sample] = self.sampler.rows[: len(self.scenes)]
        self._dt[eyes], self._load[eyes] = dt, loads[np.arange(len(eyes)), steps.astype(int) - 1]
        self.steps[eyes] += steps.astype(int)
        return True

    def _loads(self, eyes, dt, steps: int) -> np.ndarray:
        """The puff [Pa] that eyes meet at the end of each of so many steps of dt [s], [eyes, steps].

        A load stands for half a step to either side. The first also takes what the last one before stood for too long
        or too short, its step having had another length, and at the start of a run, at rest, the half step before it.
        """
        edges = np.zeros((len(self.scenes), steps + 1))
        start, before = self.sample * self._span[eyes], self._dt[eyes]
        edges[eyes] = start[:, None] + dt[:, None] * (np.arange(steps + 1) + 0.5)
        edges[eyes, 0] = start + 0.5 * before
        impulse = self._course.impulse_at_apex(edges)[eyes]
        impulse[:, 0] -= 0.5 * (dt - before) * self._load[eyes]
        return impulse / dt[:, None]

    def record(self) -> None:
        """Look at the eyes that were advanced last: add to their traces, stop what left its validity, rebuild
        weights."""
        backend.refuse_lost(self.generation)
        eyes, rows = self._eyes, self._history[self.sample]
        calm = self._guard.where_calm(rows, self.sample % self._per_frame == 0)
        if not calm.all():
            walls = _Walls(self.cornea, self.aqueous)
            for eye in eyes[~calm[eyes]]:
                self.stops[eye] = self._guard.stop_of(
                    eye,
                    eye,
                    rows[eye],
                    radius_mm=lambda node, eye=eye: self._radius_mm(eye, node),
                    time_ms=float(self.sample * self.sample_ms[eye]),
                    lobes=self._lobes(eye, rows[eye], walls),
                )
                self._going[eye] = self.stops[eye] is None
            eyes = eyes[self._going[eyes]]
        self.recorded[eyes] = self.sample + 1
        travelled = rows[:, at.wall_travel] > self._rebuild_travel
        if travelled.any():
            due = np.zeros(len(self.scenes), dtype=np.int32)
            due[eyes] = travelled[eyes]
            self.aqueous.rebuild(due)
            self.survey.remember_build(due)
            self.rebuilds += due

    def _lobes(self, number: int, row: np.ndarray, walls: "_Walls") -> int | None:
        """The lobes into which a shell folds now, asked at film frames once it is compressed enough."""
        eye = self.cases[number].eye
        if self.sample % self._per_frame[number] or not self._guard.may_fold(number, row):
            return None
        count = self.clouds[number].wall_count
        if number not in self._foldings:
            self._foldings[number] = Folding.of(eye, eye.section.cornea_nodes(count - 1))
        wall = slice(self.first[number], self.first[number] + count)
        return self._foldings[number].lobes(walls.place[wall], eye.iop + walls.excess[wall])

    def state(self) -> State:
        """All that evolves, at the last sample that was recorded: with it and the scenes, a run can go on elsewhere."""
        return {
            **self._workspace.snapshot.take(int(self.first[-1] + self.clouds[-1].count), len(self.scenes)),
            "sample": np.array(self.sample),
            "figures": self._history[: self.sample + 1].copy(),
            "largest_work": self._guard.largest_work.copy(),
            **{name: getattr(self, name).copy() for name in KEPT},
            "stops": np.array([repr(stop.args) if stop else "" for stop in self.stops]),
        }

    def restore(self, state: State) -> None:
        """Take up a state that `state` gave for the same scenes, in a new batch; ValueError where it does not fit."""
        figures = state["figures"]
        if figures.shape[1:] != self._history.shape[1:] or len(figures) > len(self._history):
            raise ValueError("the state belongs to other scenes")
        self.sample = int(state["sample"])
        self._history[: len(figures)] = figures
        self.sampler.rows[: len(self.scenes)] = figures[-1]
        self._guard.largest_work = state["largest_work"].copy()
        for name in KEPT:
            getattr(self, name)[:] = state[name]
        self.stops = [RunStopped(*ast.literal_eval(text)) if text else None for text in state["stops"].tolist()]
        self._workspace.restore(state)
        self._restored = True
