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
between two over the nodes, and on a GPU step 1 and the mean pressure's sum go beside step 2. Steps 1 and 3 of an eye
are carried out by its team (`taichi_eye.solver.team`), a block of threads on a GPU, one thread on a CPU, and so, where
an eye marches on its own, are steps 2 and 4. P p is summed once for all sweeps; a sweep sums the divergence alone, over
gradient weights.

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
from taichi_eye.solver.team import team_for

SERIAL_NODES = 4000  # up to here one thread running the whole time loop beats launching each loop on all of them
# On a GPU, estimated and not measured: a block of threads takes some 4 us for each pass over as many nodes as it has
# threads; a step's launches take some 60 us besides their gathers, which take 38 us up to some thousand nodes. So a
# block is faster up to TEAM_NODES, and from TEAM_EYES eyes on, which keep a good third of an H100's multiprocessors
# busy, at any size.
TEAM_NODES, TEAM_EYES = 1000, 48
PARTS = 1024  # threads that sum the mean pressure of an eye on a GPU, beside those that kick its nodes
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
        self.team = team_for(eyes)
        if self.team.lanes > 1:
            self.pressure_part = ti.Vector.field(2, fp, (eyes, PARTS))  # `Aqueous.pressure_sums`
        self._plan = None
        self.march_all, step_all = _launches(self)
        self._step_all = backend.launcher(step_all)

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
        if self.marches(self.aqueous.nodes[:1]):
            self.march_all(plan)
        else:
            self.advance_in_parallel(plan)

    def marches(self, nodes: np.ndarray) -> bool:
        """Whether eyes of so many nodes take their steps each on its own, from end to end in one launch, rather than
        all together in launches for each pass over the nodes."""
        if backend.on_cpu():
            return len(nodes) >= backend.threads() or nodes.max() <= SERIAL_NODES
        return self.team.lanes > 1 and (len(nodes) >= TEAM_EYES or nodes.max() <= TEAM_NODES)

    def advance_in_parallel(self, plan: np.ndarray) -> None:
        """Carry out a plan (`plan_of`), each pass of a step in parallel over the nodes of all eyes."""
        everyone = np.zeros((len(self.aqueous.nodes), plan.shape[1]))
        everyone[plan[:, 0].astype(int)] = plan
        if self.team.block:
            everyone = self._sent(everyone)
        step_all = self._step_all
        for step in range(int(plan[:, 1].max())):
            step_all(step, everyone)

    def _sent(self, plan: np.ndarray):
        """A plan in the device's own memory: an array of Python's would go there and come back with each launch."""
        if self._plan is None or self._plan.shape[1] < plan.shape[1]:
            self._plan = ti.ndarray(ti.f64, (plan.shape[0], 2 * plan.shape[1]))
        whole = np.zeros(self._plan.shape)
        whole[:, : plan.shape[1]] = plan
        self._plan.from_numpy(whole)
        return self._plan

    @ti.func
    def _work_of_air(self, eye, i, puff, dt):
        # trapezoid: the force before this call is the one at the start of the step
        self.cornea.air_pressure[i] = puff * self.cornea.load_shape[i]
        moved = self.cornea.held(eye, i, dt * self.cornea.velocity[i] + 0.5 * dt * dt * self.cornea.acceleration[i])
        before = self.cornea.force_air[i]
        self.cornea.collect_forces(eye, i)
        return 0.5 * (before + self.cornea.force_air[i]).dot(moved)

    @ti.func
    def move_wall(self, eye, lane, puff, dt):
        """Step 1, by a lane: places, tensions and forces of the membrane."""
        start, end = self.team.share(self.cornea.first[eye], self.cornea.last[eye] + 1, lane)
        for i in range(start, end):
            self.cornea.predict(eye, i, dt)
            self.guess[i] = self.cornea.acceleration[i]
            self.last_miss[i] = ti.Vector([0.0, 0.0])
        self.team.meet(eye)
        self.cornea.spread_load(eye, self.team, lane)
        relaxed = self.cornea.deform_share(eye, dt, self.team, lane)
        # a node's force asks for the tensions on either side
        self.team.meet(eye)
        work = 0.0
        for i in range(start, end):
            work += self._work_of_air(eye, i, puff, dt)
        sums = self.team.sum(eye, lane, ti.Vector([work, relaxed]))
        if lane == 0:
            self.cornea.puff_work[eye] += sums[0]
            self.cornea.relaxed_work[eye] = sums[1]

    @ti.func
    def _match_wall(self, eye, lane, dt, volume):
        """Step 3, by a lane: iterate the membrane's acceleration; volume: of the chamber [m^3]."""
        start, end = self.team.share(self.cornea.first[eye], self.cornea.last[eye] + 1, lane)
        omega = self.factor[eye]
        for i in range(start, end):
            self.wall_rough[i] = self.aqueous.smoother.roughness_at(i, self.aqueous.continuity_row)
            self.ring[i] = self.cornea.volume_gradient(eye, i)
        sweep = 0
        residual = ti.math.inf
        going = True
        while going:
            top, swept = self.velocity_floor[eye], 0.0
            for i in range(start, end):
                after = self.cornea.velocity[i] + 0.5 * dt * (self.cornea.acceleration[i] + self.guess[i])
                self.wall_velocity[i] = self.cornea.held(eye, i, 0.5 * (self.cornea.velocity[i] + after))
                top = ti.max(top, after.norm())
            for i in range(start, end):
                self.aqueous.velocity[i] = self.aqueous.meet_wall(eye, i, self.cornea.place, self.wall_velocity[i])
            if self.aqueous.sealed[eye] == 0:
                for i in range(start, end):
                    swept += self.ring[i].dot(self.wall_velocity[i])
                sums = self.team.sum(eye, lane, ti.Vector([swept, 0.0]))
                if lane == 0:
                    self.aqueous.outflow[eye] = -sums[0] / volume
            # a node's divergence asks for the velocities of its neighbours
            self.team.meet(eye)
            for i in range(start, end):
                divergence = self.aqueous.operators.divergence_at(i, self.aqueous.place, self.aqueous.velocity)
                self.wall_pressure[i] = (
                    self.aqueous.pressure[i]
                    + self.aqueous.pressure_shift[eye]
                    + dt * self.aqueous.pressure_rate(eye, i, divergence, self.wall_rough[i], self.wall_velocity)
                )
            residual = 0.0
            square, product, broken = 0.0, 0.0, 0.0
            for i in range(start, end):
                force = self.cornea.force_solid[i] + self.cornea.force_air[i] + self.wall_pressure[i] * self.ring[i]
                miss = self.cornea.held(eye, i, force / self.cornea.mass[i]) - self.guess[i]
                change = miss - self.last_miss[i]
                square += change.norm_sqr()
                product += self.last_miss[i].dot(change)
                change_of_velocity = 0.5 * dt * miss.norm()
                residual = ti.max(residual, change_of_velocity)
                # a maximum forgets NaN
                if ti.math.isnan(change_of_velocity):
                    broken = 1.0
                self.miss[i] = miss
            # from here on all lanes know the same, and go the same way
            sums, tops, _ = self.team.combine(
                eye, lane, ti.Vector([square, product, broken]), ti.Vector([residual, top]), ti.Vector([0, 0])
            )
            square, product, residual = sums[0], sums[1], tops[0] / tops[1]
            if sums[2] > 0.0:
                residual = ti.math.inf
            sweep += 1
            if self.iterated[eye] == 1:
                # written so that NaN goes on to the limit instead of passing
                going = not (residual <= self.tolerance[eye]) and sweep < self.sweeps_max[eye]
                if going:
                    if self.aitken[eye] == 1 and sweep > 1 and square > 0.0:
                        omega = -omega * product / square
                    for i in range(start, end):
                        self.guess[i] += omega * self.miss[i]
                        self.last_miss[i] = self.miss[i]
            else:
                going = False
                for i in range(start, end):
                    self.guess[i] += self.miss[i]
        if lane == 0:
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
        return self.volume_over(eye, self.cornea.enclosed_volume(eye, self.cornea.place))

    @ti.func
    def volume_over(self, eye, enclosed):
        """Volume [m^3] of the chamber under a cornea that encloses so much over the limbus plane."""
        return self.aqueous.rest_volume[eye] + (enclosed - self.rest_enclosed[eye])

    @ti.func
    def match_wall(self, eye, lane, dt, pressure, weight):
        """Mean pressure and step 3, by a lane, and the state of the cornea at the end of the step.

        pressure, weight: the lane's share of `Aqueous.pressure_sums`.
        """
        enclosed = self.cornea.enclosed_volume(eye, self.cornea.place, self.team, lane)
        sums = self.team.sum(eye, lane, ti.Vector([enclosed, pressure, weight]))
        volume = self.volume_over(eye, sums[0])
        if lane == 0:
            # the lanes meet before anyone asks for it
            self.aqueous.pressure_shift[eye] = self.aqueous.add_pressure(eye, volume, dt, sums[1] / sums[2])
        self._match_wall(eye, lane, dt, volume)
        start, end = self.team.share(self.cornea.first[eye], self.cornea.last[eye] + 1, lane)
        for i in range(start, end):
            self._end_cornea_step(eye, i, dt)
        if lane == 0:
            self.cornea.half_step[eye] = 0.5 * dt

    @ti.func
    def march(self, eye, lane, k, plan: ti.template()):
        """All steps of an eye by its team: row k of a plan (`plan_of`)."""
        steps, dt, kick_dt = int(plan[k, 1]), float(plan[k, 2]), float(plan[k, 3])
        first = self.aqueous.first[eye]
        start, end = self.team.share(first, first + self.aqueous.count[eye], lane)
        for step in range(steps):
            if self.status[eye] == RUNNING:
                if step > 0:
                    kick_dt = dt
                for i in range(start, end):
                    self.aqueous.kick(eye, i, kick_dt, self.cornea.velocity)
                # step 1 reads and writes nothing of this; all meet in it
                self.move_wall(eye, lane, float(plan[k, 4 + step]), dt)
                pressure, weight = self.aqueous.pressure_sums(eye, lane, self.team.lanes)
                self.match_wall(eye, lane, dt, pressure, weight)
                # the last meeting has been before the wall's last guess, of which nothing is read here
                for i in range(start, end):
                    self.aqueous.compress(eye, i, dt, self.wall_velocity)
                self.team.meet(eye)


