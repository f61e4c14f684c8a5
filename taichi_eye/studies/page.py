"""The plots of a study, and its page: response curves, a scatter matrix, and a bar for each key that matters."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.analysis.names import UNITS, unit_of
from taichi_eye.report.folder import replacing
from taichi_eye.report.page import COLOURS, embedded, plain, table, write_page
from taichi_eye.studies.matters import Effect
from taichi_eye.studies.study import KINDS, Study

KEYS_MAX = 8  # columns of the response curves
SCATTERED = 6, 4  # keys and figures of the scatter matrix, at most
DOTS = 2000  # eyes that are drawn, at most
BINS = 12
GREY = "#8a9199"
SHORT = "a1", "a2", "hc", "da", "iop", "sp"  # words that stand for others


def label(name: str) -> str:
    """A column in words, with its unit; a key of a scene by its name."""
    if "." in name:
        return name
    unit = unit_of(name)
    tail = next((short for short, long in UNITS.items() if long == unit), "")
    words = name.replace(f"_{tail}", "").split("_") if tail else name.split("_")
    words = [{"biop": "bIOP", "nct": "(NCT)"}.get(w, w.upper() if w in SHORT else w) for w in words]
    return " ".join(words) + (f", {unit}" if unit else "")


def draw(study: Study, frame, found: Sequence[Effect]) -> dict[str, Figure]:
    """The figures by the names of their files."""
    figures = [name for name in study.show if np.isfinite(frame[name].to_numpy(dtype=float)).any()]
    keys = _foremost(study, frame, found)
    drawn = {}
    if figures and keys:
        drawn["responses.png"] = _responses(study, frame, keys, figures)
        drawn["scatter.png"] = _scatter(frame, keys[: SCATTERED[0]], figures[: SCATTERED[1]])
    if found:
        drawn["matters.png"] = _bars(study, found)
    return drawn


def write(study: Study, frame, found: Sequence[Effect], summary: dict[str, Any], folder: Path) -> Path:
    """Write the plots and study.html; the page's path."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a layout that is tight
        pictures = []
        for name, figure in draw(study, frame, found).items():
            data = io.BytesIO()
            figure.savefig(data, format="png", dpi=110)
            with replacing(folder / name) as temporary:
                temporary.write_bytes(data.getvalue())
            pictures.append(embedded(data.getvalue()))
    counts = ", ".join(f"{count} {status}" for status, count in summary["status"].items() if count)
    words = f"{study.kind}: {KINDS[study.kind][0]}. {summary['eyes']} eyes: {counts}."
    used = min((effect.eyes for effect in found), default=summary["eyes"])
    if used < summary["eyes"] and study.kind != "one_at_a_time":
        words += (
            f" What matters was taken from {used} of them, those that show a figure: it is said of such eyes alone."
        )
    parts = [f"<p>{plain(words)}</p>", *pictures]
    body = [
        (label(name), *(f"{value:.4g}" for value in (row["mean"], row["sd"], row["least"], row["most"])), row["eyes"])
        for name, row in summary["figures"].items()
    ]
    parts += ["<h2>Figures</h2>", table(("figure", "mean", "SD", "least", "most", "eyes"), body)]
    reasons = [(reason, count) for reason, count in summary["reasons"].items()]
    if reasons:
        parts += ["<h2>What stopped</h2>", table(("reason", "eyes"), reasons)]
    page = folder / "study.html"
    write_page(page, f"taichi-eye sweep {study.name}", parts)
    return page


def _foremost(study: Study, frame, found: Sequence[Effect]) -> list[str]:
    """The keys that are drawn, those that matter most where they are too many, in the order of the study."""
    keys = [name for name in study.factors if frame[name].dtype.kind in "fib"]
    if len(keys) > KEYS_MAX:
        largest = {
            figure: max(abs(e.value) for e in found if e.figure == figure) for figure in {e.figure for e in found}
        }
        weight = {key: sum(abs(e.value) / largest[e.figure] for e in found if e.key == key) for key in keys}
        chosen = sorted(keys, key=lambda key: -weight[key])[:KEYS_MAX]
        keys = [key for key in keys if key in chosen]
    return keys


