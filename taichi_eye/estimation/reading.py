"""From what a user has to what is fitted: a trace, a film, a run or a table, checked, or refused in one message.

A table with a column of times is a trace; one with columns of clinical parameters is a row of them for every
examination. A traces.csv of a run holds the apex without the retreat of the whole eye, a trace of an instrument holds
it where its column is a displacement, and a histories.csv of `taichi-eye analyze` is read as films are. A run is its
film; without slit frames, its traces.csv. A film also shows thickness and radius, which are then known that well.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_eye.analysis.analyze import Analysis, analyze
from taichi_eye.analysis.curves import REST_MS
from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS
from taichi_eye.analysis.plausible import CAP_REACH_MM
from taichi_eye.analysis.response import circle
from taichi_eye.errors import FilmError, NoEstimate, SceneError
from taichi_eye.estimation.observation import Observation, of_film, of_history, of_row
from taichi_eye.estimation.parameters import THICKNESS_SD_UM, Row, is_parameter, read_rows
from taichi_eye.estimation.unknowns import RADIUS, THICKNESS, UNKNOWNS, Known
from taichi_eye.eye.eye import eye_of
from taichi_eye.report.compare import DEFLECTION, read_measured
from taichi_eye.report.traces import COLUMNS
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.table import read_cells
from taichi_eye.units import MMHG, MS

TABLES = ".csv", ".txt", ".tsv", ".dat"
RADIUS_SD_MM = 0.05
STILL_MM, DEEPEST_MM = 0.05, 2.0
PUFF_MS, SAMPLES_LEAST, GAP_MS = (6.0, 24.0), 16, 3.0
REST_MS_MOST, REST_MM = 3.0, 0.06


@dataclass(frozen=True)
class Found:
    """What a path holds. seen: one observation, or one a row; rows: the table's; film: the reading of a film;
    notes: what was mended or left out."""

    seen: list[Observation]
    rows: list[Row] | None = None
    film: Analysis | None = None
    notes: tuple[str, ...] = ()


def run_scene_of(path: Path) -> Scene | None:
    """The scene of the run that a path is, or stands in."""
    folder = path if path.is_dir() else path.parent
    return load_scene(folder / "scene.toml") if (folder / "scene.toml").is_file() else None


def read(
    path: str | Path,
    scene: Scene,
    noise_um: float | None = None,
    age_years: float | None = None,
    **instrument: float | None,
) -> Found:
    """What can be fitted of a trace, a film, a run or a table; SceneError or FilmError where there is nothing.

    scene: the model that it is fitted with, for what an instrument takes for its own puff. instrument: settings of the
    camera, as `taichi_eye.analysis.analyze` takes them.
    """
    path = Path(path)
    if path.suffix.lower() in TABLES:
        return _table(path, scene, noise_um, age_years)
    if not path.exists():
        raise SceneError(f"{path}: no such file or folder")
    if path.is_dir() and (path / "scene.toml").is_file() and not _filmed(path):
        if not (path / "traces.csv").is_file():
            raise SceneError(f"{path}: the run has neither slit frames nor traces.csv")
        return _table(path / "traces.csv", scene, noise_um, age_years)
    return _film(path, instrument)


def _filmed(folder: Path) -> bool:
    shows = load_scene(folder / "scene.toml").camera.view != "particles"
    return shows and ((folder / "film.mp4").is_file() or (folder / "frames").is_dir())


def _film(path: Path, instrument: dict) -> Found:
    result = analyze(path, write=False, **instrument)
    history, response = result.histories, result.response
    if response.deformation_amplitude_mm is None:
        why = next((note for note in result.notes if "left blank" in note), "the cornea does not move")
        raise FilmError(f"{path}: no estimate: {why}")
    if response.hc_deflection_mm is None:
        why = next((note for note in result.notes if "deflection" in note), "no deflection is seen")
        raise FilmError(f"{path}: no estimate: {why}")
    shown = {}
    if response.central_thickness_um is not None:
        shown[THICKNESS] = Known(response.central_thickness_um, THICKNESS_SD_UM)
    # a place that a frame at rest does not show stays blank
    rest = history.height_mm[history.time_ms <= history.time_ms[0] + REST_MS].mean(axis=0)
    bend = circle(history.x_mm, rest, CAP_REACH_MM)[0]
    if np.isfinite(bend) and bend > 0.0:
        shown[RADIUS] = Known(1.0 / bend, RADIUS_SD_MM)
    for name, known in shown.items():
        low, high = UNKNOWNS[name].allowed
        if not low <= known.value <= high:
            raise FilmError(
                f"{path}: {name} of {known.value:.4g} in the film; an eye's lies between {low:g} and {high:g}"
            )
    return Found([of_film(result.film.name, history, shown, result.notes)], film=result, notes=result.notes)


def _table(path: Path, scene: Scene, noise_um: float | None, age_years: float | None) -> Found:
    header = read_cells(path, lambda cell: _is_time(cell) or is_parameter(cell) or cell in COLUMNS)[0]
    if not any(_is_time(cell) for cell in header) and any(is_parameter(cell) for cell in header):
        rows, left_out = read_rows(path)
        puff, interval = eye_of(scene).puff, scene.camera.frame_interval_ms
        air = lambda t: float(puff.pressure_at_apex(t * MS)) / MMHG
        seen = []
        for row in rows:
            thickness = row.beside.get("central_thickness_um")
            shown = {} if thickness is None else {THICKNESS: Known(thickness, THICKNESS_SD_UM)}
            age = row.beside.get("age_years", age_years if age_years is not None else ELDERLY_AGE_YEARS)
            seen.append(of_row(row, interval, air, age, shown))
        return Found(seen, rows=rows, notes=tuple(left_out))
    measured = read_measured(path)
    read = any(cell.startswith("apex_deflection") for cell in header)
    whole = measured.column != DEFLECTION
    time, values = measured.time_ms, measured.displacement_mm
    notes = (*measured.notes, *_checked(path, time, values))
    noise = None if noise_um is None else 1e-3 * noise_um
    return Found([of_history(measured.name, time, values, whole, noise, read, notes)], notes=notes)


def _is_time(cell: str) -> bool:
    return cell.lower().startswith("time")


def _checked(path: Path, time: np.ndarray, values: np.ndarray) -> list[str]:
    """Notes on a history; NoEstimate where nothing can be read off it."""
    if values.max() < STILL_MM:
        raise NoEstimate(
            f"{path}: the apex moves by {1e3 * values.max():.0f} um: no air puff, and nothing to estimate from"
        )
    if values.max() > DEEPEST_MM:
        raise NoEstimate(
            f"{path}: the apex moves by {values.max():.2f} mm; no eye gives way by more than {DEEPEST_MM:g} mm"
        )
    early = time <= min(time[0] + 1.0, REST_MS_MOST)
    if time[0] > PUFF_MS[0] or abs(float(np.median(values[early]) if early.any() else 0.0)) > REST_MM:
        raise NoEstimate(
            f"{path}: does not begin with the eye at rest before the puff, so its displacements are from nowhere"
        )
    inside = time[(time >= PUFF_MS[0]) & (time <= PUFF_MS[1])]
    if len(inside) < SAMPLES_LEAST:
        raise NoEstimate(
            f"{path}: {len(inside)} values from {PUFF_MS[0]:g} to {PUFF_MS[1]:g} ms, where the puff acts; at least "
            f"{SAMPLES_LEAST} are needed"
        )
    ends = np.concatenate([[PUFF_MS[0]], inside, [PUFF_MS[1]]])
    gaps = [(a, b) for a, b in zip(ends[:-1], ends[1:]) if b - a > GAP_MS]
    return [f"no values from {a:.2f} to {b:.2f} ms: the intervals are wider for it" for a, b in gaps]
