"""A cornea inflated without a puff, against closed forms."""

import numpy as np
import pytest

from taichi_eye.eye.eye import eye_of
from taichi_eye.proof import donor
from taichi_eye.scene import load_scene
from taichi_eye.units import MM, MMHG

STIFF = ["cornea.stiffness_a_pa=80000", "cornea.poisson_ratio=0.3"]


def test_a_whole_sphere_rises_by_laplace_while_strains_are_small():
    # k so small that the law is linear: E/(1 - nu) = 2 A k
    eye = eye_of(load_scene(None, ["cornea.stiffness_a_pa=5e8", "cornea.exponent_k=0.01", "cornea.poisson_ratio=0.3"]))
    rise = donor.free_sphere(eye, 10 * MMHG, 12 * MMHG)
    radius, thickness = eye.section.radius, eye.cornea.thickness
    assert rise == pytest.approx(2 * MMHG * radius**2 / (2.0 * 2.0 * 5e8 * 0.01 * thickness), rel=2e-3)


@pytest.mark.parametrize("flexural_mpa", [0.0, 0.1])
def test_half_a_sphere_held_at_its_equator_rises_as_a_whole_one(flexural_mpa):
    # the equator of a sphere moves in its plane, and what holding it disturbs does not reach the pole
    keys = ["cornea.limbus_radius_mm=7.79", "numerics.spacing_mm=0.25", f"cornea.flexural_modulus_mpa={flexural_mpa}"]
    eye = eye_of(load_scene(None, [*STIFF, *keys]))
    assert donor.apex_rise(eye, 10 * MMHG, 30 * MMHG) == pytest.approx(
        donor.free_sphere(eye, 10 * MMHG, 30 * MMHG), rel=0.01
    )


def test_a_cornea_is_at_rest_under_every_pressure_and_comes_back():
    eye = eye_of(load_scene(None, [*STIFF, "cornea.flexural_modulus_mpa=0.05", "cornea.limbus_thickness_mm=0.65"]))
    cornea = donor.HeldCornea(eye, 64)
    rest = cornea.place.copy()
    cornea.inflate(27 * MMHG)
    assert cornea.place[0, 1] > rest[0, 1] and np.abs(cornea.place[-1] - rest[-1]).max() == 0.0
    cornea.inflate(eye.iop)
    assert np.abs(cornea.place - rest).max() < 1e-9 * MM


def test_the_rise_converges_with_the_elements():
    eye = eye_of(load_scene(None, [*STIFF, "cornea.flexural_modulus_mpa=0.05"]))
    rises = []
    for elements in (24, 48, 96):
        cornea = donor.HeldCornea(eye, elements)
        cornea.inflate(20 * MMHG)
        rises.append(cornea.place[0, 1])
    assert abs(rises[2] - rises[1]) < 0.35 * abs(rises[1] - rises[0])
