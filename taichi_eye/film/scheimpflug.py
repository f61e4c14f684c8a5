"""The Scheimpflug view: what a Corvis ST shows, 8-bit grey.

A lit section of the cornea on a dark field: a bright anterior line, the stroma fading with depth, a soft
posterior edge shortened by refraction (surface.py), air above and the chamber below, sensor noise. Grey
levels and widths were measured on public frames of the instrument; brightness falls off to the sides as the
slit light does. The shadows of iris and lens are a backdrop painted in image space: the model's chamber has
a plain rigid back.

Pixel (row i, column j) has its centre at x = (j - apex_column) pixel_x, z = z_apex,rest - (i - apex_row)
pixel_y.
"""
from math import erf, exp, sqrt

import numpy as np
import taichi as ti

from taichi_eye.backend import real

from .glyphs import GlyphAtlas, stamp
from .noise import gaussian_table, noise_key, hash_u32
from .state import FrameState
from .surface import Surface

AIR = 6.5
CHAMBER = 7.4
LINE_CENTRE, LINE_FALL = 85.0, 0.115         # peak of the anterior line on the axis; its fall-off [1/mm]
STROMA_TOP, STROMA_BOTTOM, STROMA_FALL = 65.0, 46.0, 0.195
FALL_CORE_MM = 0.5                           # rounds the fall-off on the axis
RISE_SIGMA_PX = 2.2                          # blur of the air-to-stroma step; the line rises in 4.5 px
LINE_SIGMA_PX, LINE_DEPTH_PX = 2.12, 2.4     # the line's excess over the stroma: FWHM 5 px
POSTERIOR_SIGMA_PX = 2.55                    # 10-90 % in 6.5 px
NOISE_FLOOR, NOISE_GAIN = 12.0, 0.24         # variance = floor + gain * level
HAZE_REST, HAZE_DENTED = 9.0, 18.0           # lens haze over the chamber at rest and at 1 mm indentation
STAMP_LEVEL = 205
STEPS_PER_PX = 16
PROFILE_BEFORE_PX, PROFILE_AFTER_PX = 10, 14


@ti.data_oriented
class Scheimpflug:
    """Renders frames of shape [height_px, width_px], uint8.

    One `Surface` may be shared with another view, which then need not be updated twice for the same frame.
    """

    def __init__(self, scene, surface: Surface | None = None):
        camera = scene.camera
        self.surface = Surface(scene) if surface is None else surface
        self.height, self.width = camera.height_px, camera.width_px
        self.pixel_x, self.pixel_y = camera.pixel_x_mm * 1e-3, camera.pixel_y_mm * 1e-3
        self.apex_row, self.apex_column = float(camera.apex_row_px), float(camera.apex_column_px)
        self.apex_rest = self.surface.apex_rest
        self.noise, self.seed = camera.noise, camera.seed
        self.interval_ms = camera.frame_interval_ms
        self.atlas = GlyphAtlas(max(8, round(0.065 * self.height))) if camera.stamp else None

        edge, posterior, line_stroma = edge_profiles()
        self.line_stroma = line_stroma
        self.edge = ti.Vector.field(2, real(), len(edge))
        self.posterior = ti.field(real(), len(posterior))
        self.column = ti.Vector.field(5, real(), self.width)
        self.backdrop = ti.Vector.field(2, real(), (self.height, self.width))
        self.quantile = ti.field(real(), len(gaussian_table()))
        self.edge.from_numpy(edge)
        self.posterior.from_numpy(posterior)
        self.backdrop.from_numpy(backdrop(self.height, self.width, self.apex_column))
        self.quantile.from_numpy(gaussian_table())

    def render(self, state: FrameState, fresh: bool = True) -> np.ndarray:
        """The frame at `state`; `fresh` says that the surface tables have yet to be updated for it."""
        if fresh:
            self.surface.update(state.wall, state.wall_count)
        image = np.empty((self.height, self.width), np.uint8)
        frame = round(state.time_ms / self.interval_ms)
        self._render(image, noise_key(self.seed, frame), 1 if self.noise else 0)
        if self.atlas is not None:
            mask = self.atlas.mask(f"{state.time_ms:.2f} ms")
            stamp(image, mask, self.height - mask.shape[0] - 3, self.width - mask.shape[1] - 6, STAMP_LEVEL)
        return image

    @ti.kernel
    def _render(self, image: ti.types.ndarray(), key: ti.u32, noisy: ti.i32):
        for j in range(self.width):
            x = (j - self.apex_column) * self.pixel_x
            z = self.surface.at(self.surface.height, x)
            slope = self.surface.at(self.surface.slope, x) * self.pixel_x / self.pixel_y
            depth = (z - self.surface.at(self.surface.apparent, x)) / self.pixel_y
            off_mm = ti.sqrt((x * 1e3) ** 2 + FALL_CORE_MM**2) - FALL_CORE_MM
            stroma = (STROMA_TOP - CHAMBER) * ti.exp(-STROMA_FALL * off_mm)
            line = (LINE_CENTRE - CHAMBER) * ti.exp(-LINE_FALL * off_mm) - self.line_stroma * stroma
            row = self.apex_row + (self.apex_rest - z) / self.pixel_y
            tilt = 1.0 / ti.sqrt(1.0 + slope * slope)
            self.column[j] = ti.Vector([row, ti.max(depth, 1.0), tilt, stroma, ti.max(line, 0.0)])
        for i, j in ti.ndrange(self.height, self.width):
            row, thickness, tilt, stroma, line = self.column[j]
            depth = i - row
            level = 0.0 * depth + AIR
            if depth * tilt > -PROFILE_BEFORE_PX:
                iris, haze = self.backdrop[i, j]
                dent = ti.math.clamp((self.apex_rest - self.surface.height[0]) * 1e3, 0.0, 1.5)
                behind = iris + haze * (HAZE_REST + (HAZE_DENTED - HAZE_REST) * dent)
                level = CHAMBER + behind
                if (depth - thickness) * tilt < PROFILE_AFTER_PX:
                    # step across the anterior surface, the line's excess, step across the posterior surface
                    edge = look_up(self.edge, depth * tilt)
                    inside = look_up(self.posterior, (depth - thickness) * tilt)
                    share = ti.math.clamp(depth / thickness, 0.0, 1.0)
                    body = stroma * (1.0 - (STROMA_TOP - STROMA_BOTTOM) / (STROMA_TOP - CHAMBER) * share)
                    level = (AIR + edge[0] * (CHAMBER - AIR + inside * body + (1.0 - inside) * behind)
                             + edge[1] * line)
            if noisy != 0:
                draw = hash_u32(hash_u32(ti.cast(i * self.width + j, ti.u32)) ^ key)
                normal = self.quantile[ti.cast(draw >> 20, ti.i32)]
                level += ti.sqrt(NOISE_FLOOR + NOISE_GAIN * level) * normal
            image[i, j] = ti.cast(ti.math.clamp(level + 0.5, 0.0, 255.0), ti.u8)


