"""The worked examples do what they say."""

import numpy as np
import pytest

import taichi_eye
from taichi_eye.examples import iop_chart, laplacian, tissue_mpa
from taichi_eye.report.traces import COLUMNS
from taichi_eye.scene.calibration import rest_stress, solve_prestrain
from taichi_eye.units import MM, MMHG


def test_the_chart_falls_as_two_independent_methods_have_it(tmp_path, capsys):
    peaks = iop_chart.main((10, 20, 30), tmp_path / "chart.png")
    np.testing.assert_allclose(peaks, (1.156, 0.803, 0.579), rtol=0.03)
    assert (tmp_path / "chart.png").stat().st_size > 1000 and len(capsys.readouterr().out.splitlines()) == 4


@pytest.mark.parametrize("wanted_mpa, nu", [(0.25, 0.49), (1.7, 0.3)])
def test_tissue_of_a_wanted_modulus_has_it_in_a_small_stretch(wanted_mpa, nu):
    scene = tissue_mpa.with_young(taichi_eye.load_scene("quick", [f"cornea.poisson_ratio={nu}"]), wanted_mpa)
    cornea = scene.cornea
    a, k, e0 = cornea.stiffness_a_pa, cornea.exponent_k, cornea.prestrain
    s0 = rest_stress(scene.eye.iop_mmhg * MMHG, cornea.radius_mm * MM, cornea.thickness_mm * MM)
    assert solve_prestrain(s0, a, k) == pytest.approx(e0, rel=1e-9)

    def stress(e1, e2):  # of the law W = A [exp(Q) - 1], by differences
        energy = lambda x, y: a * np.expm1(k / (1 + nu) * ((1 - nu) * (x * x + y * y) + nu * (x + y) ** 2))
        h = 1e-5
        return (energy(e1 + h, e2) - energy(e1 - h, e2)) / (2 * h)

    # pulled along, free across: the strain across that keeps the stress across
    step, across = 1e-6, 0.0
    for _ in range(50):
        across -= (stress(e0 + across, e0 + step) - s0) / (1e6 * wanted_mpa / (1 - nu**2))
    assert (stress(e0 + step, e0 + across) - s0) / step == pytest.approx(1e6 * wanted_mpa, rel=1e-3)


def test_tissue_below_the_least_modulus_of_its_exponent_is_refused():
    with pytest.raises(SystemExit, match="0.01 MPa"):
        tissue_mpa.with_young(taichi_eye.load_scene("quick"), 0.01)


def test_errors_of_the_operators_fall_at_their_orders(capsys):
    (orders,) = laplacian.main((10, 20))
    assert orders[0] > 1.6 and orders[1] > 0.7
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_columns_of_the_examples_are_columns():
    assert {"apex_displacement_mm", "time_ms"} <= set(COLUMNS)
