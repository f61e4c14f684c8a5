"""`taichi-eye fit-clinic SCENE --free KEYS`: a scene's named keys fitted to levels and slopes of living eyes at once.

Least squares (SciPy, trust region) over the logarithms of the free keys, whichever numbers of the scene they are, on
the cavity rung; what the scene's own rung shows otherwise at the start is added to the levels (on `mfpm` a shell snaps
back more gently than on `cavity`: A2 velocity differs by a standard deviation). Residuals: a level's distance from its
judging population's mean in standard deviations; a slope's from the measured one in its standard error, or in a fifth
of it where that is more, so that a factor 1.5 counts as 2.5 (the regression's errors say how well 194 eyes know a
slope, not how well a model is asked to meet it). A round takes one change of each key by STEP for the derivatives; an
evaluation five eyes (`taichi_eye.proof.population.starred`), or the one where no slope is asked for. What an eye does
not show, because a guard stopped it or it does not applanate, counts as a residual of MISSING, and so does every eye
that is stopped: a fit may not win by losing its worst eye.

A fit ends in the minimum nearest to its start, and there may be others: what rings after the snap makes A2 velocity
rise and fall with the bending stiffness of corvis_healthy.toml, so that a fit of levels from a tenth above it may stay
there. Start from more than one place.

The result is a set of overrides, with what the targets know of each key: its standard error with the residuals' scales
taken for errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from tqdm import tqdm

from taichi_eye.analysis.norms import judged_by
from taichi_eye.errors import SceneError
from taichi_eye.eye.eye import refuse_no_puff
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.proof.dcr import SHOWN, slopes_of
from taichi_eye.proof.population import simulate, starred
from taichi_eye.report.folder import write_text
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.draft import CHANGE, Draft
from taichi_eye.scene.schema import all_keys

LEVEL = "level"
STOPPED = "stopped"  # the name of the target that counts stopped eyes
STEP = 0.05  # of the logarithm of a key, for derivatives: what rings after the snap makes smaller ones noisy
REACH = 20.0  # a key may go that factor up and down
SHARE = 0.2  # of a measured slope, the least that its residual is counted in
MISSING = 10.0
TOLERANCE = 1e-4
ROUNDS = 12


@dataclass(frozen=True)
class Target:
    """What a figure ought to be; unit: LEVEL, or that of a slope; scale: that of its residual."""

    name: str
    unit: str
    value: float
    scale: float


@dataclass(frozen=True)
class Fit:
    """What a fit came to: the free keys before and after with the relative standard error of each, every target's
    figure before and after (None where not shown), and half the sum of squares."""

    keys: dict[str, tuple[float, float, float]]
    targets: tuple[Target, ...]
    before: tuple[float | None, ...]
    after: tuple[float | None, ...]
    cost: tuple[float, float]
    rounds: int
    finished: bool


def clinical_targets() -> tuple[Target, ...]:
    """Every level that has a judging population, every measured slope, and no eye stopped."""
    found = []
    for name in SHOWN:
        if judge := judged_by(name):
            found.append(Target(name, LEVEL, judge[1], judge[2]))
    for slope in slopes_of([]):
        scale = max(slope.error or 0.0, 0.0 if slope.measured_zero else SHARE * abs(slope.measured))
        found.append(Target(slope.name, slope.unit, slope.measured, scale))
    return (*found, Target(STOPPED, "eyes", 0.0, 1.0 / MISSING))


def figures(scene: Scene, targets: Sequence[Target], tell: Callable[[], None] = lambda: None) -> list[float | None]:
    """The targets' figures of a scene; tell() after each eye."""
    places = starred(scene)
    if all(target.unit == LEVEL for target in targets):
        places = places[:1]
    eyes = []
    for iop, thickness in places:
        eyes.append(simulate(scene, iop, thickness))
        tell()
    known = {(slope.name, slope.unit): slope.computed for slope in slopes_of(eyes)}
    known[STOPPED, "eyes"] = float(sum(bool(eye.stopped) for eye in eyes))
    own = eyes[0]
    out = []
    for target in targets:
        value = known[target.name, target.unit] if target.unit != LEVEL else None
        if target.unit == LEVEL and not own.stopped:
            value = getattr(own.response, target.name)
        out.append(None if value is None or not np.isfinite(value) else value)
    return out


