"""Charts: what is worked out from points, and that they can be interrupted and resumed."""

import json

import numpy as np
import pytest

from taichi_eye.cli import main
from taichi_eye.ladder import chart, chart_page
from taichi_eye.ladder.misfit import misfit
from taichi_eye.ladder.points import Point, Setting, finest_limit, limit, run_point, triple
from taichi_eye.scene import load_scene

TIME = np.linspace(0.0, 32.0, 641)


def made(setting, seconds=1.0, by_space=0.02, by_sound=10.0, model=0.0):
    """A point whose peak is off by `by_space` h^2, `by_sound` / c^2 and `model`."""
    c = setting.sound_speed_m_s
    peak = 1.0 + by_space * setting.spacing_mm**2 + (by_sound / c**2 if c else 0.0) + model
    hump = np.exp(-(((TIME - 15.0) / 5.0) ** 2))
    traces = {"time_ms": TIME, "apex_displacement_mm": peak * hump, "fluid_pressure_apex_kpa": 2.0 + peak * hump}
    return Point(setting, traces, seconds, 0.9 * seconds, 3, int(13.0 / setting.spacing_mm**2), 1000)


@pytest.fixture
def scene():
    return load_scene(None)


def test_limit_takes_both_errors_away(scene):
    points = {setting.label: made(setting) for level in chart.LEVELS[1:3] for setting in triple(*level)}
    reference, level, rougher = finest_limit(points, chart.LEVELS)
    assert level == (0.1414, 80.0)
    # the spacings' ratio is sqrt 2 to four digits
    assert reference["apex_displacement_mm"].max() == pytest.approx(1.0, abs=1e-6)
    assert misfit(rougher, reference).history < 1e-3
    fine, coarse, soft = (made(setting) for setting in triple(0.2, 80.0))
    assert limit(fine, coarse, soft)["fluid_pressure_apex_kpa"].max() == pytest.approx(3.0, abs=1e-6)


def test_a_chart_knows_its_front_orders_and_recommendations(scene):
    line = [Setting("mfpm", h, c) for h in (0.4, 0.2828, 0.2, 0.1414) for c in (40.0, 80.0)]
    line += [Setting("mfpm", 0.2, c) for c in (10.0, 20.0, 160.0)]
    points = {s.label: made(s, seconds=1e-4 * s.sound_speed_m_s / s.spacing_mm**3) for s in line}
    for setting, model, seconds in (
        (Setting("cavity", 0.2), -0.02, 0.01),
        (Setting("cavity", 0.1), -0.02, 0.03),
        (Setting("membrane", 0.2), 0.5, 0.02),
    ):
        points[setting.label] = made(setting, seconds, model=model)
    charted = chart.Chart(scene, points)
    exponents = charted.exponents()
    assert exponents["mfpm c 40: time in 1/h"] == pytest.approx(3.0, abs=0.01)
    assert exponents["mfpm c 40: error in h"] == pytest.approx(2.0, abs=0.05)
    assert exponents["mfpm h 0.2: error in 1/c"] == pytest.approx(2.0, abs=0.05)
    front = charted.front()
    assert front[0] == "cavity h 0.2" and "membrane h 0.2" not in front
    errors = [charted.error(label) for label in front]
    assert errors == sorted(errors, reverse=True)
    assert charted.recommended()[3.0] == "cavity h 0.2"
    assert charted.recommended()[1.0].startswith("mfpm")
    # run and twin: errors of second order are gone, at the time of both
    limit, fine, coarse = (
        charted.every[f"mfpm h {words}"] for words in ("0.2 c 80 extrapolated", "0.2 c 80", "0.4 c 40")
    )
    assert limit.traces["apex_displacement_mm"].max() == pytest.approx(1.0, abs=1e-9)
    assert limit.whole_s == pytest.approx(fine.whole_s + coarse.whole_s)
    assert "mfpm h 0.2 c 10 extrapolated" not in charted.every
    shares = charted.shares()
    assert shares["cavity h 0.2"]["model"] == pytest.approx(2.0, rel=0.01)
    assert shares["mfpm h 0.2 c 40"]["sound speed"] == pytest.approx(100.0 * 10.0 / 40.0**2, rel=0.05)
    assert shares["mfpm h 0.2 c 40"]["space"] == pytest.approx(100.0 * 0.02 * 0.2**2, rel=0.05)


