"""Many exams in one table."""

from types import SimpleNamespace

import pandas
import pytest

from taichi_eye import cli
from taichi_eye.analysis import Response
from taichi_eye.errors import FilmError
from taichi_eye.studies import exams
from taichi_eye.studies.columns import CLINICAL, INSTRUMENT, exams_schema, unit_of


def test_a_row_an_exam_with_the_instruments_columns_beside_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(exams, "COMPUTE", "stubs:exams")
    for suffix, read in ((".csv", pandas.read_csv), (".parquet", pandas.read_parquet)):
        table = tmp_path / f"all{suffix}"
        counts, first = exams.measure_all(["b.avi", "bad.avi", "a.avi"], table, {"note": "mine"}, threads=1)
        assert counts == {"complete": 2, "refused": 1, "failed": 0} and first == "no film"
        held = read(table)
        assert list(held.columns) == exams_schema().names
        assert list(held["exam"]) == ["b.avi", "bad.avi", "a.avi"]
        assert list(held["status"]) == ["complete", "refused", "complete"] and held["reason"][1] == "no film"
        assert held["a1_time_ms"][0] == held["A1 Time [ms]"][0] == 7.25 and pandas.isna(held["A1 Time [ms]"][1])
        assert held["peak_distance_mm"][2] == held["Peak Dist. [mm]"][2] == 4.5
        assert held["frames"][0] == 139 and held["notes"][2] == "mine"


def test_the_instruments_names_say_the_units_of_ours():
    assert set(INSTRUMENT) <= set(CLINICAL) and len(set(INSTRUMENT.values())) == len(INSTRUMENT)
    same = {"1/mm": "mm^-1"}
    for ours, theirs in INSTRUMENT.items():
        unit = theirs[theirs.index("[") + 1 : -1] if "[" in theirs else ""
        # SP A1 has no unit in its name there, and ratios have none
        assert unit == same.get(unit_of(ours), unit_of(ours)) or ours == "sp_a1_mmhg_mm"


def test_what_an_exam_shows_is_its_row_and_what_is_wrong_with_it_its_reason(monkeypatch):
    def analyze(path, write, **options):
        if path == "none":
            raise FilmError("none: no such file\nor folder")
        if path == "broken":
            raise IndexError("list index out of range")
        film = SimpleNamespace(frames=[0] * 7, timed_by=f"{options['age_years']}")
        return SimpleNamespace(response=Response(hc_time_ms=16.5), film=film, notes=("one", "two"))

    monkeypatch.setattr(exams, "analyze", analyze)
    good, none, broken = exams.measure({"age_years": 60}, [{"exam": name} for name in ("good", "none", "broken")])
    assert good["hc_time_ms"] == 16.5 and good["a1_time_ms"] is None and good["frames"] == 7
    assert good["timed_by"] == "60" and good["notes"] == "one; two" and good["status"] == "complete"
    assert none == {"status": "refused", "reason": "none: no such file; or folder"}
    assert broken == {"status": "failed", "reason": "IndexError: list index out of range"}


@pytest.mark.parametrize(
    "words, text",
    [
        (["a.avi", "b.avi"], "name the table that they go into"),
        (["a.avi", "--table", "all.txt"], "must end in .csv or .parquet"),
        (["a.avi", "--table", "nowhere/all.csv"], "cannot be written"),
        (["a.avi", "--table", "all.csv", "--out", "x"], "no folders"),
    ],
)
def test_bad_commands_write_nothing(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["analyze", *words]) == 2
    assert text in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_no_table_where_no_exam_can_be_read(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(exams, "COMPUTE", "stubs:exams")
    assert cli.main(["analyze", "bad.avi", "--table", "all.csv", "--threads", "1"]) == 2
    assert "none of 1 exams could be read; the first: no film" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
