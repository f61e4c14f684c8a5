"""`numerics.fidelity = "auto"`: the cheapest rung and settings that keep a scene within its tolerance.

The estimates are computed for the scene at hand, cheapest first, and the climb ends at the first rung that they let
pass; where a pilot is already the run that was asked for, it is the run. All in percent of the quantities of
`taichi_eye.ladder.misfit`, each pair of pilots differing in one thing:

    space       cavity with 32 elements against 8: a fifteenth of their difference is the error of the 32, and goes as
                h^2. All rungs carry the membrane's error, which dominates. Once inertia counts, thin-layer runs with 16
                and 8 take their place.
    inertia     thin-layer flow (`taichi_eye.solver.potential`) in the chamber at rest against cavity, both with 8
                elements.
    IOP         of `membrane` in a sealed chamber: the pressure's rise over the puff's.
    map's age   of `added_mass`: at most AGE_SHARE of the inertia for each spacing that the wall of 8 elements travels
                between two maps (7 to 23 % on sixteen scenes). Where that would ask for more maps: thin layer with 8
                elements refreshed at 1 spacing against 0.5, taken AGED times, as it came out down to half of what it
                was (on shells).
    map's grid  of `added_mass`, and as much of `mfpm`: `MAP_SHARE` of the inertia at 0.4 mm, as h^2. On the scenes of
                `taichi-eye check choices`, maps made often, it is what the error by space leaves of the true error:
                nothing to 4 % of the inertia where that is small, 6 % under a 10 ms puff, 9 % under one with an aqueous
                humour three times as dense.
    viscosity   of every rung but `mfpm`: what the flow of the thin layer would lose to viscosity, over the puff's work.
    sound speed of `mfpm`: cavity that yields as the liquid does at c = 40 m/s against one that does not, which goes as
                c^-2 with the sound speed of the mean pressure, up to STIFFER times that of the waves; and of the waves
                `WAVE_SHARE` of the inertia at 20 m/s, as c^-2 (the modes of the cylinder of `taichi-eye verify` are
                1.1 % low there, so the added mass is 2 % high).

`MARGIN` is kept free for what is not estimated: on those scenes the true errors of what was chosen were at most 3 %
above the estimates. A rung whose pilot leaves its validity (a slack cornea, a cornea at the
back of the chamber) is refused with its reason; the last rung is never refused: it stops by itself. A thin layer of 8
elements that blows up only says that inertia counts.
"""

import math
import time
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from taichi_eye.eye.eye import eye_of
from taichi_eye.ladder.misfit import misfit
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.ladder.trial import run_to_stop
from taichi_eye.scene import Scene
from taichi_eye.scene.resolve import coarsest_spacing_mm, section_area_mm2
from taichi_eye.scene.schema import AUTO
from taichi_eye.solver.reduced import Cavity, Reduced, ThinLayer
from taichi_eye.units import MM, MM3, MMHG, MPA_S, MS

PILOT = 8  # elements of the coarsest pilots
OFFERED = 4 * PILOT  # of the coarsest uniform rung offered: it costs 10 ms, and fewer make a film of a polygon
AGED = 2.0  # times the age of the maps that pilots show
AGE_SHARE = 0.25  # of the inertia, that flow maps get wrong with each spacing of a pilot that they age
MARGIN = 0.1  # share of the tolerance that the estimates leave free
# seconds: of a flow map at 0.2 mm, of mfpm a node and step and its samples per ms, of a uniform rung at 0.4 mm per ms
MAP_S, NODE_STEP_S, SAMPLES_S, UNIFORM_S = 5e-3, 9e-8, 0.02, 1.5e-4
MAP_ORDER = 2.4  # a flow map's time goes as this power of 1 / spacing
MAP_SHARE = 0.08  # of the inertia that a flow map at COARSEST_MM gets wrong
RAREST, OFTENEST = 0.5, 0.02  # spacings of travel between two flow maps, as offered
COARSEST_MM, FINEST_MM = 0.4, 0.05  # spacings offered where nodes are packed, and the finest at all
PILOT_C = 40.0  # m/s
STIFFER, STIFFEST = (
    5.0,
    160.0,
)  # sound speed of the mean pressure over that of the waves, and in m/s: more costs time steps
WAVE_SHARE = 0.04
TWIN_WIDER = 1.5  # times the spacing that the eye must take where an error bar asks for a coarser twin
SPEEDS = (20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 160.0)  # m/s, of mfpm