def test_a_point_survives_the_file():
    point = made(Setting("added_mass", 0.2, refresh_travel=0.25))
    back = Point.from_dict(json.loads(json.dumps(point.as_dict())))
    assert back.setting == point.setting and back.whole_s == point.whole_s
    assert all(np.array_equal(back.traces[name], column) for name, column in point.traces.items())


def test_a_run_point_is_the_run(scene):
    setting = Setting("cavity", 0.4)
    point = run_point(scene, setting, repeats=2)
    assert point.repeats == 2 and 0.0 < point.solver_s <= point.whole_s and not point.stopped
    assert point.traces["apex_displacement_mm"].max() == pytest.approx(0.96, abs=0.02)
    assert setting.label == "cavity h 0.4" and setting.applied(scene).numerics.fidelity == "cavity"


FEW = [Setting("cavity", 0.4), Setting("cavity", 0.2828), *triple(0.2828, 80.0)]
QUICK = ("--set", "puff.duration_ms=8", "--set", "numerics.duration_ms=5")


def test_charts_resume_where_they_were_interrupted(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(chart, "settings", lambda: FEW)
    measured = []
    real = chart.run_point

    def counted(scene, setting):
        if len(measured) == 2:
            measured.append("stop")
            raise KeyboardInterrupt
        measured.append(setting.label)
        return real(scene, setting, repeats=1)

    monkeypatch.setattr(chart, "run_point", counted)
    folder = tmp_path / "chart"
    assert main(["chart", *QUICK, "--out", str(folder), "--quiet"]) == 130
    assert "--resume" in capsys.readouterr().err
    assert len(json.loads((folder / "chart.json").read_text())["points"]) == 2
    assert main(["chart", *QUICK, "--resume", str(folder), "--quiet", "--json", str(tmp_path / "copy.json")]) == 0
    measured.remove("stop")
    assert sorted(measured) == sorted(setting.label for setting in FEW)
    whole = json.loads((tmp_path / "copy.json").read_text())
    assert set(whole["errors_percent"]) == set(measured) and whole["reference"]["level"] == [0.2828, 80.0]
    assert (folder / "chart.png").stat().st_size > 10_000 and "front" in (folder / "chart.html").read_text()


def test_a_budget_passes_over_what_it_does_not_pay_for(tmp_path, scene, monkeypatch):
    monkeypatch.setattr(chart, "settings", lambda: [Setting("cavity", 0.4), Setting("mfpm", 0.0707, 80.0)])
    charted = chart.measure(scene, tmp_path, {}, budget_s=5.0)
    assert list(charted.points) == ["cavity h 0.4"] and charted.passed_over == ("mfpm h 0.0707 c 80",)
    assert any("No reference" in line for line in chart_page.words(charted))


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--resume", "nowhere"), "chart.json"),
        (("--budget", "0"), "not a positive"),
        (("--resume", "x", "--out", "y"), "leave --out"),
    ],
)
def test_bad_input_is_refused(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["chart", *arguments])
    except SystemExit as stop:
        status = stop.code
    assert status == 2 and said in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_another_scenes_chart_is_not_gone_on_with(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(chart, "settings", lambda: [Setting("cavity", 0.4)])
    assert main(["chart", "--out", str(tmp_path / "a"), "--quiet"]) == 0
    assert main(["chart", "--set", "eye.iop_mmhg=20", "--resume", str(tmp_path / "a"), "--quiet"]) == 2
    assert "another scene" in capsys.readouterr().err
