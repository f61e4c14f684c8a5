"""DCR parameters of curves whose parameters are known in closed form."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from taichi_eye.analysis.curves import Curves, curves_from_wall, grid, smooth
from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS, NORMS, POPULATIONS, judged_by
from taichi_eye.analysis.response import (
    CURVATURE_MM,
    READ_AS,
    Response,
    biop_surrogate_mmhg,
    circle,
    histories,
    moving,
    respond,
    shown_iop_nct_mmhg,
)

TIMES = 0.2315 * np.arange(139)


def puff(time):
    return np.exp(-(((time - 16.0) / 5.0) ** 2))


def parabolas(depth=1.0, whole=0.0):
    """Curvature falls from 1/8 to -1/7 in step with the apex, the whole eye moves by `whole`."""
    x = grid()
    load = puff(TIMES)[:, None]
    bend = 0.125 - (0.125 + 1.0 / 7.0) * load
    inner = np.where(np.abs(x) < 1.3, x**2, 1.3**2 + 2.6 * (np.abs(x) - 1.3))
    far = np.clip((np.abs(x) - 1.3) / 1.7, 0.0, 1.0)
    height = -0.0625 * x**2 * far - (1 - far) * 0.5 * bend * inner - (1 - far**2) * depth * load - whole * load
    return Curves(TIMES, x, height, np.full(len(TIMES), 0.55))


@pytest.mark.parametrize("radius", [7.8, 3.5, -3.5, -7.0])
def test_circle_has_its_curvature(radius):
    x = grid()
    inside = np.abs(x) < 2.0
    z = np.where(inside, np.sign(radius) * np.sqrt(radius**2 - np.where(inside, x, 0.0) ** 2), np.nan)
    assert circle(x, z + 3.0, CURVATURE_MM)[0] == pytest.approx(1.0 / radius, rel=2e-4)


def test_applanations_lie_where_the_curvature_vanishes():
    response = respond(parabolas())
    share = 0.125 / (0.125 + 1.0 / 7.0)  # of the puff, at which the curvature is zero
    late = 5.0 * np.sqrt(-np.log(share))
    assert response.a1_time_ms == pytest.approx(16.0 - late, abs=0.03)
    assert response.a2_time_ms == pytest.approx(16.0 + late, abs=0.03)
    speed = 2.0 * late / 25.0 * share
    assert response.a1_velocity_m_s == pytest.approx(speed, rel=0.02)
    assert response.a2_velocity_m_s == pytest.approx(-speed, rel=0.02)
    assert response.hc_time_ms == pytest.approx(16.0, abs=0.02)
    assert response.deformation_amplitude_mm == pytest.approx(1.0, abs=2e-3)
    assert response.hc_radius_mm == pytest.approx(7.0, rel=0.02)
    assert response.central_thickness_um == pytest.approx(550.0)


def test_inverse_radius_is_summed_over_the_frames_between_the_applanations():
    # a parabola's curvature is that of narrow zones
    response = respond(parabolas(), inverse_mm=1.0)
    inverse = -(0.125 - (0.125 + 1.0 / 7.0) * puff(TIMES))
    assert response.integrated_inverse_radius_per_mm == pytest.approx(inverse[inverse > 0].sum(), rel=0.02)
    assert response.max_inverse_radius_per_mm == pytest.approx(1.0 / 7.0, rel=0.02)
    coarse = respond(parabolas(), frame_interval_ms=0.463, inverse_mm=1.0)
    assert coarse.integrated_inverse_radius_per_mm == pytest.approx(0.5 * inverse[inverse > 0].sum(), rel=0.03)


def test_whole_eye_movement_is_told_from_deflection():
    still, moved = respond(parabolas(0.8)), respond(parabolas(0.8, whole=0.3))
    assert still.whole_eye_movement_mm is None
    assert moved.whole_eye_movement_mm == pytest.approx(0.3, abs=2e-3)
    assert moved.deformation_amplitude_mm == pytest.approx(still.deformation_amplitude_mm + 0.3, abs=2e-3)
    assert moved.hc_deflection_mm == pytest.approx(still.hc_deflection_mm, abs=2e-3)
    assert moved.da_ratio_2mm < still.da_ratio_2mm


def test_area_and_arc_length_of_a_cone():
    x = grid()
    load = puff(TIMES)[:, None]
    height = -load * np.clip(1.0 - np.abs(x) / 3.0, 0.0, None)
    response = respond(Curves(TIMES, x, height))
    assert response.hc_deflection_area_mm2 == pytest.approx(3.0, rel=0.01)
    # the smoothing rounds the tip off
    assert response.hc_delta_arc_length_mm == pytest.approx(2.0 * (np.hypot(3.0, 1.0) - 3.0), rel=0.05)
    assert response.deformation_amplitude_mm == pytest.approx(1.0, abs=0.05)


def test_missing_frames_change_little():
    whole = parabolas()
    keep = np.random.default_rng(0).choice(len(TIMES), 110, replace=False)
    keep.sort()
    thinned = respond(Curves(TIMES[keep], whole.x_mm, whole.height_mm[keep], whole.thickness_mm[keep]))
    full = respond(whole)
    assert thinned.a1_time_ms == pytest.approx(full.a1_time_ms, abs=0.05)
    assert thinned.deformation_amplitude_mm == pytest.approx(full.deformation_amplitude_mm, abs=2e-3)
    assert thinned.integrated_inverse_radius_per_mm == pytest.approx(full.integrated_inverse_radius_per_mm, rel=0.01)


def test_an_eye_that_does_not_move_has_no_parameters_but_its_thickness():
    resting = Curves(TIMES, grid(), np.tile(-0.0625 * grid() ** 2, (len(TIMES), 1)), np.full(len(TIMES), 0.5))
    assert respond(resting).deformation_amplitude_mm is None
    assert respond(resting).central_thickness_um == pytest.approx(500.0)


def test_stiffness_parameter_is_the_pressure_left_over_the_deflection():
    response = respond(parabolas(), biop_mmhg=15.0, puff_mmhg=lambda t: 10.0 * t)
    assert response.sp_a1_mmhg_mm == pytest.approx((10.0 * response.a1_time_ms - 15.0) / response.a1_deflection_mm)
    assert biop_surrogate_mmhg(16.0, 550.0, 50.0) == pytest.approx(19.98 + 14.16 - 16.83 - 2.19)


def test_a_simulated_eye_shows_the_pressures_that_the_instrument_would():
    response = respond(parabolas(), age_years=60.0, puff_mmhg=lambda t: 10.0 * t)
    assert response.iop_nct_mmhg == pytest.approx(16.8 + (response.a1_time_ms - 7.36) / 0.134)
    assert response.biop_mmhg == pytest.approx(biop_surrogate_mmhg(response.iop_nct_mmhg, 550.0, 60.0))
    over = 10.0 * response.a1_time_ms - response.biop_mmhg
    assert response.sp_a1_mmhg_mm == pytest.approx(over / response.a1_deflection_mm)
    # the means of the 194 eyes belong to one age
    assert biop_surrogate_mmhg(16.6, 551.0, ELDERLY_AGE_YEARS) == pytest.approx(14.75, abs=0.05)
    assert shown_iop_nct_mmhg(NORMS["iran"]["a1_time_ms"][0]) == pytest.approx(POPULATIONS["iran"].iop_mmhg[0])


@pytest.mark.parametrize("half, depth", [(2.4, 0.9), (2.0, 0.6)])
def test_the_circle_radius_is_that_of_the_circle_through_both_peaks_and_the_apex(half, depth):
    x = grid()
    height = -puff(TIMES)[:, None] * 0.5 * depth * (1.0 + np.cos(np.pi * np.clip(x / half, -2.0, 2.0)))
    response = respond(Curves(TIMES, x, height))
    assert response.peak_distance_mm == pytest.approx(2.0 * half, rel=0.01)
    assert response.hc_circle_radius_mm == pytest.approx((half**2 + depth**2) / (2.0 * depth), rel=0.02)
    assert response.hc_radius_mm < response.hc_circle_radius_mm


def test_a_parameter_is_judged_by_one_population_for_all():
    assert judged_by("deformation_amplitude_mm") == ("elderly", *NORMS["elderly"]["deformation_amplitude_mm"])
    assert judged_by("a2_time_ms") == ("china", *NORMS["china"]["a2_time_ms"])
    assert judged_by("a1_length_mm") is None
    known = set(vars(Response()))
    assert all(set(norms) <= known & set(READ_AS) for norms in NORMS.values()) and set(NORMS) == set(POPULATIONS)


def test_a_narrower_circle_sees_a_later_applanation_of_a_dent_that_starts_wide():
    x = grid()
    load = puff(TIMES)[:, None]
    height = -0.0625 * x**2 + load * 0.14 * (x**2 - 0.03 * x**4) - load
    wide, narrow = (respond(Curves(TIMES, x, height), curvature_mm=mm).a1_time_ms for mm in (1.5, 0.75))
    assert wide > narrow
    share = 0.0625 / 0.14  # of the puff, at which the apex itself is flat
    assert narrow == pytest.approx(16.0 - 5.0 * np.sqrt(-np.log(share)), abs=0.1)


def test_moving_polynomial_reproduces_polynomials_and_bridges_gaps():
    time = np.concatenate([np.arange(0.0, 5.0, 0.2), np.arange(7.0, 12.0, 0.2)])
    values = 1.0 + 2.0 * time - 0.3 * time**2
    at = np.array([2.0, 6.0, 9.9])
    assert moving(time, values, at, 0.8, 2) == pytest.approx(1.0 + 2.0 * at - 0.3 * at**2)
    assert moving(time, values, at, 0.8, 2, 1) == pytest.approx(2.0 - 0.6 * at)


def test_curves_of_a_wall_start_at_rest_height_zero():
    r = np.linspace(0.0, 5.8, 60)
    z = np.stack([np.sqrt(7.8**2 - r**2) - depth * np.exp(-(r**2)) for depth in (0.0, 0.5)])
    curves = curves_from_wall(np.array([0.0, 1.0]), np.stack([r, r]), z, 0.5)
    assert curves.height_mm[0, len(grid()) // 2] == 0.0
    assert curves.height_mm[1, len(grid()) // 2] == pytest.approx(-0.5)
    x = grid()
    assert curves.height_mm[0] == pytest.approx(np.sqrt(7.8**2 - x**2) - 7.8, abs=1e-5)
    assert histories(curves).curvature_per_mm[0] == pytest.approx(1 / 7.8, rel=1e-3)


def test_walls_are_splined_as_one_by_one():
    rng = np.random.default_rng(3)
    r = np.cumsum(np.hstack([np.zeros((6, 1)), rng.uniform(0.1, 0.4, (6, 24))]), axis=1)
    r[5, 12] = r[5, 11] - 0.05  # a wall that hangs over
    z = 2.0 - 0.06 * r**2 + rng.normal(0.0, 0.02, r.shape)
    curves = curves_from_wall(np.arange(6.0), r, z)
    x, heights = np.abs(curves.x_mm), []
    for row in range(6):
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(r[row])) > 1e-9])
        spline = CubicSpline(r[row, keep], z[row, keep], bc_type=((1, 0.0), "not-a-knot"))
        heights.append(np.where(x <= r[row, keep][-1], spline(x), np.nan))
    np.testing.assert_allclose(curves.height_mm, np.array(heights) - heights[0][len(x) // 2], rtol=0, atol=1e-12)


def test_a_moving_polynomial_is_the_weighted_fit_whatever_is_missing():
    rng = np.random.default_rng(4)
    time = np.delete(TIMES, [3, 4, 5, 6, 7, 8, 50, 51])
    values, at = rng.normal(size=len(time)), np.concatenate([rng.uniform(-0.5, 32.5, 40), TIMES[:9]])
    values[20] = np.nan
    for degree, derivative, half in ((1, 0, 0.7), (2, 1, 0.8), (3, 0, 1.6)):
        found = moving(time, values, at, half, degree, derivative)
        good = np.isfinite(values)
        for one, value in zip(at, found):
            distance = np.abs(time[good] - one)
            width = max(half, 1.01 * np.sort(distance)[degree + 2])
            weight = np.sqrt(np.clip(1.0 - (distance / width) ** 2, 0.0, None) ** 2)
            shape = ((time[good] - one) / width)[:, None] ** np.arange(degree + 1)
            fit = np.linalg.lstsq(shape * weight[:, None], values[good] * weight, rcond=None)[0]
            assert value == pytest.approx(fit[derivative] / width**derivative, rel=1e-6, abs=1e-8)


def test_curves_with_gaps_are_smoothed_as_one_by_one():
    rng = np.random.default_rng(5)
    height = rng.normal(size=(7, len(grid())))
    height[1, :30], height[2, 200:203], height[4, :30], height[5] = np.nan, np.nan, np.nan, np.nan
    together = smooth(height)
    for row in range(7):
        np.testing.assert_allclose(together[row], smooth(height[row : row + 1])[0], rtol=0, atol=1e-12)
    assert np.isnan(together[5]).all() and np.isfinite(together[2]).all() and np.isnan(together[1, :30]).all()
