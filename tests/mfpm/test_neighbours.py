"""Neighbour lists against brute force."""

import numpy as np
import pytest

from taichi_eye.backend import real
from taichi_eye.lang import ti
from taichi_eye.mfpm.neighbours import SAME_DISTANCE, NeighbourLists

CAPACITY, WIDTH = 500, 60


@ti.data_oriented
class Lists:
    """Neighbour lists of any points, read back as arrays."""

    def __init__(self, width):
        self.lists = NeighbourLists(CAPACITY, width)
        self.points = ti.Vector.field(2, real(), CAPACITY)
        self.taken = ti.field(ti.i32, CAPACITY)

    def search(self, points, radius):
        whole = np.full((CAPACITY, 2), np.nan)
        whole[: len(points)] = points
        self.points.from_numpy(whole)
        self.lists.search(self.points, len(points), float(radius))
        found = self.lists.found.to_numpy()[: len(points)]
        entry, distance2 = self.lists.entry.to_numpy(), self.lists.distance2.to_numpy()
        return [entry[i, :n] for i, n in enumerate(found)], [distance2[i, :n] for i, n in enumerate(found)]

    @ti.kernel
    def _take(self, wanted: int):
        for i in range(self.lists.count[0]):
            self.taken[i] = self.lists.with_ties(i, wanted)

    def with_ties(self, wanted):
        self._take(wanted)
        return self.taken.to_numpy()[: self.lists.count[0]]


@pytest.fixture(scope="module")
def lists():
    return Lists(WIDTH)


def everyone_around(points, i):
    """Entries and squared distances of all other nodes and of all images, in no order."""
    nodes = np.arange(len(points))
    mirrored = points * (-1.0, 1.0)
    entry = np.concatenate([nodes[nodes != i], -1 - nodes[points[:, 0] > 0.0]])
    place = np.vstack([points[nodes != i], mirrored[points[:, 0] > 0.0]])
    return entry, ((place - points[i]) ** 2).sum(1)


def scattered(seed, count, width, height, clumped):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 1.0, (count, 2))
    if clumped:
        points = points**3
    points[rng.random(count) < 0.1, 0] = 0.0
    return points * (width, height) + (0.0, rng.uniform(-1.0, 1.0) * height)


@pytest.mark.parametrize("clumped", [False, True])
@pytest.mark.parametrize(
    "seed, count, width, height",
    [
        (0, 200, 1.0, 1.0),
        (1, 500, 6e-3, 2.5e-3),
        (2, 120, 1.0, 40.0),
        (3, 60, 5.0, 1e-3),
        (4, 2, 1.0, 1.0),
        (5, 1, 1.0, 1.0),
    ],
)
def test_lists_hold_all_and_only_what_is_within_the_radius_nearest_first(lists, seed, count, width, height, clumped):
    points = scattered(seed, count, width, height, clumped)
    far = np.sort(np.concatenate([everyone_around(points, i)[1] for i in range(count)]))
    radius = 1.0001 * np.sqrt(far[min(len(far) - 1, 6 * count)]) if len(far) else width
    entries, distances = lists.search(points, radius)
    for i in range(count):
        entry, distance2 = everyone_around(points, i)
        near = distance2 <= radius**2
        nearest = np.sort(distance2[near])[:WIDTH]
        np.testing.assert_allclose(distances[i], nearest, rtol=1e-12)
        if near.sum() <= WIDTH:
            assert set(entries[i]) == set(entry[near]) and len(entries[i]) == near.sum()
        assert np.all(np.diff(distances[i]) >= 0.0)
        by_entry = dict(zip(entry, distance2))
        np.testing.assert_allclose([by_entry[e] for e in entries[i]], distances[i], rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_full_row_keeps_the_nearest(seed):
    narrow = Lists(9)
    points = scattered(seed, 150, 1.0, 1.0, False)
    entries, distances = narrow.search(points, 0.8)
    for i, row in enumerate(entries):
        entry, distance2 = everyone_around(points, i)
        np.testing.assert_allclose(distances[i], np.sort(distance2)[:9], rtol=1e-12)
        # a node and its image are as far from a node on the axis: either may be the last one kept
        if points[i, 0] > 0.0:
            assert set(row) == set(entry[np.argsort(distance2)[:9]])


def test_nodes_on_the_axis_have_no_image(lists):
    z = np.linspace(0.0, 1.0, 7)
    points = np.vstack([np.column_stack([np.zeros(7), z]), np.column_stack([np.full(7, 0.1), z])])
    entries, _ = lists.search(points, 10.0)
    for row in entries:
        assert not set(row) & {-1 - j for j in range(7)}
        assert {-1 - j for j in range(7, 14)} <= set(row)


@pytest.mark.parametrize("spacing", [0.125, 0.3, 1e-4])
def test_entries_at_one_distance_stay_together(lists, spacing):
    # a square lattice with a column on the axis: shells of 4, 4, 4, 8 around an inner node
    r, z = np.meshgrid(np.arange(11) * spacing, np.arange(11) * spacing)
    points = np.column_stack([r.ravel(), z.ravel()])
    _, distances = lists.search(points, 3.1 * spacing)
    inner = 5 + 11 * 5
    for wanted, taken in ((1, 4), (4, 4), (5, 8), (8, 8), (9, 12), (13, 20), (20, 20)):
        whole = lists.with_ties(wanted)
        assert whole[inner] == taken
        for row, count in zip(distances, whole):
            assert count >= min(wanted, len(row))
            assert count == len(row) or row[count] > row[count - 1] * SAME_DISTANCE


def test_no_more_is_taken_than_was_found(lists):
    entries, _ = lists.search(scattered(7, 30, 1.0, 1.0, False), 0.2)
    np.testing.assert_array_equal(lists.with_ties(1000), [len(row) for row in entries])
