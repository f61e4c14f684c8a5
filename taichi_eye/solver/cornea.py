"""The cornea: an axisymmetric exponential-hyperelastic membrane by finite differences in the material angle.

The tissue is a law of `taichi_eye.eye.laws`, W(e1, e2) per reference volume, with

    lam1 = |x'| / R,  lam2 = r / (R sin th),  E_i = (lam_i^2 - 1) / 2,  e_i = E_i + eps0,  S_i = dW/dE_i,

E the Green-Lagrange strain from the pressurised state and eps0 the prestrain that carries the IOP at rest.

Discretisation. Two-point differences on a uniform grid in the angle: stretch and stress live on the elements between
nodes, with lam1 = |dx| / |dX| and lam2 = (r_i + r_{i+1}) / (R_i + R_{i+1}). The nodal force is minus the derivative of
the summed energy h A_e W(E1, E2), so the tangent is symmetric, the elastic energy is a state function, and the axis
(r = 0, z' = 0) needs no special case. Homogeneous stretch x = lam X gives exact strains. Pressure, puff and inertia of
a node act on its ring, half an element to either side: the force is p_i dV/dx_i with V = sum pi r_m^2 dz the volume by
the midpoint rule (r_m between nodes), so a uniform pressure does exactly p dV of work.

Rings, not the hat functions of finite elements: those load the apex with h^2/6 of the radius integral where its ring
has h^2/8, and that point load makes a logarithmic spike, an apex that converges at order 1.3-1.7 only. With rings, 32 /
64 / 128 elements put the apex of the default eye 0.22 / 0.056 / 0.014 % deep under the peak load of the puff: order
1.98.

Bending, where the scene asks for it: a shell instead of a membrane. With phi the inclination of an element, the changes
of curvature from rest are (phi_k - phi_k-1) / L at the nodes and (sin phi - sin phi0) / R_k on the elements, and
W_b = D/2 (dk1^2 + dk2^2) per area, D = E h^3 / (12 (1 - nu^2)). Kirchhoff's mixed term, D nu dk1 dk2, is left out: its
integral depends on the rim alone. The rim is a hinge.

Transverse shear, where the scene asks for it: the sections of the wall do not turn with it (a frozen director), since
turning them bends, which at the width of a dent is far stiffer than shear. Lamellae that keep their length and their
thickness while what stood across them stays as it was slide over one another by gamma = tan(phi - phi0) per thickness.
With kappa G the modulus of that simple shear, per area at rest

    W_s = (kappa G h / 2) gamma^2,   and a viscous part of the stress, kappa G delay d gamma/dt,

whose work is lost. A step takes the viscous part from the change over the step before, which limits the step
(`taichi_eye.solver.timestep`). Relaxation leaves shear alone.

Relaxation, where the scene asks for it: quasi-linear viscoelasticity (Fung), one relaxation time. On the elastic stress
S comes an overstress q, dq/dt = g dS/dt - q / tau: a sudden stretch meets 1 + g times the slow stiffness, a slow one
none of it, and in between motion is damped, at most by tan(delta) = (g/2) / sqrt(1 + g) at a period of 2 pi tau sqrt(1
+ g). Moments of bending carry the same. A step takes the exact answer to a stress that changes evenly over it,

    q_n+1 = e^(-dt/tau) q_n + g (1 - e^(-dt/tau)) (tau/dt) (S_n+1 - S_n),

so tau sets no limit to the step; only the waves are faster, by sqrt(1 + g). The work done against the overstress is
summed by the trapezoidal rule and closes the energy balance; what of it has not yet become heat is not told apart. A
dashpot alone (Kelvin-Voigt) would limit the step to L^2 rho / (2 eta), a fiftieth of the acoustic one for the damping
wanted.

Rest. The discrete sphere is in equilibrium with the IOP up to O(h^2); that remainder is computed once at the reference
and subtracted as a dead load, so that a scene without a puff stays at rest to rounding.

Units are SI: m, s, Pa, N, J. Forces and masses are those of full rings (2 pi r).
"""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.eye import jet
from taichi_eye.eye.eye import Eye
from taichi_eye.eye.laws import LAWS, Law
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver import rings
from taichi_eye.solver.team import ALONE

# squared frequency of the stiffest discrete wave of tension or shear, which sits at the apex, over speed^2 / L^2: a
# strip has 4
STIFFEST_SHEAR = 4.842


