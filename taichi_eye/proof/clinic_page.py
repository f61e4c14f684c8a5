"""The clinic's study as a clinician reads it: sentences, tables, one picture, a page and JSON.

`words` says in plain sentences what holds and what does not; `tables` gives (head, rows, numbers of the rows that do
not hold) by title, for the terminal and the page alike; `draw` shows levels with the norms, slopes measured beside
computed, and the 194 eyes by bIOP; `write` makes clinic.html and clinic.png; `as_json` holds the figures unrounded.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS, POPULATIONS
from taichi_eye.analysis.response import READ_AS, SHOWN_IOP
from taichi_eye.proof import clinic
from taichi_eye.proof.dcr import FACTOR, PER_10_UM, PER_MMHG, SHOWN, Slope, Study
from taichi_eye.proof.population import SimulatedEye
from taichi_eye.provenance import png_metadata
from taichi_eye.report.folder import replacing
from taichi_eye.report.page import COLOURS, picture, plain, table, write_page

MEASURED, COMPUTED, MISSED, OTHER = "#4c5560", COLOURS[0], COLOURS[1], "#a6adb5"
SOURCES = (
    *(f"{population.name}: {population.source}." for population in POPULATIONS.values()),
    "Slopes: over the 194 eyes, of what was measured on IOPnct, thickness and age; +- is the standard error. A1 time: "
    "by the bIOP formula's inverse, per mmHg of the eye's own pressure.",
    "Pressures: IOPnct = {:g} + (A1 time - {:g})/{:g}; bIOP = 19.98 + 0.885 IOPnct - 0.0306 CCT (um) - 0.0438 age, a "
    "fit to what the instrument showed on the 194 eyes (open data, R2 .98), here at {:g} years.".format(
        *SHOWN_IOP, ELDERLY_AGE_YEARS
    ),
    "Donor corneas: PMC7415307. Stiffened donor sclerae: PMC7044755.",
    "Keratoconus: Tian et al. 2014, J Ophthalmol 147516.",
)


def words(study: Study) -> list[str]:
    """What the study found, in sentences."""
    own, thickness = study.own.response, study.own.thickness_um
    if study.own.stopped:
        return [f"{study.name}: the run was stopped ({study.own.stopped}); only what belongs to A1 is shown of it."]
    shown = f"{study.name}, an eye of {study.own.iop_mmhg:g} mmHg and {thickness:.0f} um"
    if own.biop_mmhg is None:
        return [f"{shown}, does not applanate: the instrument would show no pressure."]
    judged = [level for level in study.levels if level.holds is not None]
    lines = [
        f"{shown}, would show IOPnct {own.iop_nct_mmhg:.1f} and bIOP {own.biop_mmhg:.1f} mmHg.",
        f"Levels: {sum(level.holds for level in judged)} of {len(judged)} within one standard deviation"
        + _but([SHOWN[level.name].split(",")[0] for level in judged if not level.holds]),
    ]
    for unit, meaning in ((PER_MMHG, ""), (PER_10_UM, " of thickness at equal A1 time")):
        here = [slope for slope in study.slopes if slope.unit == unit]
        signs = sum(slope.verdict != "NO" for slope in here)
        lines.append(
            f"Slopes {unit}{meaning}: {sum(slope.verdict == 'yes' for slope in here)} of {len(here)} hold, {signs} "
            "have the sign or the zero" + _but([SHOWN[s.name].split(",")[0] for s in here if s.verdict != "yes"])
        )
    if stopped := [eye for eye in study.population if eye.stopped]:
        which = ", ".join(f"{eye.iop_mmhg:g} mmHg {eye.thickness_um:.0f} um" for eye in stopped)
        lines.append(
            f"Slopes are those of {len(study.population) - len(stopped)} of {len(study.population)} simulated eyes: "
            f"the others were stopped ({which}: {stopped[0].stopped})."
        )
    shown = [eye for eye in study.line if not eye.stopped and eye.response.biop_mmhg is not None]
    least, most = shown[0], shown[-1]
    lines.append(
        f"By bIOP: simulated eyes of {least.iop_mmhg:g} to {most.iop_mmhg:g} mmHg show bIOP "
        f"{least.response.biop_mmhg:.1f} to {most.response.biop_mmhg:.1f}."
    )
    return lines


def _but(names: list[str]) -> str:
    return f"; not {', '.join(names)}." if names else "."


def tables(study: Study) -> dict[str, tuple[list[str], list[list[str]], list[int]]]:
    """Every table by title: head, rows, and which rows do not hold."""
    return {
        "Levels beside the norms (z)": _levels(study),
        f"Slopes over {len(study.population)} simulated eyes, beside those over 194 living eyes": _slopes(study),
        "By bIOP: 194 elderly eyes, computed beside the group means": _groups(study),
        "Donor corneas inflated from 10 to 30 mmHg without a puff, apex rise": _donors(study),
        "A globe 30 % stiffer": _stiffened(study),
        **({"Keratoconus: this eye beside the healthy one": _diseased(study)} if study.diseased else {}),
        "The same eyes read over other zones": _zones(study),
        "Velocities as differences over +- so many frames": _speeds(study),
        "One switch at a time set back": _switches(study),
        "The simulated eyes": _eyes(study),
    }


def _levels(study: Study):
    body, stated = [], any(level.numerical_error is not None for level in study.levels)
    for level in study.levels:
        cells = []
        for name in POPULATIONS:
            mean, deviation, z = level.norms.get(name, (None, None, None))
            shown = "" if z is None else f" ({z:+.1f})"
            cells.append("" if mean is None else f"{mean:g} +- {deviation:g}{shown}")
        judge = "" if level.judge is None else POPULATIONS[level.judge].name
        error = [_error(level.numerical_error)] if stated else []
        body.append([SHOWN[level.name], _cell(level.value), *error, *cells, judge, _yes(level.holds)])
    error = ["numerical error"] if stated else []
    head = ["parameter", "computed", *error, *(p.name for p in POPULATIONS.values()), "judged by", "within 1 SD"]
    return head, body, [k for k, level in enumerate(study.levels) if level.holds is False]


def _slopes(study: Study):
    body = []
    for slope in study.slopes:
        error = "" if slope.error is None else f" +- {slope.error:g}"
        ratio = "zero" if slope.measured_zero else f"{slope.ratio:.2f}"
        body.append(
            [
                SHOWN[slope.name],
                slope.unit,
                f"{slope.computed:+.4f}",
                f"{slope.measured:+g}{error}",
                ratio,
                slope.verdict,
            ]
        )
    head = ["parameter", "", "computed", "measured", "ratio", f"within {FACTOR:g}, or 2 SE of a zero"]
    return head, body, [k for k, slope in enumerate(study.slopes) if slope.verdict != "yes"]


def _groups(study: Study):
    body = [
        [
            SHOWN[row.name],
            *(f"{_cell(found)} ({mean:g})" for found, mean in zip(row.computed, row.measured)),
            f"{row.spread:g}",
            _yes(row.holds),
        ]
        for row in study.groups
    ]
    head = ["computed (measured)", *(f"{mmhg:g} mmHg" for mmhg in clinic.GROUPS_MMHG), "SD of eyes", "all within it"]
    return head, body, [k for k, row in enumerate(study.groups) if not row.holds]


def _donors(study: Study):
    row, (least, most) = study.donors, clinic.DONOR_NM_PER_MMHG
    head = ["", "computed, nm/mmHg", "whole sphere of the same tissue", "measured", "within"]
    found = ["no rest found" if rise is None else f"{rise:.0f}" for rise in (row.computed, row.free_sphere)]
    body = [["apex", *found, f"{least:g} to {most:g}", _yes(row.holds)]]
    return head, body, [] if row.holds else [0]


def _stiffened(study: Study):
    body = [
        [
            SHOWN[row.name],
            _cell(row.before),
            _cell(row.after),
            "the same within 5 %" if row.name == "sp_a1_mmhg_mm" else "less",
            _yes(row.holds),
        ]
        for row in study.stiffened
    ] or [["the globe of this scene does not yield", "", "", "", ""]]
    head = ["parameter", "computed", "with the stiffer globe", "expected", "holds"]
    return head, body, [k for k, row in enumerate(study.stiffened) if not row.holds]


def _diseased(study: Study):
    body = [
        [
            SHOWN.get(row.name, "CCT, um"),
            _cell(row.healthy),
            _cell(row.ill),
            f"{row.published_healthy:g}",
            f"{row.published_ill:g}",
            "-" if row.share is None else f"{row.share:.2f}",
            _yes(row.holds),
        ]
        for row in study.diseased
    ]
    head = ["", "healthy, computed", "this eye", "healthy, published", "keratoconus", "share", "sign holds"]
    return head, body, [k for k, row in enumerate(study.diseased) if not row.holds]


def _zones(study: Study):
    head = [
        "half width, mm",
        *(SHOWN[name] for name in study.zones[0].values),
        "A1 time per mmHg",
        "A1 velocity per mmHg",
    ]
    body = [
        [
            f"{row.zone_mm:g}",
            *(_cell(value) for value in row.values.values()),
            f"{row.a1_time_per_mmhg:+.4f} ({clinic.A1_TIME_PER_MMHG:g})",
            f"{row.a1_velocity_per_mmhg:+.4f} ({clinic.SLOPES['a1_velocity_m_s'][0][0]:g})",
        ]
        for row in study.zones
    ]
    return head, body, []


def _speeds(study: Study):
    body = [[f"{row.frames}", _cell(row.a1_velocity_m_s), _cell(row.a2_velocity_m_s)] for row in study.speeds]
    return ["frames", SHOWN["a1_velocity_m_s"], SHOWN["a2_velocity_m_s"]], body, []


def _switches(study: Study):
    body = [
        [
            ("without " if name != "scene" else "") + name,
            *(_cell(getattr(reading.response, field)) for field in SHOWN),
            reading.stopped,
        ]
        for name, reading in study.switches.items()
    ]
    return (
        ["", *SHOWN.values(), "stopped"],
        body,
        [k for k, reading in enumerate(study.switches.values()) if reading.stopped],
    )


def _eyes(study: Study):
    eyes = _all_eyes(study)
    body = [
        [
            f"{eye.iop_mmhg:g}",
            f"{eye.thickness_um:.0f}",
            _cell(eye.response.iop_nct_mmhg),
            _cell(eye.response.biop_mmhg),
            *(_cell(getattr(eye.response, name)) for name in SHOWN),
            eye.stopped,
        ]
        for eye in eyes
    ]
    head = ["IOP, mmHg", "thickness, um", "IOPnct", "bIOP", *SHOWN.values(), "stopped"]
    return head, body, [k for k, eye in enumerate(eyes) if eye.stopped]


def _all_eyes(study: Study) -> list[SimulatedEye]:
    """The population, and what the groups needed beyond it."""
    return study.population + [eye for eye in study.line if eye not in study.population]


def write(study: Study, folder: Path) -> Path:
    """clinic.png and clinic.html into the folder; the page's path."""
    canvas = draw(study)
    with replacing(folder / "clinic.png") as temporary:
        canvas.savefig(temporary, format="png", metadata=png_metadata())
    parts = [f"<p>{plain(line)}</p>" for line in words(study)] + [picture(canvas)]
    for title, (head, body, failed) in tables(study).items():
        parts += [f"<h2>{plain(title)}</h2>", table(head, body, failed)]
    read = [[SHOWN[name], text] for name, text in READ_AS.items() if name in SHOWN]
    parts += ["<h2>How each parameter is read</h2>", table(["parameter", "definition"], read)]
    parts.append("<h2>Sources</h2><ul>" + "".join(f"<li>{plain(source)}</li>" for source in SOURCES) + "</ul>")
    page = folder / "clinic.html"
    write_page(page, f"What a clinician would measure: {study.name}", parts, markdown=True)
    return page


