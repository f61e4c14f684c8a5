"""One coupled time step, and the loop around it.

Partitioned, Dirichlet-Neumann: the cornea hands its motion to the aqueous humour, the aqueous humour hands its wall
pressure back. From t_n to t_n+1, with a the membrane's acceleration:

 1. cornea, explicit Newmark (beta 0, gamma 1/2):  x_n+1 = x_n + dt v_n + dt^2/2 a_n;
    forces of tissue, IOP and puff at x_n+1, t_n+1. The volume under x_n+1 gives the mean pressure of t_n+1.
 2. aqueous: momentum with the pressure of t_n gives the velocity of t_n+1/2 everywhere but at the cornea.
 3. coupling iteration on a_n+1:  v_n+1 = v_n + dt/2 (a_n + a_n+1);  the wall moves with (v_n + v_n+1)/2;  continuity
    with that wall velocity gives the wall pressures of t_n+1;  these and step 1 give a new a_n+1. Only the wall nodes'
    own equations change between sweeps, so a sweep costs one pass over them and yet is the iteration of the whole
    step. Relaxed by a fixed factor or by Aitken's.
 4. aqueous: continuity with the converged wall velocity gives the pressure of t_n+1 everywhere.

Held constant during the iteration: stencils, pressure gradients, dissipation, the interior velocity. Loose coupling is
one sweep of the same: the fluid sees the predictor a_n, the membrane what the fluid answers.

A sweep contracts by about (dt/2)^2 rho c^2 / (g rho_s h_wall), g the distance of the first nodes under the wall: at a
fixed CFL number by CFL c dt rho / (4 rho_s h_wall), which goes to 0 with dt as van Brummelen (2009) has it for a
compressible fluid: 0.01 at h = 0.1 mm. Loose coupling is unstable where it exceeds about 1.

Pressure and velocity are staggered by half a step, so the pair is a leapfrog: second order in dt and without damping of
its own; the dissipation is lagged. Steps 2 and 4 are one pass over the nodes each: the pressure's gradients go with the
velocity's dissipation, which has its gradients from the step before, the velocity's with the pressure's.

Nothing in step 2 needs step 1, so the code takes step 2 first: a step in parallel is three loops, one over the eyes
between two over the nodes. P p is summed once for all sweeps; a sweep sums the divergence alone, over gradient weights.

Tried on two cores and left out: all threads in one launch per sample, meeting at barriers in memory. 4089 nodes went
from 0.37 to 0.53 of the bare gather's rate, 16 k from 0.33 to 0.35; but a thread that waits spins, and one other busy
process on the machine made it 4 to 6 times slower. Tasks taken one by one as they become ready (0.48) bear that better
and gain little.
"""

import numpy as np

from taichi_eye import backend
from taichi_eye.backend import real
from taichi_eye.lang import ti
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.figures import NOT_CONVERGED, RUNNING

SERIAL_NODES = 4000  # up to here one thread running the whole time loop beats launching each loop on all of them
# what rounding leaves, by precision: membrane speeds [m/s] below which the wall counts as at rest in the coupling
# tolerance, and the finest tolerance that can be met
VELOCITY_FLOOR = {ti.f64: 1e-7, ti.f32: 1e-2}
FINEST_TOLERANCE = {ti.f64: 0.0, ti.f32: 1e-5}


def plan_of(eyes, steps, dt, kick_dt, puff_apex) -> np.ndarray:
    """What eyes are to do up to their next sample, a row to an eye: eye, steps, step and first kick's step [s], and
    puff.

    One array, since each that a kernel takes costs some 10 us a call. puff_apex [k, step] [Pa].
    """
    plan = np.empty((len(eyes), 4 + puff_apex.shape[1]))
    plan[:, 0], plan[:, 1], plan[:, 2], plan[:, 3], plan[:, 4:] = eyes, steps, dt, kick_dt, puff_apex
    return plan


