"""The meridional section of the anterior chamber: where the cornea, the rigid back and the axis run.

Coordinates (r, z) in metres, z up towards the nozzle, z = 0 in the limbus plane. The cornea at rest is a spherical cap
of radius R that ends at the limbus radius a; its pole, the apex, lies at z = R - sqrt(R^2 - a^2). Below it the
chamber is closed by a rigid back plane (iris and lens), on which a spherical lens cap may stand, and, where the
back plane lies deeper than the limbus, by a rigid cylinder at r = a.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Section:
    """Geometry of one chamber; all lengths in metres.

    radius: of the cornea; limbus_radius: of its rim; depth: from the apex to the back plane, on the axis without the
    lens; lens_radius, lens_height: radius of curvature and height of the lens cap (height 0: none).
    """

    radius: float
    limbus_radius: float
    depth: float
    lens_radius: float = 0.0
    lens_height: float = 0.0
    planar = False  # whether the left edge, r = 0, is an edge and no axis

    @property
    def centre_z(self) -> float:
        """Height of the centre of the corneal sphere (negative: below the limbus plane)."""
        return -np.sqrt(self.radius**2 - self.limbus_radius**2)

    @property
    def apex_z(self) -> float:
        """Height of the apex at rest, which is the depth of the cap."""
        return self.radius + self.centre_z

    @property
    def back_z(self) -> float:
        """Height of the back plane (0 where it is the limbus plane)."""
        return min(self.apex_z - self.depth, 0.0)

    @property
    def limbus_angle(self) -> float:
        """Polar angle of the limbus on the corneal sphere, in radians."""
        return float(np.arcsin(self.limbus_radius / self.radius))

    @property
    def lens_base_radius(self) -> float:
        """Radius of the circle in which the lens cap meets the back plane."""
        return float(np.sqrt(max(2.0 * self.lens_radius * self.lens_height - self.lens_height**2, 0.0)))

    @property
    def cornea_length(self) -> float:
        """Arc length of the cornea from apex to limbus."""
        return self.radius * self.limbus_angle

    def cornea_share(self, r):
        """Share of the cornea's arc, from the apex, that lies within radius r [m]."""
        return np.arcsin(np.minimum(r / self.radius, 1.0)) / self.limbus_angle

    def cornea_height(self, r):
        """z of the cornea at rest over radius r [m]; the limbus plane beyond the limbus."""
        inside = np.maximum(self.radius**2 - np.square(np.minimum(r, self.limbus_radius)), 0.0)
        return self.centre_z + np.sqrt(inside)

    def back_height(self, r):
        """z of the rigid back (plane, or lens cap on it) over radius r [m]."""
        r = np.asarray(r, dtype=float)
        if self.lens_height <= 0.0:
            return np.full_like(r, self.back_z)
        base = self.lens_base_radius
        rise = np.sqrt(np.maximum(self.lens_radius**2 - np.minimum(r, base) ** 2, 0.0))
        return self.back_z + np.where(r < base, rise - (self.lens_radius - self.lens_height), 0.0)

    def wall_clearance(self, points):
        """Signed distance [m] from points, shape [n, 2], to the nearest wall; positive inside the chamber.

        The axis is no wall. The sign is exact everywhere, the distance next to a single wall; beside a corner it may be
        too large.
        """
        r, z = np.abs(points[:, 0]), points[:, 1]
        distance = self.radius - np.hypot(r, z - self.centre_z)
        # below the limbus plane the cylinder bounds the chamber, not the continued sphere
        if self.back_z < 0.0:
            distance = np.where(z < 0.0, self.limbus_radius - r, distance)
        distance = np.minimum(distance, z - self.back_z)
        if self.lens_height > 0.0:
            lens_centre = self.back_z + self.lens_height - self.lens_radius
            distance = np.minimum(distance, np.hypot(r, z - lens_centre) - self.lens_radius)
        return distance

    def volume(self) -> float:
        """Volume of the chamber at rest, in m^3."""
        cap, lens = self.apex_z, self.lens_height
        volume = np.pi * cap**2 * (self.radius - cap / 3.0) - np.pi * self.limbus_radius**2 * self.back_z
        return float(volume - np.pi * lens**2 * (self.lens_radius - lens / 3.0))

    def cornea_nodes(self, elements: int):
        """Points of the cornea at equal angles, apex first, limbus last: shape [elements + 1, 2], in metres."""
        angle = np.linspace(0.0, self.limbus_angle, elements + 1)
        points = np.column_stack([self.radius * np.sin(angle), self.centre_z + self.radius * np.cos(angle)])
        points[-1] = self.limbus_radius, 0.0
        return points
