"""The Scheimpflug view: what a Corvis ST shows, 8-bit grey.

A slit of light in the meridional plane scatters in the cornea: strongly in the epithelium, a bright line blurred by the
optics, then in the stroma, fading with depth as the light is used up; the endothelium shows no line of its own but a
soft edge. The camera sees the posterior edge, and behind it iris and lens, through the anterior surface of that instant
(surface.py). Light falls off to the sides, a speck of the tear film shines now and then, the sensor adds its noise.
Grey levels and widths were measured on public frames of the instrument:

    air 6.5 +- 3.75, chamber 7.4 +- 3.9; anterior line 80-90 at the centre, 55-60 at the sides, rising over 5 px and 5
    px wide at half height; stroma 65 to 46 through its depth at the centre, 38-45 at +-2 mm, 30-34 at +-4 mm; posterior
    fall 46 to 10 over 6-7 px; iris 20-90 in the lower corners, lens 15-25 at the bottom; variance 12 + 0.24 grey level.

Every layer has its switch in [camera]; optics = "plain" draws the band between the two edges and nothing else.

Pixel (row i, column j) has its centre at x = (j - apex_column) pixel_x, z = z_apex,rest - (i - apex_row)
pixel_y.
"""

from math import erf, exp, sqrt

import numpy as np

from taichi_eye.backend import real
from taichi_eye.lang import ti
from taichi_eye.solver.workspace import capacity

from .glyphs import glyph_atlas, stamp
from .noise import gaussian_table, hash_u32, noise_key
from .state import FrameState
from .strips import Strips
from .surface import RAYS, Surface

AIR = 6.5
CHAMBER = 7.4
LINE_CENTRE, LINE_FALL = 85.0, 0.115  # peak of the anterior line on the axis; its fall-off [1/mm]
STROMA_TOP, STROMA_BOTTOM, STROMA_FALL = 65.0, 46.0, 0.195
FALL_CORE_MM = 0.5  # rounds the fall-off on the axis
RISE_SIGMA_PX = 2.2  # blur of the air-to-stroma step; the line rises in 4.5 px
LINE_SIGMA_PX, LINE_DEPTH_PX = 2.12, 2.4  # the line's excess over the stroma: FWHM 5 px
POSTERIOR_SIGMA_PX = 2.55  # 10-90 % in 6.5 px
NOISE_FLOOR, NOISE_GAIN = 12.0, 0.24  # variance = floor + gain * level
HAZE_REST, HAZE_DENTED = 9.0, 18.0  # lens haze over the chamber at rest and at 1 mm indentation
SPECK_SHARE = 0.12  # of the frames
SPECK_LEVEL, SPECK_SIGMA_PX = 520.0, 1.3  # saturates over some 4 px
PLAIN_BAND = 150.0
STAMP_LEVEL = 205
STEPS_PER_PX = 64  # the steepest edge moves by 0.2 grey levels in half a step
PROFILE_BEFORE_PX, PROFILE_AFTER_PX = 10, 14
SCENERY_MM = 0.05  # grid of iris and lens
SCENERY_REACH_MM, SCENERY_TOP_MM, SCENERY_BOTTOM_MM = 6.5, 1.5, -7.0
# placed so that at rest the wedges and the haze stand where the instrument's frames show them; z from the limbus plane
IRIS_RIM_MM, IRIS_PUPIL_MM, IRIS_HEIGHT_MM, IRIS_SLOPE = 4.5, 1.45, 0.22, 0.455
LENS_POLE_MM, LENS_RADIUS_MM, LENS_SIGMA_MM, LENS_DECAY_MM = -1.35, 10.0, (1.35, 0.48), 1.5
SMALLEST = 1 << 17  # pixels of a frame: smaller ones share one set of kernels
WIDEST = 4096  # columns
# of `Scheimpflug.numbers`; whole ones: of `Scheimpflug.size`
PIXEL_X, PIXEL_Y, APEX_ROW, APEX_COLUMN, APEX_REST, IRIS, LENS = range(7)
HEIGHT, WIDTH = range(2)
IRIS_ABOVE_MM, LENS_ABOVE_MM = 0.4, 0.1  # over the front of the iris, and z: higher up there is neither


