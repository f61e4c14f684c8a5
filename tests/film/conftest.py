"""Synthetic eyes for the renderer: fields filled from closed forms, no solver."""

import numpy as np
import pytest

from taichi_eye.backend import real
from taichi_eye.film import FrameState
from taichi_eye.lang import ti
from taichi_eye.scene import load_scene

WALL_COUNT, NODE_CAPACITY = 120, 64


class SyntheticEye:
    """A scene and a FrameState whose wall and nodes are set by hand; fields are longer than their counts."""

    def __init__(self, overrides=()):
        self.scene = load_scene(None, list(overrides))
        self.radius, self.limbus = self.scene.cornea.radius_mm, self.scene.cornea.limbus_radius_mm
        self.r = self.radius * np.sin(np.linspace(0.0, np.arcsin(self.limbus / self.radius), WALL_COUNT))
        empty = np.empty(0)
        wall = ti.Vector.field(2, real(), WALL_COUNT + 9)
        nodes, velocity = (ti.Vector.field(2, real(), NODE_CAPACITY) for _ in range(2))
        pressure = ti.field(real(), NODE_CAPACITY)
        self.state = FrameState(0.0, wall, WALL_COUNT, nodes, 0, pressure, velocity, empty, empty, empty)
        self.set_wall(self.sphere())

    def sphere(self, radius_mm=None):
        """A cap of this radius of curvature (negative: concave) through the apex at rest; the cornea's by
        default."""
        radius = self.radius if radius_mm is None else radius_mm
        apex = self.radius - np.sqrt(self.radius**2 - self.limbus**2)
        return lambda r: apex - radius + np.sign(radius) * np.sqrt(radius**2 - r**2)

    def dented(self, depth_mm):
        """The cap at rest with a dent on the axis and a bulge around it."""
        rest = self.sphere()
        return lambda r: rest(r) - depth_mm * (np.exp(-((r / 1.6) ** 2)) - 0.1 * np.exp(-((r - 3.2) ** 2)))

    def set_wall(self, height_mm):
        points = np.full((WALL_COUNT + 9, 2), 1e3)
        points[:WALL_COUNT] = np.column_stack([self.r, height_mm(self.r)])
        self.state.wall.from_numpy(points * 1e-3)

    def set_nodes(self, points_mm, pressure_pa, speed_m_s=0.0):
        count = len(points_mm)
        points = np.zeros((NODE_CAPACITY, 2))
        points[:count] = np.asarray(points_mm) * 1e-3
        pressure, velocity = np.zeros(NODE_CAPACITY), np.zeros((NODE_CAPACITY, 2))
        pressure[:count] = pressure_pa
        velocity[:count, 1] = speed_m_s
        self.state.nodes.from_numpy(points)
        self.state.pressure.from_numpy(pressure)
        self.state.velocity.from_numpy(velocity)
        self.state.node_count = count


@pytest.fixture(scope="module")
def synthetic_eye():
    return SyntheticEye
