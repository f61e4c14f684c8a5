"""Run folders and whole files."""

import pytest

from taichi_eye.errors import SceneError
from taichi_eye.report.folder import create_run_folder, replacing, write_text


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
    new = tmp_path / "a" / "b"
    assert create_run_folder(new, "seed") == new and new.is_dir()
    assert create_run_folder(str(new), "seed") == new


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
