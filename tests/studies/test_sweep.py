"""Studies from file to folder: rows that are those of each eye alone, and studies that are cut off."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas
import pyarrow.parquet as pq
import pytest
from processes import environment

import taichi_eye
from taichi_eye import cli
from taichi_eye.analysis import Response
from taichi_eye.analysis.simulated import Reading, response_of
from taichi_eye.errors import Interrupted, OutputError, SceneError
from taichi_eye.report.folder import Lock
from taichi_eye.studies import eyes, page
from taichi_eye.studies import sweep as module
from taichi_eye.studies.columns import FIGURES
from taichi_eye.studies.study import plain_scene
from taichi_eye.studies.sweep import resume, sweep

HERE = Path(__file__).parent
IOP, THICK = "eye.iop_mmhg", "cornea.thickness_mm"
PLOTS = {"responses.png", "scatter.png", "matters.png"}
ALWAYS = PLOTS | {
    *("table.parquet", "table.csv", "columns.csv", "matters.csv", "summary.json", "scene.toml", "study.toml"),
    "study.html",
}
TIMES = np.linspace(0.0, 20.0, 201)
TRACES = {
    "time_ms": TIMES,
    "apex_displacement_mm": np.exp(-(((TIMES - 9.0) / 4.0) ** 2)),
    "puff_apex_kpa": 10.0 * np.exp(-(((TIMES - 10.0) / 4.0) ** 2)),
    "puff_work_uj": TIMES,
    "fluid_pressure_apex_kpa": TIMES,
    "cornea_min_stress_kpa": TIMES,
    "chamber_volume_error": TIMES,
    "energy_error_uj": TIMES,
}
STUB = {
    "design": {"kind": "random", "eyes": 120, "seed": 2},
    "set": {"numerics": {"fidelity": "cavity"}},
    "vary": {IOP: {"mean": 15, "sd": 3}, THICK: {"mean": 0.55, "sd": 0.03}},
}


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_rows_are_those_of_each_eye_alone(tmp_path, monkeypatch):
    (tmp_path / "eyes.csv").write_text("who,eye.iop_mmhg,numerics.fidelity\na,12,cavity\nb,18,cavity\nc,15,membrane\n")
    (tmp_path / "base.toml").write_text("[numerics]\nspacing_mm = 0.4\n")
    (tmp_path / "study.toml").write_text('scene = "base.toml"\n[design]\nkind = "table"\nfile = "eyes.csv"\n')
    result = taichi_eye.sweep(tmp_path / "study.toml", tmp_path / "out", threads=1)
    table = result.table
    # of two complete eyes there is no fit
    assert names(tmp_path / "out") == ALWAYS - {"matters.png"} | {"design.csv"}
    assert list(table["eye"]) == [0, 1, 2] and list(table["who"]) == list("abc")
    for row in table.to_dict("records"):
        changed = [f"{name}={row[name]}" for name in (IOP, "numerics.fidelity")]
        alone = response_of(taichi_eye.load_scene(tmp_path / "base.toml", changed))
        for name, value in asdict(alone.response).items():
            assert row[name] == value if value is not None else np.isnan(row[name]), name
        assert (row["status"] == "stopped") == bool(alone.stopped) == (row["who"] == "c")
        assert row["fidelity"] == row["numerics.fidelity"]
    assert table["reason"][2].startswith("stopped at ") and table["simulated_ms"][2] < 32.0
    assert result.summary["status"] == {"complete": 2, "stopped": 1, "refused": 0, "failed": 0}
    assert table["deformation_amplitude_mm"][0] > table["deformation_amplitude_mm"][1] > 0.5
    # what is left of a study runs again to the same table, and is what pandas reads from either file
    monkeypatch.setattr(page, "draw", lambda *_: {})
    again = sweep(tmp_path / "out" / "study.toml", tmp_path / "again", threads=1)
    pandas.testing.assert_frame_equal(again.table, table)
    text = pandas.read_csv(tmp_path / "out" / "table.csv")
    np.testing.assert_array_equal(text[list(FIGURES)].to_numpy(float), table[list(FIGURES)].to_numpy(float))


def test_an_eye_that_raises_takes_nothing_from_those_beside_it(monkeypatch):
    def some(scenes):
        if any(scene.eye.iop_mmhg == 13.0 for scene in scenes):
            raise SceneError("the chamber cannot be filled\nat this spacing")
        return [Found(scene) for scene in scenes]

    class Found:
        outcome, read = SimpleNamespace(stop=None, traces=TRACES), lambda self: Reading(Response(a1_time_ms=7.0))

        def __init__(self, scene):
            # as "auto" decides, on another spacing than was asked for
            self.scene = scene.but({"numerics.fidelity": "cavity", "numerics.spacing_mm": 0.4})

    monkeypatch.setattr(eyes, "observe_many", some)
    base = plain_scene(taichi_eye.load_scene(None, ["numerics.fidelity=auto"]))
    common = eyes.common_of(base, [IOP, "numerics.spacing_mm"], {})
    rows = eyes.measure(common, [{IOP: 12.0}, {IOP: 13.0}, {IOP: 14.0}, {IOP: -1.0}])
    assert [row["status"] for row in rows] == ["complete", "refused", "complete", "refused"]
    assert rows[1]["reason"] == "the chamber cannot be filled; at this spacing" and "eye.iop_mmhg" in rows[3]["reason"]
    assert rows[0][IOP] == 12.0 and rows[0]["numerics.spacing_mm"] == 0.1 and rows[0]["fidelity"] == "cavity"
    assert (
        rows[0]["a1_time_ms"] == 7.0
        and rows[0]["apex_peak_mm"] == 1.0
        and rows[0]["apex_delay_ms"] == pytest.approx(-1.0)
    )


def test_a_puff_file_travels_with_the_study(tmp_path):
    file = tmp_path / "puff.csv"
    file.write_text("time_ms,pressure_kpa\n0,0\n8,6\n16,0\n")
    words = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.4", "puff.time_course=file", f"puff.file={file}"]
    scene = taichi_eye.load_scene(None, words)
    common = eyes.common_of(plain_scene(scene), ["puff.file"], {str(file): file.read_text()})
    here = eyes.measure(common, [{}])[0]
    file.unlink()  # as on another machine
    eyes._base.cache_clear()
    eyes._places.cache_clear()
    there = eyes.measure(common, [{}])[0]
    assert here == there and there["status"] == "complete" and there["puff.file"] == str(file)


def test_an_eye_that_ends_its_process_is_a_row(tmp_path, plain, monkeypatch, capsys):
    monkeypatch.setattr(module, "sweep", partial(sweep, compute="stubs:deadly"))
    monkeypatch.chdir(tmp_path)
    form = '[design]\nkind = "grid"\n[set]\nnumerics.fidelity = "cavity"\n[vary]\neye.iop_mmhg = {{ values = {} }}\n'
    Path("some.toml").write_text(form.format([66.0, 12.0]))
    words = ["--quiet", "--threads", "1"]
    assert cli.main(["sweep", "some.toml", "--out", "some", *words]) == 0
    said = capsys.readouterr().out
    assert "1 eye: the process that computed it was ended by signal 9\n" in said
    assert "some: 2 eyes (1 complete, 1 failed)" in said
    table = pandas.read_parquet("some/table.parquet")
    assert list(table["status"]) == ["failed", "complete"] and list(table[IOP]) == [66.0, 12.0]
    assert "signal 9" in table["reason"][0] and table["a1_time_ms"].notna().tolist() == [False, True]
    # a program that raises ends its process, too, with what it says at last; where no eye is complete the status is 1
    Path("none.toml").write_text(form.format([67.0]))
    assert cli.main(["sweep", "none.toml", "--out", "none", *words]) == 1
    said = capsys.readouterr().out
    assert "none: 1 eye (1 failed)" in said and "ZeroDivisionError" in said


@pytest.fixture
def plain(monkeypatch):
    """Studies without pictures, which take their time."""
    monkeypatch.setattr(page, "draw", lambda *_: {})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a study that was never cut off."""
    return sweep(STUB, tmp_path_factory.mktemp("whole") / "out", threads=1, compute="stubs:linear").folder


