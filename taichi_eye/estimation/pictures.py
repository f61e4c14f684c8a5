"""fit.png (fit over data, residuals, profile), corner.png, fit.csv, and for a film its overlay with the fitted edge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from taichi_eye.analysis.curves import Curves
from taichi_eye.analysis.pictures import write_overlay
from taichi_eye.estimation.estimate import Estimate
from taichi_eye.estimation.fit import SD_68, SD_95
from taichi_eye.estimation.motion import cheap
from taichi_eye.estimation.observation import STATIONS_MM, FilmSurface, ParameterRow
from taichi_eye.estimation.unknowns import IOP, UNKNOWNS
from taichi_eye.provenance import png_metadata
from taichi_eye.report.folder import replacing, write_rows
from taichi_eye.report.page import COLOURS

INK, DATA, FIT, GREY = "#22262b", "#3d8b57", "#14539a", "#8b9099"


def write(found: Estimate, folder: Path) -> None:
    """All pictures of an estimate, and its table of data, fit and residuals."""
    for name, canvas in (("fit.png", draw_fit(found)), ("corner.png", draw_corner(found))):
        with replacing(folder / name) as temporary:
            canvas.savefig(temporary, format="png", facecolor="white", metadata=png_metadata())
    write_table(found, folder / "fit.csv")
    if found.film is not None:
        write_film(found, folder / "overlay.mp4")


def draw_fit(found: Estimate) -> Figure:
    """Fit over data and residuals on the left, the profile of the IOP on the right."""
    canvas = Figure(figsize=(12.0, 6.2), dpi=120, layout="constrained")
    grid = canvas.add_gridspec(2, 2, width_ratios=(2.2, 1.0), height_ratios=(2.0, 1.0))
    top, below, side = canvas.add_subplot(grid[0, 0]), canvas.add_subplot(grid[1, 0]), canvas.add_subplot(grid[:, 1])
    seen, off = found.seen, (found.seen.values - found.fitted) / found.deviations
    if isinstance(seen, ParameterRow):
        place = np.arange(len(seen.values))
        share = seen.values / found.fitted
        error = found.deviations / np.abs(found.fitted)
        top.axhline(1.0, color=FIT, linewidth=1.6, label="fit")
        top.errorbar(place, share, error, fmt="o", color=DATA, label="measured, with its error and the model's")
        top.set_ylabel("measured over fitted")
        for axes in (top, below):
            axes.set_xticks(
                place,
                [name.rsplit("_", 1)[0] if len(name) > 18 else name for name in seen.names],
                rotation=30,
                ha="right",
                fontsize=7,
            )
        top.tick_params(labelbottom=False)
        below.bar(place, off, color=DATA)
    else:
        lines = (
            [(seen.x_mm == x, f"{x:g} mm from the axis") for x in STATIONS_MM]
            if isinstance(seen, FilmSurface)
            else [(slice(None), "")]
        )
        for number, (here, label) in enumerate(lines):
            colour = COLOURS[number % len(COLOURS)] if label else DATA
            top.plot(seen.time_ms[here], seen.values[here], ".", color=colour, markersize=4, label=label or "measured")
            top.plot(
                seen.time_ms[here],
                found.fitted[here],
                color=colour if label else FIT,
                linewidth=1.5,
                label="" if label else "fit",
            )
            below.plot(seen.time_ms[here], off[here], ".-", color=colour, markersize=3, linewidth=0.6)
        top.set_ylabel("inwards (mm); lines: fit" if isinstance(seen, FilmSurface) else "apex, inwards (mm)")
        below.set_xlabel("time (ms)")
    top.legend(frameon=False, fontsize=8)
    for level in (-2.0, 2.0):
        below.axhline(level, color=GREY, linewidth=0.7, linestyle=(0, (4, 3)))
    below.axhline(0.0, color=INK, linewidth=0.6)
    below.set_ylabel("residual over its\nstandard deviation")
    iop = found[IOP]
    between = np.linspace(found.profile_mmhg[0], found.profile_mmhg[-1], 201)
    side.plot(between, np.interp(between, found.profile_mmhg, found.profile_root) ** 2, color=FIT)
    side.plot(found.profile_mmhg, found.profile_root**2, "o", color=FIT, markersize=4)
    ends = side.get_xlim()
    for width, label in ((SD_68, "68 %"), (SD_95, "95 %")):
        side.axhline(width**2, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
        side.annotate(
            label, (iop.value, width**2), (0, 2), textcoords="offset points", ha="center", fontsize=8, color=GREY
        )
    for value in iop.range95:
        if ends[0] <= value <= ends[1]:
            side.axvline(value, color=COLOURS[1], linewidth=0.9)
    side.set_xlabel("IOP (mmHg)")
    side.set_ylabel("rise of the least sum of squares, all others let go")
    side.set_ylim(bottom=0.0)
    for axes in (top, below, side):
        axes.spines[["top", "right"]].set_visible(False)
    name = found.name.replace("$", r"\$")
    canvas.suptitle(
        f"{name}: IOP {iop.value:.2f} mmHg, 95 % {iop.range95[0]:.2f} to {iop.range95[1]:.2f}; "
        f"chi^2 {found.chi2:.0f} at {found.degrees}",
        fontsize=12,
    )
    return canvas


def draw_corner(found: Estimate) -> Figure:
    """Every pair of unknowns as ellipses of one and two standard deviations, each alone as its bell; dashed: what was
    known beforehand."""
    many = found.quantities
    count = len(many)
    canvas = Figure(figsize=(1.0 + 1.55 * count, 1.0 + 1.45 * count), dpi=110, layout="constrained")
    axes = canvas.subplots(count, count, squeeze=False)
    names = found.problem.before.names
    log_sd = dict(zip(names, np.sqrt(np.diag(found.solution.covariance))))
    value, width = np.array([q.value for q in many]), np.array([q.value * log_sd[q.name] for q in many])
    for i in range(count):
        for j in range(count):
            part = axes[i, j]
            if j > i:
                part.set_visible(False)
                continue
            part.set_xlim(value[j] - 3.2 * width[j], value[j] + 3.2 * width[j])
            if i == j:
                x = np.linspace(*part.get_xlim(), 121)
                part.fill_between(
                    x, np.exp(-0.5 * ((x - value[i]) / width[i]) ** 2), color=FIT, alpha=0.25, linewidth=0
                )
                if many[i].before is not None:
                    known = many[i].before
                    part.plot(
                        x,
                        np.exp(-0.5 * ((x - known.value) / known.deviation) ** 2),
                        color=INK,
                        linewidth=0.9,
                        linestyle=(0, (4, 3)),
                    )
                part.set_yticks([])
                part.set_title(f"{many[i].name}\n{value[i]:.3g} +- {width[i]:.2g}", fontsize=8)
            else:
                part.set_ylim(value[i] - 3.2 * width[i], value[i] + 3.2 * width[i])
                part.annotate(
                    f"{found.correlation[i, j]:+.2f}", (0.05, 0.88), xycoords="axes fraction", fontsize=7, color=INK
                )
                for number in (1.0, 2.0):
                    part.add_patch(
                        _ellipse((value[j], value[i]), (width[j], width[i]), found.correlation[i, j], number)
                    )
            part.tick_params(labelsize=6)
            if i < count - 1:
                part.set_xticklabels([])
            else:
                part.set_xlabel(_label(many[j].name), fontsize=7)
                part.tick_params(axis="x", rotation=45)
            if j > 0 or i == 0:
                part.set_yticklabels([])
            else:
                part.set_ylabel(_label(many[i].name), fontsize=7)
    return canvas


def _label(name: str) -> str:
    unit = UNKNOWNS[name].unit
    return name if unit in ("", *name.split("_")) or name.endswith(unit.lower()) else f"{name} ({unit})"


def _ellipse(centre, width, alike: float, number: float) -> Ellipse:
    covariance = np.outer(width, width) * np.array([[1.0, alike], [alike, 1.0]])
    values, vectors = np.linalg.eigh(covariance)
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    size = 2.0 * number * np.sqrt(np.maximum(values[::-1], 0.0))
    return Ellipse(centre, *size, angle=angle, facecolor=FIT, alpha=0.22, linewidth=0)


def write_table(found: Estimate, path: Path) -> None:
    """Data, fit and residuals, a row a value."""
    seen = found.seen
    head, columns = [], []
    if isinstance(seen, ParameterRow):
        head, columns = ["parameter"], [list(seen.names)]
    else:
        head, columns = ["time_ms"], [[f"{t:.6g}" for t in seen.time_ms]]
        if isinstance(seen, FilmSurface):
            head.append("x_mm")
            columns.append([f"{x:g}" for x in seen.x_mm])
    head += ["measured", "fitted", "standard_deviation"]
    columns += [[f"{value:.6g}" for value in values] for values in (seen.values, found.fitted, found.deviations)]
    write_rows(path, head, zip(*columns))


def fitted_rows(found: Estimate) -> np.ndarray:
    """Rows of the fitted eye's front in the film's frames, [frames, columns], NaN outside.

    The cheap model's curves at the frames' times, the recorded retreat of the whole eye in place of the model's, turned
    by the recorded tilt and put where the recorded eye lies.
    """
    film, curves, seen = found.film.film, found.film.curves, found.film.histories
    motion = cheap(found.scene, found.problem.rung)
    fitted: Curves = motion.curves
    own = motion.histories
    height = np.array([np.interp(film.time_ms, fitted.time_ms, column) for column in fitted.height_mm.T]).T
    back = np.interp(film.time_ms, seen.time_ms, seen.whole_eye_mm) - np.interp(
        film.time_ms, own.time_ms, own.whole_eye_mm
    )
    height = height - back[:, None]
    turn = np.deg2rad(curves.tilt_deg)
    columns = np.arange(film.frames.shape[2])
    across = (columns - curves.axis_column_px) * film.instrument.pixel_x_mm
    out = np.empty((len(height), len(columns)))
    for k, one in enumerate(height):
        x, z = fitted.x_mm * np.cos(turn) - one * np.sin(turn), one * np.cos(turn) + fitted.x_mm * np.sin(turn)
        good = np.isfinite(z)
        place = np.interp(across, x[good], z[good], left=np.nan, right=np.nan)
        out[k] = curves.apex_row_px - place / film.instrument.pixel_y_mm
    return out


def write_film(found: Estimate, path: Path) -> None:
    """The recorded film with the recorded edge (blue) and the fitted eye's (orange) drawn over it."""
    result = found.film
    columns = np.arange(result.film.frames.shape[2])
    edges = replace(result.edges, posterior=fitted_rows(found), posterior_column=columns)
    write_overlay(
        path, result.film.frames, result.film.time_ms, edges, result.curves, result.histories, result.response
    )
