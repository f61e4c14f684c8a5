"""The dynamic corneal response of a scene: its run without a film, read from the computed wall itself.

What `taichi-eye analyze` reads from a recorded or rendered film, without the camera between: the same definitions
(`taichi_eye.analysis.response`) on the wall at the times of the film's frames, whole-eye movement included. As
on the instrument, IOPnct comes from the A1 time and bIOP, for SP-A1, from it and the thickness, at the age of the eyes
whose norms it is held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.curves import Curves, curves_from_wall
from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS
from taichi_eye.analysis.response import SPEED_MS, Response, respond
from taichi_eye.eye.eye import Eye, eye_of
from taichi_eye.ladder.batches import run_batch
from taichi_eye.ladder.choose import choose
from taichi_eye.scene import Scene
from taichi_eye.solver.batch import Outcome
from taichi_eye.units import MM, MMHG, MS

FRAMES_LEAST = 30  # fewer show no response


# what a run that was stopped may have shown before
EARLY = ("a1_", "iop_nct", "biop", "sp_a1", "central_thickness")


@dataclass(frozen=True)
class Reading:
    """The response of a scene; stopped: why its run ended before its end, or empty.

    Of a stopped run the response holds what belongs to A1, where that was passed by the width of the readings' windows:
    the largest dent of half a puff is none.
    """

    response: Response
    stopped: str = ""


@dataclass(frozen=True)
class Observed:
    """A scene as it was run, its eye, the curves of its wall (None where there are too few frames of them), and what
    became of the run."""

    scene: Scene
    eye: Eye
    curves: Curves | None
    stopped: str = ""
    outcome: Outcome | None = None

    def response(self, curves: Curves, **windows) -> Response:
        """What this eye's camera and puff show of curves; windows: those of `respond` that are not its defaults."""
        puff = lambda t: float(self.eye.puff.pressure_at_apex(t * MS)) / MMHG
        interval = self.scene.camera.frame_interval_ms
        return respond(curves, interval, puff_mmhg=puff, age_years=ELDERLY_AGE_YEARS, **windows)

    def read(self, **windows) -> Reading:
        """The response; windows: those of `respond` that are not its defaults."""
        if self.curves is None:
            return Reading(Response(), self.stopped)
        response = self.response(self.curves, **windows)
        if self.stopped:
            passed = response.a1_time_ms is not None and self.curves.time_ms[-1] > response.a1_time_ms + SPEED_MS
            early = {n: value for n, value in vars(response).items() if n.startswith(EARLY)} if passed else {}
            response = Response(**early)
        return Reading(response, self.stopped)


def response_of(scene: Scene) -> Reading:
    """Run a resolved scene without a film and read the dynamic corneal response from its wall."""
    return observe(scene).read()


def observe(scene: Scene) -> Observed:
    """Run a resolved scene without a film and keep the curves of its wall."""
    return observe_many([scene])[0]


def observe_many(scenes: Sequence[Scene]) -> list[Observed]:
    """The same for several scenes, those of the full model side by side (`taichi_eye.ladder.batches`)."""
    scenes = [choose(scene).scene if scene.numerics.fidelity == "auto" else scene for scene in scenes]
    eyes = [eye_of(scene) for scene in scenes]
    times: list[list[float]] = [[] for _ in scenes]
    walls: list[list[np.ndarray]] = [[] for _ in scenes]

    def keep(number, time_ms, wall):
        times[number].append(time_ms)
        walls[number].append(wall - [0.0, float(eyes[number].retreat(time_ms * MS)) / MM])

    return [
        observed(outcome, eyes[number], np.array(times[number]), np.array(walls[number]))
        for number, outcome in enumerate(run_batch(scenes, on_frame=keep))
    ]


def observed(outcome: Outcome, eye: Eye, time_ms: np.ndarray, walls_mm: np.ndarray) -> Observed:
    """What was observed of a run that is over; walls_mm: at its frames, [frames, nodes, 2], less the eye's retreat."""
    stop = outcome.stop
    stopped = f"{stop.what}, {stop.time_ms:.1f} ms" if stop else ""
    curves = None
    if len(time_ms) >= FRAMES_LEAST:
        r, z = np.moveaxis(walls_mm, 2, 0)
        curves = curves_from_wall(time_ms, r, z, outcome.scene.cornea.thickness_mm)
    return Observed(outcome.scene, eye, curves, stopped or ("" if curves else "too few frames"), outcome)
