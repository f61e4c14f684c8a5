"""The coupling of cornea and liquid: converged, and the same however it gets there."""

import numpy as np
import pytest
from eye_bench import run_eye

from taichi_eye.solver import coupling

SHORT = "numerics.duration_ms=7"
COMPARED = (
    "apex_displacement_mm",
    "apex_velocity_m_s",
    "fluid_pressure_apex_kpa",
    "puff_work_uj",
    "cornea_elastic_uj",
    "aqueous_kinetic_uj",
)


def apart(one, other):
    """Largest difference of the histories, relative to their largest values."""
    return max(np.abs(one[name] - other[name]).max() / np.abs(one[name]).max() for name in COMPARED)


@pytest.fixture(scope="module")
def iterated():
    return run_eye(SHORT)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-11])
def test_iteration_ends_below_its_tolerance(tolerance):
    run = run_eye("numerics.duration_ms=3", f"numerics.coupling_tolerance={tolerance}")
    assert run.stop is None
    assert run["coupling_residual"].max() <= tolerance
    assert 1 <= run["coupling_iterations"][1:].min() and run["coupling_iterations"].max() < 20


def test_a_finer_tolerance_takes_more_sweeps():
    sweeps = [
        run_eye("numerics.duration_ms=2", f"numerics.coupling_tolerance={t}")["coupling_iterations"][1:].mean()
        for t in (1e-3, 1e-6, 1e-11)
    ]
    assert sweeps[0] < sweeps[1] < sweeps[2]


@pytest.mark.parametrize("relaxation, factor", [("fixed", 1.0), ("fixed", 0.7), ("aitken", 0.5)])
def test_relaxation_changes_the_way_and_not_the_result(iterated, relaxation, factor):
    other = run_eye(
        SHORT,
        f"numerics.relaxation={relaxation}",
        f"numerics.relaxation_factor={factor}",
        "numerics.coupling_iterations_max=100",
    )
    assert other.stop is None and not np.array_equal(other["coupling_iterations"], iterated["coupling_iterations"])
    assert apart(iterated, other) < 1e-5


def test_relaxed_results_close_in_as_the_tolerance_does():
    gaps = []
    for tolerance in (1e-5, 1e-10):
        keys = (
            "numerics.duration_ms=4",
            f"numerics.coupling_tolerance={tolerance}",
            "numerics.coupling_iterations_max=99",
        )
        fixed = run_eye(*keys, "numerics.relaxation=fixed", "numerics.relaxation_factor=0.6")
        gaps.append(apart(run_eye(*keys), fixed))
    assert gaps[1] < 0.01 * gaps[0]


def test_aitken_takes_fewer_sweeps_than_a_small_fixed_factor(iterated):
    slow = run_eye(
        SHORT, "numerics.relaxation=fixed", "numerics.relaxation_factor=0.5", "numerics.coupling_iterations_max=100"
    )
    assert iterated["coupling_iterations"].mean() < 0.5 * slow["coupling_iterations"].mean()


def test_loose_coupling_differs_by_no_more_than_the_order_of_the_step():
    steps, gaps = (0.8, 0.4, 0.2), []
    for cfl in steps:
        keys = SHORT, f"numerics.cfl={cfl}"
        loose = run_eye(*keys, "numerics.coupling=loose")
        assert loose.stop is None and set(loose["coupling_iterations"][1:]) == {1}
        gaps.append(apart(run_eye(*keys), loose))
    assert gaps[0] < 5e-3
    assert np.polyfit(np.log(steps), np.log(gaps), 1)[0] > 0.9


def test_serial_and_parallel_kernels_agree_to_rounding(iterated, monkeypatch):
    monkeypatch.setattr(coupling, "SERIAL_NODES", 0)
    parallel = run_eye("numerics.duration_ms=2")
    count = len(parallel["time_ms"])
    for column, values in iterated.traces.items():
        np.testing.assert_allclose(
            parallel[column][:count], values[:count], rtol=1e-9, atol=1e-9 * np.abs(values).max(), err_msg=column
        )


def test_history_hardly_depends_on_the_time_step():
    steps = (0.8, 0.4, 0.2)
    runs = [run_eye("numerics.duration_ms=6", f"numerics.cfl={cfl}") for cfl in steps]
    coarse, fine = (np.abs(a["apex_displacement_mm"] - b["apex_displacement_mm"]).max() for a, b in zip(runs, runs[1:]))
    assert fine < coarse < 1e-3 * np.abs(runs[0]["apex_displacement_mm"]).max()
