"""The load: air pressure on the cornea over time and place.

Pressure on a material point of reference radius r at time t is p(t) f(r), over atmosphere. Time courses p:

gaussian  Eq. 2 of Montanino, Angelillo and Pandolfi: pmax exp(-b (2t - T)^2/(4 T^2)). With their T = 30 ms, b = 25 and
          pmax = 10 kPa it is centred at 15.00 ms with a standard deviation of 4.243 ms and a full width at half maximum
          of 9.99 ms, and 19 Pa are left at t = 0.
corvis    Measured course of the Corvis ST, fitted within 1.7 % rms: exp(-(|t - 16.15|/8.00)^2.59) before 16.15 ms,
          exp(-((t - 16.15)/4.175)^1.547) after (t in ms); full width at half maximum 10.24 ms, measured 10.4. The
          instrument's central pressure is 96.4 +- 1.4 mmHg, 12.85 kPa (Oehring 2021, doi 10.3390/app11062499).
file      The user's table, linear between its rows and zero outside.

Radial profiles f, fixed to the material points of the reference cap (r = R sin phi):

paper     exp(-a sin^2 phi), same eq. 2; with a = 21.5 and R = 7.8 mm half the pressure is left at r = 1.40 mm, and the
          peak force along the axis is 0.0889 N at 10 kPa.
gaussian  exp(-r^2/w^2).

Either is that on a flat wall where the air feels the dent (`taichi_eye.eye.jet`).

A solver takes integrals, exact where a pulse is shorter than its step or a spot narrower than its element: of p over
the time that a step stands for, so that the impulse is whole, and the mean of f over the ring of a node, so that the
force is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.eye import jet
from taichi_eye.scene.table import read_puff_file
from taichi_eye.units import KPA, MS

CORVIS_PEAK_S = 16.15 * MS
CORVIS_RISE = 8.00 * MS, 2.59  # width, power
CORVIS_FALL = 4.175 * MS, 1.547


@dataclass(frozen=True)
class Puff:
    """Pressure of the air puff, in SI.

    peak: the largest pressure, of a user's samples, too; radial_rate: the profile is exp(-radial_rate r^2) [1/m^2];
    samples: the user's times [s] and pressures [Pa]; dent_feedback: c of `taichi_eye.eye.jet`.
    """

    time_course: str
    peak: float
    duration: float
    spread_b: float
    radial_rate: float
    samples: tuple[np.ndarray, np.ndarray] | None = None
    dent_feedback: float = 0.0

    def pressure_at_apex(self, t: ArrayLike) -> np.ndarray:
        """Pressure [Pa] over atmosphere at the apex at time t [s]; any shape."""
        t = np.asarray(t, dtype=float)
        if self.samples is not None:
            return np.interp(t, *self.samples, left=0.0, right=0.0)
        if self.time_course == "corvis":
            late = t - CORVIS_PEAK_S
            width, power = (np.where(late < 0.0, *pair) for pair in zip(CORVIS_RISE, CORVIS_FALL))
            return self.peak * np.exp(-((np.abs(late) / width) ** power))
        return self.peak * np.exp(-self.spread_b * ((2.0 * t - self.duration) / (2.0 * self.duration)) ** 2)

    def impulse_at_apex(self, edges: ArrayLike) -> np.ndarray:
        """Integral [Pa s] of the pressure at the apex between each two of the times `edges` [..., n + 1] (s)."""
        edges = np.asarray(edges, dtype=float)
        if self.samples is not None or self.time_course != "corvis":
            passed = self._impulse(edges)
            return passed[..., 1:] - passed[..., :-1]
        # it lasts milliseconds: over steps, Simpson's rule is right to 1e-8 even across its cusp
        start, end = edges[..., :-1], edges[..., 1:]
        middle = self.pressure_at_apex(0.5 * (start + end))
        return (end - start) * (self.pressure_at_apex(start) + 4.0 * middle + self.pressure_at_apex(end)) / 6.0

    def _impulse(self, t: np.ndarray) -> np.ndarray:
        """Integral [Pa s] of the pressure at the apex up to t [s], from wherever."""
        if self.samples is None:
            steep = np.sqrt(self.spread_b)
            passed = _erf(steep * (t / self.duration - 0.5)).astype(float)
            return self.peak * self.duration * (0.5 * math.sqrt(math.pi) / steep) * passed
        times, pressures = self.samples
        gone = np.append(0.0, np.cumsum(0.5 * np.diff(times) * (pressures[1:] + pressures[:-1])))
        within = np.clip(t, times[0], times[-1])
        row = np.clip(np.searchsorted(times, within, side="right") - 1, 0, len(times) - 1)
        return gone[row] + 0.5 * (within - times[row]) * (pressures[row] + np.interp(within, times, pressures))

    def radial(self, r: ArrayLike, curvature: float = 0.0) -> np.ndarray:
        """Share of the apex pressure, without unit, on material points of reference radius r [m]; any shape.

        curvature [1/m]: of the wall under the jet, convex positive; felt with dent_feedback alone.
        """
        return np.exp(-self._rate(curvature) * np.square(np.asarray(r, dtype=float)))

    def on_rings(self, r: np.ndarray, curvature: float = 0.0) -> np.ndarray:
        """The mean of `radial` over the ring of each node of reference radii r [n] (m), from 0 to the rim."""
        edges = jet.ring_edges(np.asarray(r, dtype=float))
        return jet.mean_over_ring(self._rate(curvature), edges[:-1], edges[1:])

    def _rate(self, curvature: float) -> float:
        narrow = jet.narrowing(self.dent_feedback, curvature) if self.dent_feedback else 1.0
        return self.radial_rate * narrow**2


_erf = np.frompyfunc(math.erf, 1, 1)  # scipy's takes a tenth of a second to load


def read_puff(file: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and pressures [Pa] of a user's puff; SceneError on a bad file."""
    time_ms, pressure_kpa = read_puff_file(Path(file))
    return time_ms * MS, pressure_kpa * KPA


class Puffs:
    """The puffs of several eyes, evaluated together: those of one time course in one go."""

    def __init__(self, puffs: Sequence[Puff]):
        courses: dict[object, list[int]] = {}
        for eye, puff in enumerate(puffs):
            courses.setdefault(puff.time_course if puff.samples is None else eye, []).append(eye)
        self._groups = []
        for eyes in courses.values():
            if puffs[eyes[0]].samples is not None:
                self._groups.append((eyes, puffs[eyes[0]]))
                continue
            column = lambda name, eyes=eyes: np.array([[getattr(puffs[eye], name)] for eye in eyes])
            self._groups.append(
                (
                    eyes,
                    replace(
                        puffs[eyes[0]],
                        **{name: column(name) for name in ("peak", "duration", "spread_b", "radial_rate")},
                    ),
                )
            )

    def impulse_at_apex(self, edges: np.ndarray) -> np.ndarray:
        """Integral [Pa s] of the pressure at the apex of each eye between its times [eyes, n + 1] (s)."""
        if len(self._groups) == 1:
            return self._groups[0][1].impulse_at_apex(edges)
        impulse = np.empty((len(edges), edges.shape[1] - 1))
        for eyes, puff in self._groups:
            impulse[eyes] = puff.impulse_at_apex(edges[eyes])
        return impulse
