"""Reduced models: the cornea over a liquid that is not resolved in time. They have no acoustics and no acoustic time
step.

The membrane is that of `taichi_eye.solver.cornea`. Its ring i, of area vector G_i = dV/dx_i, feels the excess pressure
p_i:

membrane    p = 0: the IOP stays, whatever the chamber's volume (studies without fluid did that).
cavity      p = p0, uniform: the chamber is sealed and yields to pressure by its compliance alone.
added_mass  p from incompressible potential flow (`taichi_eye.solver.potential`), Bernoulli's equation on the moving
            nodes,

    p = p0 - rho [ N (G . a + dG/dt . v) + dN/dt Q + (phi_s^2 - v_n^2)/2 - v_s phi_s ],   Q = G . v,  phi = N Q on the
                                                                                          wall,

where s runs along the wall, v_n and v_s are the wall's velocity across and along. With a = (F + G p)/m and D = |G|^2/m
this is (1 + rho N D) p = p0 - rho [N (G . F/m + dG/dt . v) + ...]. N is refreshed once the wall has moved by
`numerics.refresh_travel` spacings; between refreshes it follows the wall's place along the way d between the last two,

    N = N_last + alpha (N_last - N_before),   alpha = (x - x_last) . d / d . d,

(its last known rate in time, tried before, went on while the wall stood still: after the snap of a shell N drifted
until it fed energy), and the inverse at the last refresh corrects the defect of the pressure of the step before, one
sweep per step. What is quadratic in the velocity is taken once per sample.

Volume. p0 is the multiplier of V(x) = V0 - C p0 at the END of the step, found by Newton's iteration to 1e-13 of V0, so
a stiff chamber costs no time step and its volume does not drift. C is the compliance of the globe
(`taichi_eye.solver.globe`, whose law and delay may make another volume of its C p0) plus V0 / K with K the bulk modulus
of water. Where C is so soft that the chamber's own mode is resolved, p0 = (V0 - V)/C of the start of the step: the
end's value would damp it. That is decided in the first steps of a run: a change between the two rings. In an open
chamber p0 = 0.

Time: leapfrog, the membrane's in-plane waves (and bending) set the step. A sample's steps run inside one kernel.
"""

from taichi_eye.backend import real
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver import guards
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.figures import at
from taichi_eye.solver.globe import Globe
from taichi_eye.solver.state import Snapshot

SMOOTHINGS = 4  # of what is quadratic in the velocity
PUFF_ROWS = 4  # of the puff's table per sample
RUNNING, ALARM = range(2)


