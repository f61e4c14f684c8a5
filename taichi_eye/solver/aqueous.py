"""The aqueous humour: a weakly compressible Newtonian liquid on moving MFPM nodes.

Equations on a node that moves with velocity w (arbitrary Lagrangian-Eulerian), p the excess over the IOP:

    dp/dt  = -(rho0 c^2 + p) div u - (u - w) . grad p + alpha c h P p + (mass fix, mean stiffness)
    du/dt  = -grad (p - mu/3 div u) / rho + (mu / rho) lap u - (u - w) . grad u + alpha c h P u
    rho    = rho0 + p / c^2.

c is a numerical sound speed; the sealed chamber makes it a compliance, so its error in the apex peak goes as c^-2
(unless the mean pressure has a sound speed of its own, below).

Node motion. A node keeps its share of the height between the rigid back (0) and the cornea point above it (1) and takes
that share of the cornea's displacement there. The map is smooth, the limbus wedge and the back stay put, and the nodes
keep their neighbours through the whole puff, so stencils are chosen once and only their weights are rebuilt.

Walls. Cornea: the normal velocity is the membrane's (slip) or the whole velocity is (no slip). Rigid back and axis:
nodes slide along, corners stay. The pressure of wall nodes follows from the same continuity equation with their
one-sided stencils, so nothing is extrapolated.

Stabilisation. alpha c h P (`taichi_eye.mfpm.operators`) acts on p and u at every node: a term of third order in h.
Largest growth rates of the semi-discrete coupled system at rest, in c/h (h = 0.25 mm, c = 100 m/s, quadratic basis, 14
neighbours): alpha 0: 0.14, 0.1: 0.09, 0.2: 0.04, 0.3: 2e-6, 0.5: 1.5e-6; p or u alone at alpha 0.3: 0.06. Damping only
the velocity difference along each pair, as a Riemann solver does, leaves vortical modes that grow by 30-130/s. What is
left at alpha 0.5 is the first coupled mode itself, growing by 0.6/s. Its price at alpha 0.5, damping of the first three
coupled modes (309, 550, 804 Hz): none, 19/s, 133/s at h 0.25 mm and none, 4/s, 40/s at 0.18 mm.

Mass fix. Collocation does not conserve mass to rounding, and in a sealed chamber a volume error is a pressure error.
The mean pressure has a known value at every instant, rho0 c_m^2 (V0/V - 1) with V the volume under the membrane. The
membrane's place at the end of a step is known at its start, so each step adds the uniform pressure that continuity is
not going to bring. It converges to nothing with h and leaves all other modes alone.

Two sound speeds. The mean pressure need not be as soft as the waves: c_m (`mean_sound_speed_m_s`) is its own number,
and c's compliance of the sealed chamber goes with it. No wave travels at c_m; the explicit part of its stiffness rings
with the wall's mass, which limits the step only beyond some 8 c (`taichi_eye.solver.timestep`). Apex peak of the
default eye, h 0.2 mm, against the converged 0.959 mm: c 40 +0.93 %, c 20 +3.1 %; with c_m 160: c 40 +0.24 %, c 20
+0.26 %. What is left of c is the inertia of its waves: the first radial one of the chamber is 2 kHz at c 20, the puff
below 0.2 kHz. Correcting by the change of volume of the last step instead of the coming one blows up at half of the
c_m (c 20: at 160, not at 320).

Open chamber. To ask what the sealed volume does, fluid may leave: a sink of uniform rate q [1/s] takes it with the
velocity and the pressure it has, so momentum keeps its equation and continuity becomes
    dp/dt = -(rho0 c^2 + p)(div u + q) + ...,    q = -(dV/dt) / V  from the wall's velocity of the same step,
which holds the mean excess pressure at zero (the mass fix then removes what collocation leaves of it). The leaving
fluid carries off q (rho u^2/2 + p + elastic energy) per volume and time, and does the work IOP (V0 - V) outside.
"""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.cloud.packing import FIXED, FREE, SLIDE, WALL, Cloud
from taichi_eye.eye.eye import Eye
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.mfpm.neighbours import NeighbourLists
from taichi_eye.mfpm.operators import CONDITION_LIMIT, SEARCH_RADIUS, STENCIL, WIDTH, MfpmOperators
from taichi_eye.solver.globe import Globe
from taichi_eye.solver.scheme import Scheme
from taichi_eye.solver.team import ALONE

