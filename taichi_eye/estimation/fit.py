"""The most likely eye behind what was measured, and how likely its neighbours are.

With f the cheap model (`taichi_eye.estimation.motion`), y the data, x the logarithms of the unknowns, S = noise + model
error and P, m the precision and mean known beforehand, the estimate is the least of

    (y - d(x) - f(x))' S^-1 (y - d(x) - f(x)) + (x - m)' P (x - m)

found by SciPy's trust-region least squares with derivatives from one run per unknown. They serve at other places, too,
as long as they foretell what the runs there show (AGREES), and are bent by Broyden's update to what they missed; where
a search ends they are taken anew. d is what the cheap model leaves out, the fine model less the cheap one: known at
the last estimate, and around it by Broyden's derivative from the estimates before. It is taken anew until the estimate
rests (SETTLED standard deviations), some three times: so the end is an estimate with the fine model at the price of the
cheap one.

The search begins on the cavity rung with landmarks (`taichi_eye.estimation.landmarks`), and goes on with added mass, at
first with what that one leaves out in S: with the camera's noise alone the valleys are so narrow that it would end in a
wrong one, for what rings after a shell's snap repeats itself. Close to the least the problem is linear: the covariance
is that of Gauss and Laplace; the interval of the IOP is read off its profile, all others let go.

The least value is that of chi^2 with as many degrees of freedom as data, less the unknowns of which nothing is known
beforehand. Where there is a model error and the least is improbable (WIDEN_P), the model error is enlarged until the
least is what it should be, at most by WIDEST; so it is where the eye is improbable by what was known beforehand alone.
What WIDEST does not explain either, or is very improbable (REFUSED_P) without a model error, is no eye of this model,
and there is no estimate; nor is there one where the nearest eye is FAR_SHARE of the dent away.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2

from taichi_eye.errors import NoEstimate, SceneError
from taichi_eye.estimation.landmarks import landmarks_of
from taichi_eye.estimation.model_error import CAVITY, NONE, ModelError
from taichi_eye.estimation.motion import ROUGH, Motion, cheap, fine, fine_apices
from taichi_eye.estimation.observation import Observation
from taichi_eye.estimation.unknowns import IOP, Beforehand
from taichi_eye.scene import Scene

# of a logarithm, for derivatives: so much of what the data know it to, within limits. Small, for where a shell snaps
# the derivatives by the IOP change by 4 % in .005; not smaller, for runs scatter by what their step counts do
STEP_SD, STEPS = 0.5, (0.002, 0.02)
NEAR = 1.5  # of these steps: derivatives are those of the place itself so far
AGREES = 0.2  # of a change of the prediction: derivatives that miss no more of it hold
TOLERANCE, ON_THE_WAY = 1e-5, 1e-3  # of the sum of squares: at the end, and where a search goes on
EVALUATIONS = 25
STARTS_MMHG = 6.0, 8.0, 10.5, 13.5, 17.0, 22.0, 29.0, 38.0, 50.0
SETTLED, ROUNDS = 0.1, 6
LEAST_MOVE = 0.2  # standard deviations between two fine runs that a derivative is taken from
HOP, HOPS, LOWER = 2.5, 2, 0.5
CHEAPEST = "membrane", "cavity"  # rungs that nothing is cheaper than
LEFT_OUT = 0.5, 0.15  # of `CAVITY`: what added mass leaves out, and more to begin with
DETOURS = 0.0, 0.05, 0.1  # of ln IOP, where a fine run is stopped: a shell folds less the higher its pressure
WIDEN_P, REFUSED_P, WIDEST = 0.05, 1e-4, 3.0
WIDENINGS, WIDER = 5, 1.5
PROFILE_SD = 1.0, 2.1
PROFILE_STEPS = 3
GAIN = 0.05  # of the sum of squares, below which it is not made less
RESTS = 3
SD_68, SD_95 = 1.0, 1.959964
FAR_SHARE = 0.08  # of the largest depth, rms
ON_BOUND = 0.02  # of the way between the bounds


class Defect:
    """The fine model less the cheap one: known at the places of fine runs, linear about the last."""

    def __init__(self, count: int, unknowns: int):
        self.value, self.slopes = np.zeros(count), np.zeros((count, unknowns))
        self.place: np.ndarray | None = None

    def at(self, place: np.ndarray) -> np.ndarray:
        """[n] at a place."""
        return self.value if self.place is None else self.value + self.slopes @ (place - self.place)

    def take(self, place: np.ndarray, value: np.ndarray, scale: np.ndarray) -> None:
        """A fine run's; scale [unknowns]: that of the places, for Broyden's update."""
        if self.place is not None:
            moved = (place - self.place) / scale
            if moved @ moved > LEAST_MOVE**2:
                self.slopes = self.slopes + np.outer(value - self.at(place), moved / scale) / (moved @ moved)
        self.place, self.value = place.copy(), value


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of a prediction [n, unknowns] about a place; shown [n]: the prediction there; taken: whether by runs
    about this very place, and not by an update."""

    place: np.ndarray
    shown: np.ndarray
    matrix: np.ndarray
    taken: bool

    def missed(self, place: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """What they do not foretell of the prediction at another place."""
        return shown - self.shown - self.matrix @ (place - self.place)


@dataclass(eq=False)
class Problem:
    """What was measured and what is known, with the runs made so far. defect: d above."""

    seen: Observation
    before: Beforehand
    model: ModelError
    tell: Callable[[str], None] = lambda text: None
    defect: Defect = field(init=False)
    runs: int = field(init=False, default=0)
    _shown: dict = field(init=False, default_factory=dict)
    _slopes: list[Slopes] = field(init=False, default_factory=list)

    def __post_init__(self):
        self.defect = Defect(len(self.seen.values), len(self.before.names))
        values, vectors = np.linalg.eigh(self.before.precision)
        self._steps = np.full(len(self.before.names), STEPS[0])
        self._prior = np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T
        self._noise = self.seen.noise()
        fidelity = self.before.base.numerics.fidelity
        self.climb(fidelity if fidelity in CHEAPEST else ROUGH)
        self.shape(self.seen.values)

    def shape(self, shown: np.ndarray) -> None:
        """Take the model error of a motion that shows these values, once there is one in place of what was measured.

        A model error has the shape of the motion. With that of what was measured it has the shape of the noise, too,
        and a dent that is too shallow is free of it (Peelle's puzzle): with 10 um of noise and 61 um of model error, of
        an eye that is 0.48 mm deep one of 80 mmHg was likelier than its own of 32.
        """
        self._wrong, cheap_wrong = (self.seen.model_error(model, shown) for model in (self.model, CAVITY))
        self._cheap_wrong = cheap_wrong + np.diag(np.diag(cheap_wrong))
        self.widen(1.0)

    def widen(self, factor: float, cavity: float = 0.0) -> None:
        """Take the model error so many times as large, and that of the cheap model besides."""
        self.factor, self.left_out = factor, cavity
        self.covariance = self._noise + factor**2 * self._wrong + cavity**2 * self._cheap_wrong
        self.lower = np.linalg.cholesky(self.covariance)

    def climb(self, rung: str) -> None:
        """Take another cheap rung."""
        self.rung, self._shown, self._slopes = rung, {}, []

    def motion(self, place: np.ndarray) -> Motion | None:
        """The cheap motion at a place; None where there can be no such eye."""
        self.runs += 1
        try:
            return cheap(self.before.scene(place), self.rung)
        except SceneError:
            return None

    def predict(self, place: np.ndarray) -> np.ndarray:
        """The cheap model's prediction [n], NaN where it does not show it."""
        key = np.asarray(place, float).tobytes()
        if key not in self._shown:
            motion = self.motion(place)
            self._shown[key] = np.full(len(self.seen.values), np.nan) if motion is None else self.seen.predict(motion)
            self.tell(f"IOP {np.exp(place[self.before.names.index(IOP)]):.2f} mmHg")
        return self._shown[key]

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """L^-1 values, S = L L'."""
        if not np.isfinite(values).all():
            return np.full(values.shape, np.nan)
        return solve_triangular(self.lower, values, lower=True)

    def residuals(self, place: np.ndarray) -> np.ndarray:
        """What the sum of squares above is of: data, then what is known beforehand."""
        off = self.predict(place) + self.defect.at(place) - self.seen.values
        return np.concatenate([self.whitened(off), self._prior @ (place - self.before.mean)])

    def cost(self, place: np.ndarray) -> float:
        """That sum; infinite where the model shows no such motion."""
        off = self.residuals(place)
        return float(off @ off) if np.isfinite(off).all() else np.inf

    def agreement(self, place: np.ndarray) -> float:
        """Probability that an eye is so far from what is known beforehand; 1 where nothing is.

        Beside the sum of all squares, in which the many data, of which a model error takes up most, would hide it.
        """
        known, off = int((np.diag(self.before.precision) > 0.0).sum()), self._prior @ (place - self.before.mean)
        return float(chi2.sf(off @ off, known)) if known else 1.0

    def slopes(self, place: np.ndarray, anew: bool = False) -> np.ndarray:
        """Derivatives of the cheap prediction [n, unknowns]; anew: those of the place itself, no others."""
        known = self._known_slopes(place, anew) or self._taken_slopes(place)
        if np.isfinite(known.shown).all() and not any(known is one for one in self._slopes):
            self._slopes.append(known)
        return known.matrix

    def _known_slopes(self, place: np.ndarray, anew: bool) -> Slopes | None:
        """Those taken at the place, or those of another that foretell best what is shown here, as long as they do."""
        far = lambda one: float((np.abs(place - one.place) / self._steps).max())
        own = min((one for one in self._slopes if one.taken), key=far, default=None)
        if own is not None and far(own) <= NEAR:
            return own
        here = self.predict(place)
        if anew or not self._slopes or not np.isfinite(here).all():
            return None
        size = lambda values: float(np.linalg.norm(self.whitened(values)))
        best = min(self._slopes, key=lambda one: size(one.missed(place, here)))
        if far(best) <= NEAR:
            return best
        missed = best.missed(place, here)
        if size(missed) > AGREES * size(here - best.shown):
            return None
        scale = np.sqrt(np.diag(_inverse(self._information(best.matrix) + self.before.precision)))
        moved = (place - best.place) / scale
        return Slopes(place.copy(), here, best.matrix + np.outer(missed, moved / scale) / (moved @ moved), False)

    def _taken_slopes(self, place: np.ndarray) -> Slopes:
        """From one run per unknown."""
        here, columns = self.predict(place), []
        for k in range(len(place)):
            for step in (self._steps[k], -self._steps[k]):
                moved = np.array(place, float)
                moved[k] += step
                column = (self.predict(moved) - here) / step
                if np.isfinite(column).all():
                    break
            columns.append(np.nan_to_num(column))
        matrix = np.array(columns).T
        known = np.diag(self._information(matrix)) + np.diag(self.before.precision)
        self._steps = np.clip(STEP_SD / np.sqrt(np.maximum(known, 1e-12)), *STEPS)
        return Slopes(np.array(place, float), here, matrix, True)

    def jacobian(self, place: np.ndarray) -> np.ndarray:
        """Derivatives of `residuals`."""
        return np.vstack([self.whitened(self.slopes(place) + self.defect.slopes), self._prior])

    def information(self, place: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        """What the data (those of `rows`) tell of the unknowns: the inverse covariance."""
        # without the defect's: Broyden's few directions serve a search, and are no derivative in any other
        slopes = self.slopes(place)
        if rows is None:
            return self._information(slopes)
        if not rows.any():
            return np.zeros((len(place),) * 2)
        part = slopes[rows]
        return part.T @ cho_solve(cho_factor(self.covariance[np.ix_(rows, rows)], lower=True), part)

    def _information(self, slopes: np.ndarray) -> np.ndarray:
        white = self.whitened(slopes)
        return white.T @ white

    def information_of_noise(self, place: np.ndarray) -> np.ndarray:
        """What the data would tell were there no model error."""
        slopes = self.slopes(place)
        return slopes.T @ np.linalg.solve(self._noise, slopes)

    def sums(self, place: np.ndarray, factor: float) -> float:
        """The sum of squares at a place with a model error so many times as large."""
        off = self.predict(place) + self.defect.at(place) - self.seen.values
        if not np.isfinite(off).all():
            return np.inf
        known = self._prior @ (place - self.before.mean)
        covariance = self.covariance + (factor**2 - self.factor**2) * self._wrong
        return float(off @ cho_solve(cho_factor(covariance, lower=True), off) + known @ known)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the least is. place, covariance: of the logarithms; chi2, degrees, probability; rung: the fine model's;
    rounds: fine runs; stopped: why the fine model could not be used, or empty; settled: whether the rounds ended."""

    place: np.ndarray
    covariance: np.ndarray
    chi2: float
    degrees: int
    probability: float
    rung: str
    rounds: int
    stopped: str = ""
    settled: bool = True


def solve(problem: Problem, finely: bool = True) -> Solution:
    """The estimate; NoEstimate where no eye of the model moves like that. finely: end on the scene's own rung."""
    solving = _solving(problem, finely)
    motion = None
    while True:
        try:
            scene = solving.send(motion)
        except StopIteration as end:
            return end.value
        motion = fine(scene)


def solve_many(
    problems: Sequence[Problem], tell: Callable[[str], None] = lambda text: None
) -> list[Solution | NoEstimate]:
    """Estimates of many eyes from histories of their apices, their fine runs side by side."""
    found: list[Solution | NoEstimate | None] = [None] * len(problems)
    solving = {number: _solving(problem, True) for number, problem in enumerate(problems)}
    motions: dict[int, Motion | None] = dict.fromkeys(solving)
    rounds = 0
    while solving:
        asked, rounds = {}, rounds + 1
        for done, number in enumerate(list(solving), 1):
            tell(f"search, round {rounds}, {done} of {len(motions)} eyes")
            try:
                asked[number] = solving[number].send(motions[number])
            except StopIteration as end:
                found[number] = end.value
            except NoEstimate as refusal:
                found[number] = refusal
            if found[number] is not None:
                del solving[number]
        tell(f"{len(asked)} fine runs")
        motions = dict(zip(asked, fine_apices(list(asked.values()))))
    return found


def _solving(problem: Problem, finely: bool) -> Generator[Scene, Motion, Solution]:
    """The estimate, in steps: gives the scenes that it needs the fine motion of."""
    rung = problem.before.base.numerics.fidelity
    climbs = rung not in CHEAPEST
    finely = finely and climbs
    rounds, stopped, settled = 0, "", False
    place = _begin(problem)
    shown = problem.predict(place)
    if np.isfinite(shown).all():
        problem.shape(shown)
    if climbs:
        problem.climb("added_mass")
    for left_out in LEFT_OUT:
        problem.widen(1.0, left_out)
        place = _best(problem, [place], ON_THE_WAY)
    place = _hopped(problem, place)
    if not finely:
        problem.widen(1.0)
        place = _best(problem, [place])
    while finely and not settled and rounds < ROUNDS:
        problem.tell(f"{rung}, round {rounds + 1}")
        for aside in DETOURS:
            beside = place.copy()
            beside[problem.before.names.index(IOP)] += aside
            exact = yield problem.before.scene(beside)
            shown, stopped = problem.seen.predict(exact), exact.stopped
            if not stopped and np.isfinite(shown).all():
                break
            stopped = stopped or "it does not show what was measured"
        rounds += 1
        if stopped:
            problem.defect = Defect(len(shown), len(place))
            break
        deviations = np.sqrt(np.diag(_covariance(problem, place)))
        problem.defect.take(beside, shown - problem.predict(beside), deviations)
        problem.widen(1.0)
        before, place = place, _best(problem, [place])
        deviations = np.sqrt(np.diag(_covariance(problem, place)))
        settled = bool((np.abs(place - before) <= SETTLED * deviations).all())
    if stopped:
        problem.widen(1.0, LEFT_OUT[-1])
        place = _best(problem, [place])
    degrees = len(problem.seen.values) - int((np.diag(problem.before.precision) == 0.0).sum())
    place = _at_rest(problem, _widened(problem, place, degrees))
    _refuse_far(problem, place)
    rung = rung if finely and not stopped else problem.rung
    like = Solution(place, np.empty(0), 0.0, degrees, 0.0, rung, rounds, stopped, settled or not finely)
    return _solution(problem, place, like)


def _solution(problem: Problem, place: np.ndarray, like: Solution) -> Solution:
    """A solution at a place, otherwise like another."""
    cost = problem.cost(place)
    probability = float(chi2.sf(cost, like.degrees))
    covariance = _covariance(problem, place)
    return replace(like, place=place, covariance=covariance, chi2=cost, probability=probability)


def profiled(problem: Problem, solution: Solution) -> tuple[Solution, np.ndarray, np.ndarray]:
    """The solution with its profile; a lower place that the profile comes upon is the solution."""
    place, root, lowest = profile(problem, solution)
    if problem.cost(lowest) < solution.chi2 - LOWER:
        solution = _solution(problem, _at_rest(problem, _best(problem, [lowest])), solution)
        place, root, _ = profile(problem, solution)
    return solution, place, root


def profile(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ln IOP, rising; the signed root of the least sum of squares there over the least of all, all others let go; and
    the place of the lowest sum met.

    The root is the number of standard deviations from the estimate, were the problem linear.
    """
    lowest = solution.place
    k = problem.before.names.index(IOP)
    rest = [j for j in range(len(solution.place)) if j != k]
    deviation = float(np.sqrt(solution.covariance[k, k]))
    follow = solution.covariance[:, k] / solution.covariance[k, k]
    found = [(float(solution.place[k]), 0.0)]
    for side in (-1.0, 1.0):
        for number in PROFILE_SD:
            place = solution.place + side * number * deviation * follow
            place = np.clip(place, problem.before.low, problem.before.high)
            place[k] = np.clip(
                solution.place[k] + side * number * deviation, problem.before.low[k], problem.before.high[k]
            )
            if abs(place[k] - found[0][0]) < 1e-9 or any(abs(place[k] - one) < 1e-9 for one, _ in found):
                break
            cost = problem.cost(place)
            for _ in range(PROFILE_STEPS):
                if not rest or not np.isfinite(cost):
                    break
                slopes = problem.jacobian(place)[:, rest]
                step = np.linalg.lstsq(slopes, -problem.residuals(place), rcond=None)[0]
                moved = place.copy()
                moved[rest] = np.clip(place[rest] + step, problem.before.low[rest], problem.before.high[rest])
                new = problem.cost(moved)
                if not new < cost:
                    break
                gained, place, cost = cost - new, moved, new
                if gained < GAIN:
                    break
            if not np.isfinite(cost):
                break
            if cost < problem.cost(lowest):
                lowest = place
            found.append((float(place[k]), side * float(np.sqrt(max(cost - solution.chi2, 0.0)))))
    found.sort()
    place, root = np.array(found).T
    # the root rises with the IOP; where runs scatter, it is not let fall
    return place, np.maximum.accumulate(root), lowest


def interval(
    place: np.ndarray, root: np.ndarray, deviations: float, bounds: tuple[float, float]
) -> tuple[float, float]:
    """The ln IOP at so many standard deviations to either side on a profile, within the bounds."""
    ends = []
    for side, wanted in ((0, -deviations), (-1, deviations)):
        if len(place) < 2:
            ends.append(bounds[side])
        elif root[0] <= wanted <= root[-1]:
            ends.append(float(np.interp(wanted, root, place)))
        else:
            # as far as the profile goes at the pace of its whole side
            own = int(np.argmin(np.abs(root)))
            run = root[side] - root[own]
            pace = (place[side] - place[own]) / run if abs(run) > 1e-6 else np.inf
            ends.append(float(place[own] + pace * wanted) if np.isfinite(pace) else bounds[side])
    return max(ends[0], bounds[0]), min(ends[1], bounds[1])


def on_bound(before: Beforehand, place: np.ndarray) -> list[str]:
    """The unknowns whose estimates lie on a bound."""
    share = (place - before.low) / (before.high - before.low)
    return [name for name, at in zip(before.names, share) if not ON_BOUND <= at <= 1.0 - ON_BOUND]


def _begin(problem: Problem) -> np.ndarray:
    """Where the search begins: the least of the landmarks, where the data have them."""
    marks = landmarks_of(problem.seen)
    if marks is None:
        return _best(problem, _starts(problem), ON_THE_WAY)
    rough = Problem(marks, problem.before, NONE, problem.tell)
    place = _best(rough, _starts(rough)[:1], ON_THE_WAY)
    problem.runs += rough.runs
    return place


def _hopped(problem: Problem, place: np.ndarray) -> np.ndarray:
    """The place, or a lower one beyond a ridge: the search once more from either side of it, HOP standard deviations
    along what the data know least."""
    if len(place) == 1:
        return place
    before = problem.before
    for _ in range(HOPS):
        values, vectors = np.linalg.eigh(_covariance(problem, place))
        away = HOP * np.sqrt(values[-1]) * vectors[:, -1]
        starts = [np.clip(place + side * away, before.low + 1e-6, before.high - 1e-6) for side in (-1.0, 1.0)]
        found = [_best(problem, [start], ON_THE_WAY) for start in starts if np.isfinite(problem.cost(start))]
        lowest = min(found, key=problem.cost, default=place)
        if not problem.cost(lowest) < problem.cost(place) - LOWER:
            break
        place = lowest
    return place


def _refuse_far(problem: Problem, place: np.ndarray) -> None:
    """NoEstimate where the nearest eye is far from a history, however large a model error would have it: a model that
    misses by more is no model of what was measured."""
    if problem.seen.unit != "mm":
        return
    off = problem.predict(place) + problem.defect.at(place) - problem.seen.values
    beyond_noise = max(float(np.mean(off**2) - np.mean(np.diag(problem.seen.noise()))), 0.0)
    rms, depth = np.sqrt(beyond_noise), float(np.abs(problem.seen.values).max())
    if rms > FAR_SHARE * depth:
        raise NoEstimate(
            f"{problem.seen.name}: no eye of this scene moves like that: the nearest is {1e3 * rms:.0f} um off (rms), "
            f"{100.0 * rms / depth:.0f} % of the largest depth; more than {100.0 * FAR_SHARE:g} % is another motion. "
            "Check the units, the scene and its puff"
        )


def _starts(problem: Problem) -> list[np.ndarray]:
    """Places along the IOP with all else at its mean, the best first."""
    before = problem.before
    k, places = before.names.index(IOP), []
    for iop in STARTS_MMHG:
        place = before.mean.copy()
        place[k] = np.log(iop)
        places.append(np.clip(place, before.low + 1e-6, before.high - 1e-6))
    costs = [problem.cost(place) for place in places]
    order = [int(n) for n in np.argsort(costs) if np.isfinite(costs[int(n)])]
    if not order:
        motion = problem.motion(places[len(places) // 2])
        why = motion.stopped if motion is not None and motion.stopped else "it does not show what was measured"
        raise NoEstimate(f"{problem.seen.name}: no eye of this scene moves like that at any pressure: {why}")
    return [places[n] for n in order[:2]]


def _at_rest(problem: Problem, place: np.ndarray) -> np.ndarray:
    """The least by derivatives of its own place."""
    for _ in range(RESTS):
        problem.slopes(place, anew=True)
        before, place = place, _best(problem, [place])
        if not problem.cost(place) < problem.cost(before) - GAIN:
            break
    return place


def _best(problem: Problem, starts: list[np.ndarray], tolerance: float = TOLERANCE) -> np.ndarray:
    """The least from the first start; from the others as well, where that one is improbable."""
    before, best = problem.before, None
    for start in starts:
        result = least_squares(
            problem.residuals,
            np.clip(start, before.low + 1e-6, before.high - 1e-6),
            jac=problem.jacobian,
            bounds=(before.low, before.high),
            x_scale="jac",
            ftol=tolerance,
            xtol=TOLERANCE,
            gtol=1e-9,
            max_nfev=EVALUATIONS,
        )
        if best is None or result.cost < best.cost:
            best = result
        if chi2.sf(2.0 * best.cost, len(problem.seen.values)) > REFUSED_P:
            break
    return best.x


def _covariance(problem: Problem, place: np.ndarray) -> np.ndarray:
    return _inverse(problem.information(place) + problem.before.precision)


def _inverse(information: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(information)


def _widened(problem: Problem, place: np.ndarray, degrees: int) -> np.ndarray:
    """The place with a model error as large as the residuals, and what was known beforehand, ask for; NoEstimate where
    none explains them."""
    for _ in range(WIDENINGS):
        cost = problem.cost(place)
        improbable = chi2.sf(cost, degrees) < WIDEN_P
        if not improbable and problem.agreement(place) >= WIDEN_P:
            return place
        if problem.factor >= WIDEST or problem.sums(place, 2.0 * WIDEST) >= problem.sums(place, problem.factor):
            break
        if improbable:
            excess = lambda factor: problem.sums(place, factor) - degrees
            factor = WIDEST if excess(WIDEST) > 0.0 else float(brentq(excess, problem.factor, WIDEST, xtol=1e-2))
        else:
            factor = min(WIDER * problem.factor, WIDEST)
        problem.widen(factor, problem.left_out)
        place = _best(problem, [place])
    cost, before = problem.cost(place), problem.before
    where = f", even with a model error {problem.factor:.1f} times as large" if problem.factor > 1.0 else ""
    iop = float(np.exp(place[before.names.index(IOP)]))
    refused = WIDEN_P if problem.factor >= WIDEST else REFUSED_P
    if chi2.sf(cost, degrees) < refused:
        raise NoEstimate(
            f"{problem.seen.name}: no eye of this scene moves like that{where}: chi^2 {cost:.0f} at {degrees} degrees "
            f"of freedom; the nearest has {iop:.1f} mmHg. Check the units, the scene and its puff, or allow for a "
            "model error"
        )
    if problem.agreement(place) < refused:
        off = (place - before.mean) * np.sqrt(np.diag(before.precision))
        worst = int(np.argmax(np.abs(off)))
        raise NoEstimate(
            f"{problem.seen.name}: only an eye unlike all that is known beforehand moves like that{where}: the nearest "
            f"has {iop:.1f} mmHg and {before.names[worst]} {np.exp(place[worst]):.3g}, {abs(off[worst]):.1f} standard "
            "deviations away. Check what is declared, the scene and its puff, or allow for a model error"
        )
    return place
