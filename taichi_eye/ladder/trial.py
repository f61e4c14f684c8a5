"""A run without a film, and what it leaves: the one place where a guard's stop becomes a result.

Charts, pilots, studies, sweeps and estimates run scenes for their traces; that a run ends early is then an answer and
not an error. `run_scene` builds the simulation that the scene's fidelity asks for and runs it; who builds a simulation
of his own hands it to `run_to_stop`. The stop is kept without its traceback, which would hold on to the fields and
kernels that the next run takes over.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taichi_eye.cloud.packing import Cloud
from taichi_eye.errors import RunStopped
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.report.history import History, summarise
from taichi_eye.scene import Scene


@dataclass(frozen=True)
class Trial:
    """What a run left.

    traces: arrays by column, up to the stop; stop: the guard's, None for a run that got to its end; steps: taken;
    nodes: of the cloud, of the wall where there is none; set_up_s, solver_s: wall time before the first step (packing
    included, where no cloud was given) and from there on.
    """

    scene: Scene
    traces: dict[str, np.ndarray]
    stop: RunStopped | None
    steps: int
    nodes: int
    set_up_s: float
    solver_s: float

    @property
    def apex(self) -> History:
        """Summary of the apex history."""
        return summarise(self.traces["time_ms"], self.traces["apex_displacement_mm"])

    @property
    def energy_share(self) -> float:
        """Largest energy error over the largest work of the puff; 0 without a puff."""
        work = np.abs(self.traces["puff_work_uj"]).max()
        return float(np.abs(self.traces["energy_error_uj"]).max() / work) if work > 0.0 else 0.0


def run_to_stop(simulation, on_frame: Callable | None = None, on_sample: Callable | None = None) -> RunStopped | None:
    """Run a simulation; the guard's stop, or None where it got to its end. The callbacks are those of its `run`."""
    try:
        simulation.run(on_frame, on_sample)
    except RunStopped as stop:
        return stop.with_traceback(None)
    return None


def run_scene(
    scene: Scene, cloud: Cloud | None = None, on_frame: Callable | None = None, on_sample: Callable | None = None
) -> Trial:
    """Run a resolved scene of a decided fidelity to its end or to a guard's stop; cloud: its nodes, where packed."""
    started = time.perf_counter()
    simulation = simulation_of(scene, cloud)
    built = time.perf_counter()
    stop = run_to_stop(simulation, on_frame, on_sample)
    done = time.perf_counter()
    nodes = simulation.cloud.count if simulation.cloud is not None else simulation.wall_count
    return Trial(scene, simulation.traces, stop, simulation.steps, nodes, built - started, done - built)
