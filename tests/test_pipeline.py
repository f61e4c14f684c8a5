"""The Python interface: a scene in, a run folder out."""

import json

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from processes import python

import taichi_eye
from taichi_eye.errors import OutputError
from taichi_eye.film import FilmView
from taichi_eye.lang import ti
from taichi_eye.recording.observer import Moment, Recording
from taichi_eye.report.traces import read_traces

TINY = ["numerics.spacing_mm=0.3", "numerics.sound_speed_m_s=15", "numerics.duration_ms=1.7"]
ALWAYS = {"film.mp4", "apex.png", "sheet.png", "traces.csv", "wall.npz", "summary.json", "scene.toml", "report.html"}


def names(folder):
    return {path.name for path in folder.iterdir()}


def film_frames(path):
    return imageio_ffmpeg.count_frames_and_secs(str(path))[0]


def test_a_run_starts_without_what_only_its_end_or_a_film_that_is_read_needs():
    slow = "scipy.signal scipy.stats scipy.interpolate scipy.ndimage matplotlib.figure meshio taichi_eye.analysis"
    told = python("-c", f"import sys, taichi_eye.pipeline; print([n for n in {slow.split()} if n in sys.modules])")
    assert told.stdout == "[]\n", told.stderr


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    scene = taichi_eye.load_scene(None, TINY + ["output.gif=true"])
    return taichi_eye.run(scene, tmp_path_factory.mktemp("runs") / "both")


def test_result_is_what_stands_in_the_folder(result):
    assert names(result.folder) == ALWAYS | {"film.gif"}
    written = read_traces(result.folder / "traces.csv")
    assert set(written) == set(result.traces)
    for column, values in written.items():
        np.testing.assert_array_equal(result.traces[column], values)
    assert json.loads((result.folder / "summary.json").read_text()) == json.loads(json.dumps(result.summary))


def test_film_of_both_views_has_every_frame(result):
    scene = taichi_eye.load_scene(result.folder / "scene.toml")
    assert scene.camera.view == "both" and film_frames(result.folder / "film.mp4") == scene.camera.frame_count == 8
    with Image.open(result.folder / "film.gif") as gif:
        assert 1 < gif.n_frames <= 8 and gif.mode in ("P", "RGB")


def test_filming_does_not_touch_the_simulation(result):
    scene = taichi_eye.load_scene(None, TINY)
    alone = taichi_eye.Simulation(scene).run()
    for column, values in alone.items():
        np.testing.assert_array_equal(values, result.traces[column])


def test_frame_of_the_film_shows_the_state_of_its_time(result, tmp_path):
    scene = taichi_eye.load_scene(None, TINY + ["output.png_frames=true", "camera.noise=false"])
    again = taichi_eye.run(scene, tmp_path / "again")
    frames = sorted((again.folder / "frames").iterdir())
    assert len(frames) == 8

    def look(path):
        with Image.open(path) as image:
            return np.asarray(image.convert("L"), dtype=float)

    first, last = look(frames[0]), look(frames[-1])
    assert first.shape == last.shape and np.abs(last - first).max() > 20.0


def test_an_interrupted_run_leaves_what_it_has(tmp_path, monkeypatch):
    render, frames = FilmView.render, []

    def interrupted(self, state):
        if len(frames) == 4:
            raise KeyboardInterrupt
        frames.append(state.time_ms)
        return render(self, state)

    monkeypatch.setattr(FilmView, "render", interrupted)
    scene = taichi_eye.load_scene(None, TINY + ["camera.view=scheimpflug"])
    with pytest.raises(KeyboardInterrupt):
        taichi_eye.run(scene, tmp_path / "cut")
    folder = tmp_path / "cut"
    assert names(folder) == ALWAYS | {".run"}
    assert film_frames(folder / "film.mp4") == 4
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "stopped" and summary["reason"] == "interrupted"
    assert read_traces(folder / "traces.csv")["time_ms"][-1] == summary["simulated_ms"] < 1.0
    with np.load(folder / "wall.npz") as wall:
        assert len(wall["time_ms"]) == 4
    monkeypatch.setattr(FilmView, "render", render)
    assert taichi_eye.resume(folder).summary["status"] == "complete"
    assert names(folder) == ALWAYS and film_frames(folder / "film.mp4") == scene.camera.frame_count


def test_a_bad_spacing_or_folder_or_history_is_refused_before_anything_is_written(tmp_path):
    scene = taichi_eye.load_scene(None, TINY)
    full = tmp_path / "full"
    full.mkdir()
    (full / "kept").write_text("")
    with pytest.raises(taichi_eye.SceneError, match="not empty"):
        taichi_eye.run(scene, full)
    with pytest.raises(taichi_eye.SceneError, match="nowhere.csv"):
        taichi_eye.run(scene, tmp_path / "new", compare=tmp_path / "nowhere.csv")
    assert names(tmp_path) == {"full"} and names(full) == {"kept"}


