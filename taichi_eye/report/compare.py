"""A measured apex history beside the computed one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.errors import SceneError
from taichi_eye.report.history import summarise
from taichi_eye.scene.table import read_table


@dataclass(frozen=True)
class Measured:
    """A measured history: name of its file and its column, times [ms] and displacements [mm], shape [samples].

    An apex displacement includes the retreat of the whole eye; a deflection does not, and is what a cornea with a
    fixed limbus should be held against.
    """

    name: str
    column: str
    time_ms: np.ndarray
    displacement_mm: np.ndarray


def read_measured(path: str | Path) -> Measured:
    """Read a CSV with the columns time_ms and either apex_displacement_mm or deflection_mm, inward positive.

    SceneError names the file, the line and the value of what is wrong. A traces.csv of another run will do.
    """
    table = read_table(Path(path), ("time_ms", "apex_displacement_mm", "deflection_mm"))
    if len(table) == 3:
        raise SceneError(f"{path}: the header has apex_displacement_mm and deflection_mm; keep the one to compare with")
    column = next(name for name in table if name != "time_ms")
    values = table[column]
    if np.abs(values).max() > 10:
        raise SceneError(f"{path}: {column} reaches {values[np.abs(values).argmax()]:g}; allowed is -10 to 10 mm")
    if values.max() <= 0:
        raise SceneError(f"{path}: {column} is at most {values.max():g}; inward displacements must be positive")
    return Measured(Path(path).name, column, table["time_ms"], values)


def differences(time_ms: ArrayLike, displacement_mm: ArrayLike, measured: Measured) -> dict[str, float | None]:
    """Computed less measured: peak [mm], times [ms], and the rms [mm] over the measured times within the run."""
    t, d = np.asarray(time_ms, dtype=float), np.asarray(displacement_mm, dtype=float)
    here, there = summarise(t, d), summarise(measured.time_ms, measured.displacement_mm)
    inside = (measured.time_ms >= t[0]) & (measured.time_ms <= t[-1])
    off = np.interp(measured.time_ms[inside], t, d) - measured.displacement_mm[inside]

    def less(name: str) -> float | None:
        pair = getattr(here, name), getattr(there, name)
        return None if None in pair else pair[0] - pair[1]

    return {
        "peak_mm": less("peak"),
        "peak_time_ms": less("peak_time_ms"),
        "rise_time_ms": less("rise_time_ms"),
        "fall_time_ms": less("fall_time_ms"),
        "rms_mm": float(np.sqrt(np.mean(off**2))) if inside.any() else None,
    }