CORNERS = 12  # triangles that may meet in a node


@ti.data_oriented
class Aqueous:
    """Nodes of the aqueous humour in fields; the first `wall_count` of an eye are its cornea's, in its order.

    capacity: nodes of all eyes (see `NeighbourLists`); an eye's triangles start at twice the number of its first node.
    place [m], velocity [m/s], pressure (excess over the IOP) [Pa], volume of a node's ring [m^3]. planar: a plane flow
    in (x, z) instead, volumes per metre of depth; verification problems use it.
    """

    def __init__(self, capacity: int, basis: str, planar: bool = False, eyes: int = 1):
        fp = real()
        self.capacity, self.basis, self.planar = capacity, basis, planar
        self.nodes = np.zeros(eyes, dtype=int)  # of each eye
        self.neighbours = NeighbourLists(capacity, WIDTH[basis], planar, eyes)
        self.operators = MfpmOperators(self.neighbours, basis)
        # the dissipation stays on the quadratic basis, whichever basis the equations take
        self.smoother = self.operators if basis == "quadratic" else MfpmOperators(self.neighbours, "quadratic")
        self.first, self.count = self.neighbours.first, self.neighbours.count
        self.wall_count, self.no_slip = ti.field(ti.i32, eyes), ti.field(ti.i32, eyes)
        self.sealed, self.outflow = ti.field(ti.i32, eyes), ti.field(fp, eyes)  # q [1/s], 0 where sealed
        vector = lambda: ti.Vector.field(2, fp, capacity)
        scalar = lambda: ti.field(fp, capacity)
        self.rest, self.place, self.velocity, self.slide = (vector() for _ in range(4))
        self.divergence, self.pressure, self.roughness_work, self.laplacian = scalar(), scalar(), scalar(), vector()
        self.volume, self.wall_fraction, self.height_fraction = (ti.field(fp) for _ in range(3))
        self.kind, self.wall_index = ti.field(ti.i32), ti.field(ti.i32)
        self.viscous_loss, self.numerical_loss = ti.field(fp), ti.field(fp)
        # what a pass reads together lies together: fewer streams from memory at once
        for together in (
            (self.viscous_loss, self.numerical_loss),
            (self.volume, self.wall_fraction, self.height_fraction, self.kind, self.wall_index),
        ):
            ti.root.dense(ti.i, capacity).place(*together)
        self.velocity_gradient = ti.Matrix.field(2, 2, fp, capacity)
        self.slopes = self.velocity_gradient
        if basis != "quadratic":
            self.slopes, self.pressure_gradient = ti.Matrix.field(2, 2, fp, capacity), vector()
        # what the two passes of a step gather from a node, laid side by side so that a neighbour is one access to
        # memory:
        # momentum_row (p - mu/3 div u, and u less its slope) by `kick`, continuity_row (p and its gradient) by
        # `compress`
        self.momentum_row, self.continuity_row = (ti.Vector.field(4, fp, capacity) for _ in range(2))
        self.outflow_loss = scalar()
        self.triangle_count = ti.field(ti.i32, eyes)
        self.triangle = ti.field(ti.i32, (2 * capacity, 3))
        self.rest_area = ti.field(fp, 2 * capacity)
        self.corner = ti.field(ti.i32, (capacity, CORNERS))
        self.corner_count = ti.field(ti.i32, capacity)
        self.density0, self.viscosity, self.sound_speed, self.mean_speed = (ti.field(fp, eyes) for _ in range(4))
        self.dissipation_length = ti.field(fp, eyes)  # alpha c h [m^2/s]
        self.rest_volume, self.last_volume = ti.field(fp, eyes), ti.field(fp, eyes)
        self.globe = Globe(eyes)
        self.pressure_shift = ti.field(fp, eyes)

    def evolving(self) -> dict:
        """The fields of nodes that evolve and that a step reads, by name (`taichi_eye.solver.state`)."""
        names = [
            "velocity",
            "pressure",
            "laplacian",
            "divergence",
            "velocity_gradient",
            "momentum_row",
            "continuity_row",
        ]
        names += ["viscous_loss", "numerical_loss", "outflow_loss"]
        if self.basis != "quadratic":
            names += ["slopes", "pressure_gradient"]
        return {f"aqueous_{name}": getattr(self, name) for name in names}

    def evolving_of_eyes(self) -> dict:
        """The same of eyes."""
        return {
            "outflow": self.outflow,
            "last_volume": self.last_volume,
            "pressure_shift": self.pressure_shift,
            **self.globe.evolving(),
        }

    def build(self, cloud: Cloud, eye: Eye, scheme: Scheme, number: int = 0, first: int = 0) -> None:
        """Place the nodes of an eye, and its globe behind them, at rest; number: of the eye, first: of its first
        node."""
        self.setup(
            cloud,
            density=eye.liquid.density,
            viscosity=eye.liquid.viscosity,
            sound_speed=scheme.sound_speed,
            dissipation=scheme.dissipation,
            no_slip=scheme.no_slip,
            sealed=eye.liquid.sealed,
            mean_speed=scheme.mean_sound_speed,
            eye=number,
            first=first,
        )
        self.globe.build(eye, number)

    def setup(
        self,
        cloud: Cloud,
        *,
        density: float,
        viscosity: float,
        sound_speed: float,
        dissipation: float,
        no_slip: bool = False,
        sealed: bool = True,
        mean_speed: float | None = None,
        stencil: int | None = None,
        eye: int = 0,
        first: int = 0,
    ) -> None:
        """Place the nodes of one eye at rest, choose their stencils and compute all weights (SI units).

        mean_speed: the mean pressure's sound speed (default: the waves'); stencil: neighbours wanted per node; the
        basis has its own number. The globe behind is rigid (`Globe.build` says otherwise). Several eyes are set up in
        their order, each from the node after the last one's on.
        """
        self.nodes[eye] = count = cloud.count
        corner = np.zeros((count, CORNERS), dtype=np.int32)
        corners = np.zeros(count, dtype=np.int32)
        for t, nodes in enumerate(cloud.triangles):
            for node in nodes:
                corner[node, corners[node]] = t
                corners[node] += 1
        self._load(
            cloud.points,
            cloud.kind,
            cloud.direction,
            cloud.wall_index,
            cloud.wall_fraction,
            cloud.height_fraction,
            corner,
            corners,
            first,
        )
        self._load_chamber(
            triangles=cloud.triangles,
            wall_count=cloud.wall_count,
            volume=cloud.section.volume(),
            density=density,
            viscosity=viscosity,
            sound_speed=sound_speed,
            dissipation_length=dissipation * sound_speed * cloud.spacing,
            no_slip=no_slip,
            sealed=sealed,
            mean_speed=mean_speed or sound_speed,
            eye=eye,
            first=first,
        )
        self.neighbours.search(self.place, count, SEARCH_RADIUS[self.basis] * cloud.spacing, eye, first)
        self.operators.choose_stencils(self.place, stencil or STENCIL[self.basis], CONDITION_LIMIT[self.basis], eye)
        if self.smoother is not self.operators:
            self.smoother.choose_stencils(self.place, STENCIL["quadratic"], CONDITION_LIMIT["quadratic"], eye)
        self._measure_volumes((np.arange(len(self.nodes)) == eye).astype(np.int32))
        self._remember_areas(eye)

    @ti.kernel
    def _load(
        self,
        points: ti.types.ndarray(),
        kind: ti.types.ndarray(),
        direction: ti.types.ndarray(),
        wall_index: ti.types.ndarray(),
        wall_fraction: ti.types.ndarray(),
        height_fraction: ti.types.ndarray(),
        corner: ti.types.ndarray(),
        corner_count: ti.types.ndarray(),
        first: int,
    ):
        for n in range(points.shape[0]):
            i = first + n
            zero = ti.Vector([0.0, 0.0])
            self.rest[i] = ti.Vector([points[n, 0], points[n, 1]])
            self.place[i] = self.rest[i]
            self.kind[i], self.slide[i] = kind[n], ti.Vector([direction[n, 0], direction[n, 1]])
            self.wall_index[i], self.wall_fraction[i] = first + wall_index[n], wall_fraction[n]
            self.height_fraction[i] = height_fraction[n]
            self.corner_count[i] = corner_count[n]
            for k in range(CORNERS):
                self.corner[i, k] = 2 * first + corner[n, k]
            self.velocity[i], self.laplacian[i] = zero, zero
            self.pressure[i], self.divergence[i] = 0.0, 0.0
            self.velocity_gradient[i] = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            self.slopes[i] = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            self.momentum_row[i] = ti.Vector([0.0, 0.0, 0.0, 0.0])
            self.continuity_row[i] = ti.Vector([0.0, 0.0, 0.0, 0.0])
            self.viscous_loss[i], self.numerical_loss[i], self.roughness_work[i] = 0.0, 0.0, 0.0
            self.outflow_loss[i] = 0.0

    @ti.kernel
    def _load_chamber(
        self,
        triangles: ti.types.ndarray(),
        wall_count: int,
        volume: float,
        density: float,
        viscosity: float,
        sound_speed: float,
        dissipation_length: float,
        no_slip: int,
        sealed: int,
        mean_speed: float,
        eye: int,
        first: int,
    ):
        # one task, since each costs compile time
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.wall_count[eye], self.triangle_count[eye] = wall_count, triangles.shape[0]
            self.rest_volume[eye], self.last_volume[eye], self.pressure_shift[eye] = volume, volume, 0.0
            self.density0[eye], self.viscosity[eye], self.sound_speed[eye] = density, viscosity, sound_speed
            self.dissipation_length[eye], self.no_slip[eye] = dissipation_length, no_slip
            self.sealed[eye], self.outflow[eye] = sealed, 0.0
            self.globe.rest(eye, 0.0, 0.0, ti.math.inf)
            self.mean_speed[eye] = mean_speed
            for t in range(triangles.shape[0]):
                for k in ti.static(range(3)):
                    self.triangle[2 * first + t, k] = first + triangles[t, k]

    def rebuild(self, due=None) -> None:
        """Recompute operator weights and node volumes at the current places, for the eyes in the mask `due` [eyes]."""
        due = self.neighbours.everyone() if due is None else due
        self.operators.rebuild(self.place, due)
        if self.smoother is not self.operators:
            self.smoother.rebuild(self.place, due)
        self._measure_volumes(due)

    @ti.func
    def triangle_area(self, t):
        """Signed area [m^2] of triangle t; negative once nodes have crossed."""
        a, b, c = (self.place[self.triangle[t, 0]], self.place[self.triangle[t, 1]], self.place[self.triangle[t, 2]])
        return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    @ti.kernel
    def _remember_areas(self, eye: int):
        for t in range(2 * self.first[eye], 2 * self.first[eye] + self.triangle_count[eye]):
            self.rest_area[t] = self.triangle_area(t)

    @ti.kernel
    def _measure_volumes(self, due: ti.types.ndarray()):
        for i in range(self.neighbours.total[None]):
            if due[self.neighbours.eye_of[i]] == 1:
                self.volume[i] = self.volume_of(i)
                self.lay_momentum_row(i, self.momentum_row[i][0])

    @ti.func
    def volume_of(self, i):
        """Volume [m^3] of the ring of node i: a third of its triangles."""
        volume = 0.0
        for k in range(self.corner_count[i]):
            t = self.corner[i, k]
            radii = (
                self.place[self.triangle[t, 0]][0]
                + self.place[self.triangle[t, 1]][0]
                + self.place[self.triangle[t, 2]][0]
                + self.place[i][0]
            )
            if ti.static(self.planar):
                volume += self.triangle_area(t) / 3.0
            else:
                volume += 2.0 * ti.math.pi * self.triangle_area(t) * radii / 12.0
        return volume

    @ti.func
    def wall_share(self, i, wall_field: ti.template()):
        """The share of node i in a vector field on the cornea's nodes (displacement or velocity)."""
        k, f = self.wall_index[i], self.wall_fraction[i]
        return self.height_fraction[i] * ((1.0 - f) * wall_field[k] + f * wall_field[k + 1])

    @ti.func
    def move_node(self, i, wall_rest: ti.template(), wall_place: ti.template()):
        """Place node i under the current cornea."""
        k, f = self.wall_index[i], self.wall_fraction[i]
        shift = (1.0 - f) * (wall_place[k] - wall_rest[k]) + f * (wall_place[k + 1] - wall_rest[k + 1])
        self.place[i] = self.rest[i] + self.height_fraction[i] * shift

    @ti.func
    def density(self, eye, i):
        """Density [kg/m^3] of node i from its pressure."""
        return self.density0[eye] + self.pressure[i] / self.sound_speed[eye] ** 2

    @ti.func
    def find_velocity_gradient(self, eye, i):
        """All that a step takes over from the one before, from pressure and velocity: what the first step starts
        from."""
        self.velocity_gradient[i] = self.operators.velocity_gradient_at(i, self.velocity)
        self.laplacian[i] = self.operators.velocity_laplacian_at(i, self.place, self.velocity)
        self.divergence[i] = self.operators.divergence_from(i, self.place, self.velocity, self.velocity_gradient[i])
        if ti.static(self.basis != "quadratic"):
            self.slopes[i] = self.smoother.velocity_gradient_at(i, self.velocity)
        self.lay_momentum_row(i, self.pressure[i] - self.viscosity[eye] / 3.0 * self.divergence[i])

    @ti.func
    def lay_momentum_row(self, i, potential):
        """Lay out what `kick` gathers from node i; potential: p - mu/3 div u [Pa]."""
        self.momentum_row[i] = self.smoother.row_of_velocity(i, potential, self.velocity[i], self.slopes[i])

    @ti.func
    def differentiate_pressure(self, i):
        """P u [1/(m s)] at node i (see `taichi_eye.mfpm.operators`); keeps the gradient of p - mu/3 div u."""
        smooth, rough = self.smoother.gradient_and_roughness(i, self.momentum_row, self.slopes)
        self.continuity_row[i] = self.smoother.row_of_scalar(i, self.momentum_row[i][0], smooth)
        if ti.static(self.basis != "quadratic"):
            self.pressure_gradient[i] = self.operators.gradient_of_first(i, self.momentum_row)
        return rough

    @ti.func
    def driving_gradient(self, i):
        """The gradient of p - mu/3 div u that drove node i."""
        gradient = ti.Vector([self.continuity_row[i][1], self.continuity_row[i][2]])
        if ti.static(self.basis != "quadratic"):
            gradient = self.pressure_gradient[i]
        return gradient

    @ti.func
    def differentiate_velocity(self, i):
        """Gradient and Laplacian of the velocity, kept, and P p [Pa/m^2] of the pressure that drove it."""
        rough = 0.0
        if ti.static(self.basis == "quadratic"):
            self.velocity_gradient[i], self.laplacian[i], rough = self.operators.derivatives_and_roughness(
                i, self.place, self.velocity, self.continuity_row
            )
        else:
            self.velocity_gradient[i] = self.operators.velocity_gradient_at(i, self.velocity)
            self.laplacian[i] = self.operators.velocity_laplacian_at(i, self.place, self.velocity)
            self.slopes[i], unused, rough = self.smoother.derivatives_and_roughness(
                i, self.place, self.velocity, self.continuity_row
            )
        return rough

    @ti.func
    def kick(self, eye, i, dt, wall_velocity: ti.template()):
        """Momentum: the velocity of node i half a step later. Its neighbours do not read it, so it may take its
        place."""
        rough = self.dissipation_length[eye] * self.differentiate_pressure(i)
        rho = self.density(eye, i)
        before = self.velocity[i]
        slip = before - self.wall_share(i, wall_velocity)
        gradient = self.velocity_gradient[i]
        carried = ti.Vector(
            [gradient[0, 0] * slip[0] + gradient[0, 1] * slip[1], gradient[1, 0] * slip[0] + gradient[1, 1] * slip[1]]
        )
        push = (self.viscosity[eye] * self.laplacian[i] - self.driving_gradient(i)) / rho - carried + rough
        velocity = before + dt * push
        felt = rough
        if self.kind[i] != FREE:
            if self.kind[i] == SLIDE:
                velocity = self.slide[i] * self.slide[i].dot(velocity)
                if self.no_slip[eye] == 1 and self.place[i][0] > 0.0:
                    velocity = ti.Vector([0.0, 0.0])
            elif self.kind[i] == FIXED:
                velocity = ti.Vector([0.0, 0.0])
            if self.no_slip[eye] == 1:
                # the wall sets this velocity
                felt = ti.Vector([0.0, 0.0])
        self.velocity[i] = velocity
        self.roughness_work[i] = -0.5 * dt * rho * (velocity + before).dot(felt)

    @ti.func
    def meet_wall(self, eye, i, wall_place: ti.template(), wall_velocity):
        """The velocity of wall node i once the cornea moves with `wall_velocity` there."""
        velocity = wall_velocity
        if self.no_slip[eye] == 0 and i > self.first[eye] and self.kind[i] == WALL:
            along = (wall_place[i + 1] - wall_place[i - 1]).normalized()
            normal = ti.Vector([-along[1], along[0]])
            velocity = self.velocity[i] + normal * normal.dot(wall_velocity - self.velocity[i])
        return velocity

    @ti.func
    def pressure_rate(self, eye, i, divergence, rough, wall_velocity: ti.template()):
        """dp/dt [Pa/s] of node i with its velocity's divergence and its P p given."""
        slip = self.velocity[i] - self.wall_share(i, wall_velocity)
        return (
            self.dissipation_length[eye] * rough
            - slip.dot(self.driving_gradient(i))
            - (self.density0[eye] * self.sound_speed[eye] ** 2 + self.pressure[i]) * (divergence + self.outflow[eye])
        )

    @ti.func
    def compress(self, eye, i, dt, wall_velocity: ti.template()):
        """Continuity: the pressure of node i at the end of the step, from the velocity in its middle.

        Also what the dissipation of pressure, viscosity and outflow have taken.
        """
        rough = self.differentiate_velocity(i)
        g, before = self.velocity_gradient[i], self.pressure[i]
        divergence = self.operators.divergence_from(i, self.place, self.velocity, g)
        self.pressure[i] += dt * self.pressure_rate(eye, i, divergence, rough, wall_velocity) + self.pressure_shift[eye]
        self.lay_momentum_row(i, self.pressure[i] - self.viscosity[eye] / 3.0 * divergence)
        hoop = divergence - g[0, 0] - g[1, 1]
        squares = g[0, 0] ** 2 + g[1, 1] ** 2 + hoop**2 + 0.5 * (g[0, 1] + g[1, 0]) ** 2 - divergence**2 / 3.0
        self.viscous_loss[i] += dt * self.volume[i] * 2.0 * self.viscosity[eye] * squares
        self.numerical_loss[i] += self.volume[i] * (
            self.roughness_work[i]
            - dt * before * self.dissipation_length[eye] * rough / (self.density0[eye] * self.sound_speed[eye] ** 2)
        )
        if self.sealed[eye] == 0:
            rho = self.density(eye, i)
            self.outflow_loss[i] += (
                dt
                * self.outflow[eye]
                * self.volume[i]
                * (0.5 * rho * self.velocity[i].norm_sqr() + self.pressure[i] + rho * self.stored_at(eye, i))
            )

    @ti.func
    def pressure_sums(self, eye, part, parts):
        """Sums over an eye's nodes of volume times pressure [J] and of volume [m^3]: the share of one of so many parts,
        every so many'th four nodes."""
        first, count = self.first[eye], self.count[eye]
        # four sums side by side: one alone waits for its last addition
        totals, weights = ti.Vector([0.0, 0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0, 0.0])
        for k in range((count // 4 - part + parts - 1) // parts):
            i = first + 4 * (k * parts + part)
            shares = ti.Vector([self.volume[i], self.volume[i + 1], self.volume[i + 2], self.volume[i + 3]])
            totals += shares * ti.Vector(
                [self.pressure[i], self.pressure[i + 1], self.pressure[i + 2], self.pressure[i + 3]]
            )
            weights += shares
        total, weight = totals.sum(), weights.sum()
        if part == 0:
            for i in range(first + count - count % 4, first + count):
                total += self.volume[i] * self.pressure[i]
                weight += self.volume[i]
        return total, weight

    @ti.func
    def missing_pressure(self, eye, volume, dt):
        """What `add_pressure` says at the mean pressure that an eye's nodes have."""
        total, weight = self.pressure_sums(eye, 0, 1)
        return self.add_pressure(eye, volume, dt, total / weight)

    @ti.func
    def add_pressure(self, eye, volume, dt, present):
        """The uniform pressure [Pa] to add in the step of dt [s] that ends with the chamber at its volume [m^3].

        Continuity is going to bring the liquid's own stiffness times the change of volume; what that and the present
        mean lack of the mean pressure that the volume stands for is added. In an open chamber that mean is zero. What
        the rest of the globe takes up (`taichi_eye.solver.globe`) has left, from everywhere alike.
        """
        mean, coming = 0.0, 0.0
        if self.sealed[eye] == 1:
            stiffness = self.density0[eye] * self.mean_speed[eye] ** 2
            followed = self.globe.followed(eye, dt)
            held = (1.0 - followed) * self.globe.taken_up[eye]
            mean = self.globe.pressure_for(eye, followed, volume / stiffness, self.rest_volume[eye] - held - volume)
            self.globe.take_up(eye, followed, mean)
            coming = self.density0[eye] * self.sound_speed[eye] ** 2 * (self.last_volume[eye] / volume - 1.0)
        self.last_volume[eye] = volume
        return mean - coming - present

    @ti.func
    def stored_at(self, eye, i):
        """Elastic energy [J/kg] of node i relative to rest: the integral of p / rho^2 d rho, without the IOP."""
        c2 = self.sound_speed[eye] ** 2
        ratio = self.pressure[i] / (self.density0[eye] * c2)
        # ln(1 + x) - x / (1 + x), by its series where the difference would cancel
        stored = ti.log(1.0 + ratio) - ratio / (1.0 + ratio)
        if ti.abs(ratio) < 0.01:
            stored = ratio * ratio * (0.5 - ratio * (2.0 / 3.0 - ratio * (0.75 - 0.8 * ratio)))
        return c2 * stored

    @ti.func
    def energies(self, eye, volume):
        """Kinetic energy and elastic energy relative to rest [J] of an eye's liquid; the IOP's part is left out."""
        kinetic, elastic, weight = self.energy_sums(eye, ALONE, 0)
        return kinetic * volume / weight, elastic * volume / weight

    @ti.func
    def energy_sums(self, eye, team: ti.template(), lane):
        """Both over the nodes' own volumes, and these [m^3]: a lane's share."""
        kinetic, elastic, weight = 0.0, 0.0, 0.0
        start, end = team.share(self.first[eye], self.first[eye] + self.count[eye], lane)
        for i in range(start, end):
            rho = self.density(eye, i)
            kinetic += 0.5 * rho * self.volume[i] * self.velocity[i].norm_sqr()
            elastic += rho * self.volume[i] * self.stored_at(eye, i)
            weight += self.volume[i]
        return kinetic, elastic, weight
