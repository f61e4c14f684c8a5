"""The liquid on moving nodes: an exact flow, its energies, its mass, its stabilisation and its node motion."""

import numpy as np
import pytest
from scipy.integrate import quad

from taichi_eye.cloud.packing import FIXED, SLIDE
from taichi_eye.cloud.quality import measure
from taichi_eye.units import MM

SHAPES = [(0.25, 7.8), (0.18, 7.2), (0.31, 9.5)]
BASES = ["quadratic", "cubic"]


class Squeeze:
    """Inviscid flow between a plate and a plane at a gap H(t), exact and polynomial:

    u_z = H' z / H, u_r = -H' r / (2H), p = p0 + rho (r^2/4)(H''/H - 1.5 (H'/H)^2) - rho z^2 H''/(2H).
    Material points move as z ~ H, r ~ H^(-1/2), whatever wall they lie on.
    """

    def __init__(self, seed, density=1000.0):
        rng = np.random.default_rng(seed)
        self.gap = rng.uniform(0.7, 1.2)  # H over H at rest
        self.speed, self.push = rng.uniform(-300, 300), rng.uniform(-2e5, 2e5)  # H'/H, H''/H
        self.p0, self.density = rng.uniform(0, 5e3), density

    def place(self, rest):
        return rest * (self.gap**-0.5, self.gap)

    def velocity(self, points):
        return points * (-0.5 * self.speed, self.speed)

    def pressure(self, points):
        r, z = points.T
        return self.p0 + self.density * (0.25 * r**2 * (self.push - 1.5 * self.speed**2) - 0.5 * z**2 * self.push)

    def pressure_gradient(self, points):
        return self.density * points * (0.5 * (self.push - 1.5 * self.speed**2), -self.push)

    def change_at_a_place(self, points):
        """du/dt at a fixed place."""
        return points * (-0.5, 1.0) * (self.push - self.speed**2)


def node_velocity(cloud, wall_velocity):
    """Velocity of every node from the cornea's, by the rule of the node motion."""
    k, f = cloud.wall_index, cloud.wall_fraction[:, None]
    return cloud.height_fraction[:, None] * ((1 - f) * wall_velocity[k] + f * wall_velocity[k + 1])


@pytest.fixture(
    params=[(basis, shape, seed) for basis in BASES for shape in SHAPES for seed in range(2)],
    ids=lambda case: f"{case[0]}, {case[1][0]} mm, R {case[1][1]} mm, H {case[2]}",
)
def squeezed(request, liquid_of, chamber):
    """A liquid in the exact squeeze flow, its wall moved along with the flow since rest, nodes carried."""
    basis, shape, seed = request.param
    liquid, flow, cloud = liquid_of(basis), Squeeze(seed), chamber(*shape)
    # so stiff that the density does not answer the pressure
    liquid.fill(cloud, sound_speed=1e8)
    liquid.carry(flow.place(cloud.points[: cloud.wall_count]))
    places = liquid.places
    liquid.set_fields(flow.pressure(places), flow.velocity(places))
    liquid.put(liquid.wall_velocity, flow.velocity(places[: cloud.wall_count]))
    return liquid, flow, places


def test_squeeze_flow_is_free_of_divergence_on_moved_nodes(squeezed):
    liquid, flow, places = squeezed
    np.testing.assert_allclose(liquid.get(liquid.aqueous.divergence), 0.0, atol=1e-9 * abs(flow.speed))


def test_momentum_of_the_squeeze_flow_is_exact_on_moving_nodes(squeezed):
    liquid, flow, places = squeezed
    dt = 1e-6
    change = (liquid.kick(dt) - flow.velocity(places)) / dt
    carried = node_velocity(liquid.cloud, flow.velocity(places[: liquid.walls])) * (-0.5 * flow.speed, flow.speed)
    exact = flow.change_at_a_place(places) + carried
    fixed = liquid.cloud.kind == FIXED
    np.testing.assert_allclose(change[~fixed], exact[~fixed], rtol=0, atol=1e-7 * np.abs(exact).max())
    assert not liquid.get(liquid.aqueous.velocity)[fixed].any()


