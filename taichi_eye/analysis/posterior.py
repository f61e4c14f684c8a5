"""The posterior edge of the cornea: where the stroma's light falls to the chamber's, to a fraction of a pixel.

The edge has no line of its own. In a frame straightened along the anterior edge the model
a + b [(1 - fade d/e) step((e - d)/blur) + foot line(d)] of depth d, the stroma's fading light and the foot of the
anterior line, is fitted to groups of columns, linear in a and b, the edge e by search.

All candidates for e in a group of columns of a frame are judged on one and the same window of depths; were each judged
on a window of its own, a short window that holds little would win. The window ends CHAMBER_PX below about where the
edge lies in that frame, before iris and lens: in a dent they come near an edge that is seen short, and a window as long
as at rest would take their light for the chamber's. The blur is the camera's: one for the film,
searched for. What tissue and slit give a column stays the same while the cornea moves, so fade and foot are fitted once
per group, to the mean of the frames that show the cornea thick; fitted anew in every frame they swap with the edge
where a thin cornea is seen short. An edge must be a fall, and a best candidate at the end of its search is no answer:
there depths are NaN.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter1d, median_filter
from scipy.special import erf

FROM_PX = 6.0  # fitted from this depth on
LINES_AT_PX, LINE_SIGMA_PX = (2.5, 4.5), 2.2  # lines of different cameras: a mixture of two
STROMA_PX = 8.0, 13.0  # depths that are stroma in any cornea
DEEPEST_PX = 44.0
CHAMBER_PX = 9.0  # fitted below the edge; iris and lens further down are none of the model
SEARCH_PX, STEP_PX = 6.0, 0.25  # on either side of the group's usual depth
BLUR_PX = 0.5, 0.7, 1.0, 1.4, 1.9, 2.55, 3.3, 4.2, 5.3  # standard deviations tried
BLUR_FROM_PX = 7.0  # above the edge: all that tells the blur
BLUR_FRAMES = 24  # that the blur is searched for in
FALL_MIN = 5.0  # grey levels from stroma to chamber
STAYS_PX = 2.5  # a fall is one that stays below
STEEP_PX, STEEP_SHARE = 5.0, 0.5  # within so far on either side it falls by that share
FADE_MAX, FOOT_MAX = 0.9, 3.0
ACROSS_GROUPS = 3  # groups whose misfits are averaged
ALONG_FRAMES = 0.11, 0.22, 0.34, 0.22, 0.11  # weights of a frame's misfit and its neighbours': depth changes slowly
STRAY_PX = 3.0  # from the median of the neighbouring frames and groups
OUTLIER_PX = 2.0


def posterior_depth(depth: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Depth of the posterior edge below the anterior one for each group of columns, [frames, groups]; NaN where none.

    depth [k], even steps from FROM_PX to DEEPEST_PX; level [frames, k, groups], grey levels there.
    """
    usual = _usual(depth, level)
    seen = np.flatnonzero(np.isfinite(usual))
    edge = np.full((level.shape[0], level.shape[2]), np.nan)
    if len(seen) < ACROSS_GROUPS:
        return edge
    level, centre = level[:, :, seen], STEP_PX * np.round(usual[seen] / STEP_PX)
    mild = correlate1d(level, [0.25, 0.5, 0.25], axis=2, mode="nearest")
    blur = _blur(depth, mild, centre)
    edges = _candidates(centre)
    found = edges[_misfit(depth, mild, centre, _free(blur)).argmin(axis=0)]
    near = median_filter(found, size=(9, 9), mode="nearest")
    light = _light(depth, level, centre, near, blur)
    misfit = _misfit(depth, level, centre, _lit(blur, *light), about=near)
    misfit = correlate1d(misfit, np.full(ACROSS_GROUPS, 1.0 / ACROSS_GROUPS), axis=2, mode="nearest")
    misfit = correlate1d(misfit, ALONG_FRAMES, axis=1, mode="nearest")
    near = median_filter(edges[misfit.argmin(axis=0)], size=(5, 9), mode="nearest")
    misfit[np.abs(edges[:, None, None] - near) > STRAY_PX] = np.inf
    best = _least(misfit, edges)
    # the iris close behind the cornea's border, or a logo, is not a posterior edge
    astray = np.abs(best - median_filter(best, size=(1, 15), mode="mirror")) > OUTLIER_PX
    edge[:, seen] = np.where(astray, np.nan, best)
    return edge


