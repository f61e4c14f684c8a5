"""Corvis ST films, recorded or computed, read back into the clinic's numbers.

    from taichi_eye.analysis import analyze
    result = analyze("film.mp4", out="results")
    result.response.deformation_amplitude_mm

`respond(curves_from_wall(...))` gives the same parameters of computed curves.
"""

from taichi_eye.analysis.analyze import Analysis, analyze, table
from taichi_eye.analysis.curves import Curves, Instrument, curves_from_edges, curves_from_wall
from taichi_eye.analysis.edges import Edges, find_edges
from taichi_eye.analysis.frames import Film, read_film
from taichi_eye.analysis.response import Histories, Response, histories, respond

__all__ = [
    "Analysis",
    "Curves",
    "Edges",
    "Film",
    "Histories",
    "Instrument",
    "Response",
    "analyze",
    "curves_from_edges",
    "curves_from_wall",
    "find_edges",
    "histories",
    "read_film",
    "respond",
    "table",
]
