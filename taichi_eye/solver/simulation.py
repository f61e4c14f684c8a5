"""One scene's coupled simulation: a batch of one eye (`taichi_eye.solver.batch`), run frame by frame."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from taichi_eye.cloud.packing import Cloud
from taichi_eye.cloud.quality import CloudQuality, measure
from taichi_eye.errors import RunStopped
from taichi_eye.solver.batch import Batch, cloud_of


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
        self.puff = batch.puffs[0]
        self.samples_per_frame, self.sample_ms = int(batch.samples_per_frame[0]), float(batch.sample_ms[0])

    @property
    def sample(self) -> int:
        """Number of the last sample."""
        return self.batch.sample

    @property
    def time_ms(self) -> float:
        """Simulated time of the last sample."""
        return self.sample * self.sample_ms

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
        """Run to the end; call on_frame(self, frame) at each film frame and on_sample(self) at each sample.

        Returns the traces as arrays. Raises RunStopped when a guard stops the run; `traces` keeps what was computed.
        """
        frames = self.scene.camera.frame_count
        self._record()
        while True:
            frame, rest = divmod(self.sample, self.samples_per_frame)
            if on_sample:
                on_sample(self)
            if rest == 0 and frame < frames and on_frame:
                on_frame(self, frame)
            if not self.batch.advance():
                return self.traces
            self._record()

    def arrays(self) -> dict[str, np.ndarray]:
        """The traces so far, one array per column."""
        return self.traces

    def _record(self) -> None:
        self.batch.record()
        if self.batch.stops[0] is not None:
            # a new one: what is raised holds on to the frames it passes, and so to the fields
            raise RunStopped(*self.batch.stops[0].args)
