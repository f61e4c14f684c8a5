"""The aqueous humour without a cornea: any cloud, any fields, one set of kernels per basis."""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver.aqueous import Aqueous

CAPACITY, WALLS = 1400, 120


@ti.data_oriented
class Liquid:
    """An aqueous humour whose wall and fields are set by hand; arrays in, arrays out."""

    def __init__(self, basis="quadratic"):
        self.aqueous = Aqueous(CAPACITY, basis)
        self.wall_rest, self.wall_place, self.wall_velocity = (ti.Vector.field(2, real(), WALLS) for _ in range(3))
        self.scalar, self.vector = ti.field(real(), CAPACITY), ti.Vector.field(2, real(), CAPACITY)
        self.number = ti.field(real(), 3)

    def fill(self, cloud, density=1000.0, viscosity=0.8e-3, sound_speed=50.0, dissipation=0.0, no_slip=False):
        """Fill a chamber, at rest, its wall where the cloud has it."""
        self.cloud, self.count, self.walls = cloud, cloud.count, cloud.wall_count
        self.aqueous.setup(
            cloud,
            density=density,
            viscosity=viscosity,
            sound_speed=sound_speed,
            dissipation=dissipation,
            no_slip=no_slip,
        )
        for field in (self.wall_rest, self.wall_place):
            self.put(field, cloud.points[: self.walls])
        self.put(self.wall_velocity, np.zeros((self.walls, 2)))
        return self

    def put(self, field, values):
        whole = np.zeros((*field.shape, *np.shape(values)[1:]))
        whole[: len(values)] = values
        field.from_numpy(whole)

    def get(self, field):
        return field.to_numpy()[: self.count]

    @property
    def places(self):
        return self.get(self.aqueous.place)

    def carry(self, wall, rebuild=True):
        """Move the wall to `wall` and the nodes after it."""
        self.put(self.wall_place, wall)
        self._carry()
        if rebuild:
            self.aqueous.rebuild()

    def set_fields(self, pressure, velocity):
        """Pressure, which is the driving potential too, and velocity."""
        self.put(self.aqueous.pressure, pressure)
        self.put(self.aqueous.velocity, velocity)
        self._differentiate()

    @ti.kernel
    def _carry(self):
        for i in range(self.aqueous.count[0]):
            self.aqueous.move_node(i, self.wall_rest, self.wall_place)

    @ti.kernel
    def _differentiate(self):
        for i in range(self.aqueous.count[0]):
            self.aqueous.find_velocity_gradient(0, i)
            self.aqueous.lay_momentum_row(i, self.aqueous.pressure[i])
        for i in range(self.aqueous.count[0]):
            self.vector[i] = self.aqueous.differentiate_pressure(i)

    @ti.kernel
    def _kick(self, dt: float):
        for i in range(self.aqueous.count[0]):
            self.aqueous.kick(0, i, dt, self.wall_velocity)

    def kick(self, dt):
        """The velocities half a step later."""
        self._kick(dt)
        return self.get(self.aqueous.velocity)

    @ti.kernel
    def _meet(self):
        for i in range(self.aqueous.wall_count[0]):
            self.vector[i] = self.aqueous.meet_wall(0, i, self.wall_place, self.wall_velocity[i])

    def meet(self, kicked, wall_velocity):
        """Velocities of the wall nodes from kicked ones and the cornea's velocities there."""
        self.put(self.aqueous.velocity, kicked)
        self.put(self.wall_velocity, wall_velocity)
        self._meet()
        return self.vector.to_numpy()[: self.walls]

    @ti.kernel
    def _rate(self):
        for i in range(self.aqueous.count[0]):
            self.scalar[i] = self.aqueous.pressure_rate(0, i, self.aqueous.divergence[i], 0.0, self.wall_velocity)

    def pressure_rate(self):
        self._rate()
        return self.get(self.scalar)

    @ti.kernel
    def _dissipate(self):
        for i in range(self.aqueous.count[0]):
            self.vector[i] = self.aqueous.differentiate_pressure(i)
        for i in range(self.aqueous.count[0]):
            self.scalar[i] = self.aqueous.differentiate_velocity(i)

    def dissipation(self):
        """P p [n] and P u [n, 2]."""
        self._dissipate()
        return self.get(self.scalar), self.get(self.vector)

    @ti.kernel
    def _weigh(self, volume: float):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            kinetic, elastic = self.aqueous.energies(0, volume)
            self.number[0], self.number[1] = kinetic, elastic
            self.aqueous.last_volume[0] = volume  # the chamber stands still
            self.number[2] = self.aqueous.missing_pressure(0, volume, 0.0)

    def kinetic_elastic_missing(self, volume):
        self._weigh(float(volume))
        return self.number.to_numpy()
