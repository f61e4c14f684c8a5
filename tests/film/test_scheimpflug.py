"""The Scheimpflug frame against the geometry, the grey levels and the noise law that it is to have."""

import subprocess
import sys

import numpy as np
import pytest

from taichi_eye.film import Scheimpflug
from taichi_eye.film.noise import gaussian_table

THREADS_SCRIPT = """
import hashlib, sys
from taichi_eye import backend
backend.init("cpu", "f64", threads=int(sys.argv[1]))
sys.path.insert(0, sys.argv[2])
from conftest import SyntheticEye
from taichi_eye.film import FilmView
eye = SyntheticEye()
eye.set_wall(eye.dented(0.7))
eye.set_nodes([[0.1 * k, 0.05 * k] for k in range(20)], 3000.0)
print(hashlib.sha256(FilmView(eye.scene).render(eye.state).tobytes()).hexdigest())
"""


@pytest.fixture(scope="module")
def clean(synthetic_eye):
    eye = synthetic_eye(["camera.noise=false", "camera.stamp=false"])
    eye.view = Scheimpflug(eye.scene)
    return eye


@pytest.fixture(scope="module")
def noisy(synthetic_eye):
    eye = synthetic_eye(["camera.stamp=false"])
    eye.view = Scheimpflug(eye.scene)
    return eye


def rendered(eye, height_mm, time_ms=0.0):
    eye.set_wall(height_mm)
    eye.state.time_ms = time_ms
    return eye.view.render(eye.state)


def rows(eye, z_mm):
    """Image row of a height over the limbus plane."""
    return eye.scene.camera.apex_row_px + (eye.sphere()(0.0) - z_mm) / eye.scene.camera.pixel_y_mm


def crossing(column, level, start, stop):
    """Row, to a fraction, where the grey level first crosses `level` between two rows."""
    part = column[start:stop].astype(float)
    beyond = (part - level) * np.sign(part[0] - level) < 0.0
    k = int(np.argmax(beyond))
    return start + k - 1 + (level - part[k - 1]) / (part[k] - part[k - 1])


@pytest.mark.parametrize("depth", [0.0, 0.5, 1.0])
def test_half_rise_of_the_anterior_line_lies_on_the_surface(clean, depth):
    profile = clean.dented(depth)
    image = rendered(clean, profile)
    camera = clean.scene.camera
    for column in range(8, 570, 6):
        x = abs(column - camera.apex_column_px) * camera.pixel_x_mm
        peak = image[:125, column].max()
        found = crossing(image[:, column], 0.5 * (peak + 6.5), 0, 160)
        assert found == pytest.approx(rows(clean, profile(x)), abs=0.35), column


def test_posterior_edge_lies_where_refraction_puts_it(clean):
    image = rendered(clean, clean.sphere())
    found = crossing(image[:, 288], 0.5 * (46.0 + 7.4), 25, 60)
    assert found == pytest.approx(16.0 + 0.627 * 0.55 / 0.0165, abs=0.3)


def test_grey_levels_and_widths_of_the_instrument(clean):
    image = rendered(clean, clean.sphere()).astype(float)
    centre = image[:, 288]
    assert image[:3, 100].mean() == pytest.approx(6.5, abs=0.5)
    assert image[60:80, 288].mean() == pytest.approx(7.4, abs=0.5)
    assert 80 <= centre.max() <= 90
    assert 55 <= image[:125, 3].max() <= 60 and 55 <= image[:125, 573].max() <= 60
    # the stroma falls from 65 to 46: its linear part, drawn out to both surfaces
    slope, top = np.polyfit(np.arange(8, 15), centre[24:31], 1)
    assert top == pytest.approx(65.0, abs=3.0) and top + 20.9 * slope == pytest.approx(46.0, abs=3.0)
    for off_mm, low, high in ((2.0, 38, 45), (4.0, 30, 34)):
        column = 288 + round(off_mm / 0.015625)
        top = rows(clean, clean.sphere()(off_mm))
        assert low <= image[round(top + 7) : round(top + 16), column].mean() <= high
    assert 20 <= image[140:, :40].max() <= 90  # iris
    rise = crossing(centre, 0.9 * 85.0, 0, 30) - crossing(centre, 6.5 + 0.1 * 79.0, 0, 30)
    assert rise == pytest.approx(5.0, abs=1.0)
    fall = crossing(centre, 7.4 + 0.1 * 38.6, 25, 60) - crossing(centre, 7.4 + 0.9 * 38.6, 27, 60)
    assert 5.5 <= fall <= 7.5


def test_lens_haze_grows_with_the_dent(clean):
    rest = rendered(clean, clean.sphere())[190:, 280:296].mean()
    dented = rendered(clean, clean.dented(1.0))[190:, 280:296].mean()
    assert 15 <= rest < dented <= 26


def test_noise_has_the_measured_variance_and_no_bias(clean, noisy):
    level = rendered(clean, clean.sphere()).astype(float)
    residual = np.stack([rendered(noisy, noisy.sphere(), k * 0.2315) for k in range(10)]) - level
    for low, high in ((6, 9), (12, 20), (25, 35), (38, 45), (46, 56), (75, 90)):
        here = residual[:, (level >= low) & (level <= high)]
        expected = 12.0 + 0.24 * level[(level >= low) & (level <= high)].mean()
        assert here.size > 4000
        assert here.var() == pytest.approx(expected, rel=0.08)
        assert abs(here.mean()) < 0.2


def test_noise_is_white_and_new_in_every_frame(noisy):
    first, second = (rendered(noisy, noisy.sphere(), t)[60:130, 150:420].astype(float) for t in (0.0, 0.2315))
    first, second = first - first.mean(), second - second.mean()
    assert abs((first * second).mean() / first.var()) < 0.03
    assert abs((first[1:] * first[:-1]).mean() / first.var()) < 0.03
    assert abs((first[:, 1:] * first[:, :-1]).mean() / first.var()) < 0.03


def test_noise_table_is_a_standard_normal():
    table = gaussian_table()
    assert table.mean() == pytest.approx(0.0, abs=1e-12)
    assert table.var() == pytest.approx(1.0, rel=1e-12)
    assert (table**4).mean() == pytest.approx(3.0, abs=0.05)


def test_same_state_same_bits_and_another_seed_other_noise(noisy, synthetic_eye):
    first = rendered(noisy, noisy.sphere())
    assert np.array_equal(first, rendered(noisy, noisy.sphere()))
    other = synthetic_eye(["camera.stamp=false", "camera.seed=2"])
    other.view = Scheimpflug(other.scene)
    assert (rendered(other, other.sphere()) != first).mean() > 0.5


def test_bits_do_not_depend_on_the_thread_count(request):
    digests = set()
    for threads in (1, 2):
        command = [sys.executable, "-c", THREADS_SCRIPT, str(threads), str(request.path.parent)]
        run = subprocess.run(command, check=True, capture_output=True, text=True)
        digests.add(run.stdout.split()[-1])
    assert len(digests) == 1 and len(digests.pop()) == 64


def test_a_broken_state_still_draws(clean):
    image = rendered(clean, lambda r: np.nan * r)
    assert image.shape == (200, 576)
