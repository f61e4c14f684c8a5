"""A globe that yields: the volume it takes up, and the energy that goes with it."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation
from taichi_eye.units import MM3, MMHG

CHEAP = ["numerics.spacing_mm=0.35", "numerics.sound_speed_m_s=40", "numerics.duration_ms=16"]


@pytest.fixture(scope="module")
def runs():
    backend.init("cpu", "f64")
    return {c: Simulation(load_scene(None, [*CHEAP, f"chamber.compliance_mm3_mmhg={c}"])).run() for c in (0, 1.35)}


def test_a_yielding_globe_is_dented_deeper_at_lower_pressure(runs):
    sealed, yielding = runs[0], runs[1.35]
    assert yielding["apex_displacement_mm"].max() > 1.2 * sealed["apex_displacement_mm"].max()
    assert yielding["fluid_pressure_apex_kpa"].max() < sealed["fluid_pressure_apex_kpa"].max()


@pytest.mark.parametrize("compliance", [0, 1.35])
def test_volume_and_energy_are_accounted_for(runs, compliance):
    traces = runs[compliance]
    # what the globe has taken up counts as there; left is the compression of the liquid
    assert np.abs(traces["chamber_volume_error"]).max() < 3e-3
    work = np.abs(traces["puff_work_uj"]).max()
    assert np.abs(traces["energy_error_uj"]).max() < 0.01 * work


SHORT = [*CHEAP, "chamber.compliance_mm3_mmhg=0.3"]


def history(model, *more):
    scene = load_scene(None, [*SHORT, *more, f'numerics.fidelity="{model}"'])
    return simulation_of(scene).run()


@pytest.mark.parametrize("model", ["cavity", "mfpm"])
def test_a_late_globe_lies_between_one_that_yields_at_once_and_one_that_does_not(model):
    peaks = [
        history(model, f"chamber.globe_delay_ms={delay}")["apex_displacement_mm"].max() for delay in (0, 0.01, 3, 1000)
    ]
    stiff = history(model, "chamber.compliance_mm3_mmhg=0")["apex_displacement_mm"].max()
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-3)
    assert peaks[0] > peaks[2] > peaks[3] > stiff and peaks[3] == pytest.approx(stiff, rel=0.02)


@pytest.mark.parametrize("model", ["cavity", "mfpm"])
def test_a_late_globe_takes_energy_and_the_balance_closes(model):
    prompt, late = history(model), history(model, "chamber.globe_delay_ms=3")
    work = late["puff_work_uj"].max()
    assert np.abs(prompt["tissue_loss_uj"]).max() < 1e-6 * work
    assert late["tissue_loss_uj"][-1] > 0.01 * work and np.diff(late["tissue_loss_uj"]).min() > -1e-6 * work
    assert np.abs(late["energy_error_uj"]).max() < 0.01 * work


@pytest.mark.parametrize("late", [0.0, 0.7])
def test_what_the_globe_takes_up_follows_the_pressure_by_its_law(late):
    scene = load_scene(None, [*SHORT, f"chamber.globe_delay_ms={late}"])
    eye = Simulation(scene)
    times, taken, pressure = [], [], []

    def keep(eye):
        times.append(eye.time_ms)
        taken.append(eye.aqueous.globe.taken_up[0])
        pressure.append(eye.aqueous.globe.mean_pressure[0])

    eye.run(on_sample=keep)
    goal = 0.3 * MM3 / MMHG * np.array(pressure)
    expected = goal.copy()
    if late:
        # the exact answer to a pressure that goes evenly from sample to sample
        for k in range(1, len(times)):
            dt, before = times[k] - times[k - 1], expected[k - 1]
            rate = (goal[k] - goal[k - 1]) / dt
            expected[k] = goal[k] - rate * late + (before - goal[k - 1] + rate * late) * np.exp(-dt / late)
    np.testing.assert_allclose(taken, expected, atol=3e-3 * np.max(taken))
