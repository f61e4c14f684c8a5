"""The numerical error of a run by its coarser twin: exact where errors are of second order, and never nothing."""

import csv
import json

import numpy as np
import pytest

import taichi_eye
from taichi_eye import cli
from taichi_eye.analysis.error_bar import SAFETY, band, bars, error_bar, history_figures
from taichi_eye.analysis.simulated import observe
from taichi_eye.errors import SceneError
from taichi_eye.ladder.choose import choose
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.ladder.trial import run_to_stop
from taichi_eye.ladder.twin import CLOSEST, Twin, twin_of
from taichi_eye.report.history import summarise
from taichi_eye.scene import load_scene

TIME = np.arange(0.0, 32.0, 0.025)
CAVITY = ("numerics.fidelity=cavity", "numerics.error_bar=true")


def hump(late=0.0):
    return np.exp(-(((TIME - 15.0 - late) / 5.0) ** 2))


@pytest.mark.parametrize("h, ratio", [(0.1, 2.0), (0.23, 1.4)])
def test_an_error_of_second_order_is_told_exactly_and_taken_away(h, ratio):
    draw = np.random.default_rng(5)
    exact = hump() + 0.1 * hump(draw.uniform(1.0, 3.0))
    error = 0.3 * hump(draw.uniform(-4.0, 4.0))
    run, twin = exact + error * h**2, exact + error * (ratio * h) ** 2
    estimate = Twin(None, ratio).share * (run - twin)
    np.testing.assert_allclose(run + estimate, exact, atol=1e-12)
    assert (np.abs(run - exact) <= band(TIME, estimate)).all()
    found = bars(lambda values: history_figures(TIME, values), TIME, run, estimate)
    true = history_figures(TIME, exact)
    for name, value in found.values.items():
        assert abs(value - true[name]) <= found.errors[name], name
        assert found.extrapolated[name] == pytest.approx(true[name], abs=1e-9)
    assert found.errors["peak"] <= 2.5 * SAFETY * abs(found.values["peak"] - true["peak"])


def test_where_two_runs_cross_the_bar_is_not_nothing():
    run = hump()
    # an error that is nothing at the peak, and grows on both sides of it
    estimate = 1e-3 * np.sin((TIME - 15.0) / 2.0)
    found = bars(lambda values: {"peak": summarise(TIME, values).peak}, TIME, run, estimate)
    assert found.errors["peak"] > 1e-4
    assert band(TIME, estimate)[np.argmax(run)] > 1e-3
    assert (band(TIME, 0.0 * estimate) == 0.0).all()


def test_a_figure_that_one_of_the_readings_lacks_has_no_bar():
    found = bars(lambda values: {"rise": summarise(TIME, values - 0.5).half_rise_ms}, TIME, hump() - 0.6, hump())
    assert found.values["rise"] is None and found.errors["rise"] is None


@pytest.mark.parametrize("rung", ["membrane", "cavity", "added_mass", "mfpm"])
@pytest.mark.parametrize("spacing", [0.09, 0.2, 0.33, 0.42])
def test_a_twin_is_the_same_eye_coarser_by_one_ratio(rung, spacing):
    words = (f"numerics.fidelity={rung}", f"numerics.spacing_mm={spacing}", "numerics.error_bar=true")
    scene = load_scene(None, (*words, "numerics.mean_sound_speed_m_s=200", "eye.iop_mmhg=17"))
    twin = twin_of(scene)
    assert CLOSEST <= twin.ratio <= 2.2
    assert twin.scene.numerics.spacing_mm == pytest.approx(spacing * twin.ratio)
    coarser = twin.ratio if rung == "mfpm" else 1.0
    assert twin.scene.numerics.sound_speed_m_s == pytest.approx(scene.numerics.sound_speed_m_s / coarser)
    assert twin.scene.numerics.mean_sound_speed_m_s == pytest.approx(200.0 / coarser)
    kept = ("spacing_mm", "sound_speed_m_s", "mean_sound_speed_m_s", "error_bar")
    for name, value in twin.scene.values().items():
        assert name.split(".")[1] in kept or value == scene.values()[name], name


