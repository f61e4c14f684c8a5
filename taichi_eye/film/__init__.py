"""Live, off-screen film: solver fields to 8-bit images in Taichi kernels, images to a film while the run
goes on."""

import numpy as np

from taichi_eye.solver.workspace import capacity

from .encoder import EncoderError, FilmWriter, ffmpeg, frame_name, shrunk, slim, write_gif
from .particles import SMALLEST as SMALLEST_SECTION
from .particles import Particles, section_size
from .scheimpflug import SMALLEST as SMALLEST_FRAME
from .scheimpflug import Scheimpflug, frame_size
from .state import FrameState
from .surface import SMALLEST as SMALLEST_TABLE
from .surface import Surface, table_size

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
    "slim",
    "write_gif",
]


def _stamped_below(scene) -> bool:
    return scene.camera.stamp and scene.camera.view == "particles"


class FilmView:
    """The view that scene.camera.view asks for: "scheimpflug", "particles" or "both" in one frame.

    "both" puts the Scheimpflug frame, every pixel doubled, over the particle view; the time then stands in
    the upper one alone. All views share one `Surface`. slit: the Scheimpflug frame within the last one rendered, uint8
    [height_px, width_px]; None where the view has none.
    """

    def __init__(self, scene):
        self.surface = Surface(scene)
        self.scheimpflug = Scheimpflug(scene, self.surface)
        self.particles = None
        if scene.camera.view != "scheimpflug":
            self.particles = Particles(scene, self.surface, _stamped_below(scene))
        self._take(scene)

    @staticmethod
    def capacities(scene) -> tuple:
        """What the fields of a view are made for: it can show other scenes that have the same."""
        sizes = (table_size(scene), SMALLEST_TABLE), (frame_size(scene), SMALLEST_FRAME)
        if scene.camera.view != "scheimpflug":
            sizes += ((section_size(scene), SMALLEST_SECTION),)
        return tuple(capacity(*size) for size in sizes)

    def setup(self, scene) -> None:
        """Show another scene of the same `capacities`."""
        self.surface.setup(scene)
        self.scheimpflug.setup(scene)
        if self.particles is not None:
            self.particles.setup(scene, _stamped_below(scene))
        self._take(scene)

    def _take(self, scene) -> None:
        self.scene, self.kind, self.slit = scene, scene.camera.view, None

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
