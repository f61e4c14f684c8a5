"""Spectra of the discrete system, from the solver's own step.

One time step of the solver, taken about rest, is a linear map of its state. `step_matrix` takes it column by column:
each unit perturbation goes through the actual kernels. An eigenvalue m of the map over dt is the mode exp(lambda t),
lambda = log(m) / dt: its real part the growth rate [1/s], its imaginary part the angular frequency [rad/s]. At a dt far
below the stable one, lambda is the spectrum of the semi-discrete operator up to dt^2; at the dt of a run it is the
stability of that run, time integration and coupling included.
"""

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from taichi_eye.backend import real
from taichi_eye.cloud.packing import Cloud
from taichi_eye.eye.laws import LAWS, Law
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.coupling import Coupling
from taichi_eye.solver.figures import NOT_CONVERGED

PERTURBATION = 1e-7  # of each variable's own scale: small enough to be linear, large enough for 1e-9 of accuracy


@ti.data_oriented
class CoupledSystem:
    """Cornea and aqueous humour about rest, stepped by the solver's coupling.

    State vector: pressures [n] over rho c, velocities [2 n], and for the wall nodes displacements times c / spacing,
    velocities and accelerations times spacing / c [2 w each]: all in m/s, so that one perturbation suits all.
    """

    def __init__(
        self,
        capacity: int,
        walls_capacity: int,
        *,
        basis: str = "quadratic",
        planar: bool = False,
        law: Law = LAWS["exponential"],
        rim: str = "clamped",
    ):
        self.cornea = Cornea(walls_capacity, law, rim, planar)
        self.aqueous = Aqueous(capacity, basis, planar)
        self.coupling = Coupling(self.cornea, self.aqueous)
        self.pressure_scale, self.length_scale, self.acceleration_scale = (ti.field(real(), ()) for _ in range(3))

    def setup(
        self,
        cloud: Cloud,
        *,
        thickness: float,
        wall_density: float,
        material,
        iop: float,
        density: float,
        viscosity: float,
        sound_speed: float,
        dissipation: float,
        stencil: int | None = None,
        iterated: bool = True,
        sweeps_max: int = 60,
    ) -> None:
        """Put a cloud and its cornea to rest (SI units; as `Cornea.setup`, `Aqueous.setup` and `Coupling.setup`).

        material: the coefficients of the tissue law and, last, the prestrain.
        """
        self.iterated, self.sweeps_max = iterated, sweeps_max
        self.cloud, self.count, self.walls = cloud, cloud.count, cloud.wall_count
        nodes = cloud.section.cornea_nodes(cloud.wall_count - 1)
        *coefficients, prestrain = material
        self.cornea.setup(
            nodes,
            thickness=thickness,
            density=wall_density,
            coefficients=coefficients,
            prestrain=prestrain,
            iop=iop,
            load_shape=np.zeros(self.walls),
        )
        self.aqueous.setup(
            cloud,
            density=density,
            viscosity=viscosity,
            sound_speed=sound_speed,
            dissipation=dissipation,
            stencil=stencil,
        )
        self.sound_speed, self.spacing = sound_speed, cloud.spacing
        self.pressure_scale[None] = density * sound_speed
        self.length_scale[None] = cloud.spacing / sound_speed
        self.acceleration_scale[None] = sound_speed / cloud.spacing
        self._remember()

    def _set_coupling(self, iterated: bool, tolerance: float, sweeps_max: int) -> None:
        self.coupling.setup(iterated=iterated, aitken=False, factor=1.0, tolerance=tolerance, sweeps_max=sweeps_max)

    @property
    def size(self) -> int:
        """Length of the state vector."""
        return 3 * self.count + 6 * self.walls

    @ti.kernel
    def _remember(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.coupling.rest_enclosed[0] = self.cornea.enclosed_volume(0, self.cornea.place)

    @ti.kernel
    def _load(self, state: ti.types.ndarray()):
        n, w = self.aqueous.count[0], self.aqueous.wall_count[0]
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            for i in range(n):
                self.aqueous.pressure[i] = state[i] * self.pressure_scale[None]
                self.aqueous.velocity[i] = ti.Vector([state[n + 2 * i], state[n + 2 * i + 1]])
            for i in range(w):
                at = 3 * n + 2 * i
                self.cornea.place[i] = self.cornea.rest[i] + self.length_scale[None] * ti.Vector(
                    [state[at], state[at + 1]]
                )
                self.cornea.lost[i] = ti.Vector([0.0, 0.0])
                self.cornea.velocity[i] = ti.Vector([state[at + 2 * w], state[at + 2 * w + 1]])
                self.cornea.acceleration[i] = self.acceleration_scale[None] * ti.Vector(
                    [state[at + 4 * w], state[at + 4 * w + 1]]
                )
            for i in range(n):
                self.aqueous.find_velocity_gradient(0, i)
            self.aqueous.last_volume[0] = self.coupling.chamber_volume(0)

    @ti.kernel
    def _store(self, state: ti.types.ndarray()):
        n, w = self.aqueous.count[0], self.aqueous.wall_count[0]
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            for i in range(n):
                state[i] = self.aqueous.pressure[i] / self.pressure_scale[None]
                for a in ti.static(range(2)):
                    state[n + 2 * i + a] = self.aqueous.velocity[i][a]
            for i in range(w):
                at = 3 * n + 2 * i
                for a in ti.static(range(2)):
                    state[at + a] = (self.cornea.place[i][a] - self.cornea.rest[i][a]) / self.length_scale[None]
                    state[at + 2 * w + a] = self.cornea.velocity[i][a]
                    state[at + 4 * w + a] = self.cornea.acceleration[i][a] / self.acceleration_scale[None]

    def step(self, state, dt: float):
        """The state one step of dt [s] after `state`."""
        self._load(state)
        # as good as exact: the sweeps go on until nothing changes, and their limit is no failure here
        self._set_coupling(self.iterated, 1e-14, self.sweeps_max)
        self.coupling.advance(np.zeros(1), dt, dt)
        after = np.empty_like(state)
        self._store(after)
        return after

    def run(self, state, dt: float, steps: int):
        """The state `steps` steps of dt [s] after `state`, as a run takes them; None where the coupling gave up."""
        self._load(state)
        self._set_coupling(self.iterated, 1e-10, self.sweeps_max)
        self.coupling.advance(np.zeros(steps), dt, dt)
        if self.coupling.status[0] == NOT_CONVERGED:
            return None
        after = np.empty_like(state)
        self._store(after)
        return after

    def residual_after(self, dt: float, sweeps: int, tolerance: float = 0.0) -> tuple[int, float]:
        """Sweeps taken and residual left by the coupling iteration of one step from a kick of the wall."""
        state = np.zeros(self.size)
        kick = np.sin(np.linspace(0.0, 9.0, self.walls)) + 1.0
        state[3 * self.count + 2 * self.walls + 1 : 3 * self.count + 4 * self.walls : 2] = 1e-3 * kick
        self._load(state)
        self._set_coupling(True, tolerance, sweeps)
        self.coupling.advance(np.zeros(1), dt, dt)
        return self.coupling.sweeps[0], self.coupling.worst_residual[0]

    def contraction(self, dt: float) -> float:
        """Factor by which a sweep of the plain iteration shrinks the residual, from the last sweeps above rounding."""
        residual = np.array([self.residual_after(dt, sweeps)[1] for sweeps in range(1, 9)])
        above = residual > 1e-12 * residual[0]
        last = int(np.nonzero(above)[0][-1])
        first = max(0, last - 3)
        return float((residual[last] / residual[first]) ** (1.0 / max(last - first, 1)))


def step_matrix(system, dt: float, progress=None):
    """The matrix of one step of dt [s] about rest, column by column through the actual kernels."""
    size = system.size
    matrix = np.empty((size, size))
    state = np.zeros(size)
    rest = system.step(state, dt)
    for column in range(size):
        state[column] = PERTURBATION
        matrix[:, column] = (system.step(state, dt) - rest) / PERTURBATION
        state[column] = 0.0
        if progress is not None and column % 200 == 0:
            progress(column / size)
    return matrix


def reachable(matrix):
    """The map restricted to the variables that a step ever changes; the rest only decays to nothing at once."""
    keep = np.any(matrix != 0.0, axis=1)
    return matrix[np.ix_(keep, keep)]


def exponents(matrix, dt: float):
    """All lambda [1/s] of the map over dt; modes that one step wipes out are left out."""
    multiplier = np.linalg.eigvals(reachable(matrix))
    multiplier = multiplier[np.abs(multiplier) > 1e-9]
    return np.log(multiplier) / dt


def growth(matrix, dt: float) -> float:
    """Largest growth rate [1/s] of the map over dt."""
    return float(exponents(matrix, dt).real.max())


def mode(matrix, dt: float, frequency: float, sweeps: int = 40) -> tuple[float, float]:
    """Frequency [Hz] and damping rate [1/s] of the mode nearest to a frequency [Hz], by inverse iteration.

    The shift stays at the frequency asked for, so the nearest mode wins by the ratio of the distances per sweep.
    Returns NaN where that has not settled to 1e-8 after `sweeps`.
    """
    kept = reachable(matrix)
    shift = np.exp(2j * np.pi * frequency * dt)
    factors = lu_factor(kept - shift * np.eye(len(kept)))
    vector = np.random.default_rng(0).standard_normal(len(kept)).astype(complex)
    value = shift
    for _ in range(sweeps):
        vector /= np.linalg.norm(vector)
        after = lu_solve(factors, vector)
        before, value = value, shift + 1.0 / np.vdot(vector, after)
        vector = after
        if abs(value - before) < 1e-8 * abs(np.log(value)):
            exponent = np.log(value) / dt
            return float(exponent.imag / (2.0 * np.pi)), float(-exponent.real)
    return float("nan"), float("nan")
