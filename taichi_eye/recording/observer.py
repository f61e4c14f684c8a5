"""What looks on while a simulation runs: the interface of every sink, and what a sink gets to see.

`opened` once the folder is there; `sample` at every sample; `frame` at every film frame, after that sample; `held` when
a checkpoint is taken; `closed` at the end, however it came. A resumed run opens a new observer with what the old one
had `held`, and shows it the samples and frames after that, none twice: what the old one did since must be undone or
done over, so that the end is the same.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_eye import backend
from taichi_eye.eye.jet import central_curvature
from taichi_eye.film import FilmView, FrameState
from taichi_eye.ladder.rungs import needs_cloud
from taichi_eye.recording.marks import Marks
from taichi_eye.report.compare import Measured
from taichi_eye.report.history import History, summarise
from taichi_eye.scene import Scene
from taichi_eye.solver.workspace import reuse
from taichi_eye.units import MM, MS

if TYPE_CHECKING:
    from taichi_eye.analysis.error_bar import ErrorBar


@dataclass
class Recording:
    """One run and where it is recorded: what all observers share.

    work: the hidden folder of what has to be kept until the end; measured: the history to compare with; choice: what a
    summary tells of how "auto" was decided; clock: seconds by stage, those before a run was resumed included; started:
    on the clock `time.perf_counter`; coarse: what `run_twin` left of a run that states its error; error_bar: made of it
    by `Bars`; walls: a log of the wall at every frame, kept by `Wall`; notes: warnings of observers, for the summary;
    summary: made by `Summary`.
    """

    folder: Path
    work: Path
    scene: Scene
    simulation: Any
    measured: Measured | None = None
    choice: dict | None = None
    clock: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter)
    coarse: Mapping[str, np.ndarray] | None = None
    walls: Any = None
    error_bar: ErrorBar | None = None
    notes: list[str] = field(default_factory=list)
    summary: dict = field(default_factory=dict)
    _marks: Marks | None = None

    def elapsed_s(self) -> float:
        """Seconds that the run has taken, those before it was resumed included."""
        return self.clock.get("total_s", 0.0) + time.perf_counter() - self.started

    def passed(self, moment: Moment) -> str:
        """What a frame's film has passed by then (`taichi_eye.recording.marks`); nothing where no walls are kept."""
        if self.walls is None:
            return ""
        if self._marks is None:
            self._marks = Marks()
            for row in self.walls.read()[: moment.frame]:
                self._marks.see(float(row["time_ms"]), row["wall"], float(row["retreat_mm"]))
        return self._marks.see(moment.time_ms, moment.wall, moment.retreat_mm)

    @cached_property
    def view(self) -> FilmView:
        """The film's view, one that an earlier run no longer needs where it fits: fields and kernels are never given
        back, and a new view for every run would end a long row of them."""
        kind = backend.generation(), "view", FilmView.capacities(self.scene)
        view = reuse(self, kind, lambda: FilmView(self.scene))
        if view.scene is not self.scene:
            view.setup(self.scene)
        return view


class Moment:
    """A film frame as observers see it; what several of them need is made once, when first asked for.

    frame: its number; wall: places (r, z) of the wall's nodes [m], an array; retreat_mm: of the whole eye.
    """

    def __init__(self, recording: Recording, frame: int):
        self.recording, self.simulation, self.frame = recording, recording.simulation, frame
        self.time_ms = self.simulation.time_ms
        self.retreat_mm = float(self.simulation.eye.retreat(self.time_ms * MS)) / MM
        self.wall = self.simulation.cornea.place.to_numpy()[: self.simulation.wall_count]

    @cached_property
    def traces(self) -> dict[str, np.ndarray]:
        """The traces so far."""
        return self.simulation.traces

    @cached_property
    def liquid(self):
        """Fields of the liquid: place, velocity, excess pressure, and how many nodes they hold."""
        return self.simulation.liquid() if needs_cloud(self.recording.scene) else (None, None, None, 0)

    @cached_property
    def load(self) -> np.ndarray | None:
        """Share of the apex pressure on the wall's nodes, where the air feels the dent; None where it does not."""
        eye = self.simulation.eye
        if not eye.puff.dent_feedback:
            return None
        rest = eye.section.cornea_nodes(len(self.wall) - 1)[:, 0]
        return eye.puff.radial(rest, central_curvature(self.wall, rest))

    @cached_property
    def image(self) -> np.ndarray:
        """The frame of the film, uint8."""
        place, velocity, pressure, count = self.liquid
        traces = self.traces
        return self.recording.view.render(
            FrameState(
                time_ms=self.time_ms,
                wall=self.wall,
                wall_count=len(self.wall),
                nodes=place,
                node_count=count,
                pressure=pressure,
                velocity=velocity,
                trace_time_ms=traces["time_ms"],
                trace_apex_mm=traces["apex_displacement_mm"],
                trace_puff_kpa=traces["puff_apex_kpa"],
                puff_radial=self.load,
                retreat_mm=self.retreat_mm,
                passed=self.recording.passed(self) if self.recording.scene.camera.marks else "",
            )
        )


def picture(simulation) -> np.ndarray:
    """The film's image of a simulation as it stands, uint8, in the view of its scene; nothing is recorded."""
    return Moment(Recording(Path(), Path(), simulation.scene, simulation), 0).image


@dataclass(frozen=True)
class Ending:
    """How a run ended: its traces, the history of its apex, and what cut it short, None where it got to its end."""

    traces: dict[str, np.ndarray]
    stop: BaseException | None

    @cached_property
    def history(self) -> History:
        """Of the apex."""
        return summarise(self.traces["time_ms"], self.traces["apex_displacement_mm"])


class Observer:
    """One sink. Every method does nothing unless overridden.

    Class attribute `seam`: whether a checkpoint costs least now; one that is not urgent waits until all say so.
    """

    seam = True

    @classmethod
    def wanted(cls, scene: Scene) -> bool:
        """Whether a run of this scene has it."""
        return True

    def opened(self, recording: Recording, held: dict[str, Any] | None) -> None:
        """The folder is there; held: what `held` returned at the checkpoint from which the run goes on, or None."""
        self.recording = recording

    def sample(self) -> None:
        """The simulation has taken a sample."""

    def frame(self, moment: Moment) -> None:
        """The sample is a film frame."""

    def held(self) -> dict[str, Any] | None:
        """Put on the disk what cannot be made again; returns what else it takes to go on from here, for JSON.

        Under "files" stand those in the work folder that it counts on: by name, length and SHA-256 of what counts.
        """

    def closed(self, ending: Ending) -> None:
        """The run is over: put the files under their names, each whole or not at all. May raise OSError."""


class Watcher(Observer):
    """An observer that holds nothing and may end the run; signals: those of the run (`Signals.ask`)."""

    signals = None
