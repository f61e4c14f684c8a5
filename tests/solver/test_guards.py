"""Guards: each failure named with its place, its time and what to change; sound figures pass."""

import numpy as np
import pytest
from eye_bench import run_eye

from taichi_eye import backend
from taichi_eye.errors import RunStopped
from taichi_eye.eye.eye import eye_of
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import case_of
from taichi_eye.solver.figures import NOT_CONVERGED, QUANTITIES, RUNNING, at_rest
from taichi_eye.solver.guards import ENERGY_FLOOR, Guard, check, energy_floor, least_stress, liquid_advice

SOUND = {
    "least_stress": 14e3,
    "slackest_element": 3.0,
    "steepest_slant": 1.0,
    "slanted_element": 0.0,
    "chamber_gap": 0.6,
    "gap_node": 0.0,
    "flattest_triangle": 0.6,
    "flat_node": 12.0,
    "worst_condition": 210.0,
    "ill_node": 40.0,
    "not_finite": 0.0,
    "bad_node": -1.0,
    "coupling_status": float(RUNNING),
    "viscous_loss": 0.0,
    "numerical_loss": 0.0,
}
NAN = float("nan")


def judge(energy_gain=1e-8, largest_work=3e-5, overrides=(), lobes=None, **figures):
    case = case_of(load_scene(None, overrides))
    check(
        {**SOUND, **figures},
        gained=energy_gain,
        largest_work=largest_work,
        case=case,
        advice=liquid_advice(case),
        radius_mm=lambda node: 0.25 * node,
        time_ms=12.345,
        lobes=lobes,
    )


def refusal(**keys):
    with pytest.raises(RunStopped) as caught:
        judge(**keys)
    return caught.value


def test_sound_figures_pass():
    judge()
    judge(energy_gain=-1e-5)
    judge(energy_gain=0.0, largest_work=0.0)


@pytest.mark.parametrize(
    "keys, what, where, advice",
    [
        ({"least_stress": -2.5}, "slack", "r = 0.75 mm", "puff.peak_kpa"),
        ({"least_stress": 0.0}, "slack", "r = 0.75 mm", "eye.iop_mmhg"),
        ({"chamber_gap": 0.01, "gap_node": 2.0}, "reached the back", "r = 0.50 mm", "puff.peak_kpa"),
        ({"chamber_gap": -0.2}, "reached the back", "r = 0.00 mm", "chamber.depth_mm"),
        ({"flattest_triangle": -0.1}, "cross", "r = 3.00 mm", "numerics.spacing_mm"),
        ({"flattest_triangle": 0.01}, "cross", "r = 3.00 mm", "puff.peak_kpa"),
        ({"worst_condition": 1e12}, "singular", "r = 10.00 mm", "numerics.spacing_mm"),
        ({"worst_condition": float("inf")}, "singular", "r = 10.00 mm", "numerics.basis"),
        ({"worst_condition": NAN}, "singular", "r = 10.00 mm", "numerics.basis"),
        ({"not_finite": 1.0, "bad_node": 8.0}, "not finite", "r = 2.00 mm", "numerics.cfl"),
        ({"energy_gain": NAN}, "not finite", "r = 0.00 mm", "numerics.dissipation"),
        ({"energy_gain": 2e-5}, "energy", "20 uJ", "numerics.dissipation"),
        ({"energy_gain": 1e-7, "largest_work": 0.0}, "energy", "0.1 uJ", "numerics.cfl"),
        (
            {"coupling_status": float(NOT_CONVERGED), "overrides": ["numerics.coupling_iterations_max=7"]},
            "did not converge",
            "7 sweeps",
            "numerics.coupling_iterations_max",
        ),
    ],
)
def test_each_failure_is_named(keys, what, where, advice):
    stop = refusal(**keys)
    assert what in stop.what and where in stop.where and advice in stop.advice
    assert stop.time_ms == 12.345 and "12.345" in str(stop)


