"""`taichi-eye check scenes`: scenes drawn at random, put to the loader and to the solver.

extremes  scenes with some keys at the ends of what they may be, through the loader: a scene, or one refusal
runs      accepted ones of them, each run in a process of its own: its end is a result, a stop with its reason or a
          refusal, and it takes no more memory than `taichi_eye.scene.budget` says
pairs     eyes and numerics drawn within reason, each again at half the spacing and twice the speed of sound: where the
          apex moves by more than 5 % of its peak, the first run must have warned
calls     `taichi_eye.run` again and again in one process, ever another camera: memory stays after the first tens
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.bench import bench
from taichi_eye.bench.rows import Row, at_most, figure, skipped
from taichi_eye.errors import SceneError
from taichi_eye.ladder.trial import Trial, run_scene
from taichi_eye.pipeline import run
from taichi_eye.scene import Scene, dump_scene, load_scene
from taichi_eye.scene.budget import memory
from taichi_eye.scene.draft import written
from taichi_eye.scene.schema import Key, all_keys
from taichi_eye.solver.case import case_of
from taichi_eye.solver.doubts import doubts

SEED = 5
EXTREMES, RUNS, PAIRS, CALLS = 20_000, 300, 60, 1000
KEYS_MOST = 6
PATIENCE_S = 120.0  # of a run's own time on the processor, and HANGS times as long by the clock
HANGS = 10.0
CHANGE, KEPT_ALL = 0.05, 1.05
FIRST_CALLS = 50
# numbers evenly between two ends, choices of a list
WITHIN_REASON = {
    "eye.iop_mmhg": (8.0, 35.0),
    "cornea.radius_mm": (7.0, 8.6),
    "cornea.limbus_radius_mm": (4.5, 6.0),
    "cornea.thickness_mm": (0.45, 0.65),
    "cornea.stiffness_a_pa": (30.0, 300.0),
    "cornea.density_kg_m3": (1000.0, 1300.0),
    "cornea.flexural_modulus_mpa": [0.0, 0.02, 0.3],
    "cornea.shear_modulus_kpa": [0.0, 10.0, 30.0],
    "cornea.viscoelastic_share": [0.0, 0.3],
    "chamber.depth_mm": (2.2, 4.0),
    "chamber.compliance_mm3_mmhg": [0.0, 0.1, 1.0],
    "chamber.sealed": [True, True, False],
    "aqueous.viscosity_mpa_s": (0.5, 5.0),
    "puff.peak_kpa": (2.0, 14.0),
    "puff.duration_ms": (2.0, 30.0),
    "puff.time_course": ["paper", "corvis"],
    "puff.dent_feedback": [0.0, 0.4],
    "numerics.spacing_mm": (0.2, 0.45),
    "numerics.sound_speed_m_s": (15.0, 60.0),
    "numerics.cfl": (0.4, 0.8),
    "numerics.basis": ["quadratic", "cubic"],
    "numerics.fidelity": ["mfpm", "mfpm", "added_mass", "cavity", "membrane"],
}
TABLE = {name: (kind, spec) for name, kind, spec in all_keys() if name != "puff.file"}


def at_an_end(kind: type, spec: Key, random: np.random.Generator):
    """A value that a key allows on its own, more often than not the first or the last."""
    if spec.choices:
        return str(random.choice(spec.choices))
    if kind is bool:
        return bool(random.integers(2))
    if kind is str:
        return ""
    low = spec.at_least if spec.at_least is not None else -1e9
    high = spec.at_most if spec.at_most is not None else math.nextafter(spec.below, -math.inf)
    if kind is int:
        return int(random.choice([low, low + 1, high - 1, high, random.integers(low, high + 1)]))
    inner = math.nextafter(low, math.inf) if low else sys.float_info.min
    # evenly in the value or, where it may be small, in its logarithm
    within = random.uniform(low, high)
    if low >= 0.0:
        within = float(np.exp(random.uniform(np.log(max(low, 1e-9 * high)), np.log(high))))
    return float(random.choice([low, inner, math.nextafter(high, -math.inf), high, within, within]))


def extreme_words(random: np.random.Generator) -> list[str]:
    """Overrides of a few keys."""
    names = random.choice(list(TABLE), int(random.integers(1, KEYS_MOST + 1)), replace=False)
    return [f"{name}={written(at_an_end(*TABLE[name], random))}" for name in names]


def extremes(stage, scenes: int = EXTREMES, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Put so many scenes to the loader."""
    random, accepted, broken = np.random.default_rng(seed), 0, []
    for k in range(scenes):
        if k % 100 == 0:
            stage(f"{k} of {scenes}")
        words = extreme_words(random)
        try:
            accepted += load_scene(None, words) is not None
        except SceneError:
            continue
        except Exception as error:  # what this study looks for
            broken.append(f"{' '.join(words)}: {type(error).__name__}: {error}")
    note = _first(broken, f"{accepted} of {scenes} accepted")
    return [at_most("tracebacks of the loader", len(broken), "scenes", 0, note)], []


