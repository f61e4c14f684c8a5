"""`taichi-eye bench`: how fast, one table: each figure beside what is asked of it.

A part is a module of this room with a function `measure(stage)`: `stage(text)` shows on the progress bar what is being
measured; it returns rows and matplotlib figures. Its module's docstring says what is measured and how; the page shows
it. Ratios are taken in one run, in turns, best of several (`taichi_eye.bench.timing`). What cannot be had (a GPU, a
package) is one row that says so.
"""

import json
import os
import platform
import sys
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from taichi_eye import backend
from taichi_eye.bench import batch, default, gpu, growth, packing, page, peers, startup, step, studies
from taichi_eye.bench.rows import Row
from taichi_eye.provenance import language
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.page import picture, plain, table, write_page

PARTS = {
    "startup": startup.measure,
    "default": default.measure,
    "step": step.measure,
    "growth": growth.measure,
    "packing": packing.measure,
    "batch": batch.measure,
    "studies": studies.measure,
    "page": page.measure,
    "peers": peers.measure,
    "gpu": gpu.measure,
}
HEAD = ("quantity", "value", "asked", "", "sizes and settings")


def report(
    only=(),
    out: str | None = None,
    json_file: str | None = None,
    say=lambda text: print(text, flush=True),
    parts=None,
    command: str = "bench",
    progress: bool = True,
) -> bool:
    """Measure the parts named (all without names), print the table, write the page; whether all that is asked holds.

    out: folder of the page (default: a new one under renders/); json_file: the machine, and each part's rows. Both are
    written anew after every part: an interrupted bench keeps what it has. parts: those of another command. progress:
    a bar on the terminal.
    """
    measured = PARTS if parts is None else parts
    folder = create_run_folder(out, command)
    machine = describe_machine()
    found: dict[str, list[Row]] = {}
    shown: list[str] = []

    def tell(text):
        with tqdm.external_write_mode(file=sys.stdout):
            say(text)

    tell(", ".join(f"{value} {name}" if isinstance(value, int) else str(value) for name, value in machine.items()))
    tell(_line(HEAD))
    names = list(only or measured)
    with tqdm(total=len(names), unit=" parts", disable=not progress, dynamic_ncols=True, leave=False) as bar:
        for name in names:
            started = time.perf_counter()
            bar.set_description_str(name)
            rows, figures = measured[name](lambda text, name=name: bar.set_description_str(f"{name}: {text}"))
            found[name] = rows
            for row in rows:
                tell(_line(_cells(row)))
            tell(f"  {name}: {time.perf_counter() - started:.0f} s")
            theory = sys.modules[measured[name].__module__].__doc__ or ""
            shown += [
                f"<h2>{name}</h2><pre>{plain(theory)}</pre>",
                table(HEAD, [_cells(row) for row in rows], [i for i, row in enumerate(rows) if row.holds is False]),
                *map(picture, figures),
            ]
            head = f"<p>{plain(str(machine))}</p>"
            write_page(folder / f"{command}.html", f"taichi-eye {command}", [head, *shown], markdown=True)
            if json_file:
                every = {part: [row.as_dict() for row in rows] for part, rows in found.items()}
                write_text(Path(json_file), json.dumps({"machine": machine, "parts": every}, indent=2) + "\n")
            bar.update()
    asked = [row.holds for rows in found.values() for row in rows if row.holds is not None]
    missing = sum(row.value is None for rows in found.values() for row in rows)
    tell(
        f"{sum(asked)} of {len(asked)} rows hold"
        + (f", {missing} skipped" if missing else "")
        + f"; {folder / f'{command}.html'}"
    )
    return all(asked)


def describe_machine() -> dict:
    """What the figures were taken on."""
    processor = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            processor = next(
                (line.split(":", 1)[1].strip() for line in info if line.startswith("model name")), processor
            )
    except OSError:
        pass  # not Linux: platform's own word stands
    return {
        "processor": processor,
        "cores": os.cpu_count() or 1,
        "threads": backend.threads(),
        "python": f"Python {platform.python_version()}",
        "language": language(),
        "numpy": f"NumPy {np.__version__}",
    }


def _cells(row: Row):
    value = "" if row.value is None else f"{row.value:.4g} {row.unit}".rstrip()
    return row.name, value, row.asked, {True: "holds", False: "DOES NOT HOLD", None: ""}[row.holds], row.note


def _line(cells) -> str:
    widths = (58, 16, 9, 13, 0)
    return " ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths)).rstrip()
