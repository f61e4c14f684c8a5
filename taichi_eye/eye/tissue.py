"""The corneal tissue: energy, stresses and inflation of a Fung-type membrane.

Montanino, Angelillo and Pandolfi ("A mesh-free approach to cornea-aqueous humor interaction during tonometry tests")
take per reference volume, with E the Green-Lagrange strain from the physiological (pressurised) state,

    W = A [exp(C (E - E0) . (E - E0)) - 1],

so that the wall carries stress at E = 0 and none at E = E0. For an isotropic membrane and E0 = -eps0 I, with
lam_i the principal stretches, E_i = (lam_i^2 - 1)/2 and e_i = E_i + eps0, this reads

    W = A [exp(Q) - 1],    Q = s [(1 - nu)(e1^2 + e2^2) + nu (e1 + e2)^2]
    S_i = dW/dE_i = 2 A s exp(Q) [(1 - nu) e_i + nu (e1 + e2)]      (second Piola-Kirchhoff, Pa)

With k = s (1 + nu) the equibiaxial case e1 = e2 = e is Q = 2 k e^2, S = 2 A k e exp(2 k e^2). A wall with a principal
S <= 0 is slack: the membrane equations are no longer hyperbolic there. The constants are tied to the intraocular
pressure by the rest condition in `taichi_eye.scene.calibration`, whose solvers are offered here as well.

Strains and constants may be numbers or arrays that broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.scene.calibration import rest_stress, solve_exponent, solve_prestrain, solve_stiffness

__all__ = [
    "biaxial_tangent",
    "energy",
    "flexural_rigidity",
    "inflation_pressure",
    "rest_stress",
    "solve_exponent",
    "solve_prestrain",
    "solve_stiffness",
    "strain",
    "stress",
]


def strain(stretch: ArrayLike) -> np.ndarray:
    """Green-Lagrange strain (lam^2 - 1)/2 of a stretch."""
    return 0.5 * (np.square(stretch) - 1.0)


def _exponent(e1: ArrayLike, e2: ArrayLike, s: float, nu: float) -> np.ndarray:
    return s * ((1.0 - nu) * (np.square(e1) + np.square(e2)) + nu * np.square(np.add(e1, e2)))


def energy(e1: ArrayLike, e2: ArrayLike, a: float, s: float, nu: float) -> np.ndarray:
    """Energy W [J per m^3 of reference tissue] at the strains e_i = E_i + eps0; a in Pa, s and nu without unit."""
    return a * np.expm1(_exponent(e1, e2, s, nu))


def stress(e1: ArrayLike, e2: ArrayLike, a: float, s: float, nu: float) -> tuple[np.ndarray, np.ndarray]:
    """Second Piola-Kirchhoff stresses (S1, S2) [Pa] at the strains e_i = E_i + eps0."""
    scale = 2.0 * a * s * np.exp(_exponent(e1, e2, s, nu))
    both = nu * np.add(e1, e2)
    return scale * ((1.0 - nu) * np.asarray(e1) + both), scale * ((1.0 - nu) * np.asarray(e2) + both)


def biaxial_tangent(a: float, k: float, prestrain: float) -> float:
    """Slope dS/dE [Pa] of the equibiaxial stress at rest, (S0/eps0)(1 + 4 k eps0^2)."""
    return 2.0 * a * k * np.exp(2.0 * k * prestrain**2) * (1.0 + 4.0 * k * prestrain**2)


def flexural_rigidity(modulus: float, thickness: ArrayLike, nu: float) -> np.ndarray:
    """Bending stiffness D = E h^3 / (12 (1 - nu^2)) [N m] of a plate of Young's modulus [Pa] and thickness [m]."""
    return modulus * np.asarray(thickness) ** 3 / (12.0 * (1.0 - nu * nu))


def inflation_pressure(
    stretch: ArrayLike, radius: float, thickness: float, a: float, k: float, prestrain: float
) -> np.ndarray:
    """Pressure [Pa] that holds a whole sphere of this tissue at a uniform stretch lam, closed form.

    p(lam) = (2 h/(R lam)) 2 A k e exp(2 k e^2), e = (lam^2 - 1)/2 + eps0; radius R and thickness h in m, at lam = 1.
    """
    e = strain(stretch) + prestrain
    return 4.0 * thickness * a * k * e * np.exp(2.0 * k * e**2) / (radius * np.asarray(stretch))
