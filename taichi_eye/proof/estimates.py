"""Estimates of eyes whose pressure is known, because they were made: how far off, and whether the intervals are honest.

The eyes are the scene's with an IOP of 8 to 35 mmHg, a radius of 7.2 to 8.4 mm, a thickness of 480 to 620 um, stiffness
in and out of the plane times 0.6 to 1.6 and a globe's compliance times 0.7 to 1.4, evenly (factors in their logarithm);
one that a guard of the full model stops is drawn anew. Their apices are seen 139 times, 0.2315 ms apart, with 10 um of
noise.

alone    the IOP, all else known
tissue   IOP, stiffness in and out of the plane and the globe's compliance, all else known
puff     the same with a puff wrong by 1.5 % and a thickness wrong by 5 um, both declared
films    IOP and tissue from rendered, noisy, compressed films, the puff known
others   traces by another model than is fitted: no relaxation, other puffs, a membrane; with everything free and the
         model error that is the default. A refusal is honest, so it counts as covered
time     of an eye, the slowest of three, from the start of the search to the last profile, kernels compiled before

RMS is of the estimate less the truth; the bound is that of Cramer and Rao, at the truth, with what is declared. Beside
the intervals that hold the truth stands how many of the best linear estimates of the same data would: what is left of
the two numbers apart is the estimate's own error, what they share is the noise that was drawn.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.bench import bench
from taichi_eye.bench.rows import Row, at_least, at_most, figure
from taichi_eye.errors import FilmError, RunStopped, SceneError
from taichi_eye.estimation import model_error
from taichi_eye.estimation.bounds import FRAMES, INTERVAL_MS, at_truth, best_at_truth
from taichi_eye.estimation.estimate import Estimate, estimate, estimate_many, problem_of
from taichi_eye.estimation.fit import SD_95, Problem
from taichi_eye.estimation.motion import Motion, fine_apices
from taichi_eye.estimation.observation import ApexHistory, of_history
from taichi_eye.estimation.unknowns import (
    GLOBE,
    IN_PLANE,
    IOP,
    OUT_OF_PLANE,
    PUFF,
    RADIUS,
    RETREAT,
    THICKNESS,
    WIDTH,
    beforehand,
    own_values,
    scene_with,
)
from taichi_eye.scene import Scene

EYES, SEED, TIMED = 40, 14, 3
NOISE_MM = 0.010
PUFF_SD, THICKNESS_SD_UM = 0.015, 5.0
EVENLY = {IOP: (8.0, 35.0), RADIUS: (7.2, 8.4), THICKNESS: (480.0, 620.0)}
FACTORS = {IN_PLANE: (0.6, 1.6), OUT_OF_PLANE: (0.6, 1.6), GLOBE: (0.7, 1.4)}
TRIES = 4  # times as many eyes as wanted may be drawn
COVERED, COVERED_OTHERS = 0.9, 0.85
FAR_MMHG, SURE_MMHG = 3.0, 1.0


@dataclass(frozen=True, eq=False)
class Made:
    """An eye that was made, and how its apex moves. truth: by the names of the unknowns."""

    truth: dict[str, float]
    motion: Motion

    def trace(self, name: str, noise: np.random.Generator) -> ApexHistory:
        """Its apex as a camera sees it."""
        time_ms = INTERVAL_MS * np.arange(FRAMES)
        seen = np.interp(time_ms, self.motion.time_ms, self.motion.apex_mm) + NOISE_MM * noise.standard_normal(FRAMES)
        return of_history(name, time_ms, seen, False, NOISE_MM)


def drawn(scene: Scene, chance: np.random.Generator) -> dict[str, float]:
    """An eye of the population."""
    own, found = own_values(scene), {}
    for name, value in own.items():
        if name in EVENLY:
            found[name] = float(chance.uniform(*EVENLY[name]))
        elif name in FACTORS:
            found[name] = float(np.exp(chance.uniform(*np.log(FACTORS[name]))))
        else:
            found[name] = value
    return found


def made(scene: Scene, count: int, seed: int, change: Callable[[Scene, int], Scene] = lambda s, k: s) -> list[Made]:
    """Eyes of the population that run to their end; change: another model of the eye with that number."""
    chance, found, tried = np.random.default_rng(seed), [], 0
    while len(found) < count:
        if tried >= TRIES * count + 8:
            raise SceneError(
                f"of {tried} eyes of the population {len(found)} run to their end: the scene is no study's"
            )
        truths, scenes = [], []
        while len(scenes) < count - len(found):
            tried += 1
            truth = drawn(scene, chance)
            try:
                scenes.append(change(scene_with(scene, truth), len(found) + len(scenes)))
                truths.append(truth)
            except SceneError:
                if tried >= TRIES * count + 8:
                    break
        for truth, motion in zip(truths, fine_apices(scenes)):
            if not motion.stopped:
                found.append(Made(truth, motion))
    return found


@lru_cache(maxsize=2)
def _population(scene: Scene, count: int, seed: int) -> list[Made]:
    return made(scene, count, seed)


@dataclass(frozen=True)
class Outcome:
    """A part's estimates beside the truth: arrays [eyes], NaN where refused; covered: by the 95 % interval; bounds, and
    the estimates that reach them: or None."""

    truth: np.ndarray
    estimate: np.ndarray
    deviation: np.ndarray
    covered: np.ndarray
    refused: int
    bounds: np.ndarray | None = None
    best: np.ndarray | None = None

    @property
    def off(self) -> np.ndarray:
        """Estimate less truth of those that were made."""
        return (self.estimate - self.truth)[np.isfinite(self.estimate)]

    @property
    def rms(self) -> float:
        """Of these."""
        return float(np.sqrt(np.mean(self.off**2))) if len(self.off) else math.nan


def outcome(truths: Sequence[float], found: Sequence, bounds=None, best=None) -> Outcome:
    """Of estimates or refusals."""
    value, deviation, covered = (np.full(len(truths), math.nan) for _ in range(3))
    for k, (truth, one) in enumerate(zip(truths, found)):
        if isinstance(one, Estimate):
            iop = one[IOP]
            value[k], deviation[k] = iop.value, iop.deviation
            covered[k] = iop.range95[0] <= truth <= iop.range95[1]
    refused = int(np.isnan(value).sum())
    bounds, best = (None if one is None else np.array(one) for one in (bounds, best))
    return Outcome(np.array(truths), value, deviation, covered, refused, bounds, best)


def coverage(found: Outcome, least: float) -> Row:
    """How many intervals hold the truth, a refusal among them only where `least` is that of other models."""
    count = len(found.truth)
    held = int(np.nansum(found.covered)) + (found.refused if least == COVERED_OTHERS else 0)
    wanted = math.floor(least * count)
    note = f"{found.refused} refused"
    if found.best is not None:
        ideal = int((np.abs(found.best - found.truth) <= SD_95 * found.bounds).sum())
        apart = np.sqrt(np.nanmean(((found.estimate - found.best) / found.bounds) ** 2))
        note += (
            f"; the best linear estimates of the same noise hold it in {ideal}, and lie {apart:.2g} standard "
            "deviations away (rms)"
        )
    return at_least(f"95 % intervals that hold the truth, of {count}", held, "", wanted, note)


def measure(scene: Scene, count: int, seed: int, part: str, stage: Callable[[str], None]) -> tuple[list[Row], list]:
    """The rows of a part, over so many eyes."""
    return {"alone": _alone, "tissue": _tissue, "puff": _puff, "films": _films, "others": _others, "time": _time}[part](
        scene, count, seed, stage
    )


def _known(truth: dict[str, float], *free: str) -> dict[str, float]:
    return {name: value for name, value in truth.items() if name != IOP and name not in free}


def _solved(eyes: Sequence[Made], problems: Sequence[Problem], stage) -> Outcome:
    found = estimate_many(problems, stage)
    bounds = [at_truth(problem, eye.truth) for problem, eye in zip(problems, eyes)]
    best = [best_at_truth(problem, eye.truth, eye.motion) for problem, eye in zip(problems, eyes)]
    return outcome([eye.truth[IOP] for eye in eyes], found, bounds, best)


def _rows(found: Outcome, rms: float | None, over_bound: float | None) -> list[Row]:
    note = f"median claimed SD {np.nanmedian(found.deviation):.2g} mmHg, mean error {found.off.mean():+.2g} mmHg"
    rows = [
        at_most("RMS of the IOP", found.rms, "mmHg", rms, note)
        if rms
        else figure("RMS of the IOP", found.rms, "mmHg", note)
    ]
    predicted = float(np.sqrt(np.mean(found.bounds[np.isfinite(found.estimate)] ** 2)))
    text = f"bound {predicted:.3g} mmHg"
    share = found.rms / predicted
    rows.append(
        at_most("RMS over the bound", share, "", over_bound, text)
        if over_bound
        else figure("RMS over the bound", share, "", text)
    )
    return [*rows, coverage(found, COVERED)]


def _alone(scene, count, seed, stage):
    stage("eyes")
    eyes, noise = _population(scene, count, seed), np.random.default_rng(seed + 1)
    problems = [
        problem_of(eye.trace(f"eye {k}", noise), scene, _known(eye.truth), model_error_um=0.0)
        for k, eye in enumerate(eyes)
    ]
    found = _solved(eyes, problems, stage)
    return _rows(found, 0.2, None), [_draw("IOP alone", found)]


def _tissue(scene, count, seed, stage):
    stage("eyes")
    eyes, noise = _population(scene, count, seed), np.random.default_rng(seed + 2)
    problems = [
        problem_of(eye.trace(f"eye {k}", noise), scene, _known(eye.truth, *FACTORS), model_error_um=0.0)
        for k, eye in enumerate(eyes)
    ]
    found = _solved(eyes, problems, stage)
    return _rows(found, 0.4, 1.5), [_draw("IOP and tissue", found)]


def _puff(scene, count, seed, stage):
    stage("eyes")
    chance = np.random.default_rng(seed + 3)
    wrong = np.exp(PUFF_SD * chance.standard_normal(TRIES * count + 8))

    def change(eye: Scene, number: int) -> Scene:
        return eye.but({"puff.peak_kpa": eye.puff.peak_kpa * float(wrong[number])})

    eyes = made(scene, count, seed + 4, change)
    problems = []
    for number, eye in enumerate(eyes):
        factor = eye.motion.scene.puff.peak_kpa / scene.puff.peak_kpa
        eye.truth[PUFF] = factor
        known = _known(eye.truth, *FACTORS, PUFF, THICKNESS) | {
            PUFF: (1.0, PUFF_SD),
            THICKNESS: (eye.truth[THICKNESS] + THICKNESS_SD_UM * chance.standard_normal(), THICKNESS_SD_UM),
        }
        problems.append(problem_of(eye.trace(f"eye {number}", chance), scene, known, model_error_um=0.0))
    found = _solved(eyes, problems, stage)
    return _rows(found, None, 1.3), [_draw("puff and thickness declared", found)]


def _films(scene, count, seed, stage):
    from taichi_eye.pipeline import run

    chance, truths, found = np.random.default_rng(seed + 5), [], []
    filmed = scene.but({"camera.view": "scheimpflug"})
    tried = 0
    with tempfile.TemporaryDirectory() as folder:
        while len(truths) < count and tried < TRIES * count + 8:
            tried += 1
            truth = drawn(filmed, chance)
            try:
                stage(f"film {len(truths) + 1} of {count}")
                eye = scene_with(filmed, truth).but({"camera.seed": seed + tried})
                run(eye, Path(folder) / f"eye{tried}", progress=False)
            except (SceneError, RunStopped):
                continue
            truths.append(truth[IOP])
            film = Path(folder) / f"eye{tried}.mp4"
            (Path(folder) / f"eye{tried}" / "film.mp4").rename(film)
            try:
                found.append(estimate(film, scene, {PUFF: 1.0, WIDTH: 1.0}, model_error_um=0.0, tell=stage))
            except (SceneError, FilmError) as refusal:
                found.append(refusal)
    result = outcome(truths, found)
    note = f"median claimed SD {np.nanmedian(result.deviation):.2g} mmHg, mean error {result.off.mean():+.2g} mmHg"
    rows = [at_most("RMS of the IOP, from films", result.rms, "mmHg", 0.5, note), coverage(result, COVERED)]
    return rows, [_draw("from films", result)]


def others_of(scene: Scene) -> dict[str, dict]:
    """Changes that make another model of a scene's eye; those that the scene has no part of are left out."""
    found = {}
    if scene.cornea.viscoelastic_share:
        found["no relaxation"] = {"cornea.viscoelastic_share": 0.0}
    if scene.puff.radial_profile == "gaussian":
        rate = (scene.cornea.radius_mm / scene.puff.width_mm) ** 2
        found["the paper's radial profile"] = {"puff.radial_profile": "paper", "puff.spread_a": rate}
    found["a wider puff"] = (
        {"puff.width_mm": 1.1 * scene.puff.width_mm}
        if scene.puff.radial_profile == "gaussian"
        else {"puff.spread_a": scene.puff.spread_a / 1.21}
    )
    other = "gaussian" if scene.puff.time_course == "corvis" else "corvis"
    found["another time course"] = {"puff.time_course": other}
    if scene.cornea.flexural_modulus_mpa or scene.cornea.shear_modulus_kpa:
        found["a membrane"] = {
            "cornea.flexural_modulus_mpa": 0.0,
            "cornea.shear_modulus_kpa": 0.0,
            "cornea.stiffness_a_pa": "auto",
            "cornea.exponent_k": "auto",
            "cornea.exponent_s": "auto",
            "cornea.prestrain": "auto",
        }
    return found


