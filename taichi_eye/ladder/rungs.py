"""The rungs, cheapest first: what each is for and what it leaves out.

    membrane    cornea under a constant IOP. No liquid: no volume to hold, no inertia. What studies without a fluid did;
                the right model of an open chamber at slow loads, 3 times too deep in a sealed one.
    cavity      cornea over a uniform pressure that holds the chamber's volume (its stiffness is the bulk modulus of
                water and the globe's compliance). Leaves out inertia and flow: the default eye's peak is 0.5 % shallow,
                its
                flanks 0.04 ms early, 2 % of the peak at the worst instant.
    added_mass  cornea over incompressible potential flow. Leaves out viscosity, vorticity and sound.
    mfpm        the weakly compressible, viscous liquid on moving nodes.

All share scene, cornea, puff, film and traces; all but `mfpm` are `taichi_eye.solver.reduced`.
"""

from taichi_eye.cloud.packing import Cloud
from taichi_eye.scene import Scene
from taichi_eye.scene.schema import AUTO
from taichi_eye.solver.reduced import Reduced
from taichi_eye.solver.simulation import Simulation

RUNGS = ("membrane", "cavity", "added_mass", "mfpm")


def with_numerics(scene: Scene, **changes) -> Scene:
    """The scene with other values of [numerics].

    Unless given, a new fidelity brings its own refresh_travel, and a new sound speed is that of the mean pressure, too.
    """
    if "fidelity" in changes:
        changes.setdefault("refresh_travel", AUTO)
    if "sound_speed_m_s" in changes:
        changes.setdefault("mean_sound_speed_m_s", AUTO)
    return scene.but({f"numerics.{name}": value for name, value in changes.items()})


def simulation_of(scene: Scene, cloud: Cloud | None = None) -> Simulation | Reduced:
    """The simulation that a scene's fidelity asks for; ValueError for "auto", which `taichi_eye.ladder.choose` decides
    first."""
    if scene.numerics.fidelity == "auto":
        raise ValueError(
            'numerics.fidelity = "auto" has to be decided first: taichi_eye.ladder.choose.choose(scene).scene'
        )
    if scene.numerics.fidelity == "mfpm":
        return Simulation(scene, cloud)
    return Reduced(scene, scene.numerics.fidelity, cloud)


def needs_cloud(scene: Scene) -> bool:
    """Whether a run of this scene packs nodes: to compute with, or to show."""
    return (
        scene.numerics.fidelity in ("added_mass", "mfpm")
        or scene.camera.view != "scheimpflug"
        or scene.output.node_fields
    )
