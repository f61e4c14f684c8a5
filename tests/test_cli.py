"""The command line as a user types it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import imageio_ffmpeg
import meshio
import numpy as np
import pytest
from PIL import Image

from taichi_eye import cli, load_scene
from taichi_eye.errors import Interrupted
from taichi_eye.report.traces import COLUMNS, read_traces

ROOT = Path(__file__).parents[1]
TINY = """
[numerics]
spacing_mm = 0.3
sound_speed_m_s = 20
duration_ms = 2.5

[camera]
view = "scheimpflug"
"""
MEASURED = "time_ms,deflection_mm\n" + "".join(f"{t},{0.002 * t * t}\n" for t in range(1, 6))
ALWAYS = {"film.mp4", "apex.png", "sheet.png", "traces.csv", "wall.npz", "summary.json", "scene.toml", "report.html"}
FRAMES = 11  # at 0, 0.2315, ... 2.315 ms


def typed(*words, cwd, status=0):
    """Run `python -m taichi_eye run ...` in a folder; its output, once the exit status is the expected one."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-m", "taichi_eye", "run", *map(str, words)],
        cwd=cwd,
        text=True,
        capture_output=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done


def names(folder):
    return {path.name for path in folder.iterdir()}


def film_frames(path):
    return imageio_ffmpeg.count_frames_and_secs(str(path))[0]


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with a scene and a measured history, in which the commands are typed."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "tiny.toml").write_text(TINY)
    (folder / "measured.csv").write_text(MEASURED)
    return folder


@pytest.fixture(scope="module")
def first(desk):
    """The folder of a run with everything on."""
    typed(
        "tiny.toml",
        "--out",
        "first",
        "--threads",
        "1",
        "--compare",
        "measured.csv",
        "--set",
        "output.png_frames=true",
        "--set",
        "output.node_fields=true",
        cwd=desk,
    )
    return desk / "first"


def test_a_run_leaves_its_files_and_no_others(first):
    assert names(first) == ALWAYS | {"frames", "fields"}
    for name in ("apex.png", "sheet.png"):
        with Image.open(first / name) as image:
            image.load()
            assert min(image.size) > 100


def test_film_and_png_frames_hold_every_frame_time(first):
    assert film_frames(first / "film.mp4") == FRAMES
    frames = sorted(names(first / "frames"))
    assert len(frames) == FRAMES
    assert frames[0] == "frame_000_00.00ms.png" and frames[-1] == "frame_010_02.31ms.png"
    with Image.open(first / "frames" / frames[5]) as image:
        assert image.size == (576, 200) and image.mode == "L"
        assert np.asarray(image).std() > 5.0


def test_traces_have_their_columns_and_run_to_the_end(first):
    traces = read_traces(first / "traces.csv")
    assert tuple(traces) == COLUMNS
    for values in traces.values():
        assert np.isfinite(values).all() and len(values) == len(traces["time_ms"])
    assert traces["time_ms"][0] == 0.0 and 2.47 < traces["time_ms"][-1] <= 2.5
    assert traces["apex_displacement_mm"][0] == 0.0 and traces["apex_displacement_mm"][-1] > 0.005
    # every frame time is a row
    for frame in range(FRAMES):
        assert np.abs(traces["time_ms"] - 0.2315 * frame).min() < 1e-9


def test_summary_says_what_the_traces_say(first):
    summary, traces = json.loads((first / "summary.json").read_text()), read_traces(first / "traces.csv")
    assert summary["status"] == "complete" and summary["reason"] is None
    assert summary["simulated_ms"] == traces["time_ms"][-1]
    assert summary["apex_displacement_mm"]["peak"] == pytest.approx(traces["apex_displacement_mm"].max(), rel=1e-6)
    assert summary["chamber_volume_error_max"] == pytest.approx(np.abs(traces["chamber_volume_error"]).max())
    assert summary["coupling_iterations"]["most"] == traces["coupling_iterations"].max()
    assert 0.6 < summary["cloud"]["smallest_gap"] < 1.0 and summary["cloud"]["largest_hole"] < 0.8
    assert summary["cloud"]["worst_stencil_condition"] > 1.0
    assert summary["against"]["file"] == "measured.csv" and summary["against"]["rms_difference_mm"] > 0.0


