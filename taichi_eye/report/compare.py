"""A measured apex history beside the computed one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.errors import SceneError
from taichi_eye.report.history import summarise
from taichi_eye.report.traces import COLUMNS
from taichi_eye.scene.table import read_cells, read_table

DISPLACEMENT, DEFLECTION = "apex_displacement_mm", "deflection_mm"
# columns of what `analyze` writes
ANALYSED = "apex_deformation_mm", "apex_deflection_mm"
OF_RUN = frozenset(COLUMNS) - {"time_ms", DISPLACEMENT}  # any of them beside the apex: a traces.csv of a run
REACH_MM, SMALLEST_MM = 10.0, 0.002
SECONDS_BELOW, MICROSECONDS_ABOVE = 0.5, 1000.0
LATEST_START_MS = 45.0  # of a history that begins with the puff


@dataclass(frozen=True)
class Measured:
    """A measured history: name of its file and its column, times [ms] and displacements [mm], shape [samples].

    An apex displacement includes the retreat of the whole eye; a deflection does not, and is what a cornea with a
    fixed limbus should be held against. notes: what was mended on reading.
    """

    name: str
    column: str
    time_ms: np.ndarray
    displacement_mm: np.ndarray
    notes: tuple[str, ...] = ()

    def as_plain(self) -> dict:
        """Lists and strings, for a JSON file."""
        return {
            **vars(self),
            "time_ms": self.time_ms.tolist(),
            "displacement_mm": self.displacement_mm.tolist(),
            "notes": list(self.notes),
        }

    @classmethod
    def from_plain(cls, plain: dict) -> Measured:
        """What `as_plain` was given."""
        time, displacement = np.array(plain["time_ms"]), np.array(plain["displacement_mm"])
        return cls(plain["name"], plain["column"], time, displacement, tuple(plain["notes"]))


def read_measured(path: str | Path) -> Measured:
    """Read a table with the columns time_ms and either apex_displacement_mm or deflection_mm, inward positive.

    A traces.csv of another run and a histories.csv of `analyze` will do. The latter's deflection is taken; the former's
    apex_displacement_mm is one, too, as a run's apex does not move with the whole eye. What a spreadsheet does to a
    table is undone and noted; SceneError names the file, the line and the value of what is wrong.
    """
    notes: list[str] = []
    table = read_table(Path(path), ("time_ms", DISPLACEMENT, DEFLECTION, *ANALYSED), notes)
    names = [name for name in table if name != "time_ms"]
    if names == list(ANALYSED):
        names = [ANALYSED[1]]
        notes.append(f"{ANALYSED[1]} taken, without the movement of the whole eye")
    if len(names) > 1:
        raise SceneError(f"{path}: the header has {names[0]} and {names[1]}; keep the one to compare with")
    time, values = table["time_ms"], table[names[0]]
    if np.abs(values).max() > REACH_MM:
        raise SceneError(
            f"{path}: {names[0]} reaches {values[np.abs(values).argmax()]:g}; allowed is -10 to 10 mm (is it in um?)"
        )
    if values.max() <= 0.0 or -values.min() > values.max():
        raise SceneError(
            f"{path}: {names[0]} is at most {values.max():g} and at least {values.min():g}; inward displacements must "
            "be positive"
        )
    if values.max() < SMALLEST_MM:
        raise SceneError(f"{path}: {names[0]} is at most {values.max():g}; it must be in mm (is it in m?)")
    if np.abs(time).max() < SECONDS_BELOW:
        raise SceneError(f"{path}: time_ms ends at {time[-1]:g}; it must be in ms (is it in s?)")
    if np.abs(time).max() > MICROSECONDS_ABOVE:
        raise SceneError(f"{path}: time_ms reaches {time[-1]:g}; it must be in ms from the puff's start (is it in us?)")
    if time[0] > LATEST_START_MS:
        raise SceneError(
            f"{path}: time_ms begins at {time[0]:g}; times count from the puff's start, which ends within 32 ms"
        )
    column = {ANALYSED[0]: DISPLACEMENT, ANALYSED[1]: DEFLECTION}.get(names[0], names[0])
    if column == DISPLACEMENT and OF_RUN & set(read_cells(Path(path), COLUMNS.__contains__)[0]):
        column = DEFLECTION
        notes.append(f"{names[0]} of a run, which is without the movement of the whole eye")
    return Measured(Path(path).name, column, time, values, tuple(notes))


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
        "peak_difference_mm": less("peak"),
        "peak_time_difference_ms": less("peak_time_ms"),
        "half_rise_difference_ms": less("half_rise_ms"),
        "half_fall_difference_ms": less("half_fall_ms"),
        "rms_difference_mm": float(np.sqrt(np.mean(off**2))) if inside.any() else None,
    }