def runs(stage, count: int = RUNS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Run so many scenes that the loader accepts."""
    random, ends, broken, over, largest = np.random.default_rng(seed), {}, [], [], 0.0
    while sum(ends.values()) < count:
        words = extreme_words(random)
        try:
            scene = load_scene(None, words)
        except SceneError:
            continue
        stage(f"{sum(ends.values()) + 1} of {count}: {' '.join(words)}"[:100])
        end, took = _ended(scene)
        ends[end] = ends.get(end, 0) + 1
        if end not in ("complete", "stopped", "refused", "not through"):
            broken.append(f"{' '.join(words)}: {end}")
        if took is not None:
            share = took / sum(memory(scene.values()).values())
            largest = max(largest, share)
            if share > 1.0:
                over.append(f"{' '.join(words)}: {took / 1e6:.0f} MB, {share:.2f} times")
    note = ", ".join(f"{number} {end}" for end, number in ends.items())
    memory_row = "runs over the memory that they announce"
    return [
        at_most("ends without a reason", len(broken), "runs", 0, _first(broken, note)),
        at_most(memory_row, len(over), "runs", 0, _first(over, f"at most {largest:.2f} times"))
        if largest
        else skipped(memory_row, "this system does not tell it", "<= 0"),
        figure(f"not through within {PATIENCE_S:g} s of processor time", ends.get("not through", 0), "runs"),
    ], []


def _ended(scene: Scene) -> tuple[str, float | None]:
    """How a scene's run ends, and the most memory that it held [bytes], None where it is not told."""
    # what encodes the film of a run that was ended writes for a moment longer
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(dump_scene(scene), encoding="utf-8")
        words = ["run", str(path), "--out", str(Path(folder) / "out"), "--quiet", "--threads", "1"]
        with open(Path(folder) / "said", "w+", encoding="utf-8") as said:
            command = [sys.executable, "-m", "taichi_eye", *words]
            process = subprocess.Popen(command, stdout=said, stderr=said, preexec_fn=_patient)
            until, took, status = time.monotonic() + HANGS * PATIENCE_S, None, None
            while status is None and time.monotonic() < until:
                time.sleep(0.02)
                if hasattr(os, "wait4"):
                    done, code, usage = os.wait4(process.pid, os.WNOHANG)
                    if done:
                        process.returncode = status = os.waitstatus_to_exitcode(code)
                        took = usage.ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
                else:
                    status = process.poll()
            if status is None:
                process.kill()
                process.wait()
                return "hung", None
            if status == TOO_LONG:
                return "not through", None
            said.seek(0)
            text = said.read()
    end = {0: "complete", 1: "stopped", 2: "refused"}.get(status, f"status {status}")
    if "Traceback" in text or end == "stopped" and "stopped at" not in text:
        end = f"status {status}: {(text.strip().splitlines() or [''])[-1][:200]}"
    return end, took


# a run that takes more than its share of the processor ends by a signal of its own; not on Windows
TOO_LONG = -getattr(signal, "SIGXCPU", math.inf)


def _limit_time() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (int(PATIENCE_S), resource.RLIM_INFINITY))


_patient = _limit_time if hasattr(signal, "SIGXCPU") else None


def reasonable_words(random: np.random.Generator) -> list[str]:
    """Overrides of all keys of WITHIN_REASON."""
    found = []
    for name, range_ in WITHIN_REASON.items():
        value = range_[int(random.integers(len(range_)))] if isinstance(range_, list) else random.uniform(*range_)
        found.append(f"{name}={written(value)}")
    return found


