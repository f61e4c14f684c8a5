"""`taichi-eye chart SCENE`: rungs and settings side by side, wall time against error.

Errors are against a converged reference of the same scene: `mfpm` extrapolated to h -> 0 and c -> infinity from the
finest triple (h, c), (h sqrt 2, c), (h sqrt 2, c/2) that the budget paid for, and the next coarser triple says how well
converged that is. A point's error is the largest of peak, 50 % times and whole history (`taichi_eye.ladder.misfit`), in
percent.

Of two points that differ by a factor 2 in spacing and, of `mfpm`, in sound speed, as run and twin of an error bar do
(`taichi_eye.ladder.twin`), a third is made: Richardson's limit, "extrapolated", at the time of both.

Points run cheapest first and are kept in chart.json as they finish, so a chart can be interrupted and resumed; a point
whose predicted time does not fit what is left of the budget is passed over.
"""

import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.ladder.misfit import Misfit, extrapolate, misfit
from taichi_eye.ladder.points import SPACINGS, Point, Setting, finest_limit, run_point, triple
from taichi_eye.report.folder import write_text
from taichi_eye.scene import Scene, dump_scene

LEVELS = ((0.1, 80.0), (0.1414, 80.0), (0.2, 80.0), (0.2828, 80.0))  # of the reference, finest first
TOLERANCES = (10.0, 3.0, 1.0, 0.3)
RATE = 3e-5  # s per (c in m/s) / (h in mm)^3, to predict the time of an mfpm point before one has been measured
BASE = Setting("mfpm", 0.2, 40.0)  # what one thing at a time is changed from


def settings() -> list[Setting]:
    """Every point of a chart, roughly cheapest first."""
    found = [Setting("membrane", 0.2)]
    found += [Setting("cavity", h) for h in SPACINGS]
    found += [Setting("added_mass", h) for h in SPACINGS[:-1]]
    found += [Setting("added_mass", 0.2, refresh_travel=travel) for travel in (2.0, 1.0, 0.25, 0.1)]
    found += [Setting("cavity", 0.2, precision="f32"), Setting("added_mass", 0.2, precision="f32")]
    found += [Setting("mfpm", h, c) for c in (10.0, 20.0, 40.0) for h in SPACINGS[:3]]
    found += [Setting("mfpm", h, 80.0) for h in SPACINGS[:4]]
    found += [Setting("mfpm", 0.1414, 40.0)]
    found += [
        Setting("mfpm", h, c, 5.0 * c)
        for h, c in ((0.4, 20.0), (0.2828, 20.0), (0.2, 20.0), (0.2, 32.0), (0.1414, 32.0))
    ]
    found += [
        Setting("mfpm", 0.2, 40.0, **change)
        for change in ({"cfl": 0.4}, {"coupling": "loose"}, {"basis": "cubic"}, {"precision": "f32"}, {"threads": 1})
    ]
    found += [
        Setting("mfpm", 0.2, 160.0),
        Setting("mfpm", 0.1, 40.0),
        Setting("mfpm", 0.1414, 160.0),
        Setting("mfpm", 0.1, 80.0),
    ]
    known = {setting.label for setting in found}
    return found + [setting for level in LEVELS for setting in triple(*level) if setting.label not in known]


