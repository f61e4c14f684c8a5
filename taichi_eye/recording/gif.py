"""film.gif: a small looping picture of the film."""

from __future__ import annotations

import math

import numpy as np

from taichi_eye.film import shrunk, write_gif
from taichi_eye.film.display import brightened
from taichi_eye.recording.observer import Observer
from taichi_eye.recording.workroom import Log

WIDTH_PX, STRIDE, COLOURS = 480, 3, 192  # small enough for a README
FRAMES = 100  # at most; a longer film is thinned


class Gif(Observer):
    """Every third frame, shrunk, in a log until the palette can be chosen."""

    @classmethod
    def wanted(cls, scene) -> bool:
        return scene.output.gif

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        self._stride = STRIDE * math.ceil(recording.scene.camera.frame_count / (STRIDE * FRAMES))
        blank = shrunk(np.zeros(recording.view.shape, np.uint8), WIDTH_PX)
        self._log = Log(recording.work / "gif", np.dtype([("image", np.uint8, blank.shape)]), held)

    def frame(self, moment) -> None:
        if moment.frame % self._stride == 0:
            self._log.append(shrunk(brightened(moment.image, self.recording.scene), WIDTH_PX))

    def held(self) -> dict:
        return self._log.held()

    def closed(self, ending) -> None:
        fps = self.recording.scene.output.film_fps / self._stride
        if self._log.rows:
            write_gif(self._log.read()["image"], self.recording.folder / "film.gif", fps=fps, colours=COLOURS)
