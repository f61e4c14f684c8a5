"""Many scenes in one call: their order, every rung, and a call that is cut off."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_eye.errors import SceneError
from taichi_eye.ladder import batches
from taichi_eye.ladder.batches import run_batch
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.ladder.trial import run_to_stop
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import clouds_of
from taichi_eye.units import MM

BASE = ("numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "numerics.duration_ms=6", "puff.duration_ms=12")
KEYS = [
    (),
    ("numerics.fidelity=cavity", "eye.iop_mmhg=20"),
    ("numerics.basis=cubic", "numerics.duration_ms=1"),
    ("eye.iop_mmhg=22",),
    ("numerics.fidelity=added_mass",),
    ("eye.iop_mmhg=1",),
    ("puff.peak_kpa=6",),
]


def scene(keys):
    return load_scene(None, (*BASE, *keys))


@pytest.fixture(scope="module")
def scenes():
    return [scene(keys) for keys in KEYS]


@pytest.fixture(scope="module")
def alone(scenes):
    found = []
    for each in scenes:
        simulation = simulation_of(each)
        try:
            simulation.run()
        except batches.RunStopped:
            pass
        found.append(simulation.traces)
        del simulation
    return found


def assert_same(outcomes, scenes, alone):
    assert [outcome.scene for outcome in outcomes] == scenes
    for outcome, traces in zip(outcomes, alone):
        for column, values in traces.items():
            np.testing.assert_array_equal(outcome.traces[column], values, err_msg=column)
    assert [outcome.stop is not None for outcome in outcomes] == [keys == ("eye.iop_mmhg=1",) for keys in KEYS]


def test_every_rung_gives_what_it_gives_alone_in_order(scenes, alone, monkeypatch):
    monkeypatch.setattr(batches, "AT_ONCE", clouds_of(scenes)[0].count + 1)
    assert_same(run_batch(scenes), scenes, alone)


@pytest.fixture(scope="module")
def samples(scenes, tmp_path_factory):
    """The samples of one call, two eyes at once."""
    looks = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batches, "AT_ONCE", 2 * clouds_of(scenes)[0].count + 1)
        patch.setattr(batches._Kept, "hold", lambda self, *given: looks.append(1))
        run_batch(scenes, keep=tmp_path_factory.mktemp("whole") / "kept.npz")
    return len(looks)


@pytest.mark.parametrize("after", [3, 500])
def test_a_call_that_was_cut_off_goes_on_to_the_same_bits(after, scenes, alone, samples, monkeypatch, tmp_path):
    monkeypatch.setattr(batches, "AT_ONCE", 2 * clouds_of(scenes)[0].count + 1)
    monkeypatch.setattr(batches, "KEEP_S", 0.0)
    kept, looks, hold = tmp_path / "kept.npz", [], batches._Kept.hold

    def cut(self, *given):
        hold(self, *given)
        looks.append(1)
        if len(looks) == after:
            raise KeyboardInterrupt

    monkeypatch.setattr(batches._Kept, "hold", cut)
    with pytest.raises(KeyboardInterrupt):
        run_batch(scenes, keep=kept)
    monkeypatch.setattr(batches._Kept, "hold", lambda self, *given: looks.append(1))
    assert_same(run_batch(scenes, keep=kept), scenes, alone)
    assert not kept.exists() and not list(tmp_path.iterdir())
    # nothing is done twice: the samples of both calls are those of one
    assert len(looks) == samples


def test_a_file_of_other_scenes_or_a_damaged_one_is_refused(scenes, monkeypatch, tmp_path):
    kept = tmp_path / "kept.npz"
    monkeypatch.setattr(batches, "KEEP_S", 0.0)
    monkeypatch.setattr(batches._Kept, "take_up", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    batches._Kept(kept, scenes).write([None] * len(scenes))
    with pytest.raises(SceneError, match="kept.npz: was kept by a call with other scenes"):
        run_batch(scenes[:2], keep=kept)
    kept.write_bytes(kept.read_bytes()[:-40])
    with pytest.raises(SceneError, match="kept.npz: cannot be gone on from"):
        run_batch(scenes, keep=kept)


def test_a_scene_that_cannot_be_filled_is_named():
    coarse = replace(scene(()), numerics=replace(scene(()).numerics, spacing_mm=2.0))
    with pytest.raises(SceneError, match="scene 1 of the batch: numerics.spacing_mm = 2"):
        run_batch([scene(()), coarse])


def test_frames_are_those_of_each_eye_alone_once_and_in_order(scenes):
    seen = {k: [] for k in range(len(scenes))}
    batches.run_batch(scenes, on_frame=lambda k, time_ms, wall: seen[k].append((time_ms, wall)))
    for k, each in enumerate(scenes):
        alone = []
        simulation = simulation_of(each)

        def look(run, _, alone=alone):
            alone.append((run.time_ms, run.cornea.place.to_numpy()[: run.wall_count] / MM))

        run_to_stop(simulation, look)
        assert len(seen[k]) == len(alone) > 1
        for (time_ms, wall), (time, place) in zip(seen[k], alone):
            assert time_ms == pytest.approx(time, rel=1e-12)
            np.testing.assert_array_equal(wall, place)
        del simulation
    with pytest.raises(ValueError, match="leave out keep or on_frame"):
        run_batch(scenes, keep="x", on_frame=print)
