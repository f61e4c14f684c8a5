"""The default scene, full `mfpm`: solver time and apex error, for several spacings and sound speeds, and extrapolated.

Time of `Simulation.run` over the scene's 32 ms with the cloud packed and the kernels compiled, no film; error of the
apex peak against 0.959 mm, where two independent methods agree (incompressible potential flow). What is cheapest for a
given error is a soft liquid whose mean pressure is stiff (`taichi_eye.solver.aqueous`, two sound speeds), and a run of
coarse nodes with its still coarser twin, from which the limit of both is told (`taichi_eye.ladder.twin`): their times
are added.
"""

from taichi_eye import backend
from taichi_eye.bench.rows import at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.ladder.twin import twin_of
from taichi_eye.scene import Scene, load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

PEAK_MM = 0.959
SETTINGS = (0.2, 40, 40), (0.2, 40, 160), (0.25, 20, 100), (0.3, 20, 100), (0.4, 15, 75)  # h [mm], c, c_m [m/s]
QUICK, ERROR, SECONDS = (0.4, 15, 75), 0.6, 0.35  # one run: its setting, error [%] and time asked of it [s]
TWICE, LIMITS_ERROR, BOTH_S = (0.3, 20, 100), 0.1, 1.5  # the same of a run, its twin and their limit
TURNS = 9


def measure(stage, settings=SETTINGS, quick=QUICK, twice=TWICE):
    """Time and error of each setting, asked of one; and of one with its twin, extrapolated."""
    rows = []
    for setting in settings:
        scene, name = _scene(setting), _name(setting)
        stage(name)
        took, peak, note = _timed(scene)
        asked = (SECONDS, ERROR) if setting == quick else None
        rows += _rows(name, took, peak, note, asked)
        if setting == twice:
            twin = twin_of(scene)
            stage(f"the twin of {name}")
            twin_took, twin_peak, _ = _timed(twin.scene)
            limit = peak + twin.share * (peak - twin_peak)
            own = twin.scene.numerics
            note = f"with its twin, h {own.spacing_mm:.3g} mm, c {own.sound_speed_m_s:g} m/s"
            rows += _rows(f"{name}, extrapolated", took + twin_took, limit, note, (BOTH_S, LIMITS_ERROR))
    return rows, []


def _scene(setting) -> Scene:
    h, c, c_mean = setting
    words = [f"numerics.spacing_mm={h}", f"numerics.sound_speed_m_s={c}", f"numerics.mean_sound_speed_m_s={c_mean}"]
    return load_scene(None, words)


def _name(setting) -> str:
    h, c, c_mean = setting
    return f"h {h:g} mm, c {c:g}, mean {c_mean:g} m/s"


def _timed(scene: Scene) -> tuple[float, float, str]:
    """The least time of a run of a scene [s], its apex peak [mm], and its size."""
    cloud, found = cloud_of(scene), {}

    def run():
        # nothing holds on to it: the next one takes its fields and kernels
        simulation = Simulation(scene, cloud)
        found.update(peak=simulation.run()["apex_displacement_mm"].max(), steps=simulation.steps)

    run()
    took = best_of({"run": run}, TURNS)["run"]
    return took, found["peak"], f"{cloud.count} nodes, {found['steps']} steps, {backend.threads()} threads"


def _rows(name: str, took: float, peak: float, note: str, asked: tuple[float, float] | None) -> list:
    error = 100.0 * abs(peak / PEAK_MM - 1.0)
    time, apex = f"default eye, {name}: solver time", f"default eye, {name}: apex error"
    if asked is None:
        return [figure(time, took, "s", note), figure(apex, error, "%")]
    return [at_most(time, took, "s", asked[0], note), at_most(apex, error, "%", asked[1])]
