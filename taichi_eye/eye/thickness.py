"""Thickness of the cornea over the radius, and the prestrain that goes with it.

h(r) = h0 + (h1 - h0) (r/a)^2 from the axis to the rim at radius a; healthy corneas measure about 0.55 mm at the centre
and 0.67 mm near the rim. The membrane at rest is a sphere under a uniform tension IOP R/2, so where it is thicker its
stress is lower and its prestrain smaller.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.scene import Scene
from taichi_eye.scene.calibration import rest_stress, solve_prestrain
from taichi_eye.units import MM, MMHG


def thickness(scene: Scene, r: ArrayLike) -> np.ndarray:
    """Thickness [m] at reference radii r [m], that of the rim beyond it."""
    cornea = scene.cornea
    share = np.minimum(np.abs(np.asarray(r, dtype=float)) / (cornea.limbus_radius_mm * MM), 1.0) ** 2
    return (cornea.thickness_mm + (cornea.limbus_thickness_mm - cornea.thickness_mm) * share) * MM


def prestrain(scene: Scene, r: ArrayLike) -> np.ndarray:
    """Prestrain eps0 at reference radii r [m] that carries the IOP there; the scene's own where h is uniform."""
    cornea = scene.cornea
    r = np.asarray(r, dtype=float)
    if cornea.limbus_thickness_mm == cornea.thickness_mm:
        return np.full(r.shape, cornea.prestrain)
    iop, radius = scene.eye.iop_mmhg * MMHG, cornea.radius_mm * MM
    return np.array(
        [
            solve_prestrain(rest_stress(iop, radius, h), cornea.stiffness_a_pa, cornea.exponent_k)
            for h in thickness(scene, r).ravel()
        ]
    ).reshape(r.shape)
