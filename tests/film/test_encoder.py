"""Films, PNG sequences and GIFs read back from disk."""

import json

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_eye.film import EncoderError, FilmWriter, frame_name, shrunk, write_gif
from taichi_eye.film.encoder import GROUP


def ramp(shape, k):
    """A smooth picture that differs from frame to frame."""
    column = np.linspace(20, 200, shape[1])
    image = np.broadcast_to(column + 2 * k, shape[:2])
    if len(shape) == 3:
        image = np.stack([image, image[:, ::-1], 0.5 * image], axis=-1)
    return image.astype(np.uint8)


def read_back(path):
    frames = imageio_ffmpeg.read_frames(str(path))
    meta = next(frames)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in frames]


@pytest.mark.parametrize("shape", [(64, 256), (64, 256, 3)])
def test_grey_levels_survive_the_colour_conversion(tmp_path, shape):
    steps = np.broadcast_to(np.arange(256) // 16 * 16 + 6, (64, 256)).astype(np.uint8)
    frame = steps if len(shape) == 2 else np.repeat(steps[..., None], 3, axis=2)
    with FilmWriter(tmp_path / "film.mp4", fps=25) as film:
        film.write(frame)
    decoded = read_back(tmp_path / "film.mp4")[1][0].astype(int)
    assert np.abs(decoded - steps[..., None])[:, 8::16].max() <= 1


@pytest.mark.parametrize("shape", [(200, 576), (64, 96, 3)])
def test_film_reads_back_as_written(tmp_path, shape):
    with FilmWriter(tmp_path / "film.mp4", fps=25) as film:
        for k in range(12):
            film.write(ramp(shape, k))
    meta, frames = read_back(tmp_path / "film.mp4")
    assert meta["size"] == shape[1::-1] and meta["fps"] == 25 and len(frames) == 12
    assert meta["codec"] == "h264" and meta["pix_fmt"].startswith("yuv420p")
    written = ramp(shape, 7).astype(int)
    difference = np.abs(frames[7].astype(int) - (written[..., None] if written.ndim == 2 else written))
    assert difference.mean() < 3.0
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_index_stands_before_the_pictures(tmp_path):
    with FilmWriter(tmp_path / "film.mp4", fps=25) as film:
        film.write(ramp((64, 64), 0))
    content = (tmp_path / "film.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_odd_sizes_are_padded_not_rescaled(tmp_path):
    with FilmWriter(tmp_path / "odd.mp4", fps=10) as film:
        film.write(ramp((51, 77), 0))
    meta, frames = read_back(tmp_path / "odd.mp4")
    assert meta["size"] == (78, 52)
    assert np.abs(frames[0][:51, :77, 0].astype(int) - ramp((51, 77), 0)).mean() < 3.0


def test_film_of_a_run_that_failed_is_whole(tmp_path):
    with pytest.raises(RuntimeError, match="slack"):
        with FilmWriter(tmp_path / "film.mp4", fps=25) as film:
            for k in range(5):
                assert not (tmp_path / "film.mp4").exists()
                film.write(ramp((64, 64), k))
            raise RuntimeError("slack wall")
    assert len(read_back(tmp_path / "film.mp4")[1]) == 5
    film.close()


def noise(shape, k):
    """A picture that no other resembles: all of it has to be coded."""
    return np.random.default_rng([5, k]).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("cuts", [(GROUP,), (3,), (GROUP - 1, GROUP + 1), (0, 2 * GROUP, 2 * GROUP + 4)])
def test_a_film_that_goes_on_has_the_frames_of_one_that_was_never_held(tmp_path, cuts):
    count, shape = 3 * GROUP + 2, (48, 64)
    with FilmWriter(tmp_path / "whole.mp4", fps=25) as film:
        for k in range(count):
            film.write(noise(shape, k))
    whole = read_back(tmp_path / "whole.mp4")[1]
    work, held, first = tmp_path / "work", None, 0
    work.mkdir()
    for cut in (*cuts, count):
        film = FilmWriter(tmp_path / "held.mp4", 25, work, held)
        for k in range(first, cut):
            film.write(noise(shape, k))
        held, first = json.loads(json.dumps(film.hold())), cut
        assert film.frame_count == cut
        film.close()
        if cut:
            assert len(read_back(tmp_path / "held.mp4")[1]) == cut
        # what a killed process wrote after that
        (work / "held-000099-dead.h264").write_bytes(b"half a frame")
    decoded = read_back(tmp_path / "held.mp4")[1]
    assert len(decoded) == len(whole) == count
    for one, other in zip(decoded, whole):
        np.testing.assert_array_equal(one, other)


def test_holding_between_groups_does_not_end_the_film(tmp_path):
    work = tmp_path / "work"
    work.mkdir()
    with FilmWriter(tmp_path / "film.mp4", 25, work) as film:
        for k in range(2 * GROUP + 1):
            film.write(noise((48, 64), k))
            if film.between_groups:
                assert len(film.hold()["segments"]) == film.frame_count // GROUP
    assert len(read_back(tmp_path / "film.mp4")[1]) == 2 * GROUP + 1


def test_a_name_that_looks_like_an_option_is_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with FilmWriter("-x.mp4", fps=25) as film:
        film.write(ramp((64, 64), 0))
    assert [path.name for path in tmp_path.iterdir()] == ["-x.mp4"]


def test_a_missing_encoder_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "no-such-program"))
    with pytest.raises(EncoderError, match="no-such-program"):
        FilmWriter(tmp_path / "film.mp4", fps=25).write(ramp((64, 64), 0))


