"""sheet.png: six instants of the puff, drawn at the end, when it is known which."""

from __future__ import annotations

import numpy as np

from taichi_eye.film import FrameState
from taichi_eye.film.display import gain_of, levels
from taichi_eye.recording.observer import Observer


class Sheet(Observer):
    """Draws the slit image again from the walls logged: it shows nothing else, with the gain of `film.display`."""

    def closed(self, ending) -> None:
        # matplotlib's figures are slow to load: not before the film is done
        from taichi_eye.report.plots import plot_sheet, sheet_times

        rows = self.recording.walls.read()
        if not len(rows):
            return
        times = rows["time_ms"]
        chosen = [int(np.argmin(np.abs(times - wanted))) for wanted in sheet_times(ending.history, float(times[-1]))]
        frames = [(float(times[row]), self._slit(rows[row])) for row in chosen]
        plot_sheet(self.recording.folder / "sheet.png", frames)

    def _slit(self, row) -> np.ndarray:
        nothing = np.empty(0)
        frame = self.recording.view.scheimpflug_frame(
            FrameState(
                time_ms=float(row["time_ms"]),
                wall=row["wall"],
                wall_count=len(row["wall"]),
                nodes=None,
                node_count=0,
                pressure=None,
                velocity=None,
                trace_time_ms=nothing,
                trace_apex_mm=nothing,
                trace_puff_kpa=nothing,
                retreat_mm=float(row["retreat_mm"]),
            )
        )
        return levels(gain_of(self.recording.scene))[frame]
