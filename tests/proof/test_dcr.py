"""The clinic's tables: which switches a scene sets, z-scores, slopes, and what the command refuses."""

from pathlib import Path

import numpy as np
import pytest

from taichi_eye.analysis import Response
from taichi_eye.analysis.simulated import Reading
from taichi_eye.cli import main
from taichi_eye.proof import dcr
from taichi_eye.scene import load_scene

QUICK = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.25"]
HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"


def test_switches_are_those_in_which_a_scene_differs_and_go_back_to_the_default():
    assert dcr.switches_of(load_scene()) == {}
    scene = load_scene(HEALTHY)
    found = dcr.switches_of(scene)
    assert {"whole-eye movement", "bending stiffness", "in-plane stiffness", "yielding globe"} <= set(found)
    for name, changes in found.items():
        assert dcr.switches_of(scene.but(changes)).keys() == found.keys() - {name}
    back = scene.but({key: value for changes in found.values() for key, value in changes.items()})
    assert dcr.switches_of(back) == {} and back.chamber == load_scene().chamber
    # without relaxing tissue its time does not matter
    assert back.but({"cornea.relaxation_ms": 1.0}).cornea == load_scene().cornea


@pytest.mark.parametrize("tissue", [["cornea.prestrain=0.05"], ["cornea.exponent_s=40"]])
def test_a_tissue_given_in_another_way_goes_back_too(tissue):
    scene = load_scene(None, [*tissue, "eye.iop_mmhg=20"])
    assert (
        scene.but(dcr.switches_of(scene)["in-plane stiffness"]).cornea == load_scene(None, ["eye.iop_mmhg=20"]).cornea
    )


def test_a_parameter_is_within_the_norms_where_one_population_has_it_so():
    head, body = dcr.norms_table(Response(a1_time_ms=7.0, hc_radius_mm=4.0, deformation_amplitude_mm=1.05))
    rows = {row[0]: row for row in body}
    assert rows["A1 ms"][-1] == "yes" and "(-0.9)" in rows["A1 ms"][head.index("iran (z)")]
    assert rows["A1 ms"][head.index("elderly (z)")] == "" and rows["HC R mm"][-1] == "NO" and rows["A2 ms"][-1] == "NO"


def test_slopes_are_those_of_a_line_and_leave_stopped_runs_out():
    steps = (-1.0, 0.0, 1.0, 2.0)
    line = [Reading(Response(peak_distance_mm=5.0 - 0.094 * step)) for step in steps]
    assert dcr.slope(steps, line, "peak_distance_mm") == pytest.approx(-0.094)
    line[3] = Reading(Response(peak_distance_mm=50.0), "stopped")
    assert dcr.slope(steps, line, "peak_distance_mm") == pytest.approx(-0.094)
    line[0] = Reading(Response())
    assert np.isnan(dcr.slope(steps, line, "peak_distance_mm"))
    head, body = dcr.slope_table(
        [Reading(Response(deformation_amplitude_mm=1.0 - 0.031 * step)) for step in dcr.IOP_STEPS_MMHG],
        [Reading(Response())] * 5,
    )
    first = dict(zip(head, body[0]))
    assert body[0][:5] == ["DA mm", "-0.0310", "-0.031", "1.00", "yes"] and first["holds"] == "NO"


def test_a_scene_without_a_puff_is_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["clinic", str(HEALTHY), "--set", "puff.peak_kpa=0"]) == 2
    assert "puff.peak_kpa" in capsys.readouterr().err and list(tmp_path.iterdir()) == []