def test_continuity_of_the_squeeze_flow_only_carries_pressure_past_moving_nodes(squeezed):
    liquid, flow, places = squeezed
    liquid.aqueous.sound_speed[0] = 30.0  # with rounding times rho c^2 of a real run
    slip = flow.velocity(places) - node_velocity(liquid.cloud, flow.velocity(places[: liquid.walls]))
    exact = -(slip * flow.pressure_gradient(places)).sum(1)
    scale = np.abs(exact).max() + 1000.0 * 30.0**2 * abs(flow.speed)
    np.testing.assert_allclose(liquid.pressure_rate(), exact, rtol=0, atol=1e-8 * scale)


def test_a_wall_that_moves_with_the_flow_leaves_it_alone(squeezed):
    liquid, flow, places = squeezed
    wall = flow.velocity(places[: liquid.walls])
    np.testing.assert_allclose(liquid.meet(flow.velocity(places), wall), wall, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_slip_takes_the_normal_velocity_of_the_wall_and_no_other(liquid, chamber, seed):
    cloud, rng = chamber(), np.random.default_rng(seed)
    liquid.fill(cloud)
    wall = cloud.points[: cloud.wall_count] + 0.02 * MM * rng.normal(size=(cloud.wall_count, 2))
    liquid.carry(wall, rebuild=False)
    kicked, moving = rng.normal(size=(cloud.count, 2)), rng.normal(size=(cloud.wall_count, 2))
    met = liquid.meet(kicked, moving)
    along = wall[2:] - wall[:-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = along[:, ::-1] * (-1.0, 1.0)
    slipping = slice(1, cloud.wall_count - 1)
    np.testing.assert_allclose(((met - moving)[slipping] * normal).sum(1), 0.0, atol=1e-12)
    np.testing.assert_allclose(((met - kicked[: cloud.wall_count])[slipping] * along).sum(1), 0.0, atol=1e-12)
    # the apex and the limbus go with the wall
    np.testing.assert_array_equal(met[[0, -1]], moving[[0, -1]])


def test_no_slip_takes_the_whole_velocity_of_the_wall(liquid, chamber):
    cloud, rng = chamber(), np.random.default_rng(1)
    liquid.fill(cloud, no_slip=True)
    moving = rng.normal(size=(cloud.wall_count, 2))
    np.testing.assert_array_equal(liquid.meet(rng.normal(size=(cloud.count, 2)), moving), moving)


@pytest.mark.parametrize("seed", range(3))
def test_sliding_nodes_keep_to_their_line_and_fixed_ones_to_their_place(liquid, chamber, seed):
    cloud, rng = chamber(0.25, 7.8, 3.6), np.random.default_rng(seed)
    liquid.fill(cloud, dissipation=0.5)
    liquid.set_fields(1e3 * rng.normal(size=cloud.count), rng.normal(size=(cloud.count, 2)))
    kicked = liquid.kick(1e-7)
    slide = cloud.kind == SLIDE
    across = cloud.direction[slide][:, ::-1] * (-1.0, 1.0)
    np.testing.assert_allclose((kicked[slide] * across).sum(1), 0.0, atol=1e-14)
    assert np.abs(kicked[slide]).max() > 0.1
    assert not kicked[cloud.kind == FIXED].any()


@pytest.mark.parametrize("viscosity", [1e-3, 0.05])
def test_viscosity_accelerates_by_the_vector_laplacian(liquid, chamber, viscosity):
    # u_r = a r z, u_z = b r^2 + d z^2: lap u = (0, 4 b + 2 d), grad div u = (0, 2 a + 2 d)
    cloud, (a, b, d) = chamber(0.2), (3e4, -2e4, 5e4)
    liquid.fill(cloud, viscosity=viscosity, sound_speed=1e8)
    r, z = cloud.points.T
    velocity = np.column_stack([a * r * z, b * r**2 + d * z**2])
    divergence = 2 * a * z + 2 * d * z
    liquid.set_fields(-viscosity / 3.0 * divergence, velocity)
    np.testing.assert_allclose(liquid.get(liquid.aqueous.divergence), divergence, atol=1e-9 * np.abs(divergence).max())
    # nodes that go with the flow: no convection; the wall's share is zero here, so take convection out by hand
    gradient = liquid.get(liquid.aqueous.velocity_gradient)
    pushed = (liquid.kick(1.0) - velocity + np.einsum("nij,nj->ni", gradient, velocity)) * 1000.0 / viscosity
    exact = np.array([0.0, 4 * b + 2 * d + (2 * a + 2 * d) / 3.0])
    free = (cloud.kind != FIXED) & (cloud.kind != SLIDE)
    scale = np.abs(velocity).max() / cloud.spacing**2 / (viscosity / 1000.0)
    np.testing.assert_allclose(pushed[free], np.tile(exact, (free.sum(), 1)), atol=1e-10 * scale)


@pytest.mark.parametrize("ratio", [0.0, 1e-8, 1e-4, 0.0099, 0.0101, 0.2, -0.003, -0.1])
@pytest.mark.parametrize("speed", [0.0, 0.7])
def test_energies_of_an_evenly_compressed_liquid(liquid, chamber, ratio, speed):
    c, rho0 = 40.0, 1010.0
    cloud = chamber()
    liquid.fill(cloud, density=rho0, sound_speed=c)
    liquid.set_fields(np.full(cloud.count, ratio * rho0 * c**2), np.full((cloud.count, 2), (0.0, speed)))
    rest = cloud.section.volume()
    volume = rest / (1.0 + ratio)
    kinetic, elastic, missing = liquid.kinetic_elastic_missing(volume)
    assert kinetic == pytest.approx(0.5 * rho0 * rest * speed**2, rel=1e-12)
    # the work of compression: -p dV from V0 to V
    work = rho0 * rest * c**2 * quad(lambda x: x / (1.0 + x) ** 2, 0.0, ratio, epsabs=0.0, epsrel=1e-12)[0]
    assert elastic == pytest.approx(work, rel=1e-9)
    assert missing == pytest.approx(0.0, abs=1e-9 * rho0 * c**2)


@pytest.mark.parametrize("seed", range(4))
def test_missing_pressure_restores_the_mean_density(liquid, chamber, seed):
    cloud, rng = chamber(0.2 + 0.05 * seed), np.random.default_rng(seed)
    c, rho0 = rng.uniform(10, 100), 990.0
    liquid.fill(cloud, density=rho0, sound_speed=c)
    pressure = rng.normal(2e3, 3e3, cloud.count)
    liquid.set_fields(pressure, np.zeros((cloud.count, 2)))
    volume = rng.uniform(0.98, 1.0) * cloud.section.volume()
    shift = liquid.kinetic_elastic_missing(volume)[2]
    share = liquid.get(liquid.aqueous.volume)
    density = rho0 + (pressure + shift) / c**2
    assert (share * density).sum() / share.sum() * volume == pytest.approx(rho0 * cloud.section.volume(), rel=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_node_volumes_add_up_to_the_triangles_rings(liquid, chamber, shape):
    cloud = chamber(*shape)
    liquid.fill(cloud)
    a, b, c = (cloud.points[cloud.triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    volume = liquid.get(liquid.aqueous.volume)
    assert volume.min() > 0.0
    assert volume.sum() == pytest.approx(2.0 * np.pi * (area * (a + b + c)[:, 0] / 3.0).sum(), rel=1e-12)


def quadratic_fields(points, rng):
    x, y = points.T / (3 * MM)
    a, b, d = rng.normal(size=(3, 4))
    even = lambda k: k[0] + k[1] * y + k[2] * y**2 + k[3] * x**2
    return even(a), np.column_stack([d[0] * x + d[1] * x * y, even(b)])


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("depth_mm", [None, 3.6])
@pytest.mark.parametrize("seed", range(3))
def test_dissipation_leaves_quadratic_fields_alone(liquid_of, chamber, basis, depth_mm, seed):
    liquid, cloud, rng = liquid_of(basis), chamber(0.25, 7.8, depth_mm), np.random.default_rng(seed)
    liquid.fill(cloud)
    wall = cloud.points[: cloud.wall_count].copy()
    wall[:, 1] -= 0.5 * seed * MM * np.exp(-((wall[:, 0] / (1.8 * MM)) ** 2))
    liquid.carry(wall)
    pressure, velocity = quadratic_fields(liquid.places, rng)
    liquid.set_fields(pressure, velocity)
    rough_p, rough_u = liquid.dissipation()
    assert np.abs(rough_p).max() < 1e-9 * np.abs(pressure).max() / cloud.spacing**2
    assert np.abs(rough_u).max() < 1e-9 * np.abs(velocity).max() / cloud.spacing**2


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("seed", range(3))
def test_dissipation_takes_energy_out_of_noise(liquid_of, chamber, basis, seed):
    liquid, cloud, rng = liquid_of(basis), chamber(0.2), np.random.default_rng(seed)
    liquid.fill(cloud)
    pressure, velocity = rng.normal(size=cloud.count), rng.normal(size=(cloud.count, 2))
    velocity[cloud.points[:, 0] == 0.0, 0] = 0.0
    liquid.set_fields(pressure, velocity)
    rough_p, rough_u = liquid.dissipation()
    volume = liquid.get(liquid.aqueous.volume)
    assert (volume * pressure * rough_p).sum() < 0.0
    assert (volume[:, None] * velocity * rough_u).sum() < 0.0


def test_dissipation_of_smooth_fields_falls_as_the_cube_of_the_spacing(liquid, chamber):
    spacings, terms = (0.4, 0.28, 0.2, 0.14), []
    for spacing_mm in spacings:
        cloud = chamber(spacing_mm)
        liquid.fill(cloud)
        r, z = cloud.points.T
        wave = np.cos(900.0 * z + 0.3) * np.cos(600.0 * r)
        liquid.set_fields(wave, np.column_stack([np.sin(600.0 * r) * np.cos(900.0 * z), wave]))
        rough_p, rough_u = liquid.dissipation()
        volume = liquid.get(liquid.aqueous.volume)
        mean = lambda f: np.sqrt((volume * f**2).sum() / volume.sum())
        terms.append([spacing_mm * mean(rough_p), spacing_mm * mean(rough_u[:, 0]), spacing_mm * mean(rough_u[:, 1])])
    order = np.polyfit(np.log(spacings), np.log(terms), 1)[0]
    assert np.all(order > 2.5), order


def dent(cloud, depth_mm):
    """A dimple as deep as a puff makes it, with the bulge around it, and some motion inwards along the wall."""
    wall = cloud.points[: cloud.wall_count]
    x = wall[:, 0] / (cloud.section.limbus_radius)
    down = np.exp(-((wall[:, 0] / (1.9 * MM)) ** 2)) - 0.12 * (x * (1.0 - x)) ** 2 * 16.0
    shift = depth_mm * MM * np.column_stack([-0.05 * np.sin(np.pi * x), -down * (1.0 - x**4)])
    return wall + shift


@pytest.mark.parametrize("depth_mm", [None, 3.6])
@pytest.mark.parametrize("spacing_mm", [0.3, 0.17])
def test_nodes_follow_the_cornea_into_a_deep_dent_and_back(liquid, chamber, spacing_mm, depth_mm):
    cloud = chamber(spacing_mm, 7.8, depth_mm)
    liquid.fill(cloud)
    rest = liquid.places
    np.testing.assert_array_equal(rest, cloud.points)
    back = cloud.height_fraction == 0.0
    a, b, c = (cloud.triangles[:, k] for k in range(3))

    def areas(p):
        return (p[b] - p[a])[:, 0] * (p[c] - p[a])[:, 1] - (p[b] - p[a])[:, 1] * (p[c] - p[a])[:, 0]

    for depth in (0.4, 0.8, 1.2, 0.6, 0.0):
        wall = dent(cloud, depth)
        liquid.carry(wall)
        now = liquid.places
        np.testing.assert_allclose(now[: cloud.wall_count], wall, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(now[back], rest[back])
        assert not now[rest[:, 0] == 0.0, 0].any()
        assert (areas(now) / areas(rest)).min() > 0.3
        assert measure(cloud, now).smallest_gap > 0.3
        assert liquid.get(liquid.aqueous.operators.condition).max() < 2e5
    liquid.carry(cloud.points[: cloud.wall_count])
    assert liquid.places.tobytes() == rest.tobytes()


def test_weights_come_back_bit_for_bit_with_the_nodes(liquid, chamber):
    cloud = chamber(0.3)
    liquid.fill(cloud)
    operators = liquid.aqueous.operators
    weights = operators.gradient_weight, operators.laplacian_weight, operators.pair_weight
    before = [field.to_numpy() for field in weights]
    liquid.carry(dent(cloud, 1.0))
    assert np.abs(weights[0].to_numpy() - before[0]).max() > 0.0
    liquid.carry(cloud.points[: cloud.wall_count])
    for field, old in zip(weights, before):
        np.testing.assert_array_equal(field.to_numpy()[: cloud.count], old[: cloud.count])
