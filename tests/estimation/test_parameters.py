"""Rows of clinical parameters: names, units, ranges."""

import pytest

from taichi_eye.errors import SceneError
from taichi_eye.estimation.parameters import named, read_rows

CLINIC = "ID;Age;CCT (um);bIOP;DA (mm);PD (mm);A1 Velocity (m/s);A2V;HC Radius;DA ratio;IR;SP-A1\n"


def test_a_clinic_s_table_is_read_with_its_own_names_and_units(tmp_path):
    path = tmp_path / "eyes.csv"
    path.write_text(
        "# an export\n"
        + CLINIC
        + "e1;71;0,551;14,8;1,06;4,8;0,137;0,264;8,1;4,1;7,6;114\ne2;68;530;12;1.1;;0.15;-0.3;7;4;8;NA\n"
    )
    rows, left_out = read_rows(path)
    assert not left_out and [row.label for row in rows] == ["row 1 (e1)", "row 2 (e2)"]
    first, second = rows
    assert first.beside == {"age_years": 71.0, "central_thickness_um": 551.0, "biop_mmhg": 14.8}
    assert first.values["a2_velocity_m_s"] == -0.264 and first.values["hc_circle_radius_mm"] == 8.1
    assert first.values["integrated_inverse_radius_per_mm"] == 7.6 and first.values["sp_a1_mmhg_mm"] == 114.0
    assert len(first.notes) == 2
    assert "peak_distance_mm" not in second.values and "sp_a1_mmhg_mm" not in second.values
    assert "biop_mmhg" not in first.values


@pytest.mark.parametrize(
    "cell, name",
    [
        ("a1_time_ms", "a1_time_ms"),
        ("A1T [ms]", "a1_time_ms"),
        ("A1 Deflection Amp. (mm)", None),
        ("Deformation Amplitude", "deformation_amplitude_mm"),
        ("DA Ratio 2mm", "da_ratio_2mm"),
        ("Integrated Radius (1/mm)", "integrated_inverse_radius_per_mm"),
        ("SP A1 (mmHg/mm)", "sp_a1_mmhg_mm"),
        ("Pachymetry", "central_thickness_um"),
        ("IOPnct (mmHg)", "iop_nct_mmhg"),
        ("hc_radius_mm", "hc_radius_mm"),
        ("Radius (mm)", "hc_circle_radius_mm"),
        ("colour", None),
    ],
)
def test_names(cell, name):
    assert named(cell) == name


def test_what_cannot_be_is_left_out_and_refused_where_it_is_all(tmp_path):
    path = tmp_path / "eyes.csv"
    good, bad = "e1;71;551;14;1.06;4.8;.137;-.26;8.1;4.1;7.6;114\n", "e2;71;551;14;9.9;4.8;.137;-.26;8.1;4.1;7.6;114\n"
    path.write_text(CLINIC + good + bad)
    rows, left_out = read_rows(path)
    assert len(rows) == 1 and "row 2 (e2): deformation_amplitude_mm = 9.9; an eye's lies between" in left_out[0]
    path.write_text(CLINIC + bad)
    with pytest.raises(SceneError, match="deformation_amplitude_mm = 9.9"):
        read_rows(path)
    path.write_text("DA,PD\n1.0,4.8\n")
    with pytest.raises(SceneError, match="2 parameters .* at least three"):
        read_rows(path)
    path.write_text("DA,Deformation amplitude\n1.0,4.8\n")
    with pytest.raises(SceneError, match="names deformation_amplitude_mm more than once"):
        read_rows(path)
    path.write_text("DA,PD,IR\n1.0,4.8,seven\n")
    with pytest.raises(SceneError, match='line 2: integrated_inverse_radius_per_mm = "seven"'):
        read_rows(path)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(SceneError, match="needed is time_ms with a displacement, or columns of parameters"):
        read_rows(path)


def test_a_table_of_analyze_is_one_row_and_iop_nct_is_a_time(tmp_path):
    path = tmp_path / "parameters.csv"
    path.write_text(
        "parameter,value,z_china\na1_time_ms,7.4,0\ndeformation_amplitude_mm,1.05,\na2_time_ms,,\nhc_time_ms,16.8,\n"
    )
    (row,), _ = read_rows(path)
    assert row.values == {"a1_time_ms": 7.4, "deformation_amplitude_mm": 1.05, "hc_time_ms": 16.8}
    path.write_text("IOPnct,DA,PD\n18.14,1.05,4.8\n")
    (row,), _ = read_rows(path)
    assert row.values["a1_time_ms"] == pytest.approx(7.36 + 0.134 * 1.34)


@pytest.mark.parametrize("start", ["", "sep=;\n", "# exported\r\n"])
def test_a_table_is_read_however_a_spreadsheet_wrote_it(start, tmp_path):
    path = tmp_path / "eyes.txt"
    text = start + 'eye;"DA (mm)";PD;A1T;remark\n#1;0;0;0;\ne1;1,05;4,8;7,4;a\u2028b, c\n'
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_bytes(text.encode(encoding))
        (row,), left_out = read_rows(path)
        assert row.values == {"deformation_amplitude_mm": 1.05, "peak_distance_mm": 4.8, "a1_time_ms": 7.4}
        assert row.label == "row 1 (e1)" and not left_out
