"""Squeeze flow: the exact, polynomial flow under a moving flat wall."""

import numpy as np

from taichi_eye.cloud.packing import FREE
from taichi_eye.lang import ti
from taichi_eye.proof.comparison import Comparison
from taichi_eye.proof.domains import Vessel, vessel_cloud, with_kinds
from taichi_eye.solver.aqueous import Aqueous


@ti.data_oriented
class _Gap:
    """A liquid whose nodes follow a flat top, and one evaluation of the solver's momentum and continuity on it."""

    def __init__(self, cloud, density, sound_speed, basis):
        self.count = cloud.count
        self.aqueous = Aqueous(cloud.count, basis)
        self.aqueous.setup(
            with_kinds(cloud, np.full(cloud.count, FREE)),
            density=density,
            viscosity=0.0,
            sound_speed=sound_speed,
            dissipation=0.5,
        )
        self.top_rest = ti.Vector.field(2, self.aqueous.place.dtype, cloud.count)
        self.top_place = ti.Vector.field(2, self.aqueous.place.dtype, cloud.count)
        self.top_velocity = ti.Vector.field(2, self.aqueous.place.dtype, cloud.count)
        self.rate = ti.field(self.aqueous.place.dtype, cloud.count)

    @ti.kernel
    def move(self):
        """The solver's node motion."""
        for i in range(self.count):
            self.aqueous.move_node(i, self.top_rest, self.top_place)

    @ti.kernel
    def evaluate(self, dt: float):
        """velocity: after dt along the moving node; rate: dp/dt along it."""
        for i in range(self.count):
            self.aqueous.find_velocity_gradient(0, i)
        for i in range(self.count):
            self.aqueous.kick(0, i, dt, self.top_velocity)
        for i in range(self.count):
            self.rate[i] = self.aqueous.divergence[i]


def squeeze(quick: bool = False):
    """Inviscid flow in a gap H(t) under a falling plate, in rates: every term of the moving-node equations at once.

    u_z = H' z/H, u_r = -H' r/(2 H), p = rho (r^2/4)(H''/H - 1.5 (H'/H)^2) - rho z^2 H''/(2 H) + p0, z from the fixed
    plate. Quadratic in r and z, so the basis holds it: the error is that of rounding, on scattered nodes, wherever they
    have
    moved. A node keeps its share of the gap, w_z = H' z/H, w_r = 0, so du_z/dt = H'' z/H and
    du_r/dt = -(r/2)(H''/H - (H'/H)^2) along it, and div u = 0. H = 3 mm (1 - 0.3) with H' = -0.5 m/s, H'' = 200 m/s^2.
    """
    depth, width, density, c = 3e-3, 6e-3, 1000.0, 100.0
    rows = []
    for basis in ("quadratic", "cubic"):
        worst = np.zeros(3)
        spacings = (0.5e-3,) if quick else (0.5e-3, 0.3e-3)
        for spacing in spacings:
            cloud = vessel_cloud(Vessel(width, depth), spacing)
            worst = np.maximum(worst, _rate_errors(cloud, density, c, basis))
        for name, error in zip(("acceleration", "divergence", "node place"), worst):
            rows.append(
                Comparison(
                    "squeeze flow",
                    f"{name}, {basis} basis, worst node",
                    0.0,
                    float(error),
                    float(error),
                    1e-9,
                    note=f"{spacings[-1] * 1e3:g} mm nodes carried to 70 % of the gap; relative to the largest term",
                )
            )
    return rows, []


def _rate_errors(cloud, density, c, basis):
    rest = 3e-3
    gap, speed, acceleration = 0.7 * rest, -0.5, 200.0
    liquid = _Gap(cloud, density, c, basis)
    r, z0 = cloud.points[:, 0], cloud.points[:, 1] + rest
    z = z0 * gap / rest
    tops = np.zeros((cloud.count, 2))
    tops[:, 0] = np.linspace(0.0, 6e-3, cloud.count)
    liquid.top_rest.from_numpy(tops)
    liquid.top_place.from_numpy(tops + (0.0, gap - rest))
    liquid.top_velocity.from_numpy(np.tile((0.0, speed), (cloud.count, 1)))
    liquid.move()
    moved = liquid.aqueous.place.to_numpy()
    place_error = np.abs(moved - np.column_stack([r, z - rest])).max() / rest
    liquid.aqueous.rebuild()
    velocity = np.column_stack([-0.5 * speed * r / gap, speed * z / gap])
    pressure = density * (
        0.25 * r**2 * (acceleration / gap - 1.5 * (speed / gap) ** 2) - 0.5 * z**2 * acceleration / gap
    )
    liquid.aqueous.velocity.from_numpy(velocity)
    liquid.aqueous.pressure.from_numpy(pressure)
    dt = 1e-6
    liquid.evaluate(dt)
    rate = (liquid.aqueous.velocity.to_numpy() - velocity) / dt
    carried = np.column_stack([-0.5 * r * (acceleration / gap - (speed / gap) ** 2), acceleration * z / gap])
    # the pressure force acts on rho0 + p/c^2 here, on rho0 in the exact flow
    force = np.column_stack([-0.5 * r * (acceleration / gap - 1.5 * (speed / gap) ** 2), acceleration * z / gap])
    exact = carried + force * (density / (density + pressure / c**2) - 1.0)[:, None]
    return np.array(
        [
            np.abs(rate - exact).max() / np.abs(exact).max(),
            np.abs(liquid.rate.to_numpy()).max() / abs(speed / gap),
            place_error,
        ]
    )
