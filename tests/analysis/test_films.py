"""Edges and parameters read back from rendered frames, whole and damaged, against the walls they were rendered from."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taichi_eye.analysis import analyze, curves_from_edges, curves_from_wall, find_edges, histories, read_film, respond
from taichi_eye.analysis.curves import Instrument
from taichi_eye.analysis.stamps import read_stamps
from taichi_eye.errors import FilmError
from taichi_eye.film import FilmWriter, frame_name

sys.path.insert(0, str(Path(__file__).parent))
import eyes  # noqa: E402

TIMES = 0.2315 * np.arange(0, 138, 2)  # every other frame keeps these tests short


def jpeg(frame, quality):
    held = io.BytesIO()
    Image.fromarray(frame).save(held, "JPEG", quality=quality)
    return np.asarray(Image.open(held))


@pytest.fixture(scope="module")
def frames():
    return eyes.film(TIMES)


@pytest.fixture(scope="module")
def true():
    walls = np.stack([eyes.wall_mm(time) for time in TIMES])
    return curves_from_wall(TIMES, np.tile(eyes.R_MM, (len(TIMES), 1)), walls)


def close(measured, true, length_mm=0.01, time_ms=0.12, share=0.03):
    assert measured.deformation_amplitude_mm == pytest.approx(true.deformation_amplitude_mm, abs=length_mm)
    for name in ("a1_time_ms", "hc_time_ms", "a2_time_ms"):
        assert getattr(measured, name) == pytest.approx(getattr(true, name), abs=time_ms), name
    for name in ("hc_radius_mm", "peak_distance_mm", "da_ratio_2mm", "hc_deflection_area_mm2", "a1_velocity_m_s"):
        assert getattr(measured, name) == pytest.approx(getattr(true, name), rel=share), name


def test_edges_lie_on_the_surface_to_a_fraction_of_a_pixel(frames):
    edges = find_edges(frames)
    middle = np.abs(np.arange(576) - 288) * 0.015625 <= 3.5
    error = (edges.anterior - eyes.rows_px(TIMES))[:, middle]
    assert np.sqrt(np.mean(error**2)) < 0.25
    assert (np.abs(error) <= 1.5).mean() >= 0.999


def test_parameters_and_thickness_of_a_clean_film(frames, true):
    curves = curves_from_edges(find_edges(frames), TIMES, Instrument())
    close(respond(curves), respond(true))
    assert np.sqrt(np.mean((histories(curves).apex_mm - eyes.dent_mm(TIMES) * 0.9975) ** 2)) < 6e-3
    assert curves.axis_column_px == pytest.approx(288.0, abs=0.5) and abs(curves.tilt_deg) < 0.2
    assert np.nanmean(curves.thickness_mm) == pytest.approx(0.55, abs=6e-3)
    assert np.nanmax(np.abs(curves.thickness_mm - np.nanmean(curves.thickness_mm))) < 0.010


def test_a_film_off_centre_compressed_with_a_logo_and_frames_missing(true):
    frames = eyes.film(TIMES, ["camera.apex_column_px=318"])
    keep = np.sort(np.random.default_rng(1).choice(len(TIMES), 62, replace=False))
    logo = np.kron(np.random.default_rng(2).random((6, 22)) > 0.5, np.ones((5, 5)))
    damaged = []
    for k in keep:
        frame = frames[k].copy()
        frame[165:195, 6:116] = np.maximum(frame[165:195, 6:116], (235 * logo).astype(np.uint8))
        damaged.append(jpeg(frame, 40))
    times = read_stamps(np.stack(damaged), 0.2315)
    known = np.isfinite(times)
    assert known.mean() > 0.6 and np.abs(times - TIMES[keep])[known].max() < 0.006
    curves = curves_from_edges(find_edges(np.stack(damaged)[known]), times[known], Instrument())
    assert curves.axis_column_px == pytest.approx(318.0, abs=1.0)
    close(respond(curves), respond(true), length_mm=0.02, time_ms=0.25, share=0.06)


def test_a_cornea_cut_by_the_top_is_bridged(frames, true):
    cut = np.concatenate([frames[:, 24:], frames[:, :24] // 4], axis=1)  # the apex 8 px over the frame at rest
    curves = curves_from_edges(find_edges(cut), TIMES, Instrument())
    assert any("cut" in note for note in curves.notes)
    assert respond(curves).deformation_amplitude_mm == pytest.approx(1.0, abs=0.03)


def test_folders_take_their_times_from_names(frames, tmp_path):
    keep = [k for k in range(len(TIMES)) if k % 7]
    for k in keep:
        Image.fromarray(frames[k]).save(tmp_path / frame_name(2 * k, TIMES[k]))
    film = read_film(tmp_path)
    assert film.timed_by == "file names" and film.time_ms == pytest.approx(TIMES[keep], abs=0.0051)
    assert np.array_equal(film.frames[0], frames[1])


@pytest.fixture(scope="module")
def movie(frames, tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "eye.mp4"
    with FilmWriter(path, 25) as film:
        for frame in frames:
            film.write(frame)
    return path


def test_a_film_file_from_the_command_line(movie, true, tmp_path):
    command = [
        sys.executable,
        "-m",
        "taichi_eye",
        "analyze",
        str(movie),
        "--out",
        str(tmp_path / "out"),
        "--biop-mmhg",
        "15",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "deformation_amplitude_mm" in done.stdout and "stamps in the frames" in done.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "parameters.csv",
        "parameters.json",
        "report.html",
        "histories.csv",
        "edges.npz",
        "overlay.mp4",
        "analysis.png",
    }


def test_a_film_from_python_leaves_no_files(movie, true):
    result = analyze(movie, write=False)
    close(result.response, respond(true))
    assert result.folder is None and result.true_response is None


def noise_film(folder, count=12, shape=(200, 576)):
    draw = np.random.default_rng(0)
    for k in range(count):
        Image.fromarray(draw.integers(0, 20, shape).astype(np.uint8)).save(folder / f"{k:03d}.png")


def test_what_cannot_be_read_is_said_plainly(tmp_path):
    with pytest.raises(FilmError, match="no such file"):
        read_film(tmp_path / "none.mp4")
    (tmp_path / "bad.mp4").write_bytes(b"no film at all")
    with pytest.raises(FilmError, match="not a film"):
        read_film(tmp_path / "bad.mp4")
    (tmp_path / "few").mkdir()
    noise_film(tmp_path / "few", 3)
    with pytest.raises(FilmError, match="3 images"):
        read_film(tmp_path / "few")
    (tmp_path / "dark").mkdir()
    noise_film(tmp_path / "dark")
    with pytest.raises(FilmError, match="corneal section"):
        analyze(tmp_path / "dark", write=False)
    (tmp_path / "square").mkdir()
    noise_film(tmp_path / "square", shape=(256, 256))
    with pytest.raises(FilmError, match="--pixel-x-mm"):
        read_film(tmp_path / "square")
