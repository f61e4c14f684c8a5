"""The default scene, full `mfpm`: solver time and apex error, for several spacings and sound speeds.

Time of `Simulation.run` over the scene's 32 ms with the cloud packed and the kernels compiled, no film; error of the
apex peak against 0.959 mm, where two independent methods agree (incompressible potential flow). What is cheapest for a
given error is a soft liquid whose mean pressure is stiff (`taichi_eye.solver.aqueous`, two sound speeds).
"""

from taichi_eye import backend
from taichi_eye.bench.rows import at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

PEAK_MM = 0.959
ERROR, SECONDS = 1.0, 2.0  # %, s
SETTINGS = (0.2, 40, 40), (0.2, 40, 160), (0.25, 20, 100), (0.3, 20, 100)  # h [mm], c, c_m [m/s]
ASKED = 0.3, 20, 100


def measure(stage, settings=SETTINGS, asked=ASKED):
    """Time and error of each setting; asked of the cheapest one."""
    rows = []
    for setting in settings:
        h, c, c_mean = setting
        scene = load_scene(
            None,
            [f"numerics.spacing_mm={h}", f"numerics.sound_speed_m_s={c}", f"numerics.mean_sound_speed_m_s={c_mean}"],
        )
        cloud = cloud_of(scene)
        found = {}

        def run():
            # nothing holds on to it: the next one takes its fields and kernels
            simulation = Simulation(scene, cloud)
            found.update(peak=simulation.run()["apex_displacement_mm"].max(), steps=simulation.steps)

        name = f"h {h:g} mm, c {c:g}, mean {c_mean:g} m/s"
        stage(name)
        run()
        took = best_of({"run": run}, 3)["run"]
        error = 100.0 * abs(found["peak"] / PEAK_MM - 1.0)
        note = f"{cloud.count} nodes, {found['steps']} steps, {backend.threads()} threads"
        if setting == asked:
            rows += [
                at_most(f"default eye, {name}: solver time", took, "s", SECONDS, note + "; 1 s aimed at"),
                at_most(f"default eye, {name}: apex error", error, "%", ERROR),
            ]
        else:
            rows += [
                figure(f"default eye, {name}: solver time", took, "s", note),
                figure(f"default eye, {name}: apex error", error, "%"),
            ]
    return rows, []
