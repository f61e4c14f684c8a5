"""An estimate in words and figures: the table that is printed, and everything unrounded for a JSON file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.estimation.estimate import Estimate, Quantity
from taichi_eye.estimation.fit import SD_95
from taichi_eye.estimation.parameters import Row
from taichi_eye.estimation.unknowns import IOP, UNKNOWNS

AGAINST = "biop_mmhg", "iop_mmhg", "iop_nct_mmhg"  # what a table may be held against, the first that it has


@dataclass(frozen=True)
class Agreement:
    """Estimates beside a table's own pressures: estimate less reference. slope: of the estimate on the reference;
    limits: of agreement (95 %); inside: share of the references within the 95 % intervals."""

    against: str
    eyes: int
    bias: float
    deviation: float
    slope: float
    limits: tuple[float, float]
    inside: float


def lines(found: Estimate) -> list[str]:
    """The report, line by line."""
    rows = [["", "estimate", "68 %", "95 %", "known before"]]
    for quantity in found.quantities:
        rows.append(
            [
                _named(quantity.name),
                f"{quantity.value:.4g} +- {quantity.deviation:.2g}",
                _range(quantity.range68),
                _range(quantity.range95),
                "nothing"
                if quantity.before is None
                else f"{quantity.before.value:.4g} +- {quantity.before.deviation:.2g}",
            ]
        )
    out = [f"{found.name}: {found.seen.kind}, {len(found.seen.values)} values", *_columns(rows)]
    if found.held:
        out.append("held: " + ", ".join(f"{_named(name)} {value:.4g}" for name, value in found.held.items()))
    error = f"model error {found.model_error_um:.0f} um" if found.model_error_um else "no model error"
    out.append(
        f"chi^2 {found.chi2:.1f} at {found.degrees} degrees of freedom (probability {found.probability:.2g}); {error}; "
        f"rung {found.rung}, {found.rounds} runs of it and {found.runs} cheap ones, {found.seconds:.1f} s"
    )
    if len(found.quantities) > 1:
        out += ["", "correlation"]
        names = [quantity.name for quantity in found.quantities]
        head = ["", *names]
        body = [[name, *(f"{value:+.2f}" for value in row)] for name, row in zip(names, found.correlation)]
        out += _columns([head, *body])
    out += ["", f"what carried the IOP (standard deviation {found.laplace_mmhg:.2g} mmHg): the same without"]
    out += _columns([[share.part, f"{share.count} values", f"{share.deviation_without:.2g}"] for share in found.shares])
    if found.costs:
        out += ["", "what not knowing costs the IOP, mmHg: known exactly, as it is, not at all"]
        out += _columns([[_named(c.name), f"{c.exact:.2g}", f"{c.known:.2g}", f"{c.unknown:.2g}"] for c in found.costs])
    out += [f"warning: {warning}" for warning in found.warnings]
    return out + [f"note: {note}" for note in found.notes]


def as_json(found: Estimate) -> dict:
    """All figures unrounded."""
    return {
        "name": found.name,
        "kind": found.seen.kind,
        "quantities": {quantity.name: _quantity(quantity) for quantity in found.quantities},
        "held": found.held,
        "chi2": found.chi2,
        "degrees_of_freedom": found.degrees,
        "probability": found.probability,
        "model_error_um": found.model_error_um,
        "model_error_widened": found.widened,
        "correlation": {
            "names": [quantity.name for quantity in found.quantities],
            "matrix": found.correlation.tolist(),
        },
        "profile": {
            "iop_mmhg": found.profile_mmhg.tolist(),
            "standard_deviations": found.profile_root.tolist(),
        },
        "data": {
            "values": found.seen.values.tolist(),
            "fitted": found.fitted.tolist(),
            "deviations": found.deviations.tolist(),
            "parts": [str(part) for part in found.seen.groups],
        },
        "carried": [_finite(asdict(share)) for share in found.shares],
        "costs": [_finite(asdict(cost)) for cost in found.costs],
        "rung": found.rung,
        "fine_runs": found.rounds,
        "cheap_runs": found.runs,
        "seconds": found.seconds,
        "warnings": list(found.warnings),
        "notes": list(found.notes),
    }


def agreement(found: Sequence[Estimate | SceneError], rows: Sequence[Row]) -> Agreement | None:
    """Estimates of a table's rows beside the pressures that it has; None where it has none, or fewer than three."""
    against = next((name for name in AGAINST if any(name in row.beside for row in rows)), None)
    pairs = [
        (one[IOP], row.beside[against])
        for one, row in zip(found, rows)
        if isinstance(one, Estimate) and against in row.beside
    ]
    return None if len(pairs) < 3 else agreement_of(against, pairs)


def agreement_of(against: str, pairs: Sequence[tuple[Quantity, float]]) -> Agreement:
    """Of pairs of an estimate and a reference."""
    estimates, reference = np.array([q.value for q, _ in pairs]), np.array([value for _, value in pairs])
    off = estimates - reference
    bias, deviation = float(off.mean()), float(off.std(ddof=1))
    slope = float(np.polyfit(reference, estimates, 1)[0]) if np.ptp(reference) > 0.0 else math.nan
    inside = np.mean([q.range95[0] <= value <= q.range95[1] for q, value in pairs])
    limits = bias - SD_95 * deviation, bias + SD_95 * deviation
    return Agreement(against, len(pairs), bias, deviation, slope, limits, float(inside))


def agreement_lines(found: Agreement) -> list[str]:
    """The agreement beside what clinics live with."""
    return [
        f"IOP less {found.against} over {found.eyes} eyes: bias {found.bias:+.2f}, SD {found.deviation:.2f} mmHg, "
        f"slope {found.slope:.2f}, 95 % limits of agreement {found.limits[0]:+.1f} to {found.limits[1]:+.1f}; in the "
        f"95 % intervals {100.0 * found.inside:.0f} %",
        "clinics live with: bIOP less Goldmann 3.0 +- 2.6, DCT less Goldmann 2.1 +- 2.2, limits of air-puff IOP +-4.8 "
        "mmHg",
    ]


def table_lines(found: Sequence[Estimate | SceneError], rows: Sequence[Row]) -> list[str]:
    """One line a row."""
    body = [["row", "IOP, mmHg", "95 %", "chi^2", "beside", ""]]
    for one, row in zip(found, rows):
        beside = " ".join(f"{name} {value:.4g}" for name, value in row.beside.items() if name in AGAINST)
        if isinstance(one, Estimate):
            iop = one[IOP]
            cells = [f"{iop.value:.1f} +- {iop.deviation:.2g}", _range(iop.range95), f"{one.chi2:.1f}/{one.degrees}"]
            body.append([row.label, *cells, beside, "; ".join(one.warnings[:1])])
        else:
            body.append([row.label, "refused", "", "", beside, str(one)])
    return _columns(body)


def _named(name: str) -> str:
    unit = UNKNOWNS[name].unit
    return f"{name} ({UNKNOWNS[name].what}{', ' + unit if unit else ', a factor'})"


def _range(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}"


def _columns(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths)).rstrip() for row in rows]


def _quantity(quantity: Quantity) -> dict:
    return {
        "unit": quantity.unit,
        "value": quantity.value,
        "standard_deviation": quantity.deviation,
        "range68": list(quantity.range68),
        "range95": list(quantity.range95),
        "known_before": None if quantity.before is None else [quantity.before.value, quantity.before.deviation],
    }


def _finite(values: dict) -> dict:
    return {n: None if isinstance(value, float) and not math.isfinite(value) else value for n, value in values.items()}
