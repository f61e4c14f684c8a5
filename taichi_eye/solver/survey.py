"""What is read off the coupled state between steps: the figures of `taichi_eye.solver.figures`.

Energies: the aqueous humour stores the integral of p / rho^2 d rho per unit mass; its part with the IOP is IOP (V0 -
V), which is also what pushing fluid out costs.
"""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.coupling import Coupling
from taichi_eye.solver.figures import QUANTITIES, at


@ti.data_oriented
class Survey:
    """Measures the state of coupled pairs into rows of named figures, one for each eye; nodes count from the eye's
    first."""

    def __init__(self, cornea: Cornea, aqueous: Aqueous, coupling: Coupling):
        self.cornea, self.aqueous, self.coupling, self.team = cornea, aqueous, coupling, coupling.team
        eyes = cornea.first.shape[0]
        self.built_place = ti.Vector.field(2, real(), cornea.capacity)
        self.rest_energy, self.back = ti.field(real(), eyes), ti.field(real(), cornea.capacity)

    def take(self) -> dict[str, float]:
        """All figures of eye 0 by name."""
        row = np.zeros((1, len(QUANTITIES)))
        self.measure(np.zeros(1, dtype=np.int32), row)
        return dict(zip(QUANTITIES, row[0].tolist()))

    def measure(self, eyes, rows) -> None:
        """Put the figures of `eyes` (int32) into their rows of rows [eyes, quantities]."""
        self._measure(eyes, rows)

    def remember_rest(self, back_height, eye: int = 0) -> None:
        """Take the present state of an eye as rest; back_height [wall nodes]: z of the rigid back below each [m]."""
        self._remember_rest(np.asarray(back_height, dtype=float), eye)

    @ti.kernel
    def _remember_rest(self, back_height: ti.types.ndarray(), eye: int):
        for n in range(self.aqueous.wall_count[eye]):
            i = self.aqueous.first[eye] + n
            self.back[i] = back_height[n]
            self.built_place[i] = self.cornea.place[i]
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.rest_energy[eye] = self.cornea.elastic_energy(eye)
            self.coupling.rest_enclosed[eye] = self.cornea.enclosed_volume(eye, self.cornea.place)

    @ti.kernel
    def remember_build(self, due: ti.types.ndarray()):
        """Take the present wall as the one that the operator weights belong to, for the eyes in the mask `due`
        [eyes]."""
        for eye in range(due.shape[0]):
            if due[eye] == 1:
                for i in range(self.aqueous.first[eye], self.aqueous.first[eye] + self.aqueous.wall_count[eye]):
                    self.built_place[i] = self.cornea.place[i]

    @ti.kernel
    def _measure(self, eyes: ti.types.ndarray(), rows: ti.types.ndarray()):
        # an eye to a team
        if ti.static(self.team.block):
            ti.loop_config(block_dim=self.team.block)
        for n in range(self.team.extent(eyes.shape[0], 0)):
            k, lane, _ = self.team.seat(n, eyes.shape[0], 0)
            if lane >= 0:
                self.measure_eye(eyes[k], rows, self.team, lane)

    @ti.func
    def measure_eye(self, eye, rows: ti.template(), team: ti.template(), lane):
        """Put the figures of an eye into its row, by a lane."""
        first, walls, nodes = self.aqueous.first[eye], self.aqueous.wall_count[eye], self.aqueous.count[eye]
        rest_volume = self.aqueous.rest_volume[eye]
        kinetic, elastic, weight = self.aqueous.energy_sums(eye, team, lane)
        viscous, numerical, carried, pressure_volume = 0.0, 0.0, 0.0, 0.0
        bad, ill, worst = -1, first, 0.0
        gap, heaviest = ti.math.inf, 0.0
        start, end = team.share(first, first + nodes, lane)
        for i in range(start, end):
            viscous += self.aqueous.viscous_loss[i]
            pressure_volume += self.aqueous.volume[i] * self.aqueous.pressure[i]
            numerical += self.aqueous.numerical_loss[i]
            carried += self.aqueous.outflow_loss[i]
            sum = self.aqueous.pressure[i] + self.aqueous.velocity[i].sum()
            if bad < 0 and (ti.math.isnan(sum) or ti.math.isinf(sum)):
                bad = i
            if self.aqueous.operators.condition[i] > worst or ti.math.isnan(self.aqueous.operators.condition[i]):
                worst, ill = self.aqueous.operators.condition[i], i
            heaviest = ti.max(heaviest, self.aqueous.smoother.pair_sum[i])
            for k in range(self.aqueous.operators.size[i]):
                entry = self.aqueous.neighbours.entry[i, k]
                if entry >= 0:
                    gap = ti.min(gap, (self.aqueous.place[entry] - self.aqueous.place[i]).norm_sqr())
        flattest, flat = ti.math.inf, first
        start, end = team.share(2 * first, 2 * first + self.aqueous.triangle_count[eye], lane)
        for t in range(start, end):
            share = self.aqueous.triangle_area(t) / self.aqueous.rest_area[t]
            if share < flattest:
                flattest, flat = share, self.aqueous.triangle[t, 0]
        least, slackest = ti.math.inf, first
        in_plane, transverse, step = 0.0, 0.0, ti.math.inf
        slant, slanted = 1.0, first
        start, end = team.share(first, first + walls - 1, lane)
        for k in range(start, end):
            stress, speed, across = self.cornea.wave_speeds(eye, k)
            if ti.min(stress[0], stress[1]) < least:
                least, slackest = ti.min(stress[0], stress[1]), k
            in_plane, transverse = ti.max(in_plane, speed), ti.max(transverse, across)
            if self.cornea.slant(k) > slant:
                slant, slanted = self.cornea.slant(k), k
            step = ti.min(step, self.cornea.element_length[k] / ti.max(speed, 1e-6))
        room, near, travel, bad_wall = ti.math.inf, first, 0.0, -1
        for i in range(start, end):
            above = (self.cornea.place[i][1] - self.back[i]) / (self.cornea.rest[i][1] - self.back[i])
            if above < room:
                room, near = above, i
            travel = ti.max(travel, (self.cornea.place[i] - self.built_place[i]).norm())
            sum = self.cornea.place[i].sum() + self.cornea.velocity[i].sum()
            if bad_wall < 0 and (ti.math.isnan(sum) or ti.math.isinf(sum)):
                bad_wall = i
        stretch = self.cornea.elastic_energy(eye, team, lane)
        motion = self.cornea.kinetic_energy(eye, team, lane)
        enclosed = self.cornea.enclosed_volume(eye, self.cornea.place, team, lane)
        broken = ti.Vector([0.0, 0.0])
        if bad >= 0:
            broken[0] = 1.0
        if bad_wall >= 0:
            broken[1] = 1.0
        if ti.static(team.lanes > 1):
            # of the lanes, whose maxima forget NaN
            if ti.math.isnan(worst):
                worst = ti.math.inf
            sums, tops, places = team.combine(
                eye,
                lane,
                ti.Vector(
                    [kinetic, elastic, weight, viscous, pressure_volume, numerical, carried, stretch, motion, enclosed]
                ),
                ti.Vector(
                    [worst, -flattest, -least, slant, -room, broken[0], broken[1]]
                    + [heaviest, -gap, in_plane, transverse, -step, travel]
                ),
                ti.Vector([ill, flat, slackest, slanted, near, bad, bad_wall] + [first] * 6),
            )
            kinetic, elastic, weight, viscous, pressure_volume = sums[0], sums[1], sums[2], sums[3], sums[4]
            numerical, carried, stretch, motion, enclosed = sums[5], sums[6], sums[7], sums[8], sums[9]
            worst, flattest, least, slant, room = tops[0], -tops[1], -tops[2], tops[3], -tops[4]
            heaviest, gap, in_plane, transverse, step, travel = (
                tops[7],
                -tops[8],
                tops[9],
                tops[10],
                -tops[11],
                tops[12],
            )
            ill, flat, slackest, slanted, near = places[0], places[1], places[2], places[3], places[4]
            bad, bad_wall = places[5], places[6]
            broken[0] = tops[5]
        if broken[0] == 0.0:
            bad = bad_wall
        if lane == 0:
            volume = self.coupling.volume_over(eye, enclosed)
            kinetic, elastic, mean = kinetic * volume / weight, elastic * volume / weight, pressure_volume / weight
            # the volume that the rest of the globe has taken up, and what it stores
            yielded, stretched = self.aqueous.globe.taken_up[eye], self.aqueous.globe.stored(eye)
            # the liquid's mean is stiffer than its waves: what the nodes' own elastic energy has too much of it
            spared = (
                rest_volume
                / self.aqueous.density0[eye]
                * (1.0 / self.aqueous.sound_speed[eye] ** 2 - 1.0 / self.aqueous.mean_speed[eye] ** 2)
            )
            rows[eye, at.apex_place] = self.cornea.place[first][1]
            rows[eye, at.apex_velocity] = self.cornea.velocity[first][1]
            rows[eye, at.fluid_pressure_apex] = self.cornea.iop[eye] + self.aqueous.pressure[first]
            rows[eye, at.volume_error] = (volume + yielded) / rest_volume - 1.0
            rows[eye, at.puff_work] = self.cornea.puff_work[eye]
            rows[eye, at.cornea_elastic] = stretch - self.rest_energy[eye]
            rows[eye, at.cornea_kinetic] = motion
            rows[eye, at.aqueous_kinetic] = kinetic
            rows[eye, at.aqueous_elastic] = (
                elastic + self.cornea.iop[eye] * (rest_volume - volume) + stretched - 0.5 * spared * mean * mean
            )
            rows[eye, at.viscous_loss] = viscous
            rows[eye, at.numerical_loss] = numerical
            rows[eye, at.outflow_loss] = carried
            rows[eye, at.tissue_loss] = self.cornea.relaxed_work[eye] + self.aqueous.globe.work[eye] - stretched
            rows[eye, at.least_stress] = least
            rows[eye, at.slackest_element] = slackest - first
            rows[eye, at.membrane_speed] = in_plane
            rows[eye, at.transverse_speed] = transverse
            rows[eye, at.steepest_slant] = slant
            rows[eye, at.slanted_element] = slanted - first
            rows[eye, at.membrane_step] = step
            rows[eye, at.smallest_gap] = ti.sqrt(gap)
            rows[eye, at.flattest_triangle] = flattest
            rows[eye, at.flat_node] = flat - first
            rows[eye, at.pair_weight] = heaviest
            rows[eye, at.worst_condition] = worst
            rows[eye, at.ill_node] = ill - first
            rows[eye, at.chamber_gap] = room
            rows[eye, at.gap_node] = near - first
            rows[eye, at.not_finite] = ti.select(bad >= 0, 1.0, 0.0)
            rows[eye, at.bad_node] = ti.max(bad - first, -1)
            rows[eye, at.wall_travel] = travel
            rows[eye, at.coupling_sweeps] = self.coupling.sweeps[eye]
            rows[eye, at.coupling_residual] = self.coupling.worst_residual[eye]
            rows[eye, at.coupling_status] = self.coupling.status[eye]
            self.coupling.sweeps[eye] = 0
            self.coupling.worst_residual[eye] = 0.0
