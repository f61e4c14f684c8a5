"""The columns of a study's table, and of the table of many exams: one name, unit and meaning for both.

    eye           number of the row in the design, from 0
    ...           the keys that differ from eye to eye, by their names in a scene
    fidelity      the rung that computed
    CLINICAL      dynamic corneal response (`taichi_eye.analysis.response`), empty where an eye does not show it
    SUMMARY       of the computed history
    status        complete; stopped, by a guard; refused, as no scene; failed, by anything else
    reason        why, and when: what stopped or was refused

Beside many of CLINICAL the instrument's software has a column of its own, INSTRUMENT; such a column stands beside ours
in a table of exams, so that what was written for its exports reads ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from taichi_eye.analysis.names import unit_of
from taichi_eye.analysis.response import READ_AS, Response
from taichi_eye.scene.schema import all_keys

CLINICAL = tuple(f.name for f in fields(Response))
SUMMARY = {
    "simulated_ms": "time that was simulated",
    "apex_peak_mm": "largest displacement of the apex, whole-eye movement left out",
    "apex_peak_time_ms": "time of that",
    "apex_half_rise_ms": "the apex passes half of that, inwards",
    "apex_half_fall_ms": "and outwards",
    "apex_delay_ms": "from the puff's peak to the apex's",
    "fluid_pressure_apex_max_kpa": "largest pressure of the liquid under the apex",
    "cornea_min_stress_kpa": "smallest principal stress in the cornea",
    "chamber_volume_error_max": "largest change of the chamber's volume over it",
    "energy_error_share_of_work": "largest error of the energy balance over the puff's work",
}
FIGURES = (*CLINICAL, *SUMMARY)  # every column that holds a measured or computed number
STATUSES = "complete", "stopped", "refused", "failed"
INSTRUMENT = {
    "a1_time_ms": "A1 Time [ms]",
    "a1_velocity_m_s": "A1 Velocity [m/s]",
    "a1_length_mm": "A1 Length [mm]",
    "a1_deflection_mm": "A1 Deflection Amp. [mm]",
    "a1_deflection_area_mm2": "A1 Deflection Area [mm^2]",
    "a1_delta_arc_length_mm": "A1 dArc Length [mm]",
    "a2_time_ms": "A2 Time [ms]",
    "a2_velocity_m_s": "A2 Velocity [m/s]",
    "a2_length_mm": "A2 Length [mm]",
    "a2_deflection_mm": "A2 Deflection Amp. [mm]",
    "a2_deflection_area_mm2": "A2 Deflection Area [mm^2]",
    "a2_delta_arc_length_mm": "A2 dArc Length [mm]",
    "hc_time_ms": "HC Time [ms]",
    "deformation_amplitude_mm": "Def. Amp. Max [mm]",
    "hc_deflection_mm": "HC Deflection Amp. [mm]",
    "hc_circle_radius_mm": "Radius [mm]",
    "peak_distance_mm": "Peak Dist. [mm]",
    "hc_deflection_area_mm2": "HC Deflection Area [mm^2]",
    "hc_delta_arc_length_mm": "HC dArc Length [mm]",
    "da_ratio_1mm": "DA Ratio Max (1mm)",
    "da_ratio_2mm": "DA Ratio Max (2mm)",
    "max_inverse_radius_per_mm": "Max Inverse Radius [mm^-1]",
    "integrated_inverse_radius_per_mm": "Integr. Radius [mm^-1]",
    "whole_eye_movement_mm": "Whole Eye Movement Max [mm]",
    "whole_eye_movement_time_ms": "Whole Eye Movement Max [ms]",
    "central_thickness_um": "Pachy [um]",
    "iop_nct_mmhg": "IOPnct [mmHg]",
    "biop_mmhg": "bIOP [mmHg]",
    "sp_a1_mmhg_mm": "SP A1",
}


def described(inputs: Iterable[str]) -> list[tuple[str, str, str, str]]:
    """Every column of a study's table: name, unit, the instrument's name, meaning; inputs: the keys that vary."""
    keys = {name: spec for name, _, spec in all_keys()}
    rows = [("eye", "", "", "number of the eye in the design, from 0")]
    rows += [(name, keys[name].unit, "", keys[name].doc) if name in keys else (name, "", "", "") for name in inputs]
    rows.append(("fidelity", "", "", "the rung that computed"))
    rows += [(name, unit_of(name), INSTRUMENT.get(name, ""), READ_AS.get(name, "")) for name in CLINICAL]
    rows += [(name, unit_of(name), "", meaning) for name, meaning in SUMMARY.items()]
    rows.append(("status", "", "", f"one of {', '.join(STATUSES)}"))
    rows.append(("reason", "", "", "why an eye was stopped, refused or failed, and when"))
    return rows


def schema_of(inputs: Sequence[str], labels: Sequence[str] = ()):
    """The Arrow schema of a study's table; labels: columns of text that a table of eyes carries along."""
    import pyarrow as pa

    kinds = {name: kind for name, kind, _ in all_keys()}
    types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
    columns = [("eye", pa.int64()), *((name, pa.string()) for name in labels)]
    columns += [(name, types[kinds[name]]) for name in inputs]
    columns += [("fidelity", pa.string()), *((name, pa.float64()) for name in FIGURES)]
    return pa.schema([*columns, ("status", pa.string()), ("reason", pa.string())])


def exams_schema():
    """The Arrow schema of a table of exams: the instrument's names beside ours."""
    import pyarrow as pa

    columns = [("exam", pa.string())]
    for name in CLINICAL:
        columns.append((name, pa.float64()))
        if name in INSTRUMENT:
            columns.append((INSTRUMENT[name], pa.float64()))
    last = ("frames", pa.int64()), ("timed_by", pa.string()), ("notes", pa.string())
    return pa.schema([*columns, *last, ("status", pa.string()), ("reason", pa.string())])


def beside(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the instrument's columns added."""
    return {**row, **{theirs: row.get(ours) for ours, theirs in INSTRUMENT.items()}}
