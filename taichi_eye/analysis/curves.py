"""Corneal curves over time, from the edges of a film or from the membrane of a simulation, in one form.

Axes: x along the slit, 0 on the axis of the eye; heights up from the apex at rest; mm and ms. The axis of a film is the
line about which the displacement at the deepest frame is most symmetric: an eye off the centre of the frame needs no
visible pole for it. The slope of the resting surface on that axis is the tilt of the eye; the curves are turned back
by it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import atan, cos, degrees, sin

import numpy as np
from scipy.ndimage import correlate1d

from taichi_eye.analysis import optics
from taichi_eye.analysis.edges import Edges
from taichi_eye.analysis.following import following
from taichi_eye.analysis.posterior import ALONG_FRAMES
from taichi_eye.errors import FilmError

X_STEP_MM, X_REACH_MM = 0.02, 4.5
SMOOTH_MM = 0.62  # length of the cubic that smooths a curve
REFRACTING_MM = 1.0  # the same for the surface that light is bent at: its slope decides
REST_MS = 1.2  # frames that make up the resting shape
SYMMETRY_MM = 2.2  # reach of the symmetry that gives the axis
MOVED_MM = 0.05
FRAMES_MIN = 8
FOLLOWING_MIN = 0.65  # share of the frames that follow from their neighbours
FOUND_MIN = 0.4  # share of the columns with an edge, for a frame to count
COVERED_MAX_MM = 1.3  # of an edge that a frame may lack and still be bridged
BRIDGE_MM = 0.45  # seen on either side of a gap that it is bridged from, at least
CENTRAL_MM = 0.6  # half width of the zone of the central thickness


@dataclass(frozen=True)
class Instrument:
    """Scale and optics of the camera; the defaults are those of the Corvis ST (PMC4020874)."""

    pixel_x_mm: float = 0.015625
    pixel_y_mm: float = 0.0165
    frame_interval_ms: float = 0.2315
    angle_deg: float = 45.0
    refractive_index: float = 1.376


@dataclass(frozen=True)
class Curves:
    """The anterior surface over time.

    time_ms [frames], rising; x_mm [points]; height_mm [frames, points], NaN where not seen; thickness_mm [frames], the
    mean over the central 1.2 mm, and thickness_profile_mm [points] at rest, or None. axis_column_px, apex_row_px,
    tilt_deg: where the eye lies in the frame. hidden_mm [frames]: the widest part of a curve that was bridged, or None.
    notes: what a reader should know.
    """

    time_ms: np.ndarray
    x_mm: np.ndarray
    height_mm: np.ndarray
    thickness_mm: np.ndarray | None = None
    thickness_profile_mm: np.ndarray | None = None
    axis_column_px: float = 0.0
    apex_row_px: float = 0.0
    tilt_deg: float = 0.0
    hidden_mm: np.ndarray | None = None
    notes: tuple[str, ...] = field(default=())


def grid() -> np.ndarray:
    """The x of all curves [mm]."""
    count = round(X_REACH_MM / X_STEP_MM)
    return X_STEP_MM * np.arange(-count, count + 1)


def curves_from_wall(
    time_ms: np.ndarray, r_mm: np.ndarray, z_mm: np.ndarray, thickness_mm: float | None = None
) -> Curves:
    """Curves of an axisymmetric membrane: r_mm, z_mm [frames, nodes], apex first, at time_ms [frames]."""
    x = grid()
    height = _even_splines(np.asarray(r_mm, float), np.asarray(z_mm, float), np.abs(x))
    return Curves(
        np.asarray(time_ms, float),
        x,
        height - height[0, len(x) // 2],
        None if thickness_mm is None else np.full(len(height), float(thickness_mm)),
    )


def _even_splines(r: np.ndarray, z: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubic splines through the nodes of each row, flat at the first and "not-a-knot" at the last, at `at` >= 0; NaN
    beyond the last node.

    Rows are splined together, which takes a hundredth of the time; one whose nodes do not go outwards, by itself.
    """
    out = np.full((len(r), len(at)), np.nan)
    outwards = (np.diff(r, axis=1) > 1e-9).all(axis=1)
    for row in np.flatnonzero(~outwards):
        out[row] = _spline(r[row], z[row], at)
    if outwards.any():
        out[outwards] = _splined(r[outwards], z[outwards], at)
    return out


