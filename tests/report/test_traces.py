"""traces.csv."""

import numpy as np
import pytest

from taichi_eye.report.traces import COLUMNS, WHOLE, append_traces, read_traces, write_traces


def random_traces(samples):
    rng = np.random.default_rng(5)
    traces = {name: rng.normal(size=samples) * 10.0 ** rng.integers(-300, 300, samples) for name in COLUMNS}
    return traces | {name: rng.integers(0, 20, samples) for name in WHOLE}


@pytest.mark.parametrize("samples", [0, 1, 50])
def test_traces_come_back_bit_for_bit(tmp_path, samples):
    traces = random_traces(samples)
    write_traces(tmp_path / "traces.csv", traces)
    back = read_traces(tmp_path / "traces.csv")
    assert tuple(back) == COLUMNS
    for name in COLUMNS:
        np.testing.assert_array_equal(back[name], traces[name])
    assert [entry.name for entry in tmp_path.iterdir()] == ["traces.csv"]


def test_rows_can_be_added(tmp_path):
    traces = random_traces(9)
    write_traces(tmp_path / "grown.csv", {name: values[:4] for name, values in traces.items()})
    append_traces(tmp_path / "grown.csv", {name: values[:7] for name, values in traces.items()}, 4)
    append_traces(tmp_path / "grown.csv", traces, 7)
    write_traces(tmp_path / "whole.csv", traces)
    assert (tmp_path / "grown.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_single_precision_is_kept(tmp_path):
    traces = random_traces(4) | {"time_ms": np.float32([0.1, 0.2, 0.3, 0.4])}
    write_traces(tmp_path / "traces.csv", traces)
    np.testing.assert_array_equal(read_traces(tmp_path / "traces.csv")["time_ms"].astype(np.float32), traces["time_ms"])


def test_header_and_counts_read_as_documented(tmp_path):
    write_traces(tmp_path / "traces.csv", {name: np.zeros(1) for name in COLUMNS} | {"coupling_iterations": [3]})
    header, row = (tmp_path / "traces.csv").read_text().splitlines()
    assert header == (
        "time_ms,apex_displacement_mm,apex_velocity_m_s,puff_apex_kpa,fluid_pressure_apex_kpa,"
        "chamber_volume_error,puff_work_uj,cornea_elastic_uj,cornea_kinetic_uj,aqueous_kinetic_uj,"
        "aqueous_elastic_uj,viscous_loss_uj,numerical_loss_uj,outflow_loss_uj,tissue_loss_uj,energy_error_uj,"
        "coupling_iterations,coupling_residual,cornea_min_stress_kpa"
    )
    assert row.split(",")[16] == "3" and row.split(",")[0] == "0.0"


def test_columns_of_unequal_length_leave_the_old_file(tmp_path):
    path = tmp_path / "traces.csv"
    write_traces(path, random_traces(3))
    before = path.read_bytes()
    with pytest.raises(ValueError):
        write_traces(path, random_traces(3) | {"time_ms": np.zeros(2)})
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("cell", ["nan", "inf", "1e300", "1.5", "x", "", "1,2"])
def test_a_count_that_is_none_is_no_trace(cell, tmp_path):
    path = tmp_path / "traces.csv"
    write_traces(path, {name: np.zeros(3) for name in COLUMNS})
    lines = path.read_text().splitlines()
    cells = lines[2].split(",")
    cells[COLUMNS.index("coupling_iterations")] = cell
    path.write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]) + "\n")
    with pytest.raises(ValueError):
        read_traces(path)
