"""One coupled time step, and the loop around it.

Partitioned, Dirichlet-Neumann: the cornea hands its motion to the aqueous humour, the aqueous humour hands its wall
pressure back. From t_n to t_n+1, with a the membrane's acceleration:

 1. cornea, explicit Newmark (beta 0, gamma 1/2):  x_n+1 = x_n + dt v_n + dt^2/2 a_n;
    forces of tissue, IOP and puff at x_n+1, t_n+1.
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
its own; the dissipation is lagged.
"""
import numpy as np
import taichi as ti

from taichi_eye import backend
from taichi_eye.backend import real
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea

SERIAL_NODES = 4000  # up to here one thread running the whole time loop beats launching each loop on all of them
# what rounding leaves, by precision: membrane speeds [m/s] below which the wall counts as at rest in the coupling
# tolerance, and the finest tolerance that can be met
VELOCITY_FLOOR = {ti.f64: 1e-7, ti.f32: 1e-2}
FINEST_TOLERANCE = {ti.f64: 0.0, ti.f32: 1e-5}
RUNNING, NOT_CONVERGED = 0, 1


@ti.data_oriented
class Coupling:
    """Steps cornea and aqueous humour together; `setup` says how."""

    def __init__(self, cornea: Cornea, aqueous: Aqueous):
        fp = real()
        self.cornea, self.aqueous = cornea, aqueous
        vector = lambda: ti.Vector.field(2, fp, cornea.capacity)
        self.guess, self.miss, self.last_miss, self.wall_velocity = vector(), vector(), vector(), vector()
        self.wall_pressure = ti.field(fp, cornea.capacity)
        self.iterated, self.aitken, self.sweeps_max = (ti.field(ti.i32, ()) for _ in range(3))
        self.factor, self.tolerance, self.velocity_floor = (ti.field(fp, ()) for _ in range(3))
        self.status = ti.field(ti.i32, ())
        # the most sweeps of a step and the worst residual since they were last read
        self.sweeps = ti.field(ti.i32, ())
        self.worst_residual, self.rest_enclosed = ti.field(fp, ()), ti.field(fp, ())

    def setup(self, iterated: bool, aitken: bool, factor: float, tolerance: float, sweeps_max: int) -> None:
        """How step 3 runs, and a fresh start.

        factor: (first) relaxation factor; tolerance: largest change of the membrane's velocity in a sweep over its
        largest velocity; sweeps_max: at which the run counts as not converged.
        """
        self._load(iterated, aitken, factor, max(tolerance, FINEST_TOLERANCE[real()]), VELOCITY_FLOOR[real()],
                   sweeps_max)

    @ti.kernel
    def _load(self, iterated: int, aitken: int, factor: float, tolerance: float, floor: float, sweeps_max: int):
        self.iterated[None], self.aitken[None], self.sweeps_max[None] = iterated, aitken, sweeps_max
        self.factor[None], self.tolerance[None], self.velocity_floor[None] = factor, tolerance, floor
        self.status[None] = RUNNING
        self.sweeps[None], self.worst_residual[None] = 0, 0.0

    def advance(self, puff_apex, dt: float, dt_before: float) -> None:
        """Take len(puff_apex) steps of dt [s]; puff_apex [Pa]: the puff on the axis at the end of each step.

        dt_before is the step before this call: velocities live at half steps, so the first kick spans both halves.
        """
        if backend.on_cpu() and (self.aqueous.nodes <= SERIAL_NODES or backend.threads() == 1):
            self._advance_serially(np.ascontiguousarray(puff_apex, dtype=float), dt, dt_before)
        else:
            for step, puff in enumerate(puff_apex):
                self._step_in_parallel(puff, dt, 0.5 * (dt + dt_before) if step == 0 else dt)

    @ti.func
    def _start_step(self, i, puff, dt):
        # wall node i: predictor, air pressure at the end of the step
        self.cornea.predict(i, dt)
        self.cornea.air_pressure[i] = puff * self.cornea.load_shape[i]
        self.guess[i] = self.cornea.acceleration[i]
        self.last_miss[i] = ti.Vector([0.0, 0.0])

    @ti.func
    def _work_of_air(self, i, dt):
        # trapezoid: the force before this call is the one at the start of the step
        moved = self.cornea.held(i, dt * self.cornea.velocity[i] + 0.5 * dt * dt * self.cornea.acceleration[i])
        before = self.cornea.force_air[i]
        self.cornea.collect_forces(i)
        return 0.5 * (before + self.cornea.force_air[i]).dot(moved)

    @ti.func
    def _move_cornea(self, puff, dt):
        """Step 1: places, tensions and forces of the membrane; serial over the wall nodes."""
        walls = self.aqueous.wall_count[None]
        for i in range(walls):
            self._start_step(i, puff, dt)
        for k in range(walls - 1):
            self.cornea.stretch_element(k)
        work = 0.0
        for i in range(walls):
            work += self._work_of_air(i, dt)
        self.cornea.puff_work[None] += work

    @ti.func
    def _match_wall(self, dt):
        """Step 3: iterate the membrane's acceleration; serial over the wall nodes."""
        walls = self.aqueous.wall_count[None]
        omega = self.factor[None]
        volume = self.chamber_volume()
        sweep = 0
        residual = ti.math.inf
        going = True
        broken = 0
        while going:
            top = self.velocity_floor[None]
            for i in range(walls):
                after = self.cornea.velocity[i] + 0.5 * dt * (self.cornea.acceleration[i] + self.guess[i])
                self.wall_velocity[i] = self.cornea.held(i, 0.5 * (self.cornea.velocity[i] + after))
                top = ti.max(top, after.norm())
            if self.aqueous.sealed[None] == 0:
                swept = 0.0
                for i in range(walls):
                    swept += self.cornea.volume_gradient(i).dot(self.wall_velocity[i])
                self.aqueous.outflow[None] = -swept / volume
            for i in range(walls):
                self.aqueous.velocity[i] = self.aqueous.meet_wall(i, self.cornea.place, self.wall_velocity[i])
            for i in range(walls):
                slopes = self.aqueous.operators.velocity_gradient_at(i, self.aqueous.velocity)
                divergence = self.aqueous.operators.divergence_from(i, self.aqueous.place, self.aqueous.velocity, slopes)
                self.wall_pressure[i] = (self.aqueous.pressure[i] + self.aqueous.pressure_shift[None]
                                         + dt * self.aqueous.pressure_rate(i, divergence, self.wall_velocity))
            residual = 0.0
            square, product = 0.0, 0.0
            for i in range(walls):
                force = (self.cornea.force_solid[i] + self.cornea.force_air[i]
                         + self.wall_pressure[i] * self.cornea.volume_gradient(i))
                miss = self.cornea.held(i, force / self.cornea.mass[i]) - self.guess[i]
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
            if self.iterated[None] == 1:
                # written so that NaN goes on to the limit instead of passing
                going = not (residual <= self.tolerance[None]) and sweep < self.sweeps_max[None]
                if going:
                    if self.aitken[None] == 1 and sweep > 1 and square > 0.0:
                        omega = -omega * product / square
                    for i in range(walls):
                        self.guess[i] += omega * self.miss[i]
                        self.last_miss[i] = self.miss[i]
            else:
                going = False
                for i in range(walls):
                    self.guess[i] += self.miss[i]
        if self.iterated[None] == 1 and not (residual <= self.tolerance[None]):
            self.status[None] = NOT_CONVERGED
        self.sweeps[None] = ti.max(self.sweeps[None], sweep)
        self.worst_residual[None] = ti.max(self.worst_residual[None], residual)

    @ti.func
    def _end_cornea_step(self, i, dt):
        accelerated = 0.5 * dt * (self.cornea.acceleration[i] + self.guess[i])
        self.cornea.velocity[i] = self.cornea.held(i, self.cornea.velocity[i] + accelerated)
        self.cornea.acceleration[i] = self.guess[i]

    @ti.func
    def chamber_volume(self):
        """Volume [m^3] of the chamber under the present cornea."""
        return self.aqueous.rest_volume[None] + (self.cornea.enclosed_volume() - self.rest_enclosed[None])

    @ti.func
    def _settle_pressure(self):
        self.aqueous.pressure_shift[None] = self.aqueous.missing_pressure(self.chamber_volume())

    @ti.kernel
    def _advance_serially(self, puff: ti.types.ndarray(), dt: float, dt_before: float):
        nodes, walls = self.aqueous.count[None], self.aqueous.wall_count[None]
        ti.loop_config(serialize=True)
        for step in range(puff.shape[0]):
            if self.status[None] == RUNNING:
                kick_dt = dt
                if step == 0:
                    kick_dt = 0.5 * (dt + dt_before)
                self._move_cornea(puff[step], dt)
                for i in range(nodes):
                    self.aqueous.find_pressure_gradient(i)
                for i in range(nodes):
                    self.aqueous.kick(i, kick_dt, self.cornea.velocity)
                for i in range(walls, nodes):
                    self.aqueous.velocity[i] = self.aqueous.candidate[i]
                self._match_wall(dt)
                for i in range(nodes):
                    self.aqueous.find_velocity_gradient(i)
                for i in range(nodes):
                    self.aqueous.compress(i, dt, self.wall_velocity)
                for i in range(walls):
                    self._end_cornea_step(i, dt)
                self._settle_pressure()

    @ti.kernel
    def _step_in_parallel(self, puff: float, dt: float, kick_dt: float):
        ti.loop_config(serialize=True)
        for once in range(1):
            self._move_cornea(puff, dt)
        for i in range(self.aqueous.count[None]):
            self.aqueous.find_pressure_gradient(i)
        for i in range(self.aqueous.count[None]):
            self.aqueous.kick(i, kick_dt, self.cornea.velocity)
        for i in range(self.aqueous.wall_count[None], self.aqueous.count[None]):
            self.aqueous.velocity[i] = self.aqueous.candidate[i]
        ti.loop_config(serialize=True)
        for once in range(1):
            self._match_wall(dt)
        for i in range(self.aqueous.count[None]):
            self.aqueous.find_velocity_gradient(i)
        for i in range(self.aqueous.count[None]):
            self.aqueous.compress(i, dt, self.wall_velocity)
        ti.loop_config(serialize=True)
        for once in range(1):
            for i in range(self.aqueous.wall_count[None]):
                self._end_cornea_step(i, dt)
            self._settle_pressure()
