"""traces.csv: the history; and beside a checkpoint, the history so far."""

from __future__ import annotations

from taichi_eye.recording.observer import Observer
from taichi_eye.report.traces import append_traces, write_traces


class Traces(Observer):
    """The history of the run, first of all files: it is what the run was for."""

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        self._rows = 0  # that this process has put beside the checkpoint

    def held(self) -> None:
        path, traces = self.recording.work / "traces.csv", self.recording.simulation.traces
        if self._rows:
            append_traces(path, traces, self._rows)
        else:
            write_traces(path, traces)
        self._rows = len(traces["time_ms"])

    def closed(self, ending) -> None:
        write_traces(self.recording.folder / "traces.csv", ending.traces)