@ti.data_oriented
class Scheimpflug:
    """Renders frames of shape [height_px, width_px], uint8.

    One `Surface` may be shared with another view, which then need not be updated twice for the same frame.

    A column is drawn from the top down: air, the cornea with its blur, the chamber, and from the row on where iris or
    lens show, those. Air and chamber are one level each, so their noise is a table of grey levels. Pixels lie in one
    row, column after column.

    capacity: pixels of the fields; any scene whose `frame_size` fits may be set up in them.
    """

    def __init__(self, scene, surface: Surface | None = None):
        self.surface = Surface(scene) if surface is None else surface
        self.capacity = held = capacity(frame_size(scene), SMALLEST)
        profile, self._line_stroma = edge_profiles()
        objects, table = scenery(), gaussian_table()
        self.profile = ti.Vector.field(3, ti.f32, len(profile))
        self.light = ti.Vector.field(2, ti.f32, WIDEST)  # on stroma and line
        self.scenery = ti.Vector.field(2, ti.f32, objects.shape[:2])
        self.quantile = ti.field(ti.f32, len(table))
        self.even = ti.Vector.field(2, ti.u8, len(table))  # air and chamber, by quantile
        self.mixed = ti.field(ti.u32, held)
        # light from behind the cornea on the surface's radii, and the row from which on there is any
        self.behind = ti.field(ti.f32, held)
        self.behind_from = ti.field(ti.i32, WIDEST)
        self.numbers, self.size = ti.field(real(), LENS + 1), ti.field(ti.i32, WIDTH + 1)
        self.across, self.out = Strips(WIDEST), Strips(WIDEST)
        self._load_still(profile, objects)
        self.setup(scene)

    def setup(self, scene) -> None:
        """Take camera, seed and frame times from another scene that fits; a shared surface is set up by itself."""
        camera = scene.camera
        self.seed, self.interval_ms = camera.seed, camera.frame_interval_ms
        self.height, self.width = camera.height_px, camera.width_px
        self.apex_column, self.plain, self.specks = camera.apex_column_px, camera.optics == "plain", camera.specks
        letters = glyph_atlas(max(8, round(0.065 * self.height)))
        self.atlas = letters if camera.stamp else None
        self.marks = (letters, round(1.0 / camera.pixel_x_mm)) if camera.marks else None  # and the bar [px]
        numbers = {
            PIXEL_X: camera.pixel_x_mm * 1e-3,
            PIXEL_Y: camera.pixel_y_mm * 1e-3,
            APEX_ROW: camera.apex_row_px,
            APEX_COLUMN: camera.apex_column_px,
            APEX_REST: self.surface.apex_rest,
            IRIS: camera.iris,
            LENS: camera.lens,
        }
        quantile = gaussian_table() * camera.noise
        self._load(
            np.array([numbers[k] for k in range(len(numbers))], dtype=float),
            np.array([self.height, self.width], dtype=np.int32),
            self._lights(camera, self._line_stroma),
            quantile,
            np.stack([grey_levels(level, quantile) for level in (AIR, CHAMBER)], axis=-1),
        )

    def render(self, state: FrameState, fresh: bool = True) -> np.ndarray:
        """The frame at `state`; `fresh` says that the surface tables have yet to be updated for it."""
        if fresh:
            self.surface.update(state.wall, state.wall_count)
        image = np.empty((self.height, self.width), np.uint8)
        if self.plain:
            self._render_plain(image, state.retreat_mm * 1e-3)
        else:
            frame = round(state.time_ms / self.interval_ms)
            self._render(image, noise_key(self.seed, frame), state.retreat_mm * 1e-3, self._speck_column(frame))
        if self.atlas is not None:
            mask = self.atlas.mask(f"{state.time_ms:.2f} ms")
            stamp(image, mask, self.height - mask.shape[0] - 3, self.width - mask.shape[1] - 6, STAMP_LEVEL)
        if self.marks is not None:
            self._mark(image, *self.marks, state.passed)
        return image

    def _mark(self, image: np.ndarray, letters, bar: int, passed: str) -> None:
        """A bar of 1 mm in the lower left corner, what it means, and the line beside them, in place."""
        bottom = self.height - 5
        image[bottom - 1 : bottom + 1, 6 : 6 + bar] = STAMP_LEVEL
        image[bottom - 4 : bottom + 4, [6, 5 + bar]] = STAMP_LEVEL
        said = letters.mask("1 mm" + (f"   {passed}" if passed else ""))
        stamp(image, said, self.height - said.shape[0] - 3, 12 + bar, STAMP_LEVEL)

    def _lights(self, camera, line_stroma: float) -> np.ndarray:
        """Brightness of stroma and anterior line over the chamber in each column, shape [width, 2]."""
        x_mm = (np.arange(self.width) - self.apex_column) * camera.pixel_x_mm
        off_mm = camera.fall_off * (np.hypot(x_mm, FALL_CORE_MM) - FALL_CORE_MM)
        stroma = camera.stroma * (STROMA_TOP - CHAMBER) * np.exp(-STROMA_FALL * off_mm)
        line = (LINE_CENTRE - CHAMBER) * np.exp(-LINE_FALL * off_mm) - line_stroma * stroma
        return np.column_stack([stroma, camera.epithelium * np.maximum(line, 0.0)])

    @ti.kernel
    def _load_still(self, profile: ti.types.ndarray(), objects: ti.types.ndarray()):
        for k in range(profile.shape[0]):
            self.profile[k] = ti.Vector([profile[k, 0], profile[k, 1], profile[k, 2]])
        for i, k in ti.ndrange(objects.shape[0], objects.shape[1]):
            self.scenery[i, k] = ti.Vector([objects[i, k, 0], objects[i, k, 1]])

    @ti.kernel
    def _load(
        self,
        numbers: ti.types.ndarray(),
        size: ti.types.ndarray(),
        light: ti.types.ndarray(),
        quantile: ti.types.ndarray(),
        even: ti.types.ndarray(),
    ):
        # as few loops as may be: each costs compile time
        height, width = size[HEIGHT], size[WIDTH]
        for k in range(height * width + quantile.shape[0]):
            if k < numbers.shape[0]:
                self.numbers[k] = numbers[k]
            if k < size.shape[0]:
                self.size[k] = size[k]
            if k < quantile.shape[0]:
                self.quantile[k], self.even[k] = quantile[k], ti.Vector([even[k, 0], even[k, 1]])
            if k < width:
                self.light[k] = ti.Vector([light[k, 0], light[k, 1]])
            if k < height * width:
                self.mixed[k] = hash_u32(ti.cast(k % height * width + k // height, ti.u32))

    def _speck_column(self, frame: int) -> float:
        """Column of this frame's speck; far outside where it has none."""
        if not self.specks:
            return -1e3
        draw = np.random.default_rng([self.seed, frame, 1])
        if draw.random() >= SPECK_SHARE:
            return -1e3
        return self.apex_column + draw.normal(0.0, 0.15 * self.width)

    @ti.func
    def column(self, j, retreat):
        """Row of the anterior edge, apparent thickness and tilt of column j."""
        x = (j - self.numbers[APEX_COLUMN]) * self.numbers[PIXEL_X]
        z = self.surface.at(self.surface.height, x)
        slope = self.surface.at(self.surface.slope, x) * self.numbers[PIXEL_X] / self.numbers[PIXEL_Y]
        depth = (z - self.surface.at(self.surface.apparent, x)) / self.numbers[PIXEL_Y]
        return ti.Vector([self.row_of(z, retreat), ti.max(depth, 1.0), 1.0 / ti.sqrt(1.0 + slope * slope)])

    @ti.kernel
    def _render(self, image: ti.types.ndarray(), key: ti.u32, retreat: float, speck: float):
        for turn in range(self.out.turns):
            if self.out.draws(turn):
                columns = self.surface.used[1]
                for k in range(self.out.first(turn, columns), self.out.after(turn, columns)):
                    self.look_behind(k, retreat)
        for turn in range(self.across.turns):
            if self.across.draws(turn):
                for j in range(self.across.first(turn, self.size[WIDTH]), self.across.after(turn, self.size[WIDTH])):
                    self.draw_column(image, j, key, retreat, speck)

    @ti.kernel
    def _render_plain(self, image: ti.types.ndarray(), retreat: float):
        for turn in range(self.across.turns):
            if self.across.draws(turn):
                for j in range(self.across.first(turn, self.size[WIDTH]), self.across.after(turn, self.size[WIDTH])):
                    self.draw_band(image, j, retreat)

    @ti.func
    def draw_column(self, image: ti.template(), j, key, retreat, speck):
        """Air, cornea, chamber, iris and lens of column j."""
        row, thickness, tilt = self.column(j, retreat)
        stroma, line = self.light[j]
        loss = (STROMA_TOP - STROMA_BOTTOM) / (STROMA_TOP - CHAMBER) * stroma / thickness
        begin = self.row_from(row - PROFILE_BEFORE_PX / tilt)
        end = ti.max(self.row_from(row + thickness + PROFILE_AFTER_PX / tilt), begin)
        k, share = self.surface.between(abs(j - self.numbers[APEX_COLUMN]) * self.numbers[PIXEL_X])
        height = self.size[HEIGHT]
        here, near, far = j * height, k * height, (k + 1) * height
        lit = ti.min(self.behind_from[k], self.behind_from[k + 1])
        dark = ti.max(lit, end)
        # one loop: each more would cost compile time, its branches cost little
        for i in range(height):
            number = ti.cast(hash_u32(self.mixed[here + i] ^ key) >> 20, ti.i32)
            if i < begin:
                image[i, j] = self.even[number][0]
            elif i >= end and i < dark:
                image[i, j] = self.even[number][1]
            else:
                behind = 0.0
                if i >= lit:
                    behind = self.behind[near + i] + share * (self.behind[far + i] - self.behind[near + i])
                level = CHAMBER + behind
                if i < end:
                    # step across the anterior surface, the line's excess, step across the posterior surface
                    depth = i - row
                    rise, excess, _ = self.look_up(depth * tilt)
                    inside = self.look_up((depth - thickness) * tilt)[2]
                    body = stroma - loss * ti.math.clamp(depth, 0.0, thickness)
                    level = AIR + rise * (CHAMBER - AIR + inside * body + (1.0 - inside) * behind) + excess * line
                    if abs(j - speck) < 8.0:
                        off = ((j - speck) ** 2 + (depth - LINE_DEPTH_PX) ** 2) / (SPECK_SIGMA_PX * SPECK_SIGMA_PX)
                        level += SPECK_LEVEL * ti.exp(-0.5 * off)
                noise = ti.sqrt(NOISE_FLOOR + NOISE_GAIN * level) * self.quantile[number]
                image[i, j] = ti.cast(ti.math.clamp(level + noise + 0.5, 0.0, 255.0), ti.u8)

    @ti.func
    def draw_band(self, image: ti.template(), j, retreat):
        """The band between the two edges in column j, and nothing else."""
        row, thickness, _ = self.column(j, retreat)
        for i in range(self.size[HEIGHT]):
            cover = ti.math.clamp(i - row + 0.5, 0.0, 1.0) - ti.math.clamp(i - row - thickness + 0.5, 0.0, 1.0)
            image[i, j] = ti.cast(PLAIN_BAND * cover + 0.5, ti.u8)

    @ti.func
    def row_of(self, z, retreat):
        """Row of a height [m] over the limbus plane."""
        return self.numbers[APEX_ROW] + (self.numbers[APEX_REST] - z + retreat) / self.numbers[PIXEL_Y]

    @ti.func
    def row_from(self, row):
        """The first row of the image at or below `row`."""
        return ti.math.clamp(ti.cast(ti.ceil(row), ti.i32), 0, self.size[HEIGHT])

    @ti.func
    def look_up(self, offset):
        """The cross-sections nearest to `offset` px from their edge, constant beyond their ends."""
        t = ti.math.clamp((offset + PROFILE_BEFORE_PX) * STEPS_PER_PX + 0.5, 0.0, self.profile.shape[0] - 1.0)
        return self.profile[ti.max(ti.cast(t, ti.i32), 0)]

    @ti.func
    def look_behind(self, k, retreat):
        """Light of iris and lens along the rays of the k-th radius, down the rows."""
        dent = ti.math.clamp((self.numbers[APEX_REST] - self.surface.height[0]) * 1e3, 0.0, 1.5)
        haze = self.numbers[LENS] * (HAZE_REST + (HAZE_DENTED - HAZE_REST) * dent)
        top = self.row_from(self.row_of(self.surface.height[k], retreat))
        height, iris_shown = self.size[HEIGHT], self.numbers[IRIS]
        lit = height
        # between two rays place in the lit plane goes evenly with the row; straight on before the first, beyond the
        # last
        n = 0
        row, following, start, rate = self.between_rays(k, n, retreat)
        for i in range(height):
            while n < RAYS - 2 and i >= following:
                n += 1
                row, following, start, rate = self.between_rays(k, n, retreat)
            x, z = start + (i - row) * rate
            light = 0.0
            front = (IRIS_HEIGHT_MM + IRIS_ABOVE_MM + IRIS_SLOPE * (abs(x) * 1e3 - IRIS_RIM_MM)) * 1e-3
            if i >= top and z < ti.max(front, LENS_ABOVE_MM * 1e-3):
                iris, lens = self.scenery_at(x, z)
                light = iris_shown * iris + haze * lens
                lit = ti.min(lit, i)
            self.behind[k * height + i] = light
        self.behind_from[k] = lit

    @ti.func
    def between_rays(self, k, n, retreat):
        """Rows of the n-th ray of the k-th radius and of the next, the (x, z) that the first shows, and its change per
        row."""
        a = self.surface.behind[k, n]
        b = self.surface.behind[k, n + 1]
        rate = (b - a) * (self.numbers[PIXEL_Y] / ti.max(a[0] - b[0], 1e-9))
        return (
            self.row_of(a[0], retreat),
            self.row_of(b[0], retreat),
            ti.Vector([a[1], a[2]]),
            ti.Vector([rate[1], rate[2]]),
        )

    @ti.func
    def scenery_at(self, x, z):
        """Light of the iris [grey levels] and share of the lens haze at (x, z) [m] of the lit plane."""
        u = ti.math.clamp(abs(x) * (1e3 / SCENERY_MM), 0.0, self.scenery.shape[0] - 1.001)
        v = ti.math.clamp((SCENERY_TOP_MM - z * 1e3) / SCENERY_MM, 0.0, self.scenery.shape[1] - 1.001)
        i = ti.max(ti.cast(u, ti.i32), 0)
        k = ti.max(ti.cast(v, ti.i32), 0)
        p = u - i
        q = v - k
        return (1.0 - q) * ((1.0 - p) * self.scenery[i, k] + p * self.scenery[i + 1, k]) + q * (
            (1.0 - p) * self.scenery[i, k + 1] + p * self.scenery[i + 1, k + 1]
        )


def frame_size(scene) -> int:
    """Pixels of a frame, and no fewer than the rays behind its columns take."""
    camera = scene.camera
    return camera.height_px * (camera.width_px + 4)


def grey_levels(level: float, quantile: np.ndarray) -> np.ndarray:
    """What the sensor reads of an even `level`, by quantile of its noise, uint8."""
    noise = np.sqrt(NOISE_FLOOR + NOISE_GAIN * level) * quantile
    return np.clip(level + noise + 0.5, 0.0, 255.0).astype(np.uint8)


def edge_profiles() -> tuple[np.ndarray, float]:
    """Cross-sections tabulated over the distance from an edge along its normal, -10..14 px in 1/64 px.

    Returns the anterior step, the line's excess and the posterior step (1 inside the stroma, 0 behind), shape [n, 3],
    and the share of the stroma's brightness under the peak of the line. The anterior table is shifted so that on the
    axis half the rise to the peak lies on the surface itself.
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
    profile = [(step((d + below) / RISE_SIGMA_PX), bump(d + below), 1.0 - step(d / POSTERIOR_SIGMA_PX)) for d in offset]
    return np.array(profile), share


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
    haze = np.exp(
        -0.5 * (x / LENS_SIGMA_MM[0]) ** 2
        - 0.5 * (np.maximum(above, 0.0) / LENS_SIGMA_MM[1]) ** 2
        + np.minimum(above, 0.0) / LENS_DECAY_MM
    )
    return np.stack([iris, haze], axis=-1)