def _usual(depth: np.ndarray, level: np.ndarray) -> np.ndarray:
    """About where the light of each group [groups] falls from stroma to chamber; NaN where it does not."""
    step = depth[1] - depth[0]
    calm = correlate1d(level, np.full(3, 1 / 3), axis=2, mode="nearest")
    calm = correlate1d(calm, np.full(9, 1 / 9), axis=0, mode="nearest")
    calm = gaussian_filter1d(calm, 1.0 / step, axis=1, mode="nearest")
    stroma = np.median(calm[:, (depth >= STROMA_PX[0]) & (depth <= STROMA_PX[1])], axis=1)
    deep = depth >= STROMA_PX[0]
    chamber = np.percentile(calm[:, deep], 10, axis=1)
    below = calm[:, deep] < 0.5 * (stroma + chamber)[:, None]
    stays = round(STAYS_PX / step)
    for _ in range(stays):
        below[:, :-1] &= below[:, 1:]
    below[:, -stays:] = False
    first = below.argmax(axis=1)
    falls = below.any(axis=1) & (first > 0) & (stroma - chamber > FALL_MIN)
    # a fall is steep: light that only fades with depth has no edge
    around = round(STEEP_PX / step)
    index = np.arange(deep.argmax(), len(depth))[first]
    ahead, after = (
        np.take_along_axis(calm, np.clip(index + shift, 0, len(depth) - 1)[:, None], axis=1)[:, 0]
        for shift in (-around, around)
    )
    falls &= ahead - after > STEEP_SHARE * (stroma - chamber)
    place = np.where(falls, depth[deep][first], np.nan)
    enough = falls.mean(axis=0) > 0.5
    usual = np.array([np.nanmedian(one) if good else np.nan for one, good in zip(place.T, enough)])
    if not enough.any():
        return usual
    at = np.arange(len(usual))
    calm_usual = median_filter(np.interp(at, at[enough], usual[enough]), 5, mode="nearest")
    return np.where(enough & (calm_usual + CHAMBER_PX <= DEEPEST_PX + SEARCH_PX), calm_usual, np.nan)


def _candidates(centre: np.ndarray) -> np.ndarray:
    """Edges that the groups are searched for, multiples of STEP_PX [candidates]."""
    first, last = (round(end / STEP_PX) for end in (centre.min() - SEARCH_PX, centre.max() + SEARCH_PX))
    return STEP_PX * np.arange(first, last + 1)


