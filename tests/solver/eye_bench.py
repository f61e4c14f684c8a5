"""A coarse whole eye, run with the survey's figures kept."""

from dataclasses import dataclass, field

import numpy as np

from taichi_eye.errors import RunStopped
from taichi_eye.scene import Scene, load_scene
from taichi_eye.solver.simulation import Simulation

COARSE = ("numerics.spacing_mm=0.28", "numerics.sound_speed_m_s=30")


@dataclass
class Run:
    """What a run left, as arrays; it does not hold on to the simulation, whose fields the next one takes over."""

    scene: Scene
    traces: dict = None
    figures: list = field(default_factory=list)
    stop: RunStopped = None

    def __getitem__(self, column):
        return self.traces[column]

    def each(self, name):
        """A figure of the survey at every sample."""
        return np.array([figures[name] for figures in self.figures])


def run_eye(*overrides):
    """Run the coarse eye from rest with some keys overridden."""
    scene = load_scene(None, COARSE + overrides)
    run, simulation = Run(scene), Simulation(scene)
    keep = lambda eye: run.figures.append(eye.batch.figures(0))
    try:
        simulation.run(on_sample=keep)
    except RunStopped as stop:
        keep(simulation)
        run.stop = stop.with_traceback(None)
    run.traces = simulation.traces
    run.steps, run.step_limit, run.rebuilds = simulation.steps, simulation.step_limit, simulation.rebuilds
    run.cloud, aqueous, cornea = simulation.cloud, simulation.aqueous, simulation.cornea
    run.places, run.velocities, run.pressures = (
        f.to_numpy()[: run.cloud.count] for f in (aqueous.place, aqueous.velocity, aqueous.pressure)
    )
    run.wall = cornea.place.to_numpy()[: run.cloud.wall_count]
    run.wall_velocity = simulation.coupling.wall_velocity.to_numpy()[: run.cloud.wall_count]
    return run