@ti.data_oriented
class WallStepper:
    """Steps a cornea under a reduced pressure model; capacity and fields are the cornea's.

    flowing: whether the pressure varies along the wall (added mass); `sealed`, `compliance` [m^3/Pa] as above; globe:
    what the chamber yields to. status: RUNNING, or ALARM once a sample's figures are such that a guard has to look at
    them.
    """

    def __init__(self, cornea: Cornea, flowing: bool):
        fp = real()
        self.cornea, self.flowing, self.globe = cornea, flowing, Globe(1)
        vector = lambda: ti.Vector.field(2, fp, cornea.capacity)
        scalar = lambda: ti.field(fp, cornea.capacity)
        self.ring, self.ring_before, self.free, self.trial, self.moved = (vector() for _ in range(5))
        self.pressure, self.unit_pressure, self.flux_rate, self.quadratic, self.defect, self.across = (
            scalar() for _ in range(6)
        )
        self.back, self.travel_from, self.way, self.shown_velocity = scalar(), vector(), vector(), vector()
        width = cornea.capacity if flowing else 1
        self.neumann, self.inverse, self.neumann_change = (ti.field(fp, (width, width)) for _ in range(3))
        self.progress = ti.field(fp, 1)  # alpha; way: d / d . d [1/m]
        self.rest_volume, self.rest_enclosed, self.compliance, self.density = (ti.field(fp, ()) for _ in range(4))
        self.sealed, self.status, self.steps, self.aged = (ti.field(ti.i32, ()) for _ in range(4))
        self.rest_energy, self.bending_step, self.shear_damping = (ti.field(fp, ()) for _ in range(3))
        self.least_stress, self.energy_floor = (ti.field(fp, ()) for _ in range(2))
        self.last_dt, self.largest_work = ti.field(fp, 1), ti.field(fp, 1)
        self.resolved = ti.field(fp, 1)  # 1 where the chamber's own mode is, else 0
        self.snapshot = Snapshot(
            {
                **cornea.evolving(),
                "ring": self.ring,
                "ring_before": self.ring_before,
                "moved": self.moved,
                "wall_pressure": self.pressure,
                "unit_pressure": self.unit_pressure,
                "travel_from": self.travel_from,
                "way": self.way,
            },
            {
                **cornea.evolving_of_eyes(),
                **self.globe.evolving(),
                "map_progress": self.progress,
                "last_dt": self.last_dt,
                "chamber_resolved": self.resolved,
                "largest_work": self.largest_work,
            },
        )

    @ti.kernel
    def setup(
        self,
        back: ti.types.ndarray(),
        volume: float,
        compliance: float,
        sealed: int,
        density: float,
        bending_step: float,
        shear_damping: float,
        least_stress: float,
        energy_floor: float,
    ):
        """Take the cornea's present state as rest; back [walls]: z of the rigid back below each node [m]; compliance
        [m^3/Pa] of the liquid; density of the liquid [kg/m^3];
        bending_step: limit of the step by the plate's stiffest wave per squared element [s/m^2]; shear_damping: rate
        of the shear's viscosity times a squared element [m^2/s]; least_stress [Pa], and gain of energy_floor [J]: at
        which an alarm is given."""
        self.sealed[None], self.status[None], self.steps[None], self.aged[None] = sealed, RUNNING, 0, 1
        self.compliance[None], self.rest_volume[None], self.density[None] = compliance, volume, density
        self.last_dt[0], self.largest_work[0], self.progress[0] = 0.0, 0.0, 0.0
        self.bending_step[None], self.shear_damping[None] = bending_step, shear_damping
        self.least_stress[None], self.energy_floor[None] = least_stress, energy_floor
        for i in range(self.cornea.last[0] + 1):
            zero = ti.Vector([0.0, 0.0])
            self.back[i] = back[i]
            self.pressure[i], self.unit_pressure[i], self.quadratic[i], self.flux_rate[i] = 0.0, sealed, 0.0, 0.0
            self.moved[i], self.shown_velocity[i], self.travel_from[i] = zero, zero, self.cornea.place[i]
            self.way[i] = zero
            self.ring[i] = self.cornea.held(0, i, self.cornea.volume_gradient(0, i))
            self.ring_before[i] = self.ring[i]
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.rest_enclosed[None] = self.cornea.enclosed_volume(0, self.cornea.place)
            self.rest_energy[None] = self.cornea.elastic_energy(0)

    @ti.kernel
    def load_flow(
        self,
        neumann: ti.types.ndarray(),
        inverse: ti.types.ndarray(),
        change: ti.types.ndarray(),
        unit: ti.types.ndarray(),
    ):
        """New maps, `aged` once a node has moved too far: N [1/m], (1 + rho N D)^-1, the change of N since the last
        ones, and the response of the pressure to a unit p0."""
        self.aged[None] = 0
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.progress[0] = 0.0
            far = 0.0
            for i in range(unit.shape[0]):
                far += (self.cornea.place[i] - self.travel_from[i]).norm_sqr()
            for i in range(unit.shape[0]):
                self.way[i] = (self.cornea.place[i] - self.travel_from[i]) / ti.max(far, 1e-30)
        for i in range(unit.shape[0]):
            self.unit_pressure[i] = unit[i]
            self.travel_from[i] = self.cornea.place[i]
            for j in range(unit.shape[0]):
                self.neumann[i, j], self.inverse[i, j] = neumann[i, j], inverse[i, j]
                self.neumann_change[i, j] = change[i, j]

    @ti.func
    def stable_step(self):
        """The step limit [s] of the cornea's waves now: tension, shear and bending stiffen one and the same wave."""
        step = ti.math.inf
        shortest, slant = ti.math.inf, 1.0
        for k in range(self.cornea.last[0]):
            slant = ti.max(slant, self.cornea.slant(k))
            stress, in_plane, transverse = self.cornea.wave_speeds(0, k)
            length = self.cornea.element_length[k]
            step = ti.min(step, length / ti.max(ti.max(in_plane, transverse), 1e-6))
            shortest = ti.min(shortest, length)
        plate = self.bending_step[None] * shortest * shortest
        stiffness = 1.0 / (step * step) + 1.0 / (plate * plate)
        damping = self.shear_damping[None] * slant * slant / (shortest * shortest)
        return 2.0 / (damping + ti.sqrt(damping * damping + 4.0 * stiffness))

    @ti.func
    def _volume_at(self, place: ti.template()):
        return self.cornea.enclosed_volume(0, place) + self.rest_volume[None] - self.rest_enclosed[None]

    @ti.func
    def _collect(self, puff, dt):
        """Forces on the rings at the present place, without the liquid's excess pressure."""
        count = self.cornea.last[0]
        self.cornea.spread_load(0)
        self.cornea.deform(0, dt)
        work = 0.0
        for i in range(count):
            self.cornea.air_pressure[i] = puff * self.cornea.load_shape[i]
            ring = self.cornea.volume_gradient(0, i)
            solid = self.cornea.elastic_force(0, i) + self.cornea.iop[0] * ring - self.cornea.residual[i]
            air = -self.cornea.air_pressure[i] * ring
            work += 0.5 * (self.cornea.force_air[i] + air).dot(self.moved[i])
            self.cornea.force_solid[i], self.cornea.force_air[i] = solid, air
            self.ring_before[i] = self.ring[i]
            self.ring[i] = self.cornea.held(0, i, ring)
            self.free[i] = self.cornea.held(0, i, (solid + air) / self.cornea.mass[i])
        self.cornea.puff_work[0] += work

    @ti.func
    def _flow_pressure(self, dt_before):
        """The excess pressure on the wall at the p0 of the last step: one sweep from the pressure of that step."""
        count = self.cornea.last[0]
        for i in range(count):
            turning = (self.ring[i] - self.ring_before[i]).dot(self.cornea.velocity[i]) / dt_before
            mobility = self.ring[i].norm_sqr() / self.cornea.mass[i]
            self.flux_rate[i] = self.ring[i].dot(self.free[i]) + turning + mobility * self.pressure[i]
        for i in range(count):
            total = self.quadratic[i]
            for j in range(count):
                total += self.neumann[i, j] * self.flux_rate[j]
            self.defect[i] = self.globe.mean_pressure[0] - self.density[None] * total - self.pressure[i]
        for i in range(count):
            total = 0.0
            for j in range(count):
                total += self.inverse[i, j] * self.defect[j]
            self.pressure[i] += total

    @ti.func
    def _smooth(self, field: ti.template()):
        """(1, 2, 1)/4 along the wall, mirrored at the axis: removes what alternates from node to node."""
        count = self.cornea.last[0]
        behind = field[1]
        for i in range(count):
            here = field[i]
            ahead = field[ti.min(i + 1, count - 1)]
            field[i] = 0.25 * (behind + 2.0 * here + ahead)
            behind = here

    @ti.func
    def _find_quadratic(self):
        """dN/dt Q + (phi_s^2 - v_n^2)/2 - v_s phi_s on the wall, smoothed; phi goes into `defect`."""
        count = self.cornea.last[0]
        pace = 0.0
        for i in range(count):
            pace += self.cornea.velocity[i].dot(self.way[i])
            self.across[i] = self.cornea.velocity[i].dot(self.ring[i].normalized())
        for _ in ti.static(range(SMOOTHINGS)):
            self._smooth(self.across)
        for i in range(count):
            self.flux_rate[i] = self.ring[i].norm() * self.across[i]
        for i in range(count):
            potential, drift = 0.0, 0.0
            for j in range(count):
                potential += self.neumann[i, j] * self.flux_rate[j]
                drift += self.neumann_change[i, j] * self.flux_rate[j]
            self.defect[i], self.quadratic[i] = potential, pace * drift
        # the limbus does not move and takes no part: a one-sided slope beside it
        for i in range(count):
            slope, sliding = 0.0, 0.0
            if i > 0:
                ahead = ti.min(i + 1, count - 1)
                arm = self.cornea.place[ahead] - self.cornea.place[i - 1]
                slope = (self.defect[ahead] - self.defect[i - 1]) / arm.norm()
                sliding = self.cornea.velocity[i].dot(arm.normalized())
            self.quadratic[i] += 0.5 * (slope * slope - self.across[i] ** 2) - sliding * slope
        for _ in ti.static(range(SMOOTHINGS)):
            self._smooth(self.quadratic)

    @ti.func
    def _step(self, puff, dt, kick, dt_before):
        count = self.cornea.last[0]
        self._collect(puff, dt_before)
        if ti.static(self.flowing):
            self._flow_pressure(dt_before)
        # what the volume at the end of the step loses per unit of p0: dt kick times the rings' mobility under it
        mobility = 0.0
        for i in range(count):
            self.free[i] += self.ring[i] * (self.pressure[i] / self.cornea.mass[i])
            mobility += self.unit_pressure[i] * self.ring[i].norm_sqr() / self.cornea.mass[i]
        yielding = dt * kick * mobility
        change, p0 = 0.0, self.globe.mean_pressure[0]
        if self.sealed[None] == 1:
            followed = self.globe.followed(0, dt)
            soft = self.compliance[None]
            full = self.rest_volume[None] - (1.0 - followed) * self.globe.taken_up[0]
            if self.steps[None] == 0:
                self.resolved[0] = ti.select(yielding < self.globe.uptake(0, followed, soft, p0)[1], 1.0, 0.0)
            if self.resolved[0] > 0.0:
                change = self.globe.pressure_for(0, followed, soft, full - self._volume_at(self.cornea.place)) - p0
            else:
                for _ in range(4):
                    for i in range(count):
                        a = self.free[i] + self.ring[i] * (change * self.unit_pressure[i] / self.cornea.mass[i])
                        self.trial[i] = self.cornea.place[i] + dt * (self.cornea.velocity[i] + kick * a)
                    self.trial[count] = self.cornea.place[count]
                    volume, slope = self.globe.uptake(0, followed, soft, p0 + change)
                    miss = self._volume_at(self.trial) + volume - full
                    if ti.abs(miss) > 1e-13 * self.rest_volume[None]:
                        change -= miss / (yielding + slope)
                    else:
                        break
            self.globe.take_up(0, followed, p0 + change)
        for i in range(count):
            self.pressure[i] += change * self.unit_pressure[i]
            a = self.free[i] + self.ring[i] * (change * self.unit_pressure[i] / self.cornea.mass[i])
            self.cornea.acceleration[i] = a
            self.cornea.velocity[i] += kick * a
            self.moved[i] = dt * self.cornea.velocity[i]
            self.cornea.place[i] += self.moved[i]

    @ti.func
    def _impulse(self, puff: ti.template(), sample, start, end):
        """The puff's impulse [Pa s] at the apex from `start` to `end`, in rows of its table after a sample's.

        puff [rows, 2]: its impulse up to a time and its slope per row there, PUFF_ROWS to a sample; cubic in between.
        """
        first, last = ti.cast(ti.floor(start), ti.i32), ti.cast(ti.floor(end), ti.i32)
        a = ti.max(sample * PUFF_ROWS + first, 0)
        b = ti.min(sample * PUFF_ROWS + last, puff.shape[0] - 2)
        whole = puff[b, 0] - puff[a, 0]
        return whole + self._into_row(puff, b, end - last) - self._into_row(puff, a, start - first)

    @ti.func
    def _into_row(self, puff: ti.template(), row, share):
        """What a share of a row of the puff's table adds [Pa s]."""
        rise, slope, next = puff[row + 1, 0] - puff[row, 0], puff[row, 1], puff[row + 1, 1]
        return share * (slope + share * (3.0 * rise - 2.0 * slope - next + share * (slope + next - 2.0 * rise)))

    @ti.kernel
    def advance(
        self,
        puff: ti.types.ndarray(),
        first: int,
        last: int,
        span: float,
        cfl: float,
        far: float,
        record: ti.types.ndarray(),
        per_frame: int,
        frames: ti.types.ndarray(),
    ) -> ti.i32:
        """Take samples of `span` [s] from sample `first` to `last`; the sample reached.

        Ends early at an alarm (`status`), or once a node has moved by `far` [m] since the maps were loaded.
        puff: its table, as `_impulse` reads it. Filled: record [samples + 1, QUANTITIES], and
        at every `per_frame` samples frames [frame, node, place 2, velocity 2, acceleration 2, excess pressure].
        """
        reached = first
        going = True
        while going and reached < last and self.status[None] == RUNNING:
            steps = ti.cast(ti.ceil(span / (cfl * self.stable_step())), ti.i32)
            dt = span / steps
            if ti.static(self.flowing):
                self._find_quadratic()
            for n in range(steps):
                before = dt
                if n == 0:
                    before = self.last_dt[0]
                kick, here, rows = 0.5 * (dt + before), n * dt / span, 0.5 * PUFF_ROWS / span
                load = self._impulse(puff, reached, here * PUFF_ROWS - rows * before, here * PUFF_ROWS + rows * dt)
                self._step(load / kick, dt, kick, ti.select(before > 0.0, before, dt))
            self.last_dt[0] = dt
            self.steps[None] += steps
            reached += 1
            if ti.static(self.flowing):
                self._carry_maps_on()
            self._survey(record, reached, 0.5 * dt)
            if reached % per_frame == 0 and reached // per_frame < frames.shape[0]:
                self._keep(frames, reached // per_frame, 0.5 * dt)
            if ti.static(self.flowing):
                if not (self._travel() < far):
                    self.aged[None] = 1
                    going = False
        return reached

    @ti.func
    def _keep(self, frames: ti.template(), frame, half):
        for i in range(self.cornea.last[0] + 1):
            v = self.cornea.velocity[i] + half * self.cornea.acceleration[i]
            for k in ti.static(range(2)):
                frames[frame, i, k] = self.cornea.place[i][k]
                frames[frame, i, 2 + k] = v[k]
                frames[frame, i, 4 + k] = self.cornea.acceleration[i][k]
            frames[frame, i, 6] = self.pressure[i]

    @ti.kernel
    def show(self, frame: ti.types.ndarray(), placed: int):
        """Show one frame, [nodes, 7] as `advance` keeps it: its velocity, and where `placed`, the cornea there."""
        for i in range(frame.shape[0]):
            self.shown_velocity[i] = ti.Vector([frame[i, 2], frame[i, 3]])
            if placed == 1:
                self.cornea.place[i] = ti.Vector([frame[i, 0], frame[i, 1]])

    @ti.func
    def _survey(self, record: ti.template(), row, half):
        count = self.cornea.last[0]
        volume = self._volume_at(self.cornea.place)
        least, slackest, bad = ti.math.inf, 0, -1
        room, near, slant, slanted = ti.math.inf, 0, 1.0, 0
        kinetic, swept, work = 0.0, 0.0, self.cornea.puff_work[0]
        for i in range(count):
            stress = self.cornea.borne_stress(0, i)
            if ti.min(stress[0], stress[1]) < least:
                least, slackest = ti.min(stress[0], stress[1]), i
            if self.cornea.slant(i) > slant:
                slant, slanted = self.cornea.slant(i), i
            above = (self.cornea.place[i][1] - self.back[i]) / (self.cornea.rest[i][1] - self.back[i])
            if above < room:
                room, near = above, i
            v = self.cornea.velocity[i] + half * self.cornea.acceleration[i]
            kinetic += self.cornea.kinetic_at(i, v, half)
            # the work of the last step with the force at its start, which is also what the velocity goes on with
            work += self.cornea.force_air[i].dot(self.moved[i])
            sum = self.cornea.place[i].sum() + v.sum()
            if bad < 0 and (ti.math.isnan(sum) or ti.math.isinf(sum)):
                bad = i
            if ti.static(self.flowing):
                self.flux_rate[i] = self.ring[i].dot(v)
        if ti.static(self.flowing):
            for i in range(count):
                potential = 0.0
                for j in range(count):
                    potential += self.neumann[i, j] * self.flux_rate[j]
                swept += 0.5 * self.density[None] * self.flux_rate[i] * potential
        p0 = self.globe.mean_pressure[0]
        elastic = self.cornea.elastic_energy(0) - self.rest_energy[None]
        stretched = self.globe.stored(0)
        stored = (
            0.5 * self.compliance[None] * p0 * p0 + stretched + self.cornea.iop[0] * (self.rest_volume[None] - volume)
        )
        self.largest_work[0] = ti.max(self.largest_work[0], ti.abs(work))
        gained = elastic + kinetic + swept + stored - work
        if (
            bad >= 0
            or ti.math.isnan(gained)
            or least <= self.least_stress[None]
            or room < guards.CLOSED
            or slant > guards.OVERTURNED
            or gained > guards.ENERGY_SHARE * self.largest_work[0] + self.energy_floor[None]
        ):
            self.status[None] = ALARM
        record[row, at.apex_place] = self.cornea.place[0][1]
        record[row, at.apex_velocity] = self.cornea.velocity[0][1] + half * self.cornea.acceleration[0][1]
        record[row, at.fluid_pressure_apex] = self.cornea.iop[0] + self.pressure[0]
        record[row, at.volume_error] = (volume + self.globe.taken_up[0]) / self.rest_volume[None] - 1.0
        record[row, at.puff_work] = work
        record[row, at.cornea_elastic] = elastic
        record[row, at.cornea_kinetic] = kinetic
        record[row, at.aqueous_kinetic] = swept
        record[row, at.aqueous_elastic] = stored
        record[row, at.tissue_loss] = self.cornea.relaxed_work[0] + self.globe.work[0] - stretched
        record[row, at.least_stress] = least
        record[row, at.slackest_element] = slackest
        record[row, at.steepest_slant] = slant
        record[row, at.slanted_element] = slanted
        record[row, at.chamber_gap] = room
        record[row, at.gap_node] = near
        record[row, at.not_finite] = ti.select(bad >= 0, 1.0, 0.0)
        record[row, at.bad_node] = bad

    @ti.func
    def _carry_maps_on(self):
        progress = 0.0
        for i in range(self.cornea.last[0]):
            progress += (self.cornea.place[i] - self.travel_from[i]).dot(self.way[i])
        for i in range(self.cornea.last[0]):
            for j in range(self.cornea.last[0]):
                self.neumann[i, j] += (progress - self.progress[0]) * self.neumann_change[i, j]
        self.progress[0] = progress

    @ti.func
    def _travel(self):
        farthest = 0.0
        for i in range(self.cornea.last[0]):
            farthest = ti.max(farthest, (self.cornea.place[i] - self.travel_from[i]).norm())
        return farthest
