"""Boundary-conforming, relaxed node clouds for a meridional section.

Collocation is as stable as its cloud is even: one gap under one wall node is enough for a local unstable mode, so the
nodes are packed. Boundary nodes stand at equal arc length on the cornea, the rigid back and the axis; the inside
starts as a hexagonal lattice and relaxes under a short-range pair repulsion, the boundary and the mirror images
across the axis pushing too. Then the worst hole gets a node or the closest pair loses one, and the cloud relaxes
again, until every hole and gap is within bounds. Nothing is random: the same section and spacing give the same cloud.

A lattice is its own equilibrium, so the relaxation is a disturbance that walks in from the walls, some 40 rows in 300
sweeps: only nodes that it has reached are looked at, and the pairs in reach are listed once for up to 20 sweeps.
Against all pairs in each sweep the nodes end in the same places to 1e-7 spacings (the default eye's apex history: to
3e-13 mm),
six times sooner at 1.3 k nodes, ten times at 200 k, where half of the time that is left is Delaunay's (`taichi-eye
bench
--only packing`). Longer lists (a skin of 0.3) take in the lattice's second ring and doubled the work of a sweep.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from taichi_eye.errors import SceneError
from taichi_eye.eye.section import Section

# what a node may do: move freely, follow the cornea, slide along a fixed direction, or stay
FREE, WALL, SLIDE, FIXED = 0, 1, 2, 3

HOLE_LIMIT = 0.78  # largest circumradius of an empty triangle, in spacings
GAP_LIMIT = 0.62  # smallest distance between two nodes, in spacings
SHORT_SIDE = 0.7  # in spacings
REACH = 1.6  # of the repulsion, in spacings
SKIN = 0.12  # in spacings: pairs this far beyond the reach are listed too, so that a list serves several sweeps
LIST_AGE = 20  # sweeps that a list serves at most
CELL = 4.0  # in spacings: nodes rest as long as no node in their cell or beside it moves
REST = 1e-9  # in spacings per sweep: what counts as moving


@dataclass(frozen=True)
class Cloud:
    """Nodes of one chamber at rest; all lengths in metres.

    points [n, 2]; the first wall_count nodes are the cornea's, apex first, limbus last. kind [n]: FREE, WALL, SLIDE
    (along direction [n, 2]) or FIXED. triangles [t, 3]: counter-clockwise. wall_index [n], wall_fraction [n]: the
    cornea element above a node and the place within it; height_fraction [n]: 0 on the rigid back, 1 on the cornea (the
    node motion, see `taichi_eye.solver.aqueous`).
    """

    section: Section
    spacing: float
    points: np.ndarray
    wall_count: int
    kind: np.ndarray
    direction: np.ndarray
    triangles: np.ndarray
    wall_index: np.ndarray
    wall_fraction: np.ndarray
    height_fraction: np.ndarray

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.points)


def _steps(length, spacing):
    """Into how many even steps a piece of boundary is cut: steps of about one spacing, never above 1.25."""
    steps = max(round(length / spacing), 1)
    return steps + 1 if length > 1.25 * spacing * steps else steps


def cornea_elements(section: Section, spacing: float) -> int:
    """Membrane elements of a cornea at `spacing` [m], one per wall node of its cloud."""
    return _steps(section.cornea_length, spacing)


def _along(start, end, spacing):
    """Points after `start` up to and including `end`, evenly spaced at about `spacing`."""
    return np.linspace(start, end, _steps(np.linalg.norm(np.subtract(end, start)), spacing) + 1)[1:]


def _lens_arc(section, spacing):
    """Points on the lens cap from its rim (left out) to its pole."""
    if section.lens_height <= 0.0:
        return np.empty((0, 2))
    opening = np.arcsin(section.lens_base_radius / section.lens_radius)
    angle = np.linspace(opening, 0.0, _steps(section.lens_radius * opening, spacing) + 1)[1:]
    centre = section.back_z + section.lens_height - section.lens_radius
    return np.column_stack([section.lens_radius * np.sin(angle), centre + section.lens_radius * np.cos(angle)])


def boundary(section: Section, spacing: float):
    """Boundary nodes and what they may do: points [b, 2], kind [b], direction [b, 2], wall_count."""
    limbus, back_z = section.limbus_radius, section.back_z
    elements = cornea_elements(section, spacing)
    points, kind, direction = [], [], []

    def add(nodes, what, slide=(0.0, 0.0)):
        points.extend(nodes)
        kind.extend([what] * len(nodes))
        direction.extend([slide] * len(nodes))

    add(section.cornea_nodes(elements), WALL)
    kind[-1] = FIXED
    corner = np.array([limbus, back_z])
    # a side much shorter than a spacing has no room for a corner node of its own
    if -back_z > SHORT_SIDE * spacing:
        side = _along((limbus, 0.0), corner, spacing)
        add(side[:-1], SLIDE, (0.0, 1.0))
        add(side[-1:], FIXED)
    rim = np.array([section.lens_base_radius, back_z])
    plane = _along(corner, rim, spacing)
    add(plane[:-1], SLIDE, (1.0, 0.0))
    add(plane[-1:], FIXED)
    arc = _lens_arc(section, spacing)
    if len(arc):
        centre = np.array([0.0, back_z + section.lens_height - section.lens_radius])
        for point in arc[:-1]:
            normal = (point - centre) / section.lens_radius
            add([point], SLIDE, (normal[1], -normal[0]))
        add(arc[-1:], FIXED)
    axis = _along((0.0, points[-1][1]), (0.0, section.apex_z), spacing)[:-1]
    add(axis, SLIDE, (0.0, 1.0))
    return np.array(points), np.array(kind, dtype=np.int32), np.array(direction), elements + 1


def _with_images(section, points, spacing):
    """The points followed by their mirror images across the axis, as far as the repulsion reaches."""
    if section.planar:
        return points
    near = points[(points[:, 0] > 0.0) & (points[:, 0] < 2.0 * spacing)]
    return np.vstack([points, near * (-1.0, 1.0)])


class _Neighbourhood:
    """The pairs of nodes that may push each other, kept for some sweeps, where nodes still move.

    awake [a]: the inner nodes that are moved, all others rest; place [2, m]: those, their surroundings and mirror
    images.
    """

    def __init__(self, section, walls, points, hot, spacing):
        """points [n, 2], the first `walls` of them on the boundary; hot [n]: those that moved of late."""
        cell = np.floor((points - points.min(0)) / (CELL * spacing)).astype(np.intp) + 2
        shape = cell.max(0) + 3
        cell = cell[:, 0] * shape[1] + cell[:, 1]
        stirred = np.zeros(shape, dtype=bool)
        stirred.ravel()[cell[hot]] = True
        stirred = _grown(stirred)
        # the awake nodes first, then what they touch
        awake = stirred.ravel()[cell]
        awake[:walls] = False
        self.awake = np.flatnonzero(awake)
        around = np.concatenate([self.awake, np.flatnonzero(_grown(stirred).ravel()[cell] & ~awake)])
        place = points[around].T
        self.images = np.flatnonzero((place[0] > 0.0) & (place[0] < 2.0 * spacing) & (not section.planar))
        self.known = len(around)
        self.place = np.hstack([place, place[:, self.images] * [[-1.0], [1.0]]])
        self.built = self.place[:, : len(self.awake)].copy()
        pairs = cKDTree(self.place.T).query_pairs((REACH + SKIN) * spacing, output_type="ndarray")
        # of a pair the smaller index comes first
        self.one, self.other = pairs[pairs[:, 0] < len(self.awake)].T.copy()

    def push(self, reach):
        """Sum over the neighbours of (reach/d - 1)^2, away from each: [2, a]."""
        away = np.take(self.place, self.one, 1) - np.take(self.place, self.other, 1)
        inverse = 1.0 / np.sqrt(np.maximum(away[0] * away[0] + away[1] * away[1], (1e-9 * reach) ** 2))
        strength = np.maximum(reach * inverse - 1.0, 0.0)
        strength *= strength * inverse
        count = len(self.awake)
        return np.array(
            [
                np.bincount(self.one, part, count) - np.bincount(self.other, part, count)[:count]
                for part in strength * away
            ]
        )

    def move(self, moved):
        """Take the new places [2, a] of the awake nodes; how far any has come since the list was made [m]."""
        self.place[:, : len(self.awake)] = moved
        self.place[:, self.known :] = self.place[:, self.images] * [[-1.0], [1.0]]
        return np.sqrt(np.square(moved - self.built).sum(0).max())


def _grown(cells):
    """The cells and those beside them: [columns, rows], whose edges are empty."""
    wide = cells.copy()
    wide[1:] |= cells[:-1]
    wide[:-1] |= cells[1:]
    grown = wide.copy()
    grown[:, 1:] |= wide[:, :-1]
    grown[:, :-1] |= wide[:, 1:]
    return grown


def _relax(section, fixed, inner, spacing, rounds):
    """Move the inner nodes apart for `rounds` sweeps with steps that shrink to rest.

    Deep inside, the lattice is at rest until the disturbance from the walls comes near: only where nodes move is looked
    at.
    """
    points = np.vstack([fixed, inner])
    hot = np.ones(len(points), dtype=bool)
    strayed, age = np.inf, 0
    for sweep in range(rounds):
        if strayed > 0.5 * SKIN * spacing or age == LIST_AGE:
            near = _Neighbourhood(section, len(fixed), points, hot, spacing)
            hot[:] = False
            age = 0
            if not len(near.awake):
                break
        before = points[near.awake].T
        step = 0.15 * spacing * near.push(REACH * spacing)
        length = np.hypot(*step)
        limit = (0.1 * (1.0 - sweep / rounds) + 0.002) * spacing
        moved = before + step * np.minimum(1.0, limit / np.maximum(length, 1e-300))
        moved[0] = np.maximum(moved[0], 0.3 * spacing)
        moved = np.where(section.wall_clearance(moved.T) > 0.3 * spacing, moved, before)
        points[near.awake] = moved.T
        strayed = near.move(moved)
        hot[near.awake] |= length > REST * spacing
        age += 1
    return points[len(fixed) :]


def triangulate(section: Section, points, spacing: float):
    """Delaunay triangles inside the section, counter-clockwise: indices [t, 3]."""
    corners = Delaunay(points).simplices
    a, b, c = (points[corners[:, k]] for k in range(3))
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    corners = np.where((twice > 0.0)[:, None], corners, corners[:, ::-1])
    middle = (a + b + c) / 3.0
    inside = (section.wall_clearance(middle) > -1e-3 * spacing) & (np.abs(twice) > 2e-3 * spacing**2)
    return np.ascontiguousarray(corners[inside], dtype=np.int32)


def circumradii(points, triangles):
    """Circumradius of each triangle [m]: the radius of the empty disc between its corners."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    area = 0.5 * np.abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    return sides[0] * sides[1] * sides[2] / (4.0 * area)