@ti.func
def look_up(table: ti.template(), offset):
    """A cross-section table at `offset` px from its edge, constant beyond its ends."""
    t = ti.math.clamp((offset + PROFILE_BEFORE_PX) * STEPS_PER_PX, 0.0, table.shape[0] - 1.001)
    k = ti.max(ti.cast(t, ti.i32), 0)
    return table[k] + (t - k) * (table[k + 1] - table[k])


def edge_profiles() -> tuple[np.ndarray, np.ndarray, float]:
    """Cross-sections tabulated over the distance from an edge along its normal, -10..14 px in 1/16 px.

    Returns the anterior step and line excess, shape [n, 2], the posterior step (1 inside the stroma, 0
    behind), shape [n], and the share of the stroma's brightness under the peak of the line. The anterior
    table is shifted so that on the axis half the rise to the peak lies on the surface itself.
    """
    offset = np.arange(-PROFILE_BEFORE_PX * STEPS_PER_PX, PROFILE_AFTER_PX * STEPS_PER_PX + 1) / STEPS_PER_PX
    share = step(LINE_DEPTH_PX / RISE_SIGMA_PX)
    top = STROMA_TOP - CHAMBER
    excess = LINE_CENTRE - CHAMBER - share * top

    def rise(d):
        return top * step(d / RISE_SIGMA_PX) + excess * bump(d)

    below, above = -5.0, LINE_DEPTH_PX
    for _ in range(60):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if rise(middle) < 0.5 * rise(LINE_DEPTH_PX) else (below, middle)
    edge = np.array([(step((d + below) / RISE_SIGMA_PX), bump(d + below)) for d in offset])
    posterior = np.array([1.0 - step(d / POSTERIOR_SIGMA_PX) for d in offset])
    return edge, posterior, share


def step(u: float) -> float:
    """Unit step blurred by a unit Gaussian."""
    return 0.5 * (1.0 + erf(u / sqrt(2.0)))


def bump(d: float) -> float:
    """Excess of the anterior line over the stroma, 1 at its peak."""
    return exp(-0.5 * ((d - LINE_DEPTH_PX) / LINE_SIGMA_PX) ** 2)


def backdrop(height: int, width: int, apex_column: float) -> np.ndarray:
    """Iris wedges [grey levels] and lens haze [share of its strength], shape [height, width, 2]."""
    row = np.arange(height)[:, None] / height
    column = np.arange(width)[None, :] / width
    iris = np.zeros((height, width))
    for from_side in (column, 1.0 - column):
        reach = from_side / 0.31
        upper = 0.735 + 0.25 * reach**1.15
        depth = (row - upper) * height
        lit = 0.5 * (1.0 + np.tanh(depth / 5.0)) * np.exp(-np.maximum(depth, 0.0) / (0.30 * height))
        strength = 14.0 + 68.0 * np.clip(1.0 - reach, 0.0, None) ** 1.3
        iris += lit * strength * np.exp(-9.0 * np.clip(reach - 0.8, 0.0, None))
    across = (column - apex_column / width) / 0.17
    haze = np.exp(-0.5 * across**2 - 0.5 * ((row - 1.03) / 0.15) ** 2)
    return np.stack([iris, haze], axis=-1)
