"""The dynamic corneal response of a scene: its run without a film, read from the computed wall itself.

What `taichi-eye analyze` reads from a recorded or rendered film, without the camera between: the same definitions
(`taichi_eye.analysis.response`) on the wall at the times of the film's frames, whole-eye movement included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.curves import curves_from_wall
from taichi_eye.analysis.response import Response, respond
from taichi_eye.eye.eye import eye_of
from taichi_eye.ladder.choose import choose
from taichi_eye.ladder.trial import run_scene
from taichi_eye.scene import Scene
from taichi_eye.units import MM, MMHG, MS

FRAMES_LEAST = 30  # fewer show no response


@dataclass(frozen=True)
class Reading:
    """The response of a scene, up to where its run ended; stopped: why that was not its end, or empty."""

    response: Response
    stopped: str = ""


def response_of(scene: Scene) -> Reading:
    """Run a resolved scene without a film and read the dynamic corneal response from its wall."""
    if scene.numerics.fidelity == "auto":
        scene = choose(scene).scene
    times, walls, eye = [], [], eye_of(scene)

    def keep(run, frame):
        wall = run.cornea.place.to_numpy()[: run.wall_count] / MM
        times.append(run.time_ms)
        walls.append(wall - [0.0, float(eye.retreat(run.time_ms * MS)) / MM])

    stop = run_scene(scene, on_frame=keep).stop
    stopped = f"{stop.what}, {stop.time_ms:.1f} ms" if stop else ""
    if len(times) < FRAMES_LEAST:
        return Reading(Response(), stopped or "too few frames")
    r, z = np.moveaxis(np.array(walls), 2, 0)
    response = respond(
        curves_from_wall(np.array(times), r, z, scene.cornea.thickness_mm),
        scene.camera.frame_interval_ms,
        scene.eye.iop_mmhg,
        lambda t: float(eye.puff.pressure_at_apex(t * MS)) / MMHG,
    )
    return Reading(response, stopped)