def _responses(study: Study, frame, keys: Sequence[str], figures: Sequence[str]) -> Figure:
    # a row for each figure and a column for each key; of a single key the figures stand side by side
    single = len(keys) == 1
    down, across = (1, len(figures)) if single else (len(figures), len(keys))
    canvas = Figure(figsize=(2.9 * across + 0.6, 2.3 * down + 0.4), layout="constrained")
    grid = canvas.subplots(down, across, squeeze=False, sharey="none" if single else "row")
    grid = grid.T if single else grid
    whole = frame["status"].to_numpy() == "complete"
    for column, key in enumerate(keys):
        rows = _line_of(study, key, len(frame)) & whole
        for row, figure in enumerate(figures):
            axes, colour = grid[row, column], COLOURS[row % len(COLOURS)]
            x, y = (frame[name].to_numpy(dtype=float)[rows] for name in (key, figure))
            good = np.isfinite(x) & np.isfinite(y)
            _curve(axes, x[good], y[good], colour, study)
            axes.grid(color="#e4e7ea", linewidth=0.6)
            axes.tick_params(labelsize=7)
            if single or row == len(figures) - 1:
                axes.set_xlabel(key, fontsize=8)
            if column == 0:
                axes.set_ylabel(label(figure), fontsize=8)
    return canvas


def _line_of(study: Study, key: str, count: int) -> np.ndarray:
    """The eyes that a key's curve goes through: all, or of a study one at a time the scene's own and the key's."""
    rows = np.ones(count, dtype=bool)
    if study.kind == "one_at_a_time":
        lengths = [len(law.levels) for law in study.vary.values()]
        first = 1 + sum(lengths[: list(study.vary).index(key)])
        rows[1:] = False
        rows[first : first + len(study.vary[key].levels)] = True
    return rows


def _curve(axes, x: np.ndarray, y: np.ndarray, colour: str, study: Study) -> None:
    """Points, and through them a line: at each level, or the median of as many bins as there are points for."""
    if not len(x):
        return
    levels = np.unique(x)
    if study.kind == "one_at_a_time" or len(study.factors) == 1 and len(levels) == len(x):
        # a level of the scene's own eye stands there twice
        axes.plot(
            levels, [np.median(y[x == level]) for level in levels], "o-", color=colour, markersize=3, linewidth=1.3
        )
        return
    shown = _some(len(x))
    axes.plot(x[shown], y[shown], ".", color=colour, alpha=0.4, markersize=_dot(len(shown)), markeredgewidth=0)
    bins = min(BINS, len(x) // 6)
    if bins < 3 and len(levels) > bins:
        return
    if len(levels) <= bins:
        at, middle = levels, [np.median(y[x == level]) for level in levels]
    else:
        edges = np.quantile(x, np.linspace(0.0, 1.0, bins + 1))
        inside = [(x >= low) & (x <= high) for low, high in zip(edges, edges[1:])]
        at, middle = ([np.median(values[one]) for one in inside if one.any()] for values in (x, y))
    axes.plot(at, middle, "-", color="#22262b", linewidth=1.3)


def _dot(count: int) -> float:
    """Size of a dot where there are so many."""
    return float(np.clip(60.0 / np.sqrt(max(count, 1)), 1.8, 6.0))


def _some(count: int) -> np.ndarray:
    """Numbers of the eyes that are drawn."""
    if count <= DOTS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, DOTS, replace=False))


