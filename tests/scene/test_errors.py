"""The errors and the conversion factors."""

import pickle

import pytest

from taichi_eye import units
from taichi_eye.errors import RunStopped


def test_run_stopped_says_everything_and_survives_pickling():
    error = RunStopped("the wall went slack", "membrane node 3", 12.5, "lower puff.peak_kpa")
    copy = pickle.loads(pickle.dumps(error))
    for each in (error, copy):
        assert (each.what, each.where, each.time_ms, each.advice) == (
            "the wall went slack",
            "membrane node 3",
            12.5,
            "lower puff.peak_kpa",
        )
        for part in ("the wall went slack", "membrane node 3", "12.5", "lower puff.peak_kpa"):
            assert part in str(each)


def test_conversion_factors():
    assert 760 * units.MMHG == pytest.approx(101325, rel=1e-6)
    assert (units.MM**2, units.MM**3) == pytest.approx((units.MM2, units.MM3))
    assert units.KPA * units.MM3 == pytest.approx(units.UJ)
