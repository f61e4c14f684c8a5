"""Live, off-screen film: solver fields to 8-bit images in Taichi kernels, images to a film while the run
goes on."""

from dataclasses import replace

import numpy as np

from taichi_eye.eye.eye import eye_of

from .encoder import EncoderError, FilmWriter, ffmpeg, frame_name, shrunk, write_gif
from .particles import Particles
from .scheimpflug import Scheimpflug
from .state import FrameState
from .surface import Surface

__all__ = [
    "EncoderError",
    "FilmView",
    "FilmWriter",
    "FrameState",
    "Particles",
    "Scheimpflug",
    "Surface",
    "ffmpeg",
    "frame_name",
    "shrunk",
    "write_gif",
]


class FilmView:
    """The view that scene.camera.view asks for: "scheimpflug", "particles" or "both" in one frame.

    "both" puts the Scheimpflug frame, every pixel doubled, over the particle view; the time then stands in
    the upper one alone. All views share one `Surface`. slit: the Scheimpflug frame within the last one rendered, uint8
    [height_px, width_px]; None where the view has none.
    """

    def __init__(self, scene):
        self.scene = scene
        self.kind = scene.camera.view
        self.surface = Surface(scene)
        self.scheimpflug = Scheimpflug(scene, self.surface)
        self.slit: np.ndarray | None = None
        self.particles = None
        if self.kind != "scheimpflug":
            stamped = scene.camera.stamp and self.kind == "particles"
            self.particles = Particles(scene, self.surface, stamped)

    @staticmethod
    def built_in(scene) -> tuple:
        """What the kernels of a view have built in: it can show other scenes that have the same."""
        return replace(scene.camera, seed=0, frame_count=1, frame_interval_ms=1.0), eye_of(scene).section

    def setup(self, scene) -> None:
        """Show another scene, `built_in` as the first."""
        self.scene, self.slit = scene, None
        for part in (self.surface, self.scheimpflug, self.particles):
            if part is not None:
                part.setup(scene)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a frame: (H, W) grey for "scheimpflug", else (H, W, 3) RGB."""
        height, width = self.scheimpflug.height, self.scheimpflug.width
        if self.kind == "scheimpflug":
            return height, width
        below = self.particles.layout
        return (below.height if self.kind == "particles" else below.height + 2 * height), below.width, 3

    def render(self, state: FrameState) -> np.ndarray:
        """The frame at `state`, uint8, of shape `shape`; a new array each time."""
        if self.kind == "particles":
            return self.particles.render(state)
        self.slit = self.scheimpflug.render(state)
        if self.kind == "scheimpflug":
            return self.slit
        image = np.empty(self.shape, np.uint8)
        height, width = self.slit.shape
        # a pixel of three channels, doubled, is three pairs of equal bytes
        pairs = self.slit * np.uint16(0x101)
        doubled = image[: 2 * height].reshape(height, 2, 6 * width)
        for k in range(3):
            doubled[:, 0].view(np.uint16)[:, k::3] = pairs
        doubled[:, 1] = doubled[:, 0]
        self.particles.render(state, fresh=False, out=image[2 * height :])
        return image

    def scheimpflug_frame(self, state: FrameState) -> np.ndarray:
        """The Scheimpflug frame at `state`, uint8 [height_px, width_px], whatever the view."""
        return self.scheimpflug.render(state)