@dataclass
class Choice:
    """What was chosen and why.

    scene: with fidelity, spacing, sound speed and refresh travel set; reason: one line; estimates: errors in percent by
    rung and source; refused: why a rung is no model of the scene; simulation: the run itself where a pilot was already
    it, else None; seconds: spent on pilots; expected_s: what the solver will take, on one core; doubts: where the
    tolerance is not kept.
    """

    scene: Scene
    reason: str = ""
    estimates: dict = field(default_factory=dict)
    refused: dict = field(default_factory=dict)
    simulation: Reduced | None = None
    seconds: float = 0.0
    expected_s: float = 0.0
    doubts: list[str] = field(default_factory=list)

    def as_dict(self) -> dict:
        """For the summary."""
        numerics = self.scene.numerics
        return {
            "fidelity": numerics.fidelity,
            "spacing_mm": numerics.spacing_mm,
            "reason": self.reason,
            "sound_speed_m_s": numerics.sound_speed_m_s if numerics.fidelity == "mfpm" else None,
            "estimates_percent": self.estimates,
            "refused": self.refused,
            "pilots_s": round(self.seconds, 4),
            "expected_s": float(f"{self.expected_s:.2g}"),
            "doubts": self.doubts,
        }


class _Refused(Exception):
    """A pilot left its validity, or was too coarse for its scene."""


def choose(scene: Scene) -> Choice:
    """The cheapest rung and settings for a resolved scene, whatever its own fidelity, spacing and sound speed."""
    started = time.perf_counter()
    choice = _Climb(scene).climb()
    choice.seconds = time.perf_counter() - started
    return choice


@dataclass(frozen=True)
class _Pilot:
    """Traces of a finished pilot, and the viscous share of a thin layer."""

    traces: dict
    viscous: float


