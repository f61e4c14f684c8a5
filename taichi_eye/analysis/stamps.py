"""Times read from the stamp that an instrument writes into a corner of its frames, such as "9.26 ms".

Bright connected shapes of one height on one line are digits, a low one between them the point; each digit is compared
with those of a few common typefaces. A reading counts where it falls on a whole number of frame intervals and follows
the readings before it; readings that differ from frame to frame but do not rise are those of a film out of order, and
returned as they are. Unread frames between two readings are counted off where none is missing there; elsewhere their
time stays unknown.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import find_objects, label

FACES = "DejaVuSans", "DejaVuSans-Bold", "DejaVuSansMono", "DejaVuSansMono-Bold", "DejaVuSerif", "STIXGeneral"
BRIGHT = 110  # grey level that a stamp exceeds
TILE = 16, 12  # rows, columns that a digit is scaled to
MATCH_MIN = 0.55  # correlation with the nearest digit
READ_MIN = 0.5  # share of the frames that must be read
ORDERED_MIN = 0.8  # share of the readings that rise, in a film in order
DISTINCT_MIN = 0.9  # share of the readings that differ, in a film out of order


def read_stamps(frames: np.ndarray, frame_interval_ms: float) -> np.ndarray | None:
    """Times [frames] in ms from the stamps in uint8 frames [frames, rows, columns], NaN where unknown; None where there
    are no stamps.

    frame_interval_ms: stamps are held to whole multiples of it.
    """
    height, width = frames.shape[1:]
    lower = slice(height - height // 4, height)
    for side in (slice(width - width * 2 // 5, width), slice(0, width * 2 // 5)):
        if (frames[:, lower, side].max(axis=(1, 2)) > BRIGHT).mean() < READ_MIN:
            continue
        values = np.array([_read(image) for image in frames[:, lower, side]], dtype=float)
        times = _consistent(values, frame_interval_ms)
        if times is not None:
            return times
    return None


def _read(image: np.ndarray) -> float:
    """The number in a corner of a frame; NaN where none is read."""
    level = image.astype(float)
    top = np.percentile(level, 99.7)
    if top < BRIGHT:
        return np.nan
    shapes, _ = label(level > 0.5 * top, structure=np.ones((3, 3)))
    boxes = [(b[0].start, b[0].stop, b[1].start, b[1].stop) for b in find_objects(shapes)]
    tall = [b for b in boxes if 6 <= b[1] - b[0] <= image.shape[0] and b[3] - b[2] <= 1.1 * (b[1] - b[0])]
    for anchor in tall:
        line = [b for b in tall if abs(b[0] - anchor[0]) <= 2 and abs(b[1] - anchor[1]) <= 2]
        size = anchor[1] - anchor[0]
        line = sorted(line, key=lambda b: b[2])
        text, last = "", None
        for box in line:
            if last is not None and box[2] - last[3] > 1.5 * size:
                break
            between = [
                b
                for b in boxes
                if last is not None
                and last[3] - 1 <= b[2]
                and b[3] <= box[2] + 1
                and b[1] - b[0] <= 0.45 * size
                and b[0] >= anchor[0] + 0.55 * size
            ]
            digit, match = _digit(level[box[0] : box[1], box[2] : box[3]], size)
            if match < MATCH_MIN:
                break
            text += ("." if between else "") + digit
            last = box
        if text.count(".") == 1 and len(text) >= 3:
            return float(text)
    return np.nan


def _digit(crop: np.ndarray, size: int) -> tuple[str, float]:
    if crop.shape[1] < 0.3 * size:
        return "1", 1.0
    tile = _tile(crop)
    scores = {digit: max(float((tile * one).sum()) for one in tiles) for digit, tiles in _templates().items()}
    best = max(scores, key=scores.get)
    return best, scores[best]


def _tile(crop: np.ndarray) -> np.ndarray:
    """A crop at TILE's size, of zero mean and unit norm."""
    image = Image.fromarray(crop.astype(np.float32)).resize(TILE[::-1], Image.Resampling.BILINEAR)
    tile = np.asarray(image, float) - np.asarray(image, float).mean()
    return tile / max(np.linalg.norm(tile), 1e-9)


@lru_cache(maxsize=1)
def _templates() -> dict[str, list[np.ndarray]]:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    tiles: dict[str, list[np.ndarray]] = {digit: [] for digit in "0123456789"}
    for name in FACES:
        for size in (12, 14, 20):
            face = ImageFont.truetype(str(folder / f"{name}.ttf"), size)
            for digit in tiles:
                canvas = Image.new("L", (3 * size, 3 * size))
                ImageDraw.Draw(canvas).text((size, size), digit, fill=255, font=face)
                bits = np.asarray(canvas, float)
                rows, columns = (np.flatnonzero((bits > 127).any(axis=axis)) for axis in (1, 0))
                tiles[digit].append(_tile(bits[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]))
    return tiles


def _consistent(values: np.ndarray, interval: float) -> np.ndarray | None:
    """The readings that rise by whole intervals, the others bridged; None where they are too few."""
    number = values / interval
    near = np.abs(values - np.round(number) * interval) < 0.02 + 2e-3 * values
    usable = np.flatnonzero(np.isfinite(values) & near)
    if len(usable) < READ_MIN * len(values):
        return None
    whole = np.round(number[usable])
    kept = usable[_rising(whole)]
    if len(kept) < ORDERED_MIN * len(usable):
        # read well but out of order: the frames are, where hardly any two read alike
        if len(np.unique(whole)) < DISTINCT_MIN * len(whole):
            return None
        times = np.full(len(values), np.nan)
        times[usable] = interval * whole
        return times
    if len(kept) < READ_MIN * len(values):
        return None
    times = np.full(len(values), np.nan)
    times[kept] = interval * np.round(values[kept] / interval)
    # between two readings the unread frames are known where none is missing; else they stay unknown
    for i, j in zip(kept, kept[1:]):
        if round((times[j] - times[i]) / interval) == j - i:
            times[i:j] = times[i] + interval * np.arange(j - i)
    return times


def _rising(number: np.ndarray) -> np.ndarray:
    """Indices of the longest rising sequence."""
    length, before = np.ones(len(number), int), np.full(len(number), -1)
    for i in range(1, len(number)):
        below = np.where(number[:i] < number[i], length[:i], 0)
        best = int(below.argmax())
        if below[best] > 0:
            length[i], before[i] = below[best] + 1, best
    chain = [int(np.argmax(length))]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])
