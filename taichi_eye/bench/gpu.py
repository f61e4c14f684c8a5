"""The coupled step on a GPU against the CPU: the same kernels under `--arch cuda`, a table over node counts.

One backend at a time holds Taichi's fields, so the two run one after the other and not in turns. Both take the same
steps of the default eye from rest under the puff's peak; the apex must end in the same place.
"""

from taichi_eye import backend
from taichi_eye.bench.rows import at_most, figure, skipped
from taichi_eye.bench.timing import best_of
from taichi_eye.lang import ti
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation
from taichi_eye.solver.timestep import stable_step
from taichi_eye.units import MM

SPACINGS_MM = 0.1, 0.05, 0.025
STEPS = 100  # in one timed call


def measure(stage, spacings_mm=SPACINGS_MM):
    """Time per coupled step on both backends, their ratio and the difference between their answers, over the
    spacings."""
    threads = backend.threads()
    try:
        backend.init("cuda", "f64")
    except backend.BackendError:
        return [skipped("coupled step, --arch cuda against cpu", "no CUDA device")], []
    finally:
        backend.init("cpu", "f64", threads)
    rows = []
    for spacing in spacings_mm:
        scene = load_scene(None, [f"numerics.spacing_mm={spacing}"])
        stage(f"packing at {spacing:g} mm")
        cloud = cloud_of(scene)
        took, apex = {}, {}
        for arch in ("cpu", "cuda"):
            stage(f"{cloud.count} nodes on {arch}")
            backend.init(arch, "f64", threads)
            took[arch], apex[arch] = _step_time(scene, cloud)
        note = f"{cloud.count} nodes, {STEPS} steps a call, best of 3"
        rows += [figure(f"coupled step at {cloud.count} nodes, {arch}", 1e6 * took[arch], "us", note) for arch in took]
        rows.append(figure(f"cuda is faster at {cloud.count} nodes by", took["cpu"] / took["cuda"], "times", note))
        rows.append(at_most("apex, cuda against cpu", abs(apex["cuda"] - apex["cpu"]) / MM, "mm", 1e-9, note))
    backend.init("cpu", "f64", threads)
    return rows, []


def _step_time(scene, cloud):
    """Seconds per coupled step, and where the apex is after the steps [m]."""
    simulation = Simulation(scene, cloud)
    dt, _ = stable_step(simulation.survey.take(), simulation.case)
    puff = [float(simulation.puff.peak)] * STEPS

    def steps():
        simulation.coupling.advance(puff, dt, dt)
        ti.sync()

    steps()
    took = best_of({"steps": steps}, 3)["steps"] / STEPS
    return took, simulation.survey.take()["apex_place"]
