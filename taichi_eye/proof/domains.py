"""Domains with known answers, as sections that the node packing and the solver take in place of an eye.

A `Vessel` is a straight cylinder (or, planar, a box): radius (width) a, height H, its top at z = 0 where the cornea
would be. A `Hemisphere` is a half drop on its plane of symmetry. `Images` complete a domain by copies of its nodes
beyond its edges: mirrored (free slip) or shifted by a period.
"""

from dataclasses import dataclass, replace

import numpy as np

from taichi_eye.cloud.packing import FIXED, FREE, SLIDE, Cloud, boundary, fill
from taichi_eye.eye.section import Section

REACH = 5.0  # spacings up to which images are made: beyond the widest search radius


@dataclass(frozen=True)
class Vessel:
    """Cylinder 0 <= r <= width, -height <= z <= 0 (m); planar: a box in (x, z)."""

    width: float
    height: float
    planar: bool = False

    limbus_radius = property(lambda self: self.width)
    back_z = property(lambda self: -self.height)
    apex_z = property(lambda self: 0.0)
    lens_base_radius, lens_radius, lens_height = 0.0, 0.0, 0.0
    cornea_length = property(lambda self: self.width)

    def cornea_share(self, r):
        """Share of the top that lies within r [m]."""
        return np.asarray(r) / self.width

    def cornea_height(self, r):
        """z of the top: 0."""
        return np.zeros_like(r)

    def back_height(self, r):
        """z of the bottom."""
        return np.full_like(r, -self.height)

    def wall_clearance(self, points):
        """Signed distance [m] from points [n, 2] to the nearest wall; positive inside."""
        r, z = points[:, 0], points[:, 1]
        side = np.minimum(r, self.width - r) if self.planar else self.width - np.abs(r)
        return np.minimum(side, np.minimum(-z, z + self.height))

    def volume(self) -> float:
        """Volume [m^3], planar: area [m^2]."""
        return self.width * self.height if self.planar else np.pi * self.width**2 * self.height

    def cornea_nodes(self, elements: int):
        """Points of the top, equally spaced from r = 0 to r = width: [elements + 1, 2]."""
        return np.column_stack([np.linspace(0.0, self.width, elements + 1), np.zeros(elements + 1)])


def vessel_cloud(vessel: Vessel, spacing: float) -> Cloud:
    """Packed nodes of a vessel: its top as the cornea, all walls slip, its four corners stay."""
    return fill(vessel, spacing, *boundary(vessel, spacing))


def hemisphere_cloud(radius: float, spacing: float) -> Cloud:
    """Packed nodes of half a drop: a cap of 90 degrees on its plane of symmetry."""
    section = Section(radius, radius, radius)
    fixed, kind, direction, walls = boundary(section, spacing)
    return fill(section, spacing, fixed, kind, direction, walls)


def with_kinds(cloud: Cloud, kind, direction=None) -> Cloud:
    """The cloud with other boundary conditions: kind [n] and, for SLIDE nodes, direction [n, 2]."""
    return replace(
        cloud,
        kind=np.asarray(kind, dtype=np.int32),
        direction=cloud.direction if direction is None else np.asarray(direction, dtype=float),
    )


def slip_walls(cloud: Cloud) -> Cloud:
    """A vessel's cloud with its top a rigid slip wall, like its other walls."""
    kind, direction = cloud.kind.copy(), cloud.direction.copy()
    kind[: cloud.wall_count] = SLIDE
    direction[: cloud.wall_count] = 1.0, 0.0
    kind[[0, cloud.wall_count - 1]] = FIXED
    return with_kinds(cloud, kind, direction)


def no_slip_walls(cloud: Cloud) -> Cloud:
    """A planar vessel's cloud whose four walls hold the liquid."""
    on_wall = cloud.section.wall_clearance(cloud.points) < 1e-9 * cloud.spacing
    return with_kinds(cloud, np.where(on_wall, FIXED, cloud.kind))


@dataclass(frozen=True)
class Images:
    """Copies of nodes beyond the edges: source [m] node, sign [m, 2] of the velocity components, place [m, 2] (m)."""

    source: np.ndarray
    sign: np.ndarray
    place: np.ndarray

    @classmethod
    def none(cls) -> "Images":
        """No copies."""
        return cls(np.zeros(0, dtype=np.int32), np.zeros((0, 2)), np.zeros((0, 2)))


