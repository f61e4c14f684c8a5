"""Short runs of a coarse eye, with keys set beyond what a scene file may hold, and what became of them."""

from contextlib import contextmanager
from unittest import mock

from taichi_eye.cloud.packing import Cloud
from taichi_eye.ladder.trial import Trial, run_scene
from taichi_eye.scene import Scene, load_scene
from taichi_eye.solver import guards
from taichi_eye.solver.case import cloud_of

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


def cause(trial: Trial) -> str:
    """The word of `CAUSES` that the stop's diagnosis holds; "" for a run that got to its end."""
    return "" if trial.stop is None else next(word for word in CAUSES if word in trial.stop.what)


def scene_with(keys: dict) -> Scene:
    """A resolved scene on the coarse eye, with values that a scene file would be refused for.

    keys: by "section.key". Those of `numerics` but its spacing, and the density of the cornea, have no limits; all
    others have those of a scene file.
    """
    every = {**COARSE, **keys}
    free = {name for name in every if name.startswith("numerics.") and name != "numerics.spacing_mm"}
    free |= every.keys() & {"cornea.density_kg_m3"}
    scene = load_scene().but({name: value for name, value in every.items() if name not in free})
    return scene.but({name: every[name] for name in free}, within_limits=False)


def cloud_for(scene: Scene) -> Cloud:
    """The packed cloud of a scene, packed once per chamber and spacing."""
    chamber = (scene.chamber, scene.cornea.radius_mm, scene.cornea.limbus_radius_mm, scene.numerics.spacing_mm)
    if chamber not in _clouds:
        _clouds[chamber] = cloud_of(scene)
    return _clouds[chamber]


def run(keys: dict) -> Trial:
    """Run a scene (see `scene_with`) to its end or to a guard's stop."""
    scene = scene_with(keys)
    return run_scene(scene, cloud_for(scene))


@contextmanager
def unguarded():
    """Within it no run is stopped: to show what the guards prevent."""
    with mock.patch.object(guards, "check", lambda *_, **__: None):
        yield
