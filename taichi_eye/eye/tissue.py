"""Kinematics of the corneal tissue, and what follows from a tissue law (`taichi_eye.eye.laws`) in closed form.

A wall with a principal S <= 0 is slack: the membrane equations are no longer hyperbolic there. Strains and constants
may be numbers or arrays that broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.eye.laws import Law


def strain(stretch: ArrayLike) -> np.ndarray:
    """Green-Lagrange strain (lam^2 - 1)/2 of a stretch."""
    return 0.5 * (np.square(stretch) - 1.0)


def biaxial_tangent(law: Law, coefficients, prestrain: float) -> float:
    """Slope dS/dE [Pa] of the equibiaxial stress at rest: E/(1 - nu) of an isotropic sheet."""
    along, mixed, _, _ = law.of_arrays.tangent(prestrain, prestrain, prestrain, coefficients)
    return along + mixed


def flexural_rigidity(modulus: float, thickness: ArrayLike, nu: float) -> np.ndarray:
    """Bending stiffness D = E h^3 / (12 (1 - nu^2)) [N m] of a plate of Young's modulus [Pa] and thickness [m]."""
    return modulus * np.asarray(thickness) ** 3 / (12.0 * (1.0 - nu * nu))


def inflation_pressure(
    stretch: ArrayLike, radius: float, thickness: float, a: float, k: float, prestrain: float
) -> np.ndarray:
    """Pressure [Pa] that holds a whole sphere of the exponential tissue at a uniform stretch lam: an exact answer.

    p(lam) = (2 h/(R lam)) 2 A k e exp(2 k e^2), e = (lam^2 - 1)/2 + eps0; radius R and thickness h in m, at lam = 1.
    Worked out by hand, so that what is checked against it does not check itself.
    """
    e = strain(stretch) + prestrain
    return 4.0 * thickness * a * k * e * np.exp(2.0 * k * e**2) / (radius * np.asarray(stretch))