def _blur(depth: np.ndarray, level: np.ndarray, centre: np.ndarray) -> float:
    """The blur that leaves least of the film when every frame and group has its own edge."""
    # of a film's first and last frames, where the cornea is at rest and its two edges run alike
    ends = np.arange(BLUR_FRAMES // 2)
    some = np.unique(np.clip(np.concatenate([ends, len(level) - 1 - ends]), 0, len(level) - 1))
    # where the cornea lies level: along the normal a slanted edge is as sharp, down a column it is not
    level_groups = slice(3 * len(centre) // 8, len(centre) - 3 * len(centre) // 8)
    part = level[some][:, :, level_groups]
    # the fall alone: over a longer window the blur would make up for what the model lacks of the line
    left = [_misfit(depth, part, centre[level_groups], _fall(blur), BLUR_FROM_PX).min(axis=0).sum() for blur in BLUR_PX]
    best = int(np.argmin(left))
    if not 0 < best < len(left) - 1:
        return BLUR_PX[best]
    at = np.log(BLUR_PX[best - 1 : best + 2])
    bend, slope, _ = np.polyfit(at - at[1], left[best - 1 : best + 2], 2)
    return float(np.exp(at[1] - 0.5 * slope / bend)) if bend > 0.0 else BLUR_PX[best]


def _terms(depth: np.ndarray, edge, blur: float) -> tuple[np.ndarray, np.ndarray]:
    """The step at the posterior edge [k], and the anterior line [k, LINES_AT_PX], over the depth."""
    return (
        0.5 * (1.0 - erf((depth - edge) / (np.sqrt(2.0) * blur))),
        np.exp(-0.5 * ((depth[:, None] - np.array(LINES_AT_PX)) / LINE_SIGMA_PX) ** 2),
    )


def _fall(blur: float):
    """The fall alone: chamber, stroma at the edge, its slope, [k, 3]."""
    return lambda depth, edge, groups: _free(blur)(depth, edge, groups)[:, :3]


def _free(blur: float):
    """The model of a frame by itself: chamber, stroma at the edge, its slope, line; [k, terms] for all groups alike."""

    def basis(depth, edge, groups):
        step, line = _terms(depth, edge, blur)
        return np.column_stack([np.ones_like(step), step, step * np.minimum(depth - edge, 0.0), line])

    return basis


def _lit(blur: float, fade: np.ndarray, foot: np.ndarray):
    """The model with the light of each group known: chamber and body, [groups, k, 2]."""

    def basis(depth, edge, groups):
        step, line = _terms(depth, edge, blur)
        body = step * (1.0 - fade[groups, None] * np.minimum(depth / edge, 1.0)) + foot[groups] @ line.T
        return np.stack([np.ones_like(body), body], axis=2)

    return basis


def _light(
    depth: np.ndarray, level: np.ndarray, centre: np.ndarray, near: np.ndarray, blur: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fade of the stroma and foot of the anterior line [groups], from the mean of the frames in which a group's edge
    lies at its median depth or deeper; near [frames, groups]: about where."""
    thick = near >= np.median(near, axis=0)
    mean = (np.where(thick[:, None], level, 0.0).sum(axis=0) / thick.sum(axis=0))[None]
    about = np.where(thick, near, 0.0).sum(axis=0) / thick.sum(axis=0)
    edges = _candidates(centre)
    misfit = _misfit(depth, mean, centre, _free(blur))
    misfit[np.abs(edges[:, None, None] - about) > STRAY_PX] = np.inf
    edge = _least(misfit, edges)[0]
    edge = np.where(np.isfinite(edge), edge, about)
    fade, foot = np.empty(len(edge)), np.empty((len(edge), len(LINES_AT_PX)))
    for group, at in enumerate(edge):
        here = depth <= centre[group] + CHAMBER_PX
        basis = _free(blur)(depth[here], at, None)
        _, end, slope, *line = np.linalg.lstsq(basis, mean[0, here, group], rcond=None)[0]
        top = max(end - slope * at, 1e-6)
        fade[group], foot[group] = -slope * at / top, np.array(line) / top
    return (
        median_filter(np.clip(fade, -FADE_MAX, FADE_MAX), 9, mode="nearest"),
        median_filter(np.clip(foot, -FOOT_MAX, FOOT_MAX), (9, 1), mode="nearest"),
    )


def _misfit(
    depth: np.ndarray,
    level: np.ndarray,
    centre: np.ndarray,
    basis,
    above_px: float = np.inf,
    about: np.ndarray | None = None,
) -> np.ndarray:
    """Mean square that basis(depth, edge, groups) leaves of the levels, for the edges `_candidates(centre)`,
    [candidates, frames, groups]; infinite outside a group's search.

    The window lies about `about` [frames, groups], where that is not given about centre [groups].
    """
    edges, step = _candidates(centre), depth[1] - depth[0]
    about = step * np.round(np.broadcast_to(centre if about is None else about, level.shape[::2]) / step)
    misfit = np.full((len(edges), *about.shape), np.inf)
    for middle in np.unique(centre):
        groups = np.flatnonzero(centre == middle)
        searched = np.flatnonzero(np.abs(edges - middle) <= SEARCH_PX + 1e-9)
        for place in np.unique(about[:, groups]):
            frame, which = np.nonzero(about[:, groups] == place)
            group = groups[which]
            window = (depth >= place - above_px) & (depth <= place + CHAMBER_PX)
            part = level[:, window][frame, :, group]
            power = (part**2).sum(axis=1)
            for index in searched:
                terms = np.linalg.qr(basis(depth[window], edges[index], groups))[0]
                fitted = part @ terms if terms.ndim == 2 else np.einsum("pdk,pd->pk", terms[which], part)
                left = power - (fitted**2).sum(axis=1)
                misfit[index, frame, group] = left / (window.sum() - terms.shape[-1])
    return misfit


def _least(misfit: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Where the misfit is least, to a fraction of a candidate's step; NaN at the ends of the search."""
    best = misfit.argmin(axis=0)
    at_end = (best == 0) | (best == len(candidates) - 1)
    best = np.clip(best, 1, len(candidates) - 2)
    below, here, above = (np.take_along_axis(misfit, (best + k)[None], axis=0)[0] for k in (-1, 0, 1))
    inside = np.isfinite(below) & np.isfinite(above) & ~at_end
    below, here, above = (np.where(inside, value, 0.0) for value in (below, here, above))
    bend = below - 2.0 * here + above
    shift = 0.5 * (below - above) / np.where(bend > 0.0, bend, np.inf)
    return np.where(inside, candidates[best] + (candidates[1] - candidates[0]) * np.clip(shift, -1, 1), np.nan)
