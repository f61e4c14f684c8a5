"""An eye under the hand: a scene whose sliders are moved, run on the cavity rung, and its film.

All of what a tab shows is in its request: which scene, where each slider stands, which time is looked at. The server
keeps none of it, so tabs cannot mix. While a slider is dragged the eye is run with DRAGGED elements up to the time that
is looked at, and that frame is drawn; once it is let go, with FILMED elements to its end, and all frames are. With 16
elements the apex of the healthy eye is 0.4 % too deep, with 20 it is 0.2 %; the cavity rung itself is some 0.5 % off.
Whether a shell folds such elements, as long as a lobe is wide, cannot tell: that is asked of JUDGED elements, after the
film has been shown.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_eye import backend
from taichi_eye.errors import RunStopped, SceneError
from taichi_eye.eye.eye import eye_of
from taichi_eye.film import FilmView, FrameState
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.draft import written
from taichi_eye.scene.schema import AUTO, keys_of
from taichi_eye.solver.reduced import Cavity
from taichi_eye.units import MM, MS

DRAGGED, FILMED, JUDGED = 16, 20, 32  # elements of the cornea
FRAMES_A_PIECE = 12  # that are drawn before another tab has its turn
NOTHING = np.empty(0)
CAMERA = {"camera.view": "scheimpflug"}
PIXELS_MAX = 500_000  # of a frame that can be drawn under the hand
FILM_PIXELS_MAX = 100_000_000  # of a whole film, which a tab keeps, a byte each
DEFAULT = "default eye"
CHANGED = " with --set"  # after the name of a scene that the command line changed


def _given(name: str) -> Callable[[Scene], float]:
    return lambda scene: float(scene.values()[name])


Own = Mapping[str, Any]  # values of a scene by "section.key", sliders before this one moved already


def _thicker(scene: Scene, own: Own, value: float) -> dict[str, Any]:
    """The rim grows along with the centre, where it has a thickness of its own."""
    changes = {"cornea.thickness_mm": value}
    if "cornea.limbus_thickness_mm" in scene.given:
        rim = scene.cornea.limbus_thickness_mm + value - scene.cornea.thickness_mm
        changes["cornea.limbus_thickness_mm"] = max(rim, 0.01)
    return changes


TISSUE = "cornea.stiffness_a_pa", "cornea.flexural_modulus_mpa", "cornea.shear_modulus_kpa"


def _stiffer(scene: Scene, own: Own, value: float) -> dict[str, Any]:
    """All moduli of the tissue, in its plane and out of it, times a number."""
    return {name: own[name] * value for name in TISSUE if own[name]}


def _width(scene: Scene) -> float:
    """Where the load is down to 1/e on a flat wall [mm]; of the paper's profile, near the axis."""
    if scene.puff.radial_profile == "gaussian":
        return scene.puff.width_mm
    return scene.cornea.radius_mm / math.sqrt(scene.puff.spread_a) if scene.puff.spread_a > 0.0 else math.inf


def _wider(scene: Scene, own: Own, value: float) -> dict[str, Any]:
    if scene.puff.radial_profile == "gaussian":
        return {"puff.width_mm": value}
    # the paper's profile is one over the angle; what is no width is left to the limits of its key
    return {"puff.spread_a": (own["cornea.radius_mm"] / value) ** 2 if value > 0.0 else -1.0}


@dataclass(frozen=True)
class Slider:
    """Something that the hand moves: the value of a scene, and the keys that another value changes.

    key: of the scene's table, whose limits hold; low, high, step: of the slider, within them.
    """

    name: str
    label: str
    unit: str
    key: str
    low: float
    high: float
    step: float
    of: Callable[[Scene], float]
    changes: Callable[[Scene, Own, float], dict[str, Any]]

    @property
    def told(self) -> dict[str, Any]:
        """For the page."""
        section, name = self.key.split(".")
        return {k: getattr(self, k) for k in ("name", "label", "unit", "low", "high", "step")} | {
            "doc": keys_of(section)[name][1].doc
        }


def _plain(name: str, label: str, key: str, low: float, high: float, step: float) -> Slider:
    section, of = key.split(".")
    unit = keys_of(section)[of][1].unit
    return Slider(name, label, unit, key, low, high, step, _given(key), lambda _, __, value: {key: value})


SLIDERS = {
    slider.name: slider
    for slider in (
        _plain("iop", "pressure (IOP)", "eye.iop_mmhg", 5.0, 50.0, 0.5),
        Slider(
            "thickness", "thickness", "mm", "cornea.thickness_mm", 0.3, 0.8, 0.005, _given("cornea.thickness_mm"),
            _thicker,
        ),
        _plain("radius", "radius of the cornea", "cornea.radius_mm", 6.3, 9.5, 0.05),
        Slider("stiffness", "stiffness", "times", TISSUE[0], 0.3, 3.0, 0.02, lambda _: 1.0, _stiffer),
        _plain("puff", "puff, peak", "puff.peak_kpa", 0.0, 25.0, 0.1),
        Slider("width", "puff, width", "mm", "puff.width_mm", 0.6, 4.0, 0.02, _width, _wider),
        _plain("globe", "globe, compliance", "chamber.compliance_mm3_mmhg", 0.0, 3.0, 0.01),
    )
}  # fmt: skip


