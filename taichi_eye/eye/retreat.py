"""Retreat of the whole eye in its socket under the puff.

The course is the mean of three eyes, digitised from public recordings for this project: 0.02 to 0.03 mm by 5.5 ms, a
third of the peak by 9 ms, the peak (0.29 to 0.42 mm) at 19.4 to 20.3 ms, then back, nearly linearly from 23 to 30 ms.
The globe is heavy and slow (some m/s^2), so the retreat is added to what is filmed and does not enter the coupled
problem: the membrane moves relative to its limbus, the camera sees both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.units import MS

COURSE_MS = 0.0, 3.0, 5.5, 7.0, 9.0, 11.0, 13.0, 15.0, 17.0, 19.0, 20.0, 21.5, 23.0, 26.0, 28.0, 30.0, 34.0
COURSE = 0.0, 0.02, 0.065, 0.155, 0.30, 0.37, 0.41, 0.51, 0.71, 0.94, 1.0, 0.89, 0.76, 0.50, 0.26, 0.10, 0.0


@cache
def _course():
    # scipy's interpolation takes half a second to load, and few scenes need it
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(COURSE_MS, COURSE, extrapolate=False)


@dataclass(frozen=True)
class Retreat:
    """The whole eye's retreat; peak: the largest [m], 0 where the eye stays."""

    peak: float = 0.0

    def __call__(self, time: ArrayLike) -> np.ndarray:
        """How far the globe has retreated [m] at times [s], any shape; 0 outside the course."""
        time = np.asarray(time, dtype=float)
        if self.peak == 0.0:
            return np.zeros_like(time)
        return self.peak * np.nan_to_num(_course()(time / MS))
