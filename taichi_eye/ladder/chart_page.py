"""A chart as a picture, a table and a page."""

import math
from pathlib import Path

from matplotlib.figure import Figure

from taichi_eye.ladder.chart import TOLERANCES, Chart
from taichi_eye.provenance import png_metadata
from taichi_eye.report.folder import replacing
from taichi_eye.report.page import COLOURS, picture, table, write_page

HEAD = (
    "setting",
    "nodes",
    "whole, s",
    "solver, s",
    "runs",
    "error, %",
    "peak, %",
    "50 % times, %",
    "history rms, %",
    "pressure, %",
    "mostly",
    "",
)
MARKS = {
    "membrane": ("^", COLOURS[3]),
    "cavity": ("s", COLOURS[1]),
    "added_mass": ("D", COLOURS[2]),
    "mfpm": ("o", COLOURS[0]),
}


def plot(chart: Chart) -> Figure:
    """Error against wall time, both logarithmic, with the front of what nothing beats."""
    canvas = Figure(figsize=(8.2, 5.4), dpi=120, layout="constrained")
    axes = canvas.subplots()
    front = chart.front()
    axes.plot(
        [chart.every[label].whole_s for label in front],
        [chart.error(label) for label in front],
        color="#9aa3ab",
        linewidth=6,
        alpha=0.45,
        solid_capstyle="round",
        label="nothing is faster and closer",
        zorder=1,
    )
    for rung, (mark, colour) in MARKS.items():
        for of_two in (False, True):
            labels = [
                label
                for label in chart.errors
                if chart.every[label].setting.fidelity == rung and (label not in chart.points) == of_two
            ]
            if labels:
                axes.plot(
                    [chart.every[label].whole_s for label in labels],
                    [chart.error(label) for label in labels],
                    mark,
                    color=colour,
                    markerfacecolor="white" if of_two else colour,
                    markersize=6,
                    label=f"{rung}, extrapolated" if of_two else rung,
                    zorder=3,
                )
    _lines(axes, chart)
    told: list[tuple[float, float]] = []
    for label in front:
        point, place = chart.every[label].setting, (chart.every[label].whole_s, chart.error(label))
        if any(abs(math.log10(place[0] / x)) < 0.25 and abs(math.log10(place[1] / y)) < 0.12 for x, y in told):
            continue  # it would be written over its neighbour
        told.append(place)
        words = f"h {point.spacing_mm:g}" + (f", c {point.sound_speed_m_s:g}" if point.sound_speed_m_s else "")
        axes.annotate(words, place, xytext=(6, 5), textcoords="offset points", fontsize=7.5, color="#4c5560")
    for tolerance in TOLERANCES:
        axes.axhline(tolerance, color="#d2d7db", linewidth=0.8, zorder=0)
    if chart.uncertainty:
        axes.axhspan(1e-9, chart.uncertainty, color="#eceff1", zorder=0)
        axes.text(
            0.01,
            chart.uncertainty,
            " below this the reference itself is uncertain",
            fontsize=7.5,
            color="#7a838b",
            va="bottom",
            transform=axes.get_yaxis_transform(),
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    low = min([chart.error(label) for label in chart.errors] + [chart.uncertainty or 1e9])
    axes.set_ylim(0.6 * max(low, 1e-3), None)
    axes.set(
        xlabel="wall time of a run: packing, set-up and solver, warm (s)",
        ylabel="largest error: peak, 50 % times, whole history (%)",
    )
    axes.grid(color="#eef0f2", linewidth=0.6, which="both")
    axes.legend(fontsize=8.5, frameon=False, loc="upper right")
    return canvas


def _lines(axes, chart):
    """Thin lines through points that differ in spacing alone."""
    groups: dict[tuple, list[str]] = {}
    for label in (label for label in chart.errors if label in chart.points):
        setting = chart.points[label].setting
        plain = not (
            setting.basis
            or setting.coupling
            or setting.cfl
            or setting.refresh_travel
            or setting.threads
            or setting.precision != "f64"
        )
        if plain:
            groups.setdefault((setting.fidelity, setting.sound_speed_m_s, setting.mean_sound_speed_m_s), []).append(
                label
            )
    for (rung, c, mean), labels in groups.items():
        labels.sort(key=lambda name: -chart.points[name].setting.spacing_mm)
        x, y = [chart.points[label].whole_s for label in labels], [chart.error(label) for label in labels]
        axes.plot(x, y, color=MARKS[rung][1], linewidth=0.8, alpha=0.6, zorder=2)
        if c:
            axes.annotate(
                f"c {c:g}" + (f"/{mean:g}" if mean else ""),
                (x[0], y[0]),
                xytext=(-8, 6),
                textcoords="offset points",
                fontsize=7.5,
                color=MARKS[rung][1],
                ha="right",
            )


def rows(chart: Chart) -> list[tuple]:
    """One row of the table per point, cheapest first."""
    shares, front = chart.shares(), set(chart.front())
    found = []
    for label, point in sorted(chart.every.items(), key=lambda item: item[1].whole_s):
        cells = [label, point.nodes, f"{point.whole_s:.3g}", f"{point.solver_s:.3g}", point.repeats]
        if label in chart.errors:
            error = chart.errors[label]
            cells += [
                f"{value:.2g}"
                for value in (chart.error(label), error.peak, error.half_times, error.rms, error.pressure)
            ]
        else:
            cells += ["", "", "", "", ""]
        mostly = max(shares[label].items(), key=lambda item: item[1]) if label in shares else None
        cells += [f"{mostly[0]} {mostly[1]:.2g}" if mostly else point.stopped, "front" if label in front else ""]
        found.append(tuple(cells))
    return found


def words(chart: Chart) -> list[str]:
    """What the chart says, in sentences."""
    said = []
    if chart.reference is None:
        said.append("No reference: the budget did not pay for one; raise --budget and resume.")
    else:
        said.append(
            f"Reference: mfpm extrapolated from h {chart.level[0]:g} mm, c {chart.level[1]:g} m/s"
            + (f"; the next coarser triple differs by {chart.uncertainty:.2g} %." if chart.uncertainty else ".")
        )
        for tolerance, label in chart.recommended().items():
            said.append(
                f"{tolerance:g} %: "
                + (
                    f"{label}, {chart.every[label].whole_s:.3g} s, {chart.error(label):.2g} % off"
                    if label
                    else "nothing here is that close"
                )
            )
    said += [f"{name}: {power:.2f}" for name, power in chart.exponents().items()]
    if chart.passed_over:
        said.append("Passed over (budget, or impossible here): " + "; ".join(chart.passed_over))
    return said


def write(chart: Chart, folder: Path, title: str) -> Path:
    """chart.png, chart.html; the page's path."""
    parts = ["".join(f"<p>{line}</p>" for line in words(chart))]
    if chart.errors:
        canvas = plot(chart)
        with replacing(folder / "chart.png") as temporary:
            canvas.savefig(temporary, metadata=png_metadata())
        parts.append(picture(canvas))
    parts.append(table(HEAD, rows(chart)))
    shares = chart.shares()
    names = ("model", "space", "sound speed", "time", "coupling")
    parts.append("<h2>Where the error comes from (% of the peak, worst instant)</h2>")
    parts.append(
        table(
            ("setting", *names),
            [
                (label, *(f"{share[name]:.2g}" if name in share else "" for name in names))
                for label, share in shares.items()
            ],
        )
    )
    page = folder / "chart.html"
    write_page(page, title, parts, markdown=True)
    return page
