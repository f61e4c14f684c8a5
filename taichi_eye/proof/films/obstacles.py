"""Lashes, specks, stamps and shadows at random over films of known eyes.

Asked: amplitude within 0.02 mm, A1 and A2 within 0.25 ms, or a word that frames are masked or a value left blank; no
silent error over that.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.analysis import Instrument, curves_from_edges, find_edges, histories, respond
from taichi_eye.analysis.plausible import believed
from taichi_eye.bench.rows import Row, at_most, figure
from taichi_eye.errors import FilmError
from taichi_eye.proof.films import made_up
from taichi_eye.proof.films.eyes import EYES, INTERVAL_MS, TIMES_MS, truth

FILMS, SEED = 100, 31
WHICH = slice(None, None, 2)  # frames
AMPLITUDE_UM, TIME_MS = 20.0, 0.25
LOOK = made_up.Look(air=6.5, chamber=7.4, stroma_front=65.0, stroma_back=46.0, line=25.0, back_sigma_px=2.0, noise=4.5)
WORDS = "mask", "left out", "left blank"


def harm(frames: np.ndarray, random: np.random.Generator) -> list[str]:
    """Draw one to four things over the frames, in place; what they are."""
    kinds = random.choice(["lash", "speck", "stamp", "shadow"], random.integers(1, 5))
    for kind in kinds:
        if kind == "lash":
            row, column, angle = random.uniform(0, 60), random.uniform(60, 516), random.uniform(-1.2, 1.2)
            long = random.uniform(30, 110)
            stop = row + long * np.sin(angle), column + long * np.cos(angle)
            drift = random.normal(0.0, 15.0, 2) if random.random() < 0.5 else (0.0, 0.0)
            made_up.lash(frames, (row, column), stop, random.uniform(3, 10), random.uniform(70, 230), drift)
        elif kind == "speck":
            which = random.choice(len(frames), random.integers(1, 1 + len(frames) // 2), replace=False)
            made_up.speck(frames, random.uniform(5, 60), random.uniform(200, 380), random.uniform(1, 3), which)
        elif kind == "stamp":
            made_up.stamped(frames, TIMES_MS[WHICH])
        else:
            made_up.shadow(frames, random.uniform(60, 516), random.uniform(10, 80), random.uniform(0.2, 0.8))
    return list(kinds)


def errors(number: int, seed: int) -> tuple[float, float, bool]:
    """Errors of the amplitude [um] and of A1 and A2 [ms], NaN where blank; whether the film says that it is harmed."""
    random, eye = np.random.default_rng(seed), EYES[number]
    frames = made_up.draw(eye, LOOK, 540.0, seed, WHICH)
    harm(frames, random)
    true = respond(truth(eye, eye.scene()), INTERVAL_MS)
    try:
        curves = curves_from_edges(find_edges(frames), TIMES_MS[WHICH], Instrument())
    except FilmError:
        return float("nan"), float("nan"), True
    read, notes = believed(respond(curves, INTERVAL_MS), curves, histories(curves), "counting")
    off = {
        name: abs(getattr(read, name) - getattr(true, name)) if getattr(read, name) is not None else float("nan")
        for name in ("deformation_amplitude_mm", "a1_time_ms", "a2_time_ms")
    }
    said = any(word in note for note in (*curves.notes, *notes) for word in WORDS)
    return 1e3 * off["deformation_amplitude_mm"], float(np.fmax(off["a1_time_ms"], off["a2_time_ms"])), said


def measure(stage, films: int = FILMS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Read so many films harmed at random."""
    random = np.random.default_rng(seed)
    found = []
    for k in range(films):
        stage(f"obstacles {k + 1} of {films}")
        found.append(errors(int(random.integers(len(EYES))), seed + k))
    amplitude, late, said = (np.array(column) for column in zip(*found))
    silent = ~said.astype(bool)
    over = (amplitude > AMPLITUDE_UM) | (late > TIME_MS)

    def worst(values):
        return float(np.nanmax(np.where(silent, values, 0.0)))

    return [
        at_most("largest silent error of the amplitude", worst(amplitude), "um", AMPLITUDE_UM, f"{films} films"),
        at_most("largest silent error of A1 and A2", worst(late), "ms", TIME_MS, f"{silent.sum()} films say nothing"),
        figure("films that say so and are off by more", int((over & ~silent).sum()), "films"),
        figure("amplitude, worst of all films", float(np.nanmax(amplitude)), "um"),
        figure("A1 and A2, worst of all films", float(np.nanmax(late)), "ms"),
    ], []
