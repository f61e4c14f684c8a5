"""Slit images as they are shown to people: brighter than the instrument's grey levels, which a projector swallows.

Frames, film.mp4 and their reading keep the instrument's levels; sheets, GIFs, and on report.html films of the slit
image alone are shown with the gain.
"""

from __future__ import annotations

import numpy as np

DISPLAY_GAIN = 1.7  # the anterior line, 85 on the axis, becomes 145; the plain band and the nodes are bright already


def gain_of(scene) -> float:
    """How much brighter the slit image of a scene is shown."""
    return DISPLAY_GAIN if scene.camera.optics == "full" else 1.0


def brightened(image: np.ndarray, scene) -> np.ndarray:
    """A frame of a scene's view, uint8, its slit image with the gain: all of it, the upper part of both views, or
    none."""
    gain, camera = gain_of(scene), scene.camera
    if gain == 1.0 or camera.view == "particles":
        return image
    rows = slice(None) if camera.view == "scheimpflug" else slice(2 * camera.height_px)
    shown = image.copy()
    shown[rows] = levels(gain)[image[rows]]
    return shown


def levels(gain: float) -> np.ndarray:
    """The grey level shown for each of 256, uint8."""
    return np.minimum(np.arange(256) * gain + 0.5, 255.0).astype(np.uint8)
