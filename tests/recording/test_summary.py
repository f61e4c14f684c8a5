"""What a summary says beside the traces: motion as the instrument counts it, and what computed it."""

import json
import platform
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from PIL import Image

import taichi_eye
from taichi_eye import backend, cli
from taichi_eye.eye.retreat import COURSE, COURSE_MS
from taichi_eye.provenance import command
from taichi_eye.report.page import write_page

QUICK = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.4", "camera.frame_count=2", "camera.view=scheimpflug"]
WORDS = [word for setting in [*QUICK, "eye.whole_eye_movement_mm=0.3"] for word in ("--set", setting)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("summary") / "run"
    assert cli.main(["run", *WORDS, "--out", str(out), "--quiet"]) == 0
    return out


def test_deformation_is_deflection_with_whole_eye_movement(folder):
    summary = json.loads((folder / "summary.json").read_text())
    traces = np.genfromtxt(folder / "traces.csv", delimiter=",", names=True)
    # the course between its knots differs a little from straight lines
    retreat = 0.3 * np.interp(traces["time_ms"], COURSE_MS, COURSE)
    peak = (traces["apex_displacement_mm"] + retreat).max()
    whole, apex = summary["apex_deformation_mm"], summary["apex_displacement_mm"]
    assert whole["peak"] == pytest.approx(peak, abs=0.01) and whole["peak"] > apex["peak"] + 0.1
    assert whole["peak_time_ms"] > apex["peak_time_ms"] + 0.5


def test_the_line_of_a_run_says_both_motions(tmp_path, capsys):
    short = ["--set", "numerics.duration_ms=6", "--quiet"]
    assert cli.main(["run", *WORDS, *short, "--out", str(tmp_path / "a")]) == 0
    assert cli.main(["run", *WORDS[:-2], *short, "--out", str(tmp_path / "b")]) == 0
    retreating, staying = capsys.readouterr().out.splitlines()
    assert "apex deflection" in retreating and "deformation" in retreating
    assert "apex deflection" in staying and "deformation" not in staying


def test_provenance_says_what_computed_where_when_and_how(folder):
    told = json.loads((folder / "summary.json").read_text())["provenance"]
    assert told["taichi_eye"] == taichi_eye.__version__ and told["python"] == platform.python_version()
    assert (told["arch"], told["precision"], told["threads"]) == ("cpu", "f64", backend.threads())
    assert told["language"].split()[0] in ("taichi", "quadrants")
    age = datetime.now(timezone.utc) - datetime.fromisoformat(told["date"])
    assert timedelta(seconds=-1) <= age < timedelta(hours=1)
    assert (
        told["command"].startswith("taichi-eye run --set numerics.fidelity=cavity") and str(folder) in told["command"]
    )


def test_a_script_has_no_command(tmp_path):
    scene = taichi_eye.load_scene(None, [*QUICK, "numerics.duration_ms=0.5"])
    assert taichi_eye.run(scene, tmp_path / "run").summary["provenance"]["command"] is None


def test_pictures_and_the_scene_say_the_version(folder):
    for name in ("apex.png", "sheet.png"):
        with Image.open(folder / name) as image:
            assert image.text["Software"].startswith(f"taichi-eye {taichi_eye.__version__} (")
    assert f"taichi_eye {taichi_eye.__version__}," in (folder / "scene.toml").read_text().splitlines()[0]


def test_pages_say_what_wrote_them(tmp_path):
    with command(["check", "verify", "--only", "a<b"]):
        write_page(tmp_path / "page.html", "A page", ["<p>text</p>"])
    write_page(tmp_path / "script.html", "A page", [])
    told = (tmp_path / "page.html").read_text()
    assert f"taichi-eye {taichi_eye.__version__} (" in told and platform.python_version() in told
    assert "by taichi-eye check verify --only 'a&lt;b'</footer>" in told
    assert "by taichi-eye" not in (tmp_path / "script.html").read_text()
