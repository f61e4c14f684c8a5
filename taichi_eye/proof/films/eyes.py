"""Eyes whose motion is known in closed form, and films of them through the whole chain: optics, noise, encoder,
decoder.

The cap dents by d(t) [exp(-(r/w)^2) - b exp(-(r - 3.2)^2)] (r, w in mm) and retreats with the whole eye; d rises and
falls as two tanh steps under a wide bell, so that rise and fall differ in time and speed as they do in living eyes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_eye.analysis import Curves, curves_from_wall
from taichi_eye.backend import real
from taichi_eye.eye.eye import eye_of
from taichi_eye.film import FilmWriter, FrameState, Scheimpflug
from taichi_eye.lang import ti
from taichi_eye.scene import Scene, load_scene
from taichi_eye.units import MM, MS

NODES = 120
FRAMES, INTERVAL_MS = 139, 0.2315
TOP_MS, BELL_MS = 16.8, 15.0
TIMES_MS = INTERVAL_MS * np.arange(FRAMES)


@dataclass(frozen=True)
class Eye:
    """One eye. depth_mm: of the dent; width_mm: w; bulge: b; rise and fall: time and time scale [ms] of the two steps;
    overrides: of the scene (shape, thickness, whole-eye movement, camera)."""

    name: str
    depth_mm: float = 0.95
    width_mm: float = 1.75
    bulge: float = 0.07
    rise_ms: tuple[float, float] = (9.2, 2.9)
    fall_ms: tuple[float, float] = (20.9, 1.6)
    overrides: tuple[str, ...] = ()

    def scene(self, *more: str) -> Scene:
        """The scene that films it."""
        return load_scene(None, ["camera.view=scheimpflug", *self.overrides, *more])

    def dent_mm(self, time_ms) -> np.ndarray:
        """d at times of any shape."""
        (rise, slow), (fall, quick) = self.rise_ms, self.fall_ms

        def course(t):
            return (
                0.5
                * (np.tanh((t - rise) / slow) - np.tanh((t - fall) / quick))
                * np.exp(-(((t - TOP_MS) / BELL_MS) ** 2))
            )

        return self.depth_mm * (course(np.asarray(time_ms, dtype=float)) - course(0.0)) / (course(TOP_MS) - course(0.0))

    def wall_mm(self, scene: Scene, time_ms: float) -> np.ndarray:
        """(r, z) of the anterior surface at rest in its socket, shape [NODES, 2], z from the limbus plane."""
        radius, rim = scene.cornea.radius_mm, scene.cornea.limbus_radius_mm
        r = radius * np.sin(np.linspace(0.0, np.arcsin(rim / radius), NODES))
        shape = np.exp(-((r / self.width_mm) ** 2)) - self.bulge * np.exp(-((r - 3.2) ** 2))
        z = np.sqrt(radius**2 - r**2) - np.sqrt(radius**2 - rim**2) - self.dent_mm(time_ms) * shape
        return np.column_stack([r, z])


EYES = (
    Eye("default"),
    Eye("flat and thick", 0.80, 1.9, overrides=("cornea.radius_mm=8.5", "cornea.thickness_mm=0.63")),
    Eye(
        "steep and thin",
        1.20,
        1.6,
        overrides=("cornea.radius_mm=7.2", "cornea.limbus_radius_mm=5.5", "cornea.thickness_mm=0.46"),
    ),
    Eye(
        "thick rim, whole eye retreats",
        0.85,
        1.8,
        overrides=("cornea.limbus_thickness_mm=0.67", "eye.whole_eye_movement_mm=0.3"),
    ),
    Eye("stiff: a shallow dent", 0.55, 1.7, 0.05, (9.6, 3.2), (20.3, 2.2)),
    Eye(
        "soft: deep and wide, retreats far",
        1.15,
        2.1,
        0.10,
        (8.3, 2.4),
        (21.6, 1.3),
        ("eye.whole_eye_movement_mm=0.4",),
    ),
    Eye("snaps in and out", 0.95, 1.7, 0.07, (8.4, 1.5), (21.3, 0.8), ("eye.whole_eye_movement_mm=0.25",)),
    Eye("off centre, low", 0.95, 1.75, overrides=("camera.apex_column_px=258", "camera.apex_row_px=28")),
    Eye(
        "off centre, high",
        1.05,
        1.85,
        overrides=("camera.apex_column_px=322", "camera.apex_row_px=8", "cornea.thickness_mm=0.58"),
    ),
    Eye(
        "keratoconus-like: thin, quick",
        1.25,
        1.45,
        0.06,
        (7.9, 2.0),
        (21.2, 1.1),
        ("cornea.thickness_mm=0.456", "cornea.radius_mm=7.4", "eye.whole_eye_movement_mm=0.25"),
    ),
)


def walls_mm(eye: Eye, scene: Scene) -> np.ndarray:
    """(r, z) of the filmed surface at TIMES_MS, the retreat in it: shape [FRAMES, NODES, 2]."""
    walls = np.stack([eye.wall_mm(scene, time) for time in TIMES_MS])
    walls[:, :, 1] -= eye_of(scene).retreat(TIMES_MS * MS)[:, None] / MM
    return walls


def truth(eye: Eye, scene: Scene) -> Curves:
    """The curves that a film of the eye should be read to."""
    walls = walls_mm(eye, scene)
    return curves_from_wall(TIMES_MS, walls[:, :, 0], walls[:, :, 1], scene.cornea.thickness_mm)


def rows_px(eye: Eye, scene: Scene) -> np.ndarray:
    """True rows of the anterior surface, shape [FRAMES, columns]."""
    camera, walls = scene.camera, walls_mm(eye, scene)
    x = np.abs(np.arange(camera.width_px) - camera.apex_column_px) * camera.pixel_x_mm
    top = walls[0, 0, 1]
    return np.stack(
        [camera.apex_row_px + (top - np.interp(x, r, z)) / camera.pixel_y_mm for r, z in walls.transpose(0, 2, 1)]
    )


class Studio:
    """Films eyes; its fields are filled anew for each frame."""

    def __init__(self):
        self.wall, self.nodes, self.velocity = (ti.Vector.field(2, real(), NODES) for _ in range(3))
        self.pressure = ti.field(real(), NODES)

    def state(self, eye: Eye, scene: Scene, time_ms: float) -> FrameState:
        """What the renderer sees of the eye at a time."""
        self.wall.from_numpy(eye.wall_mm(scene, time_ms) * 1e-3)
        empty = np.empty(0)
        return FrameState(
            float(time_ms),
            self.wall,
            NODES,
            self.nodes,
            0,
            self.pressure,
            self.velocity,
            empty,
            empty,
            empty,
            retreat_mm=float(eye_of(scene).retreat(time_ms * MS)) / MM,
        )

    def frames(self, eye: Eye, scene: Scene) -> np.ndarray:
        """Frames at TIMES_MS, uint8 [FRAMES, height, width]."""
        view = Scheimpflug(scene)
        return np.stack([view.render(self.state(eye, scene, time)) for time in TIMES_MS])


def write_film(frames: np.ndarray, path: Path) -> Path:
    """The frames as film.mp4 of a run would hold them."""
    with FilmWriter(path, 25) as film:
        for frame in frames:
            film.write(frame)
    return path