def as_json(study: Study) -> dict:
    """All figures by parameter, null where there is none."""
    own = study.own
    return {
        "eye": {
            "scene": study.name,
            "iop_mmhg": own.iop_mmhg,
            "thickness_um": own.thickness_um,
            "iop_nct_mmhg": own.response.iop_nct_mmhg,
            "biop_mmhg": own.response.biop_mmhg,
            "stopped": own.stopped,
        },
        "levels": {
            level.name: {
                "computed": level.value,
                "numerical_error": level.numerical_error,
                "norms": {name: dict(zip(("mean", "sd", "z"), norm)) for name, norm in level.norms.items()},
                "judged_by": level.judge,
                "within_1_sd": level.holds,
            }
            for level in study.levels
        },
        "slopes": [
            {
                "parameter": slope.name,
                "unit": slope.unit,
                "computed": _finite(slope.computed),
                "measured": slope.measured,
                "standard_error": slope.error,
                "ratio": _finite(slope.ratio),
                "verdict": slope.verdict,
            }
            for slope in study.slopes
        ],
        "groups": {
            "biop_mmhg": list(clinic.GROUPS_MMHG),
            **{row.name: {**asdict(row), "holds": row.holds} for row in study.groups},
        },
        "donors": {
            "computed_nm_per_mmhg": study.donors.computed,
            "free_sphere_nm_per_mmhg": study.donors.free_sphere,
            "measured_nm_per_mmhg": list(clinic.DONOR_NM_PER_MMHG),
            "holds": study.donors.holds,
        },
        "stiffened_globe": {row.name: {**asdict(row), "holds": row.holds} for row in study.stiffened},
        "keratoconus": {row.name: {**asdict(row), "share": row.share, "holds": row.holds} for row in study.diseased},
        "zones": [
            {
                "half_width_mm": row.zone_mm,
                **row.values,
                "a1_time_per_mmhg": _finite(row.a1_time_per_mmhg),
                "a1_velocity_per_mmhg": _finite(row.a1_velocity_per_mmhg),
            }
            for row in study.zones
        ],
        "eyes": [
            {
                "iop_mmhg": eye.iop_mmhg,
                "thickness_um": eye.thickness_um,
                **{name: getattr(eye.response, name) for name in ("iop_nct_mmhg", "biop_mmhg", *SHOWN)},
                "stopped": eye.stopped,
            }
            for eye in _all_eyes(study)
        ],
        "speeds": [asdict(row) for row in study.speeds],
        "switches": {
            name: {**{field: getattr(reading.response, field) for field in SHOWN}, "stopped": reading.stopped}
            for name, reading in study.switches.items()
        },
    }


