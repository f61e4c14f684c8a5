"""The exponential law of Montanino, Angelillo and Pandolfi for an isotropic membrane.

    W = A [exp(Q) - 1],    Q = s [(1 - nu)(e1^2 + e2^2) + nu (e1 + e2)^2]
    S_i = dW/dE_i = 2 A s exp(Q) b_i,   b_i = (1 - nu) e_i + nu (e1 + e2)
    C_ij = 2 A s exp(Q) [delta_ij + nu (1 - delta_ij) + 2 s b_i b_j],   C66 = A s (1 - nu) exp(Q)

("A mesh-free approach to cornea-aqueous humor interaction during tonometry tests"; their general form is
A [exp(C (E - E0) . (E - E0)) - 1], here with E0 = -eps0 I.) With k = s (1 + nu) the equibiaxial case e1 = e2 = e is
Q = 2 k e^2, S = 2 A k e exp(2 k e^2). Constants of a scene: A [Pa], k, nu; coefficients of the text: A, s, nu.
"""

from taichi_eye.eye.laws.law import Functions, Law
from taichi_eye.scene.calibration import solve_prestrain


def text(math, func) -> Functions:
    """The law's functions, see `taichi_eye.eye.laws.law`."""

    @func
    def growth(e1, e2, c):
        """exp(Q)"""
        total = e1 + e2
        return math.exp(c[1] * ((1.0 - c[2]) * (e1 * e1 + e2 * e2) + c[2] * total * total))

    @func
    def energy(e1, e2, shift, c):
        return c[0] * (growth(e1, e2, c) - 1.0)

    @func
    def stress(e1, e2, shift, c):
        total = e1 + e2
        factor = 2.0 * c[0] * c[1] * growth(e1, e2, c)
        return factor * ((1.0 - c[2]) * e1 + c[2] * total), factor * ((1.0 - c[2]) * e2 + c[2] * total)

    @func
    def tangent(e1, e2, shift, c):
        total = e1 + e2
        factor = 2.0 * c[0] * c[1] * growth(e1, e2, c)
        b1, b2 = (1.0 - c[2]) * e1 + c[2] * total, (1.0 - c[2]) * e2 + c[2] * total
        return (
            factor * (1.0 + 2.0 * c[1] * b1 * b1),
            factor * (c[2] + 2.0 * c[1] * b1 * b2),
            factor * (1.0 + 2.0 * c[1] * b2 * b2),
            0.5 * factor * (1.0 - c[2]),
        )

    return Functions(energy, stress, tangent)


def coefficients(stiffness: float, exponent_k: float, nu: float) -> tuple[float, float, float]:
    """A [Pa], s and nu of the text from A [Pa], k = s (1 + nu) and nu."""
    return stiffness, exponent_k / (1.0 + nu), nu


def prestrain(stress: float, stiffness: float, exponent_k: float, nu: float) -> float:
    """eps0 at which 2 A k eps0 exp(2 k eps0^2) is the stress [Pa] at rest."""
    return solve_prestrain(stress, stiffness, exponent_k)


LAW = Law("exponential", 3, text, coefficients, prestrain)
