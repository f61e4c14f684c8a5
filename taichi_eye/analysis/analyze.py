"""From a film, a folder of images or a run folder to DCR parameters, tables, an overlay film and a page of plots."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from taichi_eye.analysis.curves import Curves, curves_from_edges
from taichi_eye.analysis.edges import Edges, find_edges
from taichi_eye.analysis.frames import Film, read_film
from taichi_eye.analysis.norms import NORMS, z_scores
from taichi_eye.analysis.pictures import draw_page, write_overlay
from taichi_eye.analysis.plausible import believed, refuse_what_is_no_cornea
from taichi_eye.analysis.report import analysis_page
from taichi_eye.analysis.response import (
    MOVED_MM,
    Histories,
    Response,
    biop_surrogate_mmhg,
    histories,
    measured_puff_mmhg,
    respond,
)
from taichi_eye.errors import FilmError
from taichi_eye.film import EncoderError, slim
from taichi_eye.provenance import provenance
from taichi_eye.report import result as page
from taichi_eye.report.dataframe import framed
from taichi_eye.report.folder import create_run_folder, refuse_taken, replacing, write_rows, write_text
from taichi_eye.report.plots import png_of

NAME_MAX = 100  # letters of the film's name in the folder's
STAGES = "reading frames", "finding edges", "measuring", "drawing"
PRESSURE_MMHG, AGE_YEARS = (0.0, 100.0), (0.0, 130.0)


@dataclass(frozen=True)
class Analysis:
    """What a film shows: its edges, curves, histories and parameters; true_response and true_histories for a run that
    kept its wall; notes: what a reader should know. folder: where files were written, or None."""

    film: Film
    edges: Edges
    curves: Curves
    histories: Histories
    response: Response
    true_histories: Histories | None
    true_response: Response | None
    notes: tuple[str, ...]
    folder: Path | None = None

    def plot(self):
        """The page of plots, as a matplotlib Figure."""
        return draw_page(self.film.name, self.curves, self.histories, self.response, self.true_histories)

    def to_dataframe(self):
        """The histories as a pandas DataFrame, a row a frame; the columns are those of histories.csv."""
        return framed(self.columns())

    def columns(self) -> dict[str, np.ndarray]:
        """The columns of histories.csv, arrays [frames]."""
        history, thick = self.histories, self.curves.thickness_mm
        return {
            "time_ms": history.time_ms,
            "apex_deformation_mm": history.apex_mm,
            "apex_deflection_mm": history.apex_mm - history.whole_eye_mm,
            "whole_eye_movement_mm": history.whole_eye_mm,
            "apex_velocity_m_s": history.velocity_m_s,
            "curvature_per_mm": history.curvature_per_mm,
            "central_thickness_mm": thick if thick is not None else np.full(len(history.time_ms), np.nan),
        }

    def _repr_html_(self) -> str:
        """What a notebook shows: report.html, or that page without a film where no files were written."""
        written = page.read(self.folder) if self.folder is not None else None
        return written or analysis_page(self, None, png_of(self.plot()))


def analyze(
    path: str | Path,
    out: str | Path | None = None,
    write: bool = True,
    iop_nct_mmhg: float | None = None,
    age_years: float | None = None,
    biop_mmhg: float | None = None,
    progress: bool = False,
    **settings: float | None,
) -> Analysis:
    """Measure a film, a folder of images or a run.

    out: a new or empty folder for the results; None for renders/<name>-analysis-001, ... write: False for no files.
    biop_mmhg: pressure of the eye, for SP-A1; or iop_nct_mmhg and age_years, from which it is estimated with the
    measured thickness. progress: a bar on the terminal. settings: fields of `Instrument` that differ from the defaults.
    Raises FilmError where nothing can be read, before anything is written; SceneError for a bad output folder.
    """
    _refuse_pressures(iop_nct_mmhg=iop_nct_mmhg, age_years=age_years, biop_mmhg=biop_mmhg)
    if write:
        refuse_taken(out)
    with tqdm(total=len(STAGES), unit=" stages", disable=not progress, dynamic_ncols=True, leave=False) as bar:

        def stage(name: str) -> None:
            bar.update(STAGES.index(name) - bar.n)
            bar.set_description_str(name)

        stage("reading frames")
        film = read_film(path, **settings)
        result = _measure(path, film, biop_mmhg, iop_nct_mmhg, age_years, stage)
        if not write:
            return result
        stage("drawing")
        folder = create_run_folder(out, f"{film.name[:NAME_MAX]}-analysis")
        try:
            write_results(result, folder)
        except (OSError, EncoderError) as error:
            raise FilmError(f"{folder}: the results could not be written in full ({error})") from None
    return Analysis(**{**vars(result), "folder": folder})


def _measure(path, film: Film, biop_mmhg, iop_nct_mmhg, age_years, stage: Callable[[str], None]) -> Analysis:
    """What the frames of a film show; stage: told what is done next."""
    pressure = biop_mmhg if biop_mmhg is not None else film.iop_mmhg
    interval = film.instrument.frame_interval_ms
    puff = measured_puff_mmhg
    if film.puff_mmhg is not None:
        puff = lambda t: float(np.interp(t, *film.puff_mmhg))  # noqa: E731
    stage("finding edges")
    edges = find_edges(film.frames)
    stage("measuring")
    try:
        curves = curves_from_edges(edges, film.time_ms, film.instrument)
        history = histories(curves)
        response = respond(curves, interval, pressure, puff, ready=history)
        refuse_what_is_no_cornea(curves, history, response)
    except FilmError as error:
        raise FilmError(f"{path}: {error}") from None
    if pressure is None and None not in (iop_nct_mmhg, age_years, response.central_thickness_um):
        pressure = biop_surrogate_mmhg(iop_nct_mmhg, response.central_thickness_um, age_years)
        response = respond(curves, interval, pressure, puff, ready=history)
    response, doubts = believed(response, curves, history, film.timed_by)
    notes = [f"frame times from {film.timed_by}", *film.notes, *curves.notes, *doubts]
    if response.deformation_amplitude_mm is None and not (np.nan_to_num(history.apex_mm) > MOVED_MM).any():
        notes.append(f"the cornea moves less than {MOVED_MM:g} mm: no parameters of an air puff")
    elif response.a1_time_ms is None or response.a2_time_ms is None:
        notes.append("an applanation is missing: the film ends early, starts late, or the dent stays convex")
    true_history = true_response = None
    if film.truth is not None:
        true_history = histories(film.truth)
        true_response = respond(film.truth, interval, pressure, puff, ready=true_history)
    return Analysis(film, edges, curves, history, response, true_history, true_response, tuple(notes))


def _refuse_pressures(**given: float | None) -> None:
    for name, value in given.items():
        low, high = AGE_YEARS if name == "age_years" else PRESSURE_MMHG
        if value is not None and not low <= value <= high:
            raise FilmError(f"{name} = {value:g}; allowed is {low:g} to {high:g}")


def write_results(result: Analysis, folder: Path) -> None:
    """parameters.csv and .json, histories.csv, edges.npz, overlay.mp4, analysis.png and report.html into a folder."""
    film, curves, history = result.film, result.curves, result.histories
    scores = z_scores(result.response)
    populations = list(NORMS)
    head = ["parameter", "value"] + (["computed"] if result.true_response else [])
    head += [f"{what}_{population}" for population in populations for what in ("mean", "sd", "z")]
    rows = []
    for f in fields(Response):
        row = [f.name, _figure(getattr(result.response, f.name))]
        row += [_figure(getattr(result.true_response, f.name))] if result.true_response else []
        for population in populations:
            mean, deviation = NORMS[population].get(f.name, ("", ""))
            z = scores.get(f.name, {}).get(population)
            row += [mean, deviation, "" if z is None else f"{z:.2f}"]
        rows.append(row)
    write_rows(folder / "parameters.csv", head, rows)
    report = {
        "source": film.name,
        "frames": len(film.frames),
        "notes": list(result.notes),
        "instrument": asdict(film.instrument),
        "axis_column_px": curves.axis_column_px,
        "apex_row_px": curves.apex_row_px,
        "tilt_deg": curves.tilt_deg,
        "parameters": asdict(result.response),
        "computed": None if result.true_response is None else asdict(result.true_response),
        "z_scores": scores,
        "provenance": provenance(),
    }
    write_text(folder / "parameters.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    columns = result.columns()
    write_rows(
        folder / "histories.csv", list(columns), ([_figure(value) for value in row] for row in zip(*columns.values()))
    )
    with replacing(folder / "edges.npz") as temporary:
        np.savez_compressed(
            temporary,
            time_ms=film.time_ms,
            anterior_px=result.edges.anterior,
            posterior_px=result.edges.posterior,
            posterior_column_px=result.edges.posterior_column,
            curve_time_ms=curves.time_ms,
            x_mm=curves.x_mm,
            height_mm=curves.height_mm,
        )
    write_overlay(folder / "overlay.mp4", film.frames, film.time_ms, result.edges, curves, history, result.response)
    plots = png_of(result.plot())
    with replacing(folder / "analysis.png") as temporary:
        temporary.write_bytes(plots)
    page.write(folder / page.NAME, film.name, analysis_page(result, slim(folder / "overlay.mp4"), plots))


def table(result: Analysis) -> str:
    """The parameters as text, with the computed ones of a run and the z-scores beside them."""
    scores = z_scores(result.response)
    populations = list(NORMS)
    computed = result.true_response is not None
    lines = [
        f"{'parameter':34}{'measured':>10}"
        + (f"{'computed':>10}" if computed else "")
        + "".join(f"{'z ' + population:>11}" for population in populations)
    ]
    for f in fields(Response):
        value = getattr(result.response, f.name)
        line = f"{f.name:34}{_cell(value):>10}"
        if computed:
            line += f"{_cell(getattr(result.true_response, f.name)):>10}"
        for population in populations:
            z = scores.get(f.name, {}).get(population)
            line += f"{'' if z is None else f'{z:+.1f}':>11}"
        lines.append(line.rstrip())
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _figure(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.6g}"