def of_scene(scene: Scene) -> list[str]:
    """The sliders that do something to a scene: a puff from a file brings its own pressure."""
    return [name for name in SLIDERS if name != "puff" or scene.puff.time_course != "file"]


class Refused(Exception):
    """A request that is no request; the message says what is wrong with it."""


@dataclass(frozen=True)
class Eye:
    """One eye of a request: its scene, sliders moved; words: of the command line that name the scene without them;
    changes: what the sliders changed."""

    scene: Scene
    words: tuple[str, ...]
    changes: Mapping[str, Any]

    @property
    def command(self) -> str:
        """The command line that runs this eye with the model of its scene."""
        words = [word for key, value in self.changes.items() for word in ("--set", f"{key}={written(value)}")]
        return shlex.join(["taichi-eye", "run", *self.words, *words])


class Eyes:
    """The scenes that a page offers, by name: each resolved, with the words that name it on a command line."""

    def __init__(self, scenes: Mapping[str, tuple[Scene, tuple[str, ...]]]):
        self.scenes = dict(scenes)

    def eye(self, asked: Any) -> Eye:
        """The eye that {"scene": name, "values": {slider: value}} asks for; Refused where there is none."""
        if not isinstance(asked, dict) or not isinstance(asked.get("values", {}), dict):
            raise Refused("an eye is a scene and values")
        name = asked.get("scene")
        if not isinstance(name, str) or name not in self.scenes:
            raise Refused(f"scene {_short(name)}: there are {', '.join(self.scenes)}")
        scene, words = self.scenes[name]
        allowed, own, changes = of_scene(scene), scene.values(), {}
        # the radius first: the width of the paper's profile is an angle on it
        for slider, value in sorted(asked.get("values", {}).items(), key=lambda entry: entry[0] != "radius"):
            if slider not in allowed:
                raise Refused(f"{_short(slider)}: the sliders of this eye are {', '.join(allowed)}")
            changes |= SLIDERS[slider].changes(scene, own | changes, _number(slider, value))
        if changes.get("cornea.radius_mm", own["cornea.radius_mm"]) != own["cornea.radius_mm"]:
            if scene.puff.radial_profile != "gaussian" and "width" not in asked.get("values", {}):
                # an angle on another radius is another width; the one that its slider shows is kept
                changes |= _wider(scene, own | changes, _width(scene))
        changes = {key: value for key, value in changes.items() if value != own[key]}
        try:
            return Eye(scene.but(changes), words, changes)
        except SceneError as refused:
            raise Refused(str(refused)) from None


