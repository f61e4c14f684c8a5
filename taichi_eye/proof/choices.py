"""`taichi-eye choices`: `numerics.fidelity = "auto"` put to varied scenes.

For each scene and tolerance: what auto picks, its true error against a converged reference, and what it cost, pilots
included, beside the cheapest setting of a grid that would have passed: at most ASKED_RATIO times that or SPARED_S more,
whichever is larger, is asked. The reference is `mfpm` extrapolated in h and c; the next coarser extrapolation says how
uncertain it is. Costs are wall times of packing, set-up and solver, warm, taken in turns, the least of several, for
what else the machine does only adds.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from taichi_eye.ladder.choose import Choice, choose
from taichi_eye.ladder.misfit import misfit
from taichi_eye.ladder.points import SPACINGS, Point, Setting, finest_limit, run_point, triple
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.page import table, write_page
from taichi_eye.scene import Scene, load_scene

# short puffs end before the ringing that follows them, in which no two settings agree
PARTS = {
    "default": (),
    "iop-10": ("eye.iop_mmhg=10",),
    "iop-30": ("eye.iop_mmhg=30",),
    "puff-5": ("puff.peak_kpa=5",),
    "puff-15": ("puff.peak_kpa=15",),
    "small-steep": ("cornea.radius_mm=7.2", "cornea.limbus_radius_mm=5.5"),
    "large-flat": ("cornea.radius_mm=8.4", "cornea.limbus_radius_mm=6.2"),
    "short-puff": ("puff.duration_ms=10", "numerics.duration_ms=8"),
    "heavy-short": ("puff.duration_ms=10", "aqueous.density_kg_m3=3000", "numerics.duration_ms=8"),
    "light": ("aqueous.density_kg_m3=300",),
    "soft": ("cornea.exponent_k=40",),
    "lens": ("chamber.lens_radius_mm=10", "chamber.lens_height_mm=0.6", "chamber.depth_mm=3.2"),
}
TOLERANCES = (10.0, 3.0, 1.0)
LEVELS = ((0.1, 80.0), (0.1414, 80.0), (0.2, 80.0))
OWN = "auto's own"
ASKED_RATIO, SPARED_S = 1.5, 0.03  # of the least cost, or more than it: whichever is larger
HEAD = (
    "scene",
    "tolerance, %",
    "auto picks",
    "true error, %",
    "reference +-, %",
    "cost, s",
    "cheapest that passes",
    "its cost, s",
    "ratio",
    "",
    "because",
)


@dataclass(frozen=True)
class Pick:
    """What auto picked for one scene under one tolerance, its true error [%] and its cost beside the least."""

    scene: str
    tolerance: float
    picked: str
    error: float
    uncertainty: float
    cost_s: float
    cheapest: str
    cheapest_s: float
    reason: str

    @property
    def ratio(self) -> float:
        """Cost over that of the cheapest setting that would have passed."""
        return self.cost_s / self.cheapest_s

    @property
    def cheap(self) -> bool:
        """Whether it cost at most ASKED_RATIO times the least or SPARED_S more: milliseconds nobody feels."""
        return self.cost_s <= max(ASKED_RATIO * self.cheapest_s, self.cheapest_s + SPARED_S)

    @property
    def passed(self) -> bool:
        """Whether the true error keeps the tolerance, and that cheaply."""
        return self.error <= self.tolerance and self.cheap

    def cells(self) -> tuple:
        """For the table."""
        return (
            self.scene,
            f"{self.tolerance:g}",
            self.picked,
            f"{self.error:.2g}",
            f"{self.uncertainty:.2g}",
            f"{self.cost_s:.3g}",
            self.cheapest,
            f"{self.cheapest_s:.3g}",
            f"{self.ratio:.2f}",
            "ok" if self.passed else "MISSED",
            self.reason,
        )


def grid() -> list[Setting]:
    """What a user might have set by hand, cheap rungs and coarse settings first."""
    found = [Setting("membrane", 0.2)]
    found += [Setting("cavity", h) for h in SPACINGS[2:5]] + [Setting("added_mass", h) for h in SPACINGS[:4]]
    return found + [Setting("mfpm", h, c, mean) for h, c, mean in ((0.4, 20.0, 100.0), (0.2, 20.0, 100.0))]


def judge(name: str, tell=lambda text: None) -> list[Pick]:
    """All tolerances of one scene."""
    scene = load_scene(None, PARTS[name])
    points: dict[str, Point] = {}
    for setting in grid():
        tell(f"{name}: {setting.label}")
        points[setting.label] = run_point(scene, setting)
    levels = LEVELS if name in ("short-puff", "heavy-short") else LEVELS[1:]
    for level in levels:
        for setting in triple(*level):
            if setting.label not in points:
                tell(f"{name}: {setting.label}")
                points[setting.label] = run_point(scene, setting, repeats=1)
    reference, _, rougher = finest_limit(points, levels)
    uncertainty = misfit(rougher, reference).of("apex")
    offered = {
        setting.label: misfit(points[setting.label].traces, reference).of("apex")
        for setting in grid()
        if not points[setting.label].stopped
    }
    rows = []
    for tolerance in TOLERANCES:
        asked = with_numerics(scene, fidelity="auto", tolerance_percent=tolerance)
        tell(f"{name}: auto at {tolerance:g} %")
        choice = choose(asked)
        own = run_point(choice.scene, _setting_of(choice))
        error = misfit(own.traces, reference).of("apex")
        passing = {label: points[label] for label, found in offered.items() if found <= tolerance}
        if error <= tolerance:
            passing[OWN] = own
        cheapest = min(passing, key=lambda label: passing[label].whole_s, default="none")
        pilots_s, own_s, least_s = _in_turns(asked, own, passing.get(cheapest))
        cost = pilots_s + (0.0 if choice.simulation is not None else own_s)
        rows.append(
            Pick(
                name,
                tolerance,
                choice.reason.split(":")[0],
                error,
                uncertainty,
                cost,
                cheapest,
                least_s,
                choice.reason,
            )
        )
    return rows


def _setting_of(choice: Choice) -> Setting:
    numerics = choice.scene.numerics
    return Setting(
        numerics.fidelity,
        numerics.spacing_mm,
        numerics.sound_speed_m_s,
        numerics.mean_sound_speed_m_s,
        refresh_travel=numerics.refresh_travel,
    )


def _in_turns(asked: Scene, own: Point, cheapest: Point | None) -> tuple[float, float, float]:
    """Least times [s] of making the choice, of the run chosen and of the cheapest, taken in turns."""
    found = [float("inf")] * 3
    longest = max(point.whole_s for point in (own, cheapest) if point is not None)
    for _ in range(9 if longest < 0.3 else 3):
        started = time.perf_counter()
        choose(asked)
        times = [time.perf_counter() - started]
        for point in (own, cheapest if cheapest is not own else None):
            times.append(float("inf") if point is None else run_point(asked, point.setting, repeats=1).whole_s)
        found = [min(pair) for pair in zip(found, times)]
    choice_s, own_s, least_s = found
    return choice_s, own_s, own_s if cheapest is own else least_s


def report(only=(), out: str | None = None, json_file: str | None = None, progress: bool = True) -> bool:
    """Judge the scenes named (all without names), print the table, write the page; whether every row passed."""
    folder = create_run_folder(out, "choices")
    rows: list[Pick] = []
    names = list(only or PARTS)
    with tqdm(total=len(names), unit=" scenes", disable=not progress, dynamic_ncols=True) as bar:
        for name in names:
            more = judge(name, bar.set_description_str)
            rows += more
            for row in more:
                bar.write("  ".join(str(cell) for cell in row.cells()))
            bar.update()
    missed = [index for index, row in enumerate(rows) if not row.passed]
    within = sum(row.error <= row.tolerance for row in rows)
    verdict = (
        f"{within} of {len(rows)} choices keep their tolerance; {len(rows) - len(missed)} of {len(rows)} do at no more "
        f"than {ASKED_RATIO:g} times the least cost or {1e3 * SPARED_S:g} ms more"
    )
    write_page(
        folder / "choices.html",
        "taichi-eye choices",
        [f"<p>{verdict}.</p>", table(HEAD, [row.cells() for row in rows], missed)],
        markdown=True,
    )
    if json_file:
        write_text(
            Path(json_file),
            json.dumps([{**row.__dict__, "ratio": row.ratio, "passed": row.passed} for row in rows], indent=2) + "\n",
        )
    print(f"{verdict}; {folder / 'choices.html'}")
    return not missed
