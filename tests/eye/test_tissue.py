"""The corneal tissue against its own energy and against worked numbers."""

import numpy as np
import pytest

from taichi_eye.eye import tissue
from taichi_eye.eye.laws import LAWS
from taichi_eye.scene import load_scene
from taichi_eye.scene.calibration import lambert_w, rest_stress, solve_exponent, solve_prestrain, solve_stiffness

A, K, NU = 1562.0, 86.1, 0.49
S = K / (1 + NU)
C = A, S, NU
LAW = LAWS["exponential"].of_arrays


def test_stress_is_the_derivative_of_the_energy():
    rng = np.random.default_rng(3)
    e1, e2 = rng.uniform(-0.05, 0.1, (2, 200))
    s1, s2 = LAW.stress(e1, e2, 0.0, C)
    d = 1e-5
    for got, (d1, d2) in ((s1, (d, 0)), (s2, (0, d))):
        near = LAW.energy(e1 + d1, e2 + d2, 0.0, C) - LAW.energy(e1 - d1, e2 - d2, 0.0, C)
        far = LAW.energy(e1 + 2 * d1, e2 + 2 * d2, 0.0, C) - LAW.energy(e1 - 2 * d1, e2 - 2 * d2, 0.0, C)
        np.testing.assert_allclose(got, (8 * near - far) / (12 * d), rtol=1e-8, atol=1e-3)


def test_energy_and_stress_vanish_at_the_stress_free_state():
    assert LAW.energy(0.0, 0.0, 0.0, C) == 0.0
    assert LAW.stress(0.0, 0.0, 0.0, C) == (0.0, 0.0)


def test_directions_are_interchangeable():
    s1, s2 = LAW.stress(0.03, 0.05, 0.0, C)
    assert (s2, s1) == LAW.stress(0.05, 0.03, 0.0, C)
    assert s2 > s1 > 0


def test_equibiaxial_stress():
    e = np.linspace(-0.02, 0.09, 12)
    s1, s2 = LAW.stress(e, e, 0.0, C)
    np.testing.assert_allclose(s1, 2 * A * K * e * np.exp(2 * K * e**2), rtol=1e-12)
    np.testing.assert_array_equal(s1, s2)


def test_no_coupling_at_zero_poisson_ratio_leaves_the_other_strain_in_the_exponent_only():
    s1, _ = LAW.stress(0.02, 0.05, 0.0, (A, S, 0.0))
    assert s1 == pytest.approx(2 * A * S * 0.02 * np.exp(S * (0.02**2 + 0.05**2)), rel=1e-14)


@pytest.mark.parametrize(
    "iop_mmhg, prestrain", [(10, 0.0301), (12.5, 0.0354), (15, 0.0400), (20, 0.0476), (25, 0.0536), (30, 0.0585)]
)
def test_prestrain_for_each_pressure(iop_mmhg, prestrain):
    assert load_scene(None, [f"eye.iop_mmhg={iop_mmhg}"]).cornea.prestrain == pytest.approx(prestrain, abs=5e-5)


def test_default_wall_carries_laplace_and_has_the_published_tangent():
    c = load_scene().cornea
    s0 = rest_stress(15 * 133.322387415, 7.8e-3, 0.55e-3)
    s1, s2 = LAW.stress(c.prestrain, c.prestrain, 0.0, (c.stiffness_a_pa, c.exponent_s, c.poisson_ratio))
    assert s1 == pytest.approx(s0, rel=1e-12) and s2 == pytest.approx(s0, rel=1e-12)
    tangent = tissue.biaxial_tangent(
        LAWS["exponential"], (c.stiffness_a_pa, c.exponent_s, c.poisson_ratio), c.prestrain
    )
    assert tangent == pytest.approx(s0 / c.prestrain * (1 + 4 * c.exponent_k * c.prestrain**2), rel=1e-12)
    assert tangent == pytest.approx(0.55e6, rel=0.02)


def test_tangent_is_the_slope_of_the_equibiaxial_stress():
    d, e = 1e-6, 0.04
    rise = LAW.stress(e + d, e + d, 0.0, C)[0] - LAW.stress(e - d, e - d, 0.0, C)[0]
    assert tissue.biaxial_tangent(LAWS["exponential"], C, e) == pytest.approx(rise / (2 * d), rel=1e-7)


@pytest.mark.parametrize("s0", [1e-3, 1.0, 1.4e4, 1e6, 1e9])
@pytest.mark.parametrize("a, k", [(1e-6, 1e-3), (1562.0, 86.1), (1e8, 1e4)])
def test_each_solver_inverts_the_rest_condition(s0, a, k):
    prestrain = solve_prestrain(s0, a, k)
    assert 2 * a * k * prestrain * np.exp(2 * k * prestrain**2) == pytest.approx(s0, rel=1e-11)
    assert solve_exponent(s0, a, prestrain) == pytest.approx(k, rel=1e-9)
    assert solve_stiffness(s0, k, prestrain) == pytest.approx(a, rel=1e-9)


def test_lambert_w():
    w = np.array([1e-12, 1e-3, 0.5, 1.0, 3.0, 20.0, 300.0])
    np.testing.assert_allclose([lambert_w(v * np.exp(v)) for v in w], w, rtol=1e-14)


def test_inflation_closed_form():
    """Sphere R 7.8 mm, h 0.55 mm; A chosen such that 2000 Pa hold it at lam = 1 with k 86 and eps0 0.04."""
    stretch = np.array([0.98, 0.99, 1.0, 1.01, 1.02, 1.03, 1.05])
    expected = [839.571, 1346.215, 2000.000, 2895.044, 4179.837, 6098.745, 13819.07]
    got = tissue.inflation_pressure(stretch, 7.8e-3, 0.55e-3, 1565.401, 86.0, 0.04)
    np.testing.assert_allclose(got, expected, rtol=1e-6)
