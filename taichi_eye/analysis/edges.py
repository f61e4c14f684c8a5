"""The anterior and the posterior edge of the cornea in every frame, to a fraction of a pixel.

Anterior edge, in two passes. First a path from the left to the right border of the frame that gathers the most
dark-to-bright steps (dynamic programming over all rows, all frames at once). Steps count up to a ceiling, so a bright
logo, a time stamp or the iris gains nothing over the fainter side of the cornea; a path that would leave the cornea for
them pays for the dark columns in between and for whatever shines above it. Then every frame is straightened along that
path, averaged along it over a few columns, and the edge is put where the grey level has risen half-way from the air's
to the anterior line's.

Posterior edge. It has no line of its own, only a soft fall: in the straightened frame the model
a + b [(1 - fade d/e) step((e - d)/sigma) + foot line(d)] of depth d, the stroma's fading light and the foot of the
anterior line, is fitted to groups of columns, linear in a and b, the edge e by search. What tissue and slit give a
column stays
the same while the cornea moves, so fade and foot are fitted once per group, to the mean of the frames that show the
cornea
thick. Fitted anew in every frame they swap with the edge where a thin cornea is seen short (a dent: 0.57 of its
thickness): errors of 50 um and more, where this leaves 3 um rms.

Rows are in pixels, 0 the centre of the top row; where a cornea is cut by the top of the frame, or nothing is found,
rows are NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter1d, median_filter
from scipy.special import erf

REACH_PX = 8  # rows averaged on either side of a step
CEILING = 0.30  # of the typical step of a frame's central columns: more does not count
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
GROUP_PX = 12  # columns of a posterior fit
ACROSS_GROUPS = 3  # groups whose misfits are averaged
ALONG_FRAMES = 0.25, 0.5, 0.25  # weights of a frame's misfit and its neighbours': depth changes little between frames
POSTERIOR_SIGMA_PX = 2.55
POSTERIOR_FROM_PX = 6.0
LINE_AT_PX, LINE_SIGMA_PX = 4.5, 2.2
POSTERIOR_BAND_PX = 9.0, 34.0
POSTERIOR_STEP_PX = 0.25
CHAMBER_PX = 9.0  # fitted below the edge; iris and lens further down are none of the model
FADE_MAX, FOOT_MAX = 0.9, 3.0
POSTERIOR_SHARES = 0.55, 1.6  # of the usual depth in the middle
POSTERIOR_STRAY_PX = 3.0
POSTERIOR_OUTLIER_PX = 2.0


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
    parts = [_refine(part, path) for part, path in zip(_chunks(frames), _chunks(coarse))]
    anterior, contrast, surface, level = (np.concatenate([part[k] for part in parts]) for k in range(4))
    groups = frames.shape[2] // GROUP_PX
    posterior = surface + _fall(offsets()[offsets() >= POSTERIOR_FROM_PX], level)
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
    third = pairs // 3
    ceiling = CEILING * np.median(step[:, :, third:-third].max(axis=1), axis=1)[:, None, None]
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


def _refine(frames: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, ...]:
    """Anterior rows and contrast [frames, columns]; for groups of columns the surface's rows [frames, groups] and the
    grey levels at the depths from POSTERIOR_FROM_PX on [frames, depths, groups]."""
    cut = path < 1.0
    guide = gaussian_filter1d(median_filter(path, size=(1, 9), mode="nearest"), 5.0, axis=1, mode="nearest")
    image = frames.astype(np.float32)
    for _ in range(2):
        offset, straight = _straighten(image, guide)
        found, contrast = _half_rise(offset, straight)
        row = np.where(cut, np.nan, guide + found)
        row = _without_outliers(row)
        guide = gaussian_filter1d(_filled(row, guide), 4.0, axis=1, mode="nearest")
    row[contrast < CONTRAST_MIN] = np.nan
    surface = _filled(row, guide)
    offset, straight = _straighten(image, surface)
    groups = row.shape[1] // GROUP_PX
    used = offset >= POSTERIOR_FROM_PX
    level = straight[:, used, : groups * GROUP_PX].reshape(len(row), used.sum(), groups, GROUP_PX).mean(axis=3)
    return row, contrast, surface[:, : groups * GROUP_PX].reshape(len(row), groups, GROUP_PX).mean(axis=2), level


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


def _half_rise(offset: np.ndarray, straight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset of the half rise from air to anterior line, and the line's height over the air."""
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
    return np.where(below.any(axis=1), offset[last] + STEP_PX * share, np.nan), top - air


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


