"""A film of constant Cauchy tension, like soap: no tissue, but the wall of problems with exact answers.

    W = T (lam1 lam2 - 1),   S1 = T lam2 / lam1,   S2 = T lam1 / lam2,   lam_i^2 = 1 + 2 E_i

One constant and coefficient, the tension T [Pa]. The film is in tension T at any stretch, so no prestrain is asked for.
"""

from taichi_eye.eye.laws.law import Functions, Law


def text(math, func) -> Functions:
    """The law's functions, see `taichi_eye.eye.laws.law`."""

    @func
    def stretch(e, shift):
        return math.sqrt(1.0 + 2.0 * (e - shift))

    @func
    def energy(e1, e2, shift, c):
        return c[0] * (stretch(e1, shift) * stretch(e2, shift) - 1.0)

    @func
    def stress(e1, e2, shift, c):
        lam1, lam2 = stretch(e1, shift), stretch(e2, shift)
        return c[0] * (lam2 / lam1), c[0] * (lam1 / lam2)

    @func
    def tangent(e1, e2, shift, c):
        lam1, lam2 = stretch(e1, shift), stretch(e2, shift)
        mixed = c[0] / (lam1 * lam2)
        # the shear of a fluid film costs nothing but what the tension itself does
        return -c[0] * lam2 / lam1**3, mixed, -c[0] * lam1 / lam2**3, -mixed

    return Functions(energy, stress, tangent)


LAW = Law("film", 1, text, lambda tension: (tension,), lambda stress, tension: 0.0)
