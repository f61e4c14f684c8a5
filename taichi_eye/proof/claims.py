"""The claims of Montanino, Angelillo and Pandolfi on the air-puff test, put to the model.

 (i) the apex lags the jet, (ii) its history is not symmetric in time, (iii) both come from the fluid, (iv) the fluid
 influences the motion markedly, (v) the intraocular pressure can be estimated from the motion.

Each is a comparison of runs that differ in one thing: the numerical sound speed c, the fluid's density (c goes as its
inverse root, so that the acoustic stiffness rho c^2 of the chamber stays), its viscosity and wall condition, the mass
of the cornea, a sealed or an open chamber, the load's time course, the IOP, and the tissue that an examiner does not
know. Delays have the load's own measure subtracted. A quasi-static cornea would follow a symmetric puff without delay
and without asymmetry, so with the Gaussian puff what is found is dynamics; with the measured puff, itself asymmetric,
the quasi-static answer is subtracted (`quasi_static`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from taichi_eye.eye.eye import eye_of
from taichi_eye.eye.tissue import biaxial_tangent
from taichi_eye.ladder.trial import Trial, run_scene
from taichi_eye.proof.measures import Measures, lag_of_best_match, measure
from taichi_eye.scene import load_scene

FRAME_MS = 0.2315  # between two frames of the Corvis ST: a shorter delay it does not see
C_BASE = 80.0  # m/s
SOUND_SPEEDS = 3.0, 5.0, 10.0, 20.0, 40.0, 160.0
DENSITY_FACTORS = 0.01, 0.1, 0.3, 3.0
OPEN_PEAKS_KPA = 2.0, 4.0, 6.0
IOPS_MMHG = 10.0, 12.5, 20.0, 25.0, 30.0
ENERGY_SHARE = 0.02  # of the work: a run whose energy balance is worse is shown, but nothing is concluded from it
UNKNOWN = 0.1  # share by which thickness or stiffness may be off


@dataclass(frozen=True)
class Case:
    """One run: its study, what varies there and to which value, the scene's overrides."""

    study: str
    label: str
    value: float
    overrides: tuple[str, ...] = ()
    refine: float = 1.0  # times finer than the other runs


@dataclass(frozen=True)
class Answer:
    """A case and what its run left."""

    case: Case
    run: Trial

    time_ms = property(lambda self: self.run.traces["time_ms"])
    apex_mm = property(lambda self: self.run.traces["apex_displacement_mm"])
    load_kpa = property(lambda self: self.run.traces["puff_apex_kpa"])

    @cached_property
    def measures(self) -> Measures | None:
        """Of the apex history; None where the run was stopped."""
        return None if self.run.stop else measure(self.time_ms, self.apex_mm)

    @cached_property
    def delays(self) -> dict[str, float]:
        """How far [ms] the apex is behind the load, by measure (`delays`); empty where the run was stopped."""
        return delays(self.time_ms, self.apex_mm, self.load_kpa) if self.measures else {}

    @property
    def stop(self) -> str:
        """The guard's words, or empty."""
        stop = self.run.stop
        return f"{stop.what} ({stop.where}) at {stop.time_ms:.2f} ms" if stop else ""

    @property
    def volume_change(self) -> float:
        """The most negative one, of the volume at rest."""
        return float(self.run.traces["chamber_volume_error"].min())

    @property
    def peak_mm(self) -> float:
        """The deepest point, up to the stop where there was one."""
        return self.measures.peak if self.measures else float(self.apex_mm.max())

    @property
    def sound(self) -> bool:
        """Whether the run went through and kept its energy balance."""
        return self.measures is not None and self.run.energy_share <= ENERGY_SHARE

    def row(self) -> dict:
        """The answer as one flat row for tables."""
        m = self.measures
        row = {"study": self.case.study, "case": self.case.label, "value": self.case.value, "peak_mm": self.peak_mm}
        names = ("peak_time_ms", "half_rise_ms", "half_fall_ms", "midpoint_ms", "centroid_ms")
        row |= {name: getattr(m, name) if m else None for name in names}
        row |= {f"delay_{name}_ms": self.delays.get(name) for name in ("midpoint", "centroid", "match", "peak")}
        row |= {
            name: getattr(m, name) if m else None
            for name in ("fall_to_rise", "skewness", "speed_in", "speed_out", "speed_ratio", "odd_share")
        }
        return row | {
            "volume_change": self.volume_change,
            "energy_error": self.run.energy_share,
            "overrides": " ".join(self.case.overrides),
            "stopped": self.stop,
        }