@ti.data_oriented
class Coupling:
    """Steps cornea and aqueous humour together; `setup` says how.

    An eye's cornea and aqueous humour start at the same node, so wall node i is one and the same index in both.
    """

    def __init__(self, cornea: Cornea, aqueous: Aqueous):
        fp, eyes = real(), cornea.first.shape[0]
        self.cornea, self.aqueous = cornea, aqueous
        vector = lambda: ti.Vector.field(2, fp, cornea.capacity)
        self.guess, self.miss, self.last_miss, self.wall_velocity = vector(), vector(), vector(), vector()
        # of the wall nodes: pressure at the end of the step, P p, area vector of the ring
        self.wall_pressure, self.wall_rough = ti.field(fp, cornea.capacity), ti.field(fp, cornea.capacity)
        self.ring = vector()
        self.iterated, self.aitken, self.sweeps_max = (ti.field(ti.i32, eyes) for _ in range(3))
        self.factor, self.tolerance, self.velocity_floor = (ti.field(fp, eyes) for _ in range(3))
        self.status = ti.field(ti.i32, eyes)
        self.going = ti.field(ti.i32, eyes)
        # the most sweeps of a step and the worst residual since they were last read
        self.sweeps = ti.field(ti.i32, eyes)
        self.worst_residual, self.rest_enclosed = ti.field(fp, eyes), ti.field(fp, eyes)
        self.march_all, self._step_all = _launches(self)

    def setup(
        self, *, iterated: bool, aitken: bool, factor: float, tolerance: float, sweeps_max: int, eye: int = 0
    ) -> None:
        """How step 3 runs in an eye, and a fresh start.

        factor: (first) relaxation factor; tolerance: largest change of the membrane's velocity in a sweep over its
        largest velocity; sweeps_max: at which the run counts as not converged.
        """
        self._load(
            iterated=iterated,
            aitken=aitken,
            factor=factor,
            tolerance=max(tolerance, FINEST_TOLERANCE[real()]),
            floor=VELOCITY_FLOOR[real()],
            sweeps_max=sweeps_max,
            eye=eye,
        )

    @ti.kernel
    def _load(
        self, iterated: int, aitken: int, factor: float, tolerance: float, floor: float, sweeps_max: int, eye: int
    ):
        self.iterated[eye], self.aitken[eye], self.sweeps_max[eye] = iterated, aitken, sweeps_max
        self.factor[eye], self.tolerance[eye], self.velocity_floor[eye] = factor, tolerance, floor
        self.status[eye] = RUNNING
        self.sweeps[eye], self.worst_residual[eye] = 0, 0.0

    def advance(self, puff_apex, dt: float, dt_before: float) -> None:
        """Take len(puff_apex) steps of dt [s] of eye 0; puff_apex [Pa]: the puff on the axis at the end of each step.

        dt_before is the step before this call: velocities live at half steps, so the first kick spans both halves.
        """
        puff_apex = np.asarray(puff_apex, dtype=float)[None]
        plan = plan_of([0], puff_apex.size, dt, 0.5 * (dt + dt_before), puff_apex)
        if backend.on_cpu() and (self.aqueous.nodes[0] <= SERIAL_NODES or backend.threads() == 1):
            self.march_all(plan)
        else:
            self.advance_in_parallel(plan)

    def advance_in_parallel(self, plan: np.ndarray) -> None:
        """Carry out a plan (`plan_of`), each pass of a step in parallel over the nodes of all eyes."""
        everyone = np.zeros((len(self.aqueous.nodes), plan.shape[1]))
        everyone[plan[:, 0].astype(int)] = plan
        step_all = self._step_all
        for step in range(int(plan[:, 1].max())):
            step_all(step, everyone)

    @ti.func
    def _start_step(self, eye, i, dt):
        # wall node i: predictor
        self.cornea.predict(eye, i, dt)
        self.guess[i] = self.cornea.acceleration[i]
        self.last_miss[i] = ti.Vector([0.0, 0.0])

    @ti.func
    def _work_of_air(self, eye, i, puff, dt):
        # trapezoid: the force before this call is the one at the start of the step
        self.cornea.air_pressure[i] = puff * self.cornea.load_shape[i]
        moved = self.cornea.held(eye, i, dt * self.cornea.velocity[i] + 0.5 * dt * dt * self.cornea.acceleration[i])
        before = self.cornea.force_air[i]
        self.cornea.collect_forces(eye, i)
        return 0.5 * (before + self.cornea.force_air[i]).dot(moved)

    @ti.func
    def _move_cornea(self, eye, puff, dt):
        """Step 1: places, tensions and forces of the membrane; serial over the wall nodes."""
        first = self.cornea.first[eye]
        end = first + self.aqueous.wall_count[eye]
        for i in range(first, end):
            self._start_step(eye, i, dt)
        self.cornea.spread_load(eye)
        self.cornea.deform(eye, dt)
        work = 0.0
        for i in range(first, end):
            work += self._work_of_air(eye, i, puff, dt)
        self.cornea.puff_work[eye] += work

    @ti.func
    def _match_wall(self, eye, dt):
        """Step 3: iterate the membrane's acceleration; serial over the wall nodes."""
        first = self.cornea.first[eye]
        end = first + self.aqueous.wall_count[eye]
        omega = self.factor[eye]
        volume = self.chamber_volume(eye)
        for i in range(first, end):
            self.wall_rough[i] = self.aqueous.smoother.roughness_at(i, self.aqueous.continuity_row)
            self.ring[i] = self.cornea.volume_gradient(eye, i)
        sweep = 0
        residual = ti.math.inf
        going = True
        broken = 0
        while going:
            top = self.velocity_floor[eye]
            for i in range(first, end):
                after = self.cornea.velocity[i] + 0.5 * dt * (self.cornea.acceleration[i] + self.guess[i])
                self.wall_velocity[i] = self.cornea.held(eye, i, 0.5 * (self.cornea.velocity[i] + after))
                top = ti.max(top, after.norm())
            if self.aqueous.sealed[eye] == 0:
                swept = 0.0
                for i in range(first, end):
                    swept += self.ring[i].dot(self.wall_velocity[i])
                self.aqueous.outflow[eye] = -swept / volume
            for i in range(first, end):
                self.aqueous.velocity[i] = self.aqueous.meet_wall(eye, i, self.cornea.place, self.wall_velocity[i])
            for i in range(first, end):
                divergence = self.aqueous.operators.divergence_at(i, self.aqueous.place, self.aqueous.velocity)
                self.wall_pressure[i] = (
                    self.aqueous.pressure[i]
                    + self.aqueous.pressure_shift[eye]
                    + dt * self.aqueous.pressure_rate(eye, i, divergence, self.wall_rough[i], self.wall_velocity)
                )
            residual = 0.0
            square, product = 0.0, 0.0
            for i in range(first, end):
                force = self.cornea.force_solid[i] + self.cornea.force_air[i] + self.wall_pressure[i] * self.ring[i]
                miss = self.cornea.held(eye, i, force / self.cornea.mass[i]) - self.guess[i]
                change = miss - self.last_miss[i]
                square += change.norm_sqr()
                product += self.last_miss[i].dot(change)
                change_of_velocity = 0.5 * dt * miss.norm()
                residual = ti.max(residual, change_of_velocity)
                # a maximum forgets NaN
                if ti.math.isnan(change_of_velocity):
                    broken = 1
                self.miss[i] = miss
            residual /= top
            if broken == 1:
                residual = ti.math.inf
            sweep += 1
            if self.iterated[eye] == 1:
                # written so that NaN goes on to the limit instead of passing
                going = not (residual <= self.tolerance[eye]) and sweep < self.sweeps_max[eye]
                if going:
                    if self.aitken[eye] == 1 and sweep > 1 and square > 0.0:
                        omega = -omega * product / square
                    for i in range(first, end):
                        self.guess[i] += omega * self.miss[i]
                        self.last_miss[i] = self.miss[i]
            else:
                going = False
                for i in range(first, end):
                    self.guess[i] += self.miss[i]
        if self.iterated[eye] == 1 and not (residual <= self.tolerance[eye]):
            self.status[eye] = NOT_CONVERGED
        self.sweeps[eye] = ti.max(self.sweeps[eye], sweep)
        self.worst_residual[eye] = ti.max(self.worst_residual[eye], residual)

    @ti.func
    def _end_cornea_step(self, eye, i, dt):
        accelerated = 0.5 * dt * (self.cornea.acceleration[i] + self.guess[i])
        self.cornea.velocity[i] = self.cornea.held(eye, i, self.cornea.velocity[i] + accelerated)
        self.cornea.acceleration[i] = self.guess[i]

    @ti.func
    def chamber_volume(self, eye):
        """Volume [m^3] of the chamber under the present cornea."""
        return self.aqueous.rest_volume[eye] + (
            self.cornea.enclosed_volume(eye, self.cornea.place) - self.rest_enclosed[eye]
        )

    @ti.func
    def _settle_pressure(self, eye, dt):
        self.aqueous.pressure_shift[eye] = self.aqueous.missing_pressure(eye, self.chamber_volume(eye), dt)

    @ti.func
    def step_cornea(self, eye, puff, dt):
        """Steps 1 and 3 of an eye, and the state of its cornea at the end of the step."""
        self._move_cornea(eye, puff, dt)
        self._settle_pressure(eye, dt)
        self._match_wall(eye, dt)
        for i in range(self.aqueous.first[eye], self.aqueous.first[eye] + self.aqueous.wall_count[eye]):
            self._end_cornea_step(eye, i, dt)
        self.cornea.half_step[eye] = 0.5 * dt

    @ti.func
    def march(self, eye, k, plan: ti.template()):
        """All steps of an eye on one thread: row k of a plan (`plan_of`)."""
        steps, dt, kick_dt = int(plan[k, 1]), float(plan[k, 2]), float(plan[k, 3])
        first, end = self.aqueous.first[eye], self.aqueous.first[eye] + self.aqueous.count[eye]
        for step in range(steps):
            if self.status[eye] == RUNNING:
                if step > 0:
                    kick_dt = dt
                for i in range(first, end):
                    self.aqueous.kick(eye, i, kick_dt, self.cornea.velocity)
                self.step_cornea(eye, float(plan[k, 4 + step]), dt)
                for i in range(first, end):
                    self.aqueous.compress(eye, i, dt, self.wall_velocity)