def _scatter(frame, keys: Sequence[str], figures: Sequence[str]) -> Figure:
    names = [*keys, *figures]
    whole = np.flatnonzero(frame["status"].to_numpy() == "complete")
    shown = whole[_some(len(whole))]
    columns = {name: frame[name].to_numpy(dtype=float)[shown] for name in names}
    size = max(4.5, 1.35 * len(names))
    canvas = Figure(figsize=(size, size))
    grid = canvas.subplots(len(names), len(names), squeeze=False)
    # a layout that fits itself takes seconds for so many panes
    canvas.subplots_adjust(0.7 / size, 0.6 / size, 1.0 - 0.1 / size, 1.0 - 0.1 / size, 0.1, 0.1)
    for row, below in enumerate(names):
        for column, across in enumerate(names):
            axes, colour = grid[row, column], COLOURS[0] if below in figures or across in figures else GREY
            if row == column:
                values = columns[below]
                axes.hist(values[np.isfinite(values)], bins=24, color=colour)
                axes.set_yticks([])
            else:
                axes.plot(
                    columns[across], columns[below], ".", color=colour, markersize=2, markeredgewidth=0, alpha=0.5
                )
            axes.tick_params(labelsize=5)
            if row < len(names) - 1:
                axes.set_xticklabels([])
            else:
                axes.set_xlabel(_broken(across), fontsize=6)
            if column:
                axes.set_yticklabels([])
            else:
                axes.set_ylabel(_broken(below), fontsize=6)
    return canvas


def _broken(name: str) -> str:
    """A label over two lines."""
    if "." in name:
        return name.replace(".", ".\n")
    words = label(name).split(" ")
    half = -(-len(words) // 2)
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])


def _bars(study: Study, found: Sequence[Effect]) -> Figure:
    figures = list(dict.fromkeys(effect.figure for effect in found))
    keys = list(dict.fromkeys(effect.key for effect in found))
    canvas = Figure(figsize=(2.7 * len(figures) + 2.2, 0.34 * len(keys) + 1.4), layout="constrained")
    panes = canvas.subplots(1, len(figures), squeeze=False, sharey=True)[0]
    for axes, figure in zip(panes, figures):
        of_figure = {effect.key: effect for effect in found if effect.figure == figure}
        order = [key for key in keys if key in of_figure]
        place = np.array([keys.index(key) for key in order], dtype=float)
        some = [of_figure[key] for key in order]
        _BARS[study.kind if study.kind in _BARS else "slopes"](axes, place, some)
        axes.set_axisbelow(True)
        axes.use_sticky_edges = False
        axes.margins(x=0.06)
        axes.axvline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(label(figure), fontsize=8)
        axes.set_yticks(range(len(keys)), keys, fontsize=7)
        axes.tick_params(axis="x", labelsize=7)
        axes.grid(axis="x", color="#e4e7ea", linewidth=0.6)
    panes[0].invert_yaxis()
    bars, names = panes[0].get_legend_handles_labels()
    if bars:
        canvas.legend(bars, names, loc="outside upper center", ncols=len(bars), fontsize=7, frameon=False)
    return canvas


def _index_bars(axes, place: np.ndarray, some: Sequence[Effect]) -> None:
    for shift, value, half, name, colour in (
        (-0.18, "first", "first_interval", "first order", COLOURS[0]),
        (0.18, "value", "interval", "total", COLOURS[1]),
    ):
        axes.barh(
            place + shift,
            [getattr(effect, value) for effect in some],
            0.34,
            xerr=[getattr(effect, half) for effect in some],
            color=colour,
            label=name,
            error_kw={"elinewidth": 0.9, "ecolor": "#22262b"},
        )
    axes.set_xlabel("Sobol index", fontsize=8)


def _span_bars(axes, place: np.ndarray, some: Sequence[Effect]) -> None:
    axes.barh(
        place, [effect.high - effect.low for effect in some], 0.6, [effect.low for effect in some], color=COLOURS[0]
    )
    axes.set_xlabel("change from the scene's eye", fontsize=8)


def _slope_bars(axes, place: np.ndarray, some: Sequence[Effect]) -> None:
    axes.barh(
        place,
        [effect.value for effect in some],
        0.6,
        xerr=[effect.interval for effect in some],
        color=COLOURS[0],
        error_kw={"elinewidth": 0.9, "ecolor": "#22262b"},
    )
    axes.set_xlabel(f"SDs per SD; R$^2$ {some[0].explained:.2f}", fontsize=8)


_BARS = {"sensitivity": _index_bars, "one_at_a_time": _span_bars, "slopes": _slope_bars}
