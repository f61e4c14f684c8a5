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


def lagging(times, goal, late):
    """The exact answer of dy/dt = (goal - y) / late to a goal that goes evenly from time to time."""
    found = goal.copy()
    for k in range(1, len(times)):
        dt, before = times[k] - times[k - 1], found[k - 1]
        rate = (goal[k] - goal[k - 1]) / dt
        found[k] = goal[k] - rate * late + (before - goal[k - 1] + rate * late) * np.exp(-dt / late)
    return found


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
    expected = goal
    if late:
        expected = lagging(times, goal, late)
    np.testing.assert_allclose(taken, expected, atol=3e-3 * np.max(taken))


STIFFENING = ("chamber.globe_law=friedenwald", "eye.iop_mmhg=18", "camera.frame_interval_ms=0.05")


@pytest.mark.parametrize("model", ["cavity", "added_mass", "mfpm"])
@pytest.mark.parametrize("late", [0.0, 0.5])
def test_friedenwalds_globe_takes_up_the_logarithm_of_the_pressure(model, late):
    scene = load_scene(None, [*SHORT, *STIFFENING, f"chamber.globe_delay_ms={late}", f"numerics.fidelity={model}"])
    eye = simulation_of(scene)
    times, taken, pressure = [], [], []

    def keep(eye):
        globe = eye.aqueous.globe if model == "mfpm" else eye.stepper.globe
        if times and eye.time_ms == times[-1]:
            return  # a reduced run shows its end again
        times.append(eye.time_ms)
        taken.append(globe.taken_up[0])
        pressure.append(globe.mean_pressure[0])

    traces = eye.run(on_sample=keep)
    # 0.3 mm^3/mmHg at 15 mmHg: C P0 is 4.5 mm^3 at any pressure
    goal = 4.5 * MM3 * np.log1p(np.array(pressure) / (18.0 * MMHG))
    assert max(taken) > 0.5 * MM3
    if not late:
        np.testing.assert_allclose(taken, goal, rtol=1e-9, atol=1e-6 * max(taken))
    else:
        np.testing.assert_allclose(taken, lagging(times, goal, late), atol=0.01 * max(taken))
    work = traces["puff_work_uj"].max()
    assert np.abs(traces["energy_error_uj"]).max() < 5e-3 * work
    assert traces["tissue_loss_uj"][-1] > (0.005 * work if late else -1e-4 * work)


def test_friedenwalds_globe_is_the_linear_one_at_small_pressures_and_stiffer_at_large():
    def rise(law, peak):
        keys = (f"chamber.globe_law={law}", f"puff.peak_kpa={peak}", "numerics.fidelity=cavity")
        pressure = simulation_of(load_scene(None, [*SHORT, *keys])).run()["fluid_pressure_apex_kpa"]
        return (pressure - pressure[0]).max()

    assert rise("friedenwald", 0.02) == pytest.approx(rise("linear", 0.02), rel=0.01)
    assert rise("friedenwald", 10) > 1.02 * rise("linear", 10)
