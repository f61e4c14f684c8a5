"""A parcel of eyes computed: what a worker does with scenes, and the rows it gives back.

A worker gets plain values, as JSON holds them, and gives plain rows back. An eye that is no scene, that a guard stops,
or that fails in any other way is a row with its status and reason; it takes nothing from the eyes beside it.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from taichi_eye.analysis.simulated import Observed, observe_many
from taichi_eye.errors import SceneError
from taichi_eye.report.history import summarise
from taichi_eye.scene import Scene
from taichi_eye.scene.budget import SAMPLE_MS
from taichi_eye.studies.study import scene_of

COMPUTE = "taichi_eye.studies.eyes:measure"
PARCEL_S = 20.0  # a parcel of eyes is to take no longer; what is under way when a study is cut off is computed again
FEW, MANY = 1, 64  # eyes of a parcel, at least and at most
SIDE_BY_SIDE = 16  # of the full model: more share Python's part of a sample no better
PARCELS = 256  # that a study is cut into, where its eyes are so many


def common_of(base: Mapping[str, Any], inputs: Sequence[str], files: Mapping[str, str]) -> dict[str, Any]:
    """What all parcels of a study share; base: of `plain_scene`, files: the text of every puff file by its path."""
    return {"base": dict(base), "inputs": list(inputs), "files": dict(files)}


def measure(common: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of eyes; items: what each changes in the base scene."""
    base = _base(json.dumps(common["base"], sort_keys=True), json.dumps(common["files"], sort_keys=True))
    places = _places(json.dumps(common["files"], sort_keys=True))
    rows: list[dict[str, Any]] = [{} for _ in items]
    scenes: dict[int, Scene] = {}
    for number, changes in enumerate(items):
        try:
            scenes[number] = base.but(_moved(changes, places))
        except SceneError as refused:
            rows[number] = {"status": "refused", "reason": str(refused).replace("\n", "; ")}
    paths = {place: path for path, place in places.items()}
    for (number, scene), found in zip(scenes.items(), _observed(list(scenes.values()))):
        asked = scene.values()
        inputs = {name: paths.get(asked[name], asked[name]) for name in common["inputs"]}
        rows[number] = inputs | _row(found)
    return rows


def _observed(scenes: list[Scene]) -> list[Observed | Exception]:
    """What became of each scene; where one raises, each by itself."""
    try:
        return observe_many(scenes) if scenes else []
    except Exception as problem:
        return [problem] if len(scenes) == 1 else [found for scene in scenes for found in _observed([scene])]


def _row(found: Observed | Exception) -> dict[str, Any]:
    if isinstance(found, SceneError):
        return {"status": "refused", "reason": str(found).replace("\n", "; ")}
    if isinstance(found, Exception):
        return {"status": "failed", "reason": f"{type(found).__name__}: {found}".replace("\n", "; ")}
    try:
        reading = found.read()
    except Exception as problem:
        return {"status": "failed", "reason": f"its response cannot be read: {type(problem).__name__}: {problem}"}
    stop = found.outcome.stop
    row = {"fidelity": found.scene.numerics.fidelity, **asdict(reading.response), **_summary(found.outcome.traces)}
    reason = str(stop) if stop else reading.stopped or None
    return {**row, "status": "stopped" if stop else "complete", "reason": reason}


def _summary(traces: Mapping[str, np.ndarray]) -> dict[str, float | None]:
    time = traces["time_ms"]
    apex, load = (summarise(time, traces[name]) for name in ("apex_displacement_mm", "puff_apex_kpa"))
    work = float(np.abs(traces["puff_work_uj"]).max())
    moved = apex.peak > 0.0
    return {
        "simulated_ms": float(time[-1]),
        "apex_peak_mm": float(apex.peak),
        "apex_peak_time_ms": float(apex.peak_time_ms),
        "apex_half_rise_ms": apex.half_rise_ms,
        "apex_half_fall_ms": apex.half_fall_ms,
        "apex_delay_ms": float(apex.peak_time_ms - load.peak_time_ms) if moved else None,
        "fluid_pressure_apex_max_kpa": float(traces["fluid_pressure_apex_kpa"].max()),
        "cornea_min_stress_kpa": float(traces["cornea_min_stress_kpa"].min()),
        "chamber_volume_error_max": float(np.abs(traces["chamber_volume_error"]).max()),
        "energy_error_share_of_work": float(np.abs(traces["energy_error_uj"]).max()) / work if work > 0.0 else None,
    }


@lru_cache(maxsize=4)
def _base(base: str, files: str) -> Scene:
    return scene_of(_moved(json.loads(base), _places(files)))


@lru_cache(maxsize=4)
def _places(files: str) -> dict[str, str]:
    """Where the puff files lie on this machine, by their paths on the user's."""
    texts = json.loads(files)
    if not texts:
        return {}
    folder = Path(_rooms(files).name)
    places = {}
    for number, (path, text) in enumerate(texts.items()):
        place = folder / f"{number}-{Path(path).name}"
        place.write_text(text, encoding="utf-8", newline="")
        places[path] = str(place)
    return places


@lru_cache(maxsize=4)
def _rooms(files: str) -> tempfile.TemporaryDirectory:
    """A folder of this process for the puff files of a study; it goes with the process."""
    return tempfile.TemporaryDirectory(prefix="taichi_eye-study-")


def _moved(values: Mapping[str, Any], places: Mapping[str, str]) -> dict[str, Any]:
    file = values.get("puff.file")
    return {**values, "puff.file": places[file]} if file in places else dict(values)


def parcel_of(scene: Scene, count: int, threads: int) -> int:
    """How many of a study's eyes make a parcel: as few as share the set-up well, at most PARCEL_S of one thread."""
    seconds, rung = expected_s(scene), scene.numerics.fidelity
    most = max(FEW, min(MANY, int(PARCEL_S / seconds)))
    if rung in ("mfpm", "auto"):
        # side by side they gain, so parcels are as large as still occupies every thread three times over
        return max(FEW, min(most, SIDE_BY_SIDE, -(-count // (3 * threads))))
    return max(FEW, min(most, -(-count // PARCELS)))


def expected_s(scene: Scene) -> float:
    """About what an eye takes on one thread, its reading included [s]."""
    numerics = scene.numerics
    nodes = scene.cornea.limbus_radius_mm * scene.chamber.depth_mm / numerics.spacing_mm**2
    if numerics.fidelity in ("membrane", "cavity"):
        return 0.06 + 0.1 * float(scene.cornea.flexural_modulus_mpa > 0.0)
    if numerics.fidelity == "added_mass":
        return 0.06 + 0.1 * (0.2 / numerics.spacing_mm) ** 2.4
    steps = 2.0 * numerics.sound_speed_m_s / numerics.spacing_mm * numerics.duration_ms
    return 0.06 + 1e-4 * numerics.duration_ms / SAMPLE_MS + 9e-8 * nodes * steps
