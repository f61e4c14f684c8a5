"""The particle view: where discs stand, how values become colours, and the frames made of both views."""

import matplotlib
import numpy as np
import pytest

from taichi_eye.eye.eye import eye_of
from taichi_eye.film import FilmView, Particles
from taichi_eye.film.glyphs import GlyphAtlas, stamp
from taichi_eye.film.particles import DARKEST, Layout, plot_ranges, tick_step


@pytest.fixture(scope="module")
def eye(synthetic_eye):
    eye = synthetic_eye(["numerics.spacing_mm=0.3"])
    eye.view = Particles(eye.scene, stamped=False)
    eye.back_z_mm = eye_of(eye.scene).section.back_z * 1e3
    return eye


def disc_cover(eye, points_mm, pressure=4500.0):
    """How much brighter the image gets by these nodes."""
    eye.set_nodes([[3.0, 0.3]], 0.0)
    eye.state.node_count = 0
    without = eye.view.render(eye.state).astype(float)
    eye.set_nodes(points_mm, pressure)
    return eye.view.render(eye.state).astype(float) - without


@pytest.mark.parametrize("r, z", [(1.0, 1.0), (2.513, 0.777), (4.0, 0.61)])
def test_a_disc_stands_at_its_node_and_mirrored(eye, r, z):
    at = Layout.of(eye.scene)
    change = np.abs(disc_cover(eye, [[r, z]])).sum(axis=2)
    columns, rows = np.arange(at.width) + 0.5, np.arange(at.height) + 0.5
    right, left = change.copy(), change.copy()
    right[:, : at.axis] = left[:, at.axis :] = 0.0
    for side, sign in ((right, 1.0), (left, -1.0)):
        column, row = side.sum(axis=0) @ columns / side.sum(), side.sum(axis=1) @ rows / side.sum()
        assert column == pytest.approx(at.axis + sign * r * at.scale, abs=0.15)
        assert row == pytest.approx(at.limbus_row - z * at.scale, abs=0.15)
    assert np.array_equal(change[:, at.axis : at.axis + at.half], change[:, at.axis - at.half : at.axis][:, ::-1])


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6, 1.0])
def test_pressure_becomes_the_colour_of_the_scale(synthetic_eye, share):
    eye = synthetic_eye(["numerics.spacing_mm=0.3", "camera.colour_by=pressure"])
    view = Particles(eye.scene)
    low, high = view.limits
    assert low == 0.0 and high == pytest.approx(2500.0, rel=1e-4)
    eye.set_nodes([[2.0, 0.8]], low + share * (high - low))
    at = view.layout
    pixel = view.render(eye.state)[int(at.limbus_row - 0.8 * at.scale), int(at.axis + 2.0 * at.scale)]
    expected = 255.0 * np.array(matplotlib.colormaps["viridis"](DARKEST + (1.0 - DARKEST) * share)[:3])
    assert np.abs(pixel - expected).max() <= 2.5


def test_speed_becomes_the_colour_of_its_own_scale(synthetic_eye):
    eye = synthetic_eye(["numerics.spacing_mm=0.3", "camera.colour_by=speed"])
    view = Particles(eye.scene)
    assert view.limits == pytest.approx((0.0, 0.18), rel=1e-4)
    eye.set_nodes([[2.0, 0.8]], 9e9, speed_m_s=-0.09)
    at = view.layout
    pixel = view.render(eye.state)[int(at.limbus_row - 0.8 * at.scale), int(at.axis + 2.0 * at.scale)]
    expected = 255.0 * np.array(matplotlib.colormaps["plasma"](DARKEST + (1.0 - DARKEST) * 0.5)[:3])
    assert np.abs(pixel - expected).max() <= 2.5


def test_membrane_is_drawn_along_the_wall(eye):
    profile = eye.dented(0.8)
    eye.set_wall(profile)
    eye.state.node_count = 0
    image, at = eye.view.render(eye.state).astype(float), eye.view.layout
    rows = np.arange(at.height) + 0.5
    for r in (0.0, 1.2, 2.5, 4.0):
        column = int(at.axis + r * at.scale)
        bright = np.where(image[:, column, 0] > 30.0, image[:, column, 0], 0.0)
        bright[int(at.limbus_row) - 5 :] = 0.0
        expected = at.limbus_row - profile((column + 0.5 - at.axis) / at.scale) * at.scale
        assert (bright @ rows) / bright.sum() == pytest.approx(expected, abs=0.2)
    eye.set_wall(eye.sphere())