def test_paraview_opens_every_frame_at_its_time(first):
    collection = ElementTree.parse(first / "fields" / "fields.pvd").getroot()
    entries = [(float(each.get("timestep")), each.get("file")) for each in collection.iter("DataSet")]
    assert len(entries) == 2 * FRAMES
    np.testing.assert_allclose(sorted({time for time, _ in entries}), 0.2315 * np.arange(FRAMES), atol=1e-9)
    assert names(first / "fields") == {file for _, file in entries} | {"fields.pvd"}
    summary = json.loads((first / "summary.json").read_text())["cloud"]
    for _, file in entries[-2:]:
        mesh = meshio.read(first / "fields" / file)
        fluid = file.startswith("fluid")
        assert len(mesh.points) == summary["nodes" if fluid else "wall_nodes"]
        assert [block.type for block in mesh.cells] == ["triangle" if fluid else "line"]
        assert {"velocity_m_s"} <= set(mesh.point_data)
        for values in mesh.point_data.values():
            assert np.isfinite(values).all() and np.abs(values).max() > 0.0


def test_written_scene_runs_again_to_the_same_bits(first, desk):
    typed("first/scene.toml", "--out", "again", "--threads", "1", cwd=desk)
    assert (desk / "again" / "traces.csv").read_bytes() == (first / "traces.csv").read_bytes()
    assert (desk / "again" / "scene.toml").read_bytes() == (first / "scene.toml").read_bytes()
    for frame in sorted(names(first / "frames")):
        assert (desk / "again" / "frames" / frame).read_bytes() == (first / "frames" / frame).read_bytes()
    assert load_scene(first / "scene.toml") == load_scene(
        desk / "tiny.toml", ["output.png_frames=true", "output.node_fields=true"]
    )


def test_the_same_command_twice_gives_the_same_bits_in_numbered_folders(desk):
    for number in (1, 2):
        said = typed(
            "tiny.toml",
            "--set",
            "camera.view=particles",
            "--set",
            "eye.iop_mmhg=20",
            "--threads",
            "2",
            "--quiet",
            cwd=desk,
        )
        assert f"renders/tiny-{number:03d}" in said.stdout and "apex" in said.stdout
        assert said.stderr.strip() == ""
    one, two = desk / "renders" / "tiny-001", desk / "renders" / "tiny-002"
    assert names(one) == names(two) == ALWAYS
    assert (one / "traces.csv").read_bytes() == (two / "traces.csv").read_bytes()
    assert load_scene(one / "scene.toml").eye.iop_mmhg == 20.0
    traces = read_traces(one / "traces.csv")
    assert traces["fluid_pressure_apex_kpa"][0] == pytest.approx(20 * 0.133322387415, rel=1e-9)


def test_single_precision_runs_to_nearly_the_same_history(first, desk):
    typed("tiny.toml", "--out", "single", "--precision", "f32", "--set", "camera.frame_count=2", cwd=desk)
    double, single = (read_traces(folder / "traces.csv") for folder in (first, desk / "single"))
    off = np.abs(single["apex_displacement_mm"] - double["apex_displacement_mm"]).max()
    assert 0.0 < off < 0.02 * double["apex_displacement_mm"].max()


def test_a_run_that_a_guard_stops_leaves_readable_files_and_status_1(desk):
    said = typed(
        "--set",
        "numerics.spacing_mm=0.3",
        "--set",
        "numerics.sound_speed_m_s=20",
        "--set",
        "numerics.dissipation=0",
        "--set",
        "camera.view=scheimpflug",
        "--set",
        "numerics.duration_ms=6",
        cwd=desk,
        status=1,
    )
    message = said.stderr.strip().splitlines()
    assert any("stopped at" in line and "numerics.dissipation" in line for line in message)
    assert "Traceback" not in said.stderr
    folder = desk / "renders" / "eye-001"
    assert names(folder) == ALWAYS
    summary, traces = json.loads((folder / "summary.json").read_text()), read_traces(folder / "traces.csv")
    assert summary["status"] == "stopped" and "stopped at" in summary["reason"]
    assert 0.0 < traces["time_ms"][-1] == summary["simulated_ms"] < 6.0
    assert film_frames(folder / "film.mp4") == int(traces["time_ms"][-1] / 0.2315 + 1e-6) + 1
    for name in ("apex.png", "sheet.png"):
        with Image.open(folder / name) as image:
            image.load()
    assert load_scene(folder / "scene.toml").numerics.dissipation == 0.0


def test_a_folder_that_is_not_empty_is_refused_and_left_alone(desk):
    taken = desk / "taken"
    taken.mkdir()
    (taken / "precious.txt").write_text("mine")
    said = typed("tiny.toml", "--out", "taken", cwd=desk, status=2)
    assert "--out taken" in said.stderr and "not empty" in said.stderr and len(said.stderr.splitlines()) == 1
    assert names(taken) == {"precious.txt"} and (taken / "precious.txt").read_text() == "mine"


