"""Many eyes at once: throughput of a batch over that of the same eyes one after another, in one run and in turns.

32 eyes of one chamber that differ in IOP, puff and thickness. One after another: each set up and run alone by
`Simulation`, as a script would, its node cloud given. At once: one `Batch`, its clouds given. Set-ups are timed apart:
over a whole puff they are 1 % of an eye's time or less. Of each piece, an eye's run alone or a sample of the batch,
some 0.1 s both, the best of several turns counts. The answers must be the same to the last bit.

What a batch gains: a second core, and Python, which does at a sample for all eyes at once what it does for one. The
smaller the eye, the larger Python's share: hence the three sizes.
"""

import time

import numpy as np

from taichi_eye import backend
from taichi_eye.bench.rows import at_least, at_most, figure
from taichi_eye.scene import load_scene
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

EYES = 32
ASKED = 1.8
# name, keys, simulated time [ms]
SIZES = (
    ("default eyes", (), 0.25),
    ("eyes at h 0.2 mm, c 40", ("spacing_mm=0.2", "sound_speed_m_s=40"), 4.0),
    ("eyes at h 0.25 mm, c 40", ("spacing_mm=0.25", "sound_speed_m_s=40"), 4.0),
)


def scenes_of(keys, duration_ms: float, eyes: int = EYES) -> list:
    """Scenes of one chamber, each another eye under another puff."""
    return [
        load_scene(
            None,
            [
                *(f"numerics.{key}" for key in keys),
                f"numerics.duration_ms={duration_ms}",
                f"eye.iop_mmhg={12 + 12 * share}",
                f"puff.peak_kpa={8 + 5 * share}",
                "puff.duration_ms=24",
                f"cornea.thickness_mm={0.5 + 0.12 * share}",
            ],
        )
        for share in np.linspace(0.0, 1.0, eyes)
    ]


def measure(stage, eyes: int = EYES, turns: int = 5, sizes=SIZES):
    """Throughput ratios for each size of eye, set-up apart, and the largest difference between the answers."""
    rows = []
    for name, keys, duration_ms in sizes:
        scenes = scenes_of(keys, duration_ms, eyes)
        stage(f"{eyes} {name}")
        clouds = [cloud_of(scenes[0])] * eyes
        # compiling
        warm = scenes_of(keys, 0.05, eyes)
        _one_by_one(warm[:1], clouds)
        _at_once(warm, clouds)
        alone, together, set_ups = [], [], []
        for turn in range(turns):
            stage(f"{eyes} {name}, turn {turn + 1} of {turns}")
            set_up_alone, seconds, traces = _one_by_one(scenes, clouds)
            alone.append(seconds)
            set_up, seconds, outcomes = _at_once(scenes, clouds)
            together.append(seconds)
            set_ups.append((set_up_alone, set_up))
        run_alone, run = (np.min(taken, axis=0).sum() for taken in (alone, together))
        set_up_alone, set_up = np.min(set_ups, axis=0)
        note = (
            f"{eyes} eyes of {clouds[0].count} nodes, {duration_ms:g} ms, {backend.threads()} threads, best of {turns}"
        )
        rows.append(at_least(f"{name}: a batch over one after another", run_alone / run, "times", ASKED, note))
        rows.append(
            figure(
                f"{name}: simulated in a batch",
                eyes * duration_ms / run,
                "ms/s",
                f"{eyes * duration_ms / run_alone:.3g} ms/s one after another",
            )
        )
        rows.append(
            figure(
                f"{name}: set-up of an eye in a batch",
                1e3 * set_up / eyes,
                "ms",
                f"{1e3 * set_up_alone / eyes:.3g} ms alone, without packing",
            )
        )
        apart = max(
            np.abs(outcome.traces[column] - values).max()
            for single, outcome in zip(traces, outcomes)
            for column, values in single.items()
        )
        rows.append(at_most(f"{name}: difference between the traces", float(apart), "", 0.0, "any column"))
    return rows, []


def _one_by_one(scenes, clouds):
    """Seconds of all set-ups, of each eye's run, and the traces."""
    set_up, runs, traces = 0.0, [], []
    for scene, cloud in zip(scenes, clouds):
        started = time.perf_counter()
        simulation = Simulation(scene, cloud)
        ready = time.perf_counter()
        traces.append(simulation.run())
        set_up += ready - started
        runs.append(time.perf_counter() - ready)
        del simulation  # its fields are the next one's
    return set_up, runs, traces


def _at_once(scenes, clouds):
    """Seconds of the set-up, of each sample, and what became of each eye."""
    started = time.perf_counter()
    batch = Batch(scenes, clouds)
    ticks = [time.perf_counter()]
    outcomes = batch.run(lambda _: ticks.append(time.perf_counter()))
    ticks.append(time.perf_counter())
    return ticks[0] - started, np.diff(ticks), outcomes
