"""The Scheimpflug view: what a Corvis ST shows, 8-bit grey.

A slit of light in the meridional plane scatters in the cornea: strongly in the epithelium, a bright line blurred by the
optics, then in the stroma, fading with depth as the light is used up; the endothelium shows no line of its own but a
soft edge. The camera sees the posterior edge, and behind it iris and lens, through the anterior surface of that instant
(surface.py). Light falls off to the sides, a speck of the tear film shines now and then, the sensor adds its noise.
Grey levels and widths were measured on public frames of the instrument:

    air 6.5 +- 3.75, chamber 7.4 +- 3.9; anterior line 80-90 at the centre, 55-60 at the sides, rising over 5 px and 5 px
    wide at half height; stroma 65 to 46 through its depth at the centre, 38-45 at +-2 mm, 30-34 at +-4 mm; posterior
    fall 46 to 10 over 6-7 px; iris 20-90 in the lower corners, lens 15-25 at the bottom; variance 12 + 0.24 grey level.

Every layer has its switch in [camera]; optics = "plain" draws the band between the two edges and nothing else.

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
SPECK_SHARE = 0.12                           # of the frames
SPECK_LEVEL, SPECK_SIGMA_PX = 520.0, 1.3     # saturates over some 4 px
PLAIN_BAND = 150.0
STAMP_LEVEL = 205
STEPS_PER_PX = 16
PROFILE_BEFORE_PX, PROFILE_AFTER_PX = 10, 14
SCENERY_MM = 0.05                            # grid of iris and lens
SCENERY_REACH_MM, SCENERY_TOP_MM, SCENERY_BOTTOM_MM = 6.5, 1.5, -7.0
# placed so that at rest the wedges and the haze stand where the instrument's frames show them; z from the limbus plane
IRIS_RIM_MM, IRIS_PUPIL_MM, IRIS_HEIGHT_MM, IRIS_SLOPE = 4.5, 1.45, 0.22, 0.455
LENS_POLE_MM, LENS_RADIUS_MM, LENS_SIGMA_MM, LENS_DECAY_MM = -1.35, 10.0, (1.35, 0.48), 1.5
IRIS_ABOVE_MM, LENS_ABOVE_MM = 0.4, 0.1      # over the front of the iris, and z: higher up there is neither


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
        self.plain = camera.optics == "plain"
        self.epithelium, self.stroma = float(camera.epithelium), float(camera.stroma)
        self.iris, self.lens, self.fall_off = float(camera.iris), float(camera.lens), float(camera.fall_off)
        self.specks, self.noise, self.seed = camera.specks, camera.noise, camera.seed
        self.interval_ms = camera.frame_interval_ms
        self.atlas = GlyphAtlas(max(8, round(0.065 * self.height))) if camera.stamp else None

        edge, posterior, line_stroma = edge_profiles()
        self.line_stroma = line_stroma
        objects = scenery()
        self.edge = ti.Vector.field(2, real(), len(edge))
        self.posterior = ti.field(real(), len(posterior))
        self.column = ti.Vector.field(5, real(), self.width)
        self.scenery = ti.Vector.field(2, real(), objects.shape[:2])
        self.quantile = ti.field(real(), len(gaussian_table()))
        self._load(edge, posterior, objects, gaussian_table())

    def render(self, state: FrameState, fresh: bool = True) -> np.ndarray:
        """The frame at `state`; `fresh` says that the surface tables have yet to be updated for it."""
        if fresh:
            self.surface.update(state.wall, state.wall_count)
        image = np.empty((self.height, self.width), np.uint8)
        if self.plain:
            self._render_plain(image, state.retreat_mm * 1e-3)
        else:
            frame = round(state.time_ms / self.interval_ms)
            self._render(image, noise_key(self.seed, frame), 1 if self.noise else 0, state.retreat_mm * 1e-3,
                         self._speck_column(frame))
        if self.atlas is not None:
            mask = self.atlas.mask(f"{state.time_ms:.2f} ms")
            stamp(image, mask, self.height - mask.shape[0] - 3, self.width - mask.shape[1] - 6, STAMP_LEVEL)
        return image

    @ti.kernel
    def _load(self, edge: ti.types.ndarray(), posterior: ti.types.ndarray(), objects: ti.types.ndarray(),
              quantile: ti.types.ndarray()):
        for k in range(edge.shape[0]):
            self.edge[k], self.posterior[k] = ti.Vector([edge[k, 0], edge[k, 1]]), posterior[k]
        for i, k in ti.ndrange(objects.shape[0], objects.shape[1]):
            self.scenery[i, k] = ti.Vector([objects[i, k, 0], objects[i, k, 1]])
        for k in range(quantile.shape[0]):
            self.quantile[k] = quantile[k]

    def _speck_column(self, frame: int) -> float:
        """Column of this frame's speck; far outside where it has none."""
        draw = np.random.default_rng([self.seed, frame, 1])
        if not self.specks or draw.random() >= SPECK_SHARE:
            return -1e3
        return self.apex_column + draw.normal(0.0, 0.15 * self.width)

    @ti.func
    def set_column(self, j, retreat):
        """Row of the anterior edge, apparent thickness, tilt, and the light on stroma and line of column j."""
        x = (j - self.apex_column) * self.pixel_x
        z = self.surface.at(self.surface.height, x)
        slope = self.surface.at(self.surface.slope, x) * self.pixel_x / self.pixel_y
        depth = (z - self.surface.at(self.surface.apparent, x)) / self.pixel_y
        off_mm = self.fall_off * (ti.sqrt((x * 1e3) ** 2 + FALL_CORE_MM**2) - FALL_CORE_MM)
        stroma = self.stroma * (STROMA_TOP - CHAMBER) * ti.exp(-STROMA_FALL * off_mm)
        line = (LINE_CENTRE - CHAMBER) * ti.exp(-LINE_FALL * off_mm) - self.line_stroma * stroma
        row = self.apex_row + (self.apex_rest - z + retreat) / self.pixel_y
        tilt = 1.0 / ti.sqrt(1.0 + slope * slope)
        self.column[j] = ti.Vector([row, ti.max(depth, 1.0), tilt, stroma, self.epithelium * ti.max(line, 0.0)])

    @ti.kernel
    def _render(self, image: ti.types.ndarray(), key: ti.u32, noisy: ti.i32, retreat: float, speck: float):
        for j in range(self.width):
            self.set_column(j, retreat)
        dent = ti.math.clamp((self.apex_rest - self.surface.height[0]) * 1e3, 0.0, 1.5)
        haze = self.lens * (HAZE_REST + (HAZE_DENTED - HAZE_REST) * dent)
        for i, j in ti.ndrange(self.height, self.width):
            row, thickness, tilt, stroma, line = self.column[j]
            depth = i - row
            level = 0.0 * depth + AIR
            if depth * tilt > -PROFILE_BEFORE_PX:
                behind = 0.0
                if depth > 0.5 * thickness:
                    apparent = self.apex_rest + retreat - (i - self.apex_row) * self.pixel_y
                    x, z = self.surface.through((j - self.apex_column) * self.pixel_x, apparent)
                    front = (IRIS_HEIGHT_MM + IRIS_ABOVE_MM + IRIS_SLOPE * (abs(x) * 1e3 - IRIS_RIM_MM)) * 1e-3
                    if z < ti.max(front, LENS_ABOVE_MM * 1e-3):
                        iris, lens = self.scenery_at(x, z)
                        behind = self.iris * iris + haze * lens
                level = CHAMBER + behind
                if (depth - thickness) * tilt < PROFILE_AFTER_PX:
                    # step across the anterior surface, the line's excess, step across the posterior surface
                    edge = look_up(self.edge, depth * tilt)
                    inside = look_up(self.posterior, (depth - thickness) * tilt)
                    share = ti.math.clamp(depth / thickness, 0.0, 1.0)
                    body = stroma * (1.0 - (STROMA_TOP - STROMA_BOTTOM) / (STROMA_TOP - CHAMBER) * share)
                    level = (AIR + edge[0] * (CHAMBER - AIR + inside * body + (1.0 - inside) * behind)
                             + edge[1] * line)
                    if abs(j - speck) < 8.0:
                        off = ((j - speck) ** 2 + (depth - LINE_DEPTH_PX) ** 2) / (SPECK_SIGMA_PX * SPECK_SIGMA_PX)
                        level += SPECK_LEVEL * ti.exp(-0.5 * off)
            if noisy != 0:
                draw = hash_u32(hash_u32(ti.cast(i * self.width + j, ti.u32)) ^ key)
                normal = self.quantile[ti.cast(draw >> 20, ti.i32)]
                level += ti.sqrt(NOISE_FLOOR + NOISE_GAIN * level) * normal
            image[i, j] = ti.cast(ti.math.clamp(level + 0.5, 0.0, 255.0), ti.u8)

    @ti.kernel
    def _render_plain(self, image: ti.types.ndarray(), retreat: float):
        for j in range(self.width):
            self.set_column(j, retreat)
        for i, j in ti.ndrange(self.height, self.width):
            depth = i - self.column[j][0]
            thickness = self.column[j][1]
            cover = ti.math.clamp(depth + 0.5, 0.0, 1.0) - ti.math.clamp(depth - thickness + 0.5, 0.0, 1.0)
            image[i, j] = ti.cast(PLAIN_BAND * cover + 0.5, ti.u8)

    @ti.func
    def scenery_at(self, x, z):
        """Light of the iris [grey levels] and share of the lens haze at (x, z) [m] of the lit plane."""
        u = ti.math.clamp(abs(x) * (1e3 / SCENERY_MM), 0.0, self.scenery.shape[0] - 1.001)
        v = ti.math.clamp((SCENERY_TOP_MM - z * 1e3) / SCENERY_MM, 0.0, self.scenery.shape[1] - 1.001)
        i = ti.max(ti.cast(u, ti.i32), 0)
        k = ti.max(ti.cast(v, ti.i32), 0)
        p = u - i
        q = v - k
        return ((1.0 - q) * ((1.0 - p) * self.scenery[i, k] + p * self.scenery[i + 1, k])
                + q * ((1.0 - p) * self.scenery[i, k + 1] + p * self.scenery[i + 1, k + 1]))


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


