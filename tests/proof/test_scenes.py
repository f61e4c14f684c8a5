"""What `taichi-eye check scenes` measures with, and its parts in short."""

import numpy as np
import pytest

from taichi_eye.ladder.trial import Trial
from taichi_eye.proof import scenes
from taichi_eye.scene import load_scene
from taichi_eye.scene.draft import written


def quiet(text):
    pass


def test_values_drawn_are_allowed_on_their_own_and_reach_both_ends():
    random = np.random.default_rng(1)
    for name, (kind, spec) in scenes.TABLE.items():
        drawn = [scenes.at_an_end(kind, spec, random) for _ in range(40)]
        assert all(isinstance(value, kind) and spec.holds(value) for value in drawn), name
        if kind in (int, float) and not spec.choices and spec.at_most is not None:
            assert {spec.at_least, spec.at_most} <= set(drawn), name
        load_scene(None, [f"{name}={written(value)}" for value in [spec.default]])


def test_the_loader_refuses_or_accepts_scenes_at_the_ends(monkeypatch):
    (row,), _ = scenes.extremes(quiet, 300, seed=np.random.randint(1000))
    assert row.value == 0 and row.holds, row.note
    monkeypatch.setattr(scenes, "load_scene", lambda *_: 1 / 0)
    (row,), _ = scenes.extremes(quiet, 3)
    assert row.value == 3 and not row.holds and "ZeroDivisionError" in row.note


def trial(apex, end=1.0):
    apex = np.asarray(apex, float)
    traces = {"time_ms": np.linspace(0.0, end, len(apex)), "apex_displacement_mm": apex}
    return Trial(None, traces, None, 1, 1, 0.0, 0.0)


def test_change_is_the_largest_of_the_history_over_the_peak():
    assert scenes._change(trial([0, 1, 0]), trial([0, 0.5, 1.1, 0.5, 0])) == pytest.approx(0.1)
    assert scenes._change(trial([0, 1, 0]), trial([0, 1], end=0.5)) == 0.0
    assert scenes._change(trial([0, 1, 0]), trial([0, 1], end=0.4)) == np.inf
    assert scenes._change(trial([0, 0, 0]), trial([0, 0])) == 0.0


def test_a_silent_change_fails_the_row_and_a_warned_one_does_not(monkeypatch):
    histories = iter([trial([0, 1, 0]), trial([0, 1.1, 0])] * 2)
    monkeypatch.setattr(scenes, "run_scene", lambda scene: next(histories))
    for said, holds in (([], False), (["compressed"], True)):
        monkeypatch.setattr(scenes, "doubts", lambda case, traces, said=said: said)
        rows, _ = scenes.pairs(quiet, 1)
        assert rows[0].holds is holds and rows[1].value == pytest.approx(10.0)


def test_a_run_of_an_accepted_scene_ends_with_a_reason_within_its_memory():
    words = ["numerics.fidelity=membrane", "numerics.duration_ms=1", "camera.view=scheimpflug"]
    end, took = scenes._ended(load_scene(None, words))
    assert end == "complete" and (took is None or 5e7 < took < 3e9)


@pytest.mark.parametrize("grows", [False, True])
def test_memory_that_grows_with_the_calls_fails_the_row(grows, monkeypatch):
    kept = []

    def stub(scene, out, progress):
        kept.append(np.ones(3_000_000) if grows else None)  # 24 MB a call

    monkeypatch.setattr(scenes, "run", stub)
    (row,), _ = scenes.calls(quiet, 40)
    assert row.value is None or row.holds is not grows, row.note
