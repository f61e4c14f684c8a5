"""What was measured of an eye, as the estimate takes it: values, how well they are known, and how a model shows them.

Four kinds: `ApexHistory` (a trace: the apex over time, with or without the retreat of the whole eye), `ReadDeflection`
(the deflection as `taichi_eye.analysis` reads it from a film, from its histories.csv), `FilmSurface` (the same over
STATIONS_MM, from a film) and `ParameterRow` (clinical parameters of one examination). Each has

    values [n], groups [n]   the data in mm or in their own units, and the part of the puff or the parameter each shows
    predict(motion)          the same of a motion (`taichi_eye.estimation.motion`), NaN where it does not show it
    noise()                  covariance [n, n] of what measuring adds
    model_error(model, shown) covariance [n, n] of what the model gets wrong of a motion that shows the values `shown`
    shown                    unknowns that the film itself shows (thickness, radius)

Deflections are relative to the flanks, so the retreat of the whole eye drops out of them as it does in the clinic.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from taichi_eye.analysis.curves import grid
from taichi_eye.analysis.response import APEX_MM, Histories, moving, respond
from taichi_eye.estimation import model_error as errors
from taichi_eye.estimation.model_error import ModelError
from taichi_eye.estimation.motion import Motion
from taichi_eye.estimation.parameters import REPEATABILITY, Row
from taichi_eye.estimation.unknowns import Known

STATIONS_MM = 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0
STATION_HALF_MM = 0.1
LEAST_NOISE_MM = 0.001
# of reading a film (`taichi-eye films`): what stays from frame to frame, and as a share of the deflection
READING_MM, READING_SHARE = 0.003, 0.003
STEP_MS, SAMPLES_MOST = 0.2, 300  # of a history that is finer sampled than a camera does it
SHARES = (0.9, 0.1)  # of the largest depth, that part a history


@dataclass(frozen=True, eq=False)
class Observation(ABC):
    """What all kinds have. kind: in a word; name: of the source; unit: of the values."""

    name: str
    values: np.ndarray
    groups: np.ndarray
    shown: dict[str, Known] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    kind = ""
    unit = "mm"
    retreats = False  # whether the values hold the retreat of the whole eye

    @abstractmethod
    def predict(self, motion: Motion) -> np.ndarray:
        """The values that a motion would show, as measured."""

    @abstractmethod
    def noise(self) -> np.ndarray:
        """Covariance of what was measured."""

    @abstractmethod
    def model_error(self, model: ModelError, shown: np.ndarray) -> np.ndarray:
        """Covariance of what the model gets wrong of a motion that shows these values."""


@dataclass(frozen=True, eq=False)
class ApexHistory(Observation):
    """The apex over time_ms [n]; noise_mm: standard deviation of a value; whole: whether it holds the retreat."""

    time_ms: np.ndarray = field(default_factory=lambda: np.empty(0))
    noise_mm: float = 0.01
    whole: bool = False
    kind = "apex history"

    @property
    def retreats(self) -> bool:
        return self.whole

    def predict(self, motion: Motion) -> np.ndarray:
        found = np.interp(self.time_ms, motion.time_ms, motion.apex_mm, right=np.nan)
        return found + motion.retreat_mm(self.time_ms) if self.whole else found

    def noise(self) -> np.ndarray:
        return self.noise_mm**2 * np.eye(len(self.values))

    def model_error(self, model: ModelError, shown: np.ndarray) -> np.ndarray:
        size = model.history_mm * errors.envelope(shown)
        apart = self.time_ms[:, None] - self.time_ms
        passing = size[:, None] * size * errors.correlation(apart, errors.TIME_MS)
        pace = np.gradient(moving(self.time_ms, shown, self.time_ms, 1.0, 2), self.time_ms)
        return passing + model.history_mm**2 * errors.lasting(shown, pace)


@dataclass(frozen=True, eq=False)
class ReadDeflection(ApexHistory):
    """The apex's deflection, read as films are."""

    kind = "deflection history"

    def predict(self, motion: Motion) -> np.ndarray:
        if motion.deflection_mm is None:
            return np.full(len(self.values), np.nan)
        apex = np.abs(grid()) <= APEX_MM + 1e-9
        return _at(motion.frame_ms, motion.deflection_mm[:, apex].mean(axis=1), self.time_ms)

    def noise(self) -> np.ndarray:
        return super().noise() + _reading(self.values, self.time_ms[:, None] - self.time_ms)


