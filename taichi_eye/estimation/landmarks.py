"""Landmarks of a history: when the apex passes given depths inwards and outwards, and how deep it goes.

Where a shell snaps, a little more pressure moves the snap by a little in time, and the depth at an instant beside it by
a lot: least squares of depths at instants see no slope that leads from one place of the snap to another, and stay
where they began. Times at depths change nearly in proportion to the unknowns. So the search begins with them, and ends
with the history itself once the two lie close.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.response import moving
from taichi_eye.estimation.motion import Motion
from taichi_eye.estimation.observation import ApexHistory, FilmSurface, Observation

SHARES = np.linspace(0.15, 0.9, 9)  # of the depth measured
TIME_SD_MS, DEPTH_SD_MM, LEVEL_SD_MM = 0.08, 0.01, 0.015  # what the cheapest model gets wrong, and what noise adds
SMOOTH_MS, FINE_MS = 0.6, 0.01


@dataclass(frozen=True, eq=False)
class Landmarks(Observation):
    """The landmarks of another observation: times in ms inwards and outwards by depth, then the depth in mm."""

    of: Observation | None = None
    levels_mm: np.ndarray | None = None
    deviations: np.ndarray | None = None
    kind = "landmarks"

    @property
    def retreats(self) -> bool:
        return self.of.retreats

    def predict(self, motion: Motion) -> np.ndarray:
        time, depth = _apex(self.of, self.of.predict(motion))
        return _passed(time, depth, self.levels_mm) if np.isfinite(depth).all() else np.full(len(self.values), np.nan)

    def noise(self) -> np.ndarray:
        return np.diag(self.deviations**2)

    def model_error(self, model, shown: np.ndarray) -> np.ndarray:
        return np.zeros((len(self.values),) * 2)


def landmarks_of(seen: Observation) -> Landmarks | None:
    """The landmarks of a history or a film; None of what has none."""
    if not isinstance(seen, ApexHistory | FilmSurface):
        return None
    time, depth = _apex(seen, seen.values)
    fine = np.arange(time[0], time[-1], 0.25 * SMOOTH_MS)
    smooth = moving(time, depth, fine, SMOOTH_MS, 2)
    levels = SHARES * smooth.max()
    found = _passed(fine, smooth, levels)
    # a level is passed as surely as the apex is fast there
    pace = np.abs(np.interp(found[:-1], fine, np.gradient(smooth, fine)))
    deviations = np.append(np.hypot(TIME_SD_MS, LEVEL_SD_MM / np.maximum(pace, 1e-3)), DEPTH_SD_MM)
    return Landmarks(seen.name, found, np.full(len(found), ""), {}, (), seen, levels, deviations)


def _apex(seen: Observation, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    here = seen.x_mm == 0.0 if isinstance(seen, FilmSurface) else slice(None)
    return seen.time_ms[here], values[here]


def _passed(time: np.ndarray, depth: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Times at which levels are first reached and last left, then the largest depth. A level that is not reached is
    passed at the deepest instant, so that all go on without a jump."""
    top = int(np.argmax(depth))
    inward, outward = np.maximum.accumulate(depth[: top + 1]), np.maximum.accumulate(depth[top:][::-1])
    steps = 1e-12 * np.arange(len(time))  # what stays level rises a little
    rise = np.interp(levels, inward + steps[: top + 1], time[: top + 1])
    fall = np.interp(levels, outward + steps[: len(outward)], time[top:][::-1])
    return np.concatenate([rise, fall, [depth[top]]])