def test_an_eye_that_takes_no_coarser_twin_is_refused_with_what_it_takes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "--set", "numerics.spacing_mm=0.55", "--set", "numerics.error_bar=true", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and "numerics.spacing_mm = 0.55" in said and not list(tmp_path.iterdir())
    most = float(said.split("at most ")[1].split()[0])
    assert twin_of(load_scene(None, (f"numerics.spacing_mm={0.995 * most}",))).ratio >= CLOSEST
    with pytest.raises(SceneError):
        twin_of(load_scene(None, (f"numerics.spacing_mm={1.1 * most}",)))


def test_auto_leaves_room_for_the_twin():
    shallow = ("chamber.lens_radius_mm=10", "chamber.lens_height_mm=1.6", "chamber.depth_mm=2.7")
    words = ("numerics.fidelity=auto", "numerics.tolerance_percent=1", "numerics.spacing_mm=0.1", *shallow)
    chosen = choose(load_scene(None, (*words, "numerics.error_bar=true"))).scene
    assert twin_of(chosen).ratio >= CLOSEST


def test_the_true_error_of_a_run_lies_inside():
    words = ("cornea.thickness_mm=0.48", "eye.iop_mmhg=13.5", "numerics.spacing_mm=0.22")
    scene = load_scene(None, (*CAVITY, *words))
    twin = twin_of(scene)
    run = observe(scene)
    bar = error_bar(twin, run, observe(twin.scene))
    fine = observe(with_numerics(scene, spacing_mm=0.055))
    true, exact = fine.outcome.traces["apex_displacement_mm"], vars(fine.read().response)
    assert (np.abs(bar.apex_mm - true) <= bar.band_mm).all()
    assert np.abs(bar.extrapolated_mm - true).max() < np.abs(bar.apex_mm - true).max()
    inside = [abs(v - exact[name]) <= bar.response.errors[name] for name, v in bar.response.values.items() if v]
    assert len(inside) > 20 and np.mean(inside) > 0.9


SMALL = (
    *CAVITY,
    "numerics.spacing_mm=0.3",
    "numerics.duration_ms=8",
    "camera.view=scheimpflug",
    "camera.width_px=192",
    "camera.height_px=96",
    "camera.apex_column_px=96",
)


def test_a_run_states_its_error_in_every_place(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sets = [word for entry in SMALL for word in ("--set", entry)]
    assert cli.main(["run", *sets, "--out", "run", "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "+-" in said.splitlines()[-1]
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    errors, limits = summary["numerical_error"], summary["extrapolated"]
    assert errors["apex_displacement_mm"].keys() == limits["apex_displacement_mm"].keys()
    peak = summary["apex_displacement_mm"]["peak"]
    assert (
        0.0 < abs(limits["apex_displacement_mm"]["peak"] - peak) <= errors["apex_displacement_mm"]["peak"] < 0.1 * peak
    )
    assert summary["response"].keys() == errors["response"].keys() and summary["twin"]["ratio"] == 2.0
    shown = [name for name, value in summary["response"].items() if value is not None]
    assert shown and all(f"{name} " in said for name in shown if errors["response"][name] is not None)
    with open(tmp_path / "run" / "error_bar.csv", encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    columns = dict(zip(head, np.array(rows, dtype=float).T))
    traces = taichi_eye.resume(tmp_path / "run").traces
    np.testing.assert_array_equal(columns["apex_displacement_mm"], traces["apex_displacement_mm"])
    assert columns["numerical_error_mm"].max() == errors["apex_history_mm"]
    assert (np.abs(columns["extrapolated_mm"] - columns["apex_displacement_mm"]) <= columns["numerical_error_mm"]).all()


def test_a_twin_that_is_stopped_makes_a_warning_in_place_of_an_error(tmp_path, monkeypatch):
    def stopped(simulation, on_frame, on_sample):
        run_to_stop(simulation, on_frame, on_sample)
        return taichi_eye.RunStopped("the membrane went slack", "node 3", 5.0, "Lower the puff.")

    monkeypatch.setattr("taichi_eye.recording.error_bar.run_to_stop", stopped)
    summary = taichi_eye.run(load_scene(None, SMALL), out=tmp_path / "run").summary
    assert summary["status"] == "complete" and "numerical_error" not in summary
    assert "numerics.error_bar" in summary["warnings"][0] and "went slack" in summary["warnings"][0]
    assert not (tmp_path / "run" / "error_bar.csv").exists()