def draw(study: Study) -> Figure:
    """Levels, slopes and groups in one picture."""
    canvas = Figure(figsize=(13.0, 11.0), dpi=110, layout="constrained")
    rows = canvas.add_gridspec(2, 1, height_ratios=(1.75, 1.0))
    top = rows[0].subgridspec(1, 3, width_ratios=(1.25, 1.0, 1.0))
    levels, per_mmhg, per_10_um = (canvas.add_subplot(top[k]) for k in range(3))
    _draw_levels(levels, study)
    _draw_per_mmhg(per_mmhg, [slope for slope in study.slopes if slope.unit == PER_MMHG])
    _draw_per_10_um(per_10_um, study.slopes)
    bottom = rows[1].subgridspec(1, len(study.groups))
    for k, row in enumerate(study.groups):
        axes = canvas.add_subplot(bottom[k])
        _draw_group(axes, row, first=k == 0)
    own = study.own.response
    shown = "" if own.biop_mmhg is None else f"; shown IOPnct {own.iop_nct_mmhg:.1f}, bIOP {own.biop_mmhg:.1f} mmHg"
    canvas.suptitle(
        f"{study.name}: {study.own.iop_mmhg:g} mmHg, {study.own.thickness_um:.0f} \N{MICRO SIGN}m{shown}", fontsize=13
    )
    return canvas


