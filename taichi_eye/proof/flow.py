"""The aqueous humour alone: the solver's own fluid kernels in a domain without a cornea.

The step is the fluid's part of `taichi_eye.solver.coupling`, in the same order and from the same functions: pressure
gradient, momentum, boundary values, velocity gradients, continuity. Added here are only what the problems prescribe:
velocities of WALL nodes (a lid), a body force along z, and copies of nodes beyond the edges (`domains.Images`).
"""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.cloud.packing import FREE, WALL, Cloud
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.proof.domains import Images
from taichi_eye.solver.aqueous import Aqueous


@ti.data_oriented
class Flow:
    """A liquid in a fixed domain; the first `count` nodes are its own, images follow.

    capacity: most nodes, images included; basis, planar: as the solver's.
    """

    def __init__(self, capacity: int, *, basis: str = "quadratic", planar: bool = False):
        fp = real()
        self.aqueous = Aqueous(capacity, basis, planar)
        self.own, self.copied, self.sealed = (ti.field(ti.i32, ()) for _ in range(3))
        self.source = ti.field(ti.i32, capacity)
        self.sign, self.still, self.prescribed = (ti.Vector.field(2, fp, capacity) for _ in range(3))

    def setup(
        self,
        cloud: Cloud,
        images: Images | None = None,
        *,
        density: float,
        viscosity: float,
        sound_speed: float,
        dissipation: float,
        stencil: int | None = None,
    ) -> None:
        """Fill the domain; images: copies beyond its edges; the rest as `Aqueous.setup` (SI units)."""
        images = images or Images.none()
        self.cloud, self.count = cloud, cloud.count
        copies = len(images.source)
        total = self.count + copies
        whole = Cloud(
            cloud.section,
            cloud.spacing,
            np.vstack([cloud.points, images.place]),
            0,
            np.concatenate([cloud.kind, np.full(copies, FREE, dtype=np.int32)]),
            np.vstack([cloud.direction, np.zeros((copies, 2))]),
            cloud.triangles,
            np.zeros(total, dtype=np.int32),
            np.zeros(total),
            np.zeros(total),
        )
        self.aqueous.setup(
            whole,
            density=density,
            viscosity=viscosity,
            sound_speed=sound_speed,
            dissipation=dissipation,
            stencil=stencil,
        )
        source = np.zeros(self.aqueous.capacity, dtype=np.int32)
        sign = np.zeros((self.aqueous.capacity, 2))
        source[:copies], sign[:copies] = images.source, images.sign
        self.source.from_numpy(source)
        self.sign.from_numpy(sign)
        self.own[None], self.copied[None] = self.count, copies
        # closed by its own walls: the solver's mass fix applies
        self.sealed[None] = copies == 0 and len(cloud.triangles) > 0
        self.density, self.viscosity, self.sound_speed = density, viscosity, sound_speed

    @property
    def size(self) -> int:
        """Length of the state vector: pressures, then velocities (r, z interleaved)."""
        return 3 * self.count

    def set(self, velocity=None, pressure=None) -> None:
        """Start from velocity [count, 2] (m/s) and pressure [count] (Pa); left out: 0."""
        for field, values in ((self.aqueous.velocity, velocity), (self.aqueous.pressure, pressure)):
            whole = np.zeros(field.shape + ((2,) if hasattr(field, "n") else ()))
            if values is not None:
                whole[: self.count] = values
            field.from_numpy(whole)
        self._start()

    def prescribe(self, velocity) -> None:
        """Velocities [count, 2] that the WALL nodes take."""
        whole = np.zeros((self.aqueous.capacity, 2))
        whole[: self.count] = velocity
        self.prescribed.from_numpy(whole)

    def velocity(self):
        """Velocities [count, 2]."""
        return self.aqueous.velocity.to_numpy()[: self.count]

    def pressure(self):
        """Pressures [count]."""
        return self.aqueous.pressure.to_numpy()[: self.count]

    @ti.kernel
    def _start(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            for g in range(self.copied[None]):
                self._copy_velocity(g)
            for i in range(self.own[None]):
                self.aqueous.find_velocity_gradient(0, i)
            for g in range(self.copied[None]):
                self._copy_velocity_gradient(g)
                self._copy_pressure(g)
            self._settle()

    @ti.func
    def _settle(self):
        if self.sealed[None] == 1:
            self.aqueous.pressure_shift[0] = self.aqueous.missing_pressure(0, self.aqueous.rest_volume[0], 0.0)

    @ti.func
    def _copy_velocity(self, g):
        self.aqueous.velocity[self.own[None] + g] = self.sign[g] * self.aqueous.velocity[self.source[g]]

    @ti.func
    def _copy_pressure(self, g):
        copy, source = self.own[None] + g, self.source[g]
        self.aqueous.pressure[copy] = self.aqueous.pressure[source]
        self.aqueous.lay_momentum_row(copy, self.aqueous.momentum_row[source][0])

    @ti.func
    def _copy_kicked(self, g):
        copy, row = self.own[None] + g, self.aqueous.continuity_row[self.source[g]]
        self._copy_velocity(g)
        self.aqueous.continuity_row[copy] = self.aqueous.smoother.row_of_scalar(
            copy, self.aqueous.momentum_row[copy][0], self.sign[g] * ti.Vector([row[1], row[2]])
        )

    @ti.func
    def _copy_velocity_gradient(self, g):
        both = self.sign[g].outer_product(self.sign[g])
        self.aqueous.velocity_gradient[self.own[None] + g] = both * self.aqueous.velocity_gradient[self.source[g]]
        self.aqueous.slopes[self.own[None] + g] = both * self.aqueous.slopes[self.source[g]]

    @ti.func
    def _step(self, dt, force):
        for i in range(self.own[None]):
            self.aqueous.kick(0, i, dt, self.still)
        for i in range(self.own[None]):
            if self.aqueous.kind[i] == WALL:
                self.aqueous.velocity[i] = self.prescribed[i]
            if force != 0.0 and (self.aqueous.kind[i] == FREE or self.aqueous.slide[i][1] == 1.0):
                self.aqueous.velocity[i][1] += dt * force / self.aqueous.density(0, i)
        for g in range(self.copied[None]):
            self._copy_kicked(g)
        for i in range(self.own[None]):
            self.aqueous.compress(0, i, dt, self.still)
        for g in range(self.copied[None]):
            self._copy_velocity_gradient(g)
            self._copy_pressure(g)
        self._settle()

    @ti.kernel
    def advance(self, steps: int, dt: float, start: float, amplitude: float, frequency: float):
        """`steps` steps of dt [s] under the body force amplitude cos(frequency t) [N/m^3] along z from time `start`."""
        ti.loop_config(serialize=True)
        for step in range(steps):
            middle = start + (step + 0.5) * dt
            self._step(dt, amplitude * ti.cos(frequency * middle))

    @ti.kernel
    def load(self, state: ti.types.ndarray()):
        """Take pressures and velocities from a state vector."""
        for i in range(self.own[None]):
            self.aqueous.pressure[i] = state[i]
            self.aqueous.velocity[i] = ti.Vector([state[self.own[None] + 2 * i], state[self.own[None] + 2 * i + 1]])

    @ti.kernel
    def store(self, state: ti.types.ndarray()):
        """Write pressures and velocities into a state vector."""
        for i in range(self.own[None]):
            state[i] = self.aqueous.pressure[i]
            state[self.own[None] + 2 * i] = self.aqueous.velocity[i][0]
            state[self.own[None] + 2 * i + 1] = self.aqueous.velocity[i][1]

    def step(self, state, dt: float):
        """The state one step of dt [s] after `state`."""
        self.load(state)
        self._start()
        self.advance(1, dt, 0.0, 0.0, 0.0)
        after = np.empty_like(state)
        self.store(after)
        return after
