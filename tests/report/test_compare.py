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
    # what a run calls a displacement has no movement of the whole eye in it
    assert measured.column == "deflection_mm" and any("whole eye" in note for note in measured.notes)
    np.testing.assert_array_equal(measured.displacement_mm, hump(t))


def test_a_displacement_of_an_instrument_stays_one(tmp_path):
    path = tmp_path / "eye.csv"
    path.write_text("time_ms,apex_displacement_mm,puff_kpa\n0,0,0\n1.5,0.25,3\n2,0.5,4\n")
    measured = read_measured(path)
    assert measured.column == "apex_displacement_mm" and measured.notes == ()


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
    assert off["peak_difference_mm"] == pytest.approx(0.2, abs=1e-6)
    for name in ("peak_time_difference_ms", "half_rise_difference_ms", "half_fall_difference_ms"):
        assert off[name] == pytest.approx(1.0, abs=1e-3)
    shifted = differences(t, hump(t, 0.8, 14.0) + 0.05, measured)
    assert shifted["rms_difference_mm"] == pytest.approx(0.05, rel=1e-9)


def test_histories_that_do_not_overlap_or_finish(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("time_ms,deflection_mm\n40,0.1\n41,0.2\n")
    off = differences([0, 1, 2], [0, 0.1, 0.2], read_measured(path))
    assert off["rms_difference_mm"] is None and off["half_fall_difference_ms"] is None


def written(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time_ms;deflection_mm\n0,0;0,0\n1,5;0,25\n2,0;0,5\n",
        "sep=;\r\ntime_ms;deflection_mm\r\n0;0\r\n1,5;0,25\r\n2;0,5\r\n",
        "sep=,\ntime_ms,deflection_mm\n0,0\n1.5,0.25\n2,0.5\n",
        "Time (ms)\tDeflection [mm]\n0\t0\n1.5\t0.25\n2\t0.5\n",
        "time,deflection\nms,mm\n0,0\n1.5,0.25\n2,0.5\n",
        "time;deflection\n[s];[um]\n0;0\n0,0015;250\n0,002;500\n",
        "time_us,deflection_um\n0,0\n1500,250\n2000,500\n",
        "time_s,deflection_m,eye\n0,0,left\n0.0015,0.00025,left\n0.002,0.0005,left\n",
        "time_ms,deflection_mm\n2,0.5\n0,0\n1.5,0.25\n",
        "time_ms,deflection_mm\n0,0\n0.7,\n1.5,0.25\n,0.3\n2,0.5\n",
        "# one line\u2028still it \u0085 and \x0b still\ntime_ms,deflection_mm\n0,0\n1.5,0.25\n2,0.5\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_what_a_spreadsheet_makes_of_a_table_is_undone(tmp_path, text, encoding):
    measured = read_measured(written(tmp_path / "m.csv", text, encoding))
    assert measured.time_ms == pytest.approx([0.0, 1.5, 2.0]) and measured.column == "deflection_mm"
    assert measured.displacement_mm == pytest.approx([0.0, 0.25, 0.5])


@pytest.mark.parametrize(
    "text, note",
    [
        ("time_ms,deflection_mm\n2,0.5\n0,0\n1.5,0.25\n", "order of their times"),
        ("time_ms,deflection_mm\n0,0\n0.7,\n1.5,0.25\n", "1 rows with a blank cell"),
        ("time_us,deflection_mm\n0,0\n700,0.1\n", "converted to time_ms"),
    ],
)
def test_what_was_mended_is_said(tmp_path, text, note):
    assert any(note in said for said in read_measured(written(tmp_path / "m.csv", text)).notes)


def test_the_histories_of_an_analysis_will_do(tmp_path):
    t = np.linspace(0, 32, 65)
    rows = np.column_stack([t, hump(t), hump(t, 0.8), 0.2 * hump(t), 0 * t])
    header = "time_ms,apex_deformation_mm,apex_deflection_mm,whole_eye_movement_mm,apex_velocity_m_s"
    np.savetxt(tmp_path / "histories.csv", rows, delimiter=",", header=header, comments="")
    measured = read_measured(tmp_path / "histories.csv")
    assert measured.column == "deflection_mm" and measured.displacement_mm == pytest.approx(hump(t, 0.8))


T = np.linspace(0.0, 32.0, 33)


@pytest.mark.parametrize(
    "time, values, part",
    [
        (T, -hump(T), "must be positive"),
        (T, 0.02 - hump(T), "must be positive"),
        (1e-3 * T, hump(T), "is it in s"),
        (1e3 * T, hump(T), "is it in us"),
        (T + 100.0, hump(T), "count from the puff's start"),
        (T, 1e3 * hump(T), "is it in um"),
        (T, 1e-3 * hump(T), "is it in m"),
    ],
)
def test_a_history_in_other_units_or_of_another_sign_is_refused(tmp_path, time, values, part):
    path = tmp_path / "m.csv"
    np.savetxt(path, np.column_stack([time, values]), delimiter=",", header="time_ms,deflection_mm", comments="")
    with pytest.raises(SceneError, match=part):
        read_measured(path)


def test_a_history_goes_through_a_json_file_with_its_notes(tmp_path):
    import json

    path = tmp_path / "eye.csv"
    path.write_text(
        "time_ms,apex_deformation_mm,apex_deflection_mm\n0,0,0\n8.5,0.5,0.4\n16,1,0.9\n24,0.2,0.1\n", encoding="utf-8"
    )
    measured = read_measured(path)
    again = type(measured).from_plain(json.loads(json.dumps(measured.as_plain())))
    assert measured.notes and again.notes == measured.notes and again.name == measured.name == "eye.csv"
    assert list(again.time_ms) == [0.0, 8.5, 16.0, 24.0] and list(again.displacement_mm) == [0.0, 0.4, 0.9, 0.1]
