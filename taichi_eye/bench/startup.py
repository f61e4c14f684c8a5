"""From the shell's exec to the first frame of the film, and where the time goes.

`taichi-eye run` on the quick scene (`configs/quick.toml`: h 0.25 mm, c 40 m/s) in processes of their own, each watched
from outside until its first frame is a file. Cold: Taichi's offline cache is an empty folder. Cached: a whole run has
filled it. Then the same stages in one process by its own clock, and a second scene of another size after the first.

What a start consists of, on two cores of an EPYC, in CPU seconds to the first frame: numpy and Taichi 0.3, its start
0.1, scipy's spatial package 0.3, matplotlib's colours 0.1, packing 0.05, kernels 1.5 from the cache and 4.5 without.
Kernels from the cache are not free: Taichi runs its Python front end over each to find its key (see
`taichi_eye.frontend`: a third of a cached start before), and generates machine code from what it finds. Scipy's
interpolation and matplotlib's figures load when something is interpolated or drawn; tables of the film come by one
kernel a view. The time loop, the largest kernel, compiles after the first frame, and apart from the survey: together
they took twice the time. Fields are made for at least 2048 nodes, so that all scenes below share their kernels, in the
cache too. What gained nothing: Python's collector off.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from taichi_eye.bench.rows import at_most, figure

QUICK = "--set", "numerics.spacing_mm=0.25", "--set", "numerics.sound_speed_m_s=40"
COLD_S, CACHED_S = 6.0, 2.5
AGAIN = 0.1  # share of the cold set-up that the second scene may take
PATIENCE_S = 300.0


def measure(stage, cached_runs: int = 4):
    """Times to the first frame, the stages, and the second scene."""
    with tempfile.TemporaryDirectory() as work:
        work = Path(work)
        cold = []
        for run in range(2):
            stage(f"cold start {run + 1} of 2")
            cold.append(_start(work / f"cold{run}", work / f"cache{run}"))
        stage("whole run, filling the cache")
        whole_cold = _start(work / "fill", work / "cache", whole=True)
        sizes = [path.stat().st_size for path in (work / "cache").rglob("*.tic")]
        cached = []
        for run in range(cached_runs):
            stage(f"cached start {run + 1} of {cached_runs}")
            cached.append(_start(work / f"cached{run}", work / "cache"))
        stage("whole run, cached")
        whole = _start(work / "whole", work / "cache", whole=True)
        stage("stages, cold and cached")
        slow = _stages(work / "stages")
        quick = min((_stages(work / "stages") for _ in range(2)), key=lambda found: sum(found.values()))
    (took, busy), (took_cached, busy_cached) = min(cold), min(cached)
    rows = [
        at_most(
            "quick scene, exec to first frame, cold",
            took,
            "s",
            COLD_S,
            f"best of 2, empty kernel cache, {busy:.1f} s of CPU",
        ),
        at_most(
            "quick scene, exec to first frame, cached",
            took_cached,
            "s",
            CACHED_S,
            f"best of {cached_runs}, {busy_cached:.1f} s of CPU",
        ),
    ]
    rows += [
        figure(f"quick scene, whole run, {name}", took, "s", f"to the end of the process, {busy:.1f} s of CPU")
        for name, (took, busy) in (("cold", whole_cold), ("cached", whole))
    ]
    rows.append(figure("kernels in the cache after a run", len(sizes), "", f"{sum(sizes) / 1e6:.1f} MB"))
    rows += [figure(f"  {name}", took, "s", f"cached; cold {slow[name]:.2f} s") for name, took in quick.items()]
    first, second = (slow["solver set-up"] + slow["first sample"], slow["second scene's set-up and first sample"])
    rows.append(
        at_most(
            "second scene of another size over the first, cold",
            second / first,
            "",
            AGAIN,
            "set-up and first sample, same process",
        )
    )
    return rows, []


def _environment(cache):
    # loading the language is one of the stages: not at the head of this module
    from taichi_eye.lang import CACHE_VARIABLE

    room = Path(__file__).parents[2]
    path = os.pathsep.join(filter(None, [str(room), os.environ.get("PYTHONPATH")]))
    return os.environ | {CACHE_VARIABLE: str(cache), "PYTHONPATH": path}


def _start(out, cache, whole: bool = False):
    """Seconds from exec to the first frame's file, or to the end of the process, and its CPU seconds until then."""
    started = time.perf_counter()
    watched = () if whole else ("--set", "output.png_frames=true")
    process = subprocess.Popen(
        [sys.executable, "-m", "taichi_eye", "run", *QUICK, *watched, "--quiet", "--out", str(out)],
        env=_environment(cache),
        stdout=subprocess.DEVNULL,
    )
    try:
        while watched and not any(out.glob("frames/*.png")):
            if process.poll() is not None or time.perf_counter() - started > PATIENCE_S:
                raise RuntimeError(f"taichi-eye run drew no frame (exit status {process.poll()})")
            time.sleep(0.005)
    except BaseException:
        process.kill()
        raise
    if not whole:
        process.kill()
    took = time.perf_counter() - started
    _, _, used = os.wait4(process.pid, 0)
    if whole:
        took = time.perf_counter() - started
    return took, used.ru_utime + used.ru_stime


def _stages(cache):
    said = subprocess.run(
        [sys.executable, "-c", "from taichi_eye.bench import startup; startup.stages()"],
        env=_environment(cache),
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
    return json.loads(said.stdout.splitlines()[-1])


def stages() -> None:
    """Go through a start, stage by stage, and print the seconds of each as JSON; for a process of its own."""
    clock, last = {}, time.perf_counter()

    def lap(name):
        nonlocal last
        now = time.perf_counter()
        clock[name], last = now - last, now

    import numpy as np

    from taichi_eye import backend, pipeline
    from taichi_eye.film import FilmView, FrameState
    from taichi_eye.scene import load_scene
    from taichi_eye.solver.simulation import Simulation

    lap("imports")
    backend.init()
    lap("Taichi's start")
    scene, other = (load_scene(None, [f"numerics.spacing_mm={h}", "numerics.sound_speed_m_s=40"]) for h in (0.25, 0.16))
    cloud = pipeline.cloud_of(scene)
    lap("packing")
    simulation = Simulation(scene, cloud)
    lap("solver set-up")
    view = FilmView(scene)
    lap("film set-up")

    nothing = np.empty(0)

    def draw(simulation, frame):
        if frame == 0:
            view.render(
                FrameState(
                    time_ms=0.0,
                    wall=simulation.cornea.place,
                    wall_count=cloud.wall_count,
                    nodes=simulation.aqueous.place,
                    node_count=cloud.count,
                    pressure=simulation.aqueous.pressure,
                    velocity=simulation.aqueous.velocity,
                    trace_time_ms=nothing,
                    trace_apex_mm=nothing,
                    trace_puff_kpa=nothing,
                )
            )
            lap("first frame")

    def first_sample(name):
        return lambda simulation: lap(name) if simulation.sample == 1 else None

    simulation.run(draw, first_sample("first sample"))
    lap("the rest of the puff, no film")
    del simulation
    cloud = pipeline.cloud_of(other)
    lap("packing the second scene")
    Simulation(other, cloud).run(on_sample=first_sample("second scene's set-up and first sample"))
    print(json.dumps(clock))
