"""Node clouds: on the walls, even, whole, and the same every time."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from taichi_eye.cloud import packing
from taichi_eye.cloud.packing import FIXED, FREE, GAP_LIMIT, HOLE_LIMIT, REACH, SLIDE, WALL, boundary, pack
from taichi_eye.cloud.quality import measure
from taichi_eye.errors import SceneError
from taichi_eye.eye.eye import eye_of
from taichi_eye.scene import load_scene

MM = 1e-3
SECTIONS = {
    "default": [],
    "lens cap": ["chamber.depth_mm=3.2", "chamber.lens_radius_mm=10", "chamber.lens_height_mm=0.6"],
    "lens cap on the limbus plane": ["chamber.lens_radius_mm=10", "chamber.lens_height_mm=1.0"],
    "side wall": ["chamber.depth_mm=4"],
    "very short side wall": ["chamber.depth_mm=2.62"],
    "thin": ["cornea.radius_mm=9.5"],
    "small eye": ["cornea.radius_mm=6.2", "cornea.limbus_radius_mm=4.5"],
}
SPACINGS = 0.33, 0.21, 0.13
CASES = [(name, spacing) for name in SECTIONS for spacing in SPACINGS]


def section_of(name):
    return eye_of(load_scene(None, SECTIONS[name] + ["numerics.spacing_mm=0.3"])).section


@pytest.fixture(scope="module")
def clouds():
    return {(name, spacing): pack(section_of(name), spacing * MM) for name, spacing in CASES}


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]} at {case[1]} mm")
def cloud(request, clouds):
    return clouds[request.param]


def outline(cloud):
    """Corners of the polygon of boundary nodes: wall from apex to limbus, back from rim to axis, axis up again."""
    return cloud.points[: np.count_nonzero(cloud.kind != FREE)]


def test_wall_nodes_stand_on_the_sphere_at_equal_angles(cloud):
    section, wall = cloud.section, cloud.points[: cloud.wall_count]
    angle = np.arctan2(wall[:, 0], wall[:, 1] - section.centre_z)
    np.testing.assert_allclose(np.hypot(wall[:, 0], wall[:, 1] - section.centre_z), section.radius, rtol=1e-12)
    np.testing.assert_allclose(angle, np.linspace(0.0, section.limbus_angle, cloud.wall_count), atol=1e-12)
    assert wall[0, 0] == 0.0 and wall[0, 1] == pytest.approx(section.apex_z, rel=1e-12)
    assert tuple(wall[-1]) == (section.limbus_radius, 0.0)
    step = section.radius * section.limbus_angle / (cloud.wall_count - 1)
    assert 0.75 * cloud.spacing < step < 1.25 * cloud.spacing


def test_every_boundary_node_stands_on_its_boundary(cloud):
    section = cloud.section
    clearance = section.wall_clearance(cloud.points) / cloud.spacing
    r, z = cloud.points.T
    axis = r == 0.0
    assert axis.sum() >= 4 and r.min() == 0.0
    on_wall = np.abs(clearance) < 1e-9
    boundary = cloud.kind != FREE
    assert np.all(on_wall[boundary] | axis[boundary])
    assert np.all(clearance[~boundary] > 0.25) and np.all(r[~boundary] > 0.25 * cloud.spacing)
    back = boundary & on_wall & (z <= section.back_height(r) + 1e-9 * cloud.spacing)
    assert np.count_nonzero(back) >= section.limbus_radius / cloud.spacing / 1.3
    # the ends of every boundary are nodes
    corners = [(0.0, section.apex_z), (section.limbus_radius, 0.0), (0.0, float(section.back_height(0.0)))]
    if section.lens_height > 0.0:
        corners.append((section.lens_base_radius, section.back_z))
    for corner in corners:
        assert np.hypot(*(cloud.points[boundary] - corner).T).min() < 1e-9 * cloud.spacing


def test_each_kind_of_node_stands_where_it_may(cloud):
    section, r, kind = cloud.section, cloud.points[:, 0], cloud.kind
    assert np.all(kind[: cloud.wall_count - 1] == WALL) and kind[cloud.wall_count - 1] == FIXED
    assert np.all(kind[cloud.wall_count :] != WALL)
    np.testing.assert_allclose(np.linalg.norm(cloud.direction, axis=1), kind == SLIDE, atol=1e-12)
    # sliding along its direction keeps a node on its boundary, to second order
    step = 1e-3 * cloud.spacing
    for i in np.flatnonzero(kind == SLIDE):
        moved = cloud.points[i] + step * cloud.direction[i]
        if r[i] == 0.0:
            assert moved[0] == 0.0
        else:
            assert abs(section.wall_clearance(moved[None])[0]) < step**2 / cloud.spacing
    # a node that may not move at all stands in a corner
    fixed = cloud.points[kind == FIXED]
    assert np.all((fixed[:, 1] <= section.back_height(fixed[:, 0]) + 1e-12) | (fixed[:, 0] >= section.limbus_radius))


def test_no_gap_and_no_hole_exceeds_its_limit(cloud):
    quality, spacing = measure(cloud), cloud.spacing
    both = np.vstack([cloud.points, cloud.points[cloud.points[:, 0] > 0] * (-1.0, 1.0)])
    tree = cKDTree(both)
    free = cloud.points[cloud.kind == FREE]
    assert tree.query(free, k=2)[0][:, 1].min() >= GAP_LIMIT * spacing
    nearest = cKDTree(cloud.points).query(cloud.points, k=2)[0][:, 1]
    assert quality.smallest_gap == pytest.approx(nearest.min() / spacing)
    # an independent look: how far from every node a point of the chamber can be
    rng = np.random.default_rng(cloud.count)
    section = cloud.section
    probes = rng.uniform((0.0, section.back_z), (section.limbus_radius, section.apex_z), (40_000, 2))
    probes = probes[section.wall_clearance(probes) > 0.02 * spacing]
    assert tree.query(probes)[0].max() <= HOLE_LIMIT * spacing
    assert quality.largest_hole <= HOLE_LIMIT * (1 + 1e-9)
    assert quality.nodes == cloud.count
    assert 0.9 < quality.mean_gap < 1.1


def test_triangles_fill_the_section_without_overlap(cloud):
    a, b, c = (cloud.points[cloud.triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.min() > 0.0
    r, z = outline(cloud).T
    polygon = 0.5 * abs(np.dot(r, np.roll(z, -1)) - np.dot(z, np.roll(r, -1)))
    assert area.sum() == pytest.approx(polygon, rel=1e-12)
    # Euler: as many triangles as n nodes with b of them on the outline allow
    assert len(cloud.triangles) == 2 * (cloud.count - 1) - len(r)
    assert set(cloud.triangles.ravel()) == set(range(cloud.count))


@pytest.mark.parametrize("name", SECTIONS)
def test_triangle_volume_tends_to_the_chamber_volume_at_second_order(name, clouds):
    errors = []
    for spacing in SPACINGS:
        cloud = clouds[name, spacing]
        a, b, c = (cloud.points[cloud.triangles[:, k]] for k in range(3))
        area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        volume = 2.0 * np.pi * (area * (a + b + c)[:, 0] / 3.0).sum()
        errors.append(abs(volume / cloud.section.volume() - 1.0))
    assert max(errors) < 5e-3
    # a side left out because it is much shorter than a spacing is another section
    if name != "very short side wall":
        assert np.polyfit(np.log(SPACINGS), np.log(errors), 1)[0] > 1.6


def test_node_motion_weights_are_0_on_the_back_and_1_on_the_cornea(cloud):
    section, (r, z), height = cloud.section, cloud.points.T, cloud.height_fraction
    assert np.all(height[: cloud.wall_count] == 1.0)
    on_back = (z <= section.back_height(r) + 1e-9 * cloud.spacing) & (np.arange(cloud.count) >= cloud.wall_count)
    assert height[on_back].max() < 1e-12
    free = cloud.kind == FREE
    assert np.all((height[free] > 0.0) & (height[free] < 1.0))
    np.testing.assert_allclose(
        height[free],
        (z[free] - section.back_height(r[free])) / (section.cornea_height(r[free]) - section.back_height(r[free])),
        atol=1e-9,
    )
    # the element above a node, and the place in it
    k, f = cloud.wall_index, cloud.wall_fraction
    assert k.min() >= 0 and k.max() <= cloud.wall_count - 2 and f.min() >= 0.0 and f.max() <= 1.0
    angle = section.limbus_angle / (cloud.wall_count - 1) * (k + f)
    np.testing.assert_allclose(section.radius * np.sin(angle), r, atol=1e-9 * section.radius)
    np.testing.assert_array_equal((k + f)[: cloud.wall_count], np.arange(cloud.wall_count))


@pytest.mark.parametrize("name, spacing", CASES[::4])
def test_the_same_section_gives_the_same_bits(name, spacing, clouds):
    again = pack(section_of(name), spacing * MM)
    for part in ("points", "kind", "direction", "triangles", "wall_index", "wall_fraction", "height_fraction"):
        first, second = getattr(clouds[name, spacing], part), getattr(again, part)
        assert first.tobytes() == second.tobytes() and first.dtype == second.dtype


def all_pairs_relax(section, fixed, inner, spacing, rounds):
    """The relaxation as its formula says it: every pair, every sweep."""
    reach = REACH * spacing
    for sweep in range(rounds):
        everyone = np.vstack([fixed, inner, inner * (-1.0, 1.0)])
        step = np.zeros_like(inner)
        for i, others in enumerate(cKDTree(everyone).query_ball_point(inner, reach)):
            away = inner[i] - everyone[[j for j in others if j != len(fixed) + i]]
            distance = np.linalg.norm(away, axis=1, keepdims=True)
            step[i] = 0.15 * spacing * ((reach / distance - 1.0) ** 2 * away / distance).sum(0)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        longest = (0.1 * (1.0 - sweep / rounds) + 0.002) * spacing
        moved = inner + step * np.minimum(1.0, longest / np.maximum(length, 1e-300))
        moved[:, 0] = np.maximum(moved[:, 0], 0.3 * spacing)
        inner = np.where((section.wall_clearance(moved) > 0.3 * spacing)[:, None], moved, inner)
    return inner


@pytest.mark.parametrize(
    "name, spacing_mm, rounds", [("default", 0.25, 60), ("side wall", 0.3, 60), ("default", 0.1, 8)]
)
def test_kept_lists_and_resting_nodes_change_nothing(name, spacing_mm, rounds):
    section, spacing = section_of(name), spacing_mm * MM
    fixed = boundary(section, spacing)[0]
    r, z = np.meshgrid(
        np.arange(spacing, section.limbus_radius, spacing), np.arange(section.back_z, section.apex_z, 0.866 * spacing)
    )
    r[1::2] -= 0.5 * spacing
    inner = np.column_stack([r.ravel(), z.ravel()])
    inner = inner[section.wall_clearance(inner) > 0.6 * spacing]
    quick = packing._relax(section, fixed, inner, spacing, rounds)
    plain = all_pairs_relax(section, fixed, inner, spacing, rounds)
    assert np.abs(quick - plain).max() < 1e-6 * spacing
    assert np.abs(quick - inner).max() > 0.1 * spacing


def test_a_large_cloud_is_as_even_as_a_small_one():
    quality = measure(pack(section_of("default"), 0.03 * MM))
    assert quality.nodes > 10_000 and quality.largest_hole <= HOLE_LIMIT and quality.smallest_gap >= GAP_LIMIT
    assert 0.97 < quality.mean_gap < 1.0


@pytest.mark.parametrize("spacing_mm", [1.5, 3.0, 20.0])
def test_a_spacing_with_no_room_for_nodes_is_refused(spacing_mm):
    with pytest.raises(SceneError) as caught:
        pack(section_of("default"), spacing_mm * MM)
    assert "numerics.spacing_mm" in str(caught.value) and f"{spacing_mm:g}" in str(caught.value)


def test_a_cloud_that_cannot_be_repaired_is_refused():
    with pytest.raises(SceneError) as caught:
        pack(section_of("default"), 0.3 * MM, rounds=2, repairs=1)
    for part in ("numerics.spacing_mm = 0.3", "hole", "gap"):
        assert part in str(caught.value)


def test_quality_of_a_stretched_cloud(clouds):
    cloud = clouds["default", 0.21]
    rest, stretched = measure(cloud), measure(cloud, 3.0 * cloud.points)
    assert stretched.smallest_gap == pytest.approx(3.0 * rest.smallest_gap)
    assert stretched.mean_gap == pytest.approx(3.0 * rest.mean_gap)
    assert stretched.largest_hole >= 3.0 * rest.largest_hole * (1 - 1e-12)
