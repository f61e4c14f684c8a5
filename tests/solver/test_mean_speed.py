"""A mean pressure that is stiffer than the waves: the chamber's compliance goes, the rest stays."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation

CHEAP = ["numerics.spacing_mm=0.35", "numerics.duration_ms=15"]


def history(c, *more):
    return Simulation(load_scene(None, [*CHEAP, f"numerics.sound_speed_m_s={c}", *more])).run()


@pytest.fixture(scope="module")
def runs():
    backend.init("cpu", "f64")
    return {"soft": history(20), "stiff": history(80), "stiff mean": history(20, "numerics.mean_sound_speed_m_s=80")}


def test_a_soft_liquid_with_a_stiff_mean_moves_the_cornea_as_a_stiff_one_does(runs):
    apex = {name: traces["apex_displacement_mm"] for name, traces in runs.items()}
    off = {name: np.abs(apex[name] - apex["stiff"]).max() / apex["stiff"].max() for name in apex}
    assert off["soft"] > 0.02 and off["stiff mean"] < 0.005


@pytest.mark.parametrize("name, speed", [("soft", 20.0), ("stiff", 80.0), ("stiff mean", 80.0)])
def test_the_chamber_gives_way_as_the_mean_says(runs, name, speed):
    traces = runs[name]
    pressure = traces["fluid_pressure_apex_kpa"][-1] * 1e3
    excess = pressure - traces["fluid_pressure_apex_kpa"][0] * 1e3
    assert traces["chamber_volume_error"][-1] == pytest.approx(-excess / (1000.0 * speed**2), rel=0.05)


def test_energy_is_accounted_for(runs):
    for traces in runs.values():
        assert np.abs(traces["energy_error_uj"]).max() < 0.003 * np.abs(traces["puff_work_uj"]).max()


def test_a_stiff_mean_costs_no_steps_until_its_own_limit_binds():
    def steps(*more):
        eye = Simulation(load_scene(None, [*CHEAP, "numerics.duration_ms=0.5", "numerics.sound_speed_m_s=20", *more]))
        eye.run()
        return eye.steps, eye.step_limit

    assert steps("numerics.mean_sound_speed_m_s=60") == steps()
    stiffer, limit = steps("numerics.mean_sound_speed_m_s=300")
    assert limit == "volume" and stiffer > 2 * steps()[0]
