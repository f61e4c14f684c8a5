"""Layers of the slit image: each switch, the plain view, thickness profile, specks, retreat, and what lies behind the
cornea."""

import numpy as np
import pytest

from taichi_eye.film import Scheimpflug, Surface
from taichi_eye.film.scheimpflug import SPECK_SHARE

QUIET = ["camera.noise=false", "camera.stamp=false", "camera.specks=false"]


def frame(synthetic_eye, *overrides, dent=0.0, retreat_mm=0.0, time_ms=0.0):
    eye = synthetic_eye([*QUIET, *overrides])
    eye.set_wall(eye.dented(dent))
    eye.state.retreat_mm, eye.state.time_ms = retreat_mm, time_ms
    return Scheimpflug(eye.scene).render(eye.state).astype(float)


def test_each_layer_has_its_switch(synthetic_eye):
    whole = frame(synthetic_eye)
    without = {
        name: frame(synthetic_eye, f"camera.{name}=false")
        for name in ("epithelium", "stroma", "iris", "lens", "fall_off")
    }
    assert whole[14:24, 288].max() - without["epithelium"][14:24, 288].max() > 15
    assert without["stroma"][30, 288] < 10 < whole[30, 288]
    assert without["iris"][170:, :30].max() < 10 < whole[170:, :30].max()
    assert without["lens"][190:, 288].max() < 10 < whole[190:, 288].max()
    assert without["fall_off"][:130, 20].max() > whole[:130, 20].max() + 15
    for name, image in without.items():
        assert image[:10].max() == whole[:10].max(), name


def test_plain_view_is_the_band_between_the_edges(synthetic_eye):
    image = frame(synthetic_eye, "camera.optics=plain")
    # 0.627 of 0.55 mm seen from above the apex at row 16
    assert image[:, 288].sum() / 150.0 == pytest.approx(0.627 * 0.55 / 0.0165, abs=0.05)
    assert image[16, 288] == pytest.approx(75.0, abs=1.0)
    assert set(np.unique(image[100:140, 250:300])) == {0.0}


def test_retreat_moves_the_whole_picture(synthetic_eye):
    still, moved = frame(synthetic_eye), frame(synthetic_eye, retreat_mm=10 * 0.0165)
    assert np.abs(moved[10:] - still[:-10]).max() <= 1.0


def test_rim_is_seen_thicker_where_the_scene_says_so(synthetic_eye):
    def thickness(*overrides):
        eye = synthetic_eye([*QUIET, *overrides])
        surface = Surface(eye.scene)
        surface.update(eye.state.wall, eye.state.wall_count)
        rows = (
            surface.height.to_numpy()[: surface.columns] - surface.apparent.to_numpy()[: surface.columns]
        ) / 0.0165e-3
        return np.interp([0.0, 4.5], np.arange(surface.columns) * surface.spacing * 1e3, rows)

    uniform, profile = thickness(), thickness("cornea.limbus_thickness_mm=0.67")
    assert profile[0] == pytest.approx(uniform[0], abs=0.02)
    assert 25.0 <= profile[1] <= 27.0
    assert profile[1] > uniform[1] + 1.5


def test_specks_are_rare_seeded_and_on_the_line(synthetic_eye):
    eye = synthetic_eye(["camera.noise=false", "camera.stamp=false"])
    view, found = Scheimpflug(eye.scene), []
    for k in range(60):
        eye.state.time_ms = k * 0.2315
        with_specks = view.render(eye.state).astype(float)
        lit = np.argwhere(with_specks > 200)
        if len(lit):
            found.append(k)
            line = 16.0 + (7.8 - np.sqrt(7.8**2 - ((lit[:, 1] - 288) * 0.015625) ** 2)) / 0.0165
            assert np.abs(lit[:, 0] - line).max() < 9.0
            assert with_specks.max() == 255.0 and len(lit) < 60
    assert 1 <= len(found) <= 60 * 3 * SPECK_SHARE


@pytest.mark.parametrize("dent", [0.0, 0.8])
def test_what_lies_behind_is_seen_through_the_surface_of_the_moment(synthetic_eye, dent):
    eye = synthetic_eye(QUIET)
    eye.set_wall(eye.dented(dent))
    surface = Surface(eye.scene)
    surface.update(eye.state.wall, eye.state.wall_count)
    height = eye.dented(dent)

    def slope(r):
        return (height(r + 1e-5) - height(r - 1e-5)) / 2e-5

    for x in (0.0, 1.5, 3.0):
        for y in (1.2, 1.9):
            rho = np.hypot(x, y)
            normal = np.array([-slope(rho) * x / rho, -slope(rho) * y / rho, 1.0])
            normal /= np.linalg.norm(normal)
            air = -np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)
            facing = -normal @ air
            bent = air / 1.376 + (facing / 1.376 - np.sqrt(1.0 - (1.0 - facing**2) / 1.376**2)) * normal
            entry = np.array([x, y, height(rho)])
            hit = entry - entry[1] / bent[1] * bent
            apparent, seen_x, seen_z = 1e3 * surface.behind.to_numpy()[round(x * 1e-3 / surface.spacing)].T
            falling = slice(None, None, -1)
            assert np.interp(entry[2] - y, apparent[falling], seen_z[falling]) == pytest.approx(hit[2], abs=0.08)
            assert np.interp(entry[2] - y, apparent[falling], seen_x[falling]) == pytest.approx(hit[0], abs=0.08)
