"""Refraction undone: from the posterior edge as the camera sees it to where it is.

The slit lights the plane y = 0; the camera looks under `angle_deg` to the axis in planes x = const, from far away. A
ray that enters the anterior surface at (x, y, z_a) is drawn where it would meet the lit plane unbent, at the apparent
height z_a - y / tan(angle). So the apparent height of a column gives y, Snell's law at that point of the surface the
bent ray, and where that ray meets the lit plane lies the posterior surface. For a flat surface apparent over true depth
is tan(asin(sin(angle)/n)) / tan(angle), 0.599 at 45 degrees and n 1.376. The surface off the lit plane is taken to
be that of revolution which each side of the section generates.
"""

from __future__ import annotations

from math import cos, radians, sin, tan

import numpy as np

ITERATIONS = 25
FOOT_WITHIN_MM = 1.5  # a posterior point's foot on the anterior surface is looked for so far to either side


def thickness(
    x_mm: np.ndarray,
    anterior_mm: np.ndarray,
    at_mm: np.ndarray,
    apparent_mm: np.ndarray,
    angle_deg: float,
    refractive_index: float,
) -> np.ndarray:
    """Thickness along the normal [mm] at `at_mm` [groups] in each frame, shape [frames, groups].

    x_mm [columns], even steps, 0 on the axis; anterior_mm [frames, columns] and apparent_mm [frames, groups] are
    heights (up is positive). NaN where an edge is missing.
    """
    angle = radians(angle_deg)
    cotangent, sine, cosine = 1.0 / tan(angle), sin(angle), cos(angle)
    ratio = 1.0 / refractive_index
    slope_mm = np.gradient(anterior_mm, x_mm, axis=1)
    side = np.where(at_mm < 0.0, -1.0, 1.0)
    y = np.zeros_like(apparent_mm)
    for _ in range(ITERATIONS):
        y = np.maximum((_sample(x_mm, anterior_mm, side * np.hypot(at_mm, y)) - apparent_mm) / cotangent, 0.0)
    rho = np.hypot(at_mm, y)
    z, slope = (_sample(x_mm, table, side * rho) for table in (anterior_mm, slope_mm))
    slope = side * slope  # outwards
    nz = 1.0 / np.hypot(1.0, slope)
    nx, ny = (-slope * nz * part / np.maximum(rho, 1e-9) for part in (at_mm, y))
    facing = ny * sine + nz * cosine
    bend = ratio * facing - np.sqrt(1.0 - ratio**2 * (1.0 - facing**2))
    tx, ty, tz = bend * nx, bend * ny - ratio * sine, bend * nz - ratio * cosine
    run = y / np.maximum(-ty, 1e-3)
    px, pz = at_mm + run * tx, z + run * tz
    best = np.full(apparent_mm.shape, np.inf)
    for k, x in enumerate(x_mm):
        gap = np.hypot(px - x, pz - anterior_mm[:, k : k + 1])
        best = np.fmin(best, np.where(np.abs(at_mm - x) < FOOT_WITHIN_MM, gap, np.inf))
    return np.where(np.isfinite(px + pz) & np.isfinite(best), best, np.nan)


def _sample(x: np.ndarray, table: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear interpolation of table [frames, columns] over even x at `at` [frames, groups], held at the ends."""
    t = np.clip((at - x[0]) / (x[1] - x[0]), 0.0, len(x) - 1.000001)
    k = np.nan_to_num(t).astype(int)
    low, high = np.take_along_axis(table, k, axis=1), np.take_along_axis(table, k + 1, axis=1)
    return low + (t - k) * (high - low)
