"""What is kept of a study under way, and the tables that it ends as.

The eyes of a design are cut into parcels of one size, and a parcel's rows appear on the disk as one Parquet file, whole
or not at all. Which parcels are there is all that a study which was cut off has to know: no eye is in two of them, and
none is lost once its file is there. The tables are made from the parcels one after another, so that memory does not
grow with the number of eyes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.report.folder import replacing

PARCEL = "parcel-{:07d}.parquet"
DESIGN = "design.parquet"
_PARCEL = re.compile(r"parcel-(\d{7})\.parquet")
GROUP = 50_000  # rows that are put together in the table


class Shelf:
    """The parcels of a study in a folder. schema: of its rows; size: eyes of a parcel; count: eyes in all."""

    def __init__(self, folder: Path, schema, size: int, count: int):
        self.folder, self.schema, self.size, self.count = folder, schema, size, count

    @property
    def parcels(self) -> int:
        """Parcels in all."""
        return -(-self.count // self.size)

    def eyes(self, parcel: int) -> range:
        """The eyes of a parcel."""
        return range(parcel * self.size, min((parcel + 1) * self.size, self.count))

    def finished(self) -> set[int]:
        """The parcels that are there; SceneError where one is damaged."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        found = set()
        for path in self.folder.iterdir():
            match = _PARCEL.fullmatch(path.name)
            if match is None or int(match[1]) >= self.parcels:
                continue
            try:
                rows = pq.read_metadata(path).num_rows
            except (pa.ArrowException, OSError) as problem:
                raise SceneError(
                    f"{path}: is damaged ({_first(problem)}); remove it to compute its eyes anew"
                ) from None
            if rows != len(self.eyes(int(match[1]))):
                raise SceneError(f"{path}: holds {rows} eyes; remove it to compute its eyes anew")
            found.add(int(match[1]))
        return found

    def put(self, parcel: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Keep the rows of a parcel's eyes, in their order; on the disk when this returns."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema)
        with replacing(self.folder / PARCEL.format(parcel), durable=True) as temporary:
            pq.write_table(table, temporary)

    def tables(self) -> Iterator[Any]:
        """The rows of all eyes in their order, some at a time, as Arrow tables."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        held: list = []
        for parcel in range(self.parcels):
            path = self.folder / PARCEL.format(parcel)
            try:
                held.append(pq.read_table(path, schema=self.schema, memory_map=False))
            except (pa.ArrowException, OSError) as problem:
                raise SceneError(
                    f"{path}: is damaged ({_first(problem)}); remove it to compute its eyes anew"
                ) from None
            if sum(map(len, held)) >= GROUP:
                yield pa.concat_tables(held).combine_chunks()
                held = []
        if held:
            yield pa.concat_tables(held).combine_chunks()

    def keep_design(self, design: Mapping[str, np.ndarray], labels: Mapping[str, np.ndarray]) -> None:
        """Keep the values of every key, and of the labels of a table of eyes."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {**labels, **design}
        table = pa.table(
            {name: pa.array(list(column), self.schema.field(name).type) for name, column in columns.items()}
        )
        with replacing(self.folder / DESIGN, durable=True) as temporary:
            pq.write_table(table, temporary)

    def design(self, names: Sequence[str]) -> dict[str, np.ndarray] | None:
        """What was kept of these columns; None where a study was cut off before that."""
        import pyarrow.parquet as pq

        path = self.folder / DESIGN
        if not path.is_file():
            return None
        table = pq.read_table(path, columns=list(names))
        found = {}
        for name in names:
            values = table.column(name)
            plain = values.null_count == 0 and str(values.type) in ("double", "int64", "bool")
            found[name] = values.to_numpy() if plain else np.array([*values.to_pylist(), None], dtype=object)[:-1]
        return found


def write_tables(folder: Path, tables: Iterator[Any], schema) -> None:
    """table.parquet and table.csv of rows that come some at a time, both whole or neither."""
    import pyarrow.csv as pcsv
    import pyarrow.parquet as pq

    with (
        replacing(folder / "table.parquet") as parquet,
        replacing(folder / "table.csv") as text,
        pq.ParquetWriter(parquet, schema) as columns,
        pcsv.CSVWriter(text, schema) as lines,
    ):
        for table in tables:
            columns.write_table(table)
            lines.write_table(table)


def _first(problem: Exception) -> str:
    return (str(problem).splitlines() or [""])[0][:120]
