"""`estimate`: from what was measured of an eye to its pressure, its tissue, and how well they are known.

    import taichi_eye
    found = taichi_eye.estimate("film.mp4", taichi_eye.load_scene("corvis_healthy"))
    found["iop_mmhg"].value, found["iop_mmhg"].range95

What is fitted, and with what, is told in `taichi_eye.estimation.fit`; what may be unknown in `unknowns`; what the model
gets wrong in `model_error`. An estimate is an eye of the scene's model: it is worth what the scene is worth, and says
so by a model error in its intervals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from taichi_eye.analysis.analyze import Analysis
from taichi_eye.errors import SceneError
from taichi_eye.estimation import model_error as errors
from taichi_eye.estimation.calibration import Calibration
from taichi_eye.estimation.fit import (
    SD_68,
    SD_95,
    WIDEN_P,
    Problem,
    Solution,
    interval,
    on_bound,
    profiled,
    solve,
    solve_many,
)
from taichi_eye.estimation.observation import Observation
from taichi_eye.estimation.reading import read, run_scene_of
from taichi_eye.estimation.unknowns import IOP, UNKNOWNS, Known, beforehand, own_values
from taichi_eye.eye.eye import refuse_no_puff
from taichi_eye.scene import Scene

FREE = tuple(name for name, unknown in UNKNOWNS.items() if unknown.tissue)
INSEPARABLE = 0.95  # correlation beyond which two unknowns are told apart no more
LITTLE = 0.8  # of the deviation known beforehand that is left of an unknown the data tell little of


@dataclass(frozen=True)
class Quantity:
    """An estimated unknown: value, standard deviation and intervals in its own unit; before: value and standard
    deviation known beforehand, None where nothing was."""

    name: str
    unit: str
    value: float
    deviation: float
    range68: tuple[float, float]
    range95: tuple[float, float]
    before: Known | None


@dataclass(frozen=True)
class Share:
    """What a part of the data carried: how many values, and the standard deviation of the IOP [mmHg] without them."""

    part: str
    count: int
    deviation_without: float


@dataclass(frozen=True)
class Cost:
    """What not knowing an unknown adds: standard deviation of the IOP [mmHg] were it known exactly, as it is known, and
    were nothing known of it."""

    name: str
    exact: float
    known: float
    unknown: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """An eye that moves as was measured.

    quantities: what was free, the tissue first; held: what was not. chi2, degrees, probability: of the residuals,
    fitted [n] beside seen.values and deviations [n] (noise and model error). names, correlation: of the quantities.
    profile_mmhg, profile_root: the IOP and how many standard deviations it is off. rung: the model it ended on.
    """

    name: str
    seen: Observation
    quantities: tuple[Quantity, ...]
    held: dict[str, float]
    chi2: float
    degrees: int
    probability: float
    fitted: np.ndarray
    deviations: np.ndarray
    correlation: np.ndarray
    profile_mmhg: np.ndarray
    profile_root: np.ndarray
    shares: tuple[Share, ...]
    costs: tuple[Cost, ...]
    model_error_um: float
    widened: float
    rung: str
    rounds: int
    runs: int
    seconds: float
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    problem: Problem
    solution: Solution
    film: Analysis | None = None

    def __getitem__(self, name: str) -> Quantity:
        return {quantity.name: quantity for quantity in self.quantities}[name]

    @property
    def laplace_mmhg(self) -> float:
        """Standard deviation of the IOP, were the problem linear: what shares and costs are held against."""
        k = self.problem.before.names.index(IOP)
        return self[IOP].value * float(np.sqrt(self.solution.covariance[k, k]))

    @cached_property
    def scene(self) -> Scene:
        """The scene of the estimated eye."""
        return self.problem.before.scene(self.solution.place)


def estimate(
    data: str | Path | Observation,
    scene: Scene | None = None,
    known: Mapping[str, Known | tuple[float, float] | float] | None = None,
    free: Sequence[str] = FREE,
    age_years: float | None = None,
    noise_um: float | None = None,
    model_error_um: float | None = None,
    calibration: Calibration | None = None,
    finely: bool = True,
    tell: Callable[[str], None] = lambda text: None,
    **instrument: float | None,
) -> Estimate:
    """Estimate an eye from a trace, a film, a run, or a table's only row.

    scene: the model, about whose eye the population is; of a run its own, else it has to be given. known: values by the
    names of `UNKNOWNS`, a number where it is exact, else (value, standard deviation). free: which of the pressure and
    the tissue to estimate; the others are the scene's. noise_um: of a value of a trace; from the trace itself where it
    is not given. model_error_um: of a history; from the scene's own misfit where it is not given, 0 for data of the
    model itself. calibration: of the instrument. finely: end on the scene's own rung; instrument: settings of the
    camera. Raises SceneError (NoEstimate where no eye moves like that) or FilmError.
    """
    film, notes = None, ()
    if scene is None:
        scene = None if isinstance(data, Observation) else run_scene_of(Path(data))
        if scene is None:
            raise SceneError(f"{data}: says nothing of the model that it is fitted with; give a scene")
    if not isinstance(data, Observation):
        found = read(data, scene, noise_um, age_years, **instrument)
        if len(found.seen) > 1:
            raise SceneError(f"{data}: has {len(found.seen)} rows; `estimate_many` takes them")
        data, film, notes = found.seen[0], found.film, found.notes
    problem = problem_of(data, scene, known, free, age_years, model_error_um, calibration, tell)
    started = time.perf_counter()
    return finished(problem, solve(problem, finely), started, film, notes)


def estimate_many(problems: Sequence[Problem], tell: Callable[[str], None] = lambda text: None) -> list:
    """Estimates, or the NoEstimate that refuses one, of many histories: their fine runs side by side."""
    started = time.perf_counter()
    out = []
    for number, (problem, solution) in enumerate(zip(problems, solve_many(problems, tell)), 1):
        tell(f"profile {number} of {len(problems)}")
        out.append(solution if isinstance(solution, SceneError) else finished(problem, solution, started))
    return out


def problem_of(
    seen: Observation,
    scene: Scene,
    known: Mapping | None = None,
    free: Sequence[str] = FREE,
    age_years: float | None = None,
    model_error_um: float | None = None,
    calibration: Calibration | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Problem:
    """What is to be solved, with what the user, the film and the calibration know; SceneError for bad input."""
    refuse_no_puff(scene)
    if scene.puff.time_course == "file":
        raise SceneError(
            f'puff.file = "{scene.puff.file}": the strength of a puff is part of an estimate, and a file has none to '
            'vary; use puff.time_course = "corvis" or "paper"'
        )
    given = {name: as_known(name, value) for name, value in (known or {}).items()}
    for name in free:
        if name not in FREE:
            raise SceneError(f"free {name}: allowed are {', '.join(FREE)}")
    if IOP not in free:
        raise SceneError(f"free {', '.join(free)}: {IOP} is what is estimated")
    from_scene = {name: Known(1.0) for name in FREE if name != IOP and name not in free and name not in given}
    told = dict(seen.shown)
    joint = None
    if calibration is not None:
        calibration.refuse_other(scene)
        calibrated = {name: value for name, value in calibration.known().items() if name not in given}
        told |= calibrated
        joint = calibration.joint(tuple(calibrated)) if calibrated else None
    own = own_values(scene)
    from_scene = {name: value for name, value in from_scene.items() if name in own}
    before = beforehand(scene, {**told, **from_scene, **given}, age_years, seen.retreats, joint)
    model = errors.NONE
    if model_error_um is None or model_error_um > 0.0:
        model = errors.of_scene(scene)
        if model_error_um is not None:
            model = replace(model, history_mm=1e-3 * model_error_um)
    elif model_error_um < 0.0:
        raise SceneError(f"model_error_um = {model_error_um:g}: allowed is 0 or more")
    return Problem(seen, before, model, tell)


def as_known(name: str, value) -> Known:
    """A value with its deviation, or an exact one."""
    if isinstance(value, Known):
        return value
    try:
        return Known(*map(float, value)) if isinstance(value, Sequence) else Known(float(value))
    except (TypeError, ValueError):
        raise SceneError(f"known {name} = {value!r}: a number, or a value and its standard deviation") from None


def finished(problem: Problem, solution: Solution, started: float, film: Analysis | None = None, notes=()) -> Estimate:
    """All that is reported of a solution."""
    before, seen, model = problem.before, problem.seen, problem.model
    solution, place, root = profiled(problem, solution)
    iop, k = float(np.exp(solution.place[before.names.index(IOP)])), before.names.index(IOP)
    deviations = np.sqrt(np.diag(solution.covariance))
    quantities = []
    for j, name in enumerate(before.names):
        unit, at = UNKNOWNS[name].unit, solution.place[j]
        bounds = float(before.low[j]), float(before.high[j])
        if name == IOP:
            ranges = [np.exp(interval(place, root, width, bounds)) for width in (SD_68, SD_95)]
        else:
            ranges = [
                np.exp(np.clip(at + width * deviations[j] * np.array([-1.0, 1.0]), *bounds)) for width in (SD_68, SD_95)
            ]
        value = float(np.exp(at))
        ranges = [(float(low), float(high)) for low, high in ranges]
        spread = before.precision[j, j]
        known = (
            Known(float(np.exp(before.mean[j])), float(np.exp(before.mean[j]) / np.sqrt(spread))) if spread else None
        )
        quantities.append(Quantity(name, unit, value, 0.5 * (ranges[0][1] - ranges[0][0]), *ranges, known))
    order = sorted(range(len(quantities)), key=lambda j: list(UNKNOWNS).index(quantities[j].name))
    outer = np.outer(deviations, deviations)
    return Estimate(
        name=seen.name,
        seen=seen,
        quantities=tuple(quantities[j] for j in order),
        held=dict(before.held),
        chi2=solution.chi2,
        degrees=solution.degrees,
        probability=solution.probability,
        fitted=problem.predict(solution.place) + problem.defect.at(solution.place),
        deviations=np.sqrt(np.diag(problem.covariance)),
        correlation=(solution.covariance / outer)[np.ix_(order, order)],
        profile_mmhg=np.exp(place),
        profile_root=root,
        shares=_shares(problem, solution, iop, k),
        costs=_costs(problem, solution, iop, k),
        model_error_um=1e3 * model.history_mm * problem.factor,
        widened=problem.factor,
        rung=solution.rung,
        rounds=solution.rounds,
        runs=problem.runs,
        seconds=time.perf_counter() - started,
        warnings=tuple(_warnings(problem, solution, quantities, deviations)),
        notes=tuple(dict.fromkeys((*notes, *seen.notes))),
        problem=problem,
        solution=solution,
        film=film,
    )


def _deviation(information: np.ndarray, iop: float, k: int) -> float:
    """Standard deviation of the IOP [mmHg] of an inverse covariance of the logarithms."""
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * values[-1]:
        return float("inf") if abs(vectors[k, 0]) > 1e-6 else iop * float(np.sqrt(np.linalg.pinv(information)[k, k]))
    return iop * float(np.sqrt(np.linalg.inv(information)[k, k]))


def _shares(problem: Problem, solution: Solution, iop: float, k: int) -> tuple[Share, ...]:
    """What each part of the data carried, the weightiest first."""
    found, groups = [], problem.seen.groups
    for part in dict.fromkeys(groups):
        without = problem.information(solution.place, groups != part) + problem.before.precision
        found.append(Share(str(part), int((groups == part).sum()), _deviation(without, iop, k)))
    return tuple(sorted(found, key=lambda share: -share.deviation_without))


def _costs(problem: Problem, solution: Solution, iop: float, k: int) -> tuple[Cost, ...]:
    """What each unknown that something is known of costs."""
    data, before, found = problem.information(solution.place), problem.before, []
    declared = _deviation(data + before.precision, iop, k)
    for j, name in enumerate(before.names):
        if j == k or before.precision[j, j] == 0.0:
            continue
        others = [i for i in range(len(before.names)) if i != j]
        exact = _deviation((data + before.precision)[np.ix_(others, others)], iop, others.index(k))
        found.append(Cost(name, exact, declared, _deviation(data + before.without(name), iop, k)))
    return tuple(found)


def _warnings(problem: Problem, solution: Solution, quantities, deviations) -> list[str]:
    before, said = problem.before, []
    for name in on_bound(before, solution.place):
        low, high = UNKNOWNS[name].allowed
        said.append(f"{name} lies on the bound of what is searched ({low:g} to {high:g}): it is no estimate")
    names, covariance = before.names, solution.covariance
    for i in range(len(names)):
        for j in range(i):
            alike = covariance[i, j] / np.sqrt(covariance[i, i] * covariance[j, j])
            if abs(alike) >= INSEPARABLE:
                said.append(f"{names[j]} and {names[i]} cannot be told apart (correlation {alike:+.2f})")
    for j, name in enumerate(names):
        spread = before.precision[j, j]
        if UNKNOWNS[name].tissue and spread and deviations[j] > LITTLE / np.sqrt(spread):
            said.append(f"the data tell little of {name}: it is what was taken for it beforehand")
    agreement = problem.agreement(solution.place)
    if agreement < WIDEN_P:
        said.append(f"the eye is unlike what was known beforehand (probability {agreement:.2g})")
    if problem.factor > 1.0:
        said.append(
            f"the residuals or what was known beforehand ask for a model error {problem.factor:.1f} times as large; "
            "the intervals have it"
        )
    if solution.stopped:
        said.append(f"ended on the rung {solution.rung}: the full model of this eye is {solution.stopped}")
    elif not solution.settled:
        said.append(f"the estimate had not come to rest after {solution.rounds} runs of the full model")
    return said