def levels_beyond(own: Scene, cheap: Scene, targets: Sequence[Target]) -> list[float]:
    """What each level of a scene is on its own rung less that on a cheap one, 0 where either does not show it."""
    if own.numerics.fidelity == cheap.numerics.fidelity:
        return [0.0] * len(targets)
    eyes = [simulate(scene, scene.eye.iop_mmhg, 1e3 * scene.cornea.thickness_mm) for scene in (own, cheap)]
    apart = []
    for target in targets:
        values = [getattr(eye.response, target.name, None) for eye in eyes]
        shown = target.unit == LEVEL and None not in values and not any(eye.stopped for eye in eyes)
        apart.append(values[0] - values[1] if shown else 0.0)
    return apart


def residuals(found: Sequence[float | None], targets: Sequence[Target]) -> np.ndarray:
    """Distances from the targets in their scales."""
    return np.array(
        [MISSING if value is None else (value - target.value) / target.scale for value, target in zip(found, targets)]
    )


def free_keys(scene: Scene, names: Sequence[str]) -> dict[str, float]:
    """The start of every free key; SceneError where one cannot be freed."""
    own, kinds = scene.values(), {name: kind for name, kind, _ in all_keys()}
    if not names or not all(names):
        raise SceneError("--free: name the keys to fit, SECTION.KEY,SECTION.KEY,...")
    for name in names:
        if name in own and kinds[name] is float and own[name] > 0.0:
            continue
        if name not in own:
            # a scene's own words: what is unknown, and what may be meant
            draft = Draft(None)
            draft.put(name, 1.0, CHANGE)
            raise SceneError(f"--free {name}: {draft.problems[0].partition(': ')[2]}")
        raise SceneError(f"--free {name}: is {own[name]!r} in the scene; a free key is a number above 0 to start from")
    if len(set(names)) < len(names):
        raise SceneError(f"--free {','.join(names)}: names a key twice")
    for name in names:
        try:
            scene.but({name: own[name] * np.exp(-STEP)})
        except SceneError as error:
            raise SceneError(f"--free {name}: cannot be changed alone:\n{error}") from None
    return {name: float(own[name]) for name in names}


