"""Potential flow in the chamber: what the wall feels of an incompressible liquid, without acoustics.

The velocity is the gradient of phi with lap phi = q in the chamber, q uniform (0 where the chamber is sealed, the sink
of an open one), d phi/dn = wall velocity on the cornea and 0 on the rigid back, mirrored at the axis. Collocated on the
MFPM cloud: the Laplacian row on interior nodes, on boundary ones the Laplacian of a fit that has the normal derivative
built in, the mean of phi set to zero, q the multiplier that this and the wall's fluxes ask for.

Boundary rows. With n and s across and along the wall and g = d phi/dn given, the quadratic fit is phi_j - phi_i - g n_j
= s_j D_s + n_j^2/2 D_nn + n_j s_j D_ns + s_j^2/2 D_ss (Wendland weights as in `taichi_eye.mfpm`), and its Laplacian is
set to q: both the equation and the condition hold there. Collocating the one-sided normal derivative alone makes the
wall 4-8 times heavier than it should be: the first three modes of the cylinder of `taichi-eye verify` at 0.3 mm are
-1.1/-2.8/-4.5 % off, with the cubic basis -0.5/-1.2/-2.5 %, with the fit +0.4/-0.2/-0.8 %.

One sparse LU, solved for a unit flux through each wall node's ring, gives the flow map F [nodes, walls] (potential of
every node per ring flux, 1/m) and its wall rows, the Neumann-to-Dirichlet matrix N. With Q_i = G_i . v_i the flux of
ring i (G its area vector) the liquid's kinetic energy is rho/2 Q^T N Q, so N would be symmetric in exact arithmetic of
a Galerkin method. Collocation leaves it unsymmetric by some percent, most in the column of the apex, whose ring is
tiny: what a flux through that ring alone does far away is resolved badly and hardly matters, while the row is accurate.
Taking the symmetric part instead mixes the two: 30 % wrong at the apex.

The wall pressure follows from Bernoulli's equation on the moving nodes (`taichi_eye.solver.reduced`).
"""

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from taichi_eye.cloud.packing import FIXED, FREE, SLIDE, Cloud
from taichi_eye.lang import ti
from taichi_eye.mfpm.operators import WEIGHT_RADIUS
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.rings import ring_areas


