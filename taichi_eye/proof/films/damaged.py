"""Damaged films: DA and the times that are still read from them.

Two eyes, each filmed with noise and then harmed: one frame in ten dropped (times from the stamps), every frame a JPEG
of quality 40, the picture turned by +5 or -5 degrees, a bright block pattern in the lower left corner, the axis 30 px
off the middle; and all of it at once, with 2 degrees. The turn is one of the true shape, about the middle of the frame.
"""

from __future__ import annotations

import io
from math import cos, radians, sin

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from scipy.ndimage import affine_transform

from taichi_eye.analysis import Instrument, curves_from_edges, find_edges, respond
from taichi_eye.analysis.stamps import read_stamps
from taichi_eye.bench.rows import Row, at_most
from taichi_eye.proof.films.eyes import EYES, INTERVAL_MS, TIMES_MS, Studio, truth
from taichi_eye.proof.films.reading import difference

NUMBERS = 0, 6  # of EYES
TURN_DEG, TURN_ALL_DEG = 5.0, 2.0
QUALITY = 40
AMPLITUDE_UM, TIME_MS = 20.0, 0.25
TIMES = "a1_time_ms", "hc_time_ms", "a2_time_ms"


def dropped(frames: np.ndarray) -> np.ndarray:
    """Nine frames in ten, in order, the first among them."""
    keep = np.random.default_rng(7).random(len(frames)) > 0.1
    keep[0] = True
    return frames[keep]


def jpeg(frames: np.ndarray) -> np.ndarray:
    """Every frame through a JPEG of low quality."""
    out = []
    for frame in frames:
        held = io.BytesIO()
        Image.fromarray(frame).save(held, "JPEG", quality=QUALITY)
        out.append(np.asarray(Image.open(held)))
    return np.stack(out)


def logo(frames: np.ndarray) -> np.ndarray:
    """A pattern of bright blocks in the lower left corner."""
    pattern = (235 * np.kron(np.random.default_rng(2).random((6, 22)) > 0.5, np.ones((5, 5)))).astype(np.uint8)
    out = frames.copy()
    out[:, 165:195, 6:116] = np.maximum(out[:, 165:195, 6:116], pattern)
    return out


def turned(frames: np.ndarray, angle_deg: float) -> np.ndarray:
    """The pictures turned about the middle of the frame, the corners filled with grey like air's."""
    pixel = Instrument()
    size = np.array([pixel.pixel_y_mm, pixel.pixel_x_mm])
    angle = radians(angle_deg)
    turn = np.array([[cos(angle), sin(angle)], [-sin(angle), cos(angle)]])
    matrix = turn * size[None, :] / size[:, None]
    middle = 0.5 * (np.array(frames.shape[1:]) - 1.0)
    return np.stack([affine_transform(frame, matrix, middle - matrix @ middle, order=1, cval=6.0) for frame in frames])


def everything(frames: np.ndarray) -> np.ndarray:
    """All harms one after the other."""
    return jpeg(logo(turned(dropped(frames), TURN_ALL_DEG)))


HARMS = {
    "one frame in ten dropped": (dropped, ()),
    "JPEG of quality 40": (jpeg, ()),
    "turned by +5 degrees": (lambda frames: turned(frames, TURN_DEG), ()),
    "turned by -5 degrees": (lambda frames: turned(frames, -TURN_DEG), ()),
    "a logo in the corner": (logo, ()),
    "axis 30 px off the middle": (lambda frames: frames, ("camera.apex_column_px=318",)),
    "all of it": (everything, ("camera.apex_column_px=318",)),
}


def errors(studio: Studio, number: int, harm: str) -> tuple[float, float]:
    """Error of DA [um] and the largest of the three times [ms]."""
    do, overrides = HARMS[harm]
    eye = EYES[number]
    scene = eye.scene("camera.apex_row_px=28", *overrides)
    frames = do(studio.frames(eye, scene))
    # a turned film's stamp is turned with it: its frames are counted, none is missing
    times = TIMES_MS if len(frames) == len(TIMES_MS) else read_stamps(frames, INTERVAL_MS)
    if times is None:
        return float("inf"), float("inf")
    known = np.isfinite(times)
    read = respond(curves_from_edges(find_edges(frames[known]), times[known], Instrument()), INTERVAL_MS)
    true = respond(truth(eye, scene), INTERVAL_MS)
    return (
        difference(read, true, "deformation_amplitude_mm", "um"),
        max(difference(read, true, name, "ms") for name in TIMES),
    )


def measure(stage) -> tuple[list[Row], list[Figure]]:
    """Two rows for each harm."""
    studio, rows = Studio(), []
    for harm in HARMS:
        stage(harm)
        found = [errors(studio, number, harm) for number in NUMBERS]
        amplitude, late = (max(pair[k] for pair in found) for k in (0, 1))
        rows += [
            at_most(f"{harm}: DA", amplitude, "um", AMPLITUDE_UM, f"worst of {len(NUMBERS)} eyes"),
            at_most(f"{harm}: A1, HC, A2 time", late, "ms", TIME_MS),
        ]
    return rows, []
