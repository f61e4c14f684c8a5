"""`taichi-eye verify`: the solver's kernels on problems with known answers, one table."""

import json
import math
import time
from pathlib import Path

from taichi_eye.proof import added_mass, membranes, shells, squeeze, viscous, waves
from taichi_eye.proof.comparison import Comparison
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.page import draw, picture, table, write_page

PARTS = {
    "inflation": membranes.inflation,
    "squeeze": squeeze.squeeze,
    "acoustics": waves.acoustics,
    "cylinder": waves.coupled_cylinder,
    "eye": waves.eye_modes,
    "added-mass": added_mass.added_mass,
    "hencky": membranes.hencky,
    "shear": shells.shear,
    "jet": shells.jet_force,
    "globe": shells.friedenwald,
    "poiseuille": viscous.poiseuille,
    "womersley": viscous.womersley,
    "taylor-green": viscous.taylor_green,
    "drop": waves.drop,
    "plane-wave": waves.plane_wave,
    "cavity": viscous.cavity,
}
HEAD = ("problem", "quantity", "exact", "value", "error", "limit", "order", "least", "", "resolution")


def report(
    only=(), out: str | None = None, json_file: str | None = None, say=lambda text: print(text, flush=True)
) -> bool:
    """Run the problems named (all without names), print the table, write the page; whether every row passed.

    out: folder of the page (default: a new one under renders/); json_file: the rows as a list of objects.
    """
    folder = create_run_folder(out, "verify")
    rows: list[Comparison] = []
    parts = []
    say(_line(HEAD))
    for name in only or PARTS:
        started = time.perf_counter()
        more, figures = PARTS[name]()
        rows += more
        for row in more:
            say(_line(_cells(row)))
        say(f"  {name}: {time.perf_counter() - started:.0f} s")
        parts.append(f"<h2>{name}</h2><pre>{PARTS[name].__doc__}</pre>")
        parts.append(table(HEAD, [_cells(row) for row in more], [i for i, row in enumerate(more) if not row.passed]))
        parts += [picture(draw(figure)) for figure in figures]
    failed = sum(not row.passed for row in rows)
    verdict = f"{len(rows) - failed} of {len(rows)} rows passed" + (f", {failed} FAILED" if failed else "")
    write_page(folder / "verify.html", "taichi-eye verify", [f"<p>{verdict}.</p>", *parts], markdown=True)
    if json_file:
        write_text(Path(json_file), json.dumps([row.as_dict() for row in rows], indent=2) + "\n")
    say(f"{verdict}; {folder / 'verify.html'}")
    return failed == 0


def _figure(value) -> str:
    return "" if value is None else "nan" if math.isnan(value) else f"{value:.6g}"


def _cells(row: Comparison):
    return (
        row.problem,
        row.quantity,
        _figure(row.exact),
        _figure(row.value),
        f"{row.error:.2e}",
        "" if row.limit is None else f"{row.limit:g}",
        "" if row.order is None else f"{row.order:.2f}",
        "" if row.order_limit is None else f"{row.order_limit:g}",
        "ok" if row.passed else "FAILED",
        row.note,
    )


def _line(cells) -> str:
    widths = (18, 44, 10, 10, 9, 6, 6, 5, 6, 0)
    return " ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths)).rstrip()
