"""The air jet on a wall that is not flat: its width follows the wall's curvature, one text for kernels and arrays.

A round jet of diameter D and speed U brings the momentum J = rho U^2 pi D^2 / 4 along its axis and stops on the wall
at the pressure p = rho U^2 / 2, so J = p pi D^2 / 2. A flat wall turns it by a right angle and takes all of it:
a load p exp(-r^2/w^2) has the force p pi w^2, whence w = D / sqrt 2, 1.70 mm for the nozzle of 2.4 mm. From a wall of
curvature kappa (convex positive) the air leaves along the wall, tilted at r = D by the angle kappa D: a convex wall
keeps the share sin(kappa D) of the momentum less, a dent throws it back and takes as much more,

    p pi w^2 = J (1 - sin(kappa D)),   w = w_flat (1 - kappa D / 2 + ...) = w_flat / (1 + c D kappa),   c ~ 1/2.

The force is at most twice the jet's momentum, all of it thrown back: the width stays below sqrt 2 w_flat. kappa is that
of the circle through the apex and the wall at the reference radius of the nozzle, D / 2.

The pressure at the apex stays the stagnation pressure. Flow computations (PMC6982245) find it 6.3 +- 2.2 % lower in a
dent; a jet of constant force, the other limit, would lose half of it there.
"""

import math

import numpy as np

from taichi_eye.eye.laws.law import plain
from taichi_eye.units import MM

NOZZLE = 2.4 * MM  # D
CHORD = 0.5 * NOZZLE  # reference radius at which the wall's curvature is read
WIDEST = math.sqrt(2.0)  # width over that on a flat wall, all momentum thrown back


THIN = 1e-3  # exponent across a ring below which a series gives its mean, right to 1e-13


def text(math, func):
    """Functions of numbers: the curvature [1/m] of a circle through the axis at height z0 [m] and through (r, z), its
    tangent level on the axis; what a curvature makes of 1/w, over that on a flat wall, with the feedback c; and the
    mean of exp(-rate r^2) over the ring between two radii."""

    @func
    def curvature(z0, r, z):
        sag = z0 - z
        return 2.0 * sag / (r * r + sag * sag)

    @func
    def narrowing(c, kappa):
        return math.max(1.0 + c * NOZZLE * kappa, 1.0 / WIDEST)

    @func
    def mean_over_ring(rate, inner, outer):
        # (1 - e^-x) / x of the exponent x across the ring, by its series where the difference would cancel
        x = rate * (outer * outer - inner * inner)
        y = math.max(x, THIN)
        mean = (1.0 - math.exp(-y)) / y + (y - x) / 2.0 - (y * y - x * x) / 6.0 + (y * y * y - x * x * x) / 24.0
        return math.exp(-rate * inner * inner) * mean

    return curvature, narrowing, mean_over_ring


class _Arrays:
    max, exp = np.maximum, np.exp


curvature, narrowing, mean_over_ring = text(_Arrays, plain)


def ring_edges(r: np.ndarray) -> np.ndarray:
    """Radii [n + 1] (m) between the rings of nodes at r [n], half an element to either side; the last ends at the
    rim."""
    return np.concatenate([r[:1], 0.5 * (r[1:] + r[:-1]), r[-1:]])


def chord_at(r: np.ndarray) -> tuple[int, float]:
    """The element in which CHORD lies and how far along it, of nodes of reference radii r [m]; the rim's where they
    end before. Its curvature is that of its two ends, in this share."""
    k = int(np.clip(np.searchsorted(r, CHORD) - 1, 1, len(r) - 2)) if len(r) > 2 else 0
    return k, float(np.clip((CHORD - r[k]) / (r[k + 1] - r[k]), 0.0, 1.0))


def central_curvature(place: np.ndarray, rest_r: np.ndarray) -> float:
    """Curvature [1/m] under the nozzle of a wall at `place` [n, 2] (m), its nodes of reference radii rest_r [n]."""
    k, share = chord_at(rest_r)
    at = [float(curvature(place[0, 1], *place[node])) for node in (k, k + 1)]
    return (1.0 - share) * at[0] + share * at[1]
