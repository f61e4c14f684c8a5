"""Back edges at random: the thickness that is read from corneas whose back no renderer drew.

Blur 0.8 to 4 px, seams of +-6 grey levels before the back, a stroma that loses 0 to 40 % of its light, noise of 1 to 8
grey levels, 400 to 700 um, on eyes of several shapes. Asked: the thickness at rest within 15 um in 95 of 100 films,
and none over 40 um off without a word.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.analysis import Instrument, curves_from_edges, find_edges, histories, respond
from taichi_eye.analysis.plausible import believed
from taichi_eye.bench.rows import Row, at_least, at_most
from taichi_eye.errors import FilmError
from taichi_eye.proof.films.eyes import EYES, INTERVAL_MS, TIMES_MS
from taichi_eye.proof.films.made_up import Look, draw

FILMS, SEED = 300, 13
# the frames at rest that the thickness is read from, and the motion in steps
WHICH = np.concatenate([np.arange(13), np.arange(18, 139, 6)])
EYE_NUMBERS = 0, 1, 3, 4, 5, 6
WITHIN_UM, WITHIN_SHARE, SILENT_UM = 15.0, 95.0, 40.0


def drawn(random: np.random.Generator) -> tuple[Look, float, int]:
    """A look, a thickness [um] and the number of an eye."""
    chamber = random.uniform(5.0, 22.0)
    front = chamber + random.uniform(25.0, 60.0)
    look = Look(
        air=chamber + random.uniform(-1.0, 2.0),
        chamber=chamber,
        stroma_front=front,
        stroma_back=chamber + (front - chamber) * random.uniform(0.6, 1.0),
        line=random.uniform(15.0, 35.0),
        front_sigma_px=random.uniform(1.4, 2.2),
        back_sigma_px=random.uniform(0.8, 4.0),
        seam=random.uniform(-6.0, 6.0),
        noise=random.uniform(1.0, 8.0),
    )
    return look, random.uniform(400.0, 700.0), int(random.choice(EYE_NUMBERS))


def error_um(look: Look, thickness_um: float, number: int, seed: int) -> tuple[float, bool]:
    """Thickness read less true [um], NaN where none is given; and whether the film says that it is unusual."""
    frames = draw(EYES[number], look, thickness_um, seed, WHICH)
    try:
        curves = curves_from_edges(find_edges(frames), TIMES_MS[WHICH], Instrument())
    except FilmError:
        return float("nan"), True
    response = respond(curves, INTERVAL_MS)
    if response.central_thickness_um is None:
        return float("nan"), True
    _, notes = believed(response, curves, histories(curves), "counting")
    return response.central_thickness_um - thickness_um, any("thickness" in note for note in notes)


def measure(stage, films: int = FILMS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Read so many films drawn at random."""
    random = np.random.default_rng(seed)
    found = []
    for k in range(films):
        stage(f"back edge {k + 1} of {films}")
        found.append(error_um(*drawn(random), seed=seed + k))
    off, said = (np.array(column) for column in zip(*found))
    within = 100.0 * float((np.abs(off) <= WITHIN_UM).mean())
    silent = np.abs(off[~said.astype(bool)])
    note = f"{films} films; median {np.nanmedian(np.abs(off)):.1f} um, blank in {np.isnan(off).sum()}"
    rows = [
        at_least(f"thickness within {WITHIN_UM:g} um", within, "% of films", WITHIN_SHARE, note),
        at_most("largest silent error of the thickness", float(np.nanmax(silent)), "um", SILENT_UM),
    ]
    canvas = Figure(figsize=(7.0, 3.5), dpi=110, layout="constrained")
    axes = canvas.subplots()
    axes.hist(off[np.isfinite(off)], bins=np.arange(-50.0, 51.0, 2.5), color="#14539a")
    axes.set(xlabel="thickness read less true (um)", ylabel="films")
    return rows, [canvas]
