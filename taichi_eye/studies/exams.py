"""Many exams into one table: films, folders of images or runs, read side by side, one row each.

An exam that cannot be read is a row with its reason. The instrument's column names stand beside ours
(`taichi_eye.studies.columns`). Nothing is written where no exam can be read.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from taichi_eye.analysis import analyze
from taichi_eye.errors import FilmError, SceneError
from taichi_eye.report.folder import replacing
from taichi_eye.studies.columns import beside, exams_schema
from taichi_eye.studies.crew import Crew
from taichi_eye.studies.needs import refuse_missing

COMPUTE = "taichi_eye.studies.exams:measure"


def measure(common: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of exams; common: options of `analyze`, items: {"exam": path}."""
    return [_row(item["exam"], common) for item in items]


def _row(path: str, options: Mapping[str, Any]) -> dict[str, Any]:
    try:
        result = analyze(path, write=False, **options)
    except (FilmError, SceneError) as refused:
        return {"status": "refused", "reason": str(refused).replace("\n", "; ")}
    except Exception as problem:
        return {"status": "failed", "reason": f"{type(problem).__name__}: {problem}".replace("\n", "; ")}
    row = {**asdict(result.response), "frames": len(result.film.frames), "timed_by": result.film.timed_by}
    return {**row, "notes": "; ".join(result.notes), "status": "complete", "reason": None}


def measure_all(
    exams: Sequence[str | Path],
    table: Path,
    options: Mapping[str, Any] | None = None,
    threads: int | None = None,
    progress: bool = False,
) -> tuple[dict[str, int], str]:
    """Read exams into a table, CSV or Parquet by its suffix; how many have each status, and the first reason.

    options: of `taichi_eye.analysis.analyze`, for all exams. threads: exams that are read at a time (default: all
    cores). An exam keeps the order in which it was named.
    """
    refuse_missing()
    import pyarrow as pa
    import pyarrow.csv as pcsv
    import pyarrow.parquet as pq

    workers = min(threads or os.cpu_count() or 1, len(exams))
    crew = Crew(COMPUTE, workers, 1)
    rows: list[dict[str, Any]] = [{} for _ in exams]
    jobs = ((number, [{"exam": str(exam)}]) for number, exam in enumerate(exams))
    try:
        with tqdm(total=len(exams), unit=" exams", disable=not progress, dynamic_ncols=True, leave=False) as bar:
            for number, (row,) in crew.run(dict(options or {}), jobs):
                rows[number] = beside({"exam": str(exams[number]), **row})
                bar.update()
    finally:
        crew.close()
    counts = dict(Counter(row["status"] for row in rows))
    reason = next((row["reason"] for row in rows if row["reason"]), "")
    if counts.get("complete"):
        held = pa.Table.from_pylist(rows, schema=exams_schema())
        with replacing(table) as temporary:
            (pq.write_table if table.suffix.lower() == ".parquet" else pcsv.write_csv)(held, temporary)
    return {status: counts.get(status, 0) for status in ("complete", "refused", "failed")}, reason
