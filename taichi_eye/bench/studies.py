"""Studies: eyes in a study over the same eyes one after another, and two workers of a Dask cluster over one.

The eyes differ in IOP, thickness and puff. A study computes, reads and keeps them with as many workers as there are
threads, its start and its plots included; one after another each is run and read alone with all threads
(`taichi_eye.analysis.simulated.response_of`), as a script would: of some, for all alike. Kernels are compiled before,
by a study of the same eyes that is cut short, and lie in the cache. The cluster is a scheduler and one or two workers
of one thread that are started here, each warmed by a study of its own; the computation of a second one is timed.
"""

import json
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

from taichi_eye import backend
from taichi_eye.analysis.simulated import response_of
from taichi_eye.bench.rows import at_least, at_most, figure, skipped

CAVITY_EYES, FULL_EYES, ALONE, CLUSTER_EYES = 1000, 200, 20, 500
CAVITY_S, FULL_RATIO, CLUSTER_RATIO = 60.0, 1.8, 1.7
CAVITY = {"fidelity": "cavity", "spacing_mm": 0.2}
FULL = {"fidelity": "mfpm", "spacing_mm": 0.25, "sound_speed_m_s": 40.0}


def study_of(numerics: dict, eyes: int) -> dict:
    """A study of eyes that differ in pressure, thickness and puff."""
    return {
        "design": {"kind": "latin_hypercube", "eyes": eyes},
        "set": {"numerics": numerics},
        "vary": {
            "eye.iop_mmhg": {"mean": 15, "sd": 2.5},
            "cornea.thickness_mm": {"mean": 0.55, "sd": 0.031},
            "puff.peak_kpa": {"within_percent": 10},
        },
    }


def measure(stage, cavity_eyes=CAVITY_EYES, full_eyes=FULL_EYES, alone=ALONE, cluster_eyes=CLUSTER_EYES):
    """Rows of the three questions; no figures."""
    missing = [name for name in ("pandas", "pyarrow", "SALib") if find_spec(name) is None]
    if missing:
        return [skipped("studies", f"{', '.join(missing)} not installed")], []
    rows = []
    with tempfile.TemporaryDirectory() as room:
        stage(f"{cavity_eyes} eyes on the cavity rung")
        seconds, _ = _swept(study_of(CAVITY, cavity_eyes), Path(room) / "cavity")
        note = f"{backend.threads()} threads, clinical parameters, table and plots"
        rows.append(at_most(f"{cavity_eyes} eyes, cavity", seconds, "s", CAVITY_S, note))
        stage("mfpm, compiling")
        _swept(study_of({**FULL, "duration_ms": 0.25}, full_eyes), Path(room) / "warm")
        stage(f"{full_eyes} eyes on mfpm")
        seconds, scenes = _swept(study_of(FULL, full_eyes), Path(room) / "full")
        stage(f"{alone} of them one after another")
        response_of(scenes[0])
        started = time.perf_counter()
        for scene in scenes[:alone]:
            response_of(scene)
        each = (time.perf_counter() - started) / alone
        rows.append(
            at_least(
                f"{full_eyes} eyes, mfpm at H 0.25: a study over one after another",
                each * full_eyes / seconds,
                "times",
                FULL_RATIO,
                f"{seconds / full_eyes:.3g} s an eye in the study, {each:.3g} s alone ({alone} eyes)",
            )
        )
        rows += _on_a_cluster(stage, Path(room), cluster_eyes)
    return rows, []


def _swept(study: dict, out: Path, **options):
    """Seconds of a study, those of its computation alone on a cluster, and the scenes of its eyes."""
    from taichi_eye.studies.designs import changes, count, draw
    from taichi_eye.studies.study import load_study
    from taichi_eye.studies.sweep import sweep

    started = time.perf_counter()
    result = sweep(study, out, **(options or {"threads": backend.threads()}))
    seconds = result.summary["wall_clock"]["compute_s"] if options else time.perf_counter() - started
    read = load_study(study)
    design = draw(read)
    return seconds, [read.base.but(changes(design, eye)) for eye in range(count(design))]


def _on_a_cluster(stage, room: Path, eyes: int):
    if find_spec("distributed") is None:
        return [skipped("2 Dask workers of one thread over one", "distributed not installed", f">= {CLUSTER_RATIO}")]
    file, made, taken = room / "scheduler.json", [], {}
    try:
        made.append(
            _dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file)
        )
        patience = time.monotonic() + 60.0
        while not file.exists() or not file.read_text(encoding="utf-8"):
            if time.monotonic() > patience:
                return [skipped("2 Dask workers of one thread over one", "no scheduler came up")]
            time.sleep(0.1)
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        for workers in (1, 2):
            made.append(_dask("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"))
            time.sleep(5.0)
            for turn in ("warm", "timed"):
                stage(f"{workers} Dask workers, {turn}")
                count = eyes if turn == "timed" else 16
                taken[workers], _ = _swept(study_of(CAVITY, count), room / f"{turn}-{workers}", scheduler=address)
    finally:
        for process in reversed(made):
            process.kill()
            process.wait()
    note = f"{eyes} eyes, cavity; {taken[1]:.3g} and {taken[2]:.3g} s start of the workers' processes included"
    return [
        at_least("2 Dask workers of one thread over one", taken[1] / taken[2], "times", CLUSTER_RATIO, note),
        figure("eyes per second, 2 Dask workers", eyes / taken[2], "1/s"),
    ]


def _dask(*words):
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, "-m", "dask", *map(str, words)], **quiet)
