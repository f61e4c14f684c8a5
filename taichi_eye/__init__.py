"""taichi_eye: mesh-free simulation of the ophthalmic air-puff test, and its film.

    import taichi_eye
    scene = taichi_eye.load_scene("quick", ["eye.iop_mmhg=20"])
    result = taichi_eye.run(scene, out="renders/iop20")
    result.traces["apex_displacement_mm"].max()

`resume` goes on with a run that was cut off. `Simulation` is the coupled solver without film and files, `run_batch` the
same for many scenes at once, `simulation_of` the rung of the ladder that a scene's fidelity asks for. `sweep` runs a
study: a scene as many eyes, into one table. `estimate` goes the other way: from a film or a trace to the pressure and
the tissue of the eye in it. `PointCloud` is the mesh-free operators on points of your own.
"""

from taichi_eye.errors import RunStopped, SceneError  # noqa: E402
from taichi_eye.scene import Scene, dump_scene, load_scene  # noqa: E402

__all__ = [
    "PointCloud",
    "RunResult",
    "RunStopped",
    "Scene",
    "SceneError",
    "Simulation",
    "dump_scene",
    "estimate",
    "init",
    "load_scene",
    "resume",
    "run",
    "run_batch",
    "simulation_of",
    "sweep",
]
__version__ = "0.2.0"


def __getattr__(name):
    # the solver and the renderer load Taichi and matplotlib: only once they are asked for
    if name == "init":
        from taichi_eye.backend import init

        return init
    if name == "Simulation":
        from taichi_eye.solver.simulation import Simulation

        return Simulation
    if name == "PointCloud":
        from taichi_eye.mfpm.points import PointCloud

        return PointCloud
    if name == "simulation_of":
        from taichi_eye.ladder.rungs import simulation_of

        return simulation_of
    if name == "run_batch":
        from taichi_eye.ladder.batches import run_batch

        return run_batch
    if name == "sweep":
        from taichi_eye.studies.sweep import sweep

        return sweep
    if name == "estimate":
        from taichi_eye.estimation.estimate import estimate

        return estimate
    if name in ("run", "resume", "RunResult"):
        from taichi_eye import pipeline

        return getattr(pipeline, name)
    raise AttributeError(f"module 'taichi_eye' has no attribute {name!r}")
