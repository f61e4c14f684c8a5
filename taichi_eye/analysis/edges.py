"""The anterior and the posterior edge of the cornea in every frame, to a fraction of a pixel.

Anterior edge, in two passes. First a path from the left to the right border of the frame that gathers the most
dark-to-bright steps (dynamic programming over all rows, all frames at once). Steps count up to a ceiling, so a bright
logo, a time stamp or the iris gains nothing over the fainter side of the cornea; a path that would leave the cornea for
them pays for the dark columns in between and for whatever shines above it. Then every frame is straightened along that
path, averaged along it over a few columns, and the edge is put where the grey level has risen half-way from the air's
to the anterior line's.

The posterior edge is searched for in the frames so straightened, in groups of columns (posterior.py).

Rows are in pixels, 0 the centre of the top row; where a cornea is cut by the top of the frame, or nothing is found,
rows are NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.ndimage import binary_dilation, binary_opening, correlate1d, gaussian_filter1d, median_filter

from taichi_eye.analysis.posterior import FROM_PX, posterior_depth

REACH_PX = 8  # rows averaged on either side of a step
CEILING = 0.30  # of the step that a quarter of a frame's columns exceed: more does not count
SLOPE_MAX_PX = 4  # rows from one column pair to the next
SLOPE_COST = 0.03  # of the ceiling, per row of change
LIT_ABOVE = 0.5  # weight of what shines above a step
LIT_REACH_PX = 40
PAD_PX = 12  # rows of air put over the frame: a cut cornea's path runs there
CONTRAST_MIN = 6.0  # grey levels from air to anterior line
ALONG_PX = 3.0  # standard deviation of the average along the edge
STEP_PX = 0.5  # of the straightened frame
ABOVE_PX, BELOW_PX = 14.0, 44.0
LINE_WITHIN_PX = 9.0  # the anterior line peaks so far below its edge, at most
OUTLIER_PX = 2.5  # from the median of the neighbouring columns
CURVE_EVERY = 4  # columns
CURVE_STAGES = (4, 22.0), (6, 10.0), (8, 6.0), (10, 4.0), (12, 3.5)  # degree; rows from it that count no more
FOREIGN_LIGHT = 1.7  # of the anterior line's usual brightness
FOREIGN_AIR = 0.2  # of that brightness, over the column's usual air
LASH_PX = 33  # columns masked together that are more than a speck
FOREIGN_MARGIN_PX = 17  # columns masked about what is foreign
GROUP_PX = 12  # columns of a posterior fit


@dataclass(frozen=True)
class Edges:
    """Edges of a film, in pixels.

    anterior: rows [frames, columns], NaN where none was found. posterior: rows [frames, groups] at the columns
    posterior_column [groups]. contrast: air to anterior line [frames, columns], grey levels.
    """

    anterior: np.ndarray
    posterior: np.ndarray
    posterior_column: np.ndarray
    contrast: np.ndarray


def find_edges(frames: np.ndarray) -> Edges:
    """Edges in uint8 frames [frames, rows, columns]."""
    coarse = np.concatenate([_paths(part) for part in _chunks(frames)])
    coarse = continued(coarse, coarse >= 1.0)
    parts = [_refine(part, path) for part, path in zip(_chunks(frames), _chunks(coarse))]
    anterior, contrast, air, surface, level = (np.concatenate([part[k] for part in parts]) for k in range(5))
    foreign = _foreign(anterior, contrast, air)
    anterior[foreign] = np.nan
    groups = frames.shape[2] // GROUP_PX
    posterior = surface + posterior_depth(offsets()[offsets() >= FROM_PX], level)
    # a speck on the line hides nothing of what lies behind it
    hidden = (
        binary_opening(foreign, np.ones((1, LASH_PX)))[:, : groups * GROUP_PX]
        .reshape(len(frames), groups, GROUP_PX)
        .any(axis=2)
    )
    posterior = np.where(hidden, np.nan, posterior)
    return Edges(anterior, posterior, (np.arange(groups) + 0.5) * GROUP_PX - 0.5, contrast)


def _chunks(stack: np.ndarray, size: int = 32) -> list[np.ndarray]:
    return [stack[k : k + size] for k in range(0, len(stack), size)]


def _paths(frames: np.ndarray) -> np.ndarray:
    """Rows of the best path through each frame, shape [frames, columns]; below 0 in the padding."""
    count, height, width = frames.shape
    pairs = width // 2
    image = np.minimum(frames[:, :, : 2 * pairs], 160).astype(np.float32)
    image = correlate1d(0.5 * (image[:, :, ::2] + image[:, :, 1::2]), np.full(3, 1 / 3), axis=2, mode="nearest")
    air = np.percentile(image, 10, axis=(1, 2))[:, None, None].astype(np.float32)
    padded = np.concatenate(
        [
            np.broadcast_to(air, (count, PAD_PX + LIT_REACH_PX, pairs)),
            image,
            np.broadcast_to(image[:, -1:], (count, REACH_PX, pairs)),
        ],
        axis=1,
    )
    total = np.concatenate([np.zeros((count, 1, pairs), np.float32), np.cumsum(padded, axis=1)], axis=1)
    # an edge between the padded rows k - 1 and k, k = LIT_REACH_PX ... : index j = k - LIT_REACH_PX
    rows = height + PAD_PX

    def mean(start: int, stop: int) -> np.ndarray:
        k = LIT_REACH_PX
        return (total[:, k + stop : k + stop + rows] - total[:, k + start : k + start + rows]) / (stop - start)

    step = mean(0, REACH_PX) - mean(-REACH_PX, 0)
    ceiling = CEILING * np.percentile(step.max(axis=1), 75, axis=1)[:, None, None]
    ceiling = np.maximum(ceiling, 2.0).astype(np.float32)
    lit = np.maximum(mean(-LIT_REACH_PX, -REACH_PX) - air - 3.0, 0.0)
    gain = (np.clip(step, -ceiling, ceiling) - LIT_ABOVE * np.minimum(lit, 2.0 * ceiling)) / ceiling
    path = np.repeat(_best_path(np.ascontiguousarray(gain.transpose(2, 0, 1))), 2, axis=1)
    return np.pad(path, ((0, 0), (0, width - 2 * pairs)), mode="edge")


def _best_path(gain: np.ndarray) -> np.ndarray:
    """The path of largest summed gain [columns, frames, rows] with a bounded slope, as rows less the padding."""
    columns, count, rows = gain.shape
    moves = np.arange(-SLOPE_MAX_PX, SLOPE_MAX_PX + 1)
    cost = (SLOPE_COST * np.abs(moves)).astype(np.float32)
    best = gain[0].copy()
    came = np.zeros((columns, count, rows), np.int8)
    for column in range(1, columns):
        ahead = np.pad(best, ((0, 0), (SLOPE_MAX_PX, SLOPE_MAX_PX)), constant_values=-1e9)
        top = ahead[:, :rows] - cost[0]
        move = np.zeros((count, rows), np.int8)
        for index in range(1, len(moves)):
            other = ahead[:, index : index + rows] - cost[index]
            better = other > top
            np.copyto(top, other, where=better)
            move[better] = index
        came[column] = move
        best = top + gain[column]
    path = np.empty((count, columns), np.int64)
    here = best.argmax(axis=1)
    every = np.arange(count)
    for column in range(columns - 1, -1, -1):
        path[:, column] = here
        here = np.clip(here + came[column, every, here] - SLOPE_MAX_PX, 0, rows - 1)
    return path - PAD_PX - 0.5


def continued(row: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Rows [frames, columns] made continuous along x: where a path leaves the one smooth curve that most of a frame's
    columns lie on, that curve. seen: the rows that count.

    The curve is a polynomial along the columns, of rising degree; what lies far from it counts no more at the next
    degree, so a lash under a tenth of the columns does not bend it.
    """
    at = np.linspace(-1.0, 1.0, row.shape[1])
    part = slice(None, None, CURVE_EVERY)
    weight, target = seen[:, part].astype(float), np.where(seen, row, 0.0)[:, part]
    curve = np.zeros_like(row)
    for degree, far in CURVE_STAGES:
        powers = chebvander(at, degree)
        inner = powers[part]
        ridge = 1e-6 * len(inner) * np.eye(degree + 1)
        for _ in range(4):
            normal = np.einsum("fc,ci,cj->fij", weight, inner, inner) + ridge
            fit = np.linalg.solve(normal, ((weight * target) @ inner)[..., None])[..., 0]
            off = np.abs(target - fit @ inner.T) / far
            weight = seen[:, part] * np.clip(1.0 - off**2, 0.0, 1.0) ** 2
        curve = fit @ powers.T
    return np.where(np.abs(row - curve) > CURVE_STAGES[-1][1], np.where(seen | (curve > 0.0), curve, row), row)