@dataclass(frozen=True, eq=False)
class FilmSurface(Observation):
    """The deflection over frames and stations, both sides' mean, as one row of values: time_ms, x_mm [n]; noise_mm."""

    time_ms: np.ndarray = field(default_factory=lambda: np.empty(0))
    x_mm: np.ndarray = field(default_factory=lambda: np.empty(0))
    noise_mm: float = 0.002
    kind = "film"

    def predict(self, motion: Motion) -> np.ndarray:
        if motion.deflection_mm is None:
            return np.full(len(self.values), np.nan)
        found, map_mm = np.empty(len(self.values)), stations(grid(), motion.deflection_mm)
        for k, x in enumerate(STATIONS_MM):
            here = self.x_mm == x
            found[here] = _at(motion.frame_ms, map_mm[:, k], self.time_ms[here])
        return found

    def noise(self) -> np.ndarray:
        white = self.noise_mm**2 * np.eye(len(self.values))
        return white + _reading(self.values, self.time_ms[:, None] - self.time_ms, self.x_mm[:, None] - self.x_mm)

    def model_error(self, model: ModelError, shown: np.ndarray) -> np.ndarray:
        apex = self.x_mm == 0.0
        depth = np.interp(self.time_ms, self.time_ms[apex], shown[apex])
        size = model.history_mm * errors.envelope(depth)
        along = errors.correlation(self.x_mm[:, None] - self.x_mm, errors.REACH_MM)
        return size[:, None] * size * errors.correlation(self.time_ms[:, None] - self.time_ms, errors.TIME_MS) * along


@dataclass(frozen=True, eq=False)
class ParameterRow(Observation):
    """Parameters of one examination, by `names` [n]; deviations [n]: of measuring. interval_ms: of the camera.

    air_mmhg: the pressure of the air that the instrument takes for SP-A1; age_years: that it has been told.
    """

    names: tuple[str, ...] = ()
    deviations: np.ndarray = field(default_factory=lambda: np.empty(0))
    interval_ms: float = 0.2315
    air_mmhg: Callable[[float], float] | None = None
    age_years: float = 70.0
    kind = "parameters"
    unit = ""
    retreats = True

    def predict(self, motion: Motion) -> np.ndarray:
        if motion.curves is None:
            return np.full(len(self.names), np.nan)
        found = respond(motion.curves, self.interval_ms, puff_mmhg=self.air_mmhg, age_years=self.age_years)
        if motion.stopped:
            return np.full(len(self.names), np.nan)
        return np.array([np.nan if (value := getattr(found, name)) is None else value for name in self.names])

    def noise(self) -> np.ndarray:
        return np.diag(self.deviations**2)

    def model_error(self, model: ModelError, shown: np.ndarray) -> np.ndarray:
        return np.diag([model.of(name, value) ** 2 for name, value in zip(self.names, shown)])


def of_history(
    name: str, time_ms, values_mm, whole: bool, noise_mm: float | None = None, read: bool = False, notes=()
) -> ApexHistory:
    """A history, thinned to a camera's pace; its noise from itself where it is not given. read: as films are."""
    time_ms, values_mm = np.asarray(time_ms, float), np.asarray(values_mm, float)
    if noise_mm is None:
        noise_mm = max(scatter(time_ms, values_mm), LEAST_NOISE_MM)
    keep = _paced(time_ms)
    time_ms, values_mm = time_ms[keep], values_mm[keep]
    build = ReadDeflection if read else ApexHistory
    return build(name, values_mm, phases(time_ms, values_mm), {}, tuple(notes), time_ms, noise_mm, whole)


