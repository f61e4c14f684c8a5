"""When a film passes first applanation, highest concavity and second applanation, told while it is drawn.

A1 and A2 are where the curvature of the central 2 mm crosses zero, linear between frames; HC is the frame before the
apex, whole-eye movement included, first comes back by BACK_MM. The clinic's parameters are read from the whole film,
smoothed over frames (`taichi_eye.analysis.response`): their times differ by less than a frame.
"""

from __future__ import annotations

import numpy as np

from taichi_eye.units import MM

CENTRAL_MM = 1.0
BACK_MM = 2e-3
DENT_MM = 0.05  # of the apex, before which nothing is an applanation


class Marks:
    """What has been passed so far; every frame is shown to `see` once, in order."""

    def __init__(self):
        self.times_ms: dict[str, float] = {}
        self._before: tuple[float, float] | None = None  # time, curvature
        self._top, self._top_ms, self._rest = -np.inf, 0.0, 0.0

    def see(self, time_ms: float, wall: np.ndarray, retreat_mm: float) -> str:
        """Take a frame: the wall's places (r, z) [m], [nodes, 2]. What is passed by now, in a line."""
        bend = curvature(wall / MM)
        height = float(wall[0, 1]) / MM
        if self._before is None:
            self._rest = height
        deep = self._rest - height + retreat_mm
        before, self._before = self._before, (time_ms, bend)
        if deep > self._top:
            self._top, self._top_ms = deep, time_ms
        elif "A1" in self.times_ms and deep < self._top - BACK_MM:
            self.times_ms.setdefault("HC", self._top_ms)
        if before is not None and self._top > DENT_MM:
            crossing = (
                before[0] + (time_ms - before[0]) * before[1] / (before[1] - bend) if bend != before[1] else time_ms
            )
            if before[1] > 0.0 >= bend:
                self.times_ms.setdefault("A1", crossing)
            elif before[1] < 0.0 <= bend and "HC" in self.times_ms:
                self.times_ms.setdefault("A2", crossing)
        return "  ".join(f"{name} {self.times_ms[name]:.1f}" for name in ("A1", "HC", "A2") if name in self.times_ms)


def curvature(wall_mm: np.ndarray) -> float:
    """Curvature on the axis [1/mm], convex positive, of the parabola through the central nodes of (r, z)."""
    r, z = wall_mm[:, 0], wall_mm[:, 1]
    near = max(int((r <= CENTRAL_MM).sum()), 3)
    square = r[:near] ** 2
    off = square - square.mean()
    return float(-2.0 * (off @ z[:near]) / (off @ off))
