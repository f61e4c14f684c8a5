"""What a run folder holds for the analysis: its scene, its pictures, the wall and the puff that were computed.

A run folder is one with a scene.toml; its film.mp4 and its frames/ stand for it, for they may show two views in one
picture. Every file is checked before it is used; FilmError or SceneError name the one that is damaged. No code that a
file may carry is run.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_eye.analysis.curves import Curves, curves_from_wall
from taichi_eye.errors import FilmError
from taichi_eye.report.traces import read_traces
from taichi_eye.scene import Scene, load_scene
from taichi_eye.units import MMHG

WALL = "time_ms", "r_mm", "z_mm"
WALL_BYTES_MAX = 200_000_000
FILE_BYTES_MAX = 500_000_000
NODES_MIN = 8
TIME_MAX_MS = 1e4
REACH_MAX_MM = 30.0


@dataclass(frozen=True)
class Run:
    """A run: its scene; source: the film or folder of its pictures; truth: its curves, and puff_mmhg: the air's
    pressure at the apex as (time_ms, mmHg), where it kept them."""

    scene: Scene
    source: Path
    truth: Curves | None
    puff_mmhg: tuple[np.ndarray, np.ndarray] | None


def holding(path: Path) -> Path | None:
    """The run folder that a path is or stands for; None where there is none."""
    if path.is_dir() and (path / "scene.toml").is_file():
        return path
    stands = path.name in ("frames", "film.mp4") and (path.parent / "scene.toml").is_file()
    return path.parent if stands else None


def read(folder: Path) -> Run:
    """Read and check a run folder."""
    scene = load_scene(folder / "scene.toml")
    if scene.camera.view == "particles":
        raise FilmError(f"{folder}: this run filmed the particles only (camera.view); it has no slit frames")
    if (folder / "frames").is_dir():
        source = folder / "frames"
    elif (folder / "film.mp4").is_file():
        source = folder / "film.mp4"
    else:
        raise FilmError(f"{folder}: the run has neither film.mp4 nor frames/")
    wall, traces = folder / "wall.npz", folder / "traces.csv"
    return Run(
        scene,
        source,
        _truth(wall, scene.cornea.thickness_mm) if wall.is_file() else None,
        _puff(traces) if traces.is_file() else None,
    )


def _truth(path: Path, thickness_mm: float) -> Curves:
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > WALL_BYTES_MAX:
                raise FilmError(f"{path}: holds more than {WALL_BYTES_MAX / 1e6:g} MB")
        with np.load(path, allow_pickle=False) as held:
            missing = [name for name in WALL if name not in held.files]
            if missing:
                raise FilmError(f"{path}: lacks {missing[0]}; it holds {', '.join(held.files)[:100] or 'nothing'}")
            time, r, z = (np.asarray(held[name]) for name in WALL)
    except FilmError:
        raise
    except Exception as error:  # what a damaged archive raises depends on where it is damaged
        raise FilmError(f"{path}: cannot be read ({(str(error).splitlines() or [''])[0][:120]})") from None
    for name, values in zip(WALL, (time, r, z)):
        if values.dtype.kind not in "fiu":
            raise FilmError(f"{path}: {name} holds no numbers")
    if r.ndim != 2 or r.shape != z.shape or time.shape != r.shape[:1] or len(time) < 2 or r.shape[1] < NODES_MIN:
        raise FilmError(f"{path}: time_ms, r_mm and z_mm have the shapes {time.shape}, {r.shape} and {z.shape}")
    time, r, z = (values.astype(float) for values in (time, r, z))
    for name, values, most in (("time_ms", time, TIME_MAX_MS), ("r_mm", r, REACH_MAX_MM), ("z_mm", z, REACH_MAX_MM)):
        if not np.isfinite(values).all() or np.abs(values).max() > most:
            raise FilmError(f"{path}: {name} holds values that are no numbers or exceed {most:g}")
    if not (np.diff(time) > 0).all():
        raise FilmError(f"{path}: time_ms does not increase")
    if np.abs(r[:, 0]).max() > 0.1 or (r[:, -1] < 1.0).any() or (np.diff(r, axis=1) > 0).mean() < 0.9:
        raise FilmError(f"{path}: r_mm does not run from the apex outwards")
    return curves_from_wall(time, r, z, thickness_mm)


def _puff(path: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise ValueError(f"larger than {FILE_BYTES_MAX / 1e6:g} MB")
        traces = read_traces(path)
        time, pressure = traces["time_ms"], traces["puff_apex_kpa"] * 1e3 / MMHG
    except KeyError as error:
        raise FilmError(f"{path}: lacks the column {error.args[0]}") from None
    except Exception as error:  # what a damaged table raises depends on where it is damaged
        raise FilmError(f"{path}: not a run's traces ({(str(error).splitlines() or [''])[0][:120]})") from None
    if len(time) < 2 or not np.isfinite(time).all() or not np.isfinite(pressure).all() or not (np.diff(time) > 0).all():
        raise FilmError(f"{path}: time_ms does not increase, or there are values that are no numbers")
    return time, pressure
