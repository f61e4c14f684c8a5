"""Numbers of a history, on shapes whose numbers are known."""

import numpy as np
import pytest

from taichi_eye.report.history import summarise


def test_triangle():
    t = np.arange(0, 40.5, 0.5)
    history = summarise(t, np.minimum(t / 10, (40 - t) / 30))
    lift = history.peak - 1  # of the parabola over the tip: less than half a step of the flanks
    assert 0 < lift < 0.5 * 0.5 / 10
    assert (history.half_rise_ms, history.half_fall_ms) == pytest.approx((5 + 5 * lift, 25 - 15 * lift), rel=1e-12)


def test_parabola_is_exact_between_samples_of_any_spacing():
    t = np.array([0.0, 1.0, 1.7, 3.1, 4.0])
    history = summarise(t, 2.0 - 0.3 * (t - 2.2) ** 2)
    assert (history.peak, history.peak_time_ms) == pytest.approx((2.0, 2.2), rel=1e-12)


def test_gaussian():
    t = np.linspace(0, 32, 1000)
    history = summarise(t, 0.9 * np.exp(-0.5 * ((t - 14.8) / 4.0) ** 2))
    assert history.peak == pytest.approx(0.9, rel=1e-7)
    assert history.peak_time_ms == pytest.approx(14.8, abs=1e-4)
    assert history.fwhm_ms == pytest.approx(2 * 4.0 * np.sqrt(2 * np.log(2)), abs=1e-4)
    assert history.fall_to_rise == pytest.approx(1.0, abs=1e-4)


def test_skewed_hump():
    t = np.linspace(0, 40, 4001)
    left, right = np.exp(-np.log(2) * ((t - 15) / 5) ** 2), np.exp(-np.log(2) * ((t - 15) / 6) ** 2)
    history = summarise(t, np.where(t < 15, left, right))
    assert (history.half_rise_ms, history.half_fall_ms) == pytest.approx((10, 21), abs=1e-4)
    assert history.fall_to_rise == pytest.approx(1.2, abs=1e-3)


def test_the_crossings_next_to_the_peak_count():
    history = summarise(range(9), [0, 0.6, 0.2, 1, 1, 1, 0.2, 0.6, 0])
    assert 2 < history.half_rise_ms < 3 and 5 < history.half_fall_ms < 6


def test_unfinished_flat_and_inverted_histories():
    rising = summarise([0, 1, 2], [0, 1, 2])
    assert (rising.peak, rising.peak_time_ms, rising.half_rise_ms) == (2, 2, 1)
    assert rising.half_fall_ms is rising.fwhm_ms is rising.fall_to_rise is None
    for values in ([0, 0, 0], [-1, -1, -2], [-3, -2, -1]):
        still = summarise([0, 1, 2], values)
        assert still.half_rise_ms is still.half_fall_ms is still.fall_to_rise is None
    assert summarise([3], [1]).peak == 1
