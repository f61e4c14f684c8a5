"""Text on images: glyphs of matplotlib's DejaVu Sans, rasterised once per size and blended where needed."""

from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

CHARACTERS = "0123456789.,-+ abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ/()="


@cache
def font(size_px: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans of `size_px` pixels, from the copy that matplotlib ships."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size_px)


class GlyphAtlas:
    """Coverage masks of single characters on a common baseline; DejaVu's digits are of one width, so numbers
    stay in place while they change."""

    def __init__(self, size_px: int, bold: bool = False):
        face = font(size_px, bold)
        ascent, descent = face.getmetrics()
        self.height = ascent + descent
        self.glyphs = {}
        for character in CHARACTERS:
            width = max(1, round(face.getlength(character)))
            tile = Image.new("L", (width, self.height))
            ImageDraw.Draw(tile).text((0, 0), character, fill=255, font=face)
            self.glyphs[character] = np.asarray(tile, np.float32) / 255.0

    def mask(self, text: str) -> np.ndarray:
        """Coverage of one line of text in 0..1, shape [height, width].

        Raises KeyError for a character outside CHARACTERS.
        """
        return np.concatenate([self.glyphs[character] for character in text], axis=1)


@cache
def glyph_atlas(size_px: int, bold: bool = False) -> GlyphAtlas:
    """The atlas of a size, rasterised once."""
    return GlyphAtlas(size_px, bold)


def stamp(image: np.ndarray, mask: np.ndarray, row: int, column: int, colour) -> None:
    """Blend `mask` into `image` ([H, W] or [H, W, 3], uint8) in place, its top left corner at (row, column);
    what falls outside the image is cut off. `colour` is a grey level or three of them."""
    top, left = max(row, 0), max(column, 0)
    bottom, right = min(row + mask.shape[0], image.shape[0]), min(column + mask.shape[1], image.shape[1])
    if top >= bottom or left >= right:
        return
    cover = mask[top - row : bottom - row, left - column : right - column]
    if image.ndim == 3:
        cover = cover[..., None]
    patch = image[top:bottom, left:right]
    patch[...] = np.rint(patch + cover * (np.asarray(colour, np.float32) - patch)).astype(np.uint8)