def _rows(axes, labels: list[str]) -> None:
    axes.set_yticks(range(len(labels)), labels, fontsize=9)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="x", color="#e4e7ea", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _dot(axes, x: float, row: float, good: bool, reach: float, label: str | None = None) -> None:
    """The computed figure; an arrow with its number at the edge where it lies beyond the axis."""
    colour = COMPUTED if good else MISSED
    if not np.isfinite(x):
        axes.text(0.0, row, "not reached", color=MISSED, fontsize=8, va="center", ha="center")
    elif abs(x) > reach:
        side = float(np.sign(x))
        axes.plot(side * reach, row, ">" if side > 0 else "<", color=colour, markersize=8, label=label, clip_on=False)
        axes.text(
            side * 0.93 * reach, row - 0.28, f"{x:+.1f}", color=colour, fontsize=8, ha="right" if side > 0 else "left"
        )
    else:
        axes.plot(x, row, "o", color=colour, markersize=8, label=label, zorder=4)


def _draw_levels(axes, study: Study) -> None:
    judged = [level for level in study.levels if level.judge is not None]
    _rows(axes, [SHOWN[level.name] for level in judged])
    axes.axvspan(-1.0, 1.0, color="#dfe9f3", zorder=0, label="within 1 SD of the judging population")
    styles = dict(zip(POPULATIONS, ("D", "s", "^")))
    seen = set()
    for row, level in enumerate(judged):
        mean, deviation, z = level.norms[level.judge]
        for k, (name, (other, spread, _)) in enumerate(level.norms.items()):
            axes.errorbar(
                (other - mean) / deviation,
                row + 0.16 + 0.12 * k,
                xerr=spread / deviation,
                fmt=styles[name],
                color=MEASURED if name == level.judge else OTHER,
                markersize=4,
                linewidth=1.2,
                label=None if name in seen else f"{POPULATIONS[name].name}, mean and SD",
            )
            seen.add(name)
        _dot(axes, float("nan") if z is None else z, row - 0.08, bool(level.holds), 4.0)
    axes.set_xlim(-4.2, 4.2)
    axes.set_xlabel("standard deviations from the judging population (dark)")
    axes.set_title("Levels", loc="left", fontsize=11)
    axes.legend(fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.4, -0.09), ncols=2)


