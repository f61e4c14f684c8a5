"""The jet on a wall that is not flat: curvature, width, momentum."""

import math

import numpy as np
import pytest

from taichi_eye.eye import jet
from taichi_eye.eye.eye import eye_of
from taichi_eye.scene import load_scene


@pytest.mark.parametrize("radius", [-12e-3, -6.3e-3, 5e-3, 7.8e-3, 40e-3])
@pytest.mark.parametrize("elements", [11, 30, 64])
def test_curvature_of_a_sphere_is_exact_on_any_grid(radius, elements):
    rest = np.linspace(0.0, 4e-3, elements + 1)
    place = np.column_stack([rest, np.sign(radius) * (np.sqrt(radius**2 - rest**2) - abs(radius))])
    assert jet.central_curvature(place, rest) == pytest.approx(1.0 / radius, rel=1e-9)


def test_a_wall_shorter_than_the_nozzle_is_judged_by_its_rim():
    rest = np.linspace(0.0, 0.9e-3, 10)
    place = np.column_stack([rest, np.sqrt(49e-6 - rest**2) - 7e-3])
    assert jet.central_curvature(place, rest) == pytest.approx(1.0 / 7e-3, rel=1e-9)


@pytest.mark.parametrize("c, radius_mm", [(0.5, 7.8), (0.4, -9.0), (0.6, math.inf)])
def test_the_width_is_that_on_a_flat_wall_over_what_the_curvature_asks(c, radius_mm):
    keys = ("puff.radial_profile=gaussian", "puff.width_mm=1.7", f"puff.dent_feedback={c}")
    puff = eye_of(load_scene(None, keys)).puff
    width = 1.7e-3 / (1.0 + c * 2.4 / radius_mm)
    assert puff.radial(width, 1e3 / radius_mm) == pytest.approx(math.exp(-1.0), rel=1e-12)
    assert eye_of(load_scene(None, keys[:2])).puff.radial(1.7e-3, 1e3 / radius_mm) == pytest.approx(math.exp(-1.0))


def test_no_dent_throws_back_more_than_the_momentum_of_the_jet():
    assert jet.narrowing(2.0, -1e4) ** -2 == pytest.approx(2.0)


def test_half_is_what_the_turn_of_momentum_gives_for_small_curvatures():
    for kappa in (-5.0, 5.0):
        width = math.sqrt(1.0 - math.sin(kappa * jet.NOZZLE))
        assert 1.0 / jet.narrowing(0.5, kappa) - 1.0 == pytest.approx(width - 1.0, rel=0.03)
