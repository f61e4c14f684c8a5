"""The rest condition of the corneal membrane, solved for whichever tissue constant is left open.

At rest E = 0 and the wall, a sphere of radius R and thickness h, carries the intraocular pressure (Laplace):

    S(eps0) = 2 A k eps0 exp(2 k eps0^2) = S0 = IOP R / (2 h)

with the equibiaxial second Piola-Kirchhoff stress S of the energy in `taichi_eye.eye.tissue`. With W0 the principal
branch of Lambert's function (w e^w = x) each constant is closed form:

    eps0 = sqrt(W0(S0^2/(A^2 k)) / (4 k)),   k = W0(S0 eps0/A) / (2 eps0^2),   A = S0 exp(-2 k eps0^2) / (2 k eps0)

The defaults A = 1562 Pa and k = 86.1 also meet a biaxial tangent at rest of about 0.55 MPa, Young's modulus 0.25 to
0.29 MPa in vivo over 1 - nu (PMC6948750), at 15 mmHg and eps0 = 0.04.
"""

from __future__ import annotations

import math

DEFAULT_A_PA = 1562.0
DEFAULT_K = 86.1


def lambert_w(x: float) -> float:
    """Principal branch of Lambert's W for x >= 0: the w with w exp(w) = x."""
    w = math.log1p(x)  # an upper bound, from which Newton descends monotonically
    for _ in range(100):
        step = (w - x * math.exp(-w)) / (1.0 + w)
        w -= step
        if abs(step) <= 1e-15 * w:
            break
    return w


def rest_stress(iop: float, radius: float, thickness: float) -> float:
    """Membrane stress S0 [Pa] of a sphere of `radius` [m] and `thickness` [m] under `iop` [Pa]."""
    return iop * radius / (2.0 * thickness)


def solve_prestrain(s0: float, a: float, k: float) -> float:
    """eps0 from the rest stress `s0` [Pa], A [Pa] and k."""
    return math.sqrt(lambert_w((s0 / a) ** 2 / k) / (4.0 * k))


def solve_exponent(s0: float, a: float, prestrain: float) -> float:
    """k from the rest stress `s0` [Pa], A [Pa] and eps0."""
    return lambert_w(s0 * prestrain / a) / (2.0 * prestrain**2)


def solve_stiffness(s0: float, k: float, prestrain: float) -> float:
    """A [Pa] from the rest stress `s0` [Pa], k and eps0."""
    return s0 * math.exp(-2.0 * k * prestrain**2) / (2.0 * k * prestrain)
