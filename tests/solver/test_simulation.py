"""Whole runs of a coarse eye: the answer, rest, conservation, node motion, repetition."""

import numpy as np
import pytest
from eye_bench import run_eye

from taichi_eye.report.history import summarise
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation
from taichi_eye.units import KPA, MM, MMHG

PEAK_MM = 0.959  # sealed chamber, incompressible flow: two independent methods


def test_apex_history_agrees_with_independent_solutions(whole_run):
    assert whole_run.stop is None
    history = summarise(whole_run["time_ms"], whole_run["apex_displacement_mm"])
    assert history.peak == pytest.approx(PEAK_MM, rel=0.03)
    # half-height at 9.40 and 20.66 ms
    assert history.half_rise_ms == pytest.approx(9.40, abs=0.15)
    assert history.half_fall_ms == pytest.approx(20.66, abs=0.15)
    assert abs(whole_run["apex_displacement_mm"][-1]) < 0.01
    assert whole_run["cornea_min_stress_kpa"].min() > 5.0


@pytest.mark.parametrize("iop_mmhg, peak_mm", [(10, 1.156), (20, 0.803), (30, 0.579)])
def test_a_stiffer_eye_is_dented_less(iop_mmhg, peak_mm):
    run = run_eye(f"eye.iop_mmhg={iop_mmhg}", "numerics.sound_speed_m_s=60", "numerics.duration_ms=18")
    assert run.stop is None
    assert run["apex_displacement_mm"].max() == pytest.approx(peak_mm, rel=0.03)


@pytest.mark.parametrize("peak_kpa, peak_mm", [(5, 0.581), (15, 1.172)])
def test_a_stronger_puff_dents_more(peak_kpa, peak_mm):
    run = run_eye(f"puff.peak_kpa={peak_kpa}", "numerics.sound_speed_m_s=60", "numerics.duration_ms=18")
    assert run.stop is None
    assert run["apex_displacement_mm"].max() == pytest.approx(peak_mm, rel=0.03)


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("eye.iop_mmhg=30", "numerics.dissipation=1"),
        ("numerics.basis=cubic",),
        ("numerics.wall_condition=no_slip",),
        ("numerics.coupling=loose",),
        ("chamber.depth_mm=3.4",),
        ("cornea.radius_mm=7", "aqueous.viscosity_mpa_s=20"),
    ],
)
def test_without_a_puff_nothing_moves(overrides):
    run = run_eye("puff.peak_kpa=0", "numerics.duration_ms=3", *overrides)
    assert run.stop is None and run.steps > 100
    for column in (
        "apex_displacement_mm",
        "apex_velocity_m_s",
        "chamber_volume_error",
        "puff_work_uj",
        "aqueous_kinetic_uj",
        "cornea_kinetic_uj",
        "energy_error_uj",
    ):
        np.testing.assert_allclose(run[column], 0.0, atol=1e-12, err_msg=column)
    np.testing.assert_allclose(run.places, run.cloud.points, rtol=0, atol=1e-15)
    assert np.abs(run.velocities).max() < 1e-12 and np.abs(run.pressures).max() < 1e-8
    iop_kpa = run.scene.eye.iop_mmhg * MMHG / KPA
    np.testing.assert_allclose(run["fluid_pressure_apex_kpa"], iop_kpa, rtol=1e-12)


def test_work_in_is_what_is_stored_and_lost(whole_run):
    work = whole_run["puff_work_uj"]
    stored = sum(
        whole_run[f"{name}_uj"] for name in ("cornea_elastic", "cornea_kinetic", "aqueous_elastic", "aqueous_kinetic")
    )
    lost = whole_run["viscous_loss_uj"] + whole_run["numerical_loss_uj"]
    np.testing.assert_allclose(whole_run["energy_error_uj"], stored + lost - work, atol=1e-9)
    assert np.abs(stored + lost - work).max() < 0.01 * work.max()
    for name in ("cornea_kinetic_uj", "aqueous_kinetic_uj"):
        assert whole_run[name].min() >= 0.0
    assert np.all(np.diff(whole_run["viscous_loss_uj"]) >= 0.0)
    # what was done to the eye has come back out but for the losses
    assert work[-1] == pytest.approx(lost[-1], abs=0.01 * work.max())


@pytest.mark.parametrize("sound_speed", [20, 40, 80])
def test_volume_error_is_what_the_compliance_explains(sound_speed):
    run = run_eye(f"numerics.sound_speed_m_s={sound_speed}", "numerics.duration_ms=16")
    excess = (run["fluid_pressure_apex_kpa"] * KPA - run.scene.eye.iop_mmhg * MMHG).max()
    explained = excess / (run.scene.aqueous.density_kg_m3 * sound_speed**2)
    assert np.abs(run["chamber_volume_error"]).max() < explained + 1e-3
    # at the deepest the whole chamber is under one pressure, and the volume answers it
    assert run["chamber_volume_error"][-1] == pytest.approx(
        -(run["fluid_pressure_apex_kpa"][-1] * KPA - run.scene.eye.iop_mmhg * MMHG)
        / (run.scene.aqueous.density_kg_m3 * sound_speed**2),
        rel=0.1,
    )


