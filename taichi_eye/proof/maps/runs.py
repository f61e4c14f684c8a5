"""Short runs of a coarse eye, with keys set beyond what a scene file may hold, and what became of them."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np

from taichi_eye.cloud.packing import Cloud
from taichi_eye.errors import RunStopped
from taichi_eye.report.history import History, summarise
from taichi_eye.scene import Scene, load_scene
from taichi_eye.solver import guards
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

COARSE = {"numerics.spacing_mm": 0.28, "numerics.sound_speed_m_s": 40.0}

# what a stop is about, in a word, and the colour of its dot
CAUSES = {
    "taut and sound": "#3d8b57",
    "slack": "#c9641a",
    "back": "#a88a1a",
    "cross": "#8c3a8c",
    "singular": "#4c5560",
    "finite": "#8a2030",
    "viscosity": "#2a9d9d",
    "energy": "#b03a48",
    "converge": "#14539a",
}
NAMES = {
    "slack": "cornea went slack",
    "back": "reached the back",
    "cross": "nodes about to cross",
    "singular": "stencil singular",
    "finite": "not finite",
    "viscosity": "viscous loss not balanced",
    "energy": "energy grew without work",
    "converge": "iteration did not converge",
}

_clouds: dict[tuple, Cloud] = {}


@dataclass(frozen=True)
class Outcome:
    """What a run left: traces as arrays, the guard's stop or None, seconds of wall clock, steps taken."""

    scene: Scene
    traces: dict[str, np.ndarray]
    stop: RunStopped | None
    seconds: float
    steps: int

    @property
    def cause(self) -> str:
        """The word of `CAUSES` that the stop's diagnosis holds; "" for a run that got to its end."""
        if self.stop is None:
            return ""
        return next(word for word in CAUSES if word in self.stop.what)

    @property
    def apex(self) -> History:
        """Summary of the apex history."""
        return summarise(self.traces["time_ms"], self.traces["apex_displacement_mm"])

    @property
    def energy_share(self) -> float:
        """Largest energy error over the largest work of the puff."""
        work = np.abs(self.traces["puff_work_uj"]).max()
        return float(np.abs(self.traces["energy_error_uj"]).max() / work) if work > 0.0 else 0.0


def scene_with(keys: dict, base: dict | None = None) -> Scene:
    """A resolved scene on the coarse eye; keys that `load_scene` would refuse are set behind its back.

    keys: by "section.key". Those of `numerics` and the density of the cornea, which no other key is computed from, are
    replaced after loading and so have no limits; all others are loaded as from a file.
    """
    every = {**(COARSE if base is None else base), **keys}
    free = lambda name: name.startswith("numerics.") and name != "numerics.spacing_mm" or name == "cornea.density_kg_m3"
    scene = load_scene(
        None,
        [f"{name}={value}" for name, value in every.items() if not free(name)]
        + [f"{name}={every[name]}" for name in ("numerics.duration_ms",) if name in every],
    )
    for name, value in every.items():
        if free(name):
            section, field = name.split(".")
            scene = replace(scene, **{section: replace(getattr(scene, section), **{field: value})})
    return scene


def cloud_for(scene: Scene) -> Cloud:
    """The packed cloud of a scene, packed once per chamber and spacing."""
    chamber = (scene.chamber, scene.cornea.radius_mm, scene.cornea.limbus_radius_mm, scene.numerics.spacing_mm)
    if chamber not in _clouds:
        _clouds[chamber] = cloud_of(scene)
    return _clouds[chamber]


def run(keys: dict, base: dict | None = None, kind: type[Simulation] = Simulation, on_sample=None) -> Outcome:
    """Run a scene (see `scene_with`) to its end or to a guard's stop; kind: the simulation's class."""
    scene = scene_with(keys, base)
    started = time.perf_counter()
    simulation = kind(scene, cloud_for(scene))
    stop = None
    try:
        simulation.run(on_sample=on_sample)
    except RunStopped as caught:
        # without its traceback, which would hold on to the fields that the next run takes over
        stop = caught.with_traceback(None)
    return Outcome(scene, simulation.traces, stop, time.perf_counter() - started, simulation.steps)


@contextmanager
def unguarded():
    """Within it no run is stopped: to show what the guards prevent."""
    with mock.patch.object(guards, "check", lambda *figures: None):
        yield