BAD = {
    "limbus beyond the cornea": (
        ["--set", "cornea.limbus_radius_mm=8"],
        ["cornea.limbus_radius_mm = 8.0", "cornea.radius_mm"],
    ),
    "negative thickness": (["--set", "cornea.thickness_mm=-0.5"], ["cornea.thickness_mm = -0.5", ">= 0.01"]),
    "unknown key": (["--set", "cornea.tickness_mm=0.5"], ["cornea.tickness_mm", "unknown key", "thickness_mm"]),
    "unknown section": (["--set", "kornea.radius_mm=7"], ["kornea", "unknown section", "cornea"]),
    "a string for a number": (["--set", "eye.iop_mmhg=high"], ['eye.iop_mmhg = "high"', "must be a number"]),
    "not among the choices": (["--set", "numerics.basis=linear"], ["numerics.basis", '"quadratic"', '"cubic"']),
    "no value": (["--set", "eye.iop_mmhg"], ["--set eye.iop_mmhg", "section.key=value"]),
    "a spacing that fits nowhere": (["--set", "numerics.spacing_mm=0.9"], ["numerics.spacing_mm = 0.9"]),
    "missing scene": (["nowhere.toml"], ["nowhere.toml"]),
    "malformed scene": (["broken.toml"], ["broken.toml", "malformed TOML", "line 2"]),
    "missing measured history": (["--compare", "nowhere.csv"], ["nowhere.csv"]),
    "malformed measured history": (["--compare", "broken.csv"], ["broken.csv", "time_ms"]),
    "missing puff file": (["--set", "puff.time_course=file", "--set", "puff.file=nowhere.csv"], ["nowhere.csv"]),
    "double precision on vulkan": (["--arch", "vulkan"], ["vulkan", "f32"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_message_before_anything_is_written(case, tmp_path, monkeypatch, capsys):
    words, parts = BAD[case]
    (tmp_path / "broken.toml").write_text("[eye]\niop_mmhg = = 3\n")
    (tmp_path / "broken.csv").write_text("zeit,weg\n1,2\n")
    before = names(tmp_path)
    monkeypatch.chdir(tmp_path)
    for out in ([], ["--out", "result"]):
        assert cli.main(["run", *words, *out]) == 2
        said = capsys.readouterr()
        assert said.out == "" and said.err.startswith("taichi-eye: ")
        for part in parts:
            assert part in said.err
        assert len(said.err.strip().splitlines()) == 1
        assert names(tmp_path) == before


def test_bad_input_reaches_the_shell_as_status_2(desk):
    before = names(desk)
    said = typed("--set", "cornea.thickness_mm=-0.5", cwd=desk, status=2)
    assert said.stdout == "" and "cornea.thickness_mm" in said.stderr and "Traceback" not in said.stderr
    assert names(desk) == before


@pytest.mark.parametrize(
    "words",
    [
        ["--threads", "none"],
        ["--threads", "0"],
        ["--arch", "abacus"],
        ["--precision", "f16"],
        ["--no-such-flag"],
        ["one.toml", "two.toml"],
    ],
)
def test_misspelt_flags_are_refused_by_name(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        cli.main(["run", *words])
    assert caught.value.code == 2
    assert words[-1] in capsys.readouterr().err
    assert not names(tmp_path)


def test_help_names_every_flag(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["run", "--help"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    for flag in ("--set", "--out", "--resume", "--compare", "--arch", "--precision", "--threads", "--quiet"):
        assert flag in said


def test_an_interrupted_check_says_no_folder_that_is_gone(monkeypatch, capsys):
    def cut_off(*_, **__):
        reason = Interrupted(signal.SIGINT)
        reason.folder = "/gone"
        raise reason

    monkeypatch.setattr("taichi_eye.proof.scenes.report", cut_off)
    assert cli.main(["check", "scenes", "--only", "calls", "--quiet"]) == 130
    assert capsys.readouterr().err.strip() == "taichi-eye: interrupted"


def test_an_error_bar_needs_a_history(tmp_path, capsys):
    words = ["--set", "numerics.error_bar=true", "--set", "numerics.duration_ms=0.01", "--out", str(tmp_path / "out")]
    assert cli.main(["run", "quick", "--quiet", *words]) == 2
    assert "numerics.duration_ms = 0.01" in capsys.readouterr().err and not (tmp_path / "out").exists()