def scenery() -> np.ndarray:
    """Iris [grey levels] and lens haze [share of its strength] over the lit plane, shape [|x|, depth, 2].

    Even in x; steps of SCENERY_MM, x from the axis outwards, z from SCENERY_TOP_MM downwards. Light is strongest on the
    front of the iris and dies out behind it; the iris is brighter towards its root.
    """
    x = np.arange(0.0, SCENERY_REACH_MM + SCENERY_MM / 2, SCENERY_MM)[:, None]
    z = np.arange(SCENERY_TOP_MM, SCENERY_BOTTOM_MM - SCENERY_MM / 2, -SCENERY_MM)[None, :]
    front = IRIS_HEIGHT_MM - IRIS_SLOPE * (IRIS_RIM_MM - x)
    depth = front - z
    lit = 0.5 * (1.0 + np.tanh(depth / 0.13)) * np.exp(-np.maximum(depth, 0.0) / 1.6)
    outwards = np.clip((x - IRIS_PUPIL_MM) / (IRIS_RIM_MM - IRIS_PUPIL_MM), 0.0, 1.2)
    margin = 1.0 / (1.0 + np.exp(-(x - IRIS_PUPIL_MM - 0.15) / 0.12))
    iris = lit * margin * (14.0 + 78.0 * outwards**1.3)
    above = z - (LENS_POLE_MM - 0.5 * x**2 / LENS_RADIUS_MM)
    haze = np.exp(-0.5 * (x / LENS_SIGMA_MM[0]) ** 2 - 0.5 * (np.maximum(above, 0.0) / LENS_SIGMA_MM[1]) ** 2
                  + np.minimum(above, 0.0) / LENS_DECAY_MM)
    return np.stack([iris, haze], axis=-1)