@ti.data_oriented
class PotentialFlow:
    """Flow maps of the chamber under the present cornea.

    After `refresh`: neumann [walls, walls] and flow [nodes, walls] (1/m), both for ring fluxes [m^3/s]; the limbus,
    which does not move, has a column of zeros.
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
        entry = self.aqueous.neighbours.entry.to_numpy()[:count, : self.width]
        used = np.arange(self.width) < size[:, None]
        node = np.where(used, np.where(entry < 0, -1 - entry, entry), 0)
        rows, slots = np.nonzero(used)
        self.pick = rows, slots
        interior = self._interior(cloud)
        inside = np.flatnonzero(interior)
        every = np.arange(count)
        # entries, diagonal, the mean of phi, the source q
        self.row = np.concatenate([rows, every, np.full(count, count), inside])
        self.column = np.concatenate([node[used], every, every, np.full(len(inside), count)])
        self.source = np.full(len(inside), -1.0)
        self.interior = interior.astype(np.int32)
        self.count = count
        self._setup_fits(cloud, node, entry, used)

    def _setup_fits(self, cloud, node, entry, used) -> None:
        """Stencils and rigid normals of the boundary nodes; corners, where two walls meet, keep the normal
        derivative."""
        fitted = np.flatnonzero(~(self.interior.astype(bool)) & (cloud.kind != FIXED))
        self.fitted, self.fit_node, self.fit_used = fitted, node[fitted], used[fitted]
        self.fit_sign = np.where(entry[fitted] < 0, -1.0, 1.0)
        self.fit_normal = np.column_stack([-cloud.direction[fitted, 1], cloud.direction[fitted, 0]])
        self.fit_walls = int((fitted < cloud.wall_count).sum())
        self.row = np.concatenate([self.row, fitted])
        self.column = np.concatenate([self.column, np.full(len(fitted), self.count)])
        self.source = np.full(len(self.source) + len(fitted), -1.0)

    @staticmethod
    def _interior(cloud) -> np.ndarray:
        """Nodes whose row is the Laplacian: free ones and those on the axis, which its images surround."""
        on_axis = (cloud.kind == SLIDE) & (cloud.points[:, 0] <= 0.0) & (cloud.direction[:, 1] != 0.0)
        return (cloud.kind == FREE) | on_axis

    @ti.kernel
    def _assemble(
        self,
        interior: ti.types.ndarray(),
        value: ti.types.ndarray(),
        diagonal: ti.types.ndarray(),
        volume: ti.types.ndarray(),
        area: ti.types.ndarray(),
        spacing: float,
    ):
        for i in range(interior.shape[0]):
            normal = ti.Vector([0.0, 1.0])
            if i < area.shape[0]:
                ring = self.cornea.volume_gradient(0, i)
                if i == 0:
                    ring[0] = 0.0
                area[i] = ring.norm()
                normal = ring / area[i]
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
        load = np.full(self.walls, self.spacing)
        self._fit(value, diagonal, load)
        data = np.concatenate([value[self.pick], diagonal, volume / volume.sum(), self.source])
        matrix = csc_matrix((data, (self.row, self.column)), shape=(self.count + 1, self.count + 1))
        fluxes = np.zeros((self.count + 1, self.walls))
        moving = np.arange(self.walls - 1)
        fluxes[moving, moving] = load[:-1] / area[:-1]
        self.flow = splu(matrix).solve(fluxes)[: self.count]
        self.neumann = self.flow[: self.walls].copy()

    def _fit(self, value, diagonal, load) -> None:
        """Boundary rows with the condition built in; load [walls]: what multiplies d phi/dn on the right-hand side."""
        place = self.aqueous.place.to_numpy()[: self.count].astype(float)
        here = place[self.fitted]
        normal = self.fit_normal.copy()
        rings = ring_areas(place[: self.walls])[: self.fit_walls]
        normal[: self.fit_walls] = rings / np.linalg.norm(rings, axis=1)[:, None]
        along = np.column_stack([normal[:, 1], -normal[:, 0]])
        arm = place[self.fit_node]
        arm[..., 0] *= self.fit_sign
        arm -= here[:, None]
        length = np.where(self.fit_used, np.linalg.norm(arm, axis=2), 0.0)
        radius = length.max(1)
        q = length / (WEIGHT_RADIUS * radius[:, None])
        weight = np.where(self.fit_used, np.maximum(1.0 - q, 0.0) ** 4 * (1.0 + 4.0 * q), 0.0)
        n, s = (np.einsum("ijk,ik->ij", arm, axis) / radius[:, None] for axis in (normal, along))
        basis = np.stack([s, 0.5 * n * n, n * s, 0.5 * s * s], axis=2)
        weighted = basis * weight[..., None]
        # derivatives D_s, D_nn, D_ns, D_ss per difference, [nodes, 4, entries]
        derivative = np.linalg.solve(np.einsum("ijk,ijl->ikl", weighted, basis), weighted.transpose(0, 2, 1))
        r = here[:, 0]
        on_axis = r <= 0.0
        off_axis = np.where(on_axis, np.inf, r)
        row = derivative[:, 1] + derivative[:, 3]
        row += derivative[:, 0] * (along[:, 0] * radius / off_axis)[:, None]
        # on the axis d/dr / r is d^2/dr^2, along the wall there
        row[on_axis] += derivative[on_axis, 3]
        row *= (self.spacing / radius[:, None]) ** 2
        value[self.fitted] = row
        diagonal[self.fitted] = -row.sum(1)
        load[: self.fit_walls] = ((row * n).sum(1) * radius - normal[:, 0] / off_axis * self.spacing**2)[
            : self.fit_walls
        ]

    def show(
        self, potential: np.ndarray, rate: np.ndarray, wall_velocity, wall_pressure: float, density: float
    ) -> None:
        """Fill the liquid's velocity and excess pressure from phi and d phi/dt of each node, which moves with the wall.

        wall_velocity: field on the wall nodes [m/s]; wall_pressure [Pa]: mean excess pressure on the wall, which the
        free constant of the pressure is set by.
        """
        self._show(potential, rate, wall_velocity, density)
        area = np.linalg.norm(ring_areas(self.cornea.place.to_numpy()[: self.walls]), axis=1)
        found = self.aqueous.pressure.to_numpy()[: self.walls]
        self._lift(wall_pressure - float((area * found).sum() / area.sum()))

    @ti.kernel
    def _show(
        self, potential: ti.types.ndarray(), rate: ti.types.ndarray(), wall_velocity: ti.template(), density: float
    ):
        for i in range(potential.shape[0]):
            self.aqueous.momentum_row[i][0] = potential[i]
        for i in range(potential.shape[0]):
            velocity = self.aqueous.operators.gradient_of_first(i, self.aqueous.momentum_row)
            carried = self.aqueous.wall_share(i, wall_velocity)
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
