"""Transverse shear of the cornea: forces, energy, loss, step and the eyes that have it."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.errors import RunStopped
from taichi_eye.eye.tissue import flexural_rigidity
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import case_of
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.guards import least_stress
from taichi_eye.solver.timestep import limits

RADIUS, RIM, THICKNESS = 7.8e-3, 5.8e-3, 0.55e-3
STIFFNESS = 9.0e3 * THICKNESS  # kappa G h


@ti.data_oriented
class Probe:
    """A cap whose nodes are put where the test wants them."""

    def __init__(self, elements=24, delay=0.0, coefficients=(1562.0, 57.8, 0.49), flexural_modulus=0.0):
        backend.real()
        angle = np.linspace(0.0, np.arcsin(RIM / RADIUS), elements + 1)
        self.count = elements + 1
        self.nodes = RADIUS * np.column_stack([np.sin(angle), np.cos(angle)])
        self.cornea = Cornea(self.count)
        self.force = ti.Vector.field(2, ti.f64, self.count)
        self.cornea.setup(
            self.nodes,
            thickness=THICKNESS,
            density=1050.0,
            coefficients=coefficients,
            prestrain=0.03,
            iop=2000.0,
            load_shape=np.ones(self.count),
            rigidity=flexural_rigidity(flexural_modulus, THICKNESS, 0.49),
            shear_stiffness=STIFFNESS,
            shear_delay=delay,
        )

    @ti.kernel
    def _measure(self, dt: float) -> ti.f64:
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, dt)
        ti.loop_config(serialize=True)
        for i in range(self.count):
            self.force[i] = self.cornea.elastic_force(0, i) - self.cornea.residual[i]
        return self.cornea.elastic_energy(0)

    @ti.kernel
    def shell_energy(self) -> ti.f64:
        return self.cornea.bending_energy(0)

    def measure(self, place, dt=0.0):
        """Energy [J] with the nodes at `place`, dt [s] after the last ones; the forces stay in `force`."""
        self.cornea.place.from_numpy(np.ascontiguousarray(place))
        return self._measure(dt)


@pytest.fixture(scope="module", autouse=True)
def cpu():
    backend.init("cpu", "f64")


@pytest.mark.parametrize("flexural_modulus", [0.0, 0.3e6])
def test_forces_are_minus_the_slope_of_the_energy(flexural_modulus):
    probe = Probe(flexural_modulus=flexural_modulus)
    nodes = probe.nodes
    place = nodes - 0.9e-3 * np.exp(-((nodes[:, :1] / 1.6e-3) ** 2)) * [0.05, 1.0]
    place[0, 0] = 0.0
    probe.measure(place)
    force = probe.force.to_numpy()
    for node, axis in ((0, 1), (1, 0), (1, 1), (5, 0), (5, 1), (12, 1), (23, 0), (23, 1)):
        energies = []
        for sign in (-1, 1):
            moved = place.copy()
            moved[node, axis] += sign * 1e-9
            energies.append(probe.measure(moved))
        assert force[node, axis] == pytest.approx(-(energies[1] - energies[0]) / 2e-9, rel=1e-4, abs=1e-8)


def test_the_energy_of_a_flattened_cap_is_that_of_the_tilt_of_its_sections():
    errors, angle = [], np.arcsin(RIM / RADIUS)
    # tan^2 of the polar angle over the cap
    exact = 0.5 * STIFFNESS * 2.0 * np.pi * RADIUS**2 * (1.0 / np.cos(angle) + np.cos(angle) - 2.0)
    for elements in (32, 64):
        probe = Probe(elements)
        probe.cornea.place.from_numpy(np.column_stack([probe.nodes[:, 0], np.zeros(elements + 1)]))
        errors.append(abs(probe.shell_energy() / exact - 1.0))
    assert errors[0] < 2e-3 and errors[0] / errors[1] > 3.5


def test_a_wall_turned_inside_out_stores_what_twice_the_tilt_asks_for():
    probe = Probe()
    flat = probe.nodes * [1.0, -1.0]
    probe.cornea.place.from_numpy(flat)
    rest = probe.cornea.rest_angle.to_numpy()[:24, 0]
    area = 2.0 * np.pi * probe.cornea.element_radius.to_numpy()[:24] * probe.cornea.element_length.to_numpy()[:24]
    assert probe.shell_energy() == pytest.approx(0.5 * STIFFNESS * (area * np.tan(2.0 * rest) ** 2).sum(), rel=1e-12)


@pytest.mark.parametrize("delay", [0.1e-3, 0.4e-3])
def test_loss_per_cycle_is_that_of_the_dashpot(delay):
    probe = Probe(delay=delay)
    period, steps, small = 5e-3, 400, 1e-6
    shift = np.column_stack([np.zeros(probe.count), small * (1.0 - (probe.nodes[:, 0] / RIM) ** 2)])
    probe.cornea.place.from_numpy(probe.nodes + shift)
    stored = probe.shell_energy()
    probe.cornea.place.from_numpy(probe.nodes)
    for n in range(1, 2 * steps + 1):
        probe.measure(probe.nodes + np.sin(2.0 * np.pi * n / steps) * shift, period / steps)
        if n == steps:
            before = probe.cornea.relaxed_work[0]
    loss = probe.cornea.relaxed_work[0] - before
    # amplitude a of stiffness K: pi (2 pi / period) delay K a^2
    assert loss == pytest.approx(4.0 * np.pi**2 * delay / period * stored, rel=1e-3)


EYE = (
    "numerics.spacing_mm=0.35",
    "numerics.sound_speed_m_s=20",
    "cornea.exponent_k=2000",
    "cornea.shear_modulus_kpa=14",
    "cornea.flexural_modulus_mpa=0.02",
    "cornea.shear_viscosity_ms=0.15",
    "cornea.pressure_exponent=1",
    "eye.iop_mmhg=17",
    "chamber.compliance_mm3_mmhg=0.3",
    "chamber.globe_law=friedenwald",
    "puff.radial_profile=gaussian",
    "puff.width_mm=1.7",
    "puff.dent_feedback=0.5",
)


@pytest.mark.parametrize("rung", ["cavity", "added_mass", "mfpm"])
def test_with_everything_that_a_living_eye_has_the_energy_closes(rung):
    traces = simulation_of(load_scene(None, (*EYE, f"numerics.fidelity={rung}"))).run()
    work = traces["puff_work_uj"].max()
    assert traces["apex_displacement_mm"].max() > 0.4
    assert np.abs(traces["energy_error_uj"]).max() < 5e-3 * work
    assert traces["tissue_loss_uj"][-1] > 0.01 * work
    # back at rest, all that was put in is lost
    assert abs(traces["apex_displacement_mm"][-1]) < 0.02


def test_switches_that_are_off_change_no_bit():
    off = (
        "cornea.shear_modulus_kpa=0",
        "cornea.shear_viscosity_ms=3",
        "cornea.pressure_exponent=0",
        "chamber.globe_law=friedenwald",
        "chamber.compliance_mm3_mmhg=0",
        "puff.dent_feedback=0",
    )
    base = (
        "numerics.spacing_mm=0.35",
        "numerics.sound_speed_m_s=20",
        "numerics.fidelity=cavity",
        "numerics.duration_ms=12",
    )
    plain, switched = (simulation_of(load_scene(None, (*base, *more))).run() for more in ((), off))
    for name, column in plain.items():
        np.testing.assert_array_equal(column, switched[name], err_msg=name)


def test_a_viscous_wall_of_shear_bounds_the_step_by_its_own_rate():
    figures = {
        "smallest_gap": 0.8e-4,
        "membrane_step": 2e-6,
        "membrane_speed": 25.0,
        "transverse_speed": 5.0,
        "steepest_slant": 1.0,
        "pair_weight": 1e7,
    }
    step = lambda *keys: limits(figures, case_of(load_scene(None, keys)))["membrane shear"]
    assert step() == step("cornea.shear_modulus_kpa=10") == np.inf
    viscous = step("cornea.shear_modulus_kpa=10", "cornea.shear_viscosity_ms=100")
    # the dashpot alone: w^2 delay t / 2 = 1 with w^2 = 4.842 (kappa G / rho) / L^2
    length = 2e-6 * 25.0
    assert viscous == pytest.approx(2.0 * length**2 / (4.842 * 5.0 / 6.0 * 1e4 / 1050.0 * 0.1), rel=1e-3)
    # turned by 60 degrees, gamma goes four times as fast and pushes with four times the force
    figures["steepest_slant"] = 4.0
    assert step("cornea.shear_modulus_kpa=10", "cornea.shear_viscosity_ms=100") == pytest.approx(
        viscous / 16.0, rel=1e-3
    )
    hardly = step("cornea.shear_modulus_kpa=10", "cornea.shear_viscosity_ms=1e-9")
    assert hardly == pytest.approx(length / 5.0, rel=1e-4)


STIFF = ("numerics.fidelity=cavity", "numerics.spacing_mm=0.3", "numerics.cfl=1", "numerics.duration_ms=6")


@pytest.mark.parametrize(
    "keys",
    [
        ("cornea.flexural_modulus_mpa=100",),
        ("cornea.flexural_modulus_mpa=10", "cornea.stiffness_a_pa=1e5"),
        ("cornea.shear_modulus_kpa=1e5",),
        ("cornea.shear_modulus_kpa=3000", "cornea.shear_viscosity_ms=0.1"),
    ],
)
def test_walls_that_are_stiff_out_of_plane_are_stable_up_to_the_limit(keys):
    traces = simulation_of(load_scene(None, (*STIFF, *keys))).run()
    work = traces["puff_work_uj"].max()
    assert work > 0.0 and np.abs(traces["energy_error_uj"]).max() < 1e-3 * work


def test_a_wall_of_shear_alone_is_a_shell_judged_by_its_shear():
    eye = case_of(load_scene(None, ["cornea.shear_modulus_kpa=12"])).eye
    assert eye.cornea.is_shell and least_stress(eye) == pytest.approx(-10e3, rel=1e-12)
    both = case_of(load_scene(None, ["cornea.shear_modulus_kpa=12", "cornea.flexural_modulus_mpa=0.2"])).eye
    bent = case_of(load_scene(None, ["cornea.flexural_modulus_mpa=0.2"])).eye
    assert least_stress(both) == pytest.approx(least_stress(bent) - 10e3, rel=1e-12)


def test_a_wall_that_turns_over_is_stopped_by_name():
    keys = (
        "numerics.fidelity=cavity",
        "numerics.spacing_mm=0.3",
        "chamber.sealed=false",
        "chamber.depth_mm=12",
        "cornea.shear_modulus_kpa=0.01",
        "cornea.flexural_modulus_mpa=0.001",
        "puff.peak_kpa=60",
    )
    scene = load_scene(None, keys)
    simulation = simulation_of(scene)
    simulation.judges_folding = False
    with pytest.raises(RunStopped, match="turned by more than 75 degrees"):
        simulation.run()
    assert simulation.out_of_validity
