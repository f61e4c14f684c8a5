"""A Dask cluster of a real scheduler and real workers, processes of their own on this machine."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas
import pytest
from processes import environment

from taichi_eye.errors import SceneError
from taichi_eye.studies import cluster, page
from taichi_eye.studies import sweep as module
from taichi_eye.studies.designs import draw
from taichi_eye.studies.study import load_study
from taichi_eye.studies.sweep import sweep

HERE = Path(__file__).parent
STUDY = {
    "design": {"kind": "random", "eyes": 60, "seed": 2},
    "set": {"numerics": {"fidelity": "cavity"}},
    "vary": {"eye.iop_mmhg": {"mean": 15, "sd": 3}},
}


def dask(*words, paths=()):
    """A process of Dask's in which the packages of `paths` come first."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        env=environment(PYTHONPATH=":".join(map(str, [*paths, HERE, HERE.parents[1]]))),
        cwd=HERE,  # where a module is looked for first
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The address of a scheduler."""
    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    process = dask(*f"scheduler --host 127.0.0.1 --port 0 --no-dashboard --scheduler-file {file}".split())
    patience = time.monotonic() + 120
    while not file.exists() or not file.read_text():
        assert time.monotonic() < patience and process.poll() is None
        time.sleep(0.05)
    yield json.loads(file.read_text())["address"]
    process.kill()
    process.wait()


@contextmanager
def workers(scheduler, count, paths=()):
    """Workers of one thread each."""
    made = [
        dask(*f"worker {scheduler} --nthreads 1 --no-nanny --no-dashboard --memory-limit 0".split(), paths=paths)
        for _ in range(count)
    ]
    try:
        yield made
    finally:
        for process in made:
            process.kill()
            process.wait()


def package(folder, text):
    """A package of our name that is not ours."""
    (folder / "taichi_eye" / "studies").mkdir(parents=True)
    (folder / "taichi_eye" / "__init__.py").write_text(text)
    (folder / "taichi_eye" / "studies" / "__init__.py").touch()
    (folder / "taichi_eye" / "studies" / "cluster.py").write_text(
        "def program_here():\n    return 'taichi_eye 0.0.1'\n"
    )
    return folder


def test_a_worker_that_dies_loses_nothing_and_doubles_nothing(scheduler, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "draw", lambda *_: {})
    put, kept = module.Shelf.put, []
    with workers(scheduler, 2) as (first, second):

        def kill_half_way(self, parcel, rows):
            kept.append(parcel)
            if len(kept) == 30:
                first.kill()
            put(self, parcel, rows)

        monkeypatch.setattr(module.Shelf, "put", kill_half_way)
        there = sweep(STUDY, tmp_path / "there", scheduler=scheduler, compute="stubs:slow").folder
        assert first.wait(10) != 0 and second.poll() is None
    assert sorted(kept) == list(range(60))
    table = pandas.read_parquet(there / "table.parquet")
    assert list(table["eye"]) == list(range(60)) and set(table["status"]) == {"complete"}
    asked = draw(load_study(STUDY))["eye.iop_mmhg"]
    np.testing.assert_array_equal(table["eye.iop_mmhg"], asked)
    np.testing.assert_array_equal(table["a1_time_ms"], 5.0 + 0.15 * asked)


def test_what_is_no_cluster_for_this_is_refused_with_nothing_written(scheduler, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE_S", 2.0)
    out = tmp_path / "out"

    def refused(address=scheduler):
        with pytest.raises(SceneError) as error:
            sweep(STUDY, out, scheduler=address)
        assert not out.exists() and str(error.value).startswith(f"--scheduler {address}: ")
        return str(error.value)

    assert "no Dask scheduler answers" in refused("tcp://127.0.0.1:9")
    assert "no Dask scheduler answers" in refused("nonsense")
    assert "has no workers" in refused()
    monkeypatch.setattr(cluster, "PATIENCE_S", 60.0)
    none = package(tmp_path / "none", "raise ModuleNotFoundError('No module named taichi_eye')\n")
    with workers(scheduler, 1, [none]):
        assert "cannot load this package" in refused()
    with workers(scheduler, 1, [package(tmp_path / "old", "")]):
        said = refused()
        assert "has taichi_eye 0.0.1" in said and "install the same" in said
