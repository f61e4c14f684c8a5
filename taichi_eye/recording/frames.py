"""frames/: every frame as a PNG."""

from __future__ import annotations

from PIL import Image

from taichi_eye.film import frame_name
from taichi_eye.recording.observer import Observer
from taichi_eye.report.folder import replacing


class Frames(Observer):
    """A PNG per frame, named by number and time. Frames after a checkpoint are drawn again, to the same bytes."""

    @classmethod
    def wanted(cls, scene) -> bool:
        return scene.output.png_frames

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        self._folder = recording.folder / "frames"
        self._folder.mkdir(exist_ok=True)

    def frame(self, moment) -> None:
        with replacing(self._folder / frame_name(moment.frame, moment.time_ms)) as temporary:
            Image.fromarray(moment.image).save(temporary)