def _draw_per_mmhg(axes, slopes: list[Slope]) -> None:
    _rows(axes, [SHOWN[slope.name].split(",")[0] for slope in slopes])
    axes.axvspan(1.0 / FACTOR, FACTOR, color="#dfe9f3", zorder=0, label=f"within a factor {FACTOR:g}")
    axes.axvline(0.0, color=MEASURED, linewidth=0.8)
    for row, slope in enumerate(slopes):
        error = 0.0 if slope.error is None else 2.0 * slope.error / abs(slope.measured)
        axes.errorbar(
            1.0,
            row + 0.2,
            xerr=error,
            fmt="D",
            color=MEASURED,
            markersize=4,
            label="living eyes, 2 standard errors" if row == 0 else None,
        )
        _dot(axes, slope.ratio, row - 0.08, slope.verdict == "yes", 3.0)
    axes.set_xlim(-3.2, 3.2)
    axes.set_xlabel("slope over the measured one")
    axes.set_title("Slopes with pressure, per mmHg", loc="left", fontsize=11)
    axes.legend(fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.4, -0.09))


def _draw_per_10_um(axes, slopes: list[Slope]) -> None:
    """Slopes with thickness over the measured ones with pressure: how many mmHg 10 um are worth."""
    worth = {slope.name: slope.measured for slope in slopes if slope.unit == PER_MMHG}
    here = [slope for slope in slopes if slope.unit == PER_10_UM]
    _rows(axes, [SHOWN[slope.name].split(",")[0] for slope in here])
    axes.axvline(0.0, color=MEASURED, linewidth=0.8)
    for row, slope in enumerate(here):
        unit = worth[slope.name]
        error = 0.0 if slope.error is None else 2.0 * slope.error / abs(unit)
        axes.errorbar(slope.measured / unit, row + 0.2, xerr=error, fmt="D", color=MEASURED, markersize=4)
        _dot(axes, slope.computed / unit, row - 0.08, slope.verdict == "yes", 3.0)
    axes.set_xlim(-3.2, 3.2)
    axes.set_xlabel("mmHg worth of 10 \N{MICRO SIGN}m, at equal A1 time", fontsize=9)
    axes.set_title("Slopes with thickness", loc="left", fontsize=11)
    for label, colour in (("simulated, holds", COMPUTED), ("simulated, does not", MISSED)):
        axes.plot([], [], "o", color=colour, markersize=8, label=label)
    axes.legend(fontsize=7.5, frameon=False, loc="upper center", bbox_to_anchor=(0.4, -0.09), ncols=2)


def _draw_group(axes, row, first: bool) -> None:
    shown = [pair for pair in row.eyes if clinic.GROUPS_MMHG[0] - 3.0 <= pair[0] <= clinic.GROUPS_MMHG[-1] + 3.0]
    x, mean = np.array(clinic.GROUPS_MMHG), np.array(row.measured)
    axes.fill_between(x, mean - row.spread, mean + row.spread, color="#e4e7ea", linewidth=0, label="SD between eyes")
    axes.plot(x, mean, "D-", color=MEASURED, markersize=4, linewidth=1.0, label="194 elderly eyes")
    axes.plot(
        *(zip(*shown) if shown else ([], [])),
        "o-",
        color=COMPUTED if row.holds else MISSED,
        markersize=6,
        linewidth=1.4,
        label="simulated eyes",
    )
    axes.set_title(SHOWN[row.name], loc="left", fontsize=10)
    axes.set_xlabel("bIOP, mmHg")
    axes.set_xticks(x)
    axes.grid(color="#e4e7ea", linewidth=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if first:
        axes.legend(fontsize=7.5, frameon=False)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _error(value: float | None) -> str:
    return "-" if value is None else f"+- {value:.2g}"


def _yes(holds: bool | None) -> str:
    return "" if holds is None else "yes" if holds else "NO"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
