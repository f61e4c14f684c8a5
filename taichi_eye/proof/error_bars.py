"""`taichi-eye check error-bars`: are the true numerical errors inside the bars that `numerics.error_bar` states?

Twelve varied scenes on every rung, at settings as a user takes them (spacing SPACING_MM, sound speed SOUND_SPEED_M_S).
Each runs three times: itself, its twin, and a reference at FINER times finer settings, in spacing and in sound speed.
The true error of a figure is that against the reference. For every figure: in how many scenes the true error lies
inside the bar, at least ASKED_INSIDE of them; the bar over the true error, in the median over all figures of a rung at
most ASKED_RATIO; the true error itself; and the error of the extrapolated figure over it. Of the apex history every
instant must lie inside its band. The order is the one that all three runs agree on: error as (spacing, one over sound
speed) to that power. A rung without a liquid is put to LIGHT of the puff: under all of it, its cornea reaches the back.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
from tqdm import tqdm

from taichi_eye import shipped
from taichi_eye.analysis.error_bar import ErrorBar, error_bar
from taichi_eye.analysis.simulated import Observed, observe
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.ladder.twin import twin_of
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.page import table, write_page
from taichi_eye.scene import Scene, load_scene

# a scene that ships, or None for the default eye, and what is changed
SCENES: dict[str, tuple[str | None, tuple[str, ...]]] = {
    "default": (None, ()),
    "iop-10": (None, ("eye.iop_mmhg=10",)),
    "iop-30": (None, ("eye.iop_mmhg=30",)),
    "puff-5": (None, ("puff.peak_kpa=5",)),
    "puff-15": (None, ("puff.peak_kpa=15",)),
    "small-steep": (None, ("cornea.radius_mm=7.2", "cornea.limbus_radius_mm=5.5")),
    "large-flat": (None, ("cornea.radius_mm=8.4", "cornea.limbus_radius_mm=6.2")),
    "thin-yielding": (None, ("cornea.thickness_mm=0.45", "chamber.compliance_mm3_mmhg=0.3")),
    "soft": (None, ("cornea.exponent_k=40",)),
    "corvis-puff": (None, ('puff.time_course="corvis"', "puff.peak_kpa=8", "eye.whole_eye_movement_mm=0.3")),
    "healthy": ("corvis_healthy", ()),
    "keratoconus": ("keratoconus", ()),
}
PARTS = {"membrane": 4.0, "cavity": 4.0, "added_mass": 2.0, "mfpm": 2.0}  # rungs, and FINER of their references
SPACING_MM, SOUND_SPEED_M_S = 0.2, 40.0
LIGHT = 0.2
ASKED_INSIDE, ASKED_RATIO = Fraction(11, 12), 4.0
HISTORY, ALL = "apex history, every instant", "all figures"
HEAD = ("rung", "figure", "inside", "bar over true error", "true error", "extrapolated, its error over that", "")


@dataclass
class Row:
    """One figure on one rung: for each scene that shows it the bar, the true error and that of the extrapolated
    figure; judged: whether the bar's width is, too."""

    rung: str
    figure: str
    bars: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    extrapolated: list[float] = field(default_factory=list)
    judged: bool = False
    inside: list[bool] = field(default_factory=list)

    def add(self, bar: float, error: float, extrapolated: float, inside: bool | None = None) -> None:
        """A scene; inside: where that is not bar over error."""
        self.bars.append(bar)
        self.errors.append(error)
        self.extrapolated.append(extrapolated)
        self.inside.append(error <= bar if inside is None else inside)

    @property
    def ratio(self) -> float:
        """Bar over true error, the median; infinite where most errors are nothing."""
        return _median_ratio(self.bars, self.errors)

    @property
    def better(self) -> float:
        """The extrapolated figure's error over the true one, the median."""
        return _median_ratio(self.extrapolated, self.errors)

    @property
    def passed(self) -> bool:
        """Whether enough errors lie inside, and the bar is narrow enough where that is judged."""
        enough = sum(self.inside) >= ASKED_INSIDE * len(self.inside)
        return enough and (not self.judged or self.ratio <= ASKED_RATIO)

    def cells(self) -> tuple[str, ...]:
        """For the table."""
        return (
            self.rung,
            self.figure,
            f"{sum(self.inside)} of {len(self.inside)}",
            _cell(self.ratio),
            "" if self.figure == ALL else f"{np.median(self.errors):.2g}",
            _cell(self.better),
            "ok" if self.passed else "MISSED",
        )

    def as_dict(self) -> dict:
        """For the JSON file."""
        finite = lambda value: value if math.isfinite(value) else None
        return {**vars(self), "ratio": finite(self.ratio), "better": finite(self.better), "passed": self.passed}


@dataclass(frozen=True)
class Rung:
    """What was found on a rung: its rows, the median order of the history's error, the twin's time over the run's, and
    the scenes that a guard stopped."""

    rows: list[Row]
    order: float
    cost: float
    stopped: list[str]


def scene_of(name: str, rung: str) -> Scene:
    """A scene of the study on a rung."""
    file, changes = SCENES[name]
    scene = load_scene(None if file is None else shipped.find(file, shipped.SCENES), changes)
    if rung == "membrane":
        scene = scene.but({"puff.peak_kpa": LIGHT * scene.puff.peak_kpa})
    settings = {"spacing_mm": SPACING_MM}
    if rung == "mfpm":
        settings["sound_speed_m_s"] = SOUND_SPEED_M_S
    return with_numerics(scene, fidelity=rung, error_bar=True, **settings)


