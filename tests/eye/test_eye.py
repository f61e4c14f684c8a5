"""A scene read once, in SI; what follows from an eye's numbers follows them."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_eye.eye.eye import Globe, eye_of
from taichi_eye.scene import load_scene


def test_every_unit_of_the_scene_is_read_right():
    eye = eye_of(
        load_scene(
            None,
            (
                "eye.iop_mmhg=20",
                "eye.whole_eye_movement_mm=0.3",
                "cornea.radius_mm=7.5",
                "cornea.thickness_mm=0.5",
                "cornea.limbus_thickness_mm=0.6",
                "cornea.flexural_modulus_mpa=0.02",
                "cornea.relaxation_ms=0.4",
                "chamber.compliance_mm3_mmhg=0.1",
                "chamber.globe_delay_ms=0.6",
                "aqueous.viscosity_mpa_s=0.9",
                "puff.radial_profile=gaussian",
                "puff.width_mm=2",
            ),
        )
    )
    assert eye.iop == pytest.approx(2666.44774830)
    assert eye.section.radius == 7.5e-3 and eye.cornea.thickness == 0.5e-3 and eye.cornea.rim_thickness == 0.6e-3
    assert eye.cornea.flexural_modulus == pytest.approx(2e4) and eye.cornea.relaxation_time == pytest.approx(4e-4)
    assert eye.globe.compliance == pytest.approx(1e-10 / 133.322387415) and eye.globe.delay == pytest.approx(6e-4)
    assert eye.liquid.viscosity == pytest.approx(9e-4) and eye.puff.radial_rate == pytest.approx(1.0 / 4e-6)
    assert eye.retreat(np.array([0.0, 20e-3])) == pytest.approx([0.0, 3e-4])


def test_another_pressure_is_carried_by_another_prestrain():
    eye = eye_of(load_scene())
    other = eye.but(iop=2.0 * eye.iop)
    stress, _ = other.cornea.law.of_arrays.stress(
        other.apex_prestrain, other.apex_prestrain, 0.0, other.cornea.coefficients
    )
    assert stress == pytest.approx(other.iop * other.section.radius / (2.0 * other.cornea.thickness), rel=1e-12)
    assert eye.but(globe=Globe(compliance=1e-12)).globe.delay == 0.0


@pytest.mark.parametrize("iop", [9, 15, 27])
def test_the_scenes_prestrain_is_the_eyes(iop):
    scene = load_scene(None, (f"eye.iop_mmhg={iop}", "cornea.thickness_mm=0.52"))
    assert eye_of(scene).apex_prestrain == scene.cornea.prestrain


def test_a_thicker_rim_carries_the_same_tension_by_less_stress():
    eye = eye_of(load_scene(None, ("cornea.limbus_thickness_mm=0.7",)))
    r = np.array([0.0, 2e-3, 5.8e-3, 9e-3])
    assert eye.thickness(r) == pytest.approx([0.55e-3, 0.55e-3 + 0.15e-3 * (2 / 5.8) ** 2, 0.7e-3, 0.7e-3])
    e = eye.prestrain(r)
    stress, _ = eye.cornea.law.of_arrays.stress(e, e, 0.0, eye.cornea.coefficients)
    assert stress * eye.thickness(r) == pytest.approx(eye.iop * eye.section.radius / 2.0, rel=1e-12)


def test_youngs_modulus_is_that_of_the_calibration():
    eye = eye_of(load_scene())
    # 0.55 MPa is E / (1 - nu)
    assert eye.youngs_modulus == pytest.approx((1.0 - 0.49) * 0.55e6, rel=0.02)
    softer = eye.but(cornea=replace(eye.cornea, constants=(0.5 * 1562.0, 86.1, 0.49)))
    e = softer.apex_prestrain
    assert e > eye.apex_prestrain
    # (S0/eps0)(1 + 4 k eps0^2) is the biaxial tangent
    assert softer.youngs_modulus == pytest.approx(0.51 * softer.rest_stress / e * (1.0 + 4.0 * 86.1 * e**2), rel=1e-12)
