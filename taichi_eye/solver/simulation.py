"""One scene's coupled simulation: a batch of one eye (`taichi_eye.solver.batch`), run frame by frame."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from taichi_eye.cloud.packing import Cloud
from taichi_eye.cloud.quality import CloudQuality, measure
from taichi_eye.errors import RunStopped
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.state import State


class Simulation:
    """One scene's coupled cornea and aqueous humour.

    scene: resolved; cloud: its `cloud_of`, packed here when left out (SceneError where that fails). Public: cornea,
    aqueous (fields, this eye's from 0 on), section, cloud, quality, traces (dict of arrays), step_limit (the limit that
    set the last time step), steps (taken so far), rebuilds.
    """

    def __init__(self, scene, cloud: Cloud | None = None):
        self.scene = scene
        self.cloud = cloud or cloud_of(scene)
        self.section = self.cloud.section
        self.quality: CloudQuality = measure(self.cloud)
        self.batch = batch = Batch([scene], [self.cloud])
        self.cornea, self.aqueous, self.coupling, self.survey = (
            batch.cornea,
            batch.aqueous,
            batch.coupling,
            batch.survey,
        )
        self.case = batch.cases[0]
        self.eye, self.clock, self.puff = self.case.eye, self.case.clock, self.case.eye.puff
        self._restored = False

    @property
    def sample(self) -> int:
        """Number of the last sample."""
        return self.batch.sample

    @property
    def time_ms(self) -> float:
        """Simulated time of the last sample."""
        return self.sample * self.clock.sample_ms

    @property
    def steps(self) -> int:
        """Time steps taken so far."""
        return int(self.batch.steps[0])

    @property
    def rebuilds(self) -> int:
        """How often the operator weights were computed anew."""
        return int(self.batch.rebuilds[0])

    @property
    def step_limit(self) -> str:
        """The limit that set the last time step."""
        return self.batch.step_limit[0]

    @property
    def traces(self) -> dict[str, np.ndarray]:
        """The traces so far, one array per column."""
        return self.batch.traces(0)

    @property
    def wall_count(self) -> int:
        """Nodes of the cornea."""
        return self.cloud.wall_count

    @property
    def wall_velocity(self):
        """Field of the wall's velocity now [m/s], the first `wall_count` nodes."""
        return self.cornea.velocity

    def liquid(self):
        """Fields of the liquid now: place, velocity, excess pressure, and how many nodes they hold."""
        return self.aqueous.place, self.aqueous.velocity, self.aqueous.pressure, self.cloud.count

    def facts(self) -> dict:
        """What a summary tells about the discretisation and the work done."""
        condition = float(self.aqueous.operators.condition.to_numpy()[: self.cloud.count].max())
        sweeps = self.traces["coupling_iterations"]
        return {
            "coupling_iterations": {
                "mean": float(sweeps[1:].mean()) if len(sweeps) > 1 else 0.0,
                "most": int(sweeps.max()),
            },
            "cloud": {**asdict(self.quality), "wall_nodes": self.wall_count, "worst_stencil_condition": condition},
            "steps": self.steps,
            "step_limit": self.step_limit,
            "operator_rebuilds": self.rebuilds,
        }

    def about(self) -> str:
        """The model of the liquid in a line."""
        quality, numerics = self.quality, self.scene.numerics
        return (
            f"{quality.nodes} nodes at {numerics.spacing_mm:g} mm ({numerics.basis}), smallest gap "
            f"{quality.smallest_gap:.2f} and largest hole {quality.largest_hole:.2f} spacings, "
            f"c {numerics.sound_speed_m_s:g} m/s"
        )

    def run(
        self,
        on_frame: Callable[["Simulation", int], None] | None = None,
        on_sample: Callable[["Simulation"], None] | None = None,
    ) -> dict[str, np.ndarray]:
        """Run to the end; call on_sample(self) at each sample and on_frame(self, frame) at each film frame, in this
        order.

        A simulation that was restored goes on after the sample of its state. Returns the traces as arrays. Raises
        RunStopped when a guard stops the run; `traces` keeps what was computed.
        """
        if not self._restored:
            self._record()
        while True:
            if not self._restored:
                if on_sample:
                    on_sample(self)
                frame = self.clock.frame_of(self.sample)
                if frame is not None and on_frame:
                    on_frame(self, frame)
            self._restored = False
            if not self.batch.advance():
                return self.traces
            self._record()

    def frame(self) -> np.ndarray:
        """The film's image now, uint8: grey [rows, columns] of the slit, or RGB [rows, columns, 3] (camera.view)."""
        # the film stands on the solver: it is loaded for whoever asks to see
        from taichi_eye.recording.observer import picture

        return picture(self)

    def state(self) -> State:
        """All that evolves, at the present sample, by name; `restore` takes it up."""
        return self.batch.state()

    def restore(self, state: State) -> None:
        """Take up the state of a simulation of the same scene: `run` goes on after its sample. ValueError where it does
        not fit."""
        self.batch.restore(state)
        self._restored = True

    def _record(self) -> None:
        self.batch.record()
        if self.batch.stops[0] is not None:
            # a new one: what is raised holds on to the frames it passes, and so to the fields
            raise RunStopped(*self.batch.stops[0].args)
