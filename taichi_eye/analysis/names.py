"""The full names of the clinic's parameters, and their units: one text for tables, pages and the guide."""

from __future__ import annotations

import re

# by the names of `taichi_eye.analysis.response.Response`, in its order
NAMES = {
    "a1_time_ms": "first applanation (A1), time",
    "a1_velocity_m_s": "velocity of the apex at A1, inwards",
    "a1_length_mm": "length of the flat part at A1",
    "a1_deflection_mm": "deflection amplitude at A1: apex less whole-eye movement",
    "a1_deflection_area_mm2": "deflection area at A1: between the curve at rest and the deflected one, central 7 mm",
    "a1_delta_arc_length_mm": "change in length of the curve at A1, central 7 mm",
    "a2_time_ms": "second applanation (A2), time",
    "a2_velocity_m_s": "velocity of the apex at A2, inwards",
    "a2_length_mm": "length of the flat part at A2",
    "a2_deflection_mm": "deflection amplitude at A2",
    "a2_deflection_area_mm2": "deflection area at A2",
    "a2_delta_arc_length_mm": "change in length of the curve at A2",
    "hc_time_ms": "highest concavity (HC), time: the largest apex deformation",
    "deformation_amplitude_mm": "deformation amplitude (DA): the largest apex deformation, whole-eye movement included",
    "hc_deflection_mm": "deflection amplitude at HC",
    "hc_radius_mm": "radius of the central 2 mm at HC",
    "hc_circle_radius_mm": "radius at HC (as norms have it): of the circle through both bending peaks and the apex",
    "peak_distance_mm": "peak distance (PD): between the two bending peaks at HC",
    "hc_deflection_area_mm2": "deflection area at HC",
    "hc_delta_arc_length_mm": "change in length of the curve at HC",
    "da_ratio_1mm": "deformation amplitude ratio, 1 mm: apex over its mean 1 mm beside it, largest from A1 to HC",
    "da_ratio_2mm": "deformation amplitude ratio, 2 mm: apex over its mean 2 mm beside it, largest from A1 to HC",
    "max_inverse_radius_per_mm": "largest inverse radius: concave curvature of the central 4 mm",
    "integrated_inverse_radius_per_mm": "integrated inverse radius (IR): that curvature summed over the frames from A1 "
    "to A2",
    "whole_eye_movement_mm": "whole-eye movement: the largest retreat of the eye, read beside the dent",
    "whole_eye_movement_time_ms": "time of the largest retreat",
    "central_thickness_um": "central corneal thickness at rest, refraction undone",
    "iop_nct_mmhg": "non-contact tonometer pressure (IOPnct): a straight line in the A1 time",
    "biop_mmhg": "pressure of the eye (bIOP): as given, or the surrogate from IOPnct, thickness and age",
    "sp_a1_mmhg_mm": "stiffness parameter at A1 (SP-A1): (air pressure at A1 less bIOP) over the deflection then",
}
UNITS = {
    "per_mm": "1/mm",
    "mmhg_mm": "mmHg/mm",
    "m_s": "m/s",
    "mm2": "mm^2",
    "mmhg": "mmHg",
    "kpa": "kPa",
    "mm": "mm",
    "um": "um",
    "ms": "ms",
}
_UNIT = re.compile(rf"_({'|'.join(UNITS)})(?:_max)?$")
_RATIO = "da_ratio_1mm", "da_ratio_2mm"


def unit_of(name: str) -> str:
    """Unit of a column; empty where it has none."""
    found = None if name in _RATIO else _UNIT.search(name.replace("_max_kpa", "_kpa"))
    return UNITS[found[1]] if found else ""
