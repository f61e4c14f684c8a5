"""A row of clinical parameters as a table holds it: names, units, what they may be, and how well they are known.

A column may have the clinic's name or the one of `taichi_eye.analysis.Response`, with a unit or without.
`REPEATABILITY` is the standard deviation between examinations of one eye, rounded from published studies of the Corvis
ST (SP-A1 4.9 to 7.7 mmHg/mm, IOPnct below 1 mmHg, thickness 5 um). A table from an instrument gives A2 velocity
negative, as it is here; a positive one is turned. bIOP is never fitted to: it is what an estimate is held against.
IOPnct is the A1 time by another name, and gives it where the table does not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from taichi_eye.analysis.response import a1_time_shown_as_ms
from taichi_eye.errors import SceneError
from taichi_eye.scene.table import number, read_cells

# standard deviation between examinations; range that any eye's value lies in
REPEATABILITY = {
    "a1_time_ms": (0.07, (4.5, 14.0)),
    "a1_velocity_m_s": (0.010, (0.03, 0.6)),
    "a1_deflection_mm": (0.007, (0.03, 0.5)),
    "a2_time_ms": (0.15, (16.0, 28.0)),
    "a2_velocity_m_s": (0.025, (-1.2, -0.05)),
    "hc_time_ms": (0.30, (13.0, 22.0)),
    "deformation_amplitude_mm": (0.025, (0.2, 2.0)),
    "hc_deflection_mm": (0.025, (0.2, 2.0)),
    "peak_distance_mm": (0.12, (1.0, 8.0)),
    "hc_radius_mm": (0.40, (1.0, 30.0)),
    "hc_circle_radius_mm": (0.45, (1.0, 40.0)),
    "da_ratio_2mm": (0.12, (1.2, 20.0)),
    "da_ratio_1mm": (0.03, (1.01, 5.0)),
    "integrated_inverse_radius_per_mm": (0.30, (1.0, 40.0)),
    "sp_a1_mmhg_mm": (6.0, (10.0, 500.0)),
}
THICKNESS_SD_UM = 5.0
BESIDE = {  # not fitted to; range
    "central_thickness_um": (300.0, 800.0),
    "iop_nct_mmhg": (3.0, 80.0),
    "biop_mmhg": (1.0, 80.0),
    "iop_mmhg": (3.0, 80.0),
    "age_years": (5.0, 110.0),
}
NAMES = {
    "a1_time_ms": "a1time a1t at1 timea1 ap1time",
    "a1_velocity_m_s": "a1velocity a1v velocitya1 va1 a1vel vin",
    "a1_deflection_mm": "a1deflection a1deflectionamplitude a1defla a1da",
    "a2_time_ms": "a2time a2t at2 timea2 ap2time",
    "a2_velocity_m_s": "a2velocity a2v velocitya2 va2 a2vel vout",
    "hc_time_ms": "hctime hct timehc",
    "deformation_amplitude_mm": "deformationamplitude da damax defampmax defamplitude defamp",
    "hc_deflection_mm": "hcdeflection deflectionamplitude deflamp hcdeflectionamplitude deflectionamplitudemax",
    "peak_distance_mm": "peakdistance pd peakdist",
    "hc_circle_radius_mm": "hccircleradius hcradius radius hcr hccurvatureradius",
    "da_ratio_2mm": "daratio2mm daratio dar daratiomax2mm daratio2 dar2",
    "da_ratio_1mm": "daratio1mm daratiomax1mm daratio1 dar1",
    "integrated_inverse_radius_per_mm": "integratedinverseradius ir integratedradius intradius intinverseradius",
    "sp_a1_mmhg_mm": "spa1 stiffnessparameter stiffnessparametera1",
    "central_thickness_um": "centralthickness cct pachymetry pachy thickness",
    "iop_nct_mmhg": "iopnct nctiop iopcorvis",
    "biop_mmhg": "biop",
    "iop_mmhg": "iop trueiop goat gat",
    "age_years": "age",
}
# the names of this package whose bare words mean something else in the clinic
OWN = {"hc_radius_mm"}
_ALIASES = {alias: name for name, aliases in NAMES.items() for alias in aliases.split()}
_UNIT = re.compile(
    r"[\s_]*[\[(]?\s*(mm\^?-?1|mmhg[/_]mm|mmhg|1/mm|per[ _]mm|m[/_]s|mm|um|\N{MICRO SIGN}m|ms|years|year|yrs)\s*[\])]?$"
)


@dataclass(frozen=True)
class Row:
    """One examination. label: what the table calls it; values: by the names of `REPEATABILITY`; beside: by those of
    `BESIDE`; notes: what was mended."""

    label: str
    values: dict[str, float]
    beside: dict[str, float]
    notes: tuple[str, ...] = ()


def named(cell: str) -> str | None:
    """The parameter that a header's cell means; None for another column."""
    text = cell.strip().strip('"').lower()
    if text in REPEATABILITY or text in BESIDE or text in OWN:
        return text
    bare = _UNIT.sub("", text)
    return _ALIASES.get(re.sub(r"[^a-z0-9]", "", bare)) or _ALIASES.get(re.sub(r"[^a-z0-9]", "", text))


