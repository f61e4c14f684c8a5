"""Delay and asymmetry of a history with one hump, by several measures that do not hang on a flat top.

The dent's top is flat (it stays within 1 % of its peak for 1.6 ms), so the time of the highest sample is ill
conditioned. Everything below works on the hump: the samples about the highest one down to `FOOT` of the peak on either
side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

FOOT = 0.1  # of the peak: what lies below belongs to the tails
TOP = 0.9  # of the peak: samples above it carry the fit of the peak's time
CHORD_MS = 0.2  # over which speeds are taken, about one frame of the camera
FINE_MS = 0.01  # spacing of the grid that histories are compared on


@dataclass(frozen=True)
class Measures:
    """Times in ms, values in the unit of the history, speeds in that unit per ms; the history must rise and fall.

    peak, peak_time_ms: of a quartic fitted to the samples above 90 % of the peak. half_rise_ms, half_fall_ms: at half
    the peak; midpoint_ms: midway between them. centroid_ms, skewness: of what stands above 10 % of the peak.
    speed_in, speed_out: largest rise and fall over 0.2 ms. fall_to_rise: (fall - peak)/(peak - rise).
    speed_ratio: speed_out / speed_in. odd_share: rms of the odd part about the midpoint over the rms of the whole.
    """

    peak: float
    peak_time_ms: float
    half_rise_ms: float
    half_fall_ms: float
    centroid_ms: float
    skewness: float
    speed_in: float
    speed_out: float
    odd_share: float

    @property
    def midpoint_ms(self) -> float:
        return 0.5 * (self.half_rise_ms + self.half_fall_ms)

    @property
    def fall_to_rise(self) -> float:
        return (self.half_fall_ms - self.peak_time_ms) / (self.peak_time_ms - self.half_rise_ms)

    @property
    def speed_ratio(self) -> float:
        return self.speed_out / self.speed_in


def measure(time_ms: ArrayLike, values: ArrayLike) -> Measures | None:
    """Measures of `values`, shape [samples], at increasing `time_ms`; None where the hump has no end on either side."""
    t, v = np.asarray(time_ms, dtype=float), np.asarray(values, dtype=float)
    top = int(np.argmax(v))
    low = np.flatnonzero(v < FOOT * v[top])
    if not v[top] > 0.0 or not len(low[low < top]) or not len(low[low > top]):
        return None
    first, last = low[low < top][-1], low[low > top][0]
    t, v = t[first : last + 1], v[first : last + 1]
    peak_time, peak = _top(t, v)
    rise, fall = _crossings(t, v, 0.5 * peak)
    grid = np.arange(t[0], t[-1], FINE_MS)
    above = np.maximum(np.interp(grid, t, v) - FOOT * peak, 0.0)
    centroid = float(np.sum(grid * above) / np.sum(above))
    spread = np.sum((grid - centroid) ** 2 * above) / np.sum(above)
    skewness = np.sum((grid - centroid) ** 3 * above) / np.sum(above) / spread**1.5
    slope = (np.interp(grid + 0.5 * CHORD_MS, t, v) - np.interp(grid - 0.5 * CHORD_MS, t, v)) / CHORD_MS
    inner = slice(int(0.5 * CHORD_MS / FINE_MS) + 1, -int(0.5 * CHORD_MS / FINE_MS) - 1)
    middle = 0.5 * (rise + fall)
    arm = np.arange(0.0, min(middle - t[0], t[-1] - middle), FINE_MS)
    later, earlier = np.interp(middle + arm, t, v), np.interp(middle - arm, t, v)
    odd = np.sqrt(np.sum((later - earlier) ** 2) / (2.0 * np.sum(later**2 + earlier**2)))
    return Measures(
        peak,
        peak_time,
        rise,
        fall,
        centroid,
        float(skewness),
        float(slope[inner].max()),
        float(-slope[inner].min()),
        float(odd),
    )


def _top(t: np.ndarray, v: np.ndarray) -> tuple[float, float]:
    """Time and height of the top of a quartic through the samples above `TOP` of the highest, in one stretch."""
    top = int(np.argmax(v))
    below = np.flatnonzero(v < TOP * v[top])
    first, last = below[below < top].max() + 1, below[below > top].min()
    at, values = t[first:last], v[first:last]
    if len(at) < 7:
        return float(t[top]), float(v[top])
    middle, half = 0.5 * (at[0] + at[-1]), 0.5 * (at[-1] - at[0])
    fit = np.polynomial.Polynomial.fit((at - middle) / half, values, 4, domain=[-1, 1])
    x = np.linspace(-1.0, 1.0, 20001)
    best = int(np.argmax(fit(x)))
    return float(middle + half * x[best]), float(fit(x[best]))


def _crossings(t: np.ndarray, v: np.ndarray, level: float) -> tuple[float, float]:
    """The last upward crossing of `level` before the highest sample and the first downward one after it."""
    top = int(np.argmax(v))
    low = np.flatnonzero(v < level)
    i, j = low[low < top][-1], low[low > top][0]
    rise = t[i] + (level - v[i]) / (v[i + 1] - v[i]) * (t[i + 1] - t[i])
    fall = t[j - 1] + (level - v[j - 1]) / (v[j] - v[j - 1]) * (t[j] - t[j - 1])
    return float(rise), float(fall)


def lag_of_best_match(time_ms: ArrayLike, later: ArrayLike, earlier: ArrayLike, reach_ms: float = 5.0) -> float:
    """The lag [ms] of `later` behind `earlier` at which their cross-correlation is largest, within +- reach_ms."""
    t = np.asarray(time_ms, dtype=float)
    grid = np.arange(t[0], t[-1], FINE_MS)
    ends = {"left": 0.0, "right": 0.0}
    lags = np.arange(-reach_ms, reach_ms + FINE_MS, FINE_MS)
    late = np.interp(grid, t, later)
    match = np.array([np.sum(late * np.interp(grid - lag, t, earlier, **ends)) for lag in lags])
    k = int(np.clip(np.argmax(match), 1, len(lags) - 2))
    bend = match[k - 1] - 2.0 * match[k] + match[k + 1]
    return float(lags[k] + (0.5 * FINE_MS * (match[k - 1] - match[k + 1]) / bend if bend < 0.0 else 0.0))
