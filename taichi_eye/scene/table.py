"""Reading small CSV tables that a user brings: the puff's pressure, a measured apex history."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taichi_eye.errors import SceneError


def read_text(path: Path) -> str:
    """The text of a user's file; SceneError where it is missing, a directory, unreadable or not UTF-8."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise SceneError(f"{path}: is a directory, not a file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(f"{path}: cannot be read ({reason})") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{path}: line {line} is not UTF-8 text (byte 0x{data[error.start]:02x})") from None


def read_table(path: Path, wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a CSV file whose first line (comments after # aside) is a header.

    Every cell of a wanted column must be a finite number, `time_ms` must increase from row to row, and there must
    be at least two rows. Wanted columns that the header lacks are left out of the answer unless none is there;
    other columns are not read. Returns float64 arrays, shape [rows]. SceneError names file, line and value.
    """
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(read_text(path).splitlines())
    try:
        for cells in reader:
            if cells and any(c.strip() for c in cells) and not cells[0].lstrip().startswith("#"):
                rows.append((reader.line_num, [c.strip() for c in cells]))
    except csv.Error as error:
        raise SceneError(f"{path}: line {reader.line_num}: {error}") from None
    if not rows:
        raise SceneError(f"{path}: is empty; a header and at least two rows of numbers are needed")
    header = rows.pop(0)[1]
    present = [name for name in wanted if name in header]
    if "time_ms" not in present or len(present) < 2:
        others = " or ".join(name for name in wanted if name != "time_ms")
        raise SceneError(
            f'{path}: the header is "{",".join(header)[:200]}"; needed are the columns time_ms and {others}'
        )
    for name in present:
        if header.count(name) > 1:
            raise SceneError(f"{path}: the header names {name} more than once")
    table: dict[str, list[float]] = {name: [] for name in present}
    for line, cells in rows:
        if len(cells) != len(header):
            raise SceneError(f"{path}: line {line} has {len(cells)} values, the header {len(header)}")
        for name in present:
            text = cells[header.index(name)]
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise SceneError(f'{path}: line {line}: {name} = "{text}"; a finite number is needed')
            table[name].append(value)
        times = table["time_ms"]
        if len(times) > 1 and not times[-1] > times[-2]:
            raise SceneError(
                f"{path}: line {line}: time_ms = {times[-1]:g} does not increase (the row before has {times[-2]:g})"
            )
    if len(rows) < 2:
        raise SceneError(f"{path}: has {len(rows)} row(s) of numbers; at least two are needed")
    return {name: np.array(column) for name, column in table.items()}


def read_puff_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """A user's puff: times [ms] and pressures [kPa], each of shape [rows]. SceneError on a bad file."""
    table = read_table(path, ("time_ms", "pressure_kpa"))
    time_ms, pressure_kpa = table["time_ms"], table["pressure_kpa"]
    far = np.abs(pressure_kpa) > 100
    if far.any():
        row = int(far.argmax())
        raise SceneError(
            f"{path}: pressure_kpa = {pressure_kpa[row]:g} at time_ms = {time_ms[row]:g}; allowed is "
            "-100 to 100 kPa (mmHg times 0.133322 is kPa)"
        )
    return time_ms, pressure_kpa
