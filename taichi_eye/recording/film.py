"""film.mp4."""

from __future__ import annotations

from taichi_eye.film import FilmWriter
from taichi_eye.recording.observer import Observer


class Film(Observer):
    """The film, coded while the run goes on."""

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        self._film = FilmWriter(recording.folder / "film.mp4", recording.scene.output.film_fps, recording.work, held)

    @property
    def seam(self) -> bool:
        return self._film.between_groups

    def frame(self, moment) -> None:
        self._film.write(moment.image)

    def held(self) -> dict:
        return self._film.hold()

    def closed(self, ending) -> None:
        self._film.close()
