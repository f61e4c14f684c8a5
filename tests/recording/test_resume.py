"""A run that is cut off anywhere and resumed leaves what one leaves that was never cut off.

The environment variable TAICHI_EYE_KILLS sets how many runs are killed (1), TAICHI_EYE_SIGNALS how many are ended by
each signal (1): the long form of this proof takes 200 and 20.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from cut_runs import CASES, Reference, begun, ended, kill_and_resume, resumed

import taichi_eye
from taichi_eye import cli
from taichi_eye.recording.workroom import WorkRoom
from taichi_eye.report.folder import Lock
from taichi_eye.report.traces import read_traces

KILLS = int(os.environ.get("TAICHI_EYE_KILLS", 1))
SIGNALS = int(os.environ.get("TAICHI_EYE_SIGNALS", 1))
ALWAYS = {"film.mp4", "apex.png", "sheet.png", "traces.csv", "wall.npz", "summary.json", "scene.toml", "report.html"}
_references: dict[str, Reference] = {}


@pytest.fixture
def reference(tmp_path_factory):
    def get(case: str) -> Reference:
        if case not in _references:
            _references[case] = Reference(case, tmp_path_factory.mktemp("reference") / case)
        return _references[case]

    return get


def cut(case, folder, number=signal.SIGTERM, after_s=0.2):
    """A folder of a run that a signal ended soon after its first frames."""
    process = begun(case, folder)
    while process.poll() is None and not list((folder / ".run").glob("film-*")):
        time.sleep(0.005)
    time.sleep(after_s)
    process.send_signal(number)
    return ended(process, 128 + number)


@pytest.fixture(scope="module")
def cut_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cut") / "mfpm"
    cut("mfpm", folder)
    assert (folder / ".run" / "checkpoint").exists()
    return folder


@pytest.fixture
def copy(cut_run, tmp_path):
    return shutil.copytree(cut_run, tmp_path / "copy")


@pytest.mark.parametrize("number", range(KILLS))
def test_a_killed_run_goes_on_to_the_same_end(number, reference, tmp_path):
    case = list(CASES)[number % len(CASES)]
    assert kill_and_resume(reference(case), tmp_path / "killed", random.Random(number)) >= 1
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize("number", range(SIGNALS))
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_a_run_in_order(name, number, reference, tmp_path):
    case, folder = ("mfpm", "cavity")[number % 2], tmp_path / "ended"
    said = cut(case, folder, getattr(signal, name), random.Random(number).uniform(0.0, 0.3))
    assert f"--resume {folder}" in said and len(said.strip().splitlines()) == 1
    assert ALWAYS <= {path.name for path in folder.iterdir()}
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "stopped" and (name in summary["reason"] or summary["reason"] == "interrupted")
    so_far, whole = (read_traces(each / "traces.csv") for each in (folder, reference(case).folder))
    count = len(so_far["time_ms"])
    assert 0 < count < len(whole["time_ms"]) and so_far["time_ms"][-1] == summary["simulated_ms"]
    for column, values in so_far.items():
        np.testing.assert_array_equal(values, whole[column][:count])
    with np.load(folder / "wall.npz") as wall, np.load(reference(case).folder / "wall.npz") as all_of_it:
        frames = len(wall["time_ms"])
        for column in wall.files:
            np.testing.assert_array_equal(wall[column], all_of_it[column][:frames])
    ended(resumed(folder))
    reference(case).same(folder)


def test_a_full_disk_is_named_and_the_run_goes_on_once_there_is_room(reference, tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    mount = shutil.which("mount")
    if mount is None or subprocess.run([mount, "-t", "tmpfs", "-o", "size=300k", "tmpfs", small]).returncode:
        pytest.skip("no small file system can be mounted here")
    try:
        said = ended(begun("cavity", small / "run"), 1)
        assert "No space left on device" in said and f"--resume {small / 'run'}" in said
        assert f"{small / 'run'}/" in said.splitlines()[0]
        ended(resumed(small / "run"), 1)
        subprocess.run([mount, "-o", "remount,size=100m", small], check=True)
        ended(resumed(small / "run"))
        reference("cavity").same(small / "run")
    finally:
        subprocess.run(["umount", small], check=True)


def test_what_is_damaged_or_of_another_scene_or_program_is_refused(copy, monkeypatch, capsys):
    def refused(part):
        before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
        assert cli.main(["run", "--resume", str(copy), "--quiet"]) == 2
        said = capsys.readouterr().err
        assert part in said and str(copy) in said and len(said.splitlines()) == 1
        assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before

    checkpoint = copy / ".run" / "checkpoint"
    header, _ = WorkRoom(copy).load(taichi_eye.load_scene(copy / "scene.toml"))
    whole = checkpoint.read_bytes()
    draw = random.Random(3)
    for _ in range(20):
        damaged = bytearray(whole)
        damaged[draw.randrange(len(damaged))] ^= 1 << draw.randrange(8)
        checkpoint.write_bytes(damaged)
        refused("checkpoint")
    checkpoint.write_bytes(whole[: len(whole) // 2])
    refused("is damaged")
    checkpoint.write_bytes(b"")
    refused("no checkpoint of this version")
    checkpoint.write_bytes(whole)
    for part in header["held"]["Wall"]["files"] | header["held"]["Film"]["files"]:
        path = copy / ".run" / part
        kept = bytearray(path.read_bytes())
        path.write_bytes(kept[: len(kept) // 2])
        refused(f"{part}: is damaged")
        path.unlink()
        refused(f"{part}: is damaged")
        path.write_bytes(kept)
    scene = copy / "scene.toml"
    text = scene.read_text()
    scene.write_text(text.replace("iop_mmhg = 15.0", "iop_mmhg = 16.0"))
    refused("was edited")
    scene.write_text(text)
    with monkeypatch.context() as patch:
        patch.setattr("taichi_eye.recording.workroom.program", lambda: "taichi_eye 99")
        refused("taichi_eye 99")
    manifest = copy / ".run" / "run.json"
    begun_as = manifest.read_text()
    for damaged in (begun_as.replace('"f64"', '"f32"'), "{", ""):
        manifest.write_text(damaged)
        refused("is damaged")
    manifest.write_text(begun_as)
    with monkeypatch.context() as patch:
        patch.setattr("taichi_eye.backend.settings", lambda: {"arch": "cpu", "precision": "f32"})
        refused("was begun on cpu in f64")


def test_resuming_takes_no_other_scene(copy, capsys):
    for words in (["scene.toml"], ["--set", "eye.iop_mmhg=20"], ["--out", "x"], ["--compare", "x"], ["--arch", "cpu"]):
        assert cli.main(["run", "--resume", str(copy), *words]) == 2
        assert "leave out" in capsys.readouterr().err


def test_two_processes_do_not_resume_one_run(copy):
    holder = Lock(copy)
    assert "in use by another run" in ended(resumed(copy), 2)
    holder.release()
    ended(resumed(copy))


def test_a_finished_run_says_so_and_what_is_no_run_is_refused(reference, tmp_path, capsys):
    finished = reference("mfpm").folder
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    assert cli.main(["run", "--resume", str(finished)]) == 0
    assert "finished" in capsys.readouterr().out
    result = taichi_eye.resume(finished)
    assert result.summary["status"] == "complete"
    np.testing.assert_array_equal(result.traces["time_ms"], read_traces(finished / "traces.csv")["time_ms"])
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(taichi_eye.SceneError, match=str(folder)):
            taichi_eye.resume(folder)
