"""The technical view: the fluid's nodes coloured by pressure or speed, the membrane, the puff and the apex
trace.

What never changes (chamber walls, axes, labels, colour bar) is rasterised once; a kernel draws over it
what the current fields show and nothing else. Every pixel takes the node nearest to it, found by an integer
minimum over (distance, colour), which does not depend on the order of nodes. The section is drawn for
r >= 0 and mirrored, column by column from the puff down to the back.

The colour limits are those of the scene, fixed for the whole film: speed from 0 to 0.018 m/s per kPa of the
puff's peak, which the default eye comes to under the edge of its dent; pressure from the IOP to the IOP plus a
quarter of the puff's peak (a sealed chamber gains about a fifth of it, everywhere alike).
"""

from dataclasses import dataclass
from math import ceil, floor, log10

import matplotlib
import numpy as np
from PIL import Image, ImageDraw

from taichi_eye.backend import real
from taichi_eye.eye.eye import eye_of
from taichi_eye.lang import ti
from taichi_eye.solver.workspace import capacity
from taichi_eye.units import KPA, MM, MMHG, MS

from .glyphs import font, glyph_atlas, stamp
from .state import FrameState
from .strips import Strips
from .surface import Surface

BACKGROUND = (13, 17, 26)
TEXT, FAINT, GRID = (216, 222, 233), (128, 140, 160), (36, 44, 60)
MEMBRANE, WALL = (250, 244, 230), (98, 109, 130)
JET, TRACE = (96, 190, 255), (255, 196, 92)
COLOURMAPS = {"pressure": "viridis", "speed": "plasma"}
DARKEST = 0.12  # start of the colour map: its first colours drown in the background
FILL = 0.34  # brightness of the space between nodes, of their colour
FILL_FLOOR = (8.0, 10.0, 16.0)
EMPTY = 0xFFFFFFFF
SHADE_BITS = 8  # of the nearest-node word; the distance takes the other 24
DISTANCES = 1 << (32 - SHADE_BITS)
COVER_BITS = 12  # of the distance, that tell what a disc covers
COVERS = 1 << COVER_BITS
SMALLEST = 1 << 17  # pixels of half a section: smaller ones share one set of kernels
LONGEST = 4096  # rows and columns
# of `Particles.numbers`; whole ones: of `Particles.places`
PX_PER_M, LIMBUS_ROW, LINE, CURVE, BY_SPEED = range(5)
HEIGHT, HALF, AXIS, RIM, LEFT, TOP, RIGHT, BOTTOM = range(8)


@dataclass(frozen=True)
class Layout:
    """Places in the image [px]; lengths scale with its width."""

    width: int
    height: int
    unit: float  # px per 1/1152 of the width
    scale: float  # px/mm of the section
    axis: int  # column of the axis: the boundary between columns axis-1 and axis
    limbus_row: float  # row of z = 0
    half: int  # columns of half a section
    plot: tuple[int, int, int, int]  # left, top, right, bottom of the trace's axes

    @classmethod
    def of(cls, scene) -> "Layout":
        width = 2 * scene.camera.width_px
        unit = width / 1152
        section = eye_of(scene).section
        cap, back = section.apex_z / MM, -section.back_z / MM
        panel = 0.68 * width
        above, below = 1.30, 0.12  # mm over the apex for the puff, under the back plane
        room = 268 * unit
        half_mm = scene.cornea.limbus_radius_mm + 0.42
        scale = min(0.5 * panel / half_mm, room / (above + cap + back + below))
        height = 2 * round(160 * unit)
        limbus_row = height - 52 * unit - (back + below) * scale
        half = ceil(half_mm * scale)
        plot = (round(848 * unit), round(64 * unit), round(1098 * unit), height - round(46 * unit))
        return cls(width, height, unit, scale, round(0.5 * panel + 8 * unit), limbus_row, half, plot)


