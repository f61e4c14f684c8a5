"""MFPM operators over clouds of any size, one set of fields and kernels per basis."""

import numpy as np
import pytest

from taichi_eye.backend import real
from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
from taichi_eye.lang import ti
from taichi_eye.mfpm.neighbours import NeighbourLists
from taichi_eye.mfpm.operators import CONDITION_LIMIT, SEARCH_RADIUS, STENCIL, WIDTH, MfpmOperators

CAPACITY = 2700
EYE = 7.8e-3, 5.8e-3


class Bench:
    """Operators of one basis; points in m, values by node, as arrays."""

    def __init__(self, basis):
        self.basis, self.count = basis, 0
        self.neighbours = NeighbourLists(CAPACITY, WIDTH[basis])
        self.operators = MfpmOperators(self.neighbours, basis)
        self.points, self.vector, self.vector_out = (ti.Vector.field(2, real(), CAPACITY) for _ in range(3))
        self.scalar, self.scalar_out = ti.field(real(), CAPACITY), ti.field(real(), CAPACITY)

    def put(self, field, values):
        whole = np.full((CAPACITY, *values.shape[1:]), np.nan)
        whole[: self.count] = values
        field.from_numpy(whole)

    def build(self, points, spacing):
        """Choose the stencils at `points` and compute the weights."""
        self.count = len(points)
        self.put(self.points, points)
        self.neighbours.search(self.points, self.count, SEARCH_RADIUS[self.basis] * spacing)
        self.operators.choose_stencils(self.points, STENCIL[self.basis], CONDITION_LIMIT[self.basis])
        self.operators.rebuild(self.points)
        return self

    def move(self, points):
        """Move the nodes and compute new weights on the old stencils."""
        self.put(self.points, points)
        self.operators.rebuild(self.points)

    @property
    def condition(self):
        return self.operators.condition.to_numpy()[: self.count]

    def gradient(self, f):
        self.put(self.scalar, f)
        self.operators.gradient(self.scalar, self.vector_out)
        return self.vector_out.to_numpy()[: self.count]

    def laplacian(self, f):
        self.put(self.scalar, f)
        self.operators.laplacian(self.scalar, self.scalar_out)
        return self.scalar_out.to_numpy()[: self.count]

    def divergence(self, u):
        self.put(self.vector, u)
        self.operators.divergence(self.points, self.vector, self.scalar_out)
        return self.scalar_out.to_numpy()[: self.count]

    def velocity_laplacian(self, u):
        self.put(self.vector, u)
        self.operators.velocity_laplacian(self.points, self.vector, self.vector_out)
        return self.vector_out.to_numpy()[: self.count]


@pytest.fixture(scope="session")
def quadratic():
    return Bench("quadratic")


@pytest.fixture(scope="session")
def cubic():
    return Bench("cubic")


@pytest.fixture(scope="session")
def cloud_at():
    """Packed clouds of the default eye by spacing [mm]; the section may be another one."""
    kept = {}

    def cloud(spacing_mm, radius=EYE[0], depth=None, lens=(0.0, 0.0)):
        key = spacing_mm, radius, depth, lens
        if key not in kept:
            cap = Section(radius, EYE[1], 0.0).apex_z
            kept[key] = pack(Section(radius, EYE[1], depth or cap, *lens), spacing_mm * 1e-3)
        return kept[key]

    return cloud
