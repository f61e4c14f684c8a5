"""The response of a scene, read from its computed wall."""

from pathlib import Path

import pytest

from taichi_eye.analysis.simulated import response_of
from taichi_eye.ladder.trial import run_scene
from taichi_eye.scene import load_scene

QUICK = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.25"]
HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"


def test_a_response_is_read_from_the_computed_wall_and_a_stop_is_told():
    still = load_scene(None, QUICK)
    outcome = response_of(still)
    peak = run_scene(still).apex.peak
    assert outcome.stopped == "" and outcome.response.deformation_amplitude_mm == pytest.approx(peak, rel=0.02)
    moved = response_of(load_scene(None, [*QUICK, "eye.whole_eye_movement_mm=0.3"])).response
    assert moved.deformation_amplitude_mm > outcome.response.deformation_amplitude_mm + 0.1
    assert moved.hc_radius_mm == pytest.approx(outcome.response.hc_radius_mm, rel=0.05)
    stopped = response_of(load_scene(HEALTHY, [*QUICK, "cornea.flexural_modulus_mpa=0"]))
    assert "ms" in stopped.stopped


def test_a_run_too_short_to_show_a_response_says_so():
    reading = response_of(load_scene(None, [*QUICK, "numerics.duration_ms=3"]))
    assert reading.stopped == "too few frames" and reading.response.deformation_amplitude_mm is None
