"""The clinic's tables: which switches a scene sets, z-scores, slopes, and a response read from a computed wall."""

from pathlib import Path

import numpy as np
import pytest

from taichi_eye.analysis import Response
from taichi_eye.cli import main
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.proof import dcr
from taichi_eye.scene import load_scene

QUICK = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.25"]
HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"


def test_switches_are_those_in_which_a_scene_differs_and_go_back_to_the_default():
    default = load_scene()
    assert dcr.switches_of(default, default) == {}
    found = dcr.switches_of(load_scene(HEALTHY), default)
    assert {"whole-eye movement", "bending stiffness", "in-plane stiffness", "yielding globe"} <= set(found)
    for more in found.values():
        assert dcr.switches_of(load_scene(HEALTHY, more), default).keys() <= found.keys()
    everything = [override for more in found.values() for override in more]
    assert dcr.switches_of(load_scene(HEALTHY, everything), default) == {}


def test_a_parameter_is_within_the_norms_where_one_population_has_it_so():
    head, body = dcr.norms_table(Response(a1_time_ms=7.0, hc_radius_mm=4.0, deformation_amplitude_mm=1.05))
    rows = {row[0]: row for row in body}
    assert rows["A1 ms"][-1] == "yes" and "(-0.9)" in rows["A1 ms"][head.index("iran (z)")]
    assert rows["A1 ms"][head.index("elderly (z)")] == "" and rows["HC R mm"][-1] == "NO" and rows["A2 ms"][-1] == "NO"


def test_slopes_are_those_of_a_line_and_leave_stopped_runs_out():
    steps = (-1.0, 0.0, 1.0, 2.0)
    line = [dcr.Outcome(Response(peak_distance_mm=5.0 - 0.094 * step)) for step in steps]
    assert dcr.slope(steps, line, "peak_distance_mm") == pytest.approx(-0.094)
    line[3] = dcr.Outcome(Response(peak_distance_mm=50.0), "stopped")
    assert dcr.slope(steps, line, "peak_distance_mm") == pytest.approx(-0.094)
    line[0] = dcr.Outcome(Response())
    assert np.isnan(dcr.slope(steps, line, "peak_distance_mm"))
    head, body = dcr.slope_table(
        [dcr.Outcome(Response(deformation_amplitude_mm=1.0 - 0.031 * step)) for step in dcr.IOP_STEPS_MMHG],
        [dcr.Outcome(Response())] * 5,
    )
    first = dict(zip(head, body[0]))
    assert body[0][:5] == ["DA mm", "-0.0310", "-0.031", "1.00", "yes"] and first["holds"] == "NO"


def test_a_response_is_read_from_the_computed_wall_and_a_stop_is_told():
    still = load_scene(None, QUICK)
    outcome = dcr.response_of(still)
    peak = simulation_of(still).run()["apex_displacement_mm"].max()
    assert outcome.stopped == "" and outcome.response.deformation_amplitude_mm == pytest.approx(peak, rel=0.02)
    moved = dcr.response_of(load_scene(None, [*QUICK, "eye.whole_eye_movement_mm=0.3"])).response
    assert moved.deformation_amplitude_mm > outcome.response.deformation_amplitude_mm + 0.1
    assert moved.hc_radius_mm == pytest.approx(outcome.response.hc_radius_mm, rel=0.05)
    stopped = dcr.response_of(load_scene(HEALTHY, [*QUICK, "cornea.flexural_modulus_mpa=0"]))
    assert "ms" in stopped.stopped


def test_a_scene_without_a_puff_is_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["clinic", str(HEALTHY), "--set", "puff.peak_kpa=0"]) == 2
    assert "puff.peak_kpa" in capsys.readouterr().err and list(tmp_path.iterdir()) == []