def _bounds(start: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Of the logarithms of value over start: REACH, within the limits of the keys."""
    low, high = [], []
    limits = {name: spec for name, _, spec in all_keys()}
    for name, value in start.items():
        spec = limits[name]
        tops = [top for top in (spec.at_most, spec.below) if top is not None]
        least = max(spec.at_least or 0.0, value / REACH)
        most = min([value * REACH, *tops])
        # a key at its limit has room on the other side
        low.append(min(np.log(least / value), -1e-6))
        high.append(max(np.log(most / value), 1e-6))
    return np.array(low), np.array(high)


def fit(
    scene: Scene,
    names: Sequence[str],
    targets: Sequence[Target],
    rounds: int = ROUNDS,
    tell: Callable[[float], None] = lambda cost: None,
) -> Fit:
    """Fit the named keys of a scene; tell(best cost so far) after each eye. SceneError where it cannot start."""
    own, scene = scene, with_numerics(scene, fidelity="cavity")
    start = free_keys(scene, names)
    low, high = _bounds(start)
    seen: dict[bytes, list[float | None]] = {}
    best = [np.inf]
    dearer = levels_beyond(own, scene, targets)

    def at(x: np.ndarray) -> list[float | None]:
        key = np.asarray(x).tobytes()
        if key not in seen:
            try:
                moved = scene.but({name: value * float(np.exp(z)) for (name, value), z in zip(start.items(), x)})
                found = figures(moved, targets, lambda: tell(best[0]))
                seen[key] = [None if value is None else value + more for value, more in zip(found, dearer)]
            except SceneError:
                seen[key] = [None] * len(targets)
            best[0] = min(best[0], _cost(residuals(seen[key], targets)))
        return seen[key]

    def jacobian(x: np.ndarray) -> np.ndarray:
        columns = []
        for k in range(len(x)):
            steps = [step for step in (STEP, -STEP) if low[k] <= x[k] + step <= high[k]]
            # where a figure comes or goes there is no derivative: the other side may show it
            for step in steps or [STEP]:
                moved = x.copy()
                moved[k] += step
                lost = [(one is None) != (other is None) for one, other in zip(at(x), at(moved))]
                if not any(lost):
                    break
            change = residuals(at(moved), targets) - residuals(at(x), targets)
            columns.append(np.where(lost, 0.0, change / step))
        return np.array(columns).T

    zero = np.zeros(len(start))
    before = at(zero)
    if all(value is None for value, target in zip(before, targets) if target.name != STOPPED):
        why = simulate(scene, scene.eye.iop_mmhg, 1e3 * scene.cornea.thickness_mm).stopped or "it does not applanate"
        raise SceneError(f"the scene's own eye shows nothing to fit, so that a fit has no start: {why}")
    result = least_squares(
        lambda x: residuals(at(x), targets),
        zero,
        jac=jacobian,
        bounds=(low, high),
        x_scale=1.0,
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
        max_nfev=rounds,
    )
    after = at(result.x)
    errors = np.sqrt(np.diag(np.linalg.pinv(result.jac.T @ result.jac)))
    # what no target sees has no error of 0
    errors = np.where(np.abs(result.jac).max(axis=0) > 0.0, errors, np.inf)
    return Fit(
        {
            name: (value, value * float(np.exp(z)), float(error))
            for (name, value), z, error in zip(start.items(), result.x, errors)
        },
        tuple(targets),
        tuple(before),
        tuple(after),
        (_cost(residuals(before, targets)), _cost(residuals(after, targets))),
        int(result.nfev),
        bool(result.status > 0),
    )


def _cost(values: np.ndarray) -> float:
    return 0.5 * float(values @ values)


def report(
    path: str,
    names: Sequence[str],
    overrides=(),
    rounds: int = ROUNDS,
    json_file: str | None = None,
    progress: bool = True,
    say=lambda text: print(text, flush=True),
) -> Fit:
    """Fit a scene file's keys to the clinical targets; print the tables and the overrides to paste."""
    scene = load_scene(path, overrides)
    refuse_no_puff(scene, path)
    with tqdm(unit=" eyes", disable=not progress, dynamic_ncols=True, leave=False) as bar:

        def tell(cost: float) -> None:
            if np.isfinite(cost):
                bar.set_description_str(f"cost {cost:.1f}")
            bar.update()

        found = fit(scene, names, clinical_targets(), rounds, tell)
    for line in lines(found):
        say(line)
    if json_file:
        write_text(Path(json_file), json.dumps(as_json(found), indent=2, allow_nan=False) + "\n")
    return found


def lines(found: Fit) -> list[str]:
    """The targets before and after, the keys, and the overrides."""
    rows = [["", "", "asked", "before", "(off)", "after", "(off)"]]
    for target, before, after in zip(found.targets, found.before, found.after):
        cells = []
        for value in (before, after):
            off = residuals([value], [target])[0]
            cells += ["-", ""] if value is None else [f"{value:.4g}", f"{off:+.1f}"]
        unit = "" if target.unit == LEVEL else target.unit
        rows.append([SHOWN.get(target.name, target.name), unit, f"{target.value:g} +- {target.scale:.3g}", *cells])
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    out = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths)).rstrip() for row in rows]
    end = "" if found.finished else ": not at rest yet, go on from the overrides"
    out += ["", f"half the sum of squares {found.cost[0]:.1f} -> {found.cost[1]:.1f} in {found.rounds} rounds{end}", ""]
    for name, (before, after, error) in found.keys.items():
        known = f"to {100.0 * error:.1f} %" if np.isfinite(error) else "not at all"
        out.append(f"{name}: {before:.6g} -> {after:.6g}, known {known}")
    return [*out, "", " ".join(f"--set {name}={after:.6g}" for name, (_, after, _) in found.keys.items())]


def as_json(found: Fit) -> dict:
    """All figures unrounded."""
    return {
        "overrides": {name: after for name, (_, after, _) in found.keys.items()},
        "keys": {
            name: {"before": before, "after": after, "relative_error": error if np.isfinite(error) else None}
            for name, (before, after, error) in found.keys.items()
        },
        "targets": [
            {**asdict(target), "before": before, "after": after}
            for target, before, after in zip(found.targets, found.before, found.after)
        ],
        "cost": {"before": found.cost[0], "after": found.cost[1]},
        "rounds": found.rounds,
        "finished": found.finished,
    }
