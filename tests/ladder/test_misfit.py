"""Misfits of histories that differ in a known way."""

import numpy as np
import pytest

from taichi_eye.ladder.misfit import extrapolate, misfit

TIME = np.linspace(0.0, 32.0, 1281)


def history(peak=1.0, shift=0.0, pressure=1.0):
    hump = np.exp(-(((TIME - 15.0 - shift) / 5.0) ** 2))
    return {"time_ms": TIME, "apex_displacement_mm": peak * hump, "fluid_pressure_apex_kpa": 2.0 + pressure * hump}


def test_equal_histories_have_none():
    assert misfit(history(), history()).of("pressure") == 0.0


def test_a_deeper_peak_is_its_share():
    found = misfit(history(1.02), history())
    assert found.peak == pytest.approx(2.0) and found.history == pytest.approx(2.0, rel=1e-3)
    assert found.half_times == pytest.approx(0.0, abs=1e-6)
    assert found.rms == pytest.approx(2.0 * np.sqrt((history()["apex_displacement_mm"] ** 2).mean()), rel=1e-3)


def test_a_late_history_is_its_shift_over_the_width():
    found = misfit(history(shift=0.1), history())
    width = 2.0 * 5.0 * np.sqrt(np.log(2.0))
    assert found.half_times == pytest.approx(100.0 * 0.1 / width, rel=1e-3)
    # steepest where exp(-x^2) is: slope sqrt(2/e) per width
    assert found.history == pytest.approx(100.0 * 0.1 / 5.0 * np.sqrt(2.0 / np.e), rel=1e-2)
    assert found.of("apex") == max(found.half_times, found.history, found.peak)


def test_pressure_counts_only_where_it_is_asked_for():
    found = misfit(history(pressure=1.1), history())
    assert found.of("apex") == 0.0 and found.of("pressure") == pytest.approx(10.0, rel=1e-3)


def test_extrapolation_of_a_second_order_error_is_exact():
    exact, coarse, fine = history(), history(1.0 + 0.04), history(1.0 + 0.01)
    limit = extrapolate(fine, coarse, 2.0)
    assert misfit(limit, exact).of("pressure") < 1e-10


def test_a_run_that_ended_early_is_judged_where_it_ran():
    short = {name: column[:400] for name, column in history().items()}
    assert misfit(short, history()).history == 0.0
