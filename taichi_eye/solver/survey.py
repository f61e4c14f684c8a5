"""What is read off the coupled state between steps: traces, energies, what the guards and the time step need.

Energies, all relative to rest [J]: the puff's work must equal what cornea and aqueous humour store and move with, plus
the viscous and the numerical loss, and what fluid carries off where it may leave. The aqueous humour stores the
integral of p / rho^2 d rho per unit mass; its part with the IOP is IOP (V0 - V), which is also what pushing fluid out
costs.
"""
import numpy as np
import taichi as ti

from taichi_eye.backend import real
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.coupling import Coupling

QUANTITIES = (
    "apex_place", "apex_velocity", "fluid_pressure_apex", "volume_error", "puff_work", "cornea_elastic",
    "cornea_kinetic", "aqueous_kinetic", "aqueous_elastic", "viscous_loss", "numerical_loss", "outflow_loss",
    "least_stress", "slackest_element", "membrane_speed", "transverse_speed", "membrane_step", "smallest_gap",
    "flattest_triangle", "flat_node", "pair_weight", "worst_condition", "ill_node", "chamber_gap", "gap_node",
    "not_finite", "bad_node", "wall_travel", "coupling_sweeps", "coupling_residual", "coupling_status")


@ti.data_oriented
class Survey:
    """Measures the state of a coupled pair into one row of named figures."""

    def __init__(self, cornea: Cornea, aqueous: Aqueous, coupling: Coupling):
        self.cornea, self.aqueous, self.coupling = cornea, aqueous, coupling
        self.row = ti.field(real(), len(QUANTITIES))
        self.built_place = ti.Vector.field(2, real(), cornea.capacity)
        self.rest_energy, self.back = ti.field(real(), ()), ti.field(real(), cornea.capacity)

    def take(self) -> dict[str, float]:
        """All figures by name."""
        self._measure()
        return dict(zip(QUANTITIES, self.row.to_numpy().tolist()))

    def remember_rest(self, back_height) -> None:
        """Take the present state as rest; back_height [wall nodes]: z of the rigid back below each [m]."""
        self._remember_rest(np.asarray(back_height, dtype=float))

    @ti.kernel
    def _remember_rest(self, back_height: ti.types.ndarray()):
        for i in range(self.aqueous.wall_count[None]):
            self.back[i] = back_height[i]
            self.built_place[i] = self.cornea.place[i]
        ti.loop_config(serialize=True)
        for once in range(1):
            self.rest_energy[None] = self.cornea.elastic_energy()
            self.coupling.rest_enclosed[None] = self.cornea.enclosed_volume()

    @ti.kernel
    def remember_build(self):
        """Take the present wall as the one that the operator weights belong to."""
        for i in range(self.aqueous.wall_count[None]):
            self.built_place[i] = self.cornea.place[i]

    @ti.kernel
    def _measure(self):
        ti.loop_config(serialize=True)
        for once in range(1):
            walls, nodes = self.aqueous.wall_count[None], self.aqueous.count[None]
            rest_volume = self.aqueous.rest_volume[None]
            volume = self.coupling.chamber_volume()
            kinetic, elastic = self.aqueous.energies(volume)
            viscous, numerical, carried, pressure_volume, total_volume = 0.0, 0.0, 0.0, 0.0, 0.0
            bad, ill, worst = -1, 0, 0.0
            gap, heaviest = ti.math.inf, 0.0
            for i in range(nodes):
                viscous += self.aqueous.viscous_loss[i]
                pressure_volume += self.aqueous.volume[i] * self.aqueous.pressure[i]
                total_volume += self.aqueous.volume[i]
                numerical += self.aqueous.numerical_loss[i]
                carried += self.aqueous.outflow_loss[i]
                sum = self.aqueous.pressure[i] + self.aqueous.velocity[i].sum()
                if bad < 0 and (ti.math.isnan(sum) or ti.math.isinf(sum)):
                    bad = i
                if self.aqueous.operators.condition[i] > worst or ti.math.isnan(self.aqueous.operators.condition[i]):
                    worst, ill = self.aqueous.operators.condition[i], i
                pairs = 0.0
                for k in range(self.aqueous.smoother.size[i]):
                    pairs += self.aqueous.smoother.pair_weight[i, k]
                heaviest = ti.max(heaviest, pairs)
                for k in range(self.aqueous.operators.size[i]):
                    entry = self.aqueous.neighbours.entry[i, k]
                    if entry >= 0:
                        gap = ti.min(gap, (self.aqueous.place[entry] - self.aqueous.place[i]).norm_sqr())
            flattest, flat = ti.math.inf, 0
            for t in range(self.aqueous.triangle_count[None]):
                share = self.aqueous.triangle_area(t) / self.aqueous.rest_area[t]
                if share < flattest:
                    flattest, flat = share, self.aqueous.triangle[t, 0]
            least, slackest = ti.math.inf, 0
            in_plane, transverse, step = 0.0, 0.0, ti.math.inf
            density = self.cornea.mass[1] / (0.5 * (self.cornea.element_volume[0] + self.cornea.element_volume[1]))
            for k in range(walls - 1):
                strain = self.cornea.strain_of(k)
                stress, energy = self.cornea.stress_of(strain, self.cornea.prestrain[k])
                if ti.min(stress[0], stress[1]) < least:
                    least, slackest = ti.min(stress[0], stress[1]), k
                s, nu = self.cornea.material[1], self.cornea.material[2]
                grown = 2.0 * s * (energy + self.cornea.material[0])
                slope = (1.0 - nu) * strain[0] + nu * (strain[0] + strain[1])
                stretch_squared = 2.0 * (strain[0] - self.cornea.prestrain[k]) + 1.0
                stiffness = grown * (1.0 + 2.0 * s * slope * slope) * stretch_squared + stress[0]
                speed = ti.sqrt(ti.max(stiffness, 0.0) / density)
                in_plane = ti.max(in_plane, speed)
                transverse = ti.max(transverse, ti.sqrt(ti.max(stress[0], 0.0) / density))
                step = ti.min(step, self.cornea.element_length[k] / ti.max(speed, 1e-6))
            room, near, travel = ti.math.inf, 0, 0.0
            for i in range(walls - 1):
                above = (self.cornea.place[i][1] - self.back[i]) / (self.cornea.rest[i][1] - self.back[i])
                if above < room:
                    room, near = above, i
                travel = ti.max(travel, (self.cornea.place[i] - self.built_place[i]).norm())
                sum = self.cornea.place[i].sum() + self.cornea.velocity[i].sum()
                if bad < 0 and (ti.math.isnan(sum) or ti.math.isinf(sum)):
                    bad = i
            # of the liquid's mean excess pressure: the volume that the rest of the globe has taken up
            mean = pressure_volume / total_volume
            yielded = self.aqueous.compliance[None] * mean
            figures = ((
                self.cornea.place[0][1], self.cornea.velocity[0][1],
                self.cornea.iop[None] + self.aqueous.pressure[0], (volume + yielded) / rest_volume - 1.0,
                self.cornea.puff_work[None],
                self.cornea.elastic_energy() - self.rest_energy[None], self.cornea.kinetic_energy(), kinetic,
                elastic + self.cornea.iop[None] * (rest_volume - volume) + 0.5 * yielded * mean, viscous, numerical,
                carried, least, slackest, in_plane, transverse, step, ti.sqrt(gap), flattest, flat, heaviest, worst, ill, room, near,
                ti.select(bad >= 0, 1.0, 0.0), bad, travel, self.coupling.sweeps[None], self.coupling.worst_residual[None],
                self.coupling.status[None]))
            for q in ti.static(range(len(QUANTITIES))):
                self.row[q] = figures[q]
            self.coupling.sweeps[None] = 0
            self.coupling.worst_residual[None] = 0.0
