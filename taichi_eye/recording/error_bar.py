"""error_bar.csv, and `Recording.error_bar` for those who show it: the run's numerical error by its coarser twin.

`run_twin` runs before the run's own simulation is set up, which then takes over fields and kernels; a pilot that "auto"
has chosen is there already. What the twin left
is kept beside the checkpoint, and a run that is resumed takes it from there; one that was cut off before its first
checkpoint computes it again.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_eye.errors import RunStopped
from taichi_eye.eye.eye import eye_of
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.ladder.trial import run_to_stop
from taichi_eye.ladder.twin import Twin, twin_of
from taichi_eye.recording.observer import Observer
from taichi_eye.report.folder import replacing
from taichi_eye.report.traces import write_columns
from taichi_eye.scene import Scene
from taichi_eye.solver.batch import Outcome
from taichi_eye.units import MM, MS

if TYPE_CHECKING:
    from taichi_eye.analysis.error_bar import ErrorBar
    from taichi_eye.analysis.simulated import Observed

KEPT = "time_ms", "apex_displacement_mm"
FILE = "twin.npz"


def run_twin(scene: Scene, tell: Callable[[str, float], None]) -> dict[str, np.ndarray]:
    """Run the twin of a scene; what it leaves, as arrays. tell(what, simulated ms): called at each sample.

    Raises SceneError where the eye takes no twin.
    """
    simulation = simulation_of(twin_of(scene).scene)
    times, walls = [], []

    def on_frame(run, _):
        times.append(run.time_ms)
        walls.append(run.cornea.place.to_numpy()[: run.wall_count] / MM)

    stop = run_to_stop(simulation, on_frame, lambda run: tell("coarser twin: ", run.time_ms))
    traces = simulation.traces
    return {
        **{name: traces[name] for name in KEPT},
        "frame_ms": np.array(times),
        "wall_mm": np.array(walls),
        "stop": np.array(repr(stop.args) if stop else ""),
    }


class Bars(Observer):
    """Compares the run with its twin; a twin that did not get to its end makes a warning in place of an error bar."""

    @classmethod
    def wanted(cls, scene: Scene) -> bool:
        return scene.numerics.error_bar

    def opened(self, recording, held: dict[str, Any] | None) -> None:
        super().opened(recording, held)
        path = recording.work / FILE
        if held is None:
            with replacing(path, durable=True) as temporary, open(temporary, "wb") as file:
                np.savez(file, **recording.coarse)
        self._digest = [path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest()]
        with np.load(path, allow_pickle=False) as arrays:
            self._coarse = dict(arrays)

    def held(self) -> dict[str, Any]:
        return {"files": {FILE: self._digest}}

    def closed(self, ending) -> None:
        recording, stopped = self.recording, str(self._coarse["stop"])
        if stopped:
            reason = RunStopped(*ast.literal_eval(stopped))
            recording.notes.append(f"numerics.error_bar: none can be stated, for its coarser run was {reason}")
        elif ending.stop is None:
            recording.error_bar = bar = self._bar(twin_of(recording.scene), ending.traces)
            write_columns(recording.folder / "error_bar.csv", columns(bar))

    def _bar(self, twin: Twin, traces) -> ErrorBar:
        # what reads films is slow to load
        from taichi_eye.analysis.error_bar import error_bar

        rows, coarse = self.recording.walls.read(), self._coarse
        run = _observed(self.recording.scene, traces, rows["time_ms"], rows["wall"] / MM)
        other = {name: coarse[name] for name in KEPT}
        return error_bar(twin, run, _observed(twin.scene, other, coarse["frame_ms"], coarse["wall_mm"]))


def columns(bar: ErrorBar) -> dict[str, np.ndarray]:
    """What error_bar.csv holds."""
    return {
        "time_ms": bar.time_ms,
        "apex_displacement_mm": bar.apex_mm,
        "numerical_error_mm": bar.band_mm,
        "extrapolated_mm": bar.extrapolated_mm,
    }


def _observed(scene: Scene, traces, frame_ms: np.ndarray, walls_mm: np.ndarray) -> Observed:
    from taichi_eye.analysis.simulated import observed

    eye = eye_of(scene)
    places = walls_mm.copy()
    if len(places):
        places[..., 1] -= (eye.retreat(frame_ms * MS) / MM)[:, None]
    return observed(Outcome(scene, traces, None), eye, frame_ms, places)
