"""Frames and their times from a film, a folder of images or a run folder, on the instrument's own pixels.

Pictures of another scale are brought to the instrument's pixel first: widths and blurs of the edges are known there.
Where the size of a pixel is not given, a picture of the instrument's shape shows its field, however large the copy, and
one that differs from it by a few pixels is one that was padded or cropped. What was left out, and why, stands in the
film's notes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from taichi_eye.analysis import run_folder
from taichi_eye.analysis.curves import Curves, Instrument
from taichi_eye.analysis.decode import FRAMES_MIN, Wanted, decode, kind
from taichi_eye.analysis.times import refuse_long, repeats, times_of, without_copy_marks
from taichi_eye.errors import FilmError
from taichi_eye.scene import Scene

FIELD_PX = 576, 200  # columns, rows of the instrument's frame
PADDED_PX = 4  # columns or rows that a padded or cropped frame differs by
SAME_SCALE = 0.01
COLUMNS_ROWS = (192, 1600), (64, 800)  # of a picture on the instrument's pixels
COARSEST = 3.0  # of the instrument's pixel
LIMITS = {
    "pixel_x_mm": (0.001, 0.1),
    "pixel_y_mm": (0.001, 0.1),
    "frame_interval_ms": (0.01, 5.0),
    "angle_deg": (5.0, 85.0),
    "refractive_index": (1.0, 2.0),
}


@dataclass(frozen=True)
class Film:
    """Slit frames, uint8 [frames, rows, columns], at time_ms [frames], rising.

    timed_by: where the times come from. instrument: scale and optics of these frames. notes: what was left out or
    mended. truth: the computed curves, for a run that kept its wall; puff_mmhg: its air pressure at the apex as
    (time_ms, mmHg); iop_mmhg: its pressure.
    """

    frames: np.ndarray
    time_ms: np.ndarray
    timed_by: str
    instrument: Instrument
    name: str
    notes: tuple[str, ...] = ()
    truth: Curves | None = None
    puff_mmhg: tuple[np.ndarray, np.ndarray] | None = None
    iop_mmhg: float | None = None


def read_film(path: str | Path, **settings: float | None) -> Film:
    """Read a film (mp4, avi, ...), a folder of images, an image of many pages, or a run folder.

    settings: fields of `Instrument` that are known better than its defaults (or, for a run, than the scene's camera);
    None leaves one as it is. Raises FilmError with what is wrong.
    """
    path = Path(path)
    given = _checked({name: value for name, value in settings.items() if value is not None})
    folder = run_folder.holding(path) if kind(path) else None
    if folder is not None:
        return _of_run(folder, given)
    wanted, notes = {}, []

    def shape(columns: int, rows: int) -> Wanted:
        wanted["x"], wanted["y"], size, said = _scale(path, columns, rows, given)
        notes.extend(said)
        return Wanted((columns, rows), size)

    pictures = decode(path, shape)
    instrument = replace(Instrument(), **given | {"pixel_x_mm": wanted["x"], "pixel_y_mm": wanted["y"]})
    notes += pictures.notes
    frames, names = pictures.frames, without_copy_marks(pictures.names)
    again = repeats(frames)
    if again.any():
        notes.append(f"{again.sum()} frames that repeat the one before left out")
        frames, names = frames[~again], tuple(name for name, out in zip(names, again) if not out)
    times, how, said = times_of(names, frames, instrument.frame_interval_ms)
    notes += said
    refuse_long(path, times, how)
    order, said = _in_order(times, how)
    notes += said
    if len(order) < FRAMES_MIN:
        raise FilmError(f"{path}: {len(order)} different frames of known time; at least {FRAMES_MIN} are needed")
    return Film(frames[order], times[order], how, instrument, path.stem, tuple(notes))


def _checked(given: dict[str, float]) -> dict[str, float]:
    known = {field.name for field in fields(Instrument)}
    for name, value in given.items():
        if name not in known:
            raise FilmError(f"{name}: the instrument has {', '.join(sorted(known))}")
        low, high = LIMITS[name]
        if not low <= value <= high:
            raise FilmError(f"{name} = {value:g}; allowed is {low:g} to {high:g}")
    return given


def _scale(path: Path, columns: int, rows: int, given: dict) -> tuple[float, float, tuple[int, int], list[str]]:
    """Size of a pixel [mm] across and down after resampling, the columns and rows then, and notes."""
    native = Instrument()
    x, y = given.get("pixel_x_mm"), given.get("pixel_y_mm")
    notes = []
    if x is None or y is None:
        padded = abs(columns - FIELD_PX[0]) <= PADDED_PX and abs(rows - FIELD_PX[1]) <= PADDED_PX
        if padded:
            share = 1.0, 1.0
            if (columns, rows) != FIELD_PX:
                notes.append(f"frames of {columns} x {rows} px taken for padded or cropped ones, not scaled")
        elif abs(columns * FIELD_PX[1] / (rows * FIELD_PX[0]) - 1.0) < 0.03:
            share = FIELD_PX[0] / columns, FIELD_PX[1] / rows
        else:
            raise FilmError(
                f"{path}: frames of {columns} x {rows} px do not have the shape of the instrument's "
                f"{FIELD_PX[0]} x {FIELD_PX[1]}; say how large a pixel is (--pixel-x-mm and --pixel-y-mm)"
            )
        x = native.pixel_x_mm * share[0] if x is None else x
        y = native.pixel_y_mm * share[1] if y is None else y
    across, down = x / native.pixel_x_mm, y / native.pixel_y_mm
    if max(abs(across - 1.0), abs(down - 1.0)) < SAME_SCALE:
        size = columns, rows
    else:
        size = round(columns * across), round(rows * down)
        x, y = columns * x / max(size[0], 1), rows * y / max(size[1], 1)
    if max(across, down) > COARSEST:
        raise FilmError(f"{path}: pixels of {x:.3g} x {y:.3g} mm are too coarse; at most {COARSEST:g} times 0.0156 mm")
    if not all(low <= n <= high for n, (low, high) in zip(size, COLUMNS_ROWS)):
        raise FilmError(
            f"{path}: frames of {columns} x {rows} px show {columns * given.get('pixel_x_mm', x):.3g} x "
            f"{rows * given.get('pixel_y_mm', y):.3g} mm at this size of a pixel; the instrument's show 9 x 3.3 mm"
        )
    if size != (columns, rows):
        notes.append(f"frames resampled from {columns} x {rows} to {size[0]} x {size[1]} px, the instrument's scale")
    return x, y, size, notes


def _in_order(times: np.ndarray, how: str) -> tuple[np.ndarray, list[str]]:
    """The frames of known and distinct time, in the order of their times; and notes."""
    notes = []
    known = np.flatnonzero(np.isfinite(times))
    if len(known) < len(times):
        notes.append(f"{len(times) - len(known)} frames of unknown time left out")
    order = known[np.argsort(times[known], kind="stable")]
    if not (order == known).all():
        notes.append(f"the frames were not in the order of {how}; put in order")
    distinct = np.concatenate([[True], np.diff(times[order]) > 1e-6]) if len(order) else np.zeros(0, bool)
    if not distinct.all():
        notes.append(f"{(~distinct).sum()} frames of the same time as another left out")
    return order[distinct], notes


def _of_run(folder: Path, given: dict) -> Film:
    run = run_folder.read(folder)
    camera = run.scene.camera
    given = {"pixel_x_mm": camera.pixel_x_mm, "pixel_y_mm": camera.pixel_y_mm} | given
    scaled, notes = {}, []

    def shape(columns: int, rows: int) -> Wanted:
        part = _slit(run.source, run.scene, columns, rows)
        scaled["x"], scaled["y"], size, said = _scale(run.source, camera.width_px, camera.height_px, given)
        notes.extend(said)
        return Wanted(part, size, coloured=camera.view == "both")

    pictures = decode(run.source, shape)
    settings = {
        "frame_interval_ms": camera.frame_interval_ms,
        "angle_deg": camera.angle_deg,
        "refractive_index": camera.refractive_index,
    }
    instrument = Instrument(**settings | given | {"pixel_x_mm": scaled["x"], "pixel_y_mm": scaled["y"]})
    times = np.arange(len(pictures.frames)) * instrument.frame_interval_ms
    notes += pictures.notes
    refuse_long(folder, times, "the scene's frame interval")
    return Film(
        pictures.frames,
        times,
        "the scene's frame interval",
        instrument,
        folder.resolve().name,
        tuple(notes),
        run.truth,
        run.puff_mmhg,
        run.scene.eye.iop_mmhg,
    )


def _slit(source: Path, scene: Scene, columns: int, rows: int) -> tuple[int, int]:
    """Columns and rows of the slit frame in a run's picture, of which "both" shows it doubled over the particles."""
    camera = scene.camera
    part = camera.width_px, camera.height_px
    if camera.view == "both":
        part = 2 * part[0], 2 * part[1]
    # the encoder pads an odd size by one
    fits = 0 <= columns - part[0] <= 1 and (0 <= rows - part[1] <= 1 or (camera.view == "both" and rows > part[1]))
    if not fits:
        raise FilmError(
            f"{source}: pictures of {columns} x {rows} px are not those of scene.toml, whose camera has "
            f"{camera.width_px} x {camera.height_px} px and the view {camera.view}"
        )
    return part
