"""Standard streams that are full, closed, or of a poor encoding: the work is done, and told as far as it can be."""

import os

import pytest
from processes import python

from taichi_eye import cli, console

FULL = "/dev/full"
FRAME = (
    "numerics.fidelity=cavity",
    "numerics.duration_ms=0.3",
    "camera.view=scheimpflug",
    "camera.frame_count=1",
    "camera.optics=plain",
)
FILES = {"film.mp4", "apex.png", "sheet.png", "traces.csv", "wall.npz", "summary.json", "scene.toml", "report.html"}


def run(tmp_path, out, *words, **named):
    """A run of one frame into a folder; the finished process."""
    keys = [word for key in FRAME for word in ("--set", key)]
    return python("-m", "taichi_eye", "run", *keys, "--out", out, *words, cwd=tmp_path, **named)


def whole(folder):
    return {path.name for path in folder.iterdir()} == FILES


@pytest.fixture
def full():
    with open(FULL, "w") as stream:
        yield stream


def test_a_full_disk_behind_stdout_is_said_after_complete_work(tmp_path, full):
    done = run(tmp_path, "one", "--quiet", stdout=full)
    assert done.returncode == 1 and whole(tmp_path / "one")
    assert done.stderr.splitlines() == ["taichi-eye: standard output cannot be written (No space left on device)"]


def test_a_full_disk_behind_stderr_costs_the_bar_and_nothing_else(tmp_path, full):
    done = run(tmp_path, "one", stderr=full)
    assert done.returncode == 0 and whole(tmp_path / "one") and "apex" in done.stdout


@pytest.mark.parametrize("number", [1, 2], ids=["stdout", "stderr"])
def test_a_closed_stream_takes_nothing_and_no_file_takes_its_number(tmp_path, number):
    words = ["-m", "taichi_eye", "run", *(word for key in FRAME for word in ("--set", key)), "--out", "one"]
    start = f"import os, sys; os.close({number}); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    done = python("-c", start, *words, cwd=tmp_path)
    assert done.returncode == 0 and whole(tmp_path / "one")
    assert "Traceback" not in done.stdout + done.stderr
    assert number == 1 or "apex" in done.stdout


def test_names_that_the_encoding_lacks_are_written_as_escapes(tmp_path):
    done = run(tmp_path, "\u00e4\u4e2d", "--quiet", env={"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "1"})
    assert done.returncode == 0 and done.stdout.startswith("\\xe4\\u4e2d: apex") and done.stderr == ""
    assert whole(tmp_path / "\u00e4\u4e2d")


def test_a_name_that_is_no_text_is_written_as_escapes(tmp_path):
    name = os.fsdecode(b"\xff")
    done = run(tmp_path, name, "--quiet", env={"PYTHONIOENCODING": "utf-8"})
    assert done.returncode == 0 and done.stdout.startswith("\\udcff: apex") and whole(tmp_path / name)


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"]], ids=" ".join)
def test_help_into_a_full_disk_says_so(words, full):
    done = python("-m", "taichi_eye", *words, stdout=full)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "No space left" in done.stderr


def test_bad_input_keeps_its_exit_status_where_nothing_can_be_said(full):
    assert python("-m", "taichi_eye", "run", "missing.toml", stderr=full).returncode == 2
    assert python("-m", "taichi_eye", "run", "missing.toml", stdout=full).returncode == 2
    assert python("-m", "taichi_eye", "nonsense", stderr=full).returncode == 2


def test_a_reader_that_has_gone_is_no_failure():
    read, write = os.pipe()
    os.close(read)
    done = python("-m", "taichi_eye", "--help", stdout=write)
    os.close(write)
    assert done.returncode == 0 and done.stderr == ""


def test_the_streams_of_the_caller_are_given_back(capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(["--help"])
    assert stopped.value.code == 0
    print("after")
    assert capsys.readouterr().out.endswith("after\n")


def test_an_error_of_the_command_itself_is_not_hidden(full):
    lines = "from taichi_eye import console\nconsole.steady(lambda: print('word' * 9999) or 1 / 0)()"
    done = python("-c", lines, stdout=full)
    assert done.returncode == 1 and "ZeroDivisionError" in done.stderr and "No space left" in done.stderr
    assert console.steady(lambda: 3)() == 3


def test_a_failed_stream_is_asked_no_more(full):
    lasting = console.Lasting(os.fdopen(os.dup(full.fileno()), "w"))
    assert [lasting.write("a"), lasting.flush(), lasting.write("word"), lasting.flush()] == [1, None, 4, None]
    assert lasting.failure.strerror == "No space left on device" and lasting.encoding
    lasting.stream.close()
