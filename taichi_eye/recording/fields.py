"""fields/: the nodes at every frame, for ParaView."""

from __future__ import annotations

from taichi_eye.recording.observer import Observer


class Fields(Observer):
    """A file per frame and part, and a collection of them with their times."""

    @classmethod
    def wanted(cls, scene) -> bool:
        return scene.output.node_fields

    def opened(self, recording, held) -> None:
        # meshio is slow to load, and few runs need it
        from taichi_eye.report.paraview import ParaviewWriter

        super().opened(recording, held)
        self._writer = ParaviewWriter(recording.folder / "fields", held["times_ms"] if held else ())

    def frame(self, moment) -> None:
        place, velocity, pressure, count = moment.liquid
        self._writer.add_frame(
            moment.time_ms,
            place.to_numpy()[:count],
            moment.simulation.cloud.triangles,
            {"excess_pressure_pa": pressure.to_numpy()[:count], "velocity_m_s": velocity.to_numpy()[:count]},
            moment.wall,
            {"velocity_m_s": moment.simulation.wall_velocity.to_numpy()[: len(moment.wall)]},
        )

    def held(self) -> dict:
        return {"times_ms": self._writer.times_ms}