def _launches(coupling):
    """All steps of eyes on one thread, and one step of all eyes, each of its passes in parallel over all nodes.

    Closures, since a launch of a method costs half as much again in Python.
    """
    aqueous, cornea = coupling.aqueous, coupling.cornea

    @ti.kernel
    def march_all(plan: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for k in range(plan.shape[0]):
            coupling.march(int(plan[k, 0]), k, plan)

    @ti.kernel
    def step_all(step: int, plan: ti.types.ndarray()):
        # row k of the plan is that of eye k
        for i in range(aqueous.neighbours.total[None]):
            eye = aqueous.neighbours.eye_of[i]
            if step < plan[eye, 1] and coupling.status[eye] == RUNNING:
                kick_dt = float(plan[eye, 2])
                if step == 0:
                    kick_dt = float(plan[eye, 3])
                aqueous.kick(eye, i, kick_dt, cornea.velocity)
        for eye in range(plan.shape[0]):
            coupling.going[eye] = 0
            if step < plan[eye, 1] and coupling.status[eye] == RUNNING:
                coupling.going[eye] = 1
                coupling.step_cornea(eye, float(plan[eye, 4 + step]), float(plan[eye, 2]))
        for i in range(aqueous.neighbours.total[None]):
            eye = aqueous.neighbours.eye_of[i]
            if coupling.going[eye] == 1:
                aqueous.compress(eye, i, float(plan[eye, 2]), coupling.wall_velocity)

    return march_all, step_all