def cases() -> list[Case]:
    """All runs, the reference first."""
    listed = [Case("reference", "default eye", 1.0)]
    listed += [Case("sound speed", f"c = {c:g} m/s", c, (f"numerics.sound_speed_m_s={c}",)) for c in SOUND_SPEEDS]
    listed += [Case("fluid density", f"rho_f x {x:g}", x, _lighter_fluid(x)) for x in DENSITY_FACTORS]
    listed += [
        Case("viscosity", f"mu = {mu:g} mPa s", mu, (f"aqueous.viscosity_mpa_s={mu}",)) for mu in (0.0, 8.0, 80.0)
    ]
    # the thinner layer of the thinner fluid asks for finer nodes
    listed += [
        Case(
            "viscosity, no slip",
            f"mu = {mu:g} mPa s, no slip",
            mu,
            (f"aqueous.viscosity_mpa_s={mu}", "numerics.wall_condition=no_slip"),
            refine,
        )
        for mu, refine in ((0.8, 2.0), (80.0, 1.0))
    ]
    listed += [Case("cornea density", "rho_s x 0.1", 0.1, ("cornea.density_kg_m3=105",))]
    for peak in OPEN_PEAKS_KPA:
        load = f"puff.peak_kpa={peak}"
        listed += [
            Case("sealed", f"sealed, {peak:g} kPa", peak, (load,)),
            Case("open", f"open, {peak:g} kPa", peak, (load, "chamber.sealed=false")),
        ]
    listed += [
        Case("open", "open, 10 kPa", 10.0, ("chamber.sealed=false",)),
        Case(
            "open, light fluid",
            "open, 4 kPa, rho_f x 0.1",
            4.0,
            ("puff.peak_kpa=4", "chamber.sealed=false", *_lighter_fluid(0.1)),
        ),
    ]
    listed += [Case("measured puff", "Corvis ST time course", 1.0, ("puff.time_course=corvis",))]
    listed += [Case("IOP", f"IOP {iop:g} mmHg", iop, (f"eye.iop_mmhg={iop}",)) for iop in IOPS_MMHG]
    default = load_scene()
    for share in (-UNKNOWN, UNKNOWN):
        sign = f"{100 * share:+.0f} %"
        thick, k = default.cornea.thickness_mm * (1.0 + share), default.cornea.exponent_k * (1.0 + share)
        listed += [
            Case("thickness", f"thickness {sign}", share, (f"cornea.thickness_mm={thick!r}",)),
            Case("exponent", f"exponent k {sign}", share, (f"cornea.exponent_k={k!r}",)),
            Case(
                "stiffness",
                f"stiffness at rest {sign}",
                share,
                (f"cornea.exponent_k={_exponent_for_tangent(default, 1.0 + share)!r}",),
            ),
            Case("puff", f"puff {sign}", share, (f"puff.peak_kpa={default.puff.peak_kpa * (1.0 + share)!r}",)),
        ]
    return listed


def _lighter_fluid(factor: float) -> tuple[str, ...]:
    return f"aqueous.density_kg_m3={1000.0 * factor!r}", f"numerics.sound_speed_m_s={C_BASE / math.sqrt(factor)!r}"


def _exponent_for_tangent(scene, factor: float) -> float:
    """k that multiplies the biaxial tangent at rest by `factor`; A stays, eps0 follows from the rest condition."""
    eye = eye_of(scene)
    a, exponent, nu = eye.cornea.constants

    def tangent(k):
        other = eye.but(cornea=replace(eye.cornea, constants=(a, k, nu)))
        return biaxial_tangent(other.cornea.law, other.cornea.coefficients, other.apex_prestrain)

    wanted = factor * tangent(exponent)
    low, high = 0.1 * exponent, 10.0 * exponent
    for _ in range(60):  # the tangent grows with k
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tangent(middle) < wanted else (low, middle)
    return 0.5 * (low + high)


def run_case(case: Case, spacing_mm: float) -> Answer:
    """Simulate one case; a guard's stop is an answer."""
    scene = load_scene(
        None, (f"numerics.spacing_mm={spacing_mm / case.refine}", f"numerics.sound_speed_m_s={C_BASE}", *case.overrides)
    )
    return Answer(case, run_scene(scene))


def delays(time_ms, apex, load) -> dict[str, float]:
    """How far [ms] the apex is behind the load: midpoint of the 50 % times, centroid, best match, fitted peak."""
    here, push = measure(time_ms, apex), measure(time_ms, load)
    return {
        "midpoint": here.midpoint_ms - push.midpoint_ms,
        "centroid": here.centroid_ms - push.centroid_ms,
        "match": lag_of_best_match(time_ms, apex, load),
        "peak": here.peak_time_ms - push.peak_time_ms,
    }


