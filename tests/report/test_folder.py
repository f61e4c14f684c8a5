"""Run folders and whole files."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_eye.errors import SceneError
from taichi_eye.report import folder as folder_module
from taichi_eye.report.folder import (
    MANIFEST,
    PART,
    WORK,
    claim_folder,
    create_run_folder,
    refuse_taken,
    replacing,
    sweep,
    write_text,
)


def environment():
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")]))
    return os.environ | {"PYTHONPATH": path}


def test_default_folders_count_up(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert [create_run_folder(None, "seed").as_posix() for _ in range(2)] == ["renders/seed-001", "renders/seed-002"]
    (tmp_path / "renders" / "seed-041").mkdir()
    (tmp_path / "renders" / "seed-2-900").mkdir()
    (tmp_path / "renders" / "quick-7x").write_text("")
    assert create_run_folder(None, "seed").name == "seed-042"
    assert create_run_folder(None, "quick").name == "quick-001"
    assert create_run_folder(None, "a.b").name == "a.b-001"


def test_out_may_be_new_or_empty(tmp_path):
    new, empty = tmp_path / "a" / "b", tmp_path / "empty"
    empty.mkdir()
    assert create_run_folder(new, "seed") == new and new.is_dir()
    assert create_run_folder(str(empty), "seed") == empty


def test_an_empty_folder_that_one_process_took_is_refused_to_another(tmp_path):
    """Of many that are given one --out at the same instant, one gets it."""
    claim = (
        "import sys, time\nfrom pathlib import Path\n"
        "from taichi_eye.errors import SceneError\nfrom taichi_eye.report.folder import create_run_folder\n"
        "start, out = Path(sys.argv[1]), Path(sys.argv[2])\n"
        "print('ready', flush=True)\n"
        "while not start.exists(): pass\n"
        "try:\n    create_run_folder(out, 'x')\nexcept SceneError as error:\n    print(error)\n"
        "else:\n    print('mine', flush=True); time.sleep(0.5)\n"
    )
    start, out = tmp_path / "start", tmp_path / "out"
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", claim, start, out], stdout=subprocess.PIPE, text=True, env=environment()
        )
        for _ in range(4)
    ]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    start.touch()
    said = sorted(process.communicate(timeout=60)[0].strip() for process in processes)
    assert said.count("mine") == 1 and sum("in use by another run" in text for text in said) == 3, said
    create_run_folder(out, "x")  # the lock went with its process


def test_the_lock_of_a_folder_ends_once_it_holds_something(tmp_path):
    for k in range(3):
        folder = create_run_folder(tmp_path / str(k), "x")
        (folder / "page.html").touch()
    assert [held for held, _ in folder_module._held if held.parent == tmp_path] == [tmp_path / "2"]


def test_what_a_run_left_before_it_could_be_resumed_is_nothing(tmp_path):
    (tmp_path / WORK).mkdir()
    (tmp_path / WORK / ".part-7-run.json").touch()
    refuse_taken(tmp_path)
    claim_folder(tmp_path, "x")[1].release()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / WORK).mkdir()
    (tmp_path / WORK / MANIFEST).touch()
    with pytest.raises(SceneError, match="is not empty"):
        refuse_taken(tmp_path)


def test_sweeping_takes_what_was_left_unfinished(tmp_path):
    (tmp_path / "frames").mkdir()
    with replacing(tmp_path / "frames" / "a.png") as temporary:
        assert temporary.name.startswith(PART)
        temporary.touch()
    (tmp_path / "frames" / f"{PART}1-b.png").touch()
    (tmp_path / f"{PART}1-c.csv").touch()
    sweep(tmp_path)
    assert [path.name for path in tmp_path.rglob("*")] == ["frames", "a.png"]


def test_an_error_without_a_name_gets_that_of_the_file(tmp_path):
    with pytest.raises(OSError) as caught:
        with replacing(tmp_path / "big.csv"):
            raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == str(tmp_path / "big.csv")


def test_out_is_never_overwritten(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"mine")
    with pytest.raises(SceneError, match="is not empty"):
        create_run_folder(tmp_path, "seed")
    for out in (tmp_path / "film.mp4", tmp_path / "film.mp4" / "x", tmp_path / ("x" * 3000), "a\0b"):
        with pytest.raises(SceneError, match="--out .* cannot be made"):
            create_run_folder(out, "seed")
    assert (tmp_path / "film.mp4").read_bytes() == b"mine" and len(list(tmp_path.iterdir())) == 1


def test_a_file_is_whole_or_absent(tmp_path):
    path = tmp_path / "summary.json"
    with pytest.raises(KeyboardInterrupt):
        with replacing(path) as temporary:
            temporary.write_text("{")
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    write_text(path, "{}\n\N{GREEK SMALL LETTER MU}\n")
    with pytest.raises(RuntimeError):
        with replacing(path) as temporary:
            assert (temporary.parent, temporary.suffix) == (tmp_path, ".json")
            raise RuntimeError
    assert path.read_bytes() == "{}\n\N{GREEK SMALL LETTER MU}\n".encode()
    assert list(tmp_path.iterdir()) == [path]