@dataclass
class Chart:
    """Points of one scene by label, and what has been worked out from them.

    every: the points, and those extrapolated from two of them.
    """

    scene: Scene
    points: dict[str, Point]
    passed_over: tuple[str, ...] = ()

    def __post_init__(self):
        self.reference, self.level, rougher = finest_limit(self.points, LEVELS)
        self.uncertainty = misfit(rougher, self.reference).of("apex") if rougher else None
        self.every = self.points | extrapolated(self.points)
        self.errors: dict[str, Misfit] = {}
        if self.reference is not None:
            # an unfinished run has no error
            self.errors = {
                label: misfit(point.traces, self.reference) for label, point in self.every.items() if not point.stopped
            }

    def error(self, label: str) -> float:
        """Error of a point in percent, as the scene's tolerance means it."""
        return self.errors[label].of(self.scene.numerics.tolerance_on)

    def front(self) -> list[str]:
        """Labels of the points that no other beats in both time and error, fastest first."""
        best, front = math.inf, []
        for label in sorted(self.errors, key=lambda name: self.every[name].whole_s):
            if self.error(label) < best:
                best = self.error(label)
                front.append(label)
        return front

    def recommended(self) -> dict[float, str | None]:
        """The cheapest point within each tolerance."""
        return {
            tolerance: min(
                (label for label in self.errors if self.error(label) <= tolerance),
                key=lambda name: self.every[name].whole_s,
                default=None,
            )
            for tolerance in TOLERANCES
        }

    def exponents(self) -> dict[str, float]:
        """Measured powers: of the solver's time in 1/h and in nodes, of the errors in h and in 1/c."""
        found = {}
        for c in (40.0, 80.0):
            line = [point for h in SPACINGS if (point := self.points.get(Setting("mfpm", h, c).label))]
            if len(line) > 2:
                h, nodes, seconds = (
                    np.array([get(point) for point in line])
                    for get in (lambda p: p.setting.spacing_mm, lambda p: p.nodes, lambda p: p.solver_s)
                )
                found[f"mfpm c {c:g}: time in 1/h"] = -slope(h, seconds)
                found[f"mfpm c {c:g}: time per step in nodes"] = slope(nodes, seconds / [p.steps for p in line])
                found |= _order(f"mfpm c {c:g}: error in h", line)
        for rung in ("cavity", "added_mass"):
            line = [point for h in SPACINGS if (point := self.points.get(Setting(rung, h).label))]
            if len(line) > 2:
                found[f"{rung}: time in 1/h"] = -slope([p.setting.spacing_mm for p in line], [p.solver_s for p in line])
                found |= _order(f"{rung}: error in h", line)
        line = [
            point for c in (10.0, 20.0, 40.0, 80.0, 160.0) if (point := self.points.get(Setting("mfpm", 0.2, c).label))
        ]
        if len(line) > 3:
            stiff = extrapolate(line[-1].traces, line[-2].traces, 2.0)
            found["mfpm h 0.2: error in 1/c"] = -slope(
                [p.setting.sound_speed_m_s for p in line[:-1]], [misfit(p.traces, stiff).history for p in line[:-1]]
            )
        return found

    def shares(self) -> dict[str, dict[str, float]]:
        """The error of each point by source, in percent of the apex's peak at the worst instant.

        model: of a rung's own limit h -> 0 against the reference; space: against that limit; for mfpm space and sound
        speed by halving the square of h and c, scaled to the point by their second order; time and coupling: what
        halving cfl and iterating changes at the setting they were tried at.
        """
        found: dict[str, dict[str, float]] = {}
        for rung in ("cavity", "added_mass"):
            line = [point for h in SPACINGS if (point := self.points.get(Setting(rung, h).label))]
            if self.reference is None or len(line) < 2:
                continue
            own = _own_limit(line)
            for point in line:
                found[point.setting.label] = {
                    "model": misfit(own, self.reference).history,
                    "space": misfit(point.traces, own).history,
                }
        pairs = self._mfpm_pairs()
        for label, point in self.points.items():
            setting = point.setting
            if (
                setting.fidelity == "mfpm"
                and pairs
                and label == Setting("mfpm", setting.spacing_mm, setting.sound_speed_m_s).label
            ):
                space, sound = pairs
                found[label] = {
                    "space": space * setting.spacing_mm**2,
                    "sound speed": sound / setting.sound_speed_m_s**2,
                }
        base = self.points.get(BASE.label)
        for name, change in (("time", {"cfl": 0.4}), ("coupling", {"coupling": "loose"})):
            other = self.points.get(Setting("mfpm", 0.2, 40.0, **change).label)
            if base and other and BASE.label in found:
                found[BASE.label][name] = misfit(other.traces, base.traces).history
        return found

    def _mfpm_pairs(self):
        """Space error per mm^2 and sound speed error times c^2, from the level of the reference."""
        if self.level is None:
            return None
        fine, coarse, soft = (self.points[setting.label] for setting in triple(*self.level))
        space = misfit(extrapolate(fine.traces, coarse.traces, 2.0**0.5), fine.traces).history / self.level[0] ** 2
        sound = misfit(extrapolate(coarse.traces, soft.traces, 2.0), coarse.traces).history * self.level[1] ** 2
        return space, sound

    def as_dict(self) -> dict:
        """All figures for the JSON file, points with their traces."""
        return {
            "scene": dump_scene(self.scene),
            "reference": {"level": self.level, "uncertainty_percent": self.uncertainty},
            "points": [point.as_dict() for point in self.points.values()],
            "errors_percent": {label: error.as_dict() for label, error in self.errors.items()},
            "front": self.front(),
            "recommended": {f"{t:g} %": label for t, label in self.recommended().items()},
            "exponents": self.exponents(),
            "shares_percent": self.shares(),
        }


