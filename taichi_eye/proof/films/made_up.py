"""Films made up in closed form, without the renderer: the same moving eyes under light that its frames do not show.

The renderer draws one kind of back edge and no eyelash. Real frames show sharper edges, brighter chambers, seams along
the endothelium, lashes, specks, a stamp, shadows. A film here is the eye's true rows with a profile over depth below
them: air, a front that rises as an error function, the anterior line, a stroma that changes linearly with depth, a seam
before the back, a fall of given blur to the chamber, white noise; things that stand in the way are drawn over it.

`Look` says how the cornea looks, `draw` gives frames uint8 [frames, rows, columns]; `lash`, `speck`, `stamped`,
`shadow` harm frames in place. The posterior edge lies where `analysis.optics` takes it from, found by inverting it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.special import erf

from taichi_eye.analysis import Instrument, optics
from taichi_eye.analysis.curves import grid
from taichi_eye.proof.films.eyes import TIMES_MS, Eye, walls_mm

ROWS, COLUMNS = 200, 576
GROUP_PX = 24  # columns between which the apparent depth is interpolated
BRACKET, HALVINGS = (0.1, 1.2), 15  # apparent over true depth; to 0.02 um


@dataclass(frozen=True)
class Look:
    """Grey levels, and blurs (standard deviations) in pixels; seam: grey levels over the stroma, seam_px wide."""

    air: float = 22.0
    chamber: float = 20.0
    stroma_front: float = 46.0
    stroma_back: float = 44.0
    line: float = 32.0
    front_sigma_px: float = 1.6
    back_sigma_px: float = 2.0
    seam: float = 0.0
    seam_px: float = 2.5
    noise: float = 3.0


def apparent_depth_px(x_mm: np.ndarray, height_mm: np.ndarray, thickness_um: float) -> np.ndarray:
    """Rows from anterior to apparent posterior edge at x_mm, [frames, len(x_mm)], under heights over `grid()`.

    What is seen grows with the depth, so the depth is bracketed and halved: in a dent as narrow as the cornea is thick
    no fixed point is reached.
    """
    camera, inner = Instrument(), grid()
    anterior = np.stack([np.interp(x_mm, inner, one) for one in height_mm])
    low, high = (np.full(anterior.shape, share * 1e-3 * thickness_um) for share in BRACKET)
    for _ in range(HALVINGS):
        depth = 0.5 * (low + high)
        seen = optics.thickness(inner, height_mm, x_mm, anterior - depth, camera.angle_deg, camera.refractive_index)
        short = seen < 1e-3 * thickness_um
        low, high = np.where(short, depth, low), np.where(short, high, depth)
    return 0.5 * (low + high) / camera.pixel_y_mm


def draw(eye: Eye, look: Look, thickness_um: float, seed: int, which=slice(None), axis_px: float = 288.0) -> np.ndarray:
    """Frames of the eye at TIMES_MS[which]."""
    camera, scene = Instrument(), eye.scene()
    walls, inner = walls_mm(eye, scene)[which], grid()
    height = np.stack([np.interp(np.abs(inner), r, z) for r, z in walls.transpose(0, 2, 1)])
    x = (np.arange(COLUMNS) - axis_px) * camera.pixel_x_mm
    row = scene.camera.apex_row_px + np.stack(
        [(walls[0, 0, 1] - np.interp(np.abs(x), r, z)) / camera.pixel_y_mm for r, z in walls.transpose(0, 2, 1)]
    )
    coarse = x[GROUP_PX // 2 :: GROUP_PX]
    coarse = coarse[np.abs(coarse) < 4.3]
    depth = np.stack([np.interp(x, coarse, one) for one in apparent_depth_px(coarse, height, thickness_um)])
    random = np.random.default_rng(seed)
    frames = np.empty((len(row), ROWS, COLUMNS), np.uint8)
    for k in range(len(row)):
        below = np.arange(ROWS)[:, None] - row[k]
        level = profile(look, below, depth[k]) + look.noise * random.standard_normal((ROWS, COLUMNS))
        frames[k] = np.clip(np.rint(level), 0, 255)
    return frames


def half_rise_px(look: Look) -> float:
    """How far below its own step the front has risen half-way from the air to the line: there the surface lies."""
    below = np.arange(-8.0, 12.0, 0.01)
    level = _rising(look, below, look.stroma_front)
    return float(below[np.argmax(level > 0.5 * (look.air + level.max()))])


def _rising(look: Look, below: np.ndarray, inside) -> np.ndarray:
    share = 0.5 * (1.0 + erf(below / (np.sqrt(2.0) * look.front_sigma_px)))
    return look.air + (inside + look.line * np.exp(-0.5 * ((below - 2.5) / 2.2) ** 2) - look.air) * share


def profile(look: Look, below: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Grey levels at `below` px under the anterior edge of a cornea `depth` px thick."""
    share = np.clip(below / depth, 0.0, 1.0)
    tissue = look.stroma_front + share * (look.stroma_back - look.stroma_front)

    def before(end):
        return 0.5 * (1.0 + erf((end - below) / (np.sqrt(2.0) * look.back_sigma_px)))

    back = before(depth)
    inside = look.chamber + (tissue - look.chamber) * back + look.seam * (back - before(depth - look.seam_px))
    return _rising(look, below + half_rise_px(look), inside)


def lash(frames: np.ndarray, start, stop, width_px: float, level: float, drift_px=(0.0, 0.0)) -> None:
    """A bright bar from start to stop, (row, column) each, that drifts by drift_px over the film."""
    rows, columns = np.mgrid[: frames.shape[1], : frames.shape[2]]
    start, along = np.asarray(start, float), np.asarray(stop, float) - np.asarray(start, float)
    for k, frame in enumerate(frames):
        origin = start + np.asarray(drift_px) * k / max(len(frames) - 1, 1)
        off = np.stack([rows - origin[0], columns - origin[1]])
        share = np.clip(np.tensordot(along, off, 1) / max(along @ along, 1e-9), 0.0, 1.0)
        far = np.hypot(*(off - along[:, None, None] * share))
        bar = level * np.clip(0.5 * width_px + 0.5 - far, 0.0, 1.0)
        np.maximum(frame, bar.astype(np.uint8), out=frame)


def speck(frames: np.ndarray, row: float, column: float, sigma_px: float, which) -> None:
    """A saturated speck in the frames `which`."""
    rows, columns = np.mgrid[: frames.shape[1], : frames.shape[2]]
    light = 520.0 * np.exp(-0.5 * ((rows - row) ** 2 + (columns - column) ** 2) / sigma_px**2)
    for k in which:
        frames[k] = np.clip(frames[k] + light, 0, 255)


def stamped(frames: np.ndarray, times_ms: np.ndarray) -> None:
    """The time in ms in the lower right corner, as the instrument writes it."""
    face = ImageFont.load_default(13)
    for frame, time in zip(frames, times_ms):
        picture = Image.fromarray(frame)
        ImageDraw.Draw(picture).text((COLUMNS - 70, ROWS - 20), f"{time:.2f} ms", fill=205, font=face)
        frame[:] = np.asarray(picture)


def shadow(frames: np.ndarray, column: float, width_px: float, share: float) -> None:
    """A dark stripe down the picture: `share` of the light is gone in its middle."""
    stripe = 1.0 - share * np.exp(-0.5 * ((np.arange(frames.shape[2]) - column) / (0.5 * width_px)) ** 2)
    frames[:] = np.rint(frames * stripe)


__all__ = ["COLUMNS", "ROWS", "TIMES_MS", "Look", "draw", "lash", "profile", "shadow", "speck", "stamped"]
