"""Cheap problems of the verification, the exact answers they rest on, and the spectra's own arithmetic."""

import json

import numpy as np
import pytest

from taichi_eye.cli import main
from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
from taichi_eye.proof import comparison, membranes, spectrum, squeeze, viscous, waves
from taichi_eye.proof.domains import Vessel, slip_walls, vessel_cloud
from taichi_eye.proof.flow import Flow


def test_a_row_fails_on_nan_on_error_and_on_order():
    good = comparison.Comparison("p", "q", 1.0, 1.01, 0.01, 0.02, 2.0, 1.8)
    assert good.passed
    assert not comparison.Comparison("p", "q", 1.0, 1.1, 0.1, 0.02).passed
    assert not comparison.Comparison("p", "q", 1.0, np.nan, np.nan, 0.02).passed
    assert not comparison.Comparison("p", "q", 1.0, 1.0, 0.0, 0.02, float("nan"), 1.8).passed
    assert json.loads(json.dumps(comparison.Comparison("p", "q", 1.0, np.nan, np.nan, 0.02).as_dict()))["value"] is None


def test_order_of_a_power_law():
    sizes = np.array([0.4, 0.2, 0.1])
    assert comparison.order(sizes, 3.0 * sizes**1.7) == pytest.approx(1.7)


@pytest.mark.parametrize(
    "speed, known",
    [
        (10.0, (257.6008, 503.5342, 697.340)),
        (30.0, (265.5412, 524.7111, 796.995)),
        (100.0, (266.4176, 526.4479, 799.7255)),
        (1e5, (266.5039, 526.6147, 799.975)),
    ],
)
def test_cylinder_frequencies_of_the_characteristic_equation(speed, known):
    assert waves.cylinder_frequencies(speed) == pytest.approx(known, rel=2e-6)


@pytest.mark.parametrize(
    "alpha, r, at_0, at_quarter",
    [(1.0, 0.0, 0.241994, 0.045486), (5.0, 0.5, 0.009400, 0.042393), (10.0, 0.9, 0.003384, 0.006049)],
)
def test_womersley_profile(alpha, r, at_0, at_quarter):
    quarter = 0.5 * np.pi / alpha**2
    assert viscous.womersley_profile(r, 0.0, alpha) == pytest.approx(at_0, abs=1e-6)
    assert viscous.womersley_profile(r, quarter, alpha) == pytest.approx(at_quarter, abs=1e-6)


def test_inflation_converges_at_second_order():
    found, _ = membranes.inflation(quick=True)
    assert all(row.passed for row in found)
    assert max(row.error for row in found) < 5e-6


def test_squeeze_flow_is_exact_to_rounding():
    found, _ = squeeze.squeeze(quick=True)
    assert all(row.passed for row in found)


def test_dry_membrane_rings_at_the_zeros_of_j0():
    nodes = Vessel(6e-3, 3e-3).cornea_nodes(60)
    found = membranes.dry_frequencies(nodes, waves.THICKNESS, waves.WALL_DENSITY, waves.tissue(waves.TENSION))
    assert found == pytest.approx([234.436, 538.128, 843.613], rel=2e-3)


def test_step_matrix_advances_a_state_as_the_kernels_do():
    cloud = slip_walls(vessel_cloud(Vessel(6e-3, 3e-3), 1e-3))
    flow = Flow(cloud.count)
    flow.setup(cloud, density=1000.0, viscosity=0.0, sound_speed=30.0, dissipation=0.5)
    dt = 0.2 * 1e-3 / 30.0
    matrix = spectrum.step_matrix(flow, dt)
    state = 1e-6 * np.random.default_rng(0).standard_normal(flow.size)
    after = flow.step(state, dt)
    assert np.abs(matrix @ state - after).max() < 1e-6 * np.abs(after).max()


def test_the_eye_at_rest_is_stable_with_the_default_dissipation_and_not_without():
    section = Section(7.8e-3, 5.8e-3, 7.8e-3 - np.sqrt(7.8e-3**2 - 5.8e-3**2))
    cloud = pack(section, 0.5e-3)
    system = spectrum.CoupledSystem(cloud.count, cloud.wall_count)
    rates = {}
    for alpha in (0.0, 0.5):
        system.setup(
            cloud,
            thickness=0.55e-3,
            wall_density=1050.0,
            material=(1562.0, 86.1 / 1.49, 0.49, 0.04),
            iop=2000.0,
            density=1000.0,
            viscosity=0.0,
            sound_speed=80.0,
            dissipation=alpha,
        )
        dt = 0.05 * cloud.spacing / 80.0
        rates[alpha] = spectrum.growth(spectrum.step_matrix(system, dt), dt) * cloud.spacing / 80.0
    assert rates[0.5] < 1e-4
    assert rates[0.0] > 0.01


@pytest.mark.parametrize("command", ["verify", "stability", "claims", "bench"])
def test_figures_that_cannot_be_written_are_refused_before_the_work(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for json_file in (tmp_path / "missing" / "x.json", tmp_path):
        assert main([command, "--json", str(json_file)]) == 2
        assert f"--json {json_file}" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