def _launches(coupling):
    """All steps of eyes by their teams, and one step of all eyes, each of its passes in parallel over all nodes.

    Closures, since a launch of a method costs half as much again in Python.
    """
    aqueous, cornea, team = coupling.aqueous, coupling.cornea, coupling.team

    @ti.kernel
    def march_all(plan: ti.types.ndarray()):
        if ti.static(team.block):
            ti.loop_config(block_dim=team.block)
        elif ti.static(team.lanes == 1):
            ti.loop_config(serialize=True)
        for n in range(team.extent(plan.shape[0], 0)):
            k, lane, _ = team.seat(n, plan.shape[0], 0)
            if lane >= 0:
                coupling.march(int(plan[k, 0]), lane, k, plan)

    eyes, parts = cornea.first.shape[0], PARTS

    @ti.func
    def runs(eye, step, plan: ti.template()):
        """Whether an eye takes this step of its row."""
        return step < plan[eye, 1] and coupling.status[eye] == RUNNING

    @ti.func
    def kick(i, step, plan: ti.template()):
        eye = aqueous.neighbours.eye_of[i]
        if runs(eye, step, plan):
            kick_dt = float(plan[eye, 2])
            if step == 0:
                kick_dt = float(plan[eye, 3])
            aqueous.kick(eye, i, kick_dt, cornea.velocity)

    @ti.func
    def compress(i, plan: ti.template()):
        eye = aqueous.neighbours.eye_of[i]
        if coupling.going[eye] == 1:
            aqueous.compress(eye, i, float(plan[eye, 2]), coupling.wall_velocity)

    # row k of a plan is that of eye k
    @ti.kernel
    def step_by_threads(step: int, plan: ti.types.ndarray()):
        for i in range(aqueous.neighbours.total[None]):
            kick(i, step, plan)
        # not worth waking other threads for
        ti.loop_config(serialize=True)
        for eye in range(plan.shape[0]):
            coupling.going[eye] = 0
            if runs(eye, step, plan):
                coupling.going[eye] = 1
                coupling.move_wall(eye, 0, float(plan[eye, 4 + step]), float(plan[eye, 2]))
                pressure, weight = aqueous.pressure_sums(eye, 0, 1)
                coupling.match_wall(eye, 0, float(plan[eye, 2]), pressure, weight)
        for i in range(aqueous.neighbours.total[None]):
            compress(i, plan)

    @ti.kernel
    def step_by_teams(step: int, plan: ti.types.ndarray()):
        # loops go over the capacity: how many nodes there are would have to be asked first, by a launch of its own.
        # Beside the nodes' velocities step 1, and the sum of the mean pressure in parts
        if ti.static(team.block):
            ti.loop_config(block_dim=team.block)
        for n in range(team.extent(eyes, eyes * parts + aqueous.capacity)):
            eye, lane, other = team.seat(n, eyes, eyes * parts + aqueous.capacity)
            if eye >= 0:
                if lane >= 0 and runs(eye, step, plan):
                    coupling.move_wall(eye, lane, float(plan[eye, 4 + step]), float(plan[eye, 2]))
            elif other < eyes * parts:
                eye, part = other // parts, other % parts
                if runs(eye, step, plan):
                    total, weight = aqueous.pressure_sums(eye, part, parts)
                    coupling.pressure_part[eye, part] = ti.Vector([total, weight])
            elif other - eyes * parts < aqueous.neighbours.total[None]:
                kick(other - eyes * parts, step, plan)
        if ti.static(team.block):
            ti.loop_config(block_dim=team.block)
        for n in range(team.extent(eyes, 0)):
            eye, lane, _ = team.seat(n, eyes, 0)
            if lane >= 0:
                going = runs(eye, step, plan)
                # nobody says how the step ended before all have asked whether there is one
                team.meet(eye)
                if lane == 0:
                    coupling.going[eye] = going
                if going:
                    first, end = team.share(0, parts, lane)
                    pressure, weight = 0.0, 0.0
                    for part in range(first, end):
                        pressure += coupling.pressure_part[eye, part][0]
                        weight += coupling.pressure_part[eye, part][1]
                    coupling.match_wall(eye, lane, float(plan[eye, 2]), pressure, weight)
        for i in range(aqueous.capacity):
            if i < aqueous.neighbours.total[None]:
                compress(i, plan)

    return march_all, step_by_teams if team.lanes > 1 else step_by_threads