class _Climb:
    """One scene's pilots and the way up."""

    def __init__(self, scene):
        self.scene, self.numerics = scene, scene.numerics
        self.allowed = (1.0 - MARGIN) * self.numerics.tolerance_percent
        self.length_mm = eye_of(scene).section.cornea_length / MM
        self.coarsest_mm = coarsest_spacing_mm(scene.values())
        if self.numerics.error_bar:
            # a coarser twin must have its place, too
            self.coarsest_mm /= TWIN_WIDER
        self.choice = Choice(scene)
        self.inertia: float | None = None  # in percent, once a thin layer has run
        self.rough: _Pilot | None = None  # the pilots of PILOT elements that got to their ends
        self.thin: _Pilot | None = None
        self.space, self.size = 1.0, 0.25  # space error in percent at a spacing in mm, until pilots tell
        self.slow = ""

    def climb(self) -> Choice:
        for rung in (self._uniform, self._added_mass):
            try:
                if rung():
                    return self.choice
            except _Refused:
                pass
        self._mfpm()
        return self.choice

    def _run(self, model, spacing_mm, changes=None) -> Reduced:
        """A finished run of a reduced model with other changes (see `Scene.but`); _Refused where it leaves its
        validity. The spacing may be coarser than a chamber with nodes would take: there are none."""
        named = "added_mass" if model is ThinLayer else model.__name__.lower()
        own = {"numerics.fidelity": named, "numerics.spacing_mm": spacing_mm, "numerics.refresh_travel": AUTO}
        simulation = model(self.scene.but({**own, **(changes or {})}, within_limits=False))
        # elements as long as a lobe is wide fold a sound shell at its apex
        simulation.judges_folding = spacing_mm < 1.001 * self.length_mm / OFFERED
        stop = run_to_stop(simulation)
        if stop:
            if simulation.out_of_validity:
                self.choice.refused[named] = str(stop)
            raise _Refused
        return simulation

    def _pilot(self, model, elements, changes=None) -> _Pilot:
        """What is kept of such a run: the next pilot takes over its fields and kernels."""
        simulation = self._run(model, self.length_mm / elements, changes)
        return _Pilot(simulation.traces, viscous_share(simulation) if model is ThinLayer else 0.0)

    def _apart(self, one, other) -> float:
        return misfit(one.traces, other.traces).of(self.numerics.tolerance_on)

    def _take(self, rung, spacing_mm, reason, expected_s, simulation=None, **numerics) -> bool:
        self.choice.expected_s = expected_s
        self.choice.scene = with_numerics(self.scene, fidelity=rung, spacing_mm=spacing_mm, **numerics)
        self.choice.reason, self.choice.simulation = f"{rung} at {spacing_mm:.3g} mm: {reason}", simulation
        return True

    def _finest(self, space, size_mm, left) -> float:
        """The spacing [mm] at which the space error, `space` at `size_mm`, is `left`."""
        return size_mm * math.sqrt(left / max(space, 1e-12)) if left > 0.0 else 0.0

    def _uniform(self) -> bool:
        """membrane and cavity: no flow."""
        tolerance, sealed = self.numerics.tolerance_percent, self.scene.chamber.sealed
        self.rough = rough = self._pilot(Cavity, PILOT)
        self.thin = thin = self._pilot(ThinLayer, PILOT)
        self.inertia, self.viscous = self._apart(rough, thin), thin.viscous
        if self.inertia + self.viscous > self.allowed:
            self.choice.estimates["cavity"] = {"inertia": self.inertia, "viscosity": self.viscous}
            return False
        size = min(self.length_mm / OFFERED, self.coarsest_mm)
        run = self._run(Cavity, size)
        full = _Pilot(run.traces, 0.0)
        space = self._apart(full, rough) / ((self.length_mm / PILOT / size) ** 2 - 1.0)
        errors = {"inertia": self.inertia, "viscosity": self.viscous, "space": space}
        pressure = full.traces["fluid_pressure_apex_kpa"]
        rise = 100.0 * float(np.abs(pressure - pressure[0]).max()) / max(float(run.puff.peak) * 1e-3, 1e-9)
        rung = "cavity" if sealed and rise + sum(errors.values()) > self.allowed else "membrane"
        if sealed:
            self.choice.estimates["membrane"] = {"IOP": rise}
        spacing = min(self._finest(space, size, self.allowed - self.inertia - self.viscous), size)
        self.choice.estimates[rung] = {**errors, "space": space * (spacing / size) ** 2}
        if spacing < FINEST_MM:
            return False
        ready = run if spacing == size and rung == "cavity" else None
        return self._take(
            rung,
            spacing,
            f"inertia {self.inertia:.2g} % and space "
            f"{self.choice.estimates[rung]['space']:.2g} % stay within {tolerance:g} %",
            UNIFORM_S * self.numerics.duration_ms * (0.4 / spacing) ** 1.5,
            ready,
        )

    def _added_mass(self) -> bool:
        tolerance = self.numerics.tolerance_percent
        # where eight elements blew up, they ring too coarsely to tell
        elements = PILOT if self.inertia is not None else 2 * PILOT
        coarse = self.thin or self._pilot(ThinLayer, elements)
        fine = self._pilot(ThinLayer, 2 * elements)
        if self.inertia is None:
            self.inertia = self._apart(self._pilot(Cavity, elements), coarse)
        size = self.length_mm / elements
        self.space, self.size = self._apart(fine, coarse) / 3.0, 0.5 * size
        self.viscous = fine.viscous
        left = self.allowed - self.viscous
        space, grid = self.space, MAP_SHARE * self.inertia * (self.size / COARSEST_MM) ** 2
        self.space += grid  # as mfpm has it
        age = AGE_SHARE * self.inertia  # per spacing of travel at `size`
        coarsest = min(self._finest(self.space, self.size, left), COARSEST_MM, self.coarsest_mm)
        if RAREST * age * coarsest / size > 0.25 * left:
            # as much as that is worth a closer look
            rarely = self._pilot(ThinLayer, elements, {"numerics.refresh_travel": 1.0})
            age = min(age, AGED * self._apart(coarse, rarely) / 0.5)
        spacing, travel = cheapest_maps(self.space / self.size**2, age / size, left, coarsest)
        refined = (spacing / self.size) ** 2
        self.choice.estimates["added_mass"] = errors = {
            "space": space * refined,
            "map's grid": grid * refined,
            "map's age": age * travel * spacing / size,
            "viscosity": self.viscous,
        }
        if left <= 0.0 or spacing < FINEST_MM or travel < OFTENEST:
            return False
        travelled = float(np.abs(np.diff(fine.traces["apex_displacement_mm"])).sum())
        maps_s = MAP_S * (0.2 / spacing) ** MAP_ORDER * travelled / (travel * spacing)
        if maps_s > self.numerics.duration_ms * SAMPLES_S:
            # mfpm takes no less than that
            other_s, *_, other, by_sound = self._mfpm_setting
            if maps_s > other_s and other + by_sound <= tolerance:
                self.slow = f"added_mass would take some {maps_s:.2g} s for its flow maps"
                return False
        source = max(errors, key=errors.get)
        return self._take(
            "added_mass",
            spacing,
            f"{self._why_not_cavity()}; {source} {errors[source]:.2g} % and the rest "
            f"{sum(errors.values()) - errors[source]:.2g} % stay within {tolerance:g} %",
            maps_s,
            refresh_travel=travel,
        )

    def _mfpm(self) -> None:
        tolerance = self.numerics.tolerance_percent
        expected_s, c, spacing, error, by_sound = self._mfpm_setting
        self.choice.estimates["mfpm"] = {"space": error, "sound speed": by_sound}
        self._take(
            "mfpm",
            spacing,
            f"{self._why_not_cavity()}; space {error:.2g} % and c = {c:g} m/s {by_sound:.2g} %",
            expected_s,
            sound_speed_m_s=c,
            mean_sound_speed_m_s=_mean_speed(c),
        )
        if error + by_sound > tolerance:
            self.choice.doubts.append(
                f"numerics.tolerance_percent = {tolerance:g} is not kept: space {error:.2g} % and sound speed "
                f"{by_sound:.2g} % are expected, and no setting that auto offers does better"
            )

    @cached_property
    def _mfpm_setting(self) -> tuple[float, float, float, float, float]:
        """The cheapest of SPEEDS with the spacing it leaves: time expected [s], c, spacing [mm], errors by space and
        sound."""
        try:
            volume = eye_of(self.scene).section.volume()
            give = volume / (self.scene.aqueous.density_kg_m3 * PILOT_C**2) / MM3 * MMHG
            give += self.scene.chamber.compliance_mm3_mmhg
            yielding = self._pilot(Cavity, PILOT, {"chamber.compliance_mm3_mmhg": give})
            soft = self._apart(yielding, self.rough or self._pilot(Cavity, PILOT))
        except _Refused:
            soft = 1.0  # what the default eye has
        offered = []
        for c in SPEEDS:
            by_sound = self._by_sound(soft, c)
            spacing = min(self._finest(self.space, self.size, self.allowed - by_sound), COARSEST_MM, self.coarsest_mm)
            if spacing >= FINEST_MM:
                offered.append(
                    (self._mfpm_s(c, spacing), c, spacing, self.space * (spacing / self.size) ** 2, by_sound)
                )
        c = SPEEDS[-1]
        error = self.space * (FINEST_MM / self.size) ** 2
        return min(offered, default=(self._mfpm_s(c, FINEST_MM), c, FINEST_MM, error, self._by_sound(soft, c)))

    def _mfpm_s(self, c, spacing) -> float:
        """Expected time [s] of an mfpm run: some 2 c / h steps a millisecond, 1.25 nodes to h^2 of the section."""
        nodes = 1.25 * section_area_mm2(self.scene.values()) / spacing**2
        return self.numerics.duration_ms * (SAMPLES_S + NODE_STEP_S * nodes * 2.0 * c / spacing)

    def _by_sound(self, soft, c) -> float:
        waves = WAVE_SHARE * (self.inertia or 0.0) * (20.0 / c) ** 2
        return waves + (soft * (PILOT_C / _mean_speed(c)) ** 2 if self.scene.chamber.sealed else 0.0)

    def _why_not_cavity(self) -> str:
        estimates, refused = self.choice.estimates, self.choice.refused
        said = []
        for rung in ("cavity", "added_mass"):
            if rung in refused:
                said.append(f"{rung} refused ({refused[rung]})")
            elif rung in estimates:
                source, worst = max(estimates[rung].items(), key=lambda item: item[1])
                if sum(estimates[rung].values()) > 1.001 * self.allowed:
                    said.append(f"{rung} would be {sum(estimates[rung].values()):.2g} % off by {source}")
        if self.slow:
            said.append(self.slow)
        return ", ".join(said) or "cavity leaves out inertia that counts"