def mirrored(cloud: Cloud) -> Images:
    """Mirror images of a planar vessel's nodes across its four sides and corners: free slip, exactly."""
    vessel, points = cloud.section, cloud.points
    reach, edge = REACH * cloud.spacing, 1e-9 * cloud.spacing
    maps = [
        [(1.0, 0.0), (-1.0, 0.0), (-1.0, 2.0 * vessel.width)],
        [(1.0, 0.0), (-1.0, 0.0), (-1.0, -2.0 * vessel.height)],
    ]
    return _copies(
        points,
        [((sx, tx), (sz, tz)) for sx, tx in maps[0] for sz, tz in maps[1]][1:],
        (0.0, vessel.width, -vessel.height, 0.0),
        reach,
        edge,
    )


def _copies(points, maps, box, reach, edge):
    low_x, high_x, low_z, high_z = box
    source, sign, place = [], [], []
    for (sx, tx), (sz, tz) in maps:
        copy = points * (sx, sz) + (tx, tz)
        # a node on its own mirror is no copy; beyond the reach it is of no use
        moved = np.abs(copy - points).max(1) > edge
        inside = (
            (copy[:, 0] >= low_x - edge)
            & (copy[:, 0] <= high_x + edge)
            & (copy[:, 1] >= low_z - edge)
            & (copy[:, 1] <= high_z + edge)
        )
        near = (
            (copy[:, 0] > low_x - reach)
            & (copy[:, 0] < high_x + reach)
            & (copy[:, 1] > low_z - reach)
            & (copy[:, 1] < high_z + reach)
        )
        take = np.nonzero(moved & ~inside & near)[0]
        source.append(take)
        place.append(copy[take])
        sign.append(np.tile((sx, sz), (len(take), 1)))
    return Images(np.concatenate(source).astype(np.int32), np.vstack(sign), np.vstack(place))


def tube_cloud(radius: float, period: float, spacing: float) -> tuple[Cloud, Images]:
    """A piece of a tube, periodic along z, with a no-slip wall at r = radius, and its periodic images."""
    vessel = Vessel(radius, period)
    packed = vessel_cloud(vessel, spacing)
    # the top row is the image of the bottom row
    keep = np.arange(packed.wall_count, packed.count)
    points = packed.points[keep]
    kind = np.full(len(points), FREE, dtype=np.int32)
    direction = np.zeros((len(points), 2))
    on_axis, on_wall = points[:, 0] == 0.0, points[:, 0] > radius - 1e-9 * spacing
    kind[on_axis], kind[on_wall] = SLIDE, FIXED
    direction[on_axis] = 0.0, 1.0
    cloud = bare_cloud(vessel, spacing, points, kind, direction)
    images = _copies(
        points,
        [((1.0, 0.0), (1.0, shift)) for shift in (-period, period)],
        (-1.0, radius, -period, -edge_below(spacing)),
        REACH * spacing,
        1e-9 * spacing,
    )
    return cloud, images


def periodic_box(spacing: float) -> tuple[Cloud, Images]:
    """The unit square 0 <= x <= 1, -1 <= z <= 0, periodic both ways: a packed quarter and its mirror images."""
    quarter = vessel_cloud(Vessel(0.5, 0.5, planar=True), spacing).points
    edge = 1e-9 * spacing
    # the edges in the middle once, those at the far ends not at all: they are images
    right = quarter[(quarter[:, 0] > edge) & (quarter[:, 0] < 0.5 - edge)] * (-1.0, 1.0) + (1.0, 0.0)
    upper = np.vstack([quarter, right])
    lower = upper[(upper[:, 1] < -edge) & (upper[:, 1] > -0.5 + edge)] * (1.0, -1.0) + (0.0, -1.0)
    points = np.vstack([upper, lower])
    count = len(points)
    cloud = bare_cloud(
        Vessel(1.0, 1.0, planar=True), spacing, points, np.full(count, FREE, dtype=np.int32), np.zeros((count, 2))
    )
    maps = [((1.0, x), (1.0, z)) for x in (0.0, -1.0, 1.0) for z in (0.0, -1.0, 1.0)][1:]
    low, high = edge_below(spacing) - 1.0, 1.0 - edge_below(spacing)
    return cloud, _copies(points, maps, (0.0, high, low, 0.0), REACH * spacing, edge)


def edge_below(spacing: float) -> float:
    """A hair [m] below the top edge, so that the image of the bottom row at the top counts as outside."""
    return 1e-6 * spacing


def bare_cloud(section, spacing: float, points, kind, direction) -> Cloud:
    """A cloud without a cornea and without triangles: nothing moves and no volumes are needed."""
    count = len(points)
    return Cloud(
        section,
        spacing,
        points,
        0,
        np.asarray(kind, dtype=np.int32),
        direction,
        np.zeros((0, 3), dtype=np.int32),
        np.zeros(count, dtype=np.int32),
        np.zeros(count),
        np.zeros(count),
    )