def _others(scene, count, seed, stage):
    stage("eyes")
    kinds, eyes, labels = others_of(scene), [], []
    share = -(-count // len(kinds))
    for number, (label, changes) in enumerate(kinds.items()):
        wanted = min(share, count - len(eyes))
        try:
            more = made(scene, wanted, seed + 20 + number, lambda eye, k: eye.but(changes)) if wanted else []
        except SceneError:
            continue  # no such eye runs to its end
        eyes += more
        labels += [label] * len(more)
    noise = np.random.default_rng(seed + 6)
    problems = [problem_of(eye.trace(f"{label} {k}", noise), scene) for k, (eye, label) in enumerate(zip(eyes, labels))]
    found = estimate_many(problems, stage)
    result = outcome([eye.truth[IOP] for eye in eyes], found)
    sure = (np.abs(result.estimate - result.truth) > FAR_MMHG) & (result.deviation < SURE_MMHG)
    note = (
        f"RMS {result.rms:.2g} mmHg, median claimed SD {np.nanmedian(result.deviation):.2g} mmHg"
        if len(result.off)
        else "all refused"
    )
    rows = [
        coverage(result, COVERED_OTHERS),
        _not_refused(result, found, labels),
        at_most("more than 3 mmHg off with a claimed SD below 1", int(sure.sum()), "", 0, note),
    ]
    return rows, [_draw("made by another model", result)] if len(result.off) else []


def _not_refused(result: Outcome, found: Sequence, labels: Sequence[str]) -> Row:
    """How many eyes of other models have an estimate, and how many of these are right, by the model."""
    made_of = {label: [k for k, one in enumerate(labels) if one == label] for label in dict.fromkeys(labels)}
    said = []
    for label, eyes in made_of.items():
        estimated = [k for k in eyes if isinstance(found[k], Estimate)]
        right = int(result.covered[estimated].sum())
        said.append(f"{label}: {right} right of {len(estimated)}, {len(eyes) - len(estimated)} refused")
    estimates = [one for one in found if isinstance(one, Estimate)]
    widened = sum(one.widened > 1.0 for one in estimates)
    note = f"{int(np.nansum(result.covered))} hold the truth, {widened} by an enlarged model error; {'; '.join(said)}"
    return figure(f"of {len(found)} eyes, estimated", len(estimates), "", note)


def _time(scene, count, seed, stage):
    eyes, noise, rows = _population(scene, TIMED, seed), np.random.default_rng(seed + 7), []
    seen = [eye.trace(f"eye {k}", noise) for k, eye in enumerate(eyes)]
    stage("kernels")
    estimate(seen[0], scene, _known(eyes[0].truth), model_error_um=0.0)  # compiled
    for label, limit in (("IOP alone", 10.0), ("everything free", 60.0)):
        took = []
        for eye, trace in zip(eyes, seen):
            stage(f"{label}, {trace.name}")
            known = _known(eye.truth)
            if label != "IOP alone":
                known = {name: value for name, value in known.items() if name == RETREAT}
            started, used = time.perf_counter(), time.process_time()
            found = estimate(trace, scene, known, model_error_um=0.0)
            took.append((time.perf_counter() - started, time.process_time() - used, found))
        wall, used, found = max(took, key=lambda one: one[0])
        rest = ", ".join(f"{one[0]:.1f}" for one in sorted(took, key=lambda one: one[0])[:-1])
        note = (
            f"the slowest of {len(took)}, the others {rest} s; {found.rounds} runs of {found.rung}, {found.runs} cheap "
            f"ones; processor time {used:.1f} s"
        )
        rows.append(at_most(f"time of an eye, {label}", wall, "s", limit, note))
    return rows, []


PARTS = "alone", "tissue", "puff", "films", "others", "time"


def report(
    scene: Scene,
    only: Sequence[str] = (),
    count: int = EYES,
    seed: int = SEED,
    out=None,
    json_file=None,
    progress: bool = True,
) -> bool:
    """Measure the parts named (all without names), print the table, write the page; whether all that is asked holds."""
    problem_of(of_history("", INTERVAL_MS * np.arange(FRAMES), np.zeros(FRAMES), False, 1.0), scene, model_error_um=0.0)
    beforehand(scene, {})
    model_error.of_scene(scene)

    def part(name):
        def run(stage):
            return measure(scene, count, seed, name, stage)

        return run

    parts = {name: part(name) for name in PARTS}
    return bench.report(only or PARTS, out, json_file, parts=parts, command="estimates", progress=progress)


def _draw(title: str, found: Outcome) -> Figure:
    """Errors with their 95 % intervals over the true IOP."""
    canvas = Figure(figsize=(7.0, 4.2), dpi=110, layout="constrained")
    axes = canvas.subplots()
    good = np.isfinite(found.estimate)
    off, width = (found.estimate - found.truth)[good], SD_95 * found.deviation[good]
    inside = found.covered[good] > 0.0
    for which, colour, label in ((inside, "#14539a", "interval holds the truth"), (~inside, "#b03a48", "does not")):
        axes.errorbar(
            found.truth[good][which],
            off[which],
            width[which],
            fmt="o",
            markersize=4,
            color=colour,
            linewidth=1.0,
            label=label,
        )
    axes.axhline(0.0, color="#22262b", linewidth=0.7)
    axes.set(title=title, xlabel="true IOP (mmHg)", ylabel="estimate less truth (mmHg), 95 %")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    return canvas