@ti.data_oriented
class Cornea:
    """Membrane nodes and elements in fields; capacity counts nodes, of all eyes where there are several.

    Eye e owns the nodes first[e] to last[e]; element k joins nodes k and k + 1.

    place, velocity, acceleration: [m], [m/s], [m/s^2]; rest: reference places; force_air, force_solid: forces [N] of
    the air and of everything else but the fluid's excess pressure; stress: S1, S2 of each element [Pa].

    What reads or moves a whole wall takes a team and a lane of it (`taichi_eye.solver.team`) and does, or sums, that
    lane's share: everything where nobody else is there, as by default.

    Verification problems change three things. law: another tissue. rim: "clamped" (the limbus), "sliding_r" or
    "sliding_z" (a symmetry plane in which the last node moves along r or along z). planar: a strip of unit depth in
    (x, z), without hoop strain.
    """

    def __init__(
        self,
        capacity: int,
        law: Law = LAWS["exponential"],
        rim: str = "clamped",
        planar: bool = False,
        eyes: int = 1,
    ):
        fp = real()
        self.capacity, self.rim, self.planar = capacity, rim, planar
        self.law = law.text(ti, ti.func)
        self.element_volume_under, self.ring_share = rings.text(ti.func)
        self.first, self.last = ti.field(ti.i32, eyes), ti.field(ti.i32, eyes)
        vector = lambda: ti.Vector.field(2, fp, capacity)
        scalar = lambda: ti.field(fp, capacity)
        self.rest, self.place, self.velocity, self.acceleration = vector(), vector(), vector(), vector()
        self.residual, self.lost = vector(), vector()
        self.force_solid, self.force_air, self.tension = vector(), vector(), vector()
        self.mass, self.hoop, self.load_shape, self.air_pressure = scalar(), scalar(), scalar(), scalar()
        self.element_length, self.element_radius, self.element_volume = scalar(), scalar(), scalar()
        self.prestrain, self.rest_angle = scalar(), vector()
        self.flexure = vector()  # of the node at an element's start, and of the element [J]
        self.flexible = ti.field(ti.i32, eyes)
        self.inclination = vector()  # angle of each element and its sine; rest_angle: the same at rest
        self.moment = vector()  # as flexure
        # of transverse shear: stiffness of each element, its gamma, its viscous and its whole derivative by gamma [J]
        self.shear, self.slide, self.overshear, self.shear_torque = (scalar() for _ in range(4))
        self.shear_delay = ti.field(fp, eyes)
        self.curvature, self.narrowing, self.mean_over_ring = jet.text(ti, ti.func)
        self.load_rate, self.dent_feedback = ti.field(fp, eyes), ti.field(fp, eyes)
        self.ring_edge = scalar()  # radius at rest at which the ring of a node ends [m]
        self.chord, self.chord_share = ti.field(ti.i32, eyes), ti.field(fp, eyes)
        self.stress, self.strain = vector(), vector()
        self.overstress, self.overmoment = vector(), vector()
        self.relaxation, self.relaxed_work = ti.Vector.field(2, fp, eyes), ti.field(fp, eyes)  # g, tau [s]; work [J]
        self.material = ti.Vector.field(law.size, fp, eyes)  # the law's coefficients
        self.iop, self.puff_work = ti.field(fp, eyes), ti.field(fp, eyes)
        self.half_step = ti.field(fp, eyes)  # of the last step [s]

    def evolving(self) -> dict:
        """The fields of nodes and elements that evolve and that a step reads, by name (`taichi_eye.solver.state`)."""
        names = ("place", "velocity", "acceleration", "lost", "force_air", "air_pressure", "stress", "strain")
        names += ("overstress", "overmoment", "slide", "overshear", "inclination")
        return {f"cornea_{name}": getattr(self, name) for name in names}

    def evolving_of_eyes(self) -> dict:
        """The same of eyes."""
        return {"relaxed_work": self.relaxed_work, "puff_work": self.puff_work, "half_step": self.half_step}

    def build(self, eye: Eye, elements: int, number: int = 0, first: int = 0) -> np.ndarray:
        """Place an eye's cornea of so many elements at rest; its nodes [elements + 1, 2] (m).

        number, first: of the eye and of its first node in the fields.
        """
        nodes = eye.section.cornea_nodes(elements)
        middle = 0.5 * (nodes[1:, 0] + nodes[:-1, 0])
        tissue, thickness = eye.cornea, eye.thickness(middle)
        self.setup(
            nodes,
            thickness=thickness,
            density=tissue.density,
            coefficients=tissue.coefficients,
            prestrain=eye.prestrain(middle),
            iop=eye.iop,
            load_shape=eye.puff.on_rings(nodes[:, 0], 1.0 / eye.section.radius),
            load_rate=eye.puff.radial_rate,
            dent_feedback=eye.puff.dent_feedback,
            rigidity=eye.rigidity(thickness),
            shear_stiffness=eye.shear_stiffness * thickness,
            shear_delay=tissue.shear_delay,
            overstress_share=tissue.overstress_share,
            relaxation_time=tissue.relaxation_time,
            eye=number,
            first=first,
        )
        return nodes

    def setup(
        self,
        nodes,
        *,
        thickness,
        density: float,
        coefficients,
        prestrain,
        iop: float,
        load_shape,
        load_rate: float = 0.0,
        dent_feedback: float = 0.0,
        rigidity=0.0,
        shear_stiffness=0.0,
        shear_delay: float = 0.0,
        overstress_share: float = 0.0,
        relaxation_time: float = 1.0,
        eye: int = 0,
        first: int = 0,
    ) -> None:
        """Place the membrane of one eye at rest, its nodes from `first` on.

        nodes [n, 2] (m), apex first; thickness (m); density (kg/m^3); coefficients of the tissue law; prestrain eps0;
        iop (Pa); load_shape [n]: the puff's pressure on each ring relative to its pressure on the axis, at rest;
        load_rate (1/m^2) and dent_feedback: of the puff that feels the dent (`taichi_eye.eye.jet`); rigidity: D (N m)
        and shear_stiffness: kappa G h (N/m), both 0 for a membrane; shear_delay (s): viscosity of the shear over its
        modulus; overstress_share g and relaxation_time tau (s). Thickness, eps0, D and the shear stiffness may be one
        number or one per element, [n - 1].
        """
        count = len(nodes)
        thickness = np.broadcast_to(np.asarray(thickness, dtype=float), count - 1)
        length = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        radius = 0.5 * (nodes[1:, 0] + nodes[:-1, 0])
        ring = np.zeros(count)
        # half an element on either side of a node
        ring[:-1] += thickness * np.pi * length * (0.75 * nodes[:-1, 0] + 0.25 * nodes[1:, 0])
        ring[1:] += thickness * np.pi * length * (0.25 * nodes[:-1, 0] + 0.75 * nodes[1:, 0])
        volume = thickness * 2.0 * np.pi * radius * length
        if self.planar:
            ring = 0.5 * (np.append(thickness * length, 0.0) + np.append(0.0, thickness * length))
            volume = thickness * length
        flexure = np.zeros((count - 1, 2))
        rigidity = np.broadcast_to(np.asarray(rigidity, dtype=float), count - 1)
        if rigidity[0] > 0.0:
            # nodes: D area / L^2, the apex with the disc inside half an element and its mirrored neighbour
            flexure[:, 0] = rigidity * 2.0 * np.pi * nodes[:-1, 0] / length
            flexure[0, 0] = rigidity[0] * np.pi
            flexure[:, 1] = rigidity * 2.0 * np.pi * length / radius
        angle = np.arctan2(-np.diff(nodes[:, 1]), np.diff(nodes[:, 0]))
        area = length if self.planar else 2.0 * np.pi * radius * length
        chord, chord_share = jet.chord_at(nodes[:, 0])
        self._load(
            nodes=np.ascontiguousarray(nodes),
            mass=density * ring,
            length=length,
            radius=radius,
            volume=volume,
            prestrain=np.array(np.broadcast_to(np.asarray(prestrain, dtype=float), length.shape)),
            flexure=flexure,
            angle=angle,
            shear=np.asarray(shear_stiffness, dtype=float) * area,
            load_shape=np.asarray(load_shape, dtype=float),
            ring_edge=jet.ring_edges(nodes[:, 0])[1:],
            coefficients=np.array(coefficients, dtype=float),
            iop=iop,
            share=overstress_share,
            time=relaxation_time,
            shear_delay=shear_delay,
            load_rate=load_rate,
            dent_feedback=dent_feedback,
            chord=chord,
            chord_share=chord_share,
            eye=eye,
            first=first,
        )
        self._store_rest_residual(eye)

    @ti.kernel
    def _load(
        self,
        nodes: ti.types.ndarray(),
        mass: ti.types.ndarray(),
        length: ti.types.ndarray(),
        radius: ti.types.ndarray(),
        volume: ti.types.ndarray(),
        prestrain: ti.types.ndarray(),
        flexure: ti.types.ndarray(),
        angle: ti.types.ndarray(),
        shear: ti.types.ndarray(),
        load_shape: ti.types.ndarray(),
        ring_edge: ti.types.ndarray(),
        coefficients: ti.types.ndarray(),
        iop: float,
        share: float,
        time: float,
        shear_delay: float,
        load_rate: float,
        dent_feedback: float,
        chord: int,
        chord_share: float,
        eye: int,
        first: int,
    ):
        # one task, since each costs compile time
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.first[eye], self.last[eye] = first, first + nodes.shape[0] - 1
            for c in ti.static(range(self.material.n)):
                self.material[eye][c] = coefficients[c]
            self.iop[eye], self.puff_work[eye], self.half_step[eye] = iop, 0.0, 0.0
            self.relaxation[eye], self.relaxed_work[eye] = ti.Vector([share, time]), 0.0
            self.shear_delay[eye], self.load_rate[eye], self.dent_feedback[eye] = shear_delay, load_rate, dent_feedback
            self.chord[eye], self.chord_share[eye] = first + chord, chord_share
            for n in range(nodes.shape[0]):
                i = first + n
                zero = ti.Vector([0.0, 0.0])
                self.rest[i] = ti.Vector([nodes[n, 0], nodes[n, 1]])
                self.place[i] = self.rest[i]
                self.mass[i], self.load_shape[i], self.air_pressure[i] = mass[n], load_shape[n], 0.0
                self.ring_edge[i] = ring_edge[n]
                self.velocity[i], self.acceleration[i], self.lost[i] = zero, zero, zero
                self.force_air[i], self.force_solid[i], self.residual[i] = zero, zero, zero
            for n in range(nodes.shape[0] - 1):
                k = first + n
                self.element_length[k], self.element_radius[k] = length[n], radius[n]
                self.element_volume[k], self.prestrain[k] = volume[n], prestrain[n]
                self.flexure[k] = ti.Vector([flexure[n, 0], flexure[n, 1]])
                self.rest_angle[k] = ti.Vector([angle[n], ti.sin(angle[n])])
                self.inclination[k] = self.rest_angle[k]
                self.strain[k] = ti.Vector([prestrain[n], prestrain[n]])
                zero = ti.Vector([0.0, 0.0])
                self.moment[k], self.overstress[k], self.overmoment[k] = zero, zero, zero
                self.shear[k], self.slide[k], self.overshear[k], self.shear_torque[k] = shear[n], 0.0, 0.0, 0.0
            self.flexible[eye] = ti.select(flexure[0, 1] > 0.0 or shear[0] > 0.0, 1, 0)

    @ti.func
    def hoop_stretch(self, k):
        """lam2 of element k."""
        if ti.static(self.planar):
            return 1.0
        else:
            return 0.5 * (self.place[k][0] + self.place[k + 1][0]) / self.element_radius[k]

    @ti.func
    def strain_of(self, k):
        """Shifted strains e1, e2 of element k."""
        edge = self.place[k + 1] - self.place[k]
        lam1_squared = edge.norm_sqr() / self.element_length[k] ** 2
        lam2 = self.hoop_stretch(k)
        shift = self.prestrain[k]
        return ti.Vector([0.5 * (lam1_squared - 1.0) + shift, 0.5 * (lam2 * lam2 - 1.0) + shift])

    @ti.func
    def deform(self, eye, dt):
        """Tensions of all elements of an eye at its present places, dt [s] after the last ones."""
        self.relaxed_work[eye] = self.deform_share(eye, dt, ALONE, 0)

    @ti.func
    def deform_share(self, eye, dt, team: ti.template(), lane):
        """The same by a lane, which gives the work [J] against overstress and viscosity: lane 0 with all that was done
        before."""
        first, last = self.first[eye], self.last[eye]
        start, end = team.share(first, last, lane)
        work = 0.0
        if lane == 0:
            work = self.relaxed_work[eye]
        share, time = self.relaxation[eye][0], self.relaxation[eye][1]
        # what is left of an overstress, and what of a change of stress is added
        kept, gain = 1.0, 0.0
        if share > 0.0 and dt > 0.0:
            kept = ti.exp(-dt / time)
            gain = share * (1.0 - kept) * time / dt
        if self.flexible[eye] != 0:
            before = ti.Vector([0.0, 0.0])  # turned by: now, and a step ago
            if ti.static(team.lanes > 1):
                if first < start and start < end:
                    rest = self.rest_angle[start - 1][0]
                    before = ti.Vector([self.angle_of(start - 1), self.inclination[start - 1][0]]) - rest
                # nobody overwrites an inclination of a step ago that another lane still asks for
                team.meet(eye)
            for k in range(start, end):
                old, rest, angle = self.inclination[k], self.rest_angle[k], self.angle_of(k)
                now = ti.Vector([angle, ti.sin(angle)])
                self.inclination[k] = now
                turned = ti.Vector([now[0] - rest[0], old[0] - rest[0]])
                bend = ti.Vector([turned[0] - before[0], now[1] - rest[1]])
                change = ti.Vector([bend[0] - (turned[1] - before[1]), now[1] - old[1]])
                before = turned
                over = kept * self.overmoment[k] + gain * self.flexure[k] * change
                work += 0.5 * (over + self.overmoment[k]).dot(change)
                self.overmoment[k], self.moment[k] = over, self.flexure[k] * bend + over
                if self.shear[k] > 0.0:
                    work += self._tilt(eye, k, turned[0], dt)
            # an element's torque asks for the moment of the next one
            team.meet(eye)
        for k in range(start, end):
            taken = self._stretch(eye, k, kept, gain)
            if gain > 0.0:
                work += taken
        return work

    @ti.func
    def angle_of(self, k):
        """Inclination of element k at its present place."""
        edge = self.place[k + 1] - self.place[k]
        return ti.atan2(-edge[1], edge[0])

    @ti.func
    def _tilt(self, eye, k, turned, dt):
        # what shear of element k asks of its gamma, dt after the last one; the work [J] against it
        slide, over = ti.tan(turned), 0.0
        change = slide - self.slide[k]
        if dt > 0.0:
            over = self.shear[k] * self.shear_delay[eye] * change / dt
        work = 0.5 * (over + self.overshear[k]) * change
        self.slide[k], self.overshear[k], self.shear_torque[k] = slide, over, self.shear[k] * slide + over
        return work

    @ti.func
    def _stretch(self, eye, k, kept, gain):
        # edge tension (N, along the edge, pulling node k outwards) and hoop force (N) of element k; the work [J]
        # against its overstress
        work = 0.0
        strain = self.strain_of(k)
        s1, s2 = self.law.stress(strain[0], strain[1], self.prestrain[k], self.material[eye])
        stress = ti.Vector([s1, s2])
        if gain > 0.0:
            change = stress - (self.stress[k] - self.overstress[k])
            over = kept * self.overstress[k] + gain * change
            work = 0.5 * self.element_volume[k] * (over + self.overstress[k]).dot(strain - self.strain[k])
            self.overstress[k] = over
            stress += over
        self.stress[k], self.strain[k] = stress, strain
        edge = self.place[k + 1] - self.place[k]
        self.tension[k] = edge * (self.element_volume[k] * stress[0] / self.element_length[k] ** 2)
        if ti.static(self.planar):
            self.hoop[k] = 0.0
        else:
            self.hoop[k] = self.element_volume[k] * stress[1] * self.hoop_stretch(k) * 0.5 / self.element_radius[k]
        if self.flexible[eye] != 0:
            # derivative of the energies of bending and shear with respect to the inclination [J]
            torque = self.moment[k][0] + self.moment[k][1] * ti.cos(self.inclination[k][0])
            torque += self.shear_torque[k] * self.slant(k)
            if k + 1 < self.last[eye]:
                torque -= self.moment[k + 1][0]
            self.tension[k] += ti.Vector([edge[1], -edge[0]]) * (torque / edge.norm_sqr())
        return work

    @ti.func
    def bending_energy(self, eye, team: ti.template() = ALONE, lane=0):
        """Energy of bending and shear [J], zero at rest; work against overmoments and viscosity is `relaxed_work`."""
        energy = 0.0
        if self.flexible[eye] != 0:
            before = 0.0
            start, end = team.share(self.first[eye], self.last[eye], lane)
            if ti.static(team.lanes > 1):
                if self.first[eye] < start and start < end:
                    before = self.angle_of(start - 1) - self.rest_angle[start - 1][0]
            for k in range(start, end):
                edge = self.place[k + 1] - self.place[k]
                turned = ti.atan2(-edge[1], edge[0]) - self.rest_angle[k][0]
                leant = -edge[1] / edge.norm() - self.rest_angle[k][1]
                energy += 0.5 * (self.flexure[k][0] * (turned - before) ** 2 + self.flexure[k][1] * leant**2)
                energy += 0.5 * self.shear[k] * ti.tan(turned) ** 2
                before = turned
        return energy

    @ti.func
    def spread_load(self, eye, team: ti.template() = ALONE, lane=0):
        """Spread the puff over the nodes of an eye at their present places, where the air feels the dent."""
        if self.dent_feedback[eye] > 0.0:
            first, k, share = self.first[eye], self.chord[eye], self.chord_share[eye]
            kappa = 0.0
            for end in ti.static(range(2)):
                at = self.place[k + end]
                kappa += ti.abs(1.0 - end - share) * self.curvature(self.place[first][1], at[0], at[1])
            narrow = self.narrowing(self.dent_feedback[eye], kappa)
            rate = self.load_rate[eye] * narrow * narrow
            start, end = team.share(first, self.last[eye] + 1, lane)
            inner = self.rest[first][0]
            if ti.static(team.lanes > 1):
                if first < start:
                    inner = self.ring_edge[start - 1]
            for i in range(start, end):
                self.load_shape[i] = self.mean_over_ring(rate, inner, self.ring_edge[i])
                inner = self.ring_edge[i]

    @ti.func
    def elastic_force(self, eye, i):
        """Internal force [N] on node i from the tensions of its elements."""
        force = ti.Vector([0.0, 0.0])
        if i > self.first[eye]:
            force -= self.tension[i - 1]
            force[0] -= self.hoop[i - 1]
        if i < self.last[eye]:
            force += self.tension[i]
            force[0] -= self.hoop[i]
        return force

    @ti.func
    def volume_gradient(self, eye, i):
        """Derivative [m^2] of the enclosed volume with respect to the place of node i: its ring's area vector."""
        gradient = ti.Vector([0.0, 0.0])
        if i > self.first[eye]:
            a, b = self.place[i - 1], self.place[i]
            if ti.static(self.planar):
                gradient += 0.5 * ti.Vector([a[1] - b[1], b[0] - a[0]])
            else:
                across, up = self.ring_share(a[0], a[1], b[0], b[1])
                gradient += ti.Vector([across, -up])
        if i < self.last[eye]:
            a, b = self.place[i], self.place[i + 1]
            if ti.static(self.planar):
                gradient += 0.5 * ti.Vector([a[1] - b[1], b[0] - a[0]])
            else:
                across, up = self.ring_share(a[0], a[1], b[0], b[1])
                gradient += ti.Vector([across, up])
        return gradient

    @ti.func
    def held(self, eye, i, vector):
        """The vector with what the supports take: no radial part at the apex, nothing at the limbus."""
        kept = vector
        if i == self.first[eye]:
            kept[0] = 0.0
        if i == self.last[eye]:
            if ti.static(self.rim == "sliding_r"):
                kept[1] = 0.0
            elif ti.static(self.rim == "sliding_z"):
                kept[0] = 0.0
            else:
                kept = ti.Vector([0.0, 0.0])
        return kept

    @ti.func
    def predict(self, eye, i, dt):
        """Explicit Newmark (beta 0): the place at the end of the step from the state at its start.

        The sum is compensated (Kahan): a step moves a node by less than f32 resolves at its place.
        """
        step = self.held(eye, i, dt * self.velocity[i] + 0.5 * dt * dt * self.acceleration[i]) - self.lost[i]
        moved = self.place[i] + step
        self.lost[i] = (moved - self.place[i]) - step
        self.place[i] = moved

    @ti.func
    def collect_forces(self, eye, i):
        """Forces of tissue, IOP, dead load and air on node i at the current place; the fluid's excess comes later."""
        ring = self.volume_gradient(eye, i)
        self.force_solid[i] = self.elastic_force(eye, i) + self.iop[eye] * ring - self.residual[i]
        self.force_air[i] = -self.air_pressure[i] * ring

    @ti.func
    def enclosed_volume(self, eye, place: ti.template(), team: ti.template() = ALONE, lane=0):
        """Volume [m^3] between a membrane at `place`, a field like its own, and the limbus plane."""
        volume = 0.0
        start, end = team.share(self.first[eye], self.last[eye], lane)
        for k in range(start, end):
            a, b = place[k], place[k + 1]
            if ti.static(self.planar):
                volume += 0.5 * (a[1] + b[1]) * (b[0] - a[0])
            else:
                volume += self.element_volume_under(a[0], a[1], b[0], b[1])
        return volume

    @ti.kernel
    def _store_rest_residual(self, eye: int):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.deform(eye, 0.0)
        ti.loop_config(serialize=True)
        for i in range(self.first[eye], self.last[eye] + 1):
            self.residual[i] = self.elastic_force(eye, i) + self.iop[eye] * self.volume_gradient(eye, i)

    @ti.func
    def elastic_energy(self, eye, team: ti.template() = ALONE, lane=0):
        """Stored energy [J] relative to rest is this minus its value at rest: tissue plus dead load."""
        energy = 0.0
        start, end = team.share(self.first[eye], self.last[eye], lane)
        for k in range(start, end):
            strain = self.strain_of(k)
            energy += self.element_volume[k] * self.law.energy(
                strain[0], strain[1], self.prestrain[k], self.material[eye]
            )
        start, end = team.share(self.first[eye], self.last[eye] + 1, lane)
        for i in range(start, end):
            energy += self.residual[i].dot(self.place[i] - self.rest[i])
        return energy + self.bending_energy(eye, team, lane)

    @ti.func
    def wave_speeds(self, eye, k):
        """Borne stress [Pa] of element k and the speeds [m/s] of in-plane waves (by the meridian's tangent) and
        transverse ones."""
        first = self.first[eye]
        strain, shift = self.strain_of(k), self.prestrain[k]
        along, mixed, hoop, shear = self.law.tangent(strain[0], strain[1], shift, self.material[eye])
        s1, s2 = self.law.stress(strain[0], strain[1], shift, self.material[eye])
        meridional = s1 + self.overstress[k][0]
        sudden = 1.0 + self.relaxation[eye][0]
        density = self.mass[first + 1] / (0.5 * (self.element_volume[first] + self.element_volume[first + 1]))
        stretch_squared = 2.0 * (strain[0] - shift) + 1.0
        # shear turns with 1/stretch, its stiffest wave, at the apex, is a fifth stiffer than that of a strip, and where
        # tilted it is stiffer by its tangent, (1 + gamma^2) (1 + 3 gamma^2), and couples both waves by at most half
        slant = self.slant(k)
        tilting = self.shear[k] * slant * (3.0 * slant - 2.0) / (self.element_volume[k] * stretch_squared)
        stiffness = sudden * along * stretch_squared + meridional + 0.5 * tilting
        return (
            self.borne_stress(eye, k),
            ti.sqrt(ti.max(stiffness, 0.0) / density),
            ti.sqrt(ti.max(meridional + 0.25 * STIFFEST_SHEAR * tilting, 0.0) / density),
        )

    @ti.func
    def slant(self, k):
        """1 + gamma^2 = d gamma / d phi of element k, as it was last deformed; 1 where nothing shears."""
        return 1.0 + self.slide[k] * self.slide[k]

    @ti.func
    def borne_stress(self, eye, k):
        """S1, S2 [Pa] of element k that a guard judges; of a shell without the overstress, as is the stress that
        buckles it."""
        stress = self.stress[k]
        if self.flexible[eye] != 0:
            stress -= self.overstress[k]
        return stress

    @ti.func
    def kinetic_energy(self, eye, team: ti.template() = ALONE, lane=0):
        """Kinetic energy of the membrane [J]."""
        energy = 0.0
        start, end = team.share(self.first[eye], self.last[eye] + 1, lane)
        for i in range(start, end):
            energy += self.kinetic_at(i, self.velocity[i], self.half_step[eye])
        return energy

    @ti.func
    def kinetic_at(self, i, velocity, half):
        """Kinetic energy [J] of node i at a step's end, from its velocity there: m v- . v+ / 2, the velocities half a
        step before and after. The leapfrog balances this with the trapezoids of the work exactly, whatever the step
        makes of a hard blow; m v^2 / 2 has dt^2 m a^2 / 8 more."""
        change = half * self.acceleration[i]
        return 0.5 * self.mass[i] * (velocity.norm_sqr() - change.norm_sqr())
