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


@pytest.mark.parametrize("nu, thickness", [(0.0, 0.55), (0.15, 0.7), (0.3, 0.55)])
def test_half_a_sphere_held_at_its_equator_rises_as_a_whole_one_and_by_its_edge_layer(nu, thickness):
    # at the equator w falls to nothing over l = R sqrt(N/(E h)), N = p R/2; the meridian's strain u' + w/R stays that
    # of equilibrium and its hoop's share of it goes, so that all above is lifted by (1 + nu) w l/R
    keys = [f"cornea.poisson_ratio={nu}", f"cornea.thickness_mm={thickness}", "cornea.limbus_radius_mm=7.79"]
    eye = eye_of(load_scene(None, ["cornea.stiffness_a_pa=80000", "numerics.spacing_mm=0.25", *keys]))
    low, high = 10 * MMHG, 30 * MMHG
    root = (2.0 / 3.0) * (high**1.5 - low**1.5) / (high - low)  # mean of sqrt(p)
    layer = root * np.sqrt(0.5 * eye.section.radius / (eye.youngs_modulus * eye.cornea.thickness))
    whole = donor.free_sphere(eye, low, high)
    assert donor.apex_rise(eye, low, high) == pytest.approx(whole * (1.0 + (1.0 + nu) * layer), rel=0.004)


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
