"""The anterior surface of one frame on even radii, and the posterior surface as the camera sees it through
it.

The wall is a polyline of a surface of revolution. It is resampled once per frame on a table of radii, two
pixels apart (linear interpolation then errs by less than 0.01 px where the radius of curvature exceeds 1
mm); everything drawn afterwards reads the table, so no pixel searches the wall.

Refraction. The slit lights the plane y = 0; the camera looks at it under `angle_deg` to the axis in planes x = const,
from far away (parallel rays). A ray that enters the surface at Q = (x, y, z_a(sqrt(x^2 + y^2))) bends by Snell's law at
the surface's normal there and meets the lit plane in a point P; the image shows P where the straight air ray through Q
meets that plane, (x, 0, z_Q - y / tan(angle)). For every radius the entry point whose P lies on the posterior surface
(the anterior one moved inwards along its normals by the thickness there) is found by secants. For a flat surface
apparent/true depth is tan(asin(sin(angle)/n))/tan(angle).

What lies deeper, iris and lens, is seen through the same surface: further rays of a column, each entering a little
further down, give P over the apparent height by linear interpolation. The aqueous humour counts as cornea there (1.336
against 1.376: 3 % of the depth).
"""

from math import ceil, cos, radians, sin, sqrt

import numpy as np

from taichi_eye.backend import real
from taichi_eye.eye.eye import eye_of
from taichi_eye.lang import ti
from taichi_eye.solver.workspace import capacity

SLOPE_MAX = 4.0  # dz/dr beyond which the table no longer follows an overhang
POSTERIOR_STEPS = 12  # fixed point on the normal's foot; contracts by thickness over radius of curvature
SECANT_STEPS = 8
TOLERANCE = 1e-6  # of both, in thicknesses
RAYS, RAY_STEP = 7, 0.5e-3  # rays of a column behind the posterior surface, and between their entry points [m]
MARGIN_MM = 2.0  # table beyond what is drawn: entry points and feet of normals lie outside their column
SMALLEST = 1024  # entries of a table: smaller ones share one set of kernels
SPACING, INDEX_RATIO, SIN_ANGLE, COS_ANGLE, FLAT_RATIO, LIMBUS_SLOPE = range(6)  # of `Surface.numbers`


def table_size(scene) -> int:
    """Entries of the tables that a scene needs."""
    cornea, camera = scene.cornea, scene.camera
    extent_mm = max(_half_width_mm(camera), cornea.limbus_radius_mm) + MARGIN_MM
    return ceil(extent_mm / (2.0 * camera.pixel_x_mm)) + 2


def _half_width_mm(camera) -> float:
    return max(camera.apex_column_px, camera.width_px - camera.apex_column_px) * camera.pixel_x_mm