def extrapolated(points: dict[str, Point]) -> dict[str, Point]:
    """Richardson's limits of what run and twin may be, by label: each at the time of both."""
    found = {}
    for point in points.values():
        setting = point.setting
        c = setting.sound_speed_m_s
        coarse = [
            other
            for h in SPACINGS
            if abs(h / setting.spacing_mm - 2.0) < 0.01
            and (other := points.get(Setting(setting.fidelity, h, c and c / 2.0).label))
        ]
        plain = setting.label == Setting(setting.fidelity, setting.spacing_mm, c).label
        if plain and coarse and not (point.stopped or coarse[0].stopped):
            twin = coarse[0]
            found[f"{setting.label} extrapolated"] = replace(
                point,
                traces=extrapolate(point.traces, twin.traces, twin.setting.spacing_mm / setting.spacing_mm),
                whole_s=point.whole_s + twin.whole_s,
                solver_s=point.solver_s + twin.solver_s,
                steps=point.steps + twin.steps,
            )
    return found


def slope(x, y) -> float:
    """Power of y in x by least squares of the logarithms."""
    return float(np.polyfit(np.log(np.asarray(x, dtype=float)), np.log(np.asarray(y, dtype=float)), 1)[0])


def _own_limit(line) -> dict[str, np.ndarray]:
    """The limit h -> 0 of points refined in h alone, coarsest first."""
    coarse, fine = line[-2:]
    return extrapolate(fine.traces, coarse.traces, coarse.setting.spacing_mm / fine.setting.spacing_mm)


def _order(name, line) -> dict[str, float]:
    """The order of convergence of points refined by sqrt 2, against their own extrapolated limit."""
    own = _own_limit(line)
    return {name: slope([p.setting.spacing_mm for p in line[:-1]], [misfit(p.traces, own).history for p in line[:-1]])}


def read(folder: Path, scene: Scene) -> dict[str, Point]:
    """The points of an interrupted chart of the same scene; SceneError where the folder holds another's or none."""
    path = folder / "chart.json"
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        points = [Point.from_dict(point) for point in plain["points"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneError(
            f"--resume {folder}: chart.json there cannot be read ({error}); name the folder of an interrupted chart"
        ) from None
    if plain.get("scene") != dump_scene(scene):
        raise SceneError(
            f"--resume {folder}: holds the chart of another scene; name its scene file with the same --set, or "
            "leave --resume out"
        )
    return {point.setting.label: point for point in points}


def measure(
    scene: Scene, folder: Path, points: dict[str, Point], budget_s: float, tell=lambda label, done, total: None
) -> Chart:
    """Run what is missing of a chart within the budget [s]; chart.json in `folder` is rewritten after each point."""
    started = time.perf_counter()
    todo = [setting for setting in settings() if setting.label not in points]
    # one precision and thread count after the other: each change starts Taichi afresh
    todo.sort(
        key=lambda setting: (setting.precision != "f64", setting.threads or 0, expected_s(setting, points, scene))
    )
    passed_over = []
    for index, setting in enumerate(todo):
        tell(setting.label, index, len(todo))
        if time.perf_counter() - started + expected_s(setting, points, scene) > budget_s:
            passed_over.append(setting.label)
            continue
        try:
            points[setting.label] = run_point(scene, setting)
        except SceneError as error:
            # this scene cannot be discretised so, as its own message says
            passed_over.append(f"{setting.label} ({error})")
            continue
        write_text(folder / "chart.json", json.dumps(Chart(scene, points).as_dict()) + "\n")
    tell("", len(todo), len(todo))
    chart = Chart(scene, points, tuple(passed_over))
    write_text(folder / "chart.json", json.dumps(chart.as_dict()) + "\n")
    return chart


def expected_s(setting: Setting, points: dict[str, Point], scene: Scene) -> float:
    """Predicted time [s] to measure a point, repeats and compilation included; by an mfpm point already there, if
    any."""
    duration = scene.numerics.duration_ms / 32.0
    if setting.fidelity != "mfpm":
        return duration * (0.5 + (0.02 if setting.fidelity == "added_mass" else 0.002) / setting.spacing_mm**2)
    work = (
        (setting.sound_speed_m_s / setting.spacing_mm**3)
        * (0.8 / (setting.cfl or 0.8))
        * (2.5 if setting.basis == "cubic" else 1.0)
    )
    rate = RATE
    alike = [
        point
        for point in points.values()
        if point.setting.fidelity == "mfpm" and point.setting.sound_speed_m_s and point.setting.sound_speed_m_s >= 40.0
    ]
    if alike:
        last = alike[-1]
        rate = last.whole_s / duration / (last.setting.sound_speed_m_s / last.setting.spacing_mm**3)
    return duration * work * rate * (4.0 if work * rate < 2.0 else 1.1) + 1.0
