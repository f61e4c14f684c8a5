"""apex.png and sheet.png, drawn without a display and without pyplot's global state."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from taichi_eye.provenance import png_metadata
from taichi_eye.report.compare import Measured
from taichi_eye.report.folder import replacing
from taichi_eye.report.history import History, summarise

INK, APEX, LOAD, MEASURED = "#22262b", "#14539a", "#c9641a", "#3d8b57"
MOVED_MM = 1e-3  # below it the eye counts as at rest, without peak and half heights
MARGIN_PX, CAPTION_PX, FRAME_WIDTH_MAX_PX = 14, 36, 800


class Band(Protocol):
    """A history with its error (`taichi_eye.analysis.error_bar.ErrorBar`): arrays [samples]."""

    time_ms: np.ndarray
    apex_mm: np.ndarray
    band_mm: np.ndarray


def plot_apex(
    path: Path, traces: Mapping[str, np.ndarray], measured: Measured | None = None, bar: Band | None = None
) -> None:
    """`draw_apex` as a PNG."""
    _save(draw_apex(traces, measured, bar), path)


def draw_apex(traces: Mapping[str, np.ndarray], measured: Measured | None = None, bar: Band | None = None) -> Figure:
    """The apex history with the load over it, after fig. 2 of Montanino, Angelillo and Pandolfi.

    traces: time_ms, apex_displacement_mm and puff_apex_kpa, shape [samples]; bar: the numerical error as a band. The
    two scales put both peaks at the same height, so that lag and asymmetry show; the numbers written in are those of
    `summarise`.
    """
    time, apex, load = (np.asarray(traces[name]) for name in ("time_ms", "apex_displacement_mm", "puff_apex_kpa"))
    here, push = summarise(time, apex), summarise(time, load)
    figure = Figure(figsize=(9.0, 5.4), dpi=150, layout="constrained")
    axes = figure.subplots()
    twin = axes.twinx()
    axes.set_zorder(twin.get_zorder() + 1)
    axes.patch.set_visible(False)

    twin.fill_between(time, load, color=LOAD, alpha=0.10, linewidth=0)
    lines = [twin.plot(time, load, color=LOAD, linewidth=1.4, dashes=(5, 2), label="air puff at the apex")[0]]
    lines.insert(
        0,
        axes.plot(time, apex, color=APEX, linewidth=2.2 if bar is None else 1.0, label="apex displacement computed")[0],
    )
    if bar is not None:
        widest = 1e3 * float(np.max(bar.band_mm))
        low, high = np.asarray(bar.apex_mm) - bar.band_mm, np.asarray(bar.apex_mm) + bar.band_mm
        said = f"numerical error, at most {widest:.2g} \N{MICRO SIGN}m"
        lines.append(axes.fill_between(bar.time_ms, low, high, color=APEX, alpha=0.30, linewidth=0, label=said))
    tallest = max(here.peak, MOVED_MM)
    if measured is not None:
        what = "deflection" if measured.column == "deflection_mm" else "apex displacement"
        lines += axes.plot(
            measured.time_ms,
            measured.displacement_mm,
            color=MEASURED,
            linewidth=1.2,
            marker="o",
            markersize=2.6,
            label=f"{what} measured ({_plain(measured.name)})",
        )
        tallest = max(tallest, measured.displacement_mm.max())
        axes.text(
            0.985,
            0.80,
            _describe(measured),
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=10,
            color=MEASURED,
        )
    span = float(time[0]), float(time[-1])
    _annotate(axes, here, push, span, tallest)

    low, high = min(-0.05 * tallest, 1.1 * apex.min()), 1.22 * tallest
    axes.set_ylim(low, high)
    per_mm = (push.peak if push.peak > 0 else 1.0) / max(here.peak, MOVED_MM)
    twin.set_ylim(low * per_mm, high * per_mm)
    axes.set_xlim(span[0], max(span[1], span[0] + 1e-6))
    axes.set_xlabel("time (ms)")
    axes.set_ylabel("apex displacement, inward (mm)", color=APEX)
    twin.set_ylabel("air pressure at the apex (kPa)", color=LOAD)
    axes.tick_params(axis="y", colors=APEX)
    twin.tick_params(axis="y", colors=LOAD)
    axes.axhline(0.0, color=INK, linewidth=0.7)
    for each in (axes, twin):
        each.spines["top"].set_visible(False)
    figure.legend(handles=lines, loc="outside upper center", ncols=len(lines), frameon=False, fontsize=9.5)
    return figure


def _annotate(axes: Axes, here: History, push: History, span: tuple[float, float], tallest: float) -> None:
    """Mark the peak, the half-height times and the delay of the peak behind the load's.

    span: of the time axis; tallest: of what is drawn [mm].
    """

    def say(text: str, at: tuple[float, float], offset: tuple[float, float], ha: str, va: str) -> None:
        axes.annotate(text, at, offset, textcoords="offset points", ha=ha, va=va, fontsize=10, color=INK)

    if here.peak < MOVED_MM:
        say(
            f"largest displacement inwards {1000 * max(here.peak, 0.0):.3g} \N{MICRO SIGN}m",
            (0.5 * sum(span), max(here.peak, 0.0)),
            (0, 13),
            "center",
            "bottom",
        )
        return
    place = (here.peak_time_ms - span[0]) / max(span[1] - span[0], 1e-6)
    ha = "left" if place < 0.2 else "right" if place > 0.8 else "center"
    turned = here.peak_time_ms < span[1]
    text = f"{'peak' if turned else 'so far'} {here.peak:.3f} mm at {here.peak_time_ms:.2f} ms"
    if turned and 0 < push.peak and push.peak_time_ms < span[1]:
        delay = here.peak_time_ms - push.peak_time_ms
        text += f"\n{abs(delay):.2f} ms {'after' if delay >= 0 else 'before'} the peak of the puff"
    axes.plot(
        here.peak_time_ms, here.peak, "o", color=APEX, markersize=5.5, markeredgecolor="white", zorder=5, clip_on=False
    )
    if tallest > here.peak:
        axes.plot([here.peak_time_ms] * 2, [here.peak, 1.03 * tallest], color=APEX, linewidth=0.9, linestyle=":")
    say(text, (here.peak_time_ms, tallest), ({"left": 6, "center": 0, "right": -6}[ha], 13), ha, "bottom")
    if not turned:
        return
    half = 0.5 * here.peak
    for time, side, shift in ((here.half_rise_ms, "left", 6), (here.half_fall_ms, "right", -6)):
        if time is None:
            continue
        axes.plot([time, time], [0, half], color=APEX, linewidth=0.9, linestyle=":")
        axes.plot(time, half, "o", color="white", markeredgecolor=APEX, markersize=5.5, zorder=5)
        say(f"50 % at\n{time:.2f} ms", (time, 0.0), (shift, 8), side, "bottom")
    if here.fwhm_ms is not None:
        axes.annotate(
            "",
            (here.half_rise_ms, half),
            (here.half_fall_ms, half),
            zorder=4,
            arrowprops={"arrowstyle": "<->", "color": APEX, "linewidth": 0.9, "shrinkA": 5, "shrinkB": 5},
        )
        middle = 0.5 * (here.half_rise_ms + here.half_fall_ms)
        axes.annotate(
            f"width {here.fwhm_ms:.2f} ms\nfall : rise {here.fall_to_rise:.2f}",
            (middle, half),
            (0, -5),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=10,
            color=INK,
        )


def _describe(measured: Measured) -> str:
    """Peak and half-height times of a measured history in two lines."""
    there = summarise(measured.time_ms, measured.displacement_mm)
    halves = [f"{time:.2f}" for time in (there.half_rise_ms, there.half_fall_ms) if time is not None]
    text = f"measured: peak {there.peak:.3f} mm at {there.peak_time_ms:.2f} ms"
    return text + (f"\n50 % at {' and '.join(halves)} ms" if halves else "")


def _plain(name: str) -> str:
    """A file name for a legend: short, and with its dollar signs not read as mathematics."""
    return (name if len(name) <= 32 else name[:29] + "...").replace("$", r"\$")


def sheet_times(history: History, end_ms: float) -> list[float]:
    """Six times for the sheet: rest, half risen, midway from there to the peak, the peak, half fallen, the end.

    history: of the apex. Evenly spaced times where it has no half heights.
    """
    rise, top, fall = history.half_rise_ms, history.peak_time_ms, history.half_fall_ms
    if rise is None or fall is None:
        return [end_ms * i / 5 for i in range(6)]
    return [0.0, rise, 0.5 * (rise + top), top, fall, end_ms]


def plot_sheet(path: Path, frames: Sequence[tuple[float, np.ndarray]]) -> None:
    """Six frames of the film in a grid with their times, after fig. 3 of Montanino, Angelillo and Pandolfi, as a PNG.

    frames: (time_ms, image) in the order of reading; images uint8 of one shape, [rows, columns] in grey or
    [rows, columns, 3]. Shown pixel by pixel up to 800 px of width; two columns where they are wide, else three.
    """
    rows, columns = frames[0][1].shape[:2]
    across = 2 if columns > 2 * rows else 3
    down = -(-len(frames) // across)
    scale = min(1.0, FRAME_WIDTH_MAX_PX / columns)
    width, height = round(columns * scale), round(rows * scale)
    total_width = across * width + (across + 1) * MARGIN_PX
    total_height = down * (height + CAPTION_PX) + MARGIN_PX
    figure = Figure(figsize=(total_width / 100, total_height / 100), dpi=100)
    for index, (time_ms, image) in enumerate(frames):
        row, column = divmod(index, across)
        left = MARGIN_PX + column * (width + MARGIN_PX)
        bottom = total_height - (row + 1) * (height + CAPTION_PX)
        picture = Image.fromarray(np.ascontiguousarray(image)).convert("RGB")
        if scale < 1.0:
            picture = picture.resize((width, height), Image.Resampling.LANCZOS)
        figure.figimage(np.asarray(picture), left, bottom, origin="upper")
        for text, shift, weight in (("abcdefghijkl"[index], 0, "bold"), (f"{time_ms:.2f} ms", 16, "normal")):
            figure.text(
                (left + shift) / total_width,
                (bottom + height + 5) / total_height,
                text,
                color=INK,
                fontsize=11,
                fontweight=weight,
                va="bottom",
            )
    _save(figure, path)


def png_of(figure: Figure) -> bytes:
    """A figure as a PNG, the same bytes on every run."""
    data = io.BytesIO()
    figure.savefig(data, format="png", facecolor="white", metadata=png_metadata())
    return data.getvalue()


def _save(figure: Figure, path: Path) -> None:
    with replacing(path) as temporary:
        temporary.write_bytes(png_of(figure))
