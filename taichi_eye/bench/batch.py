"""Many eyes at once: throughput of a batch over that of the same eyes one after another, in one run and in turns.

32 eyes of one chamber that differ in IOP, puff and thickness. One after another: each set up and run alone by `Simulation`,
as a script would, its node cloud given. At once: one `Batch`, its clouds given. Both times hold set-up and run. The answers
must be the same to the last bit.

What a batch gains: a second core, and Python, which does at a sample for all eyes at once what it does for one. The smaller
the eye, the larger Python's share: hence the three sizes.
"""
import numpy as np

from taichi_eye import backend
from taichi_eye.bench.rows import at_least, at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.simulation import Simulation, cloud_of

EYES = 32
ASKED = 1.8
# name, keys, simulated time [ms]
SIZES = (("default eyes", (), 0.5), ("eyes at h 0.2 mm, c 40", ("spacing_mm=0.2", "sound_speed_m_s=40"), 4.0),
         ("eyes at h 0.25 mm, c 40", ("spacing_mm=0.25", "sound_speed_m_s=40"), 4.0))


def scenes_of(keys, duration_ms: float, eyes: int = EYES) -> list:
    """Scenes of one chamber, each another eye under another puff."""
    return [load_scene(None, [*(f"numerics.{key}" for key in keys), f"numerics.duration_ms={duration_ms}",
                              f"eye.iop_mmhg={12 + 12 * share}", f"puff.peak_kpa={8 + 5 * share}", "puff.duration_ms=24",
                              f"cornea.thickness_mm={0.5 + 0.12 * share}"]) for share in np.linspace(0.0, 1.0, eyes)]


def measure(stage, eyes: int = EYES, turns: int = 3, sizes=SIZES):
    """Throughput ratios for each size of eye, and the largest difference between the answers."""
    rows = []
    for name, keys, duration_ms in sizes:
        scenes = scenes_of(keys, duration_ms, eyes)
        stage(f"{eyes} {name}")
        clouds = [cloud_of(scenes[0])] * eyes
        alone, together = [], []

        def one_by_one():
            alone[:] = [Simulation(scene, cloud).run() for scene, cloud in zip(scenes, clouds)]

        def at_once():
            together[:] = Batch(scenes, clouds).run()

        # compiling
        warm = scenes_of(keys, 0.05, eyes)
        Simulation(warm[0], clouds[0]).run()
        Batch(warm, clouds).run()
        took = best_of({"one by one": one_by_one, "at once": at_once}, turns)
        note = f"{eyes} eyes of {clouds[0].count} nodes, {duration_ms:g} ms, {backend.threads()} threads, best of {turns}"
        rows.append(at_least(f"{name}: a batch over one after another", took["one by one"] / took["at once"], "times", ASKED,
                             note))
        rows.append(figure(f"{name}: simulated in a batch", eyes * duration_ms / took["at once"], "ms/s",
                           f"{eyes * duration_ms / took['one by one']:.3g} ms/s one after another"))
        apart = max(np.abs(outcome.traces[column] - values).max() for traces, outcome in zip(alone, together)
                    for column, values in traces.items())
        rows.append(at_most(f"{name}: difference between the traces", float(apart), "", 0.0, "any column"))
    return rows, []