def test_a_shell_is_judged_from_the_classical_buckling_stress_on_and_stopped_once_it_folds():
    shell = ["cornea.flexural_modulus_mpa=0.2"]
    scene = load_scene(None, shell)
    cornea = scene.cornea
    # of an isotropic shell with the in-plane modulus for bending too: E h / (R sqrt(3 (1 - nu^2)))
    young = (1.0 - cornea.poisson_ratio) * 0.55e6
    uniform = young * cornea.thickness_mm / cornea.radius_mm / np.sqrt(3.0 * (1.0 - cornea.poisson_ratio**2))
    assert least_stress(eye_of(scene)) == pytest.approx(-uniform * np.sqrt(0.2e6 / young), rel=0.01)
    assert least_stress(eye_of(load_scene())) == 0.0
    judge(least_stress=2.0 * least_stress(eye_of(scene)), overrides=shell)
    stop = refusal(least_stress=2.0 * least_stress(eye_of(scene)), overrides=shell, lobes=5)
    assert "folded into 5 lobes" in stop.what and "cornea.flexural_modulus_mpa" in stop.advice


def test_a_slack_wall_is_named_before_what_it_causes():
    everything = {
        "least_stress": -1.0,
        "flattest_triangle": -1.0,
        "worst_condition": NAN,
        "not_finite": 1.0,
        "energy_gain": NAN,
    }
    assert "slack" in refusal(**everything).what


def test_many_eyes_are_calm_exactly_where_each_passes():
    rng, count, case = np.random.default_rng(3), 3000, case_of(load_scene(None))
    limit = CONDITION_LIMIT[case.scheme.basis]
    choices = {
        "least_stress": (14e3, 14e3, 1.0, 0.0, -5.0, -1e6),
        "chamber_gap": (0.6, 0.6, 0.1, 0.05),
        "flattest_triangle": (0.6, 0.6, 0.05, 0.0),
        "worst_condition": (210.0, 210.0, 1e3 * limit, NAN),
        "not_finite": (0.0, 0.0, 0.0, 1.0),
        "coupling_status": (RUNNING, RUNNING, RUNNING, NOT_CONVERGED),
        "viscous_loss": (0.0, 1e-7, 2e-6, 1e-5),
        "numerical_loss": (0.0, 1e-7, 2e-6, -1e-6),
    }
    rows = at_rest(count)
    for name, value in SOUND.items():
        rows[:, QUANTITIES.index(name)] = value
    for name, values in choices.items():
        rows[:, QUANTITIES.index(name)] = rng.choice(values, count)
    work = rng.choice([0.0, 2e-5, 3e-5], count)
    rows[:, QUANTITIES.index("puff_work")] = work
    rows[:, QUANTITIES.index("cornea_elastic")] = work + rng.choice([-1e-5, 0.0, 1e-8, 2.9e-6, 5e-6, NAN], count)
    guard = Guard([case] * count, [liquid_advice(case)] * count)
    verdict = guard.where_calm(rows, False)
    for k, quiet in enumerate(verdict):
        stop = guard.stop_of(k, k, rows[k], radius_mm=lambda node: 0.0, time_ms=1.0, lobes=None)
        assert (stop is None) == quiet, (rows[k], stop)
    assert 20 < verdict.sum() < 2500


@pytest.mark.parametrize("at_frame", [True, False])
def test_a_compressed_shell_is_looked_at_where_there_is_a_frame(at_frame):
    case = case_of(load_scene(None, ["cornea.flexural_modulus_mpa=0.2"]))
    guard, rows = Guard([case], [liquid_advice(case)]), at_rest(2)
    rows[:, QUANTITIES.index("least_stress")] = [0.5, 2.0] * guard.least
    assert list(guard.where_calm(rows, at_frame)) == [True, not at_frame]


