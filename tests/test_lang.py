"""The kernel language: which one is taken, and where its compiled kernels are kept on odd machines."""

import os
import stat
import time
from pathlib import Path

import pytest
from processes import python

from taichi_eye import caches, lang
from taichi_eye.lang import CACHE_VARIABLE, NAME, NAMES

USUAL = Path(NAME) / {"taichi": "ticache", "quadrants": "qdcache"}[NAME]
SCRIPT = """
from taichi_eye import backend, lang
from taichi_eye.lang import ti

@ti.kernel
def twice(x: int) -> int:
    return 2 * x

backend.init()
print(twice(21), lang.CACHE)
"""


@pytest.fixture
def script(tmp_path):
    """A script that runs a kernel and prints its answer and where the language keeps kernels."""
    path = tmp_path / "twice.py"
    path.write_text(SCRIPT)
    return path


def kept(folder):
    """Whether compiled kernels lie in a folder."""
    return folder.is_dir() and any(path.is_file() for path in folder.rglob("*"))


def test_a_name_that_is_not_installed_is_refused_with_the_names_there_are():
    done = python("-c", "import taichi_eye.lang", env={"TAICHI_EYE_LANG": "fortran"})
    assert done.returncode == 1
    assert 'TAICHI_EYE_LANG = "fortran"' in done.stderr and all(name in done.stderr for name in NAMES)


def test_help_needs_no_home():
    done = python("-m", "taichi_eye", "--help", env={"HOME": None, "XDG_CACHE_HOME": None})
    assert done.returncode == 0 and "analyze" in done.stdout and done.stderr == ""


def test_kernels_are_kept_under_home_and_nothing_is_said(script, tmp_path):
    done = python(script, env={"HOME": str(tmp_path), "XDG_CACHE_HOME": None, CACHE_VARIABLE: None})
    assert done.stdout.split() == ["42", str(tmp_path / ".cache" / USUAL)] and done.stderr == ""
    assert done.returncode == 0 and kept(tmp_path / ".cache" / USUAL)


@pytest.mark.parametrize("named", ["", "here"], ids=["empty", "relative"])
def test_a_cache_folder_that_is_no_absolute_path_counts_as_not_named(script, tmp_path, named):
    done = python(script, cwd=tmp_path, env={"HOME": str(tmp_path), "XDG_CACHE_HOME": named, CACHE_VARIABLE: None})
    assert done.returncode == 0 and kept(tmp_path / ".cache" / USUAL) and not (tmp_path / "here").exists()


@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME", CACHE_VARIABLE])
def test_where_nothing_can_be_written_kernels_go_to_a_folder_of_ones_own_and_one_line_says_so(
    script, tmp_path, variable
):
    blocked = tmp_path / "blocked"
    blocked.write_text("a file, so that no folder can be made under it")
    env = {"HOME": str(tmp_path), "XDG_CACHE_HOME": None, CACHE_VARIABLE: None, "TMPDIR": str(tmp_path)}
    for _ in range(2):  # the second time it is there
        done = python(script, env=env | {variable: str(blocked / "below")})
        own = tmp_path / f"taichi_eye-{os.getuid()}"
        assert done.returncode == 0 and done.stdout.split() == ["42", str(own / USUAL)]
        said = done.stderr.splitlines()
        assert len(said) == 1 and str(blocked) in said[0] and str(own) in said[0]
        assert kept(own / USUAL) and stat.S_IMODE(own.stat().st_mode) == 0o700
    assert blocked.is_file()


def test_a_folder_among_the_temporary_ones_that_others_can_write_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(caches.tempfile, "tempdir", str(tmp_path))
    open_to_all = tmp_path / f"taichi_eye-{os.getuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    other = caches.temporary()
    assert other != open_to_all and other.parent == tmp_path and stat.S_IMODE(other.stat().st_mode) == 0o700
    open_to_all.rmdir()
    open_to_all.symlink_to(tmp_path)
    assert caches.temporary() not in (open_to_all, tmp_path)


def test_without_any_folder_a_start_is_refused_in_one_line(script, tmp_path):
    blocked = tmp_path / "blocked"
    blocked.write_text("")
    script.write_text(
        "import tempfile\nfrom taichi_eye import caches\n"
        "tempfile.gettempdir = lambda: '/dev/null'\ncaches.SHARED_MEMORY = '/dev/null'\n"
        "from taichi_eye.cli import main\nraise SystemExit(main(['verify', '--only', 'inflation']))\n"
    )
    done = python(script, cwd=tmp_path, env={"HOME": str(blocked), "XDG_CACHE_HOME": None, CACHE_VARIABLE: None})
    assert done.returncode == 2 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and "XDG_CACHE_HOME" in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"blocked", "twice.py"}


def test_a_lock_that_a_killed_process_left_goes_and_one_in_use_stays(tmp_path):
    left, used = tmp_path / "ticache.lock", tmp_path / "other.lock"
    left.touch()
    used.touch()
    long_ago = time.time() - 2.0 * lang.STALE_LOCK_S
    os.utime(left, (long_ago, long_ago))
    lang.drop_stale_locks(tmp_path)
    assert not left.exists() and used.exists()
    lang.drop_stale_locks(tmp_path / "none")
