"""Potential flow in the chamber: what the wall feels of an incompressible liquid, without acoustics.

The velocity is the gradient of phi with lap phi = q in the chamber, q uniform (0 where the chamber is sealed, the sink of
an open one), d phi/dn = wall velocity on the cornea and 0 on the rigid back, mirrored at the axis. Collocated on the MFPM
cloud: a Laplacian row on interior nodes, a normal-derivative row on boundary ones, the mean of phi set to zero, q the
multiplier that this and the wall's fluxes ask for. One sparse LU, solved for a unit flux through each wall node's ring,
gives the flow map F [nodes, walls] (potential of every node per ring flux, 1/m) and its wall rows, the Neumann-to-Dirichlet
matrix N. With Q_i = G_i . v_i the flux of ring i (G its area vector) the liquid's kinetic energy is rho/2 Q^T N Q, so N would be
symmetric in exact arithmetic of a Galerkin method. Collocation leaves it unsymmetric by 1-8 %, most in the column of the
apex, whose ring is tiny: what a flux through that ring alone does far away is resolved badly and hardly matters, while the
row is accurate (0.01 % for J0 modes at 40 nodes). Taking the symmetric part instead mixes the two: 30 % wrong at the apex.

The wall pressure follows from Bernoulli's equation on the moving nodes (`taichi_eye.solver.reduced`).
"""
import numpy as np
import taichi as ti
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from taichi_eye.cloud.packing import FREE, SLIDE, Cloud
from taichi_eye.mfpm.neighbours import image_of
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.motion import Motion


def ring_areas(places: np.ndarray) -> np.ndarray:
    """Area vectors [m^2], shape [walls, 2], of the rings at `places`: dV/dx, nothing at the limbus, no radial part on the
    axis (`Cornea.volume_gradient`, `Cornea.held`)."""
    edge = np.diff(places, axis=0)
    radius = 0.5 * (places[1:, 0] + places[:-1, 0])
    area = np.zeros_like(places)
    area[:-1] += np.pi * radius[:, None] * np.column_stack([-edge[:, 1], radius])
    area[1:-1] += np.pi * radius[:-1, None] * np.column_stack([-edge[:-1, 1], -radius[:-1]])
    area[0, 0] = 0.0
    return area


