"""Frames and their times from a film, a folder of images or a run folder."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image, UnidentifiedImageError

from taichi_eye.analysis.curves import Curves, Instrument, curves_from_wall
from taichi_eye.analysis.stamps import read_stamps
from taichi_eye.errors import FilmError
from taichi_eye.report.traces import read_traces
from taichi_eye.scene import load_scene
from taichi_eye.units import MMHG

IMAGES = ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"
FIELD_PX = 576, 200  # columns, rows of the instrument's frame
FRAMES_MAX, PIXELS_MAX = 2000, 4_000_000
FRAMES_MIN = 8
_MS = re.compile(r"(\d+(?:\.\d+)?)\s*ms", re.IGNORECASE)
_NUMBER = re.compile(r"(\d+)(?!.*\d)")


@dataclass(frozen=True)
class Film:
    """Slit frames, uint8 [frames, rows, columns], at time_ms [frames].

    timed_by: where the times come from. truth: the computed curves, for a run that kept its wall; puff_mmhg: its air
    pressure at the apex as (time_ms, mmHg); iop_mmhg: its pressure.
    """

    frames: np.ndarray
    time_ms: np.ndarray
    timed_by: str
    instrument: Instrument
    name: str
    truth: Curves | None = None
    puff_mmhg: tuple[np.ndarray, np.ndarray] | None = None
    iop_mmhg: float | None = None


def read_film(path: str | Path, **settings: float | None) -> Film:
    """Read a film (mp4, avi, ...), a folder of images, or a run folder.

    settings: fields of `Instrument` that are known better than its defaults (or, for a run, than the scene's camera);
    None leaves one as it is. Times come from file names ("..._09.26ms.png"), else from stamps in the frames, else from
    numbers in file names, else from counting. Raises FilmError with what is wrong.
    """
    path = Path(path)
    given = {name: value for name, value in settings.items() if value is not None}
    if not path.exists():
        raise FilmError(f"{path}: there is no such file or folder")
    if path.is_dir() and (path / "scene.toml").is_file():
        return _read_run(path, given)
    instrument = replace(Instrument(), **given)
    if path.is_dir():
        files = sorted((f for f in path.iterdir() if f.suffix.lower() in IMAGES), key=_natural)
        frames = _fitting(_read_images(path, files), given, path)
        times, how = _times_of(files, frames, instrument.frame_interval_ms)
    else:
        frames = _fitting(_read_video(path), given, path)
        times, how = _times_of([], frames, instrument.frame_interval_ms)
    known = np.isfinite(times)
    frames, times = frames[known], times[known]
    columns = frames.shape[2]
    if columns != FIELD_PX[0] and "pixel_x_mm" not in given and "pixel_y_mm" not in given:
        # a copy of another size shows the same field
        scale = FIELD_PX[0] / columns
        instrument = replace(
            instrument,
            pixel_x_mm=instrument.pixel_x_mm * scale,
            pixel_y_mm=instrument.pixel_y_mm * FIELD_PX[1] / frames.shape[1],
        )
    return Film(frames, times, how, instrument, path.stem)


def _read_run(path: Path, given: dict) -> Film:
    scene = load_scene(path / "scene.toml")
    camera = scene.camera
    if camera.view == "particles":
        raise FilmError(f"{path}: this run filmed the particles only (camera.view); it has no slit frames")
    instrument = replace(
        Instrument(
            camera.pixel_x_mm, camera.pixel_y_mm, camera.frame_interval_ms, camera.angle_deg, camera.refractive_index
        ),
        **given,
    )
    pictures = path / "frames"
    if pictures.is_dir():
        stack = _read_images(pictures, sorted((f for f in pictures.iterdir() if f.suffix == ".png"), key=_natural))
    elif (path / "film.mp4").is_file():
        stack = _read_video(path / "film.mp4")
    else:
        raise FilmError(f"{path}: the run has neither film.mp4 nor frames/")
    if camera.view == "both":
        part = stack[:, : 2 * camera.height_px, : 2 * camera.width_px].astype(np.float32)
        part = part.reshape(len(part), camera.height_px, 2, camera.width_px, 2).mean(axis=(2, 4))
        stack = np.rint(part).astype(np.uint8)
    truth = puff = None
    if (path / "wall.npz").is_file():
        with np.load(path / "wall.npz") as wall:
            truth = curves_from_wall(wall["time_ms"], wall["r_mm"], wall["z_mm"], scene.cornea.thickness_mm)
    if (path / "traces.csv").is_file():
        traces = read_traces(path / "traces.csv")
        puff = traces["time_ms"], traces["puff_apex_kpa"] * 1e3 / MMHG
    time = np.arange(len(stack)) * instrument.frame_interval_ms
    return Film(stack, time, "the scene's frame interval", instrument, path.name, truth, puff, scene.eye.iop_mmhg)


def _read_video(path: Path) -> np.ndarray:
    if path.suffix.lower() in IMAGES:
        raise FilmError(f"{path}: one image is no film; name the folder that holds them all")
    try:
        reader = imageio_ffmpeg.read_frames(str(path), pix_fmt="rgb24")
        size = next(reader)["size"]
        frames = []
        for raw in reader:
            if len(frames) >= FRAMES_MAX or size[0] * size[1] > PIXELS_MAX:
                raise FilmError(f"{path}: more than {FRAMES_MAX} frames or {PIXELS_MAX} pixels a frame")
            frames.append(_flatten(np.frombuffer(raw, np.uint8).reshape(size[1], size[0], 3)))
    except FilmError:
        raise
    except (OSError, RuntimeError, StopIteration, KeyError, ValueError) as error:
        said = (str(error).strip().splitlines() or ["no frames"])[-1]
        raise FilmError(f"{path}: not a film that can be decoded ({said[:160]})") from None
    if len(frames) < FRAMES_MIN:
        raise FilmError(f"{path}: {len(frames)} frames; at least {FRAMES_MIN} are needed")
    return np.stack(frames)


def _read_images(path: Path, files: list[Path]) -> np.ndarray:
    if len(files) < FRAMES_MIN:
        raise FilmError(f"{path}: {len(files)} images ({', '.join(IMAGES)}); at least {FRAMES_MIN} are needed")
    if len(files) > FRAMES_MAX:
        raise FilmError(f"{path}: more than {FRAMES_MAX} images")
    frames = []
    for file in files:
        try:
            with Image.open(file) as image:
                frames.append(_flatten(np.asarray(image.convert("RGB"))))
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
            raise FilmError(f"{file}: not an image that can be read") from None
        if frames[-1].shape != frames[0].shape:
            raise FilmError(
                f"{file}: {frames[-1].shape[1]} x {frames[-1].shape[0]} px, the first image has "
                f"{frames[0].shape[1]} x {frames[0].shape[0]}"
            )
    return np.stack(frames)


def _flatten(image: np.ndarray) -> np.ndarray:
    """RGB [rows, columns, 3] to grey, rounded."""
    return ((image.astype(np.uint16).sum(axis=2) + 1) // 3).astype(np.uint8)


def _fitting(frames: np.ndarray, given: dict, path: Path) -> np.ndarray:
    """The frames, where their shape is the instrument's or their scale is given; FilmError otherwise."""
    rows, columns = frames.shape[1:]
    if min(rows, columns) < 64:
        raise FilmError(f"{path}: frames of {columns} x {rows} px are too small")
    alike = abs(columns * FIELD_PX[1] / (rows * FIELD_PX[0]) - 1.0) < 0.03
    if not alike and not {"pixel_x_mm", "pixel_y_mm"} <= given.keys():
        raise FilmError(
            f"{path}: frames of {columns} x {rows} px do not have the shape of the instrument's "
            f"{FIELD_PX[0]} x {FIELD_PX[1]}; say how large a pixel is (--pixel-x-mm and --pixel-y-mm)"
        )
    return frames


def _times_of(files: list[Path], frames: np.ndarray, interval: float) -> tuple[np.ndarray, str]:
    named = [_MS.search(file.stem) for file in files]
    if files and all(named):
        times = np.array([float(match[1]) for match in named])
        if (np.diff(times) > 0).all():
            return times, "file names"
    stamped = read_stamps(frames, interval)
    if stamped is not None:
        return stamped, "stamps in the frames"
    numbered = [_NUMBER.search(file.stem) for file in files]
    if files and all(numbered):
        numbers = np.array([int(match[1]) for match in numbered])
        if (np.diff(numbers) > 0).all():
            return (numbers - min(numbers[0], 1)) * interval, "numbers in the file names"
    return np.arange(len(frames)) * interval, "counting; a missing frame would go unnoticed"


def _natural(path: Path) -> list:
    return [int(part) if part.isdigit() else part.lower() for part in re.split(r"(\d+)", path.name)]
