"""What a map hands back, and how its field of dots is drawn."""

from dataclasses import dataclass, field

from matplotlib.figure import Figure

from taichi_eye.proof.maps.runs import CAUSES, NAMES


@dataclass(frozen=True)
class Map:
    """One map: its picture, what it found in plain words, its numbers, and what contradicts the solver's promises.

    head, body: a table for the page; figures: numbers for the JSON file; broken: one line for each run that returned
    bad numbers without a stop or stopped with a wrong diagnosis.
    """

    name: str
    canvas: Figure
    found: list[str]
    head: tuple = ()
    body: list[tuple] = field(default_factory=list)
    figures: dict = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)


def panels(columns: int, rows: int = 1, width: float = 6.4, height: float = 4.6):
    """A canvas and its axes [rows, columns]."""
    canvas = Figure(figsize=(width * columns, height * rows), dpi=110, layout="constrained")
    every = canvas.subplots(rows, columns, squeeze=False)
    for axes in every.flat:
        axes.grid(color="#e4e7ea", linewidth=0.6)
        axes.set_axisbelow(True)
    return canvas, every


def dots(axes, x, y, causes, size: float = 42.0) -> None:
    """A dot at each (x, y): filled where the run was stopped, coloured by the guard's diagnosis; open where it ran."""
    for cause in dict.fromkeys(causes):
        chosen = [k for k, each in enumerate(causes) if each == cause]
        place = [x[k] for k in chosen], [y[k] for k in chosen]
        if cause:
            axes.scatter(
                *place,
                s=size,
                color=CAUSES[cause],
                marker="X",
                linewidths=0.4,
                edgecolors="white",
                label=f"stopped: {NAMES[cause]}",
                zorder=3,
            )
        else:
            axes.scatter(
                *place,
                s=size,
                facecolors="white",
                edgecolors=CAUSES["taut and sound"],
                linewidths=1.6,
                label="ran to its end",
                zorder=3,
            )


def finish(axes, title: str, x: str, y: str, *, log: str = "", legend: str = "best", ticks=None) -> None:
    """Titles, scales, the legend and, given as (x, y), the ticks of one panel."""
    axes.set_title(title, fontsize=11)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if "x" in log:
        axes.set_xscale("log")
    if "y" in log:
        axes.set_yscale("log")
    if ticks:
        axes.set_xticks(ticks[0], [f"{v:g}" for v in ticks[0]])
        axes.set_yticks(ticks[1], [f"{v:g}" for v in ticks[1]])
        axes.minorticks_off()
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=True, framealpha=0.85, edgecolor="none", loc=legend)
