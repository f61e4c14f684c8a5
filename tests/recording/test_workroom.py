"""The hidden work folder: checkpoints that are whole or refused, logs that are cut where they have to be."""

import numpy as np
import pytest

from taichi_eye.errors import SceneError
from taichi_eye.recording.workroom import CHECKPOINT, Log, WorkRoom, fingerprint, program
from taichi_eye.report.folder import WORK
from taichi_eye.scene import load_scene

ROW = np.dtype([("time_ms", "f8"), ("wall", "f4", (3, 2))])


def header(scene, **more):
    return {"program": program(), "scene": fingerprint(scene), "held": {}} | more


@pytest.fixture
def room(tmp_path):
    room = WorkRoom(tmp_path)
    room.begin({"program": program(), "scene": "[eye]"})
    return room


def test_a_state_comes_back_bit_for_bit(room):
    scene, draw = load_scene(), np.random.default_rng(8)
    assert room.load(scene) is None
    state = {
        "file": draw.normal(size=(5, 2)),
        "single": draw.normal(size=7).astype(np.float32),
        "header": np.array([np.nan, -0.0, np.inf, 5e-324]),
        "count": np.array(3),
        "nothing": np.zeros((0, 4)),
        "flags": draw.random(9) < 0.5,
    }
    room.save(header(scene, held={"Film": {"frames": 4}}), state)
    head, back = room.load(scene)
    assert head["held"] == {"Film": {"frames": 4}} and set(back) == set(state)
    for name, values in state.items():
        assert back[name].dtype == values.dtype and back[name].shape == values.shape
        assert back[name].tobytes() == values.tobytes()


def test_a_checkpoint_replaces_the_last_one_or_leaves_it(room):
    scene = load_scene()
    room.save(header(scene), {"x": np.array(1.0)})
    with pytest.raises(TypeError, match="JSON"):
        room.save(header(scene, held=object()), {"x": np.array(2.0)})
    assert room.load(scene)[1]["x"] == 1.0
    room.save(header(scene), {"x": np.array(3.0)})
    assert room.load(scene)[1]["x"] == 3.0
    assert {path.name for path in room.path.iterdir()} == {"run.json", CHECKPOINT}


def test_every_damage_is_found(room):
    scene = load_scene()
    room.save(header(scene), {"x": np.arange(3.0)})
    whole = (room.path / CHECKPOINT).read_bytes()
    for place in range(0, len(whole), 7):
        damaged = bytearray(whole)
        damaged[place] ^= 0x10
        (room.path / CHECKPOINT).write_bytes(damaged)
        with pytest.raises(SceneError, match=CHECKPOINT):
            room.load(scene)
    for length in (0, 10, len(whole) - 1):
        (room.path / CHECKPOINT).write_bytes(whole[:length])
        with pytest.raises(SceneError, match=CHECKPOINT):
            room.load(scene)


def test_another_scene_is_refused_its_puff_file_included(room, tmp_path):
    puff = tmp_path / "puff.csv"
    puff.write_text("time_ms,pressure_kpa\n0,0\n5,3\n")
    scene = load_scene(None, ["puff.time_course=file", f"puff.file={puff}"])
    room.save(header(scene), {})
    assert room.load(scene) is not None
    for other in (load_scene(), load_scene(None, ["puff.time_course=file", f"puff.file={puff}", "eye.iop_mmhg=16"])):
        with pytest.raises(SceneError, match="another scene"):
            room.load(other)
    puff.write_text("time_ms,pressure_kpa\n0,0\n5,4\n")
    with pytest.raises(SceneError, match="another scene"):
        room.load(scene)


def test_a_finished_work_folder_is_gone(room, tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "a.png").touch()
    room.finish()
    (tmp_path / f"{WORK}-gone").mkdir()  # of a process that was killed just there
    room.tidy()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.png", "frames"]
    assert not (tmp_path / WORK).exists()


def test_a_log_goes_on_where_it_was_held(tmp_path):
    draw = np.random.default_rng(2)
    walls = draw.normal(size=(9, 3, 2)).astype(np.float32)
    log = Log(tmp_path / "wall", ROW)
    for k in range(4):
        log.append(0.1 * k, walls[k])
    held = log.held()
    log.append(9.9, walls[8])
    with open(tmp_path / "wall", "ab") as file:
        file.write(b"part of a row")
    again = Log(tmp_path / "wall", ROW, held)
    for k in range(4, 8):
        again.append(0.1 * k, walls[k])
    for each in (again, Log(tmp_path / "wall", ROW, again.held())):
        rows = each.read()
        np.testing.assert_array_equal(rows["wall"], walls[:8])
        np.testing.assert_array_equal(rows["time_ms"], [0.1 * k for k in range(8)])


def test_a_checkpoint_counts_on_its_files(room):
    scene, log = load_scene(), Log(room.path / "wall", ROW)
    log.append(0.0, np.ones((3, 2)))
    room.save(header(scene, held={"Wall": log.held(), "Traces": None}), {})
    log.append(0.1, np.ones((3, 2)))
    assert room.load(scene)[0]["held"]["Wall"]["rows"] == 1  # what came after it does not count
    whole = (room.path / "wall").read_bytes()
    for damaged in (whole[: ROW.itemsize - 1], b"", b"x" + whole[1:], None):
        if damaged is None:
            (room.path / "wall").unlink()
        else:
            (room.path / "wall").write_bytes(damaged)
        with pytest.raises(SceneError, match="wall: is damaged"):
            room.load(scene)
