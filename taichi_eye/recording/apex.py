"""apex.png: the history of the apex under the load."""

from __future__ import annotations

from taichi_eye.recording.observer import Observer


class Apex(Observer):
    """The plot, beside a measured history where there is one."""

    def closed(self, ending) -> None:
        # matplotlib's figures are slow to load: not before the film is done
        from taichi_eye.report.plots import plot_apex

        plot_apex(self.recording.folder / "apex.png", ending.traces, self.recording.measured, self.recording.error_bar)
