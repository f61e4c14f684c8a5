"""The numerical error of a run's apex history and of every figure read from it, by its coarser twin.

estimate    share times run less twin (`taichi_eye.ladder.twin`), at each instant, and each place of the curves; run
            plus estimate is Richardson's limit, "extrapolated".
band        of the history: SAFETY times the largest estimate within NEAR_MS, for where two runs cross their difference
            tells nothing; at least LEAST_SHARE of the largest band.
bar         of a figure: how far it moves where SAFETY times the estimate is added to what it is read from: in its own
            place, and some time early or late, whichever moves it most, for a figure that the estimate happens to
            leave where it is would seem exact. Parameters are read through windows of +-0.7 ms and more, which blur
            what is quicker: once CURVES_LATE_MS will do; those of a history from single samples: HISTORY_LATE_MS. The
            step of the grid that a figure is looked for on is added.

A bar is numerical error alone: how far the run is from its own rung's limit of no spacing and infinite sound speed. The
error of the model is not in it. Pressures have none: the sound that rings in the resolved liquid is no weaker in a
finer run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from taichi_eye.analysis.response import READS_TO, Response
from taichi_eye.analysis.simulated import Observed
from taichi_eye.ladder.twin import Twin
from taichi_eye.report.history import summarise
from taichi_eye.units import MM, MS

SAFETY = 2.0
NEAR_MS, LEAST_SHARE = 2.5, 0.1
CURVES_LATE_MS, HISTORY_LATE_MS = (0.5,), (0.25, 0.5, 0.75, 1.0)

Figures = dict[str, float | None]


@dataclass(frozen=True)
class Bars:
    """Figures by name: their values, error bars and extrapolated values; None where the eye does not show one."""

    values: Figures = field(default_factory=dict)
    errors: Figures = field(default_factory=dict)
    extrapolated: Figures = field(default_factory=dict)


@dataclass(frozen=True)
class ErrorBar:
    """What a twin tells about a run.

    time_ms, apex_mm, band_mm, extrapolated_mm [samples]: the apex history, its error at each instant and its limit.
    apex, deformation: figures of the apex displacement and of the whole deformation; response: the clinical parameters,
    empty where the film has too few frames.
    """

    twin: Twin
    time_ms: np.ndarray
    apex_mm: np.ndarray
    band_mm: np.ndarray
    extrapolated_mm: np.ndarray
    apex: Bars
    deformation: Bars
    response: Bars


def error_bar(twin: Twin, run: Observed, coarse: Observed) -> ErrorBar:
    """The error bar of a run by its twin's; ValueError where one of them did not get to its end."""
    for one in (run, coarse):
        if one.outcome.stop is not None:
            raise ValueError(str(one.outcome.stop))
    time, share = run.outcome.traces["time_ms"], twin.share
    apex, other = (one.outcome.traces["apex_displacement_mm"] for one in (run, coarse))
    estimate = share * (apex - other)
    retreat = run.eye.retreat(time * MS) / MM
    return ErrorBar(
        twin,
        time,
        apex,
        band(time, estimate),
        apex + estimate,
        bars(lambda values: history_figures(time, values), time, apex, estimate),
        bars(lambda values: history_figures(time, values + retreat, whole=False), time, apex, estimate),
        _of_response(run, coarse, share),
    )


def history_figures(time_ms: np.ndarray, values: np.ndarray, whole: bool = True) -> Figures:
    """The figures of a history by their names in a summary; whole: not only those of its peak."""
    found = summarise(time_ms, values)
    peak = {"peak": found.peak, "peak_time_ms": found.peak_time_ms}
    halves = {"half_rise_ms": found.half_rise_ms, "half_fall_ms": found.half_fall_ms}
    return {**peak, **halves, "fwhm_ms": found.fwhm_ms, "fall_to_rise": found.fall_to_rise} if whole else peak


def band(time_ms: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """The error of a history at each instant from its estimate."""
    near = 2 * round(NEAR_MS / (time_ms[1] - time_ms[0])) + 1
    wide = SAFETY * maximum_filter1d(np.abs(estimate), near, mode="nearest")
    return np.maximum(wide, LEAST_SHARE * wide.max())


def bars(
    read: Callable[[np.ndarray], Figures],
    time_ms: np.ndarray,
    run: np.ndarray,
    estimate: np.ndarray,
    late_ms: tuple[float, ...] = HISTORY_LATE_MS,
    steps: dict[str, float] | None = None,
) -> Bars:
    """The bars of what is read from a run and its estimate, arrays [times, ...]; steps: of the grids of the reading."""
    values, rows = read(run), [round(late / (time_ms[1] - time_ms[0])) for late in late_ms]
    moved = [read(run + SAFETY * _late(estimate, by)) for by in (0, *rows, *(-row for row in rows))]
    errors: Figures = {}
    for name, value in values.items():
        others = [one[name] for one in moved]
        shown = value is not None and None not in others
        step = (steps or {}).get(name, 0.0)
        errors[name] = max(abs(other - value) for other in others) + step if shown else None
    return Bars(values, errors, read(run + estimate))


def _of_response(run: Observed, coarse: Observed, share: float) -> Bars:
    curves, other = run.curves, coarse.curves
    if curves is None or other is None:
        return Bars()

    def read(height: np.ndarray) -> Figures:
        response: Response = run.response(replace(curves, height_mm=height))
        return {name: value for name, value in asdict(response).items() if name != "central_thickness_um"}

    estimate = share * (curves.height_mm - other.height_mm)
    return bars(read, curves.time_ms, curves.height_mm, estimate, CURVES_LATE_MS, READS_TO)


def _late(estimate: np.ndarray, by: int) -> np.ndarray:
    """The estimate so many rows late, held at its end."""
    return estimate[np.clip(np.arange(len(estimate)) - by, 0, len(estimate) - 1)]