def test_names_of_frames_carry_number_and_time():
    assert [frame_name(k, 0.2315 * k) for k in (0, 1, 40)] == [
        "frame_000_00.00ms.png",
        "frame_001_00.23ms.png",
        "frame_040_09.26ms.png",
    ]


def test_a_film_without_frames_leaves_no_file(tmp_path):
    FilmWriter(tmp_path / "film.mp4", fps=25).close()
    assert not list(tmp_path.iterdir())


def test_frames_of_another_shape_or_type_are_refused(tmp_path):
    with FilmWriter(tmp_path / "film.mp4", fps=25) as film:
        film.write(ramp((64, 64), 0))
        with pytest.raises(ValueError, match=r"frame 1 has shape \(64, 66\)"):
            film.write(ramp((64, 66), 0))
        with pytest.raises(ValueError, match="uint8"):
            film.write(np.zeros((64, 64)))
    assert len(read_back(tmp_path / "film.mp4")[1]) == 1


def test_a_missing_folder_is_named_by_the_encoder(tmp_path):
    film = FilmWriter(tmp_path / "nowhere" / "film.mp4", fps=25)
    with pytest.raises(EncoderError, match="nowhere"):
        for k in range(200):
            film.write(ramp((200, 576), k))
        film.close()


def test_gif_loops_at_its_size_and_speed(tmp_path):
    frames = (shrunk(ramp((60, 120, 3), 6 * k), 60) for k in range(8))
    write_gif(frames, tmp_path / "small.gif", fps=20, colours=32)
    with Image.open(tmp_path / "small.gif") as gif:
        assert gif.size == (60, 30) and gif.n_frames == 8
        assert gif.info["loop"] == 0 and gif.info["duration"] == 50
    with pytest.raises(ValueError, match="at least one frame"):
        write_gif([], tmp_path / "none.gif")
    assert [path.name for path in tmp_path.iterdir()] == ["small.gif"]


def test_shrinking_averages_areas():
    frame = np.arange(0, 256, 4, dtype=np.uint8).reshape(4, 16)
    np.testing.assert_array_equal(shrunk(frame, 8), frame.reshape(2, 2, 8, 2).mean((1, 3)))
    assert shrunk(frame, 16) is frame
