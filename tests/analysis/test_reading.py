"""What may be brought as a film: frames, order, times and scale of it, or one line that says why not."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from taichi_eye.analysis import read_film
from taichi_eye.analysis.times import repeats
from taichi_eye.errors import FilmError
from taichi_eye.film import FilmWriter
from taichi_eye.proof.films.made_up import stamped

COUNT = 24
TIMES = 0.2315 * np.arange(COUNT)


def noisy(count=COUNT, seed=0):
    """Frames that differ by their noise, and by a bright block that moves on by one column a frame."""
    random = np.random.default_rng(seed)
    frames = np.clip(10.0 + 4.0 * random.standard_normal((count, 200, 576)), 0, 255).astype(np.uint8)
    for k in range(count):
        frames[k, 40:80, 10 * k : 10 * k + 20] = 90
    return frames


def save(folder: Path, frames, names=None, suffix=".png"):
    folder.mkdir(exist_ok=True)
    for k, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{names[k] if names else f'{k:03d}'}{suffix}")
    return folder


def first_columns(frames):
    """Where the block of each frame begins: its number, times ten."""
    return (frames[:, 60, :] > 60).argmax(axis=1)


def said(film, part):
    return any(part in note for note in film.notes)


@pytest.fixture
def stamps():
    frames = noisy()
    stamped(frames, TIMES)
    return frames


@pytest.mark.parametrize("at", [0, 9, COUNT - 1])
def test_a_frame_that_stands_twice_is_one(tmp_path, stamps, at):
    film = read_film(save(tmp_path / "f", np.concatenate([stamps[: at + 1], stamps[at:]])))
    assert film.timed_by == "stamps in the frames" and film.time_ms == pytest.approx(TIMES)
    assert np.array_equal(film.frames, stamps) and said(film, "1 frames that repeat")


def test_a_bad_stamp_costs_at_most_its_frame(tmp_path, stamps):
    stamps[7, 170:, 480:] = 0
    stamped(stamps[7:8], [29.17])
    film = read_film(save(tmp_path / "f", stamps))
    assert len(film.frames) >= COUNT - 1
    assert first_columns(film.frames) * 0.1 * 0.2315 == pytest.approx(film.time_ms)


@pytest.mark.parametrize("order", [np.arange(COUNT)[::-1], np.random.default_rng(3).permutation(COUNT)])
def test_stamps_put_frames_in_order(tmp_path, stamps, order):
    film = read_film(save(tmp_path / "f", stamps[order]))
    assert said(film, "put in order") and len(film.frames) > 0.8 * COUNT
    assert first_columns(film.frames) * 0.1 * 0.2315 == pytest.approx(film.time_ms)


@pytest.mark.parametrize("mark", [" (1)", " copy", "(2)"])
def test_copies_of_files_are_no_frames(tmp_path, mark):
    frames = noisy()
    names = [f"{k:03d}" for k in range(COUNT)] + [f"{k:03d}{mark}" for k in (0, 1, 2, 11)]
    film = read_film(save(tmp_path / "f", np.concatenate([frames, frames[[0, 1, 2, 11]]]), names))
    assert np.array_equal(film.frames, frames) and film.time_ms == pytest.approx(TIMES)
    assert said(film, "4 frames that repeat")


@pytest.mark.parametrize(
    "name",
    [
        lambda k: f"cam_{k + 100}",
        lambda k: f"cam ({k + 1})",
        lambda k: f"t_{round(231.5 * k):06d}",
        lambda k: f"{10**15 + 231500 * k}",
        lambda k: f"t_{240 + 0.0002315 * k:.7f}",
        lambda k: f"t_{240 + 0.0002315 * k:.7f}s",
        lambda k: f"t{231.5 * k:.1f}us",
        lambda k: f"{240000 + 0.2315 * k:.4f}ms",
        lambda k: f"20240611_{k:03d}",
    ],
)
def test_numbers_in_names_count_from_the_smallest_in_units_recognised(tmp_path, name):
    film = read_film(save(tmp_path / "f", noisy(), [name(k) for k in range(COUNT)]))
    assert film.time_ms == pytest.approx(TIMES, abs=1e-3) and len(film.frames) == COUNT


@pytest.mark.parametrize(
    "name", [lambda k: f"img_{20240611093012 + 7 * k}", lambda k: f"{25 * k}", lambda k: f"{9 * k}ms"]
)
def test_numbers_that_are_no_times_are_refused(tmp_path, name):
    with pytest.raises(FilmError, match="frame numbers|200 ms"):
        read_film(save(tmp_path / "f", noisy(), [name(k) for k in range(COUNT)]))


def test_a_film_without_noise_has_no_repeats():
    still = np.zeros((12, 200, 576), np.uint8)
    still[6:, 50:60] = 100
    assert not repeats(still).any()
    assert repeats(noisy()[[0, 0, 1, 2, 3, 3, 3, 4]]).tolist() == [False, True] + 3 * [False] + [True, True, False]


def test_a_variable_rate_repeats_no_frame_and_drops_none(tmp_path, stamps):
    import subprocess

    import imageio_ffmpeg

    with FilmWriter(tmp_path / "a.mp4", 25) as film:
        for frame in stamps:
            film.write(frame)
    # every third frame is shown for twice as long
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", str(tmp_path / "a.mp4")]
    command += [
        "-vf",
        "setpts=(N+floor(N/3))/(25*TB)",
        "-fps_mode",
        "passthrough",
        "-crf",
        "15",
        str(tmp_path / "b.mp4"),
    ]
    subprocess.run(command, check=True)
    film = read_film(tmp_path / "b.mp4")
    assert len(film.frames) == COUNT and film.time_ms == pytest.approx(TIMES)


@pytest.mark.parametrize("times", [4, 16, 257])
def test_images_of_sixteen_bits_keep_their_levels(tmp_path, times):
    frames = noisy()
    frames[0, 0, 0] = 230
    film = read_film(save(tmp_path / "f", frames.astype(np.uint16) * times))
    assert np.abs(film.frames.astype(int) - frames).max() <= 1


@pytest.mark.parametrize("white", [1.0, 255.0, 65535.0])
def test_images_of_floats_are_scaled_by_their_range(tmp_path, white):
    frames = noisy()
    frames[0, 0, 0] = 230
    film = read_film(save(tmp_path / "f", (frames * (white / 255.0)).astype(np.float32), suffix=".tif"))
    assert np.abs(film.frames.astype(int) - frames).max() <= 1


@pytest.mark.parametrize("share", [0.5, 1.25, 1.5, 2.0])
def test_copies_of_another_size_are_brought_to_the_instruments_scale(tmp_path, share):
    frames = [np.asarray(Image.fromarray(f).resize((round(576 * share), round(200 * share)))) for f in noisy()]
    film = read_film(save(tmp_path / "f", frames))
    assert film.frames.shape[1:] == (200, 576) and said(film, "resampled")
    assert film.instrument.pixel_x_mm == pytest.approx(0.015625) and film.instrument.pixel_y_mm == pytest.approx(0.0165)
    assert first_columns(film.frames) == pytest.approx(10 * np.arange(COUNT), abs=2)


def test_a_padded_frame_is_not_scaled(tmp_path):
    film = read_film(save(tmp_path / "f", np.pad(noisy(), ((0, 0), (1, 1), (1, 1)))))
    assert film.frames.shape[1:] == (202, 578) and film.instrument.pixel_x_mm == 0.015625 and said(film, "padded")


def test_a_given_pixel_is_the_scale(tmp_path):
    frames = [np.asarray(Image.fromarray(f).resize((288, 200))) for f in noisy()]
    film = read_film(save(tmp_path / "f", frames), pixel_x_mm=0.03125, pixel_y_mm=0.0165)
    assert film.frames.shape[1:] == (200, 576) and film.instrument.pixel_x_mm == pytest.approx(0.015625)


def test_orientation_in_the_images_own_metadata_is_honoured(tmp_path):
    frames = noisy()
    (tmp_path / "f").mkdir()
    for k, frame in enumerate(frames):
        exif = Image.Exif()
        exif[0x0112] = 3
        Image.fromarray(frame[::-1, ::-1]).save(tmp_path / "f" / f"{k:03d}.png", exif=exif)
    assert np.array_equal(read_film(tmp_path / "f").frames, frames)


def test_what_is_no_frame_is_skipped_with_a_word(tmp_path):
    folder = save(tmp_path / "f", noisy())
    (folder / "._000.png").write_bytes(b"resource fork")
    Image.fromarray(noisy(1)[0]).resize((144, 50)).save(folder / "thumb.png")
    (folder / "notes.txt").write_text("no image")
    film = read_film(folder)
    assert len(film.frames) == COUNT and said(film, "1 hidden files") and said(film, "thumb.png")


def test_one_file_of_many_pages_and_webp_are_films(tmp_path):
    frames = noisy()
    pages = [Image.fromarray(frame) for frame in frames]
    pages[0].save(tmp_path / "eye.tiff", save_all=True, append_images=pages[1:])
    assert np.array_equal(read_film(tmp_path / "eye.tiff").frames, frames)
    assert len(read_film(save(tmp_path / "w", frames, suffix=".webp")).frames) == COUNT


def bomb(path: Path):
    info = PngImagePlugin.PngInfo()
    info.add_text("comment", "a" * 3_000_000, zip=True)
    Image.fromarray(noisy(1)[0]).save(path, pnginfo=info)


@pytest.mark.parametrize(
    "harm, part",
    [
        (lambda folder: os.mkfifo(folder / "x.png"), "x.png: is a pipe"),
        (lambda folder: bomb(folder / "x.png"), "x.png"),
        (lambda folder: (folder / "003.png").write_bytes((folder / "003.png").read_bytes()[:3000]), "003.png"),
        (lambda folder: (folder / "004.png").write_bytes(b"GIF89a"), "004.png"),
        (lambda folder: Image.new("1", (5000, 4000)).save(folder / "x.png"), "x.png: 5000 x 4000 px"),
    ],
)
def test_damaged_images_are_refused_by_name(tmp_path, harm, part):
    folder = save(tmp_path / "f", noisy())
    harm(folder)
    with pytest.raises(FilmError, match=part) as caught:
        read_film(folder)
    assert len(str(caught.value).splitlines()) == 1


def test_names_of_files_that_are_no_numbers_to_python(tmp_path):
    film = read_film(save(tmp_path / "f", noisy(), [f"\u00b2{k:03d}" for k in range(COUNT)]))
    assert film.time_ms == pytest.approx(TIMES)


def test_what_cannot_be_opened_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "exam.cst").write_bytes(b"anything")
    for path, part in (
        (tmp_path / "pipe.mp4", "pipe"),
        (tmp_path / "exam.cst", "export"),
        (Path("x" * 5000 + ".mp4"), "too long"),
        (Path("a\0b"), "cannot be opened"),
    ):
        with pytest.raises(FilmError, match=part) as caught:
            read_film(path)
        assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "option, value",
    [
        ("pixel_x_mm", 1e-300),
        ("pixel_y_mm", 3.0),
        ("frame_interval_ms", 1e-6),
        ("frame_interval_ms", 720.0),
        ("frame_interval_ms", 999999.0),
        ("refractive_index", 1e-300),
        ("angle_deg", float("nan")),
    ],
)
def test_options_have_bounds(tmp_path, option, value):
    with pytest.raises(FilmError, match=f"{option} = .*allowed is"):
        read_film(save(tmp_path / "f", noisy(9)), **{option: value})


def test_pictures_in_colours_are_no_slit_frames(tmp_path):
    frames = np.repeat(noisy()[..., None], 3, axis=3)
    frames[:, 100:, :200, 0] = 250
    frames[:, 100:, 300:, 2] = 250
    with pytest.raises(FilmError, match="analyse the run folder"):
        read_film(save(tmp_path / "f", frames))
    with FilmWriter(tmp_path / "a.mp4", 25) as film:
        for frame in frames:
            film.write(frame)
    with pytest.raises(FilmError, match="analyse the run folder"):
        read_film(tmp_path / "a.mp4")


def test_size_and_number_are_refused_from_headers(tmp_path, monkeypatch):
    from taichi_eye.analysis import decode

    folder = save(tmp_path / "f", noisy(9))
    monkeypatch.setattr(decode, "_upright", lambda *a: pytest.fail("a picture was decoded"))
    monkeypatch.setattr(decode, "ALL_PIXELS_MAX", 1_000_000)
    with pytest.raises(FilmError, match="9 frames of 576 x 200 px"):
        read_film(folder)
    monkeypatch.setattr(decode, "FRAMES_MAX", 8)
    with pytest.raises(FilmError, match="at most 8"):
        read_film(folder)


@pytest.mark.parametrize("angle", [180, 90])
def test_a_films_own_orientation_is_honoured(tmp_path, angle):
    import subprocess

    import imageio_ffmpeg

    frames = noisy()
    with FilmWriter(tmp_path / "stored.mp4", 25) as film:
        for frame in frames:
            film.write(np.ascontiguousarray(np.rot90(frame, -angle // 90)))
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-display_rotation", str(angle)]
    subprocess.run([*command, "-i", tmp_path / "stored.mp4", "-c", "copy", tmp_path / "turned.mp4"], check=True)
    film = read_film(tmp_path / "turned.mp4")
    assert film.frames.shape == frames.shape
    assert first_columns(film.frames) == pytest.approx(10 * np.arange(COUNT), abs=1)