def is_parameter(cell: str) -> bool:
    """Whether a header's cell is a column of a table of parameters, or the word over a column of their names."""
    return named(cell) is not None or cell in ("parameter", "value")


def checked(path, label: str, found: Mapping[str, float]) -> Row:
    """A row whose values are in range, units mended where they are plain; SceneError names what is not."""
    values, beside, notes = {}, {}, []
    for name, value in found.items():
        low, high = REPEATABILITY[name][1] if name in REPEATABILITY else BESIDE[name]
        if name == "central_thickness_um" and 0.3 <= value <= 0.8:
            value *= 1e3
            notes.append("thickness taken for mm")
        elif name == "a2_velocity_m_s" and value > 0.0:
            value = -value
            notes.append("A2 velocity turned negative")
        elif (
            name.endswith("_mm") and name in REPEATABILITY and not low <= value <= high and low <= 1e-3 * value <= high
        ):
            if "ratio" not in name and "mmhg" not in name:
                value *= 1e-3
                notes.append(f"{name} taken for um")
        if not low <= value <= high:
            raise SceneError(f"{path}: {label}: {name} = {value:g}; an eye's lies between {low:g} and {high:g}")
        (values if name in REPEATABILITY else beside)[name] = value
    if "a1_time_ms" not in values and "iop_nct_mmhg" in beside:
        values["a1_time_ms"] = a1_time_shown_as_ms(beside["iop_nct_mmhg"])
        notes.append("A1 time from IOPnct")
    if len(values) < 3:
        raise SceneError(
            f"{path}: {label}: {len(values)} parameters ({', '.join(values) or 'none'}); at least three are needed of "
            f"{', '.join(REPEATABILITY)}"
        )
    return Row(label, values, beside, tuple(notes))


def read_rows(path: Path) -> tuple[list[Row], list[str]]:
    """The rows of a table of parameters, and what was left out; SceneError where it is none.

    A table of two columns, parameter and value, as `taichi-eye analyze` writes it, is one row. A row with a value that
    cannot be is left out and said, unless it is the only one.
    """
    header, delimiter, cells = read_cells(path, is_parameter)
    if header[:2] == ["parameter", "value"]:
        pairs = {named(row[0]): row[1] for _, row in cells if len(row) > 1 and named(row[0]) and row[1]}
        header, cells = list(pairs), [(2, list(pairs.values()))]
    columns: dict[str, int] = {}
    for at, cell in enumerate(header):
        name = named(cell)
        if name in columns:
            raise SceneError(f"{path}: the header names {name} more than once ({header[columns[name]]}, {cell})")
        if name:
            columns[name] = at
    if not columns.keys() & REPEATABILITY.keys():
        raise SceneError(
            f'{path}: the header is "{",".join(header)[:200]}"; needed is time_ms with a displacement, or columns of '
            f"parameters: {', '.join(REPEATABILITY)}"
        )
    rows, left_out = [], []
    for place, (line, row) in enumerate(cells, 1):
        label = f"row {place}" + (f" ({row[0]})" if row and 0 not in columns.values() else "")
        try:
            found = {}
            for name, at in columns.items():
                text = row[at].strip() if at < len(row) else ""
                if text.lower() in ("", "-", "na", "nan", "n/a"):
                    continue
                found[name] = number(text, delimiter)
                if not math.isfinite(found[name]):
                    raise SceneError(f'{path}: line {line}: {name} = "{text}"; a finite number is needed')
            rows.append(checked(path, label, found))
        except SceneError as problem:
            if len(cells) == 1:
                raise
            left_out.append(str(problem))
    if not rows:
        raise SceneError(left_out[0] if left_out else f"{path}: has no rows")
    return rows, left_out