def test_puff_follows_the_load(eye):
    at, glow = eye.view.layout, []
    for load in (0.0, 5.0, 10.0):
        eye.state.trace_time_ms, eye.state.trace_apex_mm = np.array([0.0, 1.0]), np.array([0.0, 0.0])
        eye.state.trace_puff_kpa = np.array([0.0, load])
        image = eye.view.render(eye.state).astype(float)
        glow.append(image[10:40, at.axis - 4 : at.axis + 4, 2].mean())
    assert glow[1] - glow[0] == pytest.approx(glow[2] - glow[1], rel=0.05) and glow[1] > glow[0] + 20.0
    # a load whose centre is off the axis shows there
    eye.state.puff_radial = np.exp(-(((eye.r - 3.0) / 0.5) ** 2))
    image = eye.view.render(eye.state).astype(float)
    eye.state.puff_radial = None
    assert image[20, int(at.axis + 3.0 * at.scale), 2] > image[20, at.axis, 2] + 40.0


def test_trace_grows_to_the_present_value(eye):
    left, top, right, bottom = eye.view.layout.plot
    ranges = plot_ranges(eye.scene)
    time = np.linspace(0.0, 16.0, 200)
    eye.state.trace_time_ms, eye.state.trace_apex_mm = time, 0.06 * time
    eye.state.trace_puff_kpa = 0.0 * time
    image = eye.view.render(eye.state).astype(int)
    orange = (image[:, :, 0] - image[:, :, 2] > 80)[top : bottom + 1, left : right + 1]
    head = 16.0 / ranges.time_ms * (right - left)
    assert not orange[:, int(head) + 8 :].any() and orange[:, : int(head)].any(axis=0).all()
    k = int(head / 2)
    value = 0.06 * k / (right - left) * ranges.time_ms
    share = (value - ranges.apex_low_mm) / (ranges.apex_high_mm - ranges.apex_low_mm)
    assert np.flatnonzero(orange[:, k]).mean() == pytest.approx((bottom - top) * (1.0 - share), abs=1.0)


def test_the_expected_peak_fits_the_axes(synthetic_eye):
    for overrides, peak in (
        ([], 0.959),
        (["eye.iop_mmhg=10"], 1.156),
        (["eye.iop_mmhg=30"], 0.579),
        (["puff.peak_kpa=5"], 0.581),
        (["puff.peak_kpa=15"], 1.172),
    ):
        ranges = plot_ranges(synthetic_eye(overrides).scene)
        assert 1.05 * peak < ranges.apex_high_mm < 2.2 * peak


def test_liquid_stays_over_the_back(eye):
    at = eye.view.layout
    back = at.limbus_row - eye.back_z_mm * at.scale
    change = np.abs(disc_cover(eye, [[r, eye.back_z_mm] for r in (0.5, 2.0, 5.5)])).sum(axis=2)
    assert change[: int(back)].any() and not change[int(back) + 2 :].any()


def test_a_frame_keeps_nothing_of_the_one_before(eye):
    eye.set_nodes([[1.0, 1.0], [2.0, 0.5]], 2000.0)
    first = eye.view.render(eye.state)
    eye.set_wall(eye.dented(0.9))
    eye.set_nodes([[0.4, 1.2], [3.0, 0.2], [5.0, 0.1]], 500.0)
    eye.view.render(eye.state)
    eye.set_wall(eye.sphere())
    eye.set_nodes([[1.0, 1.0], [2.0, 0.5]], 2000.0)
    assert np.array_equal(eye.view.render(eye.state), first)


@pytest.mark.parametrize(
    "view, shape", [("scheimpflug", (200, 576)), ("particles", (320, 1152, 3)), ("both", (720, 1152, 3))]
)
def test_views_have_their_announced_shape(synthetic_eye, view, shape):
    eye = synthetic_eye([f"camera.view={view}"])
    film = FilmView(eye.scene)
    image = film.render(eye.state)
    assert image.shape == film.shape == shape and image.dtype == np.uint8
    slit = film.scheimpflug_frame(eye.state)
    if view == "both":
        assert np.array_equal(image[:400:2, ::2, 0], slit) and np.array_equal(image[1:400:2, 1::2, 2], slit)


def test_ticks_are_round_numbers():
    steps = [tick_step(v) for v in (0.9, 1.0, 1.1, 2.2, 0.28, 6.0)]
    assert steps == pytest.approx([1.0, 1.0, 2.0, 2.5, 0.3, 10.0])


def test_text_is_cut_at_the_image_edge_and_keeps_its_width():
    atlas = GlyphAtlas(13)
    assert atlas.mask("1.11 ms").shape == atlas.mask("0.48 ms").shape
    image = np.zeros((20, 30), np.uint8)
    stamp(image, np.ones((10, 10), np.float32), -5, 25, 200)
    assert image.sum() == 200 * 25 and (image[:5, 25:] == 200).all()
    stamp(image, np.ones((10, 10), np.float32), 40, 40, 200)
    assert image.sum() == 200 * 25
