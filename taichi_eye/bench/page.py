"""The live pages in a real browser: from the hand to the picture, and what watching costs a run.

`taichi-eye play corvis_healthy`, one of two eyes dragged through its pressure, to and fro, DRAGS times. The page
measures by its own clock: from a slider's event to the frame being drawn, and from letting go to the last frame of the
whole film, its history and its parameters. Then `taichi-eye run` on the quick scene, in turns without and with --watch
and a page open: CPU seconds are what watching can cost, wall seconds what it did; both are least of RUNS. The first
picture is timed from the moment in which the run had drawn it to the page having drawn it.

A film under the hand takes, in CPU time on two cores of a Xeon: the run 55 ms, 139 frames 170 ms on both, and beside
them the parameters 20 ms and 16 MB through the socket.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path
from statistics import median

from taichi_eye.bench.browser import Tab, browser, drag, missing, served, settled
from taichi_eye.bench.rows import at_most, figure, skipped

DRAGS, STEPS, RUNS = 9, 8, 3
FRAME_MS, FILM_MS, PICTURE_S, MORE = 50.0, 300.0, 2.0, 0.05
QUICK = "run", "quick", "--quiet"


def measure(stage):
    """Medians under the hand, and a run with and without a page."""
    if reason := missing():
        return [skipped("live pages", reason, f"<= {FRAME_MS:g} ms")], []
    with tempfile.TemporaryDirectory() as work, browser() as one:
        stage("an eye under the hand")
        timings = _under_the_hand(one, work)
        alone, watched, late = [], [], []
        for turn in range(RUNS + 1):  # the first fills the kernel cache
            stage(f"watching, {turn + 1} of {RUNS + 1}")
            alone.append(_run(work, f"alone{turn}"))
            took, first = _watched(one, work, f"watched{turn}")
            watched.append(took)
            late.append(first)
    busy = f"load of the machine {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    wall, cpu = (min(took[k] for took in watched[1:]) / min(took[k] for took in alone[1:]) - 1.0 for k in (0, 1))
    return [
        at_most(
            "dragging, hand to frame, median", median(timings["frame"]), "ms", FRAME_MS,
            f"{len(timings['frame'])} frames, by the page's clock, {busy}",
        ),
        at_most(
            "let go, hand to whole film, median", median(timings["film"]), "ms", FILM_MS,
            f"{len(timings['film'])} films of 139 frames, by the page's clock, {busy}",
        ),
        figure("  slowest frame", max(timings["frame"]), "ms"),
        figure("  slowest film", max(timings["film"]), "ms"),
        at_most("first picture behind the run's own first frame", max(late), "s", PICTURE_S, "page open before"),
        at_most("watched run over one that is not, more CPU time", cpu, "", MORE, f"quick scene, least of {RUNS}"),
        figure("  more wall time", wall, "", busy),
    ], []  # fmt: skip


def _under_the_hand(one, work) -> dict[str, list[float]]:
    with served("play", "corvis_healthy", cwd=work) as (url, _):
        tab = Tab(one, url)
        number = settled(tab)
        for turn in range(DRAGS + 1):
            if turn == 1:  # the first has warmed everything up
                tab.page.evaluate("(() => { timings.frame.length = timings.film.length = 0; })()")
            drag(tab, "iop", (-1) ** turn * 0.12, steps=STEPS)
            number = settled(tab, number)
        found = tab.page.evaluate("timings")
        tab.page.close()
    return found


def _run(work, name: str) -> tuple[float, float]:
    """Wall and CPU seconds of a run that nobody watches."""
    import subprocess
    import sys

    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    path = str(Path(__file__).parents[2])
    subprocess.run(
        [sys.executable, "-m", "taichi_eye", *QUICK, "--out", name],
        cwd=work, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    return time.perf_counter() - began, _cpu(before)


def _cpu(before) -> float:
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime


def _watched(one, work, name: str) -> tuple[tuple[float, float], float]:
    """The same with a page open, and how late its first picture was [s]."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with served(*QUICK, "--watch", "--out", name, cwd=work) as (url, process):
        tab = Tab(one, url)
        tab.page.wait_for_selector("body[data-state=complete]")
        late = float(tab.page.evaluate("document.body.dataset.late"))
        tab.page.close()
        process.wait()
    return (time.perf_counter() - began, _cpu(before)), late