def test_more_compliance_dents_deeper_as_the_inverse_square_of_c():
    peaks = [
        run_eye(f"numerics.sound_speed_m_s={c}", "numerics.duration_ms=16")["apex_displacement_mm"].max()
        for c in (20, 40, 80)
    ]
    first, second = peaks[0] - peaks[1], peaks[1] - peaks[2]
    assert first > second > 0.0
    assert np.log2(first / second) == pytest.approx(2.0, abs=0.3)


def test_cloud_stays_healthy_through_the_dent_and_comes_back(whole_run):
    deep = whole_run.each("flattest_triangle")
    assert deep.min() > 0.4 and deep[-1] > 0.99
    assert whole_run.each("worst_condition").max() < 1000.0
    assert whole_run.each("smallest_gap").min() > 0.35 * whole_run.cloud.spacing
    assert np.linalg.norm(whole_run.places - whole_run.cloud.points, axis=1).max() < 0.01 * MM
    assert 10 < whole_run.rebuilds < len(whole_run["time_ms"])


def test_nodes_go_with_the_cornea_and_the_back_stays(whole_run):
    run = run_eye("numerics.duration_ms=10")
    cloud = run.cloud
    assert np.linalg.norm(run.wall - cloud.points[: cloud.wall_count], axis=1).max() > 0.4 * MM
    np.testing.assert_allclose(run.places[: cloud.wall_count], run.wall, rtol=0, atol=1e-15)
    back = cloud.height_fraction == 0.0
    np.testing.assert_array_equal(run.places[back], cloud.points[back])
    assert run.wall[0, 0] == 0.0 and tuple(run.wall[-1]) == tuple(cloud.points[cloud.wall_count - 1])
    assert not run.places[cloud.points[:, 0] == 0.0, 0].any()


@pytest.mark.parametrize("wall_condition", ["slip", "no_slip"])
def test_liquid_at_the_wall_moves_with_it(wall_condition):
    run = run_eye(f"numerics.wall_condition={wall_condition}", "numerics.duration_ms=9")
    assert run.stop is None
    walls = run.cloud.wall_count
    lag = run.velocities[:walls] - run.wall_velocity
    along = run.wall[2:] - run.wall[:-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    fastest = np.abs(run.wall_velocity).max()
    across = (lag[1:-1] * along[:, ::-1] * (-1.0, 1.0)).sum(1)
    np.testing.assert_allclose(across, 0.0, atol=1e-12 * fastest)
    slipping = np.abs((lag[1:-1] * along).sum(1)).max()
    assert slipping == 0.0 if wall_condition == "no_slip" else slipping > 0.01 * fastest


def test_a_run_leaves_nothing_behind_for_the_next(whole_run):
    run_eye("eye.iop_mmhg=25", "numerics.basis=quadratic", "puff.peak_kpa=15", "numerics.duration_ms=12")
    again = run_eye()
    for column, values in whole_run.traces.items():
        np.testing.assert_array_equal(again[column], values, err_msg=column)


def test_frames_and_samples_come_at_their_times():
    scene = load_scene(
        None,
        [
            "numerics.spacing_mm=0.3",
            "numerics.sound_speed_m_s=10",
            "numerics.duration_ms=1.2",
            "camera.frame_interval_ms=0.23",
            "camera.frame_count=4",
        ],
    )
    simulation, frames, samples = Simulation(scene), [], []
    traces = simulation.run(lambda s, frame: frames.append((frame, s.time_ms)), lambda s: samples.append(s.time_ms))
    assert [frame for frame, _ in frames] == [0, 1, 2, 3]
    np.testing.assert_allclose([at for _, at in frames], 0.23 * np.arange(4), atol=1e-12)
    np.testing.assert_allclose(np.diff(samples), samples[1], rtol=1e-9)
    assert samples[1] <= 0.025 and samples[-1] <= 1.2 < samples[-1] + samples[1]
    np.testing.assert_array_equal(traces["time_ms"], samples)


def test_load_in_the_traces_is_the_puff(whole_run):
    t = whole_run["time_ms"]
    np.testing.assert_allclose(whole_run["puff_apex_kpa"], 10.0 * np.exp(-25.0 * ((2 * t - 30) / 60) ** 2), rtol=1e-12)
    # the velocity is the slope of the displacement
    slope = np.gradient(whole_run["apex_displacement_mm"], t)
    np.testing.assert_allclose(whole_run["apex_velocity_m_s"][1:-1], slope[1:-1], atol=0.02 * np.abs(slope).max())