def pairs(stage, count: int = PAIRS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Run so many scenes, each a second time with finer numerics."""
    random, changes, silent, warned, stopped = np.random.default_rng(seed), [], [], 0, 0
    number = 0
    while number < count:
        words = reasonable_words(random)
        try:
            scene = load_scene(None, words)
            finer = {
                "numerics.spacing_mm": 0.5 * scene.numerics.spacing_mm,
                "numerics.sound_speed_m_s": 2.0 * scene.numerics.sound_speed_m_s,
            }
            fine_scene = scene.but(finer)
        except SceneError:
            continue
        number += 1
        stage(f"{number} of {count}")
        first = run_scene(scene)
        if first.stop is not None:
            stopped += 1
            continue
        fine = run_scene(fine_scene)
        change = _change(first, fine)
        changes.append(change)
        if change > CHANGE:
            if doubts(case_of(scene), first.traces):
                warned += 1
            else:
                silent.append(f"{100 * change:.1f} %: {' '.join(words)}")
    held = [100.0 * value for value in changes if np.isfinite(value)]
    note = f"{len(changes)} pairs, {warned} over it with a warning; {stopped} first runs stopped with their reason"
    rows = [
        at_most(f"silent changes over {100 * CHANGE:g} % of the apex", len(silent), "scenes", 0, _first(silent, note)),
        figure("median change", float(np.median(held)) if held else math.nan, "% of the peak", note),
    ]
    canvas = Figure(figsize=(7.0, 3.5), dpi=110, layout="constrained")
    axes = canvas.subplots()
    axes.hist(np.clip(held, 1e-3, 1e2), bins=np.geomspace(1e-3, 1e2, 31), color="#14539a")
    axes.axvline(100.0 * CHANGE, color="#b03a48")
    axes.set(xscale="log", xlabel="largest change of the apex history, % of its peak", ylabel="scenes")
    return rows, [canvas]


def _change(first: Trial, fine: Trial) -> float:
    """Largest change of the apex over the peak, as far as the finer run came; infinite where that is not half way."""
    end = fine.traces["time_ms"][-1]
    time_ms, apex = first.traces["time_ms"], first.traces["apex_displacement_mm"]
    reached = time_ms <= end
    peak = np.abs(apex).max()
    if not peak > 0.0 or end < 0.5 * time_ms[-1]:
        return math.inf if peak > 0.0 else 0.0
    finer = np.interp(time_ms[reached], fine.traces["time_ms"], fine.traces["apex_displacement_mm"])
    return float(np.abs(finer - apex[reached]).max() / peak)


def calls(stage, count: int = CALLS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Call `taichi_eye.run` so many times."""
    name = "memory after all calls over that after the first"
    try:
        import resource  # not on Windows
    except ImportError:
        return [skipped(name, "this system does not tell it", f"<= {KEPT_ALL:g}")], []
    random, held, first = np.random.default_rng(seed), [], min(FIRST_CALLS, count // 2)
    for k in range(count):
        stage(f"{k + 1} of {count}")
        column = 16 * int(random.integers(4, 18))
        words = [
            "numerics.spacing_mm=0.4",
            "numerics.duration_ms=3",
            f"camera.width_px={2 * column}",
            f"camera.apex_column_px={column}",
            f"camera.height_px={16 * random.integers(6, 13)}",
            f"camera.view={random.choice(['scheimpflug', 'particles', 'both'])}",
            f"numerics.fidelity={random.choice(['cavity', 'membrane', 'mfpm', 'added_mass'])}",
            f"numerics.sound_speed_m_s={random.uniform(12.0, 20.0)}",
        ]
        with tempfile.TemporaryDirectory() as folder:
            run(load_scene(None, words), Path(folder) / "out", progress=False)
        held.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    note = f"{count} calls; the first {first}: {held[first - 1] / 1e3:.0f} MB, all: {held[-1] / 1e3:.0f} MB"
    canvas = Figure(figsize=(7.0, 3.0), dpi=110, layout="constrained")
    axes = canvas.subplots()
    axes.plot(np.arange(1, count + 1), np.array(held) / 1e3, color="#14539a")
    axes.set(xlabel="calls", ylabel="most memory so far (MB)", ylim=(0, None))
    return [at_most(name, held[-1] / held[first - 1], "times", KEPT_ALL, note)], [canvas]


def _first(found: list[str], otherwise: str) -> str:
    return "; ".join(found[:3])[:400] or otherwise


PARTS = {"extremes": extremes, "runs": runs, "pairs": pairs, "calls": calls}


def report(only=(), out: str | None = None, json_file: str | None = None, progress: bool = True) -> bool:
    """Measure the parts named (all without names), print the table, write page and JSON; whether all asked holds."""
    return bench.report(only, out, json_file, parts=PARTS, command="scenes", progress=progress)
