"""Continuity in time: a frame's curve follows from its neighbours', or the frame is damaged.

Four straight lines through pairs of neighbours foretell each curve, with room for acceleration over the time between
them, so that missing frames and a snap cost nothing. A curve that strays from at least three of them is dropped, the
worst first, and the rest judged anew.
"""

from __future__ import annotations

import numpy as np

STRAY_MM = 0.06  # upper quartile over the columns, from what the neighbours foretell
SPEEDING_MM_MS2 = 0.5  # acceleration of a surface that neighbours leave room for
KEPT_MIN = 0.5  # share of the frames; fewer are no film, and not looked at further
EVERY = 8  # columns looked at
FOUND_MIN = 0.3  # share of the columns that two curves must share
PAIRS = (-1, 1), (-2, 2), (-2, -1), (1, 2)


def following(time_ms: np.ndarray, height_mm: np.ndarray) -> np.ndarray:
    """Which frames [frames] follow from their neighbours, bool; heights [frames, columns] may hold NaN."""
    kept = np.arange(len(time_ms))
    part = height_mm[:, ::EVERY]
    while len(kept) > max(5, KEPT_MIN * len(time_ms)):
        stray = _strays(time_ms[kept], part[kept])
        worst = int(np.argmax(stray))
        if not stray[worst] > STRAY_MM:
            break
        kept = np.delete(kept, worst)
    good = np.zeros(len(time_ms), bool)
    good[kept] = True
    return good


def _strays(time: np.ndarray, height: np.ndarray) -> np.ndarray:
    """How far each curve [mm] is from the second nearest of what its neighbours foretell."""
    count = len(time)
    at = np.arange(count)
    strays = []
    for pair in PAIRS:
        # at the ends of the film the pairs lie on one side
        a, b = (at + shift for shift in pair)
        over = np.maximum(b - (count - 1), 0) + np.minimum(a, 0)
        a, b = a - over, b - over
        a, b = (np.where(one == at, np.where(at < 3, at + 3, at - 3), one) for one in (a, b))
        share = ((time - time[a]) / (time[b] - time[a]))[:, None]
        room = 0.5 * SPEEDING_MM_MS2 * np.abs((time - time[a]) * (time - time[b]))
        off = np.abs(height - (1.0 - share) * height[a] - share * height[b])
        seen = np.isfinite(off).mean(axis=1) > FOUND_MIN
        off = np.nanpercentile(np.where(seen[:, None], off, 0.0), 75, axis=1) - room
        strays.append(np.where(seen, off, 0.0))
    return np.sort(np.stack(strays), axis=0)[1]
