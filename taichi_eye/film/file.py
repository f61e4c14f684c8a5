"""A film that is written already: its frames as arrays, and what a notebook shows for it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from taichi_eye.film.encoder import slim
from taichi_eye.report import result as page


@dataclass(frozen=True)
class FilmFile:
    """An MP4 at `path`; it can be handed to whatever takes a path."""

    path: Path

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def frames(self) -> np.ndarray:
        """All frames as decoded, uint8 [frames, rows, columns, 3]; OSError where the film cannot be read."""
        with open(self.path, "rb"):
            pass  # a missing film is said so in the system's words
        reader = imageio_ffmpeg.read_frames(str(self.path))
        columns, rows = next(reader)["size"]
        return np.stack([np.frombuffer(frame, np.uint8).reshape(rows, columns, 3) for frame in reader])

    def _repr_html_(self) -> str:
        return page.video(slim(self.path))