def _spline(r: np.ndarray, z: np.ndarray, at: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline  # slow to load

    keep = np.concatenate([[True], np.diff(np.maximum.accumulate(r)) > 1e-9])
    spline, last = CubicSpline(r[keep], z[keep], bc_type=((1, 0.0), "not-a-knot")), r[keep][-1]
    return np.where(at <= last, spline(np.minimum(at, last)), np.nan)


def _splined(r: np.ndarray, z: np.ndarray, at: np.ndarray) -> np.ndarray:
    """`_even_splines` of rows [rows, nodes] that go outwards: slopes by elimination over all rows at once."""
    step, rise = np.diff(r, axis=1), np.diff(z, axis=1)
    rate = rise / step
    # for the slopes at the nodes: lower, diagonal, upper and right hand side of a tridiagonal system
    lower, upper, right = (np.zeros_like(r) for _ in range(3))
    diagonal = np.ones_like(r)
    lower[:, 1:-1], upper[:, 1:-1] = step[:, 1:], step[:, :-1]
    diagonal[:, 1:-1] = 2.0 * (step[:, 1:] + step[:, :-1])
    right[:, 1:-1] = 3.0 * (step[:, 1:] * rate[:, :-1] + step[:, :-1] * rate[:, 1:])
    last, before = step[:, -1], step[:, -2]
    both = last + before
    lower[:, -1], diagonal[:, -1] = both, before
    right[:, -1] = (last**2 * rate[:, -2] + (2.0 * both + last) * before * rate[:, -1]) / both
    for k in range(1, r.shape[1]):
        share = lower[:, k] / diagonal[:, k - 1]
        diagonal[:, k] -= share * upper[:, k - 1]
        right[:, k] -= share * right[:, k - 1]
    slope = np.empty_like(r)
    slope[:, -1] = right[:, -1] / diagonal[:, -1]
    for k in range(r.shape[1] - 2, -1, -1):
        slope[:, k] = (right[:, k] - upper[:, k] * slope[:, k + 1]) / diagonal[:, k]
    # Hermite's form between the nodes on either side
    left = np.stack([np.searchsorted(one, at, side="right") for one in r]) - 1
    left = np.clip(left, 0, r.shape[1] - 2)
    row = np.arange(len(r))[:, None]
    width, here = step[row, left], z[row, left]
    u = np.minimum((at - r[row, left]) / width, 1.0)
    climb, first, second = rise[row, left], width * slope[row, left], width * slope[row, left + 1]
    found = here + u * (first + u * (3.0 * climb - 2.0 * first - second + u * (first + second - 2.0 * climb)))
    return np.where(at <= r[:, -1:], found, np.nan)


def curves_from_edges(edges: Edges, time_ms: np.ndarray, instrument: Instrument) -> Curves:
    """Curves of a film's edges at the frames' times [frames]; FilmError where there is no cornea to be measured."""
    seen = np.isfinite(edges.anterior)
    width = seen.shape[1]
    third = slice(width // 3, width - width // 3)
    good = seen.mean(axis=1) > FOUND_MIN
    if good.mean() < 0.5 or good.sum() < FRAMES_MIN:
        raise FilmError(f"no cornea: a corneal section was found in {good.sum()} of {len(good)} frames only")
    notes = []
    if not good.all():
        notes.append(f"{(~good).sum()} frames without a corneal section left out")
    time = np.asarray(time_ms, float)[good]
    x_px = np.arange(width) * instrument.pixel_x_mm
    height, hidden_mm, covered_mm = (
        np.stack(part) for part in zip(*(_bridged(x_px, -row * instrument.pixel_y_mm) for row in edges.anterior[good]))
    )
    open_enough = covered_mm <= COVERED_MAX_MM
    if open_enough.sum() < FRAMES_MIN:
        raise FilmError(f"too much of the cornea's edge is covered in {(~open_enough).sum()} of {len(good)} frames")
    if not open_enough.all():
        notes.append(f"{(~open_enough).sum()} frames left out: more than {COVERED_MAX_MM:g} mm of the edge is masked")
        time, height, hidden_mm = time[open_enough], height[open_enough], hidden_mm[open_enough]
        good[good] = open_enough
    steady = following(time, height)
    if steady.mean() < FOLLOWING_MIN or steady.sum() < FRAMES_MIN:
        raise FilmError(
            "no cornea, or frames out of order: the edge jumps from frame to frame, "
            f"{(~steady).sum()} of {len(steady)} times"
        )
    if not steady.all():
        notes.append(f"{(~steady).sum()} frames whose edge does not follow from their neighbours' left out")
    masked = ((~seen[good][:, third]).any(axis=1) & steady).sum()
    if masked:
        notes.append(
            f"a part of the edge is masked in {masked} frames (cut off, or a lash or a speck over it); bridged"
        )
    time, height, hidden_mm = time[steady], height[steady], hidden_mm[steady]
    good[good] = steady
    rest = time <= time[0] + REST_MS
    if time[0] > 3.0:
        notes.append(f"the first frame is at {time[0]:.2f} ms: displacements are from there, not from rest")
    base = _mean_rest(height, rest)
    end = time >= time[-1] - REST_MS
    if _bend(x_px, base) >= 0.0 > _bend(x_px, _mean_rest(height, end)):
        # the film starts in the dent: the eye's place is read from its end
        rest, base = end, _mean_rest(height, end)
    x = grid()
    centre = _axis(x_px, base - height)
    if centre is None:
        centre = _pole(x_px, base)
        notes.append("the cornea does not move; the axis is taken at the pole")
        slope, top, turned = _turned_about(x_px, height, base, centre, x)
    else:
        # displacements seen askew are a little lopsided: once more in the frame of the eye
        for _ in range(2):
            slope, top, turned = _turned_about(x_px, height, base, centre, x)
            centre += (_axis(x, _mean_rest(turned, rest) - turned) or 0.0) * cos(atan(slope))
        slope, top, turned = _turned_about(x_px, height, base, centre, x)
    turn = atan(slope)
    at_px = edges.posterior_column * instrument.pixel_x_mm
    apparent = -edges.posterior[good] * instrument.pixel_y_mm - top
    at = (at_px - centre) * cos(turn) + apparent * sin(turn)
    lifted = apparent * cos(turn) - (at_px - centre) * sin(turn)
    places = nanmean(at[rest])
    inside = np.isfinite(places) & (np.abs(places) < X_REACH_MM)
    thick, profile = None, None
    if inside.any():
        lifted = np.stack([_at_places(one_at[inside], one[inside], places[inside]) for one_at, one in zip(at, lifted)])
        anterior, lifted = _over_frames(x, _smooth_filled(turned), places[inside], lifted)
        local = optics.thickness(x, anterior, places[inside], lifted, instrument.angle_deg, instrument.refractive_index)
        central = np.abs(places[inside]) <= CENTRAL_MM
        thick = nanmean(local[:, central], 1)
        profile = np.interp(x, places[inside], nanmean(local[rest]), left=np.nan, right=np.nan)
    return Curves(
        time,
        x,
        turned,
        thick,
        profile,
        centre / instrument.pixel_x_mm,
        -top / instrument.pixel_y_mm,
        degrees(turn),
        hidden_mm,
        tuple(notes),
    )


def smooth(height: np.ndarray, over_mm: float = SMOOTH_MM) -> np.ndarray:
    """Curves smoothed along x by a moving cubic over so much; gaps stay gaps."""
    length = 2 * round(0.5 * over_mm / X_STEP_MM) + 1
    out = np.full_like(height, np.nan)
    seen = np.isfinite(height)
    for shape, alike in seen_alike(seen):
        good = np.flatnonzero(shape)
        if len(good) > length:
            between = np.arange(good[0], good[-1] + 1)
            part = height[np.ix_(alike, between)]
            if len(good) < len(between):
                part = np.stack([np.interp(between, good, one[good]) for one in height[alike]])
            out[np.ix_(alike, between)] = _moving_fit(part, length, 3)
    return out


def _moving_fit(values: np.ndarray, length: int, degree: int) -> np.ndarray:
    """Values along the last axis, each from a polynomial through so many around it (Savitzky and Golay)."""
    from scipy.signal import savgol_filter  # slow to load, and a run reads no film

    return savgol_filter(values, length, degree, axis=-1, mode="interp")


def seen_alike(seen: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The curves that are seen at the same places, which can be fitted together: of a bool [curves, points] each row
    that occurs, and the numbers of the curves that have it."""
    groups: dict[bytes, list[int]] = {}
    for number, row in enumerate(seen):
        groups.setdefault(row.tobytes(), []).append(number)
    return [(seen[numbers[0]], np.array(numbers)) for numbers in groups.values()]


def _turned_about(
    x: np.ndarray, height: np.ndarray, base: np.ndarray, centre: float, onto: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Slope and height of the resting surface at `centre`, and all curves turned upright about that point."""
    slope, top = _tangent(x, base, centre)
    return slope, top, np.stack([_turned(x - centre, one - top, atan(slope), onto) for one in height])


def _mean_rest(height: np.ndarray, rest: np.ndarray) -> np.ndarray:
    return nanmean(height[rest])


def nanmean(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """The mean of what is finite along an axis, NaN where nothing is."""
    good = np.isfinite(values)
    count = good.sum(axis)
    return np.where(count > 0, np.where(good, values, 0.0).sum(axis) / np.maximum(count, 1), np.nan)


def _smooth_filled(height: np.ndarray) -> np.ndarray:
    out = smooth(height, REFRACTING_MM)
    at = np.arange(height.shape[1])
    for k in range(len(out)):
        good = np.flatnonzero(np.isfinite(out[k]))
        if len(good):
            out[k] = np.interp(at, good, out[k, good])
    return out


def _over_frames(
    x: np.ndarray, anterior: np.ndarray, places: np.ndarray, posterior: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Anterior [frames, columns] averaged over the frames that the posterior's depth was, and the posterior
    [frames, places] as deep below it: the bend of one frame's surface is noisier than the depth."""
    mean = correlate1d(anterior, ALONG_FRAMES, axis=0, mode="nearest")
    moved = np.stack([np.interp(places, x, one) for one in mean - anterior])
    return mean, posterior + moved


def _at_places(at: np.ndarray, value: np.ndarray, places: np.ndarray) -> np.ndarray:
    good = np.isfinite(at) & np.isfinite(value)
    if good.sum() < 2:
        return np.full(len(places), np.nan)
    order = np.argsort(at[good])
    moved = np.interp(places, at[good][order], value[good][order])
    return np.where(np.isfinite(value), moved, np.nan)


def _turned(x: np.ndarray, z: np.ndarray, turn: float, onto: np.ndarray) -> np.ndarray:
    """The curve (x, z) turned back by `turn` about the origin, on the grid `onto`; NaN outside."""
    good = np.isfinite(z)
    if good.sum() < 2:
        return np.full(len(onto), np.nan)
    x, z = x[good], z[good]
    return np.interp(onto, x * cos(turn) + z * sin(turn), z * cos(turn) - x * sin(turn), left=np.nan, right=np.nan)


def _axis(x: np.ndarray, displacement: np.ndarray) -> float | None:
    """Where the displacement of the deepest frames is most symmetric; None where nothing moved."""
    depth = np.nanmax(_moving_fit(np.nan_to_num(displacement), 31, 2), axis=1)
    deepest = np.argsort(depth)[-7:]
    mean = nanmean(displacement[deepest])
    good = np.isfinite(mean)
    mean = _moving_fit(np.interp(x, x[good], mean[good]), 31, 2)
    mean[: np.argmax(good)] = np.nan
    mean[len(good) - np.argmax(good[::-1]) :] = np.nan
    top = np.nanmax(mean)
    if top - np.nanmin(mean) < MOVED_MM:
        return None
    guess = x[int(np.nanargmax(mean))]
    offset = np.arange(0.05, SYMMETRY_MM, 0.05)
    candidates = guess + np.arange(-1.0, 1.0001, 0.01)
    cost = []
    for c in candidates:
        left, right = (np.interp(c + sign * offset, x, mean, left=np.nan, right=np.nan) for sign in (-1, 1))
        both = np.isfinite(left + right)
        cost.append(np.mean((left - right)[both] ** 2) if both.sum() > len(offset) // 2 else np.inf)
    best = int(np.argmin(cost))
    if not 0 < best < len(cost) - 1 or not np.isfinite(cost[best - 1] + cost[best + 1]):
        return float(candidates[best])
    a, b, c = cost[best - 1], cost[best], cost[best + 1]
    return float(candidates[best] + 0.01 * 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-30))


def _bend(x: np.ndarray, base: np.ndarray) -> float:
    """Curvature of a curve's middle half, negative while convex."""
    near = np.isfinite(base) & (np.abs(x - x.mean()) < 0.25 * np.ptp(x))
    return float(np.polyfit(x[near] - x.mean(), base[near], 2)[0]) if near.sum() > 10 else 0.0


def _pole(x: np.ndarray, base: np.ndarray) -> float:
    good = np.isfinite(base)
    c2, c1, _ = np.polyfit(x[good], base[good], 2)
    return float(np.clip(-0.5 * c1 / c2, x[0], x[-1]))


def _tangent(x: np.ndarray, base: np.ndarray, centre: float) -> tuple[float, float]:
    """Slope and height of the resting surface on the axis, from a quartic over the central 6 mm."""
    near = (np.abs(x - centre) <= 3.0) & np.isfinite(base)
    fit = np.polynomial.polynomial.polyfit(x[near] - centre, base[near], 4)
    return float(fit[1]), float(fit[0])


def _bridged(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, float, float]:
    """A curve with each of its inner gaps bridged by the least-squares quartic through as much on either side, the
    width of the widest gap, and of the widest within the picture (height below 0), not cut off by its top."""
    good = np.isfinite(z)
    if good.all() or good.sum() < 20:
        return z, 0.0, 0.0
    seen, out, widest, covered = np.flatnonzero(good), z.copy(), 0.0, 0.0
    for before, after in zip(seen[:-1], seen[1:]):
        if after == before + 1:
            continue
        middle, width = 0.5 * (x[before] + x[after]), x[after] - x[before]
        widest = max(widest, width)
        reach = 0.5 * width + max(BRIDGE_MM, width)
        near = good & (np.abs(x - middle) < reach)
        fit = np.polynomial.polynomial.polyfit((x[near] - middle) / reach, z[near], 4)
        gap = slice(before + 1, after)
        out[gap] = np.polynomial.polynomial.polyval((x[gap] - middle) / reach, fit)
        if out[gap].mean() < 0.0:
            covered = max(covered, width)
    return out, widest, covered
