"""A scene as the solver takes it: the eye and the scheme in SI, the clock, and the scene itself for what it says to a
user."""

from dataclasses import dataclass

from taichi_eye.cloud.packing import Cloud, packed
from taichi_eye.errors import SceneError
from taichi_eye.eye.eye import Eye, eye_of
from taichi_eye.scene import Scene
from taichi_eye.solver.scheme import Clock, Scheme, clock_of, scheme_of


@dataclass(frozen=True)
class Case:
    """One scene, read once; messages name the keys of `scene`."""

    scene: Scene
    eye: Eye
    scheme: Scheme
    clock: Clock


def case_of(scene: Scene) -> Case:
    """The case of a resolved scene."""
    return Case(scene, eye_of(scene), scheme_of(scene), clock_of(scene))


def cloud_of(scene: Scene) -> Cloud:
    """The packed node cloud of a resolved scene; SceneError where its chamber cannot be filled at its spacing."""
    return packed(eye_of(scene).section, scheme_of(scene).spacing)


def clouds_of(scenes) -> list[Cloud]:
    """The clouds of scenes, packed once for each chamber and spacing; raises like `cloud_of`."""
    found: dict[tuple, Cloud] = {}
    clouds = []
    for number, scene in enumerate(scenes):
        key = eye_of(scene).section, scheme_of(scene).spacing
        if key not in found:
            try:
                found[key] = packed(*key)
            except SceneError as problem:
                which = f"scene {number} of the batch: " if len(scenes) > 1 else ""
                raise SceneError(f"{which}{problem}") from None
        clouds.append(found[key])
    return clouds
