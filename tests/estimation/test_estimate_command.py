"""The commands: what they write, what they refuse, and the study in a short form."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_form import BASE, TIMES_MS, motion, use

from taichi_eye.cli import main
from taichi_eye.errors import SceneError
from taichi_eye.estimation.bounds import at_truth, best_at_truth, of_own_eye
from taichi_eye.estimation.estimate import Estimate, estimate, problem_of
from taichi_eye.estimation.motion import cheap
from taichi_eye.estimation.observation import ParameterRow, of_history
from taichi_eye.estimation.parameters import REPEATABILITY
from taichi_eye.estimation.unknowns import own_values, scene_with
from taichi_eye.proof import estimates
from taichi_eye.scene import load_scene

SCENE = """[puff]
time_course = "corvis"
[chamber]
compliance_mm3_mmhg = 0.05
[numerics]
fidelity = "cavity"
spacing_mm = 0.2
"""
KNOWN = {"puff": 1.0, "puff_width": 1.0, "thickness_um": 530.0, "radius_mm": 7.7}


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "eye.toml"
    path.write_text(SCENE)
    return path


def trace(path, scene, seed, **values):
    """A trace of an eye as a file."""
    motion = cheap(scene_with(scene, {**own_values(scene), **KNOWN, **values}))
    noise = np.random.default_rng(seed).standard_normal(len(TIMES_MS))
    depth = np.interp(TIMES_MS, motion.time_ms, motion.apex_mm) + 0.01 * noise
    path.write_text("time_ms,deflection_mm\n" + "".join(f"{t:.4f},{d:.5f}\n" for t, d in zip(TIMES_MS, depth)))
    return path


def test_an_eye_of_a_rung_is_found_again_and_all_is_written(scene_file, tmp_path, capsys):
    scene = load_scene(scene_file)
    data = trace(tmp_path / "trace.csv", scene, 3, iop_mmhg=21.4, in_plane=1.2, globe=0.9)
    known = [part for name, value in KNOWN.items() for part in ("--known", f"{name}={value}")]
    out = tmp_path / "out"
    arguments = ["estimate", str(data), "--scene", str(scene_file), *known, "--model-error-um", "0", "--noise-um", "10"]
    assert main([*arguments, "--free", "iop_mmhg,globe,in_plane", "--out", str(out), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"estimate.json", "fit.csv", "fit.png", "corner.png"}
    found = json.loads((out / "estimate.json").read_text())
    iop = found["quantities"]["iop_mmhg"]
    assert abs(iop["value"] - 21.4) < 4.0 * iop["standard_deviation"] and iop["standard_deviation"] < 0.3
    low, high = iop["range95"]
    assert low < iop["value"] < high and found["probability"] > 1e-3 and found["rung"] == "cavity"
    for words in (
        "iop_mmhg (intraocular pressure, mmHg)",
        "chi^2",
        "correlation",
        "what carried the IOP",
        "not knowing",
    ):
        assert words in said
    rows = (out / "fit.csv").read_text().splitlines()
    assert rows[0] == "time_ms,measured,fitted,standard_deviation" and len(rows) == 140


@pytest.mark.parametrize(
    "more, words",
    [
        ([], "says nothing of the model that it is fitted with"),
        (["--scene", "SCENE", "--known", "thickness=550"], "no such unknown"),
        (["--scene", "SCENE", "--known", "thickness_um"], "must read NAME=VALUE"),
        (["--scene", "SCENE", "--known", "thickness_um=5+-5+-5"], "must read NAME=VALUE"),
        (["--scene", "SCENE", "--free", "globe"], "is what is estimated"),
        (["--scene", "SCENE", "--row", "2"], "no rows"),
        (["--scene", "SCENE", "--instrument", "SCENE"], "is no calibration"),
        (["--scene", "SCENE", "--set", "puff.peak_kpa=0"], "does not move"),
        (
            ["--scene", "SCENE", "--set", "puff.time_course=file", "--set", "puff.file=puff.csv"],
            "a file has none to vary",
        ),
        (["--scene", "SCENE", "--calibrate-rows"], "at least three rows"),
        (["--scene", "SCENE", "--age-years", "200"], "age_years = 200"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(scene_file, tmp_path, monkeypatch, capsys, more, words):
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "trace.csv"
    depth = 0.9 * np.exp(-(((TIMES_MS - 16.0) / 5.0) ** 2))
    data.write_text("time_ms,deflection_mm\n" + "".join(f"{t:.4f},{d:.5f}\n" for t, d in zip(TIMES_MS, depth)))
    (tmp_path / "puff.csv").write_text("time_ms,pressure_kpa\n0,0\n15,10\n30,0\n")
    before = set(tmp_path.iterdir())
    assert main(["estimate", str(data), *(str(scene_file) if one == "SCENE" else one for one in more), "--quiet"]) == 2
    assert words in capsys.readouterr().err and set(tmp_path.iterdir()) == before


def test_rows_are_estimated_beside_their_own_pressures(scene_file, tmp_path, monkeypatch, capsys):
    # in closed form: reading a motion as a clinic does takes most of the time
    slopes = {"a1_time_ms": (7.4, 2.0), "deformation_amplitude_mm": (1.05, -0.4), "a2_time_ms": (21.8, -1.5)}
    shown = lambda name, iop: slopes[name][0] + slopes[name][1] * np.log(iop / 15.0)
    monkeypatch.setattr(
        ParameterRow, "predict", lambda row, motion: np.array([shown(n, motion.scene.eye.iop_mmhg) for n in row.names])
    )
    text = ",".join((*slopes, "CCT", "bIOP")) + "\n"
    for iop in (13.0, 17.0, 22.0):
        text += ",".join(f"{shown(name, iop):.6g}" for name in slopes) + f",550,{iop}\n"
    text += "7.4,1.05,nan,9000,15\n"
    (tmp_path / "rows.csv").write_text(text)
    arguments = ["estimate", str(tmp_path / "rows.csv"), "--scene", str(scene_file), "--model-error-um", "0"]
    held = [part for name in ("puff", "puff_width") for part in ("--known", f"{name}=1")]
    out = tmp_path / "out"
    assert (
        main([*arguments, *held, "--known", "radius_mm=7.8", "--free", "iop_mmhg", "--out", str(out), "--quiet"]) == 0
    )
    said = capsys.readouterr().out
    assert "IOP less biop_mmhg over 3 eyes" in said and "clinics live with" in said
    assert "left out" in said and "central_thickness_um = 9000" in said
    report = json.loads((out / "estimate.json").read_text())
    for row, iop in zip(report["rows"], (13.0, 17.0, 22.0)):
        assert row["quantities"]["iop_mmhg"]["value"] == pytest.approx(iop, rel=1e-3)
        # by hand: two or three parameters, each with its slope over its repeatability
        told = sum((slopes[name][1] / REPEATABILITY[name][0]) ** 2 for name in slopes)
        assert row["quantities"]["iop_mmhg"]["standard_deviation"] == pytest.approx(iop / np.sqrt(told), rel=0.05)
    assert abs(report["agreement"]["bias"]) < 0.05 and report["agreement"]["slope"] == pytest.approx(1.0, abs=0.01)
    assert (out / "estimates.csv").read_text().startswith("row,iop_mmhg,iop_mmhg_low95,iop_mmhg_high95")


def test_rows_that_calibrate_one_another_are_solved_by_what_the_others_tell(scene_file, tmp_path, monkeypatch, capsys):
    slopes = {"a1_time_ms": np.array([7.4, 2.0, -3.0]), "deformation_amplitude_mm": np.array([1.05, -0.4, 0.9])}
    slopes["a2_time_ms"] = np.array([21.8, -1.5, 4.0])
    shown = lambda name, iop, puff: (
        slopes[name][0] + slopes[name][1] * np.log(iop / 15.0) + slopes[name][2] * np.log(puff)
    )
    peak = load_scene(scene_file).puff.peak_kpa
    monkeypatch.setattr(
        ParameterRow,
        "predict",
        lambda row, motion: np.array(
            [shown(n, motion.scene.eye.iop_mmhg, motion.scene.puff.peak_kpa / peak) for n in row.names]
        ),
    )
    text = ",".join((*slopes, "CCT", "bIOP")) + "\n"
    for iop in (13.0, 17.0, 22.0):
        text += ",".join(f"{shown(name, iop, 1.03):.6g}" for name in slopes) + f",550,{iop}\n"
    (tmp_path / "rows.csv").write_text(text)
    arguments = ["estimate", str(tmp_path / "rows.csv"), "--scene", str(scene_file), "--model-error-um", "0", "--quiet"]
    arguments += ["--known", "radius_mm=7.8", "--free", "iop_mmhg", "--calibrate-rows"]
    for more in (["--known", "puff=1"], ["--instrument", str(scene_file)]):
        assert main([*arguments, *more]) == 2 and not (tmp_path / "out").exists()
    capsys.readouterr()
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert report["calibration"]["puff"][0] > 1.0
    for row, iop in zip(report["rows"], (13.0, 17.0, 22.0)):
        found = row["quantities"]["iop_mmhg"]
        assert abs(found["value"] - iop) < 3.0 * found["standard_deviation"]
        # all that stands beside the estimate is of the same solution: the profile is lowest at it
        profile = row["profile"]
        lowest = np.interp(0.0, profile["standard_deviations"], profile["iop_mmhg"])
        assert lowest == pytest.approx(found["value"], rel=1e-3)


def test_the_study_in_a_short_form(scene_file, tmp_path, capsys):
    scene = load_scene(scene_file)
    rows, figures = estimates.measure(scene, 3, 7, "alone", lambda text: None)
    assert len(figures) == 1 and [row.holds for row in rows if row.holds is not None] == [True, True]
    assert rows[0].value < 0.2 and 0.2 < rows[1].value < 3.0
    others = estimates.others_of(scene)
    assert "another time course" in others and "no relaxation" not in others
    with pytest.raises(SystemExit):
        main(["estimates", str(scene_file), "--eyes", "0"])
    assert main(["estimates", str(scene_file), "--only", "nothing"]) == 2
    assert "estimates has alone" in capsys.readouterr().err


def test_eyes_of_another_model_are_counted_as_right_wrong_and_refused(monkeypatch):
    use(monkeypatch)
    scene, number = BASE.but({"puff.time_course": "corvis"}), iter(range(9))
    own = own_values(scene)
    exactly = {name: value for name, value in own.items() if name != "iop_mmhg"}

    def made(scene, count, seed, change):
        eyes = []
        for _ in range(count):
            truth = {**own, "iop_mmhg": 15.0 + next(number)}
            eyes.append(estimates.Made(truth, motion(scene_with(scene, truth))))
        return eyes

    def wrong(problems, tell):
        # the first is right, the second is of another eye, the third is refused
        found = [estimate(one.seen, BASE, exactly, model_error_um=0.0) for one in problems[:2]]
        assert found[0].widened == 1.0
        far = replace(found[1].quantities[0], range95=(40.0, 41.0), value=40.5, deviation=0.4)
        return [found[0], replace(found[1], quantities=(far,), widened=2.0), SceneError("no eye")]

    monkeypatch.setattr(estimates, "made", made)
    monkeypatch.setattr(estimates, "estimate_many", wrong)
    covered, told, sure = estimates.measure(scene, 3, 5, "others", lambda text: None)[0]
    assert covered.value == 2 and told.value == 2 and sure.value == 1 and sure.holds is False
    assert "1 hold the truth, 1 by an enlarged model error" in told.note and "refused" in told.note


def test_a_bound_falls_with_the_noise_and_with_what_is_known(scene_file):
    scene = load_scene(scene_file)
    alone = {name: value for name, value in own_values(scene).items() if name != "iop_mmhg"}
    assert of_own_eye(scene, alone, 20.0) == pytest.approx(2.0 * of_own_eye(scene, alone, 10.0), rel=0.1)
    assert of_own_eye(scene, alone) < of_own_eye(scene, {}) < of_own_eye(scene, {}, model_error_um=30.0)


def test_the_best_linear_estimate_is_as_far_off_as_the_noise_along_the_slopes(scene_file):
    scene = load_scene(scene_file)
    truth = {**own_values(scene), "iop_mmhg": 17.0}
    motion, noise = cheap(scene_with(scene, truth)), 0.01 * np.random.default_rng(8).standard_normal(len(TIMES_MS))
    seen = of_history("eye", TIMES_MS, np.interp(TIMES_MS, motion.time_ms, motion.apex_mm) + noise, False, 0.01)
    problem = problem_of(seen, scene, {n: v for n, v in truth.items() if n != "iop_mmhg"}, model_error_um=0.0)
    ends = [
        np.interp(TIMES_MS, one.time_ms, one.apex_mm)
        for one in (cheap(scene_with(scene, {**truth, "iop_mmhg": 17.0 * np.exp(step)})) for step in (0.003, -0.003))
    ]
    slope = (ends[0] - ends[1]) / 0.006
    best = best_at_truth(problem, truth, motion)
    assert np.log(best / 17.0) == pytest.approx(slope @ noise / (slope @ slope), rel=0.05, abs=1e-5)
    assert at_truth(problem, truth) == pytest.approx(17.0 * 0.01 / np.linalg.norm(slope), rel=0.05)
    # and the estimate is that one, to a tenth of its standard deviation
    found = estimate(seen, scene, {n: v for n, v in truth.items() if n != "iop_mmhg"}, model_error_um=0.0)
    assert abs(found["iop_mmhg"].value - best) < 0.1 * found["iop_mmhg"].deviation


def test_the_package_s_own_name_is_the_function():
    import taichi_eye

    assert taichi_eye.estimate is estimate and isinstance(Estimate.__doc__, str)
    assert Path(taichi_eye.__file__).parent.joinpath("estimation").is_dir()
