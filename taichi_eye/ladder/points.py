"""One scene under one setting of the ladder: run, timed and kept."""

import gc
from dataclasses import asdict, dataclass

import numpy as np

from taichi_eye import backend
from taichi_eye.cloud.packing import packed
from taichi_eye.ladder.misfit import extrapolate
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.ladder.trial import run_scene
from taichi_eye.scene import Scene
from taichi_eye.scene.schema import AUTO

SPACINGS = (0.4, 0.2828, 0.2, 0.1414, 0.1, 0.0707)  # mm; neighbours differ by sqrt 2, as a triple needs
WARM_UP_MS = 0.5
KEPT = ("time_ms", "apex_displacement_mm", "fluid_pressure_apex_kpa")


@dataclass(frozen=True)
class Setting:
    """A rung and how it is discretised; None leaves the scene's own value."""

    fidelity: str
    spacing_mm: float
    sound_speed_m_s: float | None = None
    mean_sound_speed_m_s: float | None = None
    basis: str | None = None
    coupling: str | None = None
    cfl: float | None = None
    refresh_travel: float | None = None
    precision: str = "f64"
    threads: int | None = None

    @property
    def label(self) -> str:
        """The setting in a few words; it names a point of a chart."""
        words = [f"{self.fidelity} h {self.spacing_mm:g}"]
        words += [f"c {self.sound_speed_m_s:g}"] if self.sound_speed_m_s else []
        words += [f"mean {self.mean_sound_speed_m_s:g}"] if self.mean_sound_speed_m_s else []
        words += [str(word) for word in (self.basis, self.coupling) if word]
        words += [f"cfl {self.cfl:g}"] if self.cfl else []
        words += [f"refresh {self.refresh_travel:g}"] if self.refresh_travel else []
        words += [self.precision] if self.precision != "f64" else []
        words += [f"{self.threads} thread" + "s" * (self.threads > 1)] if self.threads else []
        return " ".join(words)

    def applied(self, scene: Scene) -> Scene:
        """The scene under this setting."""
        own = {
            name: value
            for name, value in asdict(self).items()
            if value is not None and name not in ("precision", "threads")
        }
        return with_numerics(scene, **own)


@dataclass(frozen=True)
class Point:
    """A finished run.

    traces: time, apex displacement, pressure under the apex; whole_s, solver_s: least wall time of packing, set-up and
    solver, and of the solver alone, warm, over `repeats` runs, for what else the machine does only adds; nodes, steps:
    of the run; stopped: why it ended early, or "".
    """

    setting: Setting
    traces: dict[str, np.ndarray]
    whole_s: float
    solver_s: float
    repeats: int
    nodes: int
    steps: int
    stopped: str = ""

    def as_dict(self) -> dict:
        """For a JSON file; `from_dict` reads it back."""
        return {**asdict(self), "traces": {name: column.tolist() for name, column in self.traces.items()}}

    @classmethod
    def from_dict(cls, plain: dict) -> "Point":
        """A point that `as_dict` wrote."""
        return cls(
            **{
                **plain,
                "setting": Setting(**plain["setting"]),
                "traces": {name: np.array(column) for name, column in plain["traces"].items()},
            }
        )


def run_point(scene: Scene, setting: Setting, repeats: int | None = None) -> Point:
    """Run a scene under a setting until its times are settled: 9 runs of up to 0.3 s, 3 of up to 2 s, else one.

    A run of `WARM_UP_MS` goes before, which compiles what is not compiled yet. Raises SceneError where the scene cannot
    be discretised so.
    """
    backend.init(precision=setting.precision, threads=setting.threads)
    applied = setting.applied(scene)
    warm_up_ms = min(WARM_UP_MS, applied.numerics.duration_ms)
    run_scene(applied.but({"numerics.duration_ms": warm_up_ms, "camera.frame_count": AUTO}))
    times, wanted = [], 1
    while len(times) < wanted:
        # packing belongs to what a run costs
        packed.cache_clear()
        trial = run_scene(applied)
        whole = trial.set_up_s + trial.solver_s
        times.append((whole, trial.solver_s))
        wanted = repeats or (9 if whole < 0.3 else 3 if whole < 2.0 else 1)
        # the next run takes over its fields and kernels
        gc.collect()
    whole, solver = np.min(np.array(times), axis=0)
    return Point(
        setting,
        {name: trial.traces[name] for name in KEPT},
        float(whole),
        float(solver),
        len(times),
        trial.nodes,
        trial.steps,
        str(trial.stop or ""),
    )


def triple(spacing_mm: float, sound_speed_m_s: float) -> tuple[Setting, Setting, Setting]:
    """The three `mfpm` settings that `limit` takes: (h, c), (h sqrt 2, c), (h sqrt 2, c / 2), h below the first
    SPACINGS."""
    coarse = SPACINGS[SPACINGS.index(spacing_mm) - 1]
    return (
        Setting("mfpm", spacing_mm, sound_speed_m_s),
        Setting("mfpm", coarse, sound_speed_m_s),
        Setting("mfpm", coarse, sound_speed_m_s / 2.0),
    )


def limit(fine: Point, coarse: Point, soft: Point) -> dict[str, np.ndarray]:
    """The history for h -> 0 and c -> infinity from a finished `triple`: both errors are of second order."""
    spaced = extrapolate(fine.traces, coarse.traces, 2.0**0.5)
    stiff = extrapolate(coarse.traces, soft.traces, 2.0)
    return {
        name: column if name == "time_ms" else column + stiff[name] - coarse.traces[name]
        for name, column in spaced.items()
    }


def finest_limit(points: dict[str, Point], levels) -> tuple[dict[str, np.ndarray] | None, tuple | None, dict | None]:
    """The limit by the finest complete level (h, c), that level, and the limit by the next one, to judge it by.

    points: by label; levels: (spacing, sound speed), finest first. None where fewer are complete.
    """
    found = []
    for level in levels:
        three = [points.get(setting.label) for setting in triple(*level)]
        if all(point is not None and not point.stopped for point in three):
            found.append((limit(*three), level))
    reference, level = found[0] if found else (None, None)
    return reference, level, found[1][0] if len(found) > 1 else None
