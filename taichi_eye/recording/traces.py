"""traces.csv: the history; and beside a checkpoint, the history so far."""

from __future__ import annotations

from taichi_eye.recording.observer import Observer
from taichi_eye.report.traces import write_traces


class Traces(Observer):
    """The history of the run, first of all files: it is what the run was for."""

    def held(self) -> None:
        write_traces(self.recording.work / "traces.csv", self.recording.simulation.arrays())

    def closed(self, ending) -> None:
        write_traces(self.recording.folder / "traces.csv", ending.traces)