def study(rung: str, tell: Callable[[str], None] = lambda name: None) -> Rung:
    """All scenes on a rung; tell(name): called before each."""
    rows: dict[str, Row] = {HISTORY: Row(rung, HISTORY, judged=True)}
    orders, costs, stopped = [], [], []
    for name in SCENES:
        tell(name)
        scene = scene_of(name, rung)
        twin, finer = twin_of(scene), PARTS[rung]
        changes = {"spacing_mm": scene.numerics.spacing_mm / finer}
        if rung == "mfpm":
            changes["sound_speed_m_s"] = finer * scene.numerics.sound_speed_m_s
        started = time.perf_counter()
        run = observe(scene)
        ended = time.perf_counter()
        coarse = observe(twin.scene)
        costs.append((time.perf_counter() - ended) / (ended - started))
        reference = observe(with_numerics(scene, **changes))
        if run.stopped or coarse.stopped or reference.stopped:
            stopped.append(name)
            continue
        bar = error_bar(twin, run, coarse)
        # of the same run: only values are asked of this one
        true = error_bar(twin, reference, reference)
        _compare(rows, rung, bar, true)
        orders.append(_order(bar, true, coarse, finer))
    figures = list(rows.values())[1:]
    every = Row(rung, ALL, judged=True)
    for row in figures:
        every.bars += row.bars
        every.errors += row.errors
        every.extrapolated += row.extrapolated
        every.inside += row.inside
    return Rung([rows[HISTORY], every, *figures], float(np.median(orders)), float(np.median(costs)), stopped)


def _compare(rows: dict[str, Row], rung: str, bar: ErrorBar, true: ErrorBar) -> None:
    """Add a scene to the rows."""
    error, left = (np.abs(true.apex_mm - mm) for mm in (bar.apex_mm, bar.extrapolated_mm))
    inside = bool((error <= bar.band_mm).all())
    rows[HISTORY].add(float(bar.band_mm.max()), float(error.max()), float(left.max()), inside)
    for block in ("apex", "response"):
        own, other = (getattr(one, block) for one in (bar, true))
        for name, value in own.values.items():
            figure = f"apex {name}" if block == "apex" else name
            found = value, own.errors[name], own.extrapolated[name], other.values[name]
            if None not in found:
                exact = found[3]
                rows.setdefault(figure, Row(rung, figure)).add(found[1], abs(value - exact), abs(found[2] - exact))


def _order(bar: ErrorBar, true: ErrorBar, coarse: Observed, finer: float) -> float:
    """The power p of the history's error: (twin less run) over (run less reference) is (q^p - 1)/(1 - finer^-p)."""
    wide = np.abs(coarse.outcome.traces["apex_displacement_mm"] - bar.apex_mm).max()
    near = np.abs(bar.apex_mm - true.apex_mm).max()
    powers = np.linspace(0.1, 6.0, 1000)
    return float(np.interp(wide / near, (bar.twin.ratio**powers - 1.0) / (1.0 - finer**-powers), powers))


def report(only=(), out: str | None = None, json_file: str | None = None, progress: bool = True) -> bool:
    """Study the rungs named (all without names), print the table, write the page; whether every row passed."""
    folder = create_run_folder(out, "error-bars")
    names, found = list(only or PARTS), {}
    with tqdm(total=len(names) * len(SCENES), unit=" scenes", disable=not progress, dynamic_ncols=True) as bar:
        for rung in names:

            def tell(name, rung=rung):
                bar.set_description_str(f"{rung}, {name}")
                bar.update()

            found[rung] = study(rung, tell)
    rows = [row for one in found.values() for row in one.rows]
    for line in (HEAD, ["---"] * len(HEAD), *(row.cells() for row in rows)):
        print(f"| {' | '.join(line)} |")
    said = [words(rung, one) for rung, one in found.items()]
    missed = [index for index, row in enumerate(rows) if not row.passed]
    verdict = f"{len(rows) - len(missed)} of {len(rows)} rows hold"
    write_page(
        folder / "error-bars.html",
        "taichi-eye error-bars",
        [f"<p>{verdict}.</p>", *(f"<p>{line}</p>" for line in said), table(HEAD, [r.cells() for r in rows], missed)],
    )
    if json_file:
        plain = {
            rung: {**vars(one), "rows": [row.as_dict() for row in one.rows], "settings": _settings(rung)}
            for rung, one in found.items()
        }
        write_text(Path(json_file), json.dumps(plain, indent=2, allow_nan=False) + "\n")
    for line in said:
        print(line)
    print(f"{verdict}; {folder / 'error-bars.html'}")
    return not missed and not any(one.stopped for one in found.values())


def words(rung: str, found: Rung) -> str:
    """What was found on a rung, in a sentence."""
    said = (
        f"{rung} ({_settings(rung)}): errors of order {found.order:.2f}, a twin takes {100 * found.cost:.0f} % of the "
        "time of the run without its film"
    )
    return said + (f"; stopped by a guard: {', '.join(found.stopped)}" if found.stopped else "")


def _settings(rung: str) -> str:
    sound = f", c {SOUND_SPEED_M_S:g} m/s" if rung == "mfpm" else ""
    return f"H {SPACING_MM:g} mm{sound}, reference {PARTS[rung]:g} times finer"


def _median_ratio(above: list[float], below: list[float]) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.array(above) / np.array(below)
    return float(np.median(np.where(np.isnan(ratio), 1.0, ratio)))


def _cell(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"
