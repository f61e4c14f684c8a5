"""The meridional section against quadrature and against its own outline."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from taichi_eye.eye.eye import eye_of
from taichi_eye.eye.section import Section
from taichi_eye.scene import load_scene

MM = 1e-3


def section(radius=7.8, limbus=5.8, extra=0.0, lens=(0.0, 0.0)):
    cap = radius - np.sqrt(radius**2 - limbus**2)
    return Section(radius * MM, limbus * MM, (cap + extra) * MM, lens[0] * MM, lens[1] * MM)


SECTIONS = [
    section(),
    section(extra=1.3),
    section(extra=0.02),
    section(extra=0.6, lens=(10.0, 0.6)),
    section(lens=(12.0, 0.9)),
    section(6.0, 5.0, 0.4),
    section(9.5, 5.5),
    section(7.2, 6.1, 2.0, (6.0, 1.5)),
]


def outline(a, step):
    """Points of the walls at about `step`: cornea, side, back plane, lens cap."""
    angle = np.arange(0.0, a.limbus_angle, step / a.radius)
    parts = [np.column_stack([a.radius * np.sin(angle), a.centre_z + a.radius * np.cos(angle)])]
    if a.back_z < 0.0:
        side = np.arange(a.back_z, 0.0, step)
        parts.append(np.column_stack([np.full_like(side, a.limbus_radius), side]))
    base = a.lens_base_radius
    plane = np.arange(base, a.limbus_radius, step)
    parts.append(np.column_stack([plane, np.full_like(plane, a.back_z)]))
    if base > 0.0:
        r = base * np.sin(np.linspace(0.0, np.pi / 2, int(2 * base / step)))
        parts.append(np.column_stack([r, a.back_z + a.lens_height - a.lens_radius + np.sqrt(a.lens_radius**2 - r**2)]))
    return np.vstack(parts)


@pytest.mark.parametrize("a", SECTIONS)
def test_volume_agrees_with_quadrature(a):
    def ring(r):
        return 2.0 * np.pi * r * float(a.cornea_height(r) - a.back_height(r))

    volume = sum(
        quad(ring, *span, epsabs=0, epsrel=1e-10)[0]
        for span in ((0.0, a.lens_base_radius), (a.lens_base_radius, a.limbus_radius))
        if span[0] < span[1]
    )
    assert a.volume() == pytest.approx(volume, rel=1e-8)


def test_default_chamber_has_the_published_depth_and_volume():
    a = eye_of(load_scene()).section
    assert a.apex_z == pytest.approx(2.585 * MM, abs=5e-7)
    assert a.volume() == pytest.approx(145.6e-9, rel=1e-3)
    assert a.back_z == 0.0


@pytest.mark.parametrize("a", SECTIONS)
def test_clearance_is_positive_inside_and_negative_outside(a):
    rng = np.random.default_rng(5)
    reach = 1.2 * a.limbus_radius
    points = rng.uniform((-reach, a.back_z - 0.5 * MM), (reach, a.apex_z + 0.5 * MM), (20_000, 2))
    r, z = np.abs(points[:, 0]), points[:, 1]
    inside = (r < a.limbus_radius) & (z > a.back_height(r)) & (z < a.cornea_height(r))
    np.testing.assert_array_equal(a.wall_clearance(points) > 0.0, inside)


@pytest.mark.parametrize("a", SECTIONS)
def test_clearance_is_the_distance_to_the_nearest_wall(a):
    rng = np.random.default_rng(6)
    points = rng.uniform((0.0, a.back_z), (a.limbus_radius, a.apex_z), (5_000, 2))
    clearance, step = a.wall_clearance(points), 2e-6
    distance = cKDTree(outline(a, step)).query(points)[0]
    near = (clearance > 10 * step) & (clearance < 0.5 * MM)
    # beside the side wall the rim of the cornea above is left out of account
    near &= (points[:, 1] >= 0.0) | (a.limbus_radius - points[:, 0] > 2.0 * clearance)
    assert near.sum() > 200
    np.testing.assert_allclose(clearance[near], distance[near], atol=step, rtol=1e-3)


@pytest.mark.parametrize("a", SECTIONS)
def test_points_on_a_wall_have_no_clearance(a):
    np.testing.assert_allclose(a.wall_clearance(outline(a, 0.05 * MM)), 0.0, atol=1e-15)


@pytest.mark.parametrize("elements", [1, 7, 64])
def test_cornea_nodes_divide_the_arc_evenly(elements):
    a = section()
    nodes = a.cornea_nodes(elements)
    chords = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    np.testing.assert_allclose(chords, 2.0 * a.radius * np.sin(0.5 * a.limbus_angle / elements), rtol=1e-9)
    np.testing.assert_allclose(nodes[:, 1], a.cornea_height(nodes[:, 0]), atol=1e-15)
    assert tuple(nodes[-1]) == (a.limbus_radius, 0.0) and nodes[0, 0] == 0.0
