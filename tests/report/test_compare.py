"""Measured histories: reading, refusing, comparing."""

import numpy as np
import pytest

from taichi_eye.errors import SceneError
from taichi_eye.report.compare import differences, read_measured
from taichi_eye.report.traces import COLUMNS, write_traces


def hump(t, peak=1.0, centre=15.0):
    return peak * np.exp(-0.5 * ((t - centre) / 4) ** 2)


def test_reads_deflections_and_displacements(tmp_path):
    path = tmp_path / "eye a.csv"
    path.write_text("# exported\nframe, time_ms, deflection_mm\n1,0,0\n2, 1.5 ,0.25\n3,2,0.5\n")
    measured = read_measured(path)
    assert (measured.name, measured.column) == ("eye a.csv", "deflection_mm")
    np.testing.assert_array_equal(measured.time_ms, [0, 1.5, 2])
    np.testing.assert_array_equal(measured.displacement_mm, [0, 0.25, 0.5])


def test_traces_of_another_run_will_do(tmp_path):
    t = np.linspace(0, 32, 65)
    write_traces(
        tmp_path / "traces.csv",
        {name: np.zeros(65) for name in COLUMNS} | {"time_ms": t, "apex_displacement_mm": hump(t)},
    )
    measured = read_measured(tmp_path / "traces.csv")
    assert measured.column == "apex_displacement_mm"
    np.testing.assert_array_equal(measured.displacement_mm, hump(t))


@pytest.mark.parametrize(
    "content, part",
    [
        ("", "is empty"),
        ("time_ms,apex\n0,0\n1,1\n", "time_ms and apex_displacement_mm or deflection_mm"),
        ("deflection_mm,apex_displacement_mm\n0,0\n1,1\n", "time_ms"),
        ("time_ms,deflection_mm,apex_displacement_mm\n0,0,0\n1,1,1\n", "keep the one"),
        ("time_ms,deflection_mm\n0,0\n1,one\n", 'line 3: deflection_mm = "one"'),
        ("time_ms,deflection_mm\n0,0\n0,1\n", "line 3: time_ms = 0 does not increase"),
        ("time_ms,deflection_mm\n0,0\n1,980\n", "reaches 980"),
        ("time_ms,deflection_mm\n0,0\n1,-0.98\n", "positive"),
    ],
)
def test_bad_file_is_refused(tmp_path, content, part):
    path = tmp_path / "m.csv"
    path.write_text(content)
    with pytest.raises(SceneError) as caught:
        read_measured(path)
    assert str(path) in str(caught.value) and part in str(caught.value)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        read_measured(tmp_path / "m.csv")


def test_differences(tmp_path):
    t = np.linspace(0, 32, 3201)
    path = tmp_path / "m.csv"
    rows = np.column_stack([t, hump(t, 0.8, 14.0)])
    np.savetxt(path, rows, delimiter=",", header="time_ms,deflection_mm", comments="")
    measured = read_measured(path)
    assert all(abs(v) < 1e-12 for v in differences(t, hump(t, 0.8, 14.0), measured).values())
    off = differences(t, hump(t, 1.0, 15.0), measured)
    assert off["peak_mm"] == pytest.approx(0.2, abs=1e-6)
    for name in ("peak_time_ms", "rise_time_ms", "fall_time_ms"):
        assert off[name] == pytest.approx(1.0, abs=1e-3)
    shifted = differences(t, hump(t, 0.8, 14.0) + 0.05, measured)
    assert shifted["rms_mm"] == pytest.approx(0.05, rel=1e-9)


def test_histories_that_do_not_overlap_or_finish(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("time_ms,deflection_mm\n40,0.1\n41,0.2\n")
    off = differences([0, 1, 2], [0, 0.1, 0.2], read_measured(path))
    assert off["rms_mm"] is None and off["fall_time_ms"] is None