def _holes(section, points, spacing):
    """The largest hole away from the boundary's own slivers: its radius and middle."""
    everyone = _with_images(section, points, spacing)
    triangles = triangulate(section, everyone, spacing)
    middle = everyone[triangles].mean(1)
    inside = (section.wall_clearance(middle) > 0.02 * spacing) & (middle[:, 0] >= 0.0)
    radius = np.where(inside, circumradii(everyone, triangles), 0.0)
    worst = int(np.argmax(radius))
    return radius[worst], middle[worst]


def pack(section: Section, spacing: float, rounds: int = 300, repairs: int = 40) -> Cloud:
    """A packed cloud of the section at `spacing` [m].

    Raises SceneError where holes or gaps cannot be repaired (the spacing is too coarse for the section).
    """
    return fill(section, spacing, *boundary(section, spacing), rounds, repairs)


@lru_cache(maxsize=16)
def packed(section: Section, spacing: float) -> Cloud:
    """The cloud that `pack` makes, from the last ones made where it is among them; its arrays cannot be written to."""
    cloud = pack(section, spacing)
    for value in vars(cloud).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return cloud


def fill(
    section: Section, spacing: float, fixed, kind, direction, wall_count: int, rounds: int = 300, repairs: int = 40
) -> Cloud:
    """A packed cloud inside given boundary nodes (as `boundary` returns them); raises like `pack`."""
    row = spacing * np.sqrt(3.0) / 2.0
    r, z = np.meshgrid(
        np.arange(spacing, section.limbus_radius + spacing, spacing),
        np.arange(section.back_z + row, section.apex_z, row),
    )
    r[1::2] -= 0.5 * spacing
    inner = np.column_stack([r.ravel(), z.ravel()])
    inner = inner[section.wall_clearance(inner) > 0.6 * spacing]
    if len(inner) < 8:
        raise SceneError(
            f"numerics.spacing_mm = {spacing * 1e3:g}: only {len(inner)} nodes fit inside the chamber; "
            "at least 8 are needed, so take a smaller spacing"
        )
    inner = _relax(section, fixed, inner, spacing, rounds)
    for _ in range(repairs):
        points = np.vstack([fixed, inner])
        hole, middle = _holes(section, points, spacing)
        gap = cKDTree(_with_images(section, points, spacing)).query(inner, k=2)[0][:, 1]
        if hole <= HOLE_LIMIT * spacing and gap.min() >= GAP_LIMIT * spacing:
            break
        if hole > HOLE_LIMIT * spacing:
            inner = np.vstack([inner, middle])
        else:
            inner = np.delete(inner, np.argmin(gap), 0)
        inner = _relax(section, fixed, inner, spacing, rounds // 2)
    else:
        raise SceneError(
            f"numerics.spacing_mm = {spacing * 1e3:g}: the node cloud keeps a hole of {hole / spacing:.2f} "
            f"(at most {HOLE_LIMIT}) or a gap of {gap.min() / spacing:.2f} (at least {GAP_LIMIT}) "
            "spacings in this chamber; take another spacing, smaller if in doubt"
        )
    inner = inner[np.lexsort((inner[:, 1], np.floor(inner[:, 0] / (3.0 * spacing))))]
    return complete(section, spacing, np.vstack([fixed, inner]), kind, direction, wall_count)


def complete(section: Section, spacing: float, points, kind, direction, wall_count: int) -> Cloud:
    """The cloud of the given nodes, boundary first; kind and direction of the boundary nodes (the rest is free)."""
    free = len(points) - len(kind)
    kind = np.concatenate([kind, np.full(free, FREE, dtype=np.int32)])
    direction = np.vstack([direction, np.zeros((free, 2))])
    r, z = points[:, 0], points[:, 1]
    place = section.cornea_share(r) * (wall_count - 1)
    wall_index = np.minimum(place.astype(np.int32), wall_count - 2)
    gap = section.cornea_height(r) - section.back_height(r)
    height = np.where(gap > 1e-6 * spacing, (z - section.back_height(r)) / np.maximum(gap, 1e-6 * spacing), 0.0)
    height = np.clip(height, 0.0, 1.0)
    fraction = np.clip(place - wall_index, 0.0, 1.0)
    # wall nodes are the cornea's own nodes, without the rounding of the arcsine
    wall_index[:wall_count] = np.minimum(np.arange(wall_count), wall_count - 2)
    fraction[:wall_count] = np.arange(wall_count) - wall_index[:wall_count]
    height[:wall_count] = 1.0
    return Cloud(
        section,
        spacing,
        points,
        wall_count,
        kind,
        direction,
        triangulate(section, points, spacing),
        wall_index,
        fraction,
        height,
    )