@ti.data_oriented
class Surface:
    """Tables over r = k * spacing of the anterior height and slope and of the apparent posterior height.

    Fields: height [m], slope [-] and posterior [m] (true height), `count` entries in use, apparent [m], of which
    `columns` are, which reach as far as the frame does, and behind, [columns, RAYS] vectors (a, x, z) [m]: at the
    apparent height a, which falls from ray to ray, the camera sees the point (x, z) of the lit plane; z from the limbus
    plane, all even in x. Beyond the limbus the surface goes on straight, at the slope of the undeformed cap.

    capacity: entries of the fields; any scene whose `table_size` fits may be set up in them.
    """

    def __init__(self, scene):
        self.capacity = held = capacity(table_size(scene), SMALLEST)
        self.height, self.slope, self.posterior, self.apparent, self.thickness = (
            ti.field(real(), held) for _ in range(5)
        )
        self.behind = ti.Vector.field(3, real(), (held, RAYS))
        self.numbers = ti.field(real(), LIMBUS_SLOPE + 1)
        self.used = ti.field(ti.i32, 2)  # count, columns
        self.setup(scene)

    def setup(self, scene) -> None:
        """Take camera, shape and thickness of the eye from another scene that fits."""
        cornea, camera = scene.cornea, scene.camera
        spacing_mm = 2.0 * camera.pixel_x_mm
        self.spacing = spacing_mm * 1e-3
        self.columns, self.count = ceil(_half_width_mm(camera) / spacing_mm) + 2, table_size(scene)
        sine, cosine = sin(radians(camera.angle_deg)), cos(radians(camera.angle_deg))
        optical = camera.refractive_index / sine
        cap = cornea.limbus_radius_mm / cornea.radius_mm
        eye = eye_of(scene)
        self.apex_rest = float(eye.section.apex_z)
        numbers = {
            SPACING: self.spacing,
            INDEX_RATIO: 1.0 / camera.refractive_index,
            SIN_ANGLE: sine,
            COS_ANGLE: cosine,
            FLAT_RATIO: cosine / sine / sqrt(optical * optical - 1.0),
            LIMBUS_SLOPE: max(-cap / sqrt(max(1.0 - cap * cap, 1e-6)), -SLOPE_MAX),
        }
        self._load(
            np.array([numbers[k] for k in range(len(numbers))]),
            np.array([self.count, self.columns], dtype=np.int32),
            eye.thickness(np.arange(self.count) * self.spacing),
        )

    @ti.kernel
    def _load(self, numbers: ti.types.ndarray(), used: ti.types.ndarray(), thickness: ti.types.ndarray()):
        for k in range(thickness.shape[0]):
            self.thickness[k] = thickness[k]
            if k < numbers.shape[0]:
                self.numbers[k] = numbers[k]
            if k < used.shape[0]:
                self.used[k] = used[k]

    def update(self, wall: np.ndarray | ti.MatrixField, wall_count: int) -> None:
        """Resample the wall and trace the posterior surface; gathers only, the same bits on any thread
        count."""
        # an array, whatever it came from: a kernel is compiled for each field that it is given
        wall = wall if isinstance(wall, np.ndarray) else wall.to_numpy()
        self._update(np.ascontiguousarray(wall[:wall_count]), wall_count)

    @ti.kernel
    def _update(self, wall: ti.types.ndarray(), wall_count: ti.i32):
        for k in range(self.used[0]):
            point = self.resample(wall, wall_count, k * self.numbers[SPACING])
            self.height[k] = point[0]
            self.slope[k] = point[1]
        for k in range(self.used[0]):
            x = k * self.numbers[SPACING]
            foot = x
            for _ in range(POSTERIOR_STEPS):
                s = self.at(self.slope, foot)
                moved = x - self.at(self.thickness, foot) * s / ti.sqrt(1.0 + s * s)
                change = moved - foot
                foot = moved
                if abs(change) < TOLERANCE * self.thickness[0]:
                    break
            s = self.at(self.slope, foot)
            self.posterior[k] = self.at(self.height, foot) - self.at(self.thickness, foot) / ti.sqrt(1.0 + s * s)
        for k in range(self.used[1]):
            x = k * self.numbers[SPACING]
            y = self.trace(x)
            for n in range(RAYS):
                ray = self.enter(x, y + n * RAY_STEP)
                self.behind[k, n] = ti.Vector([ray[0], ray[2], ray[3]])
            self.apparent[k] = self.behind[k, 0][0]

    @ti.func
    def at(self, table: ti.template(), r):
        """Linear interpolation in a table, even in r, straight on beyond its end. NaN stays within the
        table, so that a broken state still draws."""
        t = abs(r) * (1.0 / self.numbers[SPACING])
        k = ti.math.clamp(ti.cast(t, ti.i32), 0, self.used[0] - 2)
        return table[k] + (t - k) * (table[k + 1] - table[k])

    @ti.func
    def between(self, r):
        """The column of the tables below radius r >= 0, and the share of the way to the next."""
        t = r * (1.0 / self.numbers[SPACING])
        k = ti.math.clamp(ti.cast(t, ti.i32), 0, self.used[1] - 2)
        return k, t - k

    @ti.func
    def tangent(self, wall: ti.template(), i):
        """Unit-speed tangent at an inner node or the apex (mirrored neighbour): the parabola through three
        nodes."""
        here = node(wall, i)
        after = node(wall, i + 1)
        before = node(wall, ti.max(i - 1, 0))
        if i == 0:
            before = ti.Vector([-after[0], after[1]])
        h0 = (here - before).norm()
        h1 = (after - here).norm()
        return (h1 / h0 * (here - before) + h0 / h1 * (after - here)) / (h0 + h1)

    @ti.func
    def resample(self, wall: ti.template(), wall_count, r):
        """(z, dz/dr) at radius r of the cubic through the wall nodes. Nodes are about evenly spread in r,
        so a short walk from the guess finds the two that hold r between them; where the wall overhangs, one
        such pair."""
        last = node(wall, wall_count - 1)
        result = ti.Vector([last[1] + self.numbers[LIMBUS_SLOPE] * (r - last[0]), self.numbers[LIMBUS_SLOPE]])
        if r <= last[0]:
            i = ti.math.clamp(ti.cast(r / last[0] * (wall_count - 1), ti.i32), 0, wall_count - 2)
            while i > 0 and wall[i, 0] > r:
                i -= 1
            while i < wall_count - 2 and wall[i + 1, 0] <= r:
                i += 1
            a = node(wall, i)
            b = node(wall, i + 1)
            chord = (b - a).norm()
            ma = self.tangent(wall, i) * chord
            mb = 2.0 * (b - a) - ma
            if i + 2 < wall_count:
                mb = self.tangent(wall, i + 1) * chord
            u = ti.math.clamp((r - a[0]) / ti.max(b[0] - a[0], 1e-3 * chord), 0.0, 1.0)
            run = hermite_rate(u, a[0], b[0], ma[0], mb[0])
            for _ in range(5):
                gap = hermite(u, a[0], b[0], ma[0], mb[0]) - r
                if abs(gap) < 1e-7 * chord:
                    break
                u = ti.math.clamp(u - gap / ti.max(run, 1e-3 * chord), 0.0, 1.0)
                run = hermite_rate(u, a[0], b[0], ma[0], mb[0])
            rise = hermite_rate(u, a[1], b[1], ma[1], mb[1])
            result = ti.Vector(
                [
                    hermite(u, a[1], b[1], ma[1], mb[1]),
                    ti.math.clamp(rise / ti.max(run, 1e-3 * chord), -SLOPE_MAX, SLOPE_MAX),
                ]
            )
        return result

    @ti.func
    def enter(self, x, y):
        """The camera ray that enters at (x, y): its apparent height, how far above the posterior surface it
        meets the lit plane, and the x and z where it does [m]."""
        bent, sine, cosine = self.numbers[INDEX_RATIO], self.numbers[SIN_ANGLE], self.numbers[COS_ANGLE]
        rho = ti.sqrt(x * x + y * y)
        z = self.at(self.height, rho)
        s = self.at(self.slope, rho)
        nz = 1.0 / ti.sqrt(1.0 + s * s)
        nx = 0.0
        ny = 0.0
        if rho > 0.0:
            nx = -s * nz * x / rho
            ny = -s * nz * y / rho
        facing = ti.max(ny * sine + nz * cosine, 0.05)
        bend = bent * facing - ti.sqrt(1.0 - bent**2 * (1.0 - facing * facing))
        tx = bend * nx
        ty = -bent * sine + bend * ny
        tz = -bent * cosine + bend * nz
        run = y / ti.max(-ty, 1e-3)
        apparent = z - y * cosine / sine
        px = x + run * tx
        pz = z + run * tz
        return ti.Vector([apparent, pz - self.at(self.posterior, px), px, pz])

    @ti.func
    def trace(self, x):
        """Where (y) the ray enters that shows the posterior surface in column x."""
        y = 0.0 * x
        y0 = y
        gap0 = y
        for n in range(SECANT_STEPS + 1):
            gap = self.enter(x, y)[1]
            onwards = self.numbers[FLAT_RATIO] * gap * self.numbers[SIN_ANGLE] / self.numbers[COS_ANGLE]
            if n > 0:
                change = gap - gap0
                if abs(gap) < TOLERANCE * self.thickness[0] or change == 0.0:
                    break
                onwards = ti.max(y - gap * (y - y0) / change, 0.0)
            y0 = y
            gap0 = gap
            y = onwards
        return y


@ti.func
def node(wall: ti.template(), i):
    """Place of the i-th node of the wall."""
    return ti.Vector([wall[i, 0], wall[i, 1]])


@ti.func
def hermite(u, a, b, ma, mb):
    """Cubic with end values a, b and end derivatives ma, mb on u in 0..1."""
    return a + u * (ma + u * (3.0 * (b - a) - 2.0 * ma - mb + u * (2.0 * (a - b) + ma + mb)))


@ti.func
def hermite_rate(u, a, b, ma, mb):
    """Derivative of `hermite` in u."""
    return ma + u * (2.0 * (3.0 * (b - a) - 2.0 * ma - mb) + 3.0 * u * (2.0 * (a - b) + ma + mb))