def _fall(depth: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Depth of the posterior edge below the anterior one for each group of columns, [frames, groups].

    depth [k]; level [frames, k, groups].
    """
    groups = level.shape[2]
    candidates = np.arange(*POSTERIOR_BAND_PX, POSTERIOR_STEP_PX)
    misfit = _misfit(depth, correlate1d(level, [0.25, 0.5, 0.25], axis=2, mode="nearest"), candidates, _free)
    # noise and the stroma's own fading make second minima: the search is held near the usual depth of the middle third,
    # which the sides exceed by up to a half, then near the median of the neighbouring frames and groups
    third = slice(groups // 3, groups - groups // 3)
    typical = np.median(candidates[misfit[:, :, third].argmin(axis=0)])
    far = (candidates < POSTERIOR_SHARES[0] * typical) | (candidates > POSTERIOR_SHARES[1] * typical)
    misfit[far] = np.inf
    usual = median_filter(candidates[misfit.argmin(axis=0)], size=(9, 9), mode="nearest")
    fade, foot = _light(depth, level, usual)

    def lit(d, edge):
        step, line = _terms(d, edge)
        body = step * (1.0 - fade[:, None] * np.minimum(d / edge, 1.0)) + foot[:, None] * line
        return np.stack([np.ones_like(body), body], axis=2)

    misfit = correlate1d(
        _misfit(depth, level, candidates, lit), np.full(ACROSS_GROUPS, 1.0 / ACROSS_GROUPS), axis=2, mode="nearest"
    )
    misfit = correlate1d(misfit, ALONG_FRAMES, axis=1, mode="nearest")
    misfit[far] = np.inf
    usual = median_filter(candidates[misfit.argmin(axis=0)], size=(5, 9), mode="nearest")
    misfit[np.abs(candidates[:, None, None] - usual) > POSTERIOR_STRAY_PX] = np.inf
    edge = _least(misfit, candidates)
    # the iris close behind the cornea's border, or a logo, is not a posterior edge
    astray = np.abs(edge - median_filter(edge, size=(1, 15), mode="mirror")) > POSTERIOR_OUTLIER_PX
    return np.where(astray, np.nan, edge)


def _light(depth: np.ndarray, level: np.ndarray, usual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fade of the stroma and foot of the anterior line [groups], from the mean of the frames in which a group's edge
    lies at its median depth or deeper; usual [frames, groups]: about where."""
    thick = usual >= np.median(usual, axis=0)
    mean = (np.where(thick[:, None], level, 0.0).sum(axis=0) / thick.sum(axis=0))[None]
    candidates = np.arange(*POSTERIOR_BAND_PX, 0.2 * POSTERIOR_STEP_PX)
    misfit = _misfit(depth, mean, candidates, _free)
    about = np.where(thick, usual, 0.0).sum(axis=0) / thick.sum(axis=0)
    misfit[np.abs(candidates[:, None, None] - about) > POSTERIOR_STRAY_PX] = np.inf
    edge = candidates[misfit[:, 0].argmin(axis=0)]
    fade, foot = np.empty(len(edge)), np.empty(len(edge))
    for group, at in enumerate(edge):
        here = depth <= at + CHAMBER_PX
        _, end, slope, line = np.linalg.lstsq(_free(depth[here], at), mean[0, here, group], rcond=None)[0]
        top = max(end - slope * at, 1e-6)
        fade[group], foot[group] = -slope * at / top, line / top
    return tuple(
        median_filter(np.clip(share, 0.0, most), 9, mode="nearest")
        for share, most in ((fade, FADE_MAX), (foot, FOOT_MAX))
    )


def _terms(depth: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """The step at the posterior edge and the anterior line over the depth."""
    return (
        0.5 * (1.0 - erf((depth - edge) / (np.sqrt(2.0) * POSTERIOR_SIGMA_PX))),
        np.exp(-0.5 * ((depth - LINE_AT_PX) / LINE_SIGMA_PX) ** 2),
    )


def _free(depth: np.ndarray, edge: float) -> np.ndarray:
    """Chamber, stroma at the edge, its slope, line: the model of a frame by itself, [k, 4]."""
    step, line = _terms(depth, edge)
    return np.column_stack([np.ones_like(step), step, step * (depth - edge), line])


def _misfit(depth: np.ndarray, level: np.ndarray, candidates: np.ndarray, basis) -> np.ndarray:
    """Mean square that basis(depth, edge) leaves of the levels, [candidates, frames, groups]; the basis is [k, terms]
    for all groups or [groups, k, terms]."""
    misfit = np.empty((len(candidates), level.shape[0], level.shape[2]))
    for index, edge in enumerate(candidates):
        here = slice(0, int(np.searchsorted(depth, edge + CHAMBER_PX)))
        terms, part = np.linalg.qr(basis(depth[here], edge))[0], level[:, here]
        fitted = np.einsum("dk,fdg->fkg" if terms.ndim == 2 else "gdk,fdg->fkg", terms, part)
        misfit[index] = ((part**2).sum(axis=1) - (fitted**2).sum(axis=1)) / (here.stop - terms.shape[-1])
    return misfit


def _least(misfit: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Where the misfit is least, to a fraction of a candidate's step; NaN at the ends of the search."""
    best = np.clip(misfit.argmin(axis=0), 1, len(candidates) - 2)
    below, here, above = (np.take_along_axis(misfit, (best + k)[None], axis=0)[0] for k in (-1, 0, 1))
    inside = np.isfinite(below) & np.isfinite(above)
    bend = np.where(inside, below - 2.0 * here + above, np.inf)
    shift = np.where(
        inside & (bend > 0), 0.5 * (np.where(inside, below, 0.0) - np.where(inside, above, 0.0)) / bend, 0.0
    )
    return np.where(inside, candidates[best] + (candidates[1] - candidates[0]) * np.clip(shift, -1, 1), np.nan)
