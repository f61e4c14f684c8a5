"""The bench's table, page and JSON, with parts that measure nothing; a clock is never tested."""

import json

import pytest

from taichi_eye.bench import bench, gpu
from taichi_eye.bench.rows import Row, at_least, at_most, figure, skipped
from taichi_eye.bench.timing import best_of
from taichi_eye.cli import main
from taichi_eye.lang import NAME
from taichi_eye.report.page import draw


def good(stage):
    """Two rows and a picture."""
    stage("half way")
    canvas = draw({"title": "t", "x": "x", "y": "y", "lines": [("a line", (1.0, 2.0), (3.0, 4.0))], "log": False})
    return [at_most("a quick thing", 0.5, "s", 1.0), figure("a size <now>", 12.0, "nodes", "n = 3")], [canvas]


def slow(stage):
    """A row that does not hold."""
    return [at_least("a slow thing", 1.5, "times", 2.0)], []


def absent(stage):
    """A row that cannot be had."""
    return [skipped("another machine", "no such machine", ">= 2")], []


@pytest.fixture
def parts(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "PARTS", {"good": good, "slow": slow, "absent": absent})
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_row_holds_within_its_limit_and_nan_holds_nowhere():
    assert at_most("n", 2.0, "s", 2.0).holds and not at_most("n", 2.1, "s", 2.0).holds
    assert at_least("n", 2.0, "s", 2.0).holds and not at_least("n", 1.9, "s", 2.0).holds
    assert at_most("n", float("nan"), "s", 2.0).holds is False and at_least("n", float("nan"), "s", 2.0).holds is False
    assert figure("n", 1.0).holds is None and skipped("n", "why").holds is None
    for value in (float("nan"), float("inf"), None):
        assert json.loads(json.dumps(Row("n", value).as_dict(), allow_nan=False))["value"] is None


def test_each_turn_runs_every_job_once_in_order():
    ran = []
    best = best_of({"a": lambda: ran.append("a"), "b": lambda: ran.append("b")}, 3)
    assert ran == ["a", "b"] * 3
    assert set(best) == {"a", "b"} and all(0.0 <= took < float("inf") for took in best.values())


def test_the_table_says_what_was_measured_what_is_asked_and_whether_it_holds(parts, capsys):
    assert main(["bench", "--json", "figures.json"]) == 1
    said = capsys.readouterr().out
    line = {
        name: next(line for line in said.splitlines() if line.startswith(name))
        for name in ("a quick thing", "a size", "a slow thing", "another machine")
    }
    assert "0.5 s" in line["a quick thing"] and "<= 1" in line["a quick thing"] and "holds" in line["a quick thing"]
    assert "12 nodes" in line["a size"] and "n = 3" in line["a size"] and "hold" not in line["a size"].lower()
    assert "1.5 times" in line["a slow thing"] and "DOES NOT HOLD" in line["a slow thing"]
    assert "skipped: no such machine" in line["another machine"] and ">= 2" in line["another machine"]
    assert "1 of 2 rows hold, 1 skipped" in said
    page = (parts / "renders" / "bench-001" / "bench.html").read_text()
    assert page.count("<img") == 1 and "a size &lt;now&gt;" in page and page.count("<tr class=no>") == 1


def test_json_holds_the_machine_and_every_row(parts):
    main(["bench", "--json", "figures.json", "--out", "here"])
    figures = json.loads((parts / "figures.json").read_text())
    assert figures["machine"]["cores"] >= 1 and figures["machine"]["language"].startswith(NAME)
    assert list(figures["parts"]) == ["good", "slow", "absent"]
    assert figures["parts"]["good"][0] == {
        "name": "a quick thing",
        "value": 0.5,
        "unit": "s",
        "asked": "<= 1",
        "holds": True,
        "note": "",
    }
    assert figures["parts"]["absent"][0]["value"] is None and figures["parts"]["absent"][0]["holds"] is None
    assert sorted(path.name for path in (parts / "here").iterdir()) == ["bench.html", "bench.md"]


def test_only_the_parts_named_are_measured(parts, capsys):
    assert main(["bench", "--only", "good", "--only", "absent", "--out", "here"]) == 0
    said = capsys.readouterr().out
    assert "a quick thing" in said and "a slow thing" not in said and "another machine" in said


def test_an_unknown_part_is_refused_before_anything_is_written(parts, capsys):
    assert main(["bench", "--only", "warp"]) == 2
    said = capsys.readouterr()
    assert "--only warp" in said.err and "good, slow, absent" in said.err and said.out == ""
    assert list(parts.iterdir()) == []


def test_an_interrupted_bench_keeps_the_parts_it_measured(parts, monkeypatch):
    def interrupted(stage):
        """Control-C."""
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "PARTS", {"good": good, "interrupted": interrupted})
    assert main(["bench", "--json", "figures.json", "--out", "here"]) == 130
    assert list(json.loads((parts / "figures.json").read_text())["parts"]) == ["good"]
    assert "a quick thing" in (parts / "here" / "bench.html").read_text()


def test_without_a_gpu_the_part_is_one_row_that_says_so(monkeypatch):
    def init(arch, *rest):
        if arch == "cuda":
            raise gpu.backend.BackendError("no")

    monkeypatch.setattr(gpu.backend, "init", init)
    rows, figures = gpu.measure(lambda text: None)
    assert [row.value for row in rows] == [None] and rows[0].note == "skipped: no CUDA device" and figures == []


def test_with_a_gpu_the_table_compares_steps_and_answers(monkeypatch):
    # a CPU in the GPU's place: the same kernels, so the same answers
    monkeypatch.setattr(gpu.backend, "init", lambda arch, *rest: None)
    rows, _ = gpu.measure(lambda text: None, spacings_mm=(0.3,))
    value = {row.name.split(" at ")[0] + row.name.rpartition(",")[2]: row.value for row in rows}
    assert len(rows) == 4 and value["coupled step cpu"] > 0.0 and value["coupled step cuda"] > 0.0
    assert rows[2].value == pytest.approx(value["coupled step cpu"] / value["coupled step cuda"])
    assert rows[3].value == 0.0 and rows[3].holds