@ti.data_oriented
class PotentialFlow:
    """Flow maps of the chamber under the present cornea.

    After `refresh`: neumann [walls, walls] and flow [nodes, walls] (1/m), both for ring fluxes [m^3/s]; the limbus, which
    does not move, has a column of zeros.
    """

    def __init__(self, cornea: Cornea, aqueous: Aqueous, motion: Motion):
        self.cornea, self.aqueous, self.motion = cornea, aqueous, motion
        self.neumann = self.flow = None

    def setup(self, cloud: Cloud) -> None:
        """Fix the pattern of the matrix for a cloud that `aqueous.setup` has placed."""
        self.walls, self.spacing = cloud.wall_count, cloud.spacing
        count = cloud.count
        size = self.aqueous.operators.size.to_numpy()[:count]
        self.width = int(size.max())
        entry = self.aqueous.neighbours.entry.to_numpy()[:count, :self.width]
        node = np.where(entry < 0, -1 - entry, entry)
        used = np.arange(self.width) < size[:, None]
        rows, slots = np.nonzero(used)
        self.pick = rows, slots
        interior = self._interior(cloud)
        inside = np.flatnonzero(interior)
        every = np.arange(count)
        # entries, diagonal, the source q, the mean of phi
        self.row = np.concatenate([rows, every, inside, np.full(count, count)])
        self.column = np.concatenate([node[used], every, np.full(len(inside), count), every])
        self.source = np.full(len(inside), -1.0)
        self.interior = interior.astype(np.int32)
        self.count = count

    @staticmethod
    def _interior(cloud) -> np.ndarray:
        """Nodes whose row is the Laplacian: free ones and those on the axis, which its images surround."""
        on_axis = (cloud.kind == SLIDE) & (cloud.points[:, 0] <= 0.0) & (cloud.direction[:, 1] != 0.0)
        return (cloud.kind == FREE) | on_axis

    @ti.kernel
    def _assemble(self, interior: ti.types.ndarray(), value: ti.types.ndarray(), diagonal: ti.types.ndarray(),
                  volume: ti.types.ndarray(), area: ti.types.ndarray(), spacing: float):
        for i in range(interior.shape[0]):
            normal = ti.Vector([0.0, 1.0])
            if i < area.shape[0]:
                ring = self.cornea.volume_gradient(0, i)
                if i == 0:
                    ring[0] = 0.0
                area[i] = ring.norm()
                normal = ring / area[i]
            elif self.aqueous.kind[i] == SLIDE:
                normal = ti.Vector([-self.aqueous.slide[i][1], self.aqueous.slide[i][0]])
            total = 0.0
            for k in range(self.aqueous.operators.size[i]):
                weight = 0.0
                if interior[i] == 1:
                    weight = self.aqueous.operators.laplacian_weight[i, k] * spacing * spacing
                else:
                    weight = self.aqueous.operators.gradient_weight[i, k].dot(normal) * spacing
                value[i, k] = weight
                total += weight
            diagonal[i] = -total
            volume[i] = self.aqueous.volume[i]

    def refresh(self) -> None:
        """Recompute the maps for the cornea's present place."""
        self.motion.move_nodes()
        self.aqueous.rebuild()
        value, diagonal = np.zeros((self.count, self.width)), np.zeros(self.count)
        volume, area = np.zeros(self.count), np.zeros(self.walls)
        self._assemble(self.interior, value, diagonal, volume, area, self.spacing)
        data = np.concatenate([value[self.pick], diagonal, self.source, volume / volume.sum()])
        matrix = csc_matrix((data, (self.row, self.column)), shape=(self.count + 1, self.count + 1))
        fluxes = np.zeros((self.count + 1, self.walls))
        moving = np.arange(self.walls - 1)
        fluxes[moving, moving] = self.spacing / area[:-1]
        self.flow = splu(matrix).solve(fluxes)[:self.count]
        self.neumann = self.flow[:self.walls].copy()

    def show(self, potential: np.ndarray, rate: np.ndarray, wall_pressure: float, density: float) -> None:
        """Fill the liquid's velocity and excess pressure from phi and d phi/dt of each node, which moves with the wall.

        wall_pressure [Pa]: mean excess pressure on the wall, which the free constant of the pressure is set by.
        """
        self._show(potential, rate, density)
        area = np.linalg.norm(ring_areas(self.cornea.place.to_numpy()[:self.walls]), axis=1)
        found = self.aqueous.pressure.to_numpy()[:self.walls]
        self._lift(wall_pressure - float((area * found).sum() / area.sum()))

    @ti.kernel
    def _show(self, potential: ti.types.ndarray(), rate: ti.types.ndarray(), density: float):
        for i in range(potential.shape[0]):
            self.aqueous.potential[i] = potential[i]
        for i in range(potential.shape[0]):
            velocity = self.aqueous.operators.gradient_at(i, self.aqueous.potential)
            carried = self.aqueous.wall_share(i, self.cornea.velocity)
            self.aqueous.velocity[i] = velocity
            self.aqueous.pressure[i] = -density * (rate[i] - carried.dot(velocity) + 0.5 * velocity.norm_sqr())

    @ti.kernel
    def _lift(self, by: float):
        for i in range(self.aqueous.count[0]):
            self.aqueous.pressure[i] += by


class LayerFlow:
    """The same maps from thin-layer theory, without a cloud.

    In a layer of depth H(r) the liquid moves radially at one speed over the depth: through the cylinder at r flows what
    the rings inside displace, M. Its kinetic energy is sum_m M_m^2 dr / (2 pi r H), and the vertical motion, linear in
    height, adds H/3 per area: the first two terms of coth(k H)/k = 1/(k^2 H) + H/3 - k^2 H^3/45 + ..., 12 % above it at
    k H = 2, where the width of the dent lies. An open chamber's uniform sink is taken off M.
    """

    def __init__(self, cornea: Cornea, section):
        self.cornea, self.section = cornea, section
        self.neumann = None

    def refresh(self) -> None:
        """Recompute the map for the cornea's present place."""
        count = self.cornea.last[0] + 1
        place = self.cornea.place.to_numpy()[:count].astype(float)
        area = ring_areas(place)
        height = place[:, 1] - self.section.back_height(place[:, 0])
        middle, depth = 0.5 * (place[1:, 0] + place[:-1, 0]), 0.5 * (height[1:] + height[:-1])
        inside = np.tril(np.ones((count - 1, count)))
        held = np.cumsum(np.pi * (place[1:, 0] + place[:-1, 0]) * np.diff(place[:, 0]) * depth)
        inside -= (held / held[-1])[:, None]
        weight = np.diff(place[:, 0]) / (2.0 * np.pi * middle * depth)
        self.neumann = inside.T @ (weight[:, None] * inside)
        moving = np.arange(count - 1)
        self.neumann[moving, moving] += height[:-1] / (3.0 * area[:-1, 1])
