"""The numbers that describe a history with one hump: the apex displacement, or the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class History:
    """Summary of a history; times in ms, None where the history does not get there or never leaves zero.

    peak, peak_time_ms: of the parabola through the highest sample and its neighbours. half_rise_ms, half_fall_ms: last
    upward crossing of half the peak before it, first downward one after it, linear between samples. fwhm_ms: fall less
    rise. fall_to_rise: (fall - peak time)/(peak time - rise), 1 if symmetric.
    """

    peak: float
    peak_time_ms: float
    half_rise_ms: float | None
    half_fall_ms: float | None

    @property
    def fwhm_ms(self) -> float | None:
        if self.half_rise_ms is None or self.half_fall_ms is None:
            return None
        return self.half_fall_ms - self.half_rise_ms

    @property
    def fall_to_rise(self) -> float | None:
        if self.half_rise_ms is None or self.half_fall_ms is None:
            return None
        return (self.half_fall_ms - self.peak_time_ms) / (self.peak_time_ms - self.half_rise_ms)


def summarise(time_ms: ArrayLike, values: ArrayLike) -> History:
    """Summary of `values`, shape [samples], at increasing `time_ms`; at least one sample."""
    t, v = np.asarray(time_ms, dtype=float), np.asarray(values, dtype=float)
    top = int(np.argmax(v))
    peak_time, peak = _vertex(t, v, top)
    if not peak > 0.0:
        return History(float(peak), float(peak_time), None, None)
    half = 0.5 * peak
    below = np.flatnonzero(v < half)
    before, after = below[below < top], below[below > top]
    rise = _crossing(t, v, before[-1], half) if len(before) else None
    fall = _crossing(t, v, after[0] - 1, half) if len(after) else None
    return History(float(peak), float(peak_time), rise, fall)


def _vertex(t: np.ndarray, v: np.ndarray, top: int) -> tuple[float, float]:
    """Top of the parabola through three samples about the highest one; that sample itself at an end or a plateau."""
    if not 0 < top < len(t) - 1:
        return t[top], v[top]
    left, right = t[top] - t[top - 1], t[top + 1] - t[top]
    down_left, down_right = (v[top] - v[top - 1]) / left, (v[top] - v[top + 1]) / right
    curvature = (down_left + down_right) / (left + right)
    if curvature <= 0.0:
        return t[top], v[top]
    slope = (down_left * right - down_right * left) / (left + right)
    return t[top] + slope / (2.0 * curvature), v[top] + slope**2 / (4.0 * curvature)


def _crossing(t: np.ndarray, v: np.ndarray, i: int, level: float) -> float:
    """Where the line from sample i to i + 1 takes the value `level`."""
    return float(t[i] + (level - v[i]) / (v[i + 1] - v[i]) * (t[i + 1] - t[i]))