def of_film(name: str, seen: Histories, shown: dict[str, Known], notes=()) -> FilmSurface:
    """The deflection that a film shows."""
    map_mm = stations(seen.x_mm, seen.deflection_mm)
    time = np.repeat(seen.time_ms, len(STATIONS_MM))
    x = np.tile(np.array(STATIONS_MM), len(seen.time_ms))
    values = map_mm.ravel()
    good = np.isfinite(values)
    noise = max(scatter(seen.time_ms, column) for column in map_mm.T)
    top = np.nanmax(map_mm, axis=1)
    groups = np.repeat(phases(seen.time_ms, top), len(STATIONS_MM))
    return FilmSurface(
        name, values[good], groups[good], shown, tuple(notes), time[good], x[good], max(noise, LEAST_NOISE_MM)
    )


def of_row(row: Row, interval_ms: float, air_mmhg, age_years: float, shown: dict[str, Known]) -> ParameterRow:
    """A row of a table."""
    names = tuple(row.values)
    return ParameterRow(
        row.label,
        np.array([row.values[name] for name in names]),
        np.array(names),
        shown,
        row.notes,
        names,
        np.array([REPEATABILITY[name][0] for name in names]),
        interval_ms,
        air_mmhg,
        age_years,
    )


def stations(x_mm: np.ndarray, deflection_mm: np.ndarray) -> np.ndarray:
    """A deflection at STATIONS_MM, the mean of both sides, [frames, stations]; NaN where neither is seen."""
    columns = []
    for x in STATIONS_MM:
        near = np.abs(np.abs(x_mm) - x) <= STATION_HALF_MM + 1e-9
        part = deflection_mm[:, near]
        good = np.isfinite(part)
        total = np.where(good, part, 0.0).sum(axis=1)
        columns.append(np.where(good.sum(axis=1) > 0, total / np.maximum(good.sum(axis=1), 1), np.nan))
    return np.array(columns).T


def phases(time_ms: np.ndarray, depth_mm: np.ndarray) -> np.ndarray:
    """The part of the puff that each value shows."""
    top = int(np.nanargmax(depth_mm))
    high, low = (share * depth_mm[top] for share in SHARES)
    deep = np.flatnonzero(depth_mm >= high)
    moved = np.flatnonzero(depth_mm >= low)
    number = np.arange(len(depth_mm))
    out = np.full(len(depth_mm), "inwards", dtype=object)
    out[number < moved[0]] = "first motion"
    out[(number >= deep[0]) & (number <= deep[-1])] = "deepest"
    out[number > deep[-1]] = "outwards"
    out[number > moved[-1]] = "after the puff"
    return out


def scatter(time_ms: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of the noise of a history, from the scatter of its third differences; 0 where too short."""
    good = np.isfinite(values)
    time_ms, values = time_ms[good], values[good]
    if len(values) < 12:
        return 0.0
    steps = np.diff(time_ms)
    usual = np.abs(steps / np.median(steps) - 1.0) < 0.1
    third = np.diff(values, 3)[usual[:-2] & usual[1:-1] & usual[2:]]
    return 1.4826 * float(np.median(np.abs(third))) / np.sqrt(20.0) if len(third) >= 8 else 0.0


def _paced(time_ms: np.ndarray) -> np.ndarray:
    """Numbers of the samples that are kept of a history: all, or those a camera would take."""
    if len(time_ms) <= SAMPLES_MOST:
        return np.arange(len(time_ms))
    step = max(STEP_MS, (time_ms[-1] - time_ms[0]) / SAMPLES_MOST)
    return np.unique(np.searchsorted(time_ms, np.arange(time_ms[0], time_ms[-1], step)))


def _at(time_ms: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Values between frames; NaN beyond the last one."""
    good = np.isfinite(values)
    if good.sum() < 4:
        return np.full(len(wanted), np.nan)
    found = CubicSpline(time_ms[good], values[good])(wanted)
    return np.where(wanted <= time_ms[good][-1] + 1e-6, found, np.nan)


def _reading(values: np.ndarray, apart_ms: np.ndarray, apart_mm: np.ndarray | float = 0.0) -> np.ndarray:
    """Covariance of what a film's reading gets wrong for longer than a frame."""
    stays = errors.correlation(apart_ms, errors.TIME_MS) * errors.correlation(np.asarray(apart_mm), errors.REACH_MM)
    return READING_MM**2 * stays + READING_SHARE**2 * np.outer(values, values) * stays
