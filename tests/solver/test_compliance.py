"""A globe that yields: the volume it takes up, and the energy that goes with it."""
import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation

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