def assert_same(folder, whole):
    assert names(whole) == ALWAYS and names(folder) == ALWAYS - PLOTS
    for name in ("table.csv", "columns.csv", "study.toml", "scene.toml", "matters.csv"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name
    assert pq.read_table(folder / "table.parquet").equals(pq.read_table(whole / "table.parquet"))
    assert list(pandas.read_parquet(folder / "table.parquet")["eye"]) == list(range(120))


def killed(out, after):
    """A study in a process of its own that is killed once so many parcels are kept."""
    text = (
        "import json, sys, taichi_eye.cli as cli\n"
        "from taichi_eye.studies import command, sweep\n"
        "command_sweep = sweep.sweep\n"
        "def stub(study, out, **options):\n"
        "    return command_sweep(json.load(open(study)), out, **options, compute='stubs:slow')\n"
        "sweep.sweep = stub\n"
        "sys.exit(cli.main(['sweep', sys.argv[1], '--out', sys.argv[2], '--threads', '2', '--quiet']))\n"
    )
    study = out.parent / "study.json"
    study.write_text(json.dumps(STUB))
    process = subprocess.Popen(
        [sys.executable, "-c", text, str(study), str(out)],
        env=environment(PYTHONPATH=os.pathsep.join([str(HERE), str(HERE.parents[1])])),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    patience = time.monotonic() + 120
    while len(list((out / ".run").glob("parcel-*"))) < after and process.poll() is None:
        assert time.monotonic() < patience
        time.sleep(0.02)
    process.kill()
    process.wait()


def test_a_study_that_is_killed_goes_on_to_the_same_table(tmp_path, whole, plain):
    out = tmp_path / "out"
    killed(out, after=48)
    assert names(out) == {".run"}
    kept = {path.name: path.stat().st_mtime_ns for path in (out / ".run").glob("parcel-*.parquet")}
    assert 48 <= len(kept) < 120
    with pytest.raises(SceneError, match="holds a study.*sweep --resume"):
        taichi_eye.resume(out)
    # a second study there is refused, and so is a second process
    with pytest.raises(SceneError, match="not empty"):
        sweep(STUB, out, compute="stubs:linear")
    lock = Lock(out)
    with pytest.raises(SceneError, match="in use by another run"):
        resume(out)
    lock.release()
    seen = []
    put = module.Shelf.put
    module.Shelf.put = lambda self, parcel, rows: (seen.append(parcel), put(self, parcel, rows))
    try:
        result = resume(out, threads=1)
    finally:
        module.Shelf.put = put
    # no finished parcel was computed again
    assert len(seen) == 120 - len(kept) == result.summary["wall_clock"]["eyes_computed"]
    assert not {f"parcel-{parcel:07d}.parquet" for parcel in seen} & set(kept)
    assert_same(out, whole)
    assert resume(out).finished_before
    with pytest.raises(SceneError, match="not empty"):
        sweep(STUB, out, compute="stubs:linear")


def test_a_signal_ends_a_study_in_order_and_says_how_to_go_on(tmp_path, whole, plain, monkeypatch, capsys):
    put, kept = module.Shelf.put, []

    def ended(self, parcel, rows):
        put(self, parcel, rows)
        kept.append(parcel)
        if len(kept) == 5:
            signal.raise_signal(signal.SIGTERM)

    out = tmp_path / "out"
    monkeypatch.setattr(module, "sweep", lambda study, out, **given: sweep(STUB, out, compute="stubs:linear", **given))
    monkeypatch.setattr(module.Shelf, "put", ended)
    assert cli.main(["sweep", "study.toml", "--out", str(out), "--threads", "1", "--quiet"]) == 143
    said = capsys.readouterr()
    assert said.out == "" and "ended by SIGTERM" in said.err
    assert f"; the eyes that are finished are in {out}, go on with: taichi-eye sweep --resume {out}" in said.err
    assert len(list((out / ".run").glob("parcel-*"))) == len(kept) >= 5
    monkeypatch.setattr(module.Shelf, "put", put)
    assert cli.main(["sweep", "--resume", str(out), "--quiet"]) == 0
    assert_same(out, whole)


def test_a_full_disk_keeps_what_is_finished(tmp_path, whole, plain, monkeypatch):
    out, limit = tmp_path / "out", resource.getrlimit(resource.RLIMIT_FSIZE)
    put = module.Shelf.put

    def full(self, parcel, rows):
        if parcel == 7:
            # the system takes no byte more of a file: what a full disk does
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
        try:
            put(self, parcel, rows)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limit)

    monkeypatch.setattr(signal, "SIGXFSZ", signal.SIGXFSZ)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    monkeypatch.setattr(module.Shelf, "put", full)
    try:
        with pytest.raises(OutputError, match=r"parcel-0000007(?s:.*)sweep --resume"):
            sweep(STUB, out, threads=1, compute="stubs:linear")
    finally:
        signal.signal(signal.SIGXFSZ, before)
    monkeypatch.setattr(module.Shelf, "put", put)
    assert len(list((out / ".run").glob("parcel-*"))) == 7 and not list((out / ".run").glob(".part-*"))
    resume(out, threads=1)
    assert_same(out, whole)


def test_a_damaged_parcel_and_another_program_are_refused(tmp_path, monkeypatch):
    def stop(self, parcel, rows, put=module.Shelf.put):
        put(self, parcel, rows)
        raise Interrupted(signal.SIGTERM)

    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr(module.Shelf, "put", stop)
        with pytest.raises(Interrupted) as ended:
            sweep(STUB, out, threads=1, compute="stubs:linear")
    assert ended.value.folder == out
    (parcel,) = (out / ".run").glob("parcel-*.parquet")
    whole = parcel.read_bytes()
    parcel.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match=f"{parcel}.*is damaged"):
        resume(out)
    parcel.write_bytes(whole)
    from taichi_eye.recording import workroom

    monkeypatch.setattr(workroom, "program", lambda: "taichi_eye 9.9")
    with pytest.raises(SceneError, match="was begun by taichi_eye"):
        resume(out)