def cheapest_maps(space: float, age: float, left: float, coarsest: float) -> tuple[float, float]:
    """Spacing h [mm] and travel t [spacings] of the flow maps that are made soonest while space h^2 + age t h <= left.

    space [%/mm^2], age [%/mm]; h is at most `coarsest`, t at most RAREST. A map takes h^-MAP_ORDER, and there are as
    many as 1 / (t h): with the errors at their limit, space takes MAP_ORDER / (MAP_ORDER + 2) of it, or what maps made
    at RAREST leave.
    """
    if left <= 0.0:
        return 0.0, 0.0
    spacing = math.sqrt(MAP_ORDER / (MAP_ORDER + 2.0) * left / max(space, 1e-12))
    if left - space * spacing**2 > RAREST * age * spacing:
        linear = 0.5 * RAREST * age
        spacing = left / (linear + math.sqrt(linear**2 + space * left))
    spacing = min(spacing, coarsest)
    return spacing, min(RAREST, (left - space * spacing**2) / max(age * spacing, 1e-12))


def _mean_speed(c: float) -> float:
    return max(c, min(STIFFER * c, STIFFEST))


def viscous_share(run: Reduced) -> float:
    """What the flow under a finished run's wall loses to viscosity, in percent of the puff's work.

    The liquid moves radially at U(r, t), one speed over the depth, as continuity asks. Under slip walls its strain
    rates lose 2 mu (U_r^2 + U^2/r^2 + (U_r + U/r)^2) per volume; at a no-slip wall a Stokes layer (nu t)^1/2 thick, t
    the time in which the flow changes, but no thicker than a sixth of the depth, loses mu U^2 over its thickness.
    """
    scene = run.scene
    viscosity, density = scene.aqueous.viscosity_mpa_s * MPA_S, scene.aqueous.density_kg_m3
    place, velocity = run.frames[:, :, :2], run.frames[:, :, 2:4]
    edge, middle = np.diff(place, axis=1), 0.5 * (place[:, 1:] + place[:, :-1])
    rise = 0.5 * (velocity[:, 1:] + velocity[:, :-1])
    swept = np.cumsum(
        2.0 * np.pi * middle[..., 0] * (rise[..., 1] * edge[..., 0] - rise[..., 0] * edge[..., 1]), axis=1
    )
    r = place[:, 1:, 0]
    depth = np.maximum(place[:, 1:, 1] - run.section.back_height(r), 0.02 * MM)
    # the rim, where depth and flow vanish together, is left out
    r, depth, speed = r[:, :-1], depth[:, :-1], (-swept / (2.0 * np.pi * r * depth))[:, :-1]
    slope = np.gradient(speed, axis=1) / np.maximum(np.gradient(r, axis=1), 1e-6)
    hoop = speed / r
    loss = 2.0 * viscosity * (slope**2 + hoop**2 + (slope + hoop) ** 2) * depth
    if scene.numerics.wall_condition == "no_slip" and viscosity > 0.0:
        frame = scene.camera.frame_interval_ms * MS
        change = np.gradient(speed, frame, axis=0)
        period = np.sqrt((speed**2).sum() / max((change**2).sum(), 1e-30))
        layer = np.minimum(np.sqrt(viscosity / density * period), depth / 6.0)
        loss = loss + 2.0 * viscosity * speed**2 / layer
    lost = (loss * 2.0 * np.pi * r * np.gradient(r, axis=1)).sum() * scene.camera.frame_interval_ms * MS
    work = float(np.abs(run.traces["puff_work_uj"]).max()) * 1e-6
    return 100.0 * float(lost) / work if work > 0.0 else 0.0
