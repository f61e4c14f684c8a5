"""From a scene to the rung that computes it (`taichi_eye.rungs`)."""

from taichi_eye.cloud.packing import Cloud
from taichi_eye.rungs import RUNGS
from taichi_eye.scene import Scene
from taichi_eye.scene.schema import AUTO


def with_numerics(scene: Scene, **changes) -> Scene:
    """The scene with other values of [numerics].

    Unless given, a new fidelity brings its own refresh_travel, and a new sound speed is that of the mean pressure, too.
    """
    if "fidelity" in changes:
        changes.setdefault("refresh_travel", AUTO)
    if "sound_speed_m_s" in changes:
        changes.setdefault("mean_sound_speed_m_s", AUTO)
    return scene.but({f"numerics.{name}": value for name, value in changes.items()})


def simulation_of(scene: Scene, cloud: Cloud | None = None):
    """The simulation that a scene's fidelity asks for; ValueError for "auto", which `taichi_eye.ladder.choose` decides
    first."""
    fidelity = scene.numerics.fidelity
    if fidelity == "auto":
        raise ValueError(
            'numerics.fidelity = "auto" has to be decided first: taichi_eye.ladder.choose.choose(scene).scene'
        )
    return RUNGS[fidelity].simulation(scene, cloud)


def needs_cloud(scene: Scene) -> bool:
    """Whether a run of this scene packs nodes: to compute with, or to show."""
    packs = RUNGS[scene.numerics.fidelity].packs_nodes
    return packs or scene.camera.view != "scheimpflug" or scene.output.node_fields
