"""Unknowns: the scene that values make, and what is known beforehand."""

from pathlib import Path

import numpy as np
import pytest

from taichi_eye.errors import SceneError
from taichi_eye.estimation.unknowns import Known, beforehand, own_values, scene_with
from taichi_eye.scene import load_scene

HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"
SHELL = load_scene(
    None,
    [
        "cornea.flexural_modulus_mpa=0.02",
        "cornea.shear_modulus_kpa=11",
        "chamber.compliance_mm3_mmhg=0.2",
        "puff.radial_profile=gaussian",
        "puff.width_mm=1.7",
        "eye.whole_eye_movement_mm=0.3",
    ],
)


def test_the_scene_s_own_values_make_the_scene():
    for scene in (load_scene(HEALTHY), SHELL, load_scene(None)):
        assert scene_with(scene, own_values(scene)) == scene


@pytest.mark.parametrize(
    "name, value, key, expected",
    [
        ("in_plane", 1.3, "cornea.stiffness_a_pa", 1.3 * SHELL.cornea.stiffness_a_pa),
        ("out_of_plane", 0.8, "cornea.flexural_modulus_mpa", 0.016),
        ("out_of_plane", 0.8, "cornea.shear_modulus_kpa", 8.8),
        ("globe", 1.2, "chamber.compliance_mm3_mmhg", 0.24),
        ("puff", 1.02, "puff.peak_kpa", 10.2),
        ("puff_width", 0.9, "puff.width_mm", 1.53),
        ("whole_eye", 1.1, "eye.whole_eye_movement_mm", 0.33),
        ("thickness_um", 600.0, "cornea.limbus_thickness_mm", 0.6),
        ("radius_mm", 7.4, "cornea.radius_mm", 7.4),
        ("iop_mmhg", 20.0, "chamber.compliance_mm3_mmhg", 0.15),
    ],
)
def test_a_value_changes_what_it_is_of(name, value, key, expected):
    scene = scene_with(SHELL, {**own_values(SHELL), name: value})
    assert scene.values()[key] == pytest.approx(expected)
    # the wall still carries the pressure at rest
    assert scene.cornea.prestrain != SHELL.cornea.prestrain or name not in ("in_plane", "iop_mmhg", "thickness_um")


def test_a_width_of_the_paper_s_profile_and_a_prestrain_that_was_given():
    paper = load_scene(None)
    assert scene_with(paper, {**own_values(paper), "puff_width": 1.1}).puff.spread_a == pytest.approx(21.5 / 1.21)
    given = load_scene(None, ["cornea.prestrain=0.04"])
    stiffer = scene_with(given, {**own_values(given), "in_plane": 1.5})
    assert stiffer.cornea.stiffness_a_pa == pytest.approx(1.5 * given.cornea.stiffness_a_pa)
    assert stiffer.cornea.exponent_k == pytest.approx(given.cornea.exponent_k) and stiffer.cornea.prestrain < 0.04


def test_a_chamber_that_was_given_keeps_its_back():
    deep = load_scene(None, ["chamber.depth_mm=3.5"])
    steeper = scene_with(deep, {**own_values(deep), "radius_mm": 7.2})
    cap = lambda r: r - np.sqrt(r**2 - 5.8**2)
    assert steeper.chamber.depth_mm == pytest.approx(3.5 + cap(7.2) - cap(7.8))


def test_what_is_known_beforehand():
    known = {"thickness_um": Known(560.0, 5.0), "puff": Known(1.01)}
    before = beforehand(SHELL, known, retreats=False)
    assert before.held == {"puff": 1.01} and "whole_eye" not in before.names and before.names[0] == "iop_mmhg"
    place = before.names.index("thickness_um")
    assert before.precision[place, place] == pytest.approx((560.0 / 5.0) ** 2) and before.precision[0, 0] == 0.0
    assert before.values(before.mean)["thickness_um"] == pytest.approx(560.0)
    old, young = (beforehand(SHELL, {}, age_years=age) for age in (90.0, 10.0))
    stiff = before.names.index("in_plane")
    assert np.exp(old.mean[stiff] - young.mean[stiff]) == pytest.approx(2.0)
    with pytest.raises(SceneError, match="age_years = 3"):
        beforehand(SHELL, {}, age_years=3.0)
    assert before.without("thickness_um")[place].any() == np.False_


def test_a_calibration_knows_two_together():
    covariance = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
    known = {"puff": Known(1.02, 0.02), "puff_width": Known(0.98, 0.03)}
    before = beforehand(SHELL, known, joint=(("puff", "puff_width"), covariance))
    places = [before.names.index(name) for name in ("puff", "puff_width")]
    assert np.linalg.inv(before.precision[np.ix_(places, places)]) == pytest.approx(covariance)
