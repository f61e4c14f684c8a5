"""Neighbour binning and neighbour lists in the meridional half plane, mirror images across the axis included.

Nodes are binned into square cells as wide as the search radius by a counting sort whose scatter is serial, so that the
lists come out the same on any number of threads. A node near the axis also sees the images (-r, z) of the nodes there:
an entry >= 0 is node j itself, an entry -1 - j is its image (see `image_of`).

Several eyes stand one after the other in the same fields: eye e owns the nodes first[e] to first[e] + count[e] - 1 and
none sees another's. Every index of a node counts over all eyes.
"""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.lang import ONE_TASK, ti

SAME_DISTANCE = 1.0 + 1e-5  # ratio of squared distances that counts as a tie


@ti.func
def image_of(entry: ti.i32):
    """Node and sign of a neighbour entry: (j, 1) for a node, (j, -1) for its mirror image."""
    j = entry
    sign = 1
    if entry < 0:
        j = -1 - entry
        sign = -1
    return j, sign


@ti.func
def place_of(points: ti.template(), entry: ti.i32):
    """Position of a neighbour entry; an image lies at negative radius."""
    j, sign = image_of(entry)
    place = points[j]
    place[0] *= sign
    return place


@ti.data_oriented
class NeighbourLists:
    """For each node the entries within a search radius, nearest first.

    capacity: nodes of all eyes; width: entries kept per node (the nearest ones); planar: no axis, so no images. After
    `search`: found[i] entries in entry[i, :]; eye_of[i]; total[None] nodes in all.
    """

    def __init__(self, capacity: int, width: int, planar: bool = False, eyes: int = 1):
        self.capacity, self.width, self.planar = capacity, width, planar
        self.first, self.count = ti.field(ti.i32, eyes), ti.field(ti.i32, eyes)
        self.total, self.eye_of = ti.field(ti.i32, ()), ti.field(ti.i32, capacity)
        self.entry = ti.field(ti.i32, (capacity, width))
        self.distance2 = ti.field(real(), (capacity, width))
        self.found = ti.field(ti.i32, capacity)
        self.cell_of = ti.field(ti.i32, capacity)
        self.sorted = ti.field(ti.i32, capacity)
        self.cell_start = ti.field(ti.i32, capacity + 2)

    def search(self, points, count: int, radius: float, eye: int = 0, first: int = 0) -> None:
        """Fill the lists from `points` (vector field, m, r >= 0) with everything within `radius` [m].

        For the `count` nodes of one eye from `first` on; eyes are searched in their order.
        """
        box = np.empty(4)
        self._enclose(points, first, count, box)
        low, extent = box[:2], box[2:] - box[:2]
        size = radius
        # a sparse domain must not need more cells than there is room for
        while np.prod(np.floor(extent / size) + 1) > self.capacity:
            size *= 1.5
        columns, rows = (np.floor(extent / size) + 1).astype(int).tolist()
        self._bin(points, eye, first, count, *low.tolist(), size, columns, rows)
        self._collect(points, eye, radius, columns, rows)

    def everyone(self):
        """A mask of eyes [eyes] that leaves out none."""
        return np.ones(self.first.shape, dtype=np.int32)

    @ti.kernel
    def _enclose(self, points: ti.template(), first: int, count: int, box: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            low, high = points[first], points[first]
            for i in range(first, first + count):
                low, high = ti.min(low, points[i]), ti.max(high, points[i])
            for a in ti.static(range(2)):
                box[a], box[2 + a] = low[a], high[a]

    @ti.kernel
    def _bin(
        self,
        points: ti.template(),
        eye: int,
        first: int,
        count: int,
        r0: float,
        z0: float,
        size: float,
        columns: int,
        rows: int,
    ):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.first[eye], self.count[eye], self.total[None] = first, count, first + count
            for i in range(first, first + count):
                self.eye_of[i] = eye
                column = ti.min(ti.cast((points[i][0] - r0) / size, ti.i32), columns - 1)
                row = ti.min(ti.cast((points[i][1] - z0) / size, ti.i32), rows - 1)
                self.cell_of[i] = row * columns + column
            # counting sort; one task, since each costs compile time
            for c in range(columns * rows + 1):
                self.cell_start[c] = 0
            for i in range(first, first + count):
                self.cell_start[self.cell_of[i] + 1] += 1
            for c in range(columns * rows):
                self.cell_start[c + 1] += self.cell_start[c]
            for k in range(count):
                # backwards, so that each cell_start ends where it belongs
                i = first + count - 1 - k
                cell = self.cell_of[i]
                self.cell_start[cell + 1] -= 1
                self.sorted[self.cell_start[cell + 1]] = i
            for c in range(columns * rows):
                # cell_start[c + 1] now holds the start of cell c: shift back
                self.cell_start[c] = self.cell_start[c + 1]
            self.cell_start[columns * rows] = count

    @ti.kernel
    def _collect(self, points: ti.template(), eye: int, radius: float, columns: int, rows: int):
        for i in range(self.first[eye], self.first[eye] + self.count[eye]):
            self.found[i] = 0
            column = self.cell_of[i] % columns
            row = self.cell_of[i] // columns
            for other_row in range(ti.max(row - 1, 0), ti.min(row + 2, rows)):
                for other_column in range(ti.max(column - 1, 0), ti.min(column + 2, columns)):
                    cell = other_row * columns + other_column
                    for place in range(self.cell_start[cell], self.cell_start[cell + 1]):
                        j = self.sorted[place]
                        if j != i:
                            self._insert(i, j, (points[j] - points[i]).norm_sqr(), radius)
                        if ti.static(not self.planar):
                            if points[j][0] > 0.0:
                                image = points[j]
                                image[0] = -image[0]
                                self._insert(i, -1 - j, (image - points[i]).norm_sqr(), radius)

    @ti.func
    def _insert(self, i, entry, distance2, radius):
        # insertion sort, nearest first; the row keeps the `width` nearest
        if distance2 <= radius * radius:
            place = self.found[i]
            if place < self.width:
                self.found[i] += 1
            else:
                place = self.width
            while place > 0 and self.distance2[i, ti.max(place - 1, 0)] > distance2:
                if place < self.width:
                    self.distance2[i, place] = self.distance2[i, place - 1]
                    self.entry[i, place] = self.entry[i, place - 1]
                place -= 1
            if place < self.width:
                self.distance2[i, place] = distance2
                self.entry[i, place] = entry

    @ti.func
    def with_ties(self, i, wanted):
        """The least number of entries >= wanted that leaves out none as far away as the last one taken."""
        taken = ti.min(wanted, self.found[i])
        while (
            taken < self.found[i]
            and taken > 0
            and (
                self.distance2[i, ti.min(taken, self.width - 1)]
                <= self.distance2[i, ti.max(taken - 1, 0)] * SAME_DISTANCE
            )
        ):
            taken += 1
        return taken
