"""Reading small tables that a user brings: the puff's pressure, a measured apex history.

Whatever a spreadsheet or an instrument exports: commas, semicolons or tabs between the cells, decimal commas where the
cells are not separated by commas, a `sep=` line, comments after #, UTF-8 or UTF-16, a row of units under the header. A
column is named by its quantity and unit, and, where that is allowed, "time (ms)" and "Time [us]" mean time_ms, too.
Only carriage return and line feed end a line: what else Unicode calls a line break may stand in a comment.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.units import KPA, MMHG

DELIMITERS = ";\t,"
# each unit in the unit that its quantity is wanted in
UNITS = {
    "ms": {"ms": 1.0, "us": 1e-3, "\N{MICRO SIGN}s": 1e-3, "\N{GREEK SMALL LETTER MU}s": 1e-3, "s": 1e3},
    "mm": {"mm": 1.0, "um": 1e-3, "\N{MICRO SIGN}m": 1e-3, "\N{GREEK SMALL LETTER MU}m": 1e-3, "m": 1e3},
    "kpa": {"kpa": 1.0, "pa": 1e-3, "mmhg": MMHG / KPA},
}
_UNIT = re.compile(r"(?:[\s_]+|\s*[\[(/]\s*)([^\W\d_]+)\s*[\])]?$")


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
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if data.startswith(mark):
            try:
                return data.decode(encoding)
            except UnicodeDecodeError as error:
                raise SceneError(f"{path}: is not whole UTF-16 text (byte {error.start})") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{path}: line {line} is not UTF-8 text (byte 0x{data[error.start]:02x})") from None


def read_table(path: Path, wanted: Sequence[str], mended: list[str] | None = None) -> dict[str, np.ndarray]:
    """Columns of a table whose first line (comments after # and a `sep=` line aside) is a header.

    wanted: names with the unit at the end, as in "time_ms". Every cell of a wanted column must be a finite number,
    `time_ms` must increase from row to row, and there must be at least two rows. With a list `mended`, columns may be
    named in other words or units, rows out of order are sorted and rows with a blank cell left out, and what was done
    is appended to it. Wanted columns that the header lacks are left out of the answer unless none is there; other
    columns are not read. Returns float64 arrays, shape [rows]. SceneError names file, line and value.
    """
    header, delimiter, rows = read_cells(path, lambda cell: _wanted(cell, wanted) is not None)
    columns = _columns(path, header, wanted, exact=mended is None)
    if mended is not None and rows and _is_units(rows[0][1], columns):
        columns = _with_units(path, rows.pop(0)[1], columns)
    table: dict[str, list[float]] = {name: [] for name in columns}
    blank = 0
    for line, cells in rows:
        if len(cells) != len(header):
            raise SceneError(f"{path}: line {line} has {len(cells)} values, the header {len(header)}")
        texts = {name: cells[at] for name, (at, _) in columns.items()}
        if mended is not None and not all(texts.values()):
            blank += 1
            continue
        for name, text in texts.items():
            table[name].append(number(text, delimiter) * columns[name][1])
            if not math.isfinite(table[name][-1]):
                raise SceneError(f'{path}: line {line}: {name} = "{text}"; a finite number is needed')
        times = table["time_ms"]
        if mended is None and len(times) > 1 and not times[-1] > times[-2]:
            raise SceneError(
                f"{path}: line {line}: time_ms = {times[-1]:g} does not increase (the row before has {times[-2]:g})"
            )
    if len(table["time_ms"]) < 2:
        raise SceneError(f"{path}: has {len(table['time_ms'])} row(s) of numbers; at least two are needed")
    arrays = {name: np.array(column) for name, column in table.items()}
    if mended is not None:
        arrays = _sorted(path, arrays, rows, mended)
        if blank:
            mended.append(f"{blank} rows with a blank cell left out")
        for name, (at, factor) in columns.items():
            if factor != 1.0:
                mended.append(f'"{header[at]}" converted to {name}')
    return arrays


def read_cells(path: Path, known: Callable[[str], bool]) -> tuple[list[str], str, list[tuple[int, list[str]]]]:
    """The header of a table, what separates its cells, and the rows under it with the numbers of their lines.

    known: whether a cell of the header names a column that is looked for; the separator is the one by which most do.
    SceneError where the file is empty or no table.
    """
    text = read_text(path)
    first, _, rest = text.partition("\n")
    skipped, delimiter = 0, None
    if re.fullmatch(r"sep=.\r?", first, re.IGNORECASE):
        text, skipped, delimiter = rest, 1, first[4]
    if delimiter is None:
        lines = (line for line in re.split(r"\r\n|\n|\r", text) if line.strip() and not line.lstrip().startswith("#"))
        named = next(lines, "")
        cells = {mark: named.split(mark) for mark in DELIMITERS}
        found = {mark: sum(known(cell.strip().strip('"')) for cell in cells[mark]) for mark in DELIMITERS}
        delimiter = max(DELIMITERS, key=lambda mark: (found[mark], len(cells[mark]), mark == ","))
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        for cells in reader:
            if cells and any(c.strip() for c in cells) and not cells[0].lstrip().startswith("#"):
                rows.append((reader.line_num + skipped, [c.strip() for c in cells]))
    except csv.Error as error:
        raise SceneError(f"{path}: line {reader.line_num + skipped}: {error}") from None
    if not rows:
        raise SceneError(f"{path}: is empty; a header and rows under it are needed")
    return rows.pop(0)[1], delimiter, rows


def _quantity(name: str) -> tuple[str, str]:
    """Quantity and unit that a header names, in small letters; no unit where it names none."""
    name = name.strip().lower()
    match = _UNIT.search(name)
    units = {unit for known in UNITS.values() for unit in known}
    unit = match[1] if match and match[1] in units and match.start() > 0 else ""
    quantity = name[: match.start()] if unit else name
    return re.sub(r"[\s\-]+", "_", quantity).strip("_"), unit


def _wanted(cell: str, wanted: Sequence[str]) -> tuple[str, float] | None:
    """The wanted column that a header's cell names, and the factor to its unit; None for another column."""
    quantity, unit = _quantity(cell)
    for name in wanted:
        base, own = _quantity(name)
        if quantity == base and (not unit or unit in UNITS[own]):
            return name, UNITS[own][unit] if unit else 1.0
    return None


def _columns(path: Path, header: list[str], wanted: Sequence[str], exact: bool) -> dict[str, tuple[int, float]]:
    """Place and factor of each wanted column that the header names."""
    columns: dict[str, tuple[int, float]] = {}
    for at, cell in enumerate(header):
        match = _wanted(cell, wanted)
        if exact and match and match[0] != cell:
            continue
        if match and match[0] in columns:
            raise SceneError(f"{path}: the header names {match[0]} more than once")
        if match:
            columns[match[0]] = at, match[1]
    if "time_ms" not in columns or len(columns) < 2:
        others = " or ".join(name for name in wanted if name != "time_ms")
        raise SceneError(
            f'{path}: the header is "{",".join(header)[:200]}"; needed are the columns time_ms and {others}'
        )
    return {name: columns[name] for name in wanted if name in columns}


def _is_units(cells: list[str], columns: dict[str, tuple[int, float]]) -> bool:
    bare = [cells[at].strip("[]() ").lower() for at, _ in columns.values() if at < len(cells)]
    known = {unit for units in UNITS.values() for unit in units}
    return bool(bare) and all(cell in known for cell in bare)


def _with_units(path: Path, cells: list[str], columns: dict) -> dict[str, tuple[int, float]]:
    """The columns with the factors that a row of units gives."""
    out = {}
    for name, (at, _) in columns.items():
        units = UNITS[_quantity(name)[1]]
        unit = cells[at].strip("[]() ").lower()
        if unit not in units:
            raise SceneError(f'{path}: {name} is given in "{cells[at]}"; allowed are {", ".join(units)}')
        out[name] = at, units[unit]
    return out


def number(text: str, delimiter: str) -> float:
    """The value of a cell, with a decimal comma where cells are separated otherwise; NaN where it is no number."""
    if delimiter != "," and re.fullmatch(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?|[+-]?\d+,", text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return math.nan


def _sorted(path: Path, arrays: dict, rows: list, mended: list[str]) -> dict[str, np.ndarray]:
    """The rows in the order of their times; SceneError where two have the same."""
    times = arrays["time_ms"]
    order = np.argsort(times, kind="stable")
    same = np.flatnonzero(np.diff(times[order]) <= 0.0)
    if len(same):
        second = int(order[same[0] + 1])
        line = rows[second][0] if len(rows) == len(times) else "?"
        raise SceneError(
            f"{path}: line {line}: time_ms = {times[second]:g} does not increase (another row has the same)"
        )
    if (order != np.arange(len(order))).any():
        mended.append("rows put in the order of their times")
    return {name: column[order] for name, column in arrays.items()}


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
