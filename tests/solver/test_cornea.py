"""The membrane against closed forms, its own energy and its own clock."""

import numpy as np
import pytest

from taichi_eye.eye import tissue
from taichi_eye.eye.eye import eye_of
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.scene import load_scene
from taichi_eye.solver.cornea import Cornea
from taichi_eye.units import MM

CAPACITY = 260


@ti.data_oriented
class Membrane:
    """A cornea without fluid, of any number of elements up to CAPACITY - 1."""

    def __init__(self):
        self.cornea = Cornea(CAPACITY)
        self.out = ti.Vector.field(2, ti.f64, CAPACITY)
        self.number = ti.field(ti.f64, 3)

    def build(self, elements, *overrides):
        self.scene = load_scene(None, overrides)
        eye = eye_of(self.scene)
        self.section = eye.section
        self.nodes = self.section.cornea_nodes(elements)
        self.thickness, self.iop = eye.cornea.thickness, eye.iop
        self.cornea.setup(
            self.nodes,
            thickness=self.thickness,
            density=eye.cornea.density,
            coefficients=eye.cornea.coefficients,
            prestrain=eye.apex_prestrain,
            iop=self.iop,
            load_shape=np.ones(elements + 1),
        )
        return self

    def place(self, points):
        whole = np.zeros((CAPACITY, 2))
        whole[: len(points)] = points
        self.cornea.place.from_numpy(whole)

    def read(self):
        return self.out.to_numpy()[: len(self.nodes)]

    @ti.kernel
    def _elastic_forces(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, 0.0)
        for i in range(self.cornea.last[0] + 1):
            self.out[i] = self.cornea.elastic_force(0, i)

    def elastic_forces(self):
        self._elastic_forces()
        return self.read()

    @ti.kernel
    def _area_vectors(self):
        for i in range(self.cornea.last[0] + 1):
            self.out[i] = self.cornea.volume_gradient(0, i)

    def area_vectors(self):
        self._area_vectors()
        return self.read()

    @ti.kernel
    def _measure(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.number[0] = self.cornea.elastic_energy(0)
            self.number[1] = self.cornea.enclosed_volume(0, self.cornea.place)
            self.number[2] = self.cornea.kinetic_energy(0)

    def energy_volume_kinetic(self):
        self._measure()
        return self.number.to_numpy()

    @ti.kernel
    def march(self, steps: int, dt: float):
        """Newmark steps under the constant IOP, no fluid."""
        ti.loop_config(serialize=True)
        for _ in range(steps):
            last = self.cornea.last[0]
            for i in range(last + 1):
                self.cornea.predict(0, i, dt)
            self.cornea.deform(0, dt)
            for i in range(last + 1):
                self.cornea.collect_forces(0, i)
                force = self.cornea.force_solid[i] + self.cornea.force_air[i]
                new = self.cornea.held(0, i, force / self.cornea.mass[i])
                self.cornea.velocity[i] += 0.5 * dt * (self.cornea.acceleration[i] + new)
                self.cornea.acceleration[i] = new


@pytest.fixture(scope="module")
def membrane():
    return Membrane()


def inflated(membrane, stretch):
    """The cap stretched evenly about the centre of its sphere."""
    centre = np.array([0.0, membrane.section.centre_z])
    return centre + stretch * (membrane.nodes - centre)


def crumpled(membrane, seed, share=0.02):
    """A random smooth and a random rough displacement; supports kept."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, len(membrane.nodes))
    bend = 0.5 * MM * rng.uniform(-1.0, 1.0) * np.column_stack([s * np.cos(0.5 * np.pi * s), np.cos(0.5 * np.pi * s)])
    edge = np.linalg.norm(np.diff(membrane.nodes, axis=0), axis=1).mean()
    rough = share * edge * rng.normal(size=membrane.nodes.shape)
    rough[0, 0] = rough[-1] = 0.0
    bend[-1] = 0.0
    return membrane.nodes + bend + rough


@pytest.mark.parametrize("stretch", [0.98, 0.99, 1.0, 1.01, 1.02, 1.03, 1.05])
@pytest.mark.parametrize("overrides", [(), ("cornea.radius_mm=7.2", "eye.iop_mmhg=25", "cornea.poisson_ratio=0.3")])
def test_even_inflation_balances_the_closed_form_pressure_at_second_order(membrane, stretch, overrides):
    errors, counts = [], (32, 64, 128, 256)
    for elements in counts:
        membrane.build(elements, *overrides)
        membrane.place(inflated(membrane, stretch))
        c = membrane.scene.cornea
        pressure = tissue.inflation_pressure(
            stretch, c.radius_mm * MM, membrane.thickness, c.stiffness_a_pa, c.exponent_k, c.prestrain
        )
        load = pressure * membrane.area_vectors()[:-1]
        missing = membrane.elastic_forces()[:-1] + load
        missing[0, 0] = 0.0  # taken by the symmetry of the axis
        normal = membrane.nodes[:-1] - (0.0, membrane.section.centre_z)
        across = (missing * normal).sum(1) / membrane.section.radius
        along = np.linalg.norm(missing - across[:, None] * normal / membrane.section.radius, axis=1)
        ring = np.linalg.norm(load, axis=1)
        errors.append([(np.abs(across) / ring).max(), along.max() / ring.max()])
    assert np.all(-np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.9)
    assert np.max(errors[-1]) < 1e-5


@pytest.mark.parametrize("elements", [8, 50, 200])
@pytest.mark.parametrize("seed", range(4))
def test_elastic_force_is_minus_the_derivative_of_the_energy(membrane, elements, seed):
    membrane.build(elements)
    place, rng = crumpled(membrane, seed), np.random.default_rng(seed)
    membrane.place(place)
    # the energy counts the dead load that keeps the reference at rest, the tissue's force does not
    force = membrane.elastic_forces() - membrane.cornea.residual.to_numpy()[: elements + 1]
    way = rng.normal(size=force.shape)
    way[0, 0] = way[-1] = 0.0
    step = 1e-4 * MM / elements
    energies = []
    for share in (1, -1, 2, -2):
        membrane.place(place + share * step * way)
        energies.append(membrane.energy_volume_kinetic()[0])
    slope = (8 * (energies[0] - energies[1]) - (energies[2] - energies[3])) / (12 * step)
    assert -slope == pytest.approx((force * way).sum(), rel=1e-6, abs=1e-6 * np.abs(force * way).sum())


@pytest.mark.parametrize("elements", [8, 50, 200])
@pytest.mark.parametrize("seed", range(4))
def test_area_vectors_are_the_derivative_of_the_volume(membrane, elements, seed):
    membrane.build(elements)
    place, rng = crumpled(membrane, seed), np.random.default_rng(seed)
    membrane.place(place)
    area = membrane.area_vectors()
    way = rng.normal(size=area.shape)
    step = 1e-2 * MM
    volumes = []
    for share in (1, -1, 2, -2):
        membrane.place(place + share * step * way)
        volumes.append(membrane.energy_volume_kinetic()[1])
    # the volume is a cubic in the places, so this quotient is exact
    slope = (8 * (volumes[0] - volumes[1]) - (volumes[2] - volumes[3])) / (12 * step)
    assert slope == pytest.approx((area * way).sum(), rel=1e-9, abs=1e-9 * np.abs(area * way).sum())


@pytest.mark.parametrize("elements", [5, 33, 250])
def test_resultant_of_an_even_pressure_is_pressure_times_the_disc_it_spans(membrane, elements):
    membrane.build(elements)
    for place in (membrane.nodes, crumpled(membrane, elements)):
        membrane.place(place)
        # the free nodes carry the membrane up to the middle of its last element, the limbus the rest
        edge = 0.5 * (place[-1, 0] + place[-2, 0])
        assert membrane.area_vectors()[:-1, 1].sum() == pytest.approx(np.pi * edge**2, rel=1e-12)


@pytest.mark.parametrize("spread", [3.0, 21.5, 100.0])
def test_resultant_of_the_puff_tends_to_its_closed_form(membrane, spread):
    errors, counts = [], (32, 64, 128, 256)
    for elements in counts:
        membrane.build(elements)
        rate = spread / membrane.section.radius**2
        load = np.exp(-rate * membrane.nodes[:-1, 0] ** 2) * membrane.area_vectors()[:-1, 1]
        closed = np.pi / rate * (1.0 - np.exp(-rate * membrane.nodes[-2:, 0].mean() ** 2))
        errors.append(abs(load.sum() / closed - 1.0))
    assert errors[-1] < 1e-3
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.8


@pytest.mark.parametrize("elements", [16, 100])
def test_mass_and_volume_are_those_of_the_cap(membrane, elements):
    membrane.build(elements)
    cap = membrane.section.apex_z
    area = 2.0 * np.pi * membrane.section.radius * cap
    mass = membrane.cornea.mass.to_numpy()[: elements + 1].sum()
    density = membrane.scene.cornea.density_kg_m3
    assert mass == pytest.approx(area * membrane.thickness * density, rel=2.0 / elements**2)
    assert membrane.energy_volume_kinetic()[1] == pytest.approx(membrane.section.volume(), rel=2.0 / elements**2)


@pytest.mark.parametrize("overrides", [(), ("eye.iop_mmhg=30",), ("cornea.radius_mm=6.5", "cornea.thickness_mm=0.7")])
@pytest.mark.parametrize("elements", [10, 100])
def test_reference_is_exactly_at_rest(membrane, elements, overrides):
    membrane.build(elements, *overrides)
    membrane.march(2000, 1e-7)
    np.testing.assert_array_equal(membrane.cornea.place.to_numpy()[: elements + 1], membrane.nodes)
    assert not membrane.cornea.velocity.to_numpy().any()
    assert not membrane.cornea.acceleration.to_numpy().any()


def test_stress_of_an_even_stretch_is_the_tissue_law(membrane):
    membrane.build(40, "cornea.poisson_ratio=0.2")
    eye = eye_of(membrane.scene)
    for stretch in (0.99, 1.0, 1.04):
        membrane.place(inflated(membrane, stretch))
        membrane.elastic_forces()
        e = tissue.strain(stretch) + eye.apex_prestrain
        exact = eye.cornea.law.of_arrays.stress(e, e, 0.0, eye.cornea.coefficients)
        np.testing.assert_allclose(membrane.cornea.stress.to_numpy()[:40], np.tile(exact, (40, 1)), rtol=1e-9)


def swing(membrane, dt, duration, push):
    """Let the cap swing from a push; returns places at the end and the total energy after every step."""
    membrane.build(24)
    velocity = np.zeros((CAPACITY, 2))
    s = np.linspace(0.0, 1.0, 25)
    velocity[:25, 1] = -push * np.cos(0.5 * np.pi * s) ** 2
    membrane.cornea.velocity.from_numpy(velocity)
    start = membrane.energy_volume_kinetic()
    totals = []
    for _ in range(round(duration / dt)):
        membrane.march(1, float(dt))
        energy, volume, kinetic = membrane.energy_volume_kinetic() - (start * (1, 1, 0))
        totals.append(energy + kinetic - membrane.iop * volume)
    return membrane.cornea.place.to_numpy()[:25], np.array(totals) / start[2]


def test_free_swing_keeps_its_energy_and_is_second_order_in_time(membrane):
    steps, duration = np.array([4e-6, 2e-6, 1e-6]), 4e-4
    places, totals = zip(*(swing(membrane, dt, duration, 0.5) for dt in steps))
    swung = [np.abs(total - 1.0).max() for total in totals]
    assert swung[-1] < 2e-3
    assert np.polyfit(np.log(steps), np.log(swung), 1)[0] > 1.8
    coarse, fine = (np.abs(a - b).max() for a, b in zip(places, places[1:]))
    assert np.log2(coarse / fine) > 1.8


@pytest.mark.parametrize("dt", [1e-6, 3e-6])
def test_newmark_retraces_its_steps(membrane, dt):
    there, _ = swing(membrane, dt, 3e-4, 0.3)
    assert np.abs(there - membrane.nodes).max() > 0.02 * MM
    membrane.cornea.velocity.from_numpy(-membrane.cornea.velocity.to_numpy())
    membrane.march(round(3e-4 / dt), dt)
    np.testing.assert_allclose(membrane.cornea.place.to_numpy()[:25], membrane.nodes, atol=1e-10 * MM)
