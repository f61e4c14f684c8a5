"""A synthetic air puff: walls in closed form, and frames of them from the renderer."""

import numpy as np

from taichi_eye.backend import real
from taichi_eye.film import FrameState, Scheimpflug
from taichi_eye.lang import ti
from taichi_eye.scene import load_scene

NODES = 120
RADIUS_MM, LIMBUS_MM = 7.8, 5.8
APEX_MM = RADIUS_MM - np.sqrt(RADIUS_MM**2 - LIMBUS_MM**2)
R_MM = RADIUS_MM * np.sin(np.linspace(0.0, np.arcsin(LIMBUS_MM / RADIUS_MM), NODES))


def dent_mm(time_ms):
    """Depth on the axis: a puff of 1 mm about 16 ms."""
    return 1.0 * np.exp(-(((np.asarray(time_ms) - 16.0) / 5.2) ** 2))


def wall_mm(time_ms, radius_mm=RADIUS_MM):
    """Heights [NODES] over R_MM: the cap, a dent, the bulge around it."""
    cap = APEX_MM - radius_mm + np.sqrt(radius_mm**2 - R_MM**2)
    return cap - dent_mm(time_ms) * (np.exp(-((R_MM / 1.75) ** 2)) - 0.07 * np.exp(-((R_MM - 3.2) ** 2)))


def film(times_ms, overrides=()):
    """Frames, uint8 [frames, rows, columns], of the walls at these times."""
    scene = load_scene(None, list(overrides))
    wall, nodes, velocity = (ti.Vector.field(2, real(), NODES) for _ in range(3))
    pressure = ti.field(real(), NODES)
    view, empty, frames = Scheimpflug(scene), np.empty(0), []
    for time in times_ms:
        wall.from_numpy(np.column_stack([R_MM, wall_mm(time)]) * 1e-3)
        frames.append(
            view.render(FrameState(float(time), wall, NODES, nodes, 0, pressure, velocity, *[empty] * 3)).copy()
        )
    return np.stack(frames)


def rows_px(times_ms, columns=576, axis_px=288.0, apex_px=16.0):
    """True rows of the anterior surface, [frames, columns]."""
    x = np.abs(np.arange(columns) - axis_px) * 0.015625
    return np.stack([apex_px + (APEX_MM - np.interp(x, R_MM, wall_mm(time))) / 0.0165 for time in times_ms])