def test_the_largest_work_is_carried_from_one_look_to_the_next():
    case = case_of(load_scene(None))
    guard, rows = Guard([case], [liquid_advice(case)]), at_rest(3)
    rows[:, QUANTITIES.index("least_stress")] = 1e4
    rows[:, QUANTITIES.index("puff_work")] = [1e-5, -4e-5, 2e-5]
    guard.where_calm(rows, False)
    assert guard.largest_work == pytest.approx([1e-5, 4e-5, 4e-5])
    guard.where_calm(rows[2:], False)
    assert guard.largest_work == pytest.approx([4e-5])


def stopped(*overrides):
    """The stop of a real scene; what was computed before it is sound."""
    run = run_eye(*overrides)
    assert run.stop is not None
    times = run["time_ms"]
    assert 0 < len(times) and times[-1] < run.stop.time_ms <= times[-1] + 0.026
    for column in run.traces.values():
        assert len(column) == len(times) and np.isfinite(column).all()
    return run


def test_no_dissipation_is_stopped_within_the_first_milliseconds():
    run = stopped("numerics.dissipation=0")
    assert run.stop.time_ms < 3.0
    assert "energy" in run.stop.what
    assert "numerics.dissipation" in run.stop.advice


@pytest.mark.parametrize("overrides", [("eye.iop_mmhg=1",), ("cornea.prestrain=0.002", "puff.peak_kpa=20")])
def test_an_eye_without_tension_goes_slack(overrides):
    run = stopped(*overrides)
    assert "slack" in run.stop.what and run.each("least_stress")[-1] <= 0.0 < run.each("least_stress")[:-1].min()
    assert "eye.iop_mmhg" in run.stop.advice


def test_a_compliant_eye_is_blown_flat_against_its_back():
    run = stopped("numerics.sound_speed_m_s=1", "puff.peak_kpa=20")
    assert "back" in run.stop.what or "cross" in run.stop.what
    assert "r = 0.0" in run.stop.where and "puff.peak_kpa" in run.stop.advice
    assert run["apex_displacement_mm"].max() > 2.0


@pytest.mark.parametrize(
    "overrides",
    [
        ("numerics.coupling_iterations_max=1",),
        ("numerics.relaxation=fixed", "numerics.relaxation_factor=0.05", "numerics.coupling_iterations_max=10"),
    ],
)
def test_an_iteration_cut_short_is_stopped(overrides):
    run = stopped(*overrides)
    assert "did not converge" in run.stop.what
    assert run.stop.where == f"in {run.scene.numerics.coupling_iterations_max} sweeps"
    assert "numerics.coupling_iterations_max" in run.stop.advice


@pytest.mark.parametrize("overrides", [("numerics.dissipation=1",), ("eye.iop_mmhg=5",), ("numerics.basis=cubic",)])
def test_a_dent_of_three_quarters_of_the_chamber_is_no_failure(overrides):
    run = run_eye("puff.peak_kpa=80", *overrides)
    assert run.stop is None
    assert run["apex_displacement_mm"].max() > 1.8
    assert np.abs(run["energy_error_uj"]).max() < 0.01 * run["puff_work_uj"].max()


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_gains_within_the_rounding_of_the_wall_are_not_judged(precision, monkeypatch):
    case = case_of(load_scene(None, ["eye.iop_mmhg=25", "numerics.spacing_mm=0.35"]))
    monkeypatch.setattr(backend, "_active", {"precision": precision})
    floor = energy_floor(case)
    if precision == "f64":
        assert floor == ENERGY_FLOOR
    else:
        # places of some 8 mm to one part in 2^23, strains over 0.35 mm: what so much strain adds to the wall's energy
        strain = 2.0**-23 * 8.0 / 0.35
        wall = 2.0 * np.pi * 8.0e-3**2 * case.eye.cornea.thickness
        assert floor == pytest.approx(strain * case.eye.rest_stress * wall, rel=0.1) and floor > 10.0 * ENERGY_FLOOR
