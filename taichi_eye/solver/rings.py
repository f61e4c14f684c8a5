"""The ring of a wall node: how the volume under the cornea changes with its place, as one text for kernels and arrays.

The volume between the wall and a plane is the sum over elements of pi r_m^2 dz, r_m the radius in the middle (midpoint
rule). An element from a to b adds to the derivative of the volume with respect to both its ends: (-pi r_m dz, +-pi
r_m^2), plus at its start and minus at its end. A node's derivative, summed over its two elements, is the area vector
[m^2] of its ring, half an element to either side.
"""

import math

import numpy as np

from taichi_eye.eye.laws.law import plain


def text(func):
    """Functions of an element from (r0, z0) to (r1, z1): its volume, and its share of a ring's area at its start."""

    @func
    def volume(r0, z0, r1, z1):
        radius = 0.5 * (r0 + r1)
        return math.pi * radius**2 * (z0 - z1)

    @func
    def share(r0, z0, r1, z1):
        radius = 0.5 * (r0 + r1)
        around = math.pi * radius
        return around * (z0 - z1), around * radius

    return volume, share


def ring_areas(places: np.ndarray) -> np.ndarray:
    """Area vectors [m^2], shape [walls, 2], of the rings at `places` [walls, 2] (m), as the supports leave them:
    nothing at the limbus, no radial part on the axis."""
    across, up = text(plain)[1](*places[:-1].T, *places[1:].T)
    area = np.zeros_like(places)
    area[:-1] += np.column_stack([across, up])
    area[1:-1] += np.column_stack([across, -up])[:-1]
    area[0, 0] = 0.0
    return area