def _number(slider: str, value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e12:
        return float(value)
    raise Refused(f"{slider} = {_short(value)}: must be a number")


def _short(value: Any) -> str:
    return json.dumps(value)[:60] if isinstance(value, str | int | float | bool | None) else "a table"


@dataclass(frozen=True)
class Shown:
    """A run under the hand: times [ms] of the frames, the wall there [m], [frames, nodes, 2], the retreat of the whole
    eye [mm], apex deflection [mm] and puff [kPa] at them; stop: why it ended early, or empty."""

    scene: Scene
    time_ms: np.ndarray
    wall: np.ndarray
    retreat_mm: np.ndarray
    apex_mm: np.ndarray
    puff_kpa: np.ndarray
    stop: str = ""

    def told(self) -> dict[str, Any]:
        """For the page."""
        return {
            "time_ms": _rounded(self.time_ms),
            "deflection_mm": _rounded(self.apex_mm),
            "deformation_mm": _rounded(self.apex_mm + self.retreat_mm),
            "puff_kpa": _rounded(self.puff_kpa),
            "stop": self.stop,
        }


def _rounded(values: np.ndarray) -> list[float]:
    return np.round(values, 5).tolist()


class Hand:
    """Runs and draws eyes; every method in the one thread of the kernel language (`taichi_eye.page.thread`)."""

    def __init__(self):
        self._views: dict[tuple, FilmView] = {}

    def run(self, scene: Scene, elements: int, until_ms: float | None = None) -> Shown:
        """Run a scene on the cavity rung, to its end or up to the last frame at or before a time."""
        camera, length = scene.camera, eye_of(scene).section.cornea_length / MM
        changes = {"numerics.fidelity": "cavity", "numerics.spacing_mm": length / elements, **CAMERA}
        changes |= {"numerics.refresh_travel": AUTO, "camera.frame_count": AUTO}  # frames up to the end
        if until_ms is not None and until_ms < scene.numerics.duration_ms:
            frames = max(math.floor(until_ms / camera.frame_interval_ms + 1e-9), 1)
            changes["numerics.duration_ms"] = frames * camera.frame_interval_ms
        simulation = Cavity(scene.but(changes, within_limits=False))
        simulation.judges_folding = elements >= JUDGED
        stop = ""
        try:
            simulation.run()
        except RunStopped as reason:
            stop = str(reason)
        time_ms, wall_mm = simulation.wall_mm
        traces = simulation.traces
        rows = np.minimum(np.arange(len(time_ms)) * simulation.clock.samples_per_frame, len(traces["time_ms"]) - 1)
        retreat = np.asarray(simulation.eye.retreat(time_ms * MS)) / MM
        apex, puff = (traces[name][rows] for name in ("apex_displacement_mm", "puff_apex_kpa"))
        return Shown(simulation.scene, time_ms, wall_mm * MM, retreat, apex, puff, stop)

    def frames(self, shown: Shown, numbers: range) -> np.ndarray:
        """Slit frames, uint8 [frames, rows, columns]."""
        view = self._view(shown.scene)
        return np.stack([view.scheimpflug_frame(_state(shown, number)) for number in numbers])

    def _view(self, scene: Scene) -> FilmView:
        kind = backend.generation(), FilmView.capacities(scene)
        if kind not in self._views:
            self._views[kind] = FilmView(scene)
        view = self._views[kind]
        if view.scene is not scene:
            view.setup(scene)
        return view


def _state(shown: Shown, number: int) -> FrameState:
    return FrameState(
        time_ms=float(shown.time_ms[number]),
        wall=shown.wall[number],
        wall_count=shown.wall.shape[1],
        nodes=None,
        node_count=0,
        pressure=None,
        velocity=None,
        trace_time_ms=NOTHING,
        trace_apex_mm=NOTHING,
        trace_puff_kpa=NOTHING,
        retreat_mm=float(shown.retreat_mm[number]),
    )


def frame_of(hand: Hand, eye: Eye, time_ms: float) -> tuple[dict[str, Any], np.ndarray]:
    """The frame at or before a time, and the history up to there."""
    shown = hand.run(eye.scene, DRAGGED, time_ms)
    last = len(shown.time_ms) - 1
    number = min(math.floor(time_ms / eye.scene.camera.frame_interval_ms + 1e-9), last)
    return shown.told() | {"frame": number}, hand.frames(shown, range(number, number + 1))


def film_of(hand: Hand, eye: Eye) -> Iterator[Shown | tuple[int, np.ndarray]]:
    """The run, and then its frames in pieces, each with the number of its first."""
    shown = hand.run(eye.scene, FILMED)
    yield shown
    for first in range(0, len(shown.time_ms), FRAMES_A_PIECE):
        yield first, hand.frames(shown, range(first, min(first + FRAMES_A_PIECE, len(shown.time_ms))))


def fold_of(hand: Hand, eye: Eye, shown: Shown) -> str:
    """Why a finer run ends before the one that was shown does: its shell folds. Empty where it does not."""
    if not eye_of(eye.scene).cornea.is_shell:
        return ""
    finer = hand.run(eye.scene, JUDGED)
    return finer.stop if len(finer.time_ms) < len(shown.time_ms) else ""


def parameters_of(shown: Shown) -> dict[str, float | None]:
    """The clinic's parameters of a run, as `taichi_eye.analysis.simulated` reads them."""
    from taichi_eye.analysis.curves import curves_from_wall
    from taichi_eye.analysis.simulated import FRAMES_LEAST, Observed

    if len(shown.time_ms) < FRAMES_LEAST:
        return {}
    r, z = np.moveaxis(shown.wall / MM, 2, 0)
    curves = curves_from_wall(shown.time_ms, r, z - shown.retreat_mm[:, None], shown.scene.cornea.thickness_mm)
    return vars(Observed(shown.scene, eye_of(shown.scene), curves, shown.stop).read().response)


def load(given: str | None, overrides: Sequence[str], presets: Sequence[str]) -> Eyes:
    """The scene that is asked for, first, and the presets; SceneError where it cannot be drawn under the hand."""
    scene = load_scene(given, overrides)
    pixels = scene.camera.width_px * scene.camera.height_px
    if pixels > PIXELS_MAX:
        raise SceneError(
            f"{given or 'scene'}: camera.width_px = {scene.camera.width_px}, camera.height_px = "
            f"{scene.camera.height_px}: at most {PIXELS_MAX} pixels can be drawn under the hand"
        )
    frames = scene.but({"camera.frame_count": AUTO}).camera.frame_count
    if pixels * frames > FILM_PIXELS_MAX:
        raise SceneError(
            f"{given or 'scene'}: numerics.duration_ms = {scene.numerics.duration_ms:g}, camera.frame_interval_ms = "
            f"{scene.camera.frame_interval_ms:g}: {frames} frames of {pixels} pixels; at most "
            f"{FILM_PIXELS_MAX // 10**6} million pixels in all can be drawn under the hand"
        )
    words = tuple(word for override in overrides for word in ("--set", override))
    # a preset stays under its own name
    first = (given or DEFAULT) + (CHANGED if overrides else "")
    scenes = {first: (scene, ((given,) if given else ()) + words)}
    for name in presets:
        scenes.setdefault(name, (load_scene(name), (name,)))
    return Eyes(scenes)