@ti.data_oriented
class Particles:
    """Renders frames of shape [height, width, 3], uint8, twice as wide as the Scheimpflug view.

    One `Surface` may be shared with another view, which then need not be updated twice for the same frame.
    `stamped` writes the time into the upper left corner. capacity: pixels of half a section that the fields hold; any
    scene whose `section_size` fits may be set up in them.
    """

    def __init__(self, scene, surface: Surface | None = None, stamped: bool = True):
        self.surface = Surface(scene) if surface is None else surface
        self.capacity = held = capacity(section_size(scene), SMALLEST)
        # by columns from the axis outwards, then rows, in one row
        self.nearest, self.wall = ti.field(ti.u32, held), ti.field(ti.u8, held)
        self.floor = ti.field(ti.i32, LONGEST)
        self.column = ti.Vector.field(3, real(), LONGEST)  # row of the cornea, its tilt, the load there
        self.rows = ti.Vector.field(2, ti.i32, LONGEST)  # that may show liquid: the first, and after the last
        self.colours = ti.Vector.field(3, ti.f32, 256)
        self.cover = ti.field(ti.f32, COVERS)  # of a disc, by the distance in a nearest-node word
        self.glow = ti.field(ti.f32, LONGEST)  # of the jet, by rows over the cornea
        self.numbers, self.places = ti.field(real(), BY_SPEED + 1), ti.field(ti.i32, BOTTOM + 1)
        self.out, self.over = Strips(LONGEST), Strips(LONGEST)
        self.setup(scene, stamped)

    def setup(self, scene, stamped: bool) -> None:
        """Take camera, colours, node size, load, axes and shape of the eye from another scene that fits; a shared
        surface is set up by itself."""
        self.stamped, self.layout = stamped, Layout.of(scene)
        at = self.layout
        self.left, self.top, self.right, self.bottom = at.plot
        self.marker = 4.4 * at.unit
        self.radii = np.arange(self.surface.count) * self.surface.spacing
        self.big = glyph_atlas(max(8, round(21 * at.unit)))
        self.small = glyph_atlas(max(7, round(13 * at.unit)), bold=True)
        self.limits, self.ranges, self.peak_kpa = colour_limits(scene), plot_ranges(scene), peak_load_kpa(scene)
        self.puff_profile = eye_of(scene).puff.radial(self.radii)
        spacing_px = scene.numerics.spacing_mm * at.scale
        disc = max(0.44 * spacing_px, 0.6)
        self.reach = max(0.80 * spacing_px, 1.5)
        self.distance_steps = (DISTANCES - 1.0) / (self.reach + 1.0) ** 2
        wall = wall_cover(scene, at)
        ground = background(scene, at, self.limits, self.ranges)
        self.still = (ground + wall[..., None] / 255.0 * (np.array(WALL) - ground) + 0.5).astype(np.uint8)
        distance = np.sqrt((np.arange(COVERS) + 0.5) * (DISTANCES / COVERS / self.distance_steps))
        section = np.ascontiguousarray(wall[:, at.axis : at.axis + at.half].T)
        numbers = {
            PX_PER_M: at.scale / MM,
            LIMBUS_ROW: at.limbus_row,
            LINE: 1.7 * at.unit,
            CURVE: 1.1 * at.unit,
            BY_SPEED: scene.camera.colour_by == "speed",
        }
        rim = round(scene.cornea.limbus_radius_mm * at.scale)
        places = np.array([at.height, at.half, at.axis, rim, *at.plot], dtype=np.int32)
        self._load(
            colour_table(scene),
            np.clip(disc + 0.5 - distance, 0.0, 1.0),
            # an even beam, brighter where it stops on the cornea
            0.46 + 0.30 * np.exp(-np.arange(at.height + 2) / (0.25 * at.scale)),
            section,
            floor_rows(section),
            np.array([numbers[k] for k in range(len(numbers))], dtype=float),
            places,
        )

    @property
    def height(self) -> int:
        """Rows of a frame."""
        return self.layout.height

    @property
    def width(self) -> int:
        """Columns of a frame."""
        return self.layout.width

    def render(self, state: FrameState, fresh: bool = True, out: np.ndarray | None = None) -> np.ndarray:
        """The frame at `state`, in `out` (contiguous) where that is given; `fresh` says that the surface tables have
        yet to be updated for it.
        """
        if fresh:
            self.surface.update(state.wall, state.wall_count)
        image = np.empty(self.still.shape, np.uint8) if out is None else out
        image[...] = self.still
        profile = self.puff_profile
        puff_kpa = state.trace_puff_kpa[-1] if len(state.trace_puff_kpa) else 0.0
        if state.puff_radial is not None and np.max(np.abs(state.puff_radial)) > 0.0:
            wall = state.wall if isinstance(state.wall, np.ndarray) else state.wall.to_numpy()
            wall_r = wall[: state.wall_count, 0]
            profile = np.interp(self.radii, wall_r, state.puff_radial, right=0.0)
            profile /= np.max(np.abs(state.puff_radial))
        curves, head, now = self.curve_columns(state)
        self._draw(
            image,
            state.nodes,
            state.node_count,
            state.pressure,
            state.velocity,
            self.limits[0],
            self.limits[1] - self.limits[0],
            self.reach,
            self.distance_steps,
            profile.astype(np.float32),
            puff_kpa / self.peak_kpa,
            curves,
            now,
        )
        self.mark(image, *head)
        self.label(image, state, puff_kpa)
        return image

    def curve_columns(self, state: FrameState) -> tuple[np.ndarray, tuple[float, float], int]:
        """Rows of the apex and the load curve in every column of the plot, shape [columns, 2] float32, the
        marker (column, row) of the present, and the last column that has a past."""
        columns = np.arange(self.left, self.right + 1)
        time = (columns - self.left) / (self.right - self.left) * self.ranges.time_ms
        rows = np.full((len(columns), 2), self.bottom, np.float32)
        if not len(state.trace_time_ms):
            return rows, (-100.0, -100.0), -1
        apex = self.row_of(np.asarray(state.trace_apex_mm), self.ranges.apex_low_mm, self.ranges.apex_high_mm)
        load = self.row_of(np.asarray(state.trace_puff_kpa), 0.0, self.ranges.puff_kpa)
        rows[:, 0] = np.interp(time, state.trace_time_ms, apex)
        rows[:, 1] = np.interp(time, state.trace_time_ms, load)
        reached = min(state.trace_time_ms[-1] / self.ranges.time_ms, 1.0) * (self.right - self.left)
        return rows, (float(self.left + reached), float(apex[-1])), int(reached)

    def mark(self, image: np.ndarray, column: float, row: float) -> None:
        """A dot at the present, in place."""
        size = ceil(self.marker + 0.5)
        left, top = round(column) - size, round(row) - size
        places = np.arange(2 * size + 1)
        gone = np.hypot(left + places - column, (top + places - row)[:, None])
        stamp(image, np.clip(self.marker + 0.5 - gone, 0.0, 1.0), top, left, TRACE)

    def row_of(self, value: np.ndarray, low: float, high: float) -> np.ndarray:
        share = (value - low) / (high - low)
        return np.clip(self.bottom - share * (self.bottom - self.top), self.top, self.bottom)

    def label(self, image: np.ndarray, state: FrameState, puff_kpa: float) -> None:
        """The time and the present values, in place."""
        unit = self.layout.unit
        if self.stamped:
            stamp(image, self.big.mask(f"{state.time_ms:.2f} ms"), round(14 * unit), round(20 * unit), TEXT)
        if len(state.trace_apex_mm):
            row = round(30 * unit)
            apex = self.small.mask(f"{state.trace_apex_mm[-1]:.3f} mm")
            load = self.small.mask(f"{puff_kpa:.2f} kPa")
            stamp(image, apex, row, self.left, TRACE)
            stamp(image, load, row, self.right - load.shape[1], JET)

    @ti.kernel
    def _load(
        self,
        colours: ti.types.ndarray(),
        cover: ti.types.ndarray(),
        glow: ti.types.ndarray(),
        wall: ti.types.ndarray(),
        floor: ti.types.ndarray(),
        numbers: ti.types.ndarray(),
        places: ti.types.ndarray(),
    ):
        # as few loops as may be: each costs compile time
        half, height = wall.shape[0], wall.shape[1]
        for k in range(half * height + COVERS):
            if k < 256:
                self.colours[k] = ti.Vector([colours[k, 0], colours[k, 1], colours[k, 2]])
            if k < COVERS:
                self.cover[k] = cover[k]
            if k < glow.shape[0]:
                self.glow[k] = glow[k]
            if k < half:
                self.floor[k] = floor[k]
            if k < numbers.shape[0]:
                self.numbers[k] = numbers[k]
            if k < places.shape[0]:
                self.places[k] = places[k]
            if k < half * height:
                self.wall[k] = wall[k // height, k % height]
                self.nearest[k] = ti.u32(EMPTY)

    @ti.kernel
    def _draw(
        self,
        image: ti.types.ndarray(),
        nodes: ti.template(),
        node_count: ti.i32,
        pressure: ti.template(),
        velocity: ti.template(),
        low: float,
        span: float,
        reach: float,
        distance_steps: float,
        profile: ti.types.ndarray(),
        puff: ti.f32,
        curves: ti.types.ndarray(),
        now: ti.i32,
    ):
        for turn in range(self.out.turns):
            if self.out.draws(turn):
                first, after = self.out.first(turn, self.places[HALF]), self.out.after(turn, self.places[HALF])
                for j in range(first, after):
                    self.set_column(j, profile, puff)
                self.find(nodes, node_count, pressure, velocity, low, span, reach, distance_steps, first, after)
                for j in range(first, after):
                    self.draw_section(image, j)
        for turn in range(self.over.turns):
            if self.over.draws(turn):
                columns = self.places[RIGHT] - self.places[LEFT] + 1
                for k in range(self.over.first(turn, columns), ti.min(self.over.after(turn, columns), now + 1)):
                    self.draw_curves(image, curves, k, now)

    @ti.func
    def find(
        self,
        nodes: ti.template(),
        node_count,
        pressure: ti.template(),
        velocity: ti.template(),
        low,
        span,
        reach,
        distance_steps,
        first,
        after,
    ):
        """Write the nearest-node words of these columns, all empty before: nodes as far as `reach` px, their colours
        over low and span, distances squared in `distance_steps`."""
        px_per_m, limbus_row, height = self.numbers[PX_PER_M], self.numbers[LIMBUS_ROW], self.places[HEIGHT]
        by_speed = self.numbers[BY_SPEED]
        for n in range(node_count):
            column = nodes[n][0] * px_per_m
            left = ti.max(ti.cast(ti.ceil(column - reach - 0.5), ti.i32), first)
            right = ti.min(ti.cast(ti.floor(column + reach - 0.5), ti.i32) + 1, after)
            if left < right:
                row = limbus_row - nodes[n][1] * px_per_m
                value = 0.0 * row
                if by_speed > 0.0:
                    value = velocity[n].norm()
                else:
                    value = pressure[n]
                share = ti.math.clamp((value - low) / span, 0.0, 1.0)
                shade = ti.cast(ti.math.clamp(ti.cast(share * 255.0 + 0.5, ti.i32), 0, 255), ti.u32)
                for j in range(left, right):
                    aside = (j + 0.5 - column) ** 2
                    down = ti.sqrt(ti.max(reach * reach - aside, 0.0))
                    top = ti.max(ti.cast(ti.ceil(row - down - 0.5), ti.i32), self.rows[j][0])
                    bottom = ti.min(ti.cast(ti.floor(row + down - 0.5), ti.i32) + 1, self.rows[j][1])
                    for i in range(top, bottom):
                        far = aside + (i + 0.5 - row) ** 2
                        word = (ti.cast(far * distance_steps, ti.u32) << SHADE_BITS) | shade
                        self.nearest[j * height + i] = ti.min(self.nearest[j * height + i], word)

    @ti.func
    def set_column(self, j, profile: ti.template(), puff):
        """What the j-th column from the axis shows where."""
        r = (j + 0.5) / self.numbers[PX_PER_M]
        slope = self.surface.at(self.surface.slope, r)
        row = self.numbers[LIMBUS_ROW] - self.surface.at(self.surface.height, r) * self.numbers[PX_PER_M] - 0.5
        tilt = 1.0 / ti.sqrt(1.0 + slope * slope)
        self.column[j] = ti.Vector([row, tilt, ti.max(puff * self.surface.at(profile, r), 0.0)])
        self.rows[j] = ti.Vector([self.row_from(row), self.floor[j]])

    @ti.func
    def draw_section(self, image: ti.template(), j):
        """The j-th column from the axis and its mirror image, where jet, liquid or membrane show; empties its words."""
        row, tilt, load = self.column[j]
        surface, floor = self.rows[j]
        height, axis = self.places[HEIGHT], self.places[AXIS]
        line = 0.0
        if j < self.places[RIM]:
            line = self.numbers[LINE] + 0.5
        begin = self.row_from(row - line / tilt)
        end = ti.max(self.row_from(row + line / tilt), floor)
        if load > 1e-3:
            begin = 0
        # one loop: each more would cost compile time, its branches cost little
        for i in range(begin, end):
            depth = i - row
            membrane = ti.math.clamp(line - abs(depth) * tilt, 0.0, 1.0)
            colour = 1.0 * ti.Vector(BACKGROUND)
            wall = self.wall[j * height + i]
            shown = membrane > 0.0
            if i < surface:
                over = ti.min(-depth, height)
                k = ti.cast(over, ti.i32)
                glow = self.glow[k] + (over - k) * (self.glow[k + 1] - self.glow[k])
                colour = blend(colour, ti.Vector(JET), load * glow)
                shown = True
            elif self.nearest[j * height + i] != ti.u32(EMPTY):
                word = self.nearest[j * height + i]
                self.nearest[j * height + i] = ti.u32(EMPTY)
                tint = self.colours[ti.cast(word & ti.u32(255), ti.i32)]
                cover = self.cover[ti.cast(word >> (32 - COVER_BITS), ti.i32)]
                colour = blend(FILL * tint + ti.Vector(FILL_FLOOR), tint, cover)
                shown = True
            if shown and wall < 255:
                if membrane > 0.0:
                    colour = blend(colour, ti.Vector(MEMBRANE), membrane)
                if wall > 0:
                    colour = blend(colour, ti.Vector(WALL), wall / 255.0)
                put(image, i, axis + j, colour)
                put(image, i, axis - 1 - j, colour)

    @ti.func
    def row_from(self, row):
        """The first row of the image at or below `row`."""
        return ti.math.clamp(ti.cast(ti.ceil(row), ti.i32), 0, self.places[HEIGHT])

    @ti.func
    def draw_curves(self, image: ti.template(), curves: ti.template(), k, now):
        """The k-th column of the plot: the load, shaded down to the axis, and the apex over it."""
        here = ti.Vector([curves[k, 0], curves[k, 1]])
        before = ti.max(k - 1, 0)
        after = ti.min(k + 1, now)
        slope = 0.5 * ti.Vector([curves[after, 0] - curves[before, 0], curves[after, 1] - curves[before, 1]])
        tilt = 1.0 / ti.sqrt(1.0 + slope * slope)
        curve, left = self.numbers[CURVE], self.places[LEFT]
        half = ti.Vector([1.5 * curve + 0.5, curve + 0.5])
        for i in range(ti.max(ti.cast((here - half / tilt).min(), ti.i32), self.places[TOP]), self.places[BOTTOM] + 1):
            cover = ti.math.clamp(half - abs(i - here) * tilt, 0.0, 1.0)
            colour = pixel(image, i, left + k)
            if i > here[1]:
                colour = blend(colour, ti.Vector(JET), 0.10)
            colour = blend(blend(colour, ti.Vector(JET), 0.75 * cover[1]), ti.Vector(TRACE), cover[0])
            put(image, i, left + k, colour)


@ti.func
def pixel(image: ti.template(), i, j):
    """The colour there."""
    return ti.Vector([1.0 * image[i, j, 0], 1.0 * image[i, j, 1], 1.0 * image[i, j, 2]])


@ti.func
def put(image: ti.template(), i, j, colour):
    """Set a pixel; every colour is blended from colours, so none is out of range."""
    for c in ti.static(range(3)):
        image[i, j, c] = ti.cast(colour[c] + 0.5, ti.u8)


@ti.func
def blend(under, colour, share):
    """`colour` over `under` with coverage `share`."""
    return under + share * (colour - under)


def section_size(scene) -> int:
    """Pixels of half the section that a scene needs."""
    at = Layout.of(scene)
    return at.half * at.height


def colour_limits(scene) -> tuple[float, float]:
    """Ends of the colour scale: pressure less the IOP [Pa] or speed [m/s]; see the head of this module."""
    if scene.camera.colour_by == "speed":
        return 0.0, 0.018 * peak_load_kpa(scene)
    return 0.0, 0.25 * peak_load_kpa(scene) * KPA


def colour_table(scene) -> np.ndarray:
    """256 colours 0..255, shape [256, 3]."""
    share = DARKEST + (1.0 - DARKEST) * np.linspace(0.0, 1.0, 256)
    return 255.0 * matplotlib.colormaps[COLOURMAPS[scene.camera.colour_by]](share)[:, :3]


@dataclass(frozen=True)
class PlotRanges:
    """Axes of the trace, fixed for the whole film: time 0..time_ms, apex low..high, load 0..puff_kpa."""

    time_ms: float
    apex_low_mm: float
    apex_high_mm: float
    puff_kpa: float


def plot_ranges(scene) -> PlotRanges:
    """Axes wide enough for the displacement to be expected of this puff and IOP.

    The default eye yields 0.96 mm to 10 kPa at 15 mmHg, roughly as (puff/IOP)^0.6; a quarter is left above
    it.
    """
    puff = peak_load_kpa(scene)
    expected = 0.96 * (puff / 10.0 * 15.0 / max(scene.eye.iop_mmhg, 1.0)) ** 0.6
    high = tick_step(1.2 * expected / 4.0) * 4.0
    return PlotRanges(scene.numerics.duration_ms, -0.06 * high, high, 1.12 * puff)


def tick_step(rough: float) -> float:
    """The smallest of 1, 2, 2.5, 3, 4, 5 times a power of ten that is not below `rough`."""
    power = 10.0 ** floor(log10(rough))
    return next(m for m in (1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 10.0) if m * power >= rough * (1.0 - 1e-9)) * power


def peak_load_kpa(scene) -> float:
    """Largest load on the apex within the simulated time [kPa], at least 0.1 so that scales exist with the
    puff off."""
    time = np.linspace(0.0, scene.numerics.duration_ms * MS, 2001)
    return max(float(np.max(eye_of(scene).puff.pressure_at_apex(time))) / KPA, 0.1)


def background(scene, at: Layout, limits: tuple[float, float], ranges: PlotRanges) -> np.ndarray:
    """Axes, labels and colour bar on the plain ground, shape [height, width, 3], uint8."""
    image = Image.new("RGB", (at.width, at.height), BACKGROUND)
    draw = ImageDraw.Draw(image)
    label, unit = font(max(7, round(12 * at.unit))), at.unit
    draw_axes(draw, at, ranges, label)
    draw_colour_bar(image, draw, scene, at, limits, label)
    rule, end = round(812 * unit), round(18 * unit)
    draw.line([(rule, end), (rule, at.height - end)], GRID)
    return np.array(image)


def draw_axes(draw: ImageDraw.ImageDraw, at: Layout, ranges: PlotRanges, label) -> None:
    """Grid, ticks and titles of the trace."""
    left, top, right, bottom = at.plot
    unit = at.unit
    step = tick_step(ranges.time_ms / 5.0)
    for k in range(int(ranges.time_ms / step + 1e-9) + 1):
        x = left + round(k * step / ranges.time_ms * (right - left))
        draw.line([(x, top), (x, bottom)], GRID)
        draw.text((x, bottom + 5 * unit), f"{k * step:g}", FAINT, label, anchor="ma")
    draw.text(((left + right) / 2, bottom + 21 * unit), "time, ms", FAINT, label, anchor="ma")
    step = ranges.apex_high_mm / 4.0
    for k in range(5):
        share = (k * step - ranges.apex_low_mm) / (ranges.apex_high_mm - ranges.apex_low_mm)
        y = bottom - round(share * (bottom - top))
        draw.line([(left, y), (right, y)], GRID)
        draw.text((left - 6 * unit, y), f"{k * step:g}", TRACE, label, anchor="rm")
    step = tick_step(ranges.puff_kpa / 5.0)
    for k in range(int(ranges.puff_kpa / step + 1e-9) + 1):
        y = bottom - round(k * step / ranges.puff_kpa * (bottom - top))
        draw.text((right + 6 * unit, y), f"{k * step:g}", JET, label, anchor="lm")
    draw.line([(left, top), (left, bottom), (right, bottom), (right, top)], FAINT)
    draw.text((left, 13 * unit), "apex displacement", TRACE, label, anchor="la")
    draw.text((right, 13 * unit), "puff", JET, label, anchor="ra")


def draw_colour_bar(
    image: Image.Image, draw: ImageDraw.ImageDraw, scene, at: Layout, limits: tuple[float, float], label
) -> None:
    """The colour scale under the section, with its limits and unit."""
    unit = at.unit
    iop = scene.eye.iop_mmhg * MMHG
    if scene.camera.colour_by == "speed":
        title, scaled = "fluid speed, m/s", limits
    else:
        title, scaled = "fluid pressure over atmosphere, kPa", tuple((iop + end) / KPA for end in limits)
    width, height = round(300 * unit), max(3, round(9 * unit))
    left, top = at.axis - width // 2 + round(100 * unit), at.height - round(35 * unit)
    colours = colour_table(scene)[np.linspace(0, 255, width).round().astype(int)]
    image.paste(Image.fromarray(np.tile(colours.round().astype(np.uint8), (height, 1, 1))), (left, top))
    draw.text((left - 12 * unit, top + height / 2), title, FAINT, label, anchor="rm")
    step = tick_step((scaled[1] - scaled[0]) / 5.0)
    tick = ceil(scaled[0] / step - 1e-9) * step
    while tick <= scaled[1] + 1e-9:
        x = left + round((tick - scaled[0]) / (scaled[1] - scaled[0]) * (width - 1))
        draw.line([(x, top + height), (x, top + height + 3 * unit)], FAINT)
        draw.text((x, top + height + 4 * unit), f"{tick:.3g}", FAINT, label, anchor="ma")
        tick += step


def floor_rows(wall: np.ndarray) -> np.ndarray:
    """The row where the back begins in each column, 0 beyond the chamber; wall: coverage [columns, rows]."""
    solid = wall == 255
    top = solid & ~np.pad(solid, ((0, 0), (1, 0)))[:, :-1]
    return np.where(top, np.arange(wall.shape[1]), 0).max(axis=1)


def wall_cover(scene, at: Layout) -> np.ndarray:
    """Coverage by the rigid back (plane or lens), the cylinder above it and the limbus, shape [height,
    width], uint8."""
    fine = 4
    section = eye_of(scene).section
    rim, back = scene.cornea.limbus_radius_mm, section.back_z / MM

    def place(r, z):
        return (at.axis + r * at.scale) * fine, (at.limbus_row - z * at.scale) * fine

    cover = Image.new("L", (at.width * fine, at.height * fine))
    draw = ImageDraw.Draw(cover)
    radii = np.linspace(-rim, rim, 400)
    outer = rim + 0.16
    for side in (-1.0, 1.0):
        draw.polygon(
            [
                place(side * rim, 0.0),
                place(side * outer, 0.0),
                place(side * outer, back - 0.11),
                place(side * rim, back - 0.11),
            ],
            fill=255,
        )
        x, y = place(side * (rim + 0.04), 0.0)
        size = 0.13 * at.scale * fine
        draw.ellipse([x - size, y - size, x + size, y + size], fill=255)
    top = [place(r, z) for r, z in zip(radii, section.back_height(np.abs(radii) * MM) / MM)]
    draw.polygon(top + [place(rim, back - 0.11), place(-rim, back - 0.11)], fill=255)
    return np.array(cover.resize((at.width, at.height), Image.Resampling.BOX))
