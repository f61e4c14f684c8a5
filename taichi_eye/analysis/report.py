"""What a page of results says of the clinic's parameters: each with its full name, its norm and its z-score; and the
page of an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from taichi_eye.analysis.names import NAMES, unit_of
from taichi_eye.analysis.norms import POPULATIONS, judged_by
from taichi_eye.analysis.response import Response
from taichi_eye.report import result as page

if TYPE_CHECKING:
    from taichi_eye.analysis.analyze import Analysis

FAR = 2.0  # standard deviations beyond which a value is marked


def parameter_rows(*responses: Response) -> list[list[str]]:
    """Name, the values of the responses, unit, norm, z of the first, whose eyes; those that no response has are left
    out."""
    body = []
    for name, said in NAMES.items():
        values = [getattr(response, name) for response in responses]
        if all(value is None for value in values):
            continue
        norm = judged_by(name)
        told = ["", "", ""]
        if norm is not None:
            population, mean, deviation = norm
            z = None if values[0] is None else (values[0] - mean) / deviation
            told = [
                f"{mean:g} \N{PLUS-MINUS SIGN} {deviation:g}",
                "" if z is None else f"{z:+.1f}",
                POPULATIONS[population].name,
            ]
        body.append([said, *(page.shown(value) for value in values), unit_of(name), *told])
    return body


def parameters(names: Sequence[str], *responses: Response) -> str:
    """The table of `parameter_rows`; names: of the columns of values."""
    body = parameter_rows(*responses)
    far = [k for k, row in enumerate(body) if row[-2] and abs(float(row[-2])) > FAR]
    if not body:
        return ""
    head = ["parameter", *names, "unit", "healthy eyes", "z", "whose"]
    words = 0, len(head) - 4, len(head) - 1
    return page.table(head, body, far, words) + (
        page.paragraph(f"Marked: more than {FAR:g} standard deviations from healthy eyes.") if far else ""
    )


def analysis_page(result: Analysis, film: bytes | None, plots: bytes) -> str:
    """The page's element of an analysis; film: the overlay film as MP4, plots: analysis.png."""
    told = result.film
    responses = [result.response] + ([result.true_response] if result.true_response else [])
    settings = asdict(told.instrument)
    default = asdict(type(told.instrument)())
    differs = [[name, page.shown(value), page.shown(default[name])] for name, value in settings.items()]
    differs = [row for row, name in zip(differs, settings) if settings[name] != default[name]]
    return page.fragment(
        told.name,
        [
            page.paragraph(
                f"{len(told.frames)} frames over {told.time_ms[-1] - told.time_ms[0]:.2f} ms, read as a Corvis ST film."
            ),
            page.video(film) if film else "",
            page.section("Parameters", parameters(["measured", "computed"][: len(responses)], *responses)),
            page.section("Histories", page.image(plots, "motion, speed, curvature, thickness, curves and deflection")),
            page.section("Notes", page.warnings(result.notes)),
            page.section(
                "What differs from the instrument's own settings",
                page.rows(["setting", "here", "instrument"], differs),
            ),
        ],
    )