def test_readme_names_are_there():
    for name in taichi_eye.__all__:
        assert getattr(taichi_eye, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'simulate'"):
        taichi_eye.simulate  # noqa: B018


def test_a_soft_liquid_is_warned_of_and_a_stiff_one_is_not(tmp_path, result):
    assert result.summary["warnings"] == []
    soft = taichi_eye.load_scene(
        None,
        ["numerics.spacing_mm=0.3", "numerics.sound_speed_m_s=5", "numerics.duration_ms=12", "camera.view=scheimpflug"],
    )
    summary = taichi_eye.run(soft, tmp_path / "soft").summary
    assert summary["chamber_volume_error_max"] > 0.01
    assert len(summary["warnings"]) == 1 and "numerics.sound_speed_m_s" in summary["warnings"][0]


def test_runs_in_a_row_share_their_views(tmp_path):
    """Fields are never given back, and so many may be made: a view for every run would end a long row of them."""
    program, made = ti.lang.impl.get_runtime().prog, []
    for k in range(4):
        scene = taichi_eye.load_scene(
            None,
            [
                "numerics.fidelity=cavity",
                "numerics.spacing_mm=0.4",
                "numerics.duration_ms=0.5",
                f"eye.iop_mmhg={12 + k}",
                f"puff.peak_kpa={5 + k}",
                f"camera.seed={k}",
                f"cornea.limbus_thickness_mm={0.55 + 0.02 * k}",
            ],
        )
        taichi_eye.run(scene, tmp_path / str(k))
        made.append(program.get_snode_tree_size())
    assert made[3] == made[1]


def test_a_view_used_again_draws_what_a_new_one_draws(tmp_path):
    films = []
    for k, words in enumerate((["puff.peak_kpa=6", "eye.iop_mmhg=20"], ["numerics.spacing_mm=0.4"], [])):
        scene = taichi_eye.load_scene(None, TINY + ["output.png_frames=true", "camera.seed=5", *words])
        taichi_eye.run(scene, tmp_path / str(k))
        films.append(sorted((tmp_path / str(k) / "frames").iterdir()))
    simulation = taichi_eye.Simulation(scene)
    view, images = FilmView(scene), []

    def draw(eye, frame):
        recording = Recording(tmp_path, tmp_path, scene, eye)
        recording.__dict__["view"] = view
        images.append(Moment(recording, frame).image)

    simulation.run(draw)
    assert len(images) == len(films[2]) == 8
    for image, path in zip(images, films[2]):
        with Image.open(path) as written:
            np.testing.assert_array_equal(np.asarray(written), image)


def test_a_missing_encoder_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "no-such-program"))
    with pytest.raises(taichi_eye.SceneError, match="no-such-program"):
        taichi_eye.run(taichi_eye.load_scene(None, TINY), tmp_path / "run")
    assert names(tmp_path) == set()


def test_an_encoder_that_fails_loses_nothing_else(tmp_path, monkeypatch):
    script = tmp_path / "ffmpeg"
    script.write_text("#!/bin/sh\necho cannot encode today >&2\nexit 3\n")
    script.chmod(0o755)
    scene = taichi_eye.load_scene(None, TINY + ["camera.view=scheimpflug"])
    with monkeypatch.context() as patch:
        patch.setenv("IMAGEIO_FFMPEG_EXE", str(script))
        with pytest.raises(OutputError, match=r"(?s)cannot encode today.*traces\.csv.*--resume"):
            taichi_eye.run(scene, tmp_path / "run")
    assert {"traces.csv", "wall.npz", "summary.json", "scene.toml", "report.html"} <= names(tmp_path / "run")
    assert len(read_traces(tmp_path / "run" / "traces.csv")["time_ms"]) > 1
    taichi_eye.resume(tmp_path / "run")
    assert names(tmp_path / "run") == ALWAYS and film_frames(tmp_path / "run" / "film.mp4") == 8


def test_a_folder_named_like_an_option_is_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = taichi_eye.load_scene(None, TINY + ["camera.view=scheimpflug", "numerics.fidelity=cavity"])
    taichi_eye.run(scene, "-x")
    assert names(tmp_path / "-x") == ALWAYS


def test_an_eye_shows_the_frame_that_its_film_has(tmp_path):
    words = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.4", "numerics.duration_ms=0.8", "camera.view=both"]
    scene = taichi_eye.load_scene(None, [*words, "output.png_frames=true", "puff.duration_ms=1"])
    taichi_eye.run(scene, tmp_path / "run")
    film = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "run" / "frames").iterdir())]
    eye = taichi_eye.simulation_of(scene)
    np.testing.assert_array_equal(eye.frame(), film[0])
    images = []
    traces = eye.run(lambda eye, _: images.append(eye.frame()))
    np.testing.assert_array_equal(np.array(images), np.array(film))
    again = taichi_eye.simulation_of(scene)
    again.run()
    np.testing.assert_array_equal(again.frame(), film[-1])
    assert len(again.traces["time_ms"]) == len(traces["time_ms"]) and (film[-1] != film[0]).any()
