"""Run folders: read as one whole whichever part is named, and refused by the name of the file that is damaged."""

import shutil

import numpy as np
import pytest
from PIL import Image

from taichi_eye.analysis import read_film
from taichi_eye.errors import FilmError, SceneError
from taichi_eye.film import FilmWriter
from taichi_eye.proof.films.eyes import EYES, walls_mm
from taichi_eye.report.traces import COLUMNS, write_traces, write_wall

COUNT, WIDTH, HEIGHT = 12, 320, 120
TIMES = 0.5 * np.arange(COUNT)
CAMERA = {"view": "scheimpflug", "width_px": WIDTH, "height_px": HEIGHT, "frame_interval_ms": 0.5}


def slit_frames():
    random = np.random.default_rng(0)
    return np.clip(20.0 + 5.0 * random.standard_normal((COUNT, HEIGHT, WIDTH)), 0, 255).astype(np.uint8)


def scene_text(**changes):
    lines = [
        f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}"
        for key, value in (CAMERA | changes).items()
    ]
    return "\n".join(["[camera]", *lines, ""])


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good") / "run"
    (folder / "frames").mkdir(parents=True)
    for k, frame in enumerate(slit_frames()):
        Image.fromarray(frame).save(folder / "frames" / f"{k:03d}.png")
    (folder / "scene.toml").write_text(scene_text(), encoding="utf-8")
    write_wall(folder / "wall.npz", TIMES, walls_mm(EYES[0], EYES[0].scene())[:COUNT])
    columns = {name: np.zeros(COUNT) for name in COLUMNS} | {"time_ms": TIMES, "puff_apex_kpa": 2.0 + TIMES}
    write_traces(folder / "traces.csv", columns)
    return folder


@pytest.fixture
def run(good, tmp_path):
    return shutil.copytree(good, tmp_path / "run")


def test_the_folder_and_its_frames_are_one_run(good):
    for path in (good, good / "frames"):
        film = read_film(path)
        assert np.array_equal(film.frames, slit_frames()) and film.time_ms == pytest.approx(TIMES)
        assert film.timed_by == "the scene's frame interval" and film.truth is not None and film.name == "run"
        assert film.puff_mmhg[1][0] == pytest.approx(2.0 / 0.133322, rel=1e-4)


def test_the_slit_frame_is_taken_out_of_both_views(run):
    shutil.rmtree(run / "frames")
    (run / "scene.toml").write_text(scene_text(view="both"), encoding="utf-8")
    with FilmWriter(run / "film.mp4", 25) as film:
        for frame in slit_frames():
            whole = np.zeros((4 * HEIGHT, 2 * WIDTH, 3), np.uint8)
            whole[: 2 * HEIGHT] = frame.repeat(2, 0).repeat(2, 1)[..., None]
            whole[2 * HEIGHT :, :WIDTH] = 230, 40, 20
            whole[2 * HEIGHT :, WIDTH:] = 20, 40, 230
            film.write(whole)
    for path in (run, run / "film.mp4"):
        film = read_film(path)
        assert film.frames.shape == (COUNT, HEIGHT, WIDTH)
        assert np.abs(film.frames[:, 4:-4].astype(float) - slit_frames()[:, 4:-4]).mean() < 2.5
    elsewhere = shutil.copy(run / "film.mp4", run.parent / "film.mp4")
    for options in ({}, {"pixel_x_mm": 0.0078, "pixel_y_mm": 0.0083}):
        with pytest.raises(FilmError, match="run folder|shape of the instrument"):
            read_film(elsewhere, **options)


def wall(**changes):
    def harm(path):
        with np.load(path) as held:
            arrays = dict(held) | {key: change(held[key]) for key, change in changes.items()}
        np.savez(path, **{key: value for key, value in arrays.items() if value is not None})

    return harm


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def text(content):
    return lambda path: path.write_text(content, encoding="utf-8")


@pytest.mark.parametrize(
    "name, harm",
    [
        ("wall.npz", wall(z_mm=lambda z: z * np.nan)),
        ("wall.npz", wall(r_mm=lambda r: r[:, :-1])),
        ("wall.npz", wall(time_ms=lambda t: t[::-1])),
        ("wall.npz", wall(time_ms=lambda t: None)),
        ("wall.npz", wall(r_mm=lambda r: r.astype(object))),
        ("wall.npz", wall(r_mm=lambda r: r.astype(str))),
        ("wall.npz", wall(r_mm=lambda r: r[:, ::-1])),
        ("wall.npz", wall(z_mm=lambda z: 1e300 * z)),
        ("wall.npz", cut),
        ("wall.npz", text("no archive")),
        ("traces.csv", text("")),
        ("traces.csv", text("time_ms,puff_apex_kpa\n0,one\n")),
        ("traces.csv", text("time_ms,puff_apex_kpa\n0,1\n1\n")),
        ("traces.csv", text("time_ms,puff_apex_kpa\n0,1\n0,2\n")),
        ("traces.csv", text("time_ms,load\n0,1\n1,2\n")),
        ("traces.csv", lambda path: path.write_bytes(b"\xff\x00\x01" * 50)),
        ("frames", lambda path: (path / "003.png").write_bytes(b"PNG")),
    ],
)
def test_a_damaged_file_is_refused_by_its_name(run, name, harm):
    harm(run / name)
    with pytest.raises((FilmError, SceneError), match=name) as caught:
        read_film(run)
    assert len(str(caught.value).splitlines()) == 1


def test_pictures_of_another_size_than_the_scenes_are_refused(run):
    (run / "scene.toml").write_text(scene_text(width_px=WIDTH + 40), encoding="utf-8")
    with pytest.raises(FilmError, match="scene.toml"):
        read_film(run)


def test_a_run_without_pictures_is_refused(run):
    shutil.rmtree(run / "frames")
    with pytest.raises(FilmError, match="neither film.mp4 nor frames/"):
        read_film(run)
