"""What a tab lays over its eyes: a measured history, or the curves of a measured film.

A history is any table that `run --compare` takes; the curves are those of `edges.npz`, which `taichi-eye analyze`
leaves beside it. The bytes come from a browser: they are checked before they are used, and no code in them is run.
"""

from __future__ import annotations

import io
import math
import re
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.report.compare import read_measured

POINTS_MAX = 4000  # of a history, that are drawn
FRAMES_MAX, PLACES_MAX = 500, 240  # of curves
UNPACKED_MAX = 60_000_000  # bytes of an archive
REACH_MM, TIME_MS = 20.0, 1e4
CURVES = "curve_time_ms", "x_mm", "height_mm"


def read(data: bytes, name: str) -> dict[str, Any]:
    """A history or curves, for the page; SceneError with what is wrong. name: of the file, for messages alone."""
    name = re.sub(r"[^\w.() -]", "_", name)[-80:].strip(". ") or "table"
    return _curves(data, name) if data.startswith(b"PK") else _history(data, name)


def _history(data: bytes, name: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="taichi_eye-page-") as folder:
        path = Path(folder) / "table"  # a name of the user's may be too long for a file
        path.write_bytes(data)
        try:
            found = read_measured(path)
        except SceneError as refused:
            raise SceneError(str(refused).replace(str(path), name)) from None
    every = max(1, math.ceil(len(found.time_ms) / POINTS_MAX))
    told = {column: getattr(found, column)[::every].tolist() for column in ("time_ms", "displacement_mm")}
    return told | {"name": name, "column": found.column, "notes": list(found.notes)}


def _curves(data: bytes, name: str) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > UNPACKED_MAX:
                raise SceneError(f"{name}: holds more than {UNPACKED_MAX / 1e6:g} MB")
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            missing = [column for column in CURVES if column not in held.files]
            if missing:
                raise SceneError(f"{name}: lacks {missing[0]}; needed is an edges.npz of taichi-eye analyze")
            time, x, height = (np.asarray(held[column], dtype=float) for column in CURVES)
    except SceneError:
        raise
    except Exception as error:  # what a damaged archive raises depends on where it is damaged
        raise SceneError(f"{name}: cannot be read ({(str(error).splitlines() or [''])[0][:120]})") from None
    if time.ndim != 1 or x.ndim != 1 or height.shape != (len(time), len(x)) or len(time) < 2 or len(x) < 2:
        raise SceneError(f"{name}: {', '.join(CURVES)} have the shapes {time.shape}, {x.shape} and {height.shape}")
    seen = height[np.isfinite(height)]
    bounded = [(time, TIME_MS), (x, REACH_MM), (seen, REACH_MM)]
    if not all(np.isfinite(values).all() and (np.abs(values) <= most).all() for values, most in bounded):
        raise SceneError(f"{name}: holds values that are no numbers, or times and places beyond an eye's")
    rows, places = (
        slice(None, None, max(1, math.ceil(size / most))) for size, most in zip(height.shape, (FRAMES_MAX, PLACES_MAX))
    )
    shown = np.round(height[rows, places], 4).astype(object)
    shown[~np.isfinite(height[rows, places])] = None
    told = {"time_ms": np.round(time[rows], 4).tolist(), "x_mm": np.round(x[places], 4).tolist()}
    return told | {"height_mm": shown.tolist(), "name": name, "notes": ["the edge of the film, over both eyes"]}