def _foreign(row: np.ndarray, contrast: np.ndarray, air: np.ndarray) -> np.ndarray:
    """Where an edge [frames, columns] is not the cornea's: a lash, a speck or a logo lies over it.

    Its line is far brighter than that of its neighbours, or what should be air is lit, or it leaves the frame's
    smooth curve.
    """
    good = np.isfinite(row)
    usual, clear = (_usual(np.where(good, level, np.nan)) for level in (contrast, air))
    usual = median_filter(usual, size=len(usual) // 4, mode="mirror")
    foreign = good & (contrast > FOREIGN_LIGHT * np.maximum(usual, CONTRAST_MIN))
    foreign |= good & (air - clear > FOREIGN_AIR * np.maximum(usual, CONTRAST_MIN))
    foreign |= good & (np.abs(row - continued(row, good & ~foreign)) > 0.0)
    return binary_dilation(foreign, np.ones((1, FOREIGN_MARGIN_PX)))


def _usual(level: np.ndarray) -> np.ndarray:
    """Median over the frames of levels [frames, columns], bridged over columns that are NaN in all; 0 without any."""
    seen = np.isfinite(level).any(axis=0)
    if not seen.any():
        return np.zeros(level.shape[1])
    at = np.arange(level.shape[1])
    return np.interp(at, at[seen], np.nanmedian(level[:, seen], axis=0))


def _refine(frames: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, ...]:
    """Anterior rows, contrast and level of the air [frames, columns]; for groups of columns the surface's rows
    [frames, groups] and the grey levels at the depths from posterior.FROM_PX on [frames, depths, groups]."""
    cut = path < 1.0
    guide = gaussian_filter1d(median_filter(path, size=(1, 9), mode="nearest"), 5.0, axis=1, mode="nearest")
    image = frames.astype(np.float32)
    for _ in range(2):
        offset, straight = _straighten(image, guide)
        found, line, air = _half_rise(offset, straight)
        row = np.where(cut, np.nan, guide + found)
        row = _without_outliers(row)
        guide = gaussian_filter1d(_filled(row, guide), 4.0, axis=1, mode="nearest")
    row[line - air < CONTRAST_MIN] = np.nan
    surface = _filled(row, guide)
    offset, straight = _straighten(image, surface)
    groups = row.shape[1] // GROUP_PX
    used = offset >= FROM_PX
    level = straight[:, used, : groups * GROUP_PX].reshape(len(row), used.sum(), groups, GROUP_PX).mean(axis=3)
    return row, line - air, air, surface[:, : groups * GROUP_PX].reshape(len(row), groups, GROUP_PX).mean(axis=2), level


def offsets() -> np.ndarray:
    """Offsets [k] from the guide at which frames are straightened [px]."""
    return np.arange(-ABOVE_PX, BELOW_PX + STEP_PX / 2, STEP_PX)


def _straighten(image: np.ndarray, guide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets [k] and the grey levels at guide + offset, [frames, k, columns]; air above the frame."""
    height = image.shape[1]
    offset = offsets()
    row = np.clip(guide[:, None, :] + offset[:, None], 0.0, height - 1.000001)
    low = row.astype(np.intp)
    share = (row - low).astype(np.float32)
    above = np.take_along_axis(image, low, axis=1)
    return offset, above + share * (np.take_along_axis(image, low + 1, axis=1) - above)


def _half_rise(offset: np.ndarray, straight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset of the half rise from air to anterior line, and the levels of line and air."""
    near = offset <= LINE_WITHIN_PX
    part, offset = straight[:, near], offset[near]
    # a speck, or a logo's corner, stands out over its neighbours: what exceeds them by far is cut off
    usual = median_filter(part[:, ::2, ::4], size=(1, 1, 15), mode="nearest")
    usual = np.repeat(np.repeat(usual, 4, axis=2), 2, axis=1)[:, : part.shape[1], : part.shape[2]]
    part = gaussian_filter1d(np.minimum(part, 1.25 * usual + 15.0), ALONG_PX, axis=2, mode="nearest")
    broad = gaussian_filter1d(gaussian_filter1d(part, 4.0, axis=2, mode="nearest"), 1.5, axis=1, mode="nearest")
    air = broad[:, offset < -ABOVE_PX + 6.0].mean(axis=1)
    within = offset > -4.0
    top = broad[:, within].max(axis=1)
    peak = broad[:, within].argmax(axis=1) + int(np.argmax(within))
    half = 0.5 * (air + top)
    below = (part < half[:, None]) & (np.arange(len(offset))[:, None] <= peak[:, None])
    last = len(offset) - 1 - below[:, ::-1].argmax(axis=1)
    last = np.minimum(np.where(below.any(axis=1), last, 0), len(offset) - 2)
    a, b = (np.take_along_axis(part, k[:, None], axis=1)[:, 0] for k in (last, last + 1))
    share = np.clip((half - a) / np.maximum(b - a, 1e-3), 0.0, 1.0)
    return np.where(below.any(axis=1), offset[last] + STEP_PX * share, np.nan), top, air


def _without_outliers(row: np.ndarray) -> np.ndarray:
    """Rows with NaN where they leave the median of 25 columns by more than its slope explains."""
    filled = _filled(row, np.zeros_like(row))
    usual = gaussian_filter1d(median_filter(filled, size=(1, 25), mode="nearest"), 3.0, axis=1, mode="nearest")
    return np.where(np.abs(row - usual) > OUTLIER_PX, np.nan, row)


def _filled(row: np.ndarray, instead: np.ndarray) -> np.ndarray:
    """Rows with their gaps bridged along the columns; a frame without any row takes `instead`."""
    out = np.array(row, dtype=float)
    at = np.arange(row.shape[1])
    for k in range(len(row)):
        good = np.isfinite(row[k])
        out[k] = np.interp(at, at[good], row[k, good]) if good.any() else instead[k]
    return out