def quasi_static(reference: Answer, load_kpa: np.ndarray) -> np.ndarray:
    """The apex [mm] that a cornea without inertia would show under `load_kpa`, up to the reference's peak load.

    From the reference run under a symmetric puff: at each load the mean of the rising and the falling branch, in which
    a delay cancels to first order.
    """
    apex, load = reference.apex_mm, reference.load_kpa
    top = int(np.argmax(load))
    levels = np.linspace(load[top:].min(), load[top], 400)
    rise = np.interp(levels, load[: top + 1], apex[: top + 1])
    fall = np.interp(levels, load[top:][::-1], apex[top:][::-1])
    return np.interp(load_kpa, levels, 0.5 * (rise + fall), left=0.0)


class Results:
    """The answers by study, and what follows from them."""

    def __init__(self, answers: Sequence[Answer]):
        self.answers = list(answers)
        self.base = self.of("reference")[0]

    def of(self, study: str) -> list[Answer]:
        """The answers of one study, by rising value."""
        return sorted((o for o in self.answers if o.case.study == study), key=lambda o: o.case.value)

    def with_base(self, study: str, value: float) -> list[Answer]:
        """A study with the reference put in at its own value; runs that are not sound left out."""
        pairs = [(o.case.value, o) for o in self.of(study) if o.sound] + [(value, self.base)]
        return [o for _, o in sorted(pairs, key=lambda pair: pair[0])]

    def pressure_curve(self) -> tuple[np.ndarray, np.ndarray]:
        """IOP [mmHg] and peak of the apex [mm] of the reference tissue."""
        iop = load_scene().eye.iop_mmhg
        pairs = sorted([(o.case.value, o.peak_mm) for o in self.of("IOP") if o.sound] + [(iop, self.base.peak_mm)])
        return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])

    def pressure_seen(self, answer: Answer, feature: str = "peak") -> float:
        """The IOP [mmHg] that an examiner who believes in the reference tissue reads off a feature of a history.

        The feature must fall as the IOP rises.
        """
        iop = load_scene().eye.iop_mmhg
        pairs = sorted(
            [(o.case.value, getattr(o.measures, feature)) for o in self.of("IOP") if o.sound]
            + [(iop, getattr(self.base.measures, feature))]
        )
        pressures, values = np.array(pairs).T
        curve = PchipInterpolator(np.log(values[::-1]), np.log(pressures[::-1]))
        return float(np.exp(curve(np.log(getattr(answer.measures, feature)))))

    def elasticities(self) -> dict[str, dict[str, float]]:
        """d ln(feature) / d ln(parameter) at the reference, by parameter and feature; central differences."""
        iop = load_scene().eye.iop_mmhg
        spans = {"IOP": self._neighbours("IOP", iop), **{name: self._neighbours(name, 0.0) for name in UNKNOWNS}}
        table: dict[str, dict[str, float]] = {}
        for name, (low, high) in spans.items():
            shift = lambda o: o.case.value / iop if name == "IOP" else 1.0 + o.case.value
            table[name] = {
                feature: math.log(value(high) / value(low)) / math.log(shift(high) / shift(low))
                for feature, value in FEATURES.items()
            }
        return table

    def _neighbours(self, study: str, value: float) -> tuple[Answer, Answer]:
        found = self.of(study)
        return ([o for o in found if o.case.value < value][-1], [o for o in found if o.case.value > value][0])


UNKNOWNS = "exponent", "stiffness", "thickness", "puff"  # studies of what an examiner may not know
FEATURES: dict[str, Callable[[Answer], float]] = {
    "peak": lambda o: o.measures.peak,
    "half rise before the puff's centre": lambda o: (
        measure(o.time_ms, o.load_kpa).midpoint_ms - o.measures.half_rise_ms
    ),
    "half fall after the puff's centre": lambda o: o.measures.half_fall_ms - measure(o.time_ms, o.load_kpa).midpoint_ms,
    "inward speed": lambda o: o.measures.speed_in,
    "outward speed": lambda o: o.measures.speed_out,
}


def likeness(one: dict[str, float], other: dict[str, float]) -> float:
    """Cosine between two sensitivities: at +-1 no history of the apex tells the two parameters apart."""
    a, b = np.array(list(one.values())), np.array(list(other.values()))
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float(a @ b / size) if size > 0.0 else 0.0
