"""Each tissue law against itself: one text for arrays and kernels, stress and tangent its derivatives."""

import math

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.eye.laws import LAWS
from taichi_eye.eye.laws.law import plain
from taichi_eye.lang import ti

COEFFICIENTS = {"exponential": (1562.0, 57.8, 0.3), "film": (14182.0,)}
SHIFT = 0.04


def strains(count=400):
    return np.random.default_rng(5).uniform(-0.03, 0.09, (2, count))


@pytest.mark.parametrize("name", LAWS)
def test_kernels_and_arrays_agree_to_the_last_bit(name):
    backend.init("cpu", "f64")
    law, c = LAWS[name], COEFFICIENTS[name]
    energy, stress, tangent = law.text(ti, ti.func)
    material = ti.Vector.field(law.size, ti.f64, 1)
    material.from_numpy(np.array([c]))

    @ti.kernel
    def evaluate(e: ti.types.ndarray(), out: ti.types.ndarray()):
        for k in range(e.shape[1]):
            out[0, k] = energy(e[0, k], e[1, k], SHIFT, material[0])
            out[1, k], out[2, k] = stress(e[0, k], e[1, k], SHIFT, material[0])
            out[3, k], out[4, k], out[5, k], out[6, k] = tangent(e[0, k], e[1, k], SHIFT, material[0])

    e = strains()
    out = np.zeros((7, e.shape[1]))
    evaluate(e, out)
    # the same text with the C library's exp and sqrt, which kernels call too
    scalars = law.text(math, plain)
    for k, (e1, e2) in enumerate(e.T.tolist()):
        at = e1, e2, SHIFT, c
        expected = [scalars.energy(*at), *scalars.stress(*at), *scalars.tangent(*at)]
        if name == "exponential":
            assert out[:, k].tolist() == expected
        else:
            # compilers may raise to a power by other products
            assert out[:, k] == pytest.approx(expected, rel=1e-15)
    # NumPy's own exp is one bit off now and then
    arrays = law.of_arrays
    expected = [arrays.energy(*e, SHIFT, c), *arrays.stress(*e, SHIFT, c), *arrays.tangent(*e, SHIFT, c)]
    np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-12 * c[0])


@pytest.mark.parametrize("name", LAWS)
def test_stress_and_tangent_are_derivatives(name):
    law, c, (e1, e2) = LAWS[name].of_arrays, COEFFICIENTS[name], strains(50)
    d = 1e-6
    s1, s2 = law.stress(e1, e2, SHIFT, c)
    slope = lambda f: (f(d, 0.0) - f(-d, 0.0)) / (2 * d)
    across = lambda f: (f(0.0, d) - f(0.0, -d)) / (2 * d)
    energy = lambda a, b: law.energy(e1 + a, e2 + b, SHIFT, c)
    np.testing.assert_allclose([slope(energy), across(energy)], [s1, s2], rtol=1e-6, atol=1.0)
    c11, c12, c22, _ = law.tangent(e1, e2, SHIFT, c)
    first, second = (lambda a, b, k=k: law.stress(e1 + a, e2 + b, SHIFT, c)[k] for k in range(2))
    scale = np.abs(c11).max()
    for found, exact in ((slope(first), c11), (across(first), c12), (slope(second), c12), (across(second), c22)):
        np.testing.assert_allclose(found, exact, atol=1e-6 * scale)


def test_shear_tangent_of_an_isotropic_law_joins_the_principal_ones():
    # rotating the axes of an isotropic sheet: C66 = (C11 - C12)/2 where both strains are equal
    law, c = LAWS["exponential"].of_arrays, COEFFICIENTS["exponential"]
    e = np.linspace(-0.02, 0.08, 9)
    c11, c12, _, c66 = law.tangent(e, e, 0.0, c)
    np.testing.assert_allclose(c66, 0.5 * (c11 - c12), rtol=1e-12)


def test_prestrain_carries_the_pressure_at_rest():
    law = LAWS["exponential"]
    for stress, constants in ((14182.0, (1562.0, 86.1, 0.49)), (30e3, (8e4, 86.1, 0.3))):
        e = law.prestrain(stress, *constants)
        found = law.of_arrays.stress(e, e, 0.0, law.coefficients(*constants))
        np.testing.assert_allclose(found, stress, rtol=1e-12)
