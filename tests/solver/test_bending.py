"""Bending of the cornea: forces against the energy they derive from, and a known energy."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.eye.tissue import flexural_rigidity
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver.cornea import Cornea

RADIUS, RIM, THICKNESS, MODULUS = 7.8e-3, 5.8e-3, 0.55e-3, 0.3e6
ELEMENTS = 24


@ti.data_oriented
class Probe:
    def __init__(self, cornea):
        self.cornea = cornea
        self.force = ti.Vector.field(2, ti.f64, ELEMENTS + 1)

    @ti.kernel
    def measure(self) -> ti.f64:
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, 0.0)
        ti.loop_config(serialize=True)
        for i in range(ELEMENTS + 1):
            self.force[i] = self.cornea.elastic_force(0, i) - self.cornea.residual[i]
        return self.cornea.elastic_energy(0)

    @ti.kernel
    def bending(self) -> ti.f64:
        return self.cornea.bending_energy(0)


@pytest.fixture(scope="module")
def shell():
    backend.init("cpu", "f64")
    angle = np.linspace(0.0, np.arcsin(RIM / RADIUS), ELEMENTS + 1)
    nodes = RADIUS * np.column_stack([np.sin(angle), np.cos(angle)])
    cornea = Cornea(ELEMENTS + 1)
    flat = np.ones(ELEMENTS)
    # without in-plane tension but for the prestrain's: bending stands out
    cornea.setup(
        nodes,
        thickness=THICKNESS * flat,
        density=1050.0,
        coefficients=(1562.0, 57.8, 0.49),
        prestrain=0.03 * flat,
        iop=2000.0,
        load_shape=np.ones(ELEMENTS + 1),
        rigidity=flexural_rigidity(MODULUS, THICKNESS, 0.49),
    )
    return Probe(cornea), nodes


def test_forces_are_minus_the_slope_of_the_energy(shell):
    probe, nodes = shell
    place = nodes - 0.5e-3 * np.exp(-((nodes[:, :1] / 1.6e-3) ** 2)) * [0.05, 1.0]
    place[0, 0] = 0.0
    probe.cornea.place.from_numpy(place)
    probe.measure()
    force = probe.force.to_numpy()
    for node, axis in ((0, 1), (1, 0), (1, 1), (5, 0), (5, 1), (12, 1), (ELEMENTS - 1, 0), (ELEMENTS - 1, 1)):
        energies = []
        for sign in (-1, 1):
            moved = place.copy()
            moved[node, axis] += sign * 1e-9
            probe.cornea.place.from_numpy(moved)
            energies.append(probe.measure())
        assert force[node, axis] == pytest.approx(-(energies[1] - energies[0]) / 2e-9, rel=1e-4, abs=1e-8)


def test_flattening_a_cap_stores_the_energy_of_its_curvature(shell):
    probe, nodes = shell
    angle = np.arcsin(RIM / RADIUS)
    # unrolled: both curvatures 1/R are lost at the nodes; sin(phi)/R_k goes likewise on the elements
    flat = np.column_stack([RADIUS * np.linspace(0.0, angle, ELEMENTS + 1), np.zeros(ELEMENTS + 1)])
    probe.cornea.place.from_numpy(flat)
    rigidity = MODULUS * THICKNESS**3 / (12.0 * (1.0 - 0.49**2))
    area = 2.0 * np.pi * RADIUS**2 * (1.0 - np.cos(angle))
    assert probe.bending() == pytest.approx(0.5 * rigidity * 2.0 / RADIUS**2 * area, rel=0.03)


def test_a_resting_shell_is_a_resting_membrane(shell):
    probe, nodes = shell
    probe.cornea.place.from_numpy(nodes)
    assert probe.bending() < 1e-25
