"""The overlay film, with the edges drawn into the frames, and the page of plots."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_eye.analysis.curves import Curves
from taichi_eye.analysis.edges import Edges
from taichi_eye.analysis.response import Histories, Response
from taichi_eye.film import FilmWriter
from taichi_eye.film.glyphs import glyph_atlas, stamp

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANTERIOR, POSTERIOR, AXIS = (80, 220, 255), (255, 176, 60), (110, 110, 130)
SCALE = 2
BRIGHTEN = 1.8
INK, BLUE, ORANGE, GREEN, GREY = "#22262b", "#14539a", "#c9641a", "#3d8b57", "#8b9099"
FPS = 25


def write_overlay(
    path: Path,
    frames: np.ndarray,
    time_ms: np.ndarray,
    edges: Edges,
    curves: Curves,
    history: Histories,
    response: Response,
) -> None:
    """The film at twice its size and brightened, with both edges, the axis, the time and the phase of the test."""
    atlas = glyph_atlas(13)
    columns = SCALE * frames.shape[2]
    at = np.arange(columns) / SCALE - 0.25
    events = [
        (response.a1_time_ms, "first applanation"),
        (response.hc_time_ms, "highest concavity"),
        (response.a2_time_ms, "second applanation"),
    ]
    step = float(np.median(np.diff(time_ms))) if len(time_ms) > 1 else 0.2315
    with FilmWriter(path, FPS) as film:
        for k, frame in enumerate(frames):
            grey = np.minimum(np.repeat(np.repeat(frame, SCALE, 0), SCALE, 1) * BRIGHTEN, 255)
            image = np.repeat(grey.astype(np.uint8)[:, :, None], 3, axis=2)
            axis = round(SCALE * curves.axis_column_px)
            if 0 <= axis < columns:
                image[::12, axis] = AXIS
                image[1::12, axis] = AXIS
            for place, row, colour in (
                (np.arange(frames.shape[2]), edges.anterior[k], ANTERIOR),
                (edges.posterior_column, edges.posterior[k], POSTERIOR),
            ):
                _draw(image, at, np.interp(at, place, row, left=np.nan, right=np.nan), colour)
            same = np.flatnonzero(np.abs(history.time_ms - time_ms[k]) < 1e-9)
            apex = (
                f"apex {history.apex_mm[same[0]]:.3f} mm" if len(same) and np.isfinite(history.apex_mm[same[0]]) else ""
            )
            phase = next(
                (text for when, text in events if when is not None and abs(when - time_ms[k]) <= 0.51 * step), ""
            )
            for number, text in enumerate((f"{time_ms[k]:.2f} ms", apex, phase)):
                if text:
                    stamp(image, atlas.mask(text), 8 + 18 * number, 10, (235, 235, 235))
            film.write(image)


def _draw(image: np.ndarray, at: np.ndarray, row: np.ndarray, colour: tuple[int, int, int]) -> None:
    """A line one source pixel high along `row` (source rows) at every image column."""
    good = np.flatnonzero(np.isfinite(row))
    place = SCALE * (row[good] + 0.5) - 0.5
    for shift in (0, 1):
        r = np.floor(place).astype(int) + shift
        weight = (1.0 - np.abs(place - r)) * 0.9
        inside = (r >= 0) & (r < image.shape[0])
        cell = image[r[inside], good[inside]].astype(float)
        mixed = cell + weight[inside, None] * (np.array(colour) - cell)
        image[r[inside], good[inside]] = np.rint(mixed).astype(np.uint8)


def draw_page(
    name: str, curves: Curves, history: Histories, response: Response, truth: Histories | None = None
) -> Figure:
    """Deformation and deflection, velocity, curvature, thickness, curves at the events, and the deflection map."""
    from matplotlib.figure import Figure  # slow to load

    figure = Figure(figsize=(12.5, 10.5), dpi=110, layout="constrained")
    axes = figure.subplots(3, 2)
    time = history.time_ms
    events = [
        (text, when)
        for text, when in (("A1", response.a1_time_ms), ("HC", response.hc_time_ms), ("A2", response.a2_time_ms))
        if when is not None
    ]
    top = axes[0, 0]
    top.plot(time, history.apex_mm, color=BLUE, linewidth=1.8, label="apex deformation")
    top.plot(
        time,
        history.apex_mm - history.whole_eye_mm,
        color=ORANGE,
        linewidth=1.4,
        linestyle="--",
        label="apex deflection",
    )
    top.plot(time, history.whole_eye_mm, color=GREEN, linewidth=1.2, linestyle="-.", label="whole-eye movement")
    if truth is not None:
        top.plot(truth.time_ms, truth.apex_mm, color=INK, linewidth=0.8, linestyle=":", label="computed apex")
    top.set_ylabel("mm, inwards")
    top.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)

    speed = axes[0, 1]
    speed.plot(time, history.velocity_m_s, color=BLUE, linewidth=1.6)
    speed.set_ylabel("apex velocity, inwards (m/s)")

    bend = axes[1, 0]
    bend.plot(time, history.curvature_per_mm, color=BLUE, linewidth=1.6)
    bend.set_ylabel("curvature of the central 2 mm (1/mm)")
    if truth is not None:
        bend.plot(truth.time_ms, truth.curvature_per_mm, color=INK, linewidth=0.8, linestyle=":")
        speed.plot(truth.time_ms, truth.velocity_m_s, color=INK, linewidth=0.8, linestyle=":")

    thick = axes[1, 1]
    if curves.thickness_mm is not None and np.isfinite(curves.thickness_mm).any():
        thick.plot(time, 1e3 * curves.thickness_mm, ".", color=BLUE, markersize=4)
        middle = 1e3 * np.nanmedian(curves.thickness_mm)
        thick.set_ylim(middle - 60, middle + 60)
    thick.set_ylabel("central thickness (\N{MICRO SIGN}m)")

    for axis in (top, speed, bend, thick):
        axis.axhline(0.0, color=GREY, linewidth=0.6)
        axis.set_xlim(time[0], time[-1])
        axis.set_xlabel("time (ms)")
        for text, when in events:
            axis.axvline(when, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
            axis.annotate(
                text,
                (when, 1.0),
                (3, -2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="top",
                fontsize=8,
                color=GREY,
            )

    shape = axes[2, 0]
    for text, when, colour in [("rest", time[0], GREY)] + [
        (t, w, c) for (t, w), c in zip(events, (ORANGE, BLUE, GREEN))
    ]:
        shape.plot(
            history.x_mm,
            history.height_mm[np.argmin(np.abs(time - when))],
            color=colour,
            linewidth=1.4,
            label=f"{text}, {when:.2f} ms",
        )
    shape.set_aspect("equal")
    shape.set_xlabel("x (mm)")
    shape.set_ylabel("height (mm)")
    shape.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.02), ncols=4)

    map_ = axes[2, 1]
    limit = max(float(np.nanmax(np.abs(history.deflection_mm))), 1e-3)
    mesh = map_.pcolormesh(
        time,
        history.x_mm,
        history.deflection_mm.T,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        shading="nearest",
        rasterized=True,
    )
    map_.set_xlabel("time (ms)")
    map_.set_ylabel("x (mm)")
    figure.colorbar(mesh, ax=map_, label="deflection (mm)")
    for axis in (top, speed, bend, thick, shape):
        axis.spines[["top", "right"]].set_visible(False)
    da = response.deformation_amplitude_mm
    figure.suptitle(
        name.replace("$", r"\$")
        + (f": deformation amplitude {da:.3f} mm" if da is not None else ": no deformation found"),
        fontsize=12,
    )
    return figure
