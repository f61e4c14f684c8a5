"""The plots, as pictures: size, and that what should be drawn is."""

import imageio.v3 as iio
import numpy as np
import pytest

from taichi_eye.report.compare import Measured
from taichi_eye.report.history import History, summarise
from taichi_eye.report.plots import plot_apex, plot_sheet, sheet_times

T = np.linspace(0, 32, 200)
HUMP = 0.959 * np.exp(-0.5 * ((T - 14.8) / 4.7) ** 2)
PUFF = 10 * np.exp(-0.5 * ((T - 15) / 4.243) ** 2)


def draw(tmp_path, measured=None, until=None, apex=HUMP, load=PUFF):
    path = tmp_path / "apex.png"
    traces = {"time_ms": T, "apex_displacement_mm": apex, "puff_apex_kpa": load}
    plot_apex(path, {name: column[:until] for name, column in traces.items()}, measured)
    assert [entry.name for entry in tmp_path.iterdir()] == ["apex.png"]
    return iio.imread(path)[..., :3].astype(int)


def count(image, colour):
    return int((np.abs(image - colour).max(axis=2) < 24).sum())


APEX, LOAD, MEASURED = (0x14, 0x53, 0x9A), (0xC9, 0x64, 0x1A), (0x3D, 0x8B, 0x57)


def test_apex_plot_shows_history_and_load(tmp_path):
    image = draw(tmp_path)
    assert image.shape == (810, 1350, 3)
    assert count(image, APEX) > 2000 and count(image, LOAD) > 1000 and count(image, MEASURED) == 0


def test_apex_plot_with_a_measured_history(tmp_path):
    measured = Measured("a $1 eye_with_a_very_long_name_that_goes_on.csv", "deflection_mm", T[::2], 1.3 * HUMP[::2])
    assert count(draw(tmp_path, measured), MEASURED) > 1000


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("until", [1, 2, 60, 100, 140])
def test_interrupted_run_is_drawn(tmp_path, until):
    assert draw(tmp_path, until=until).shape == (810, 1350, 3)


@pytest.mark.filterwarnings("error")
def test_eye_at_rest_and_eye_pulled_out_are_drawn(tmp_path):
    draw(tmp_path, apex=0 * T, load=0 * T)
    draw(tmp_path, apex=-HUMP)


def test_same_data_same_file(tmp_path):
    draw(tmp_path)
    first = (tmp_path / "apex.png").read_bytes()
    draw(tmp_path)
    assert (tmp_path / "apex.png").read_bytes() == first


def test_sheet_shows_every_frame_pixel_by_pixel(tmp_path):
    rng = np.random.default_rng(2)
    frames = [(9.5 * i, rng.integers(0, 256, (200, 576), dtype=np.uint8)) for i in range(6)]
    plot_sheet(tmp_path / "sheet.png", frames)
    sheet = iio.imread(tmp_path / "sheet.png")
    for i, (_, image) in enumerate(frames):
        top, left = 36 + i // 2 * (200 + 36), 14 + i % 2 * (576 + 14)
        for channel in range(3):
            np.testing.assert_array_equal(sheet[top : top + 200, left : left + 576, channel], image)


def test_sheet_of_square_colour_frames_has_three_columns(tmp_path):
    frames = [(float(i), np.tile(np.uint8([250, 40 * i, 7]), (60, 60, 1))) for i in range(6)]
    plot_sheet(tmp_path / "sheet.png", frames)
    sheet = iio.imread(tmp_path / "sheet.png")[..., :3].astype(int)
    top = [np.argwhere(np.abs(sheet - (250, 40 * i, 7)).max(axis=2) == 0)[0] for i in range(6)]
    assert top[0][0] == top[1][0] == top[2][0] < top[3][0] == top[4][0] == top[5][0]


def test_wide_frames_are_scaled_to_fit(tmp_path):
    plot_sheet(tmp_path / "sheet.png", [(0.0, np.zeros((400, 1600, 3), np.uint8))] * 6)
    assert iio.imread(tmp_path / "sheet.png").shape[1] == 2 * 800 + 3 * 14


def test_sheet_times():
    assert sheet_times(History(1.0, 15.0, 9.0, 21.0), 32.0) == [0, 9, 12, 15, 21, 32]
    assert sheet_times(summarise(T, 0 * T), 30.0) == [0, 6, 12, 18, 24, 30]
