"""wall.npz: the membrane at every frame, logged as it comes."""

from __future__ import annotations

import numpy as np

from taichi_eye.recording.observer import Observer
from taichi_eye.recording.workroom import Log
from taichi_eye.report.traces import write_wall
from taichi_eye.units import MM


class Wall(Observer):
    """Logs time, retreat of the eye [mm] and the wall's places [m]; `Recording.walls` for those who draw it again."""

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        wall = recording.simulation.cornea.place.to_numpy()[: recording.simulation.wall_count]
        row = np.dtype([("time_ms", "f8"), ("retreat_mm", "f8"), ("wall", wall.dtype, wall.shape)])
        recording.walls = Log(recording.work / "wall", row, held)

    def frame(self, moment) -> None:
        self.recording.walls.append(moment.time_ms, moment.retreat_mm, moment.wall)

    def held(self) -> dict:
        return self.recording.walls.held()

    def closed(self, ending) -> None:
        rows = self.recording.walls.read()
        if len(rows):
            places = rows["wall"] / MM
            places[..., 1] -= rows["retreat_mm"][:, None]
            write_wall(self.recording.folder / "wall.npz", rows["time_ms"], places)
