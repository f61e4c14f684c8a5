"""Guards: a run that leaves its validity stops with what failed, where, when and what to change.

Checked at every sample, the first that applies is named. A wall that goes slack comes before what it causes: without
tension the membrane has no transverse waves and any mesh-size ripple grows. Only a wall that within one sample is more
compressed than it was stretched at rest, or whose energy grew without work in the same sample, was torn by an
instability: slackness grows from zero and the energy is balanced then.

A shell (cornea.flexural_modulus_mpa or cornea.shear_modulus_kpa) carries compression until it folds. From the classical
stress on at which a complete sphere does, 2 sqrt(D E h) / (R h) + kappa G, with D its bending stiffness, E Young's
modulus in its plane at rest and kappa G that of transverse shear, every film frame's state is put to the question
whether it is stable against lobes around the axis (`taichi_eye.solver.folding`). (A ripple of wave number k is borne by
D k^2 + E h / (R k)^2 + kappa G h per length, whose least value this is.)

Energy. What is stored must not exceed the work of the puff, and not by much together with what the dissipation took: an
unstable flow that the dissipation holds at a bounded level stores little and would pass on its stored energy alone (no
slip on coarse nodes does that). Violent but sound ringing reaches 0.1 there. The viscous loss is judged apart: the
viscous stress on the cornea is not handed over, so under slip walls what the strain rates lose is never taken from the
motion, and a liquid so viscous that it matters is outside the model.
"""

import math
from dataclasses import dataclass

import numpy as np

from taichi_eye import backend
from taichi_eye.errors import RunStopped
from taichi_eye.eye.eye import Eye
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.solver.case import Case
from taichi_eye.solver.figures import NOT_CONVERGED, QUANTITIES, RUNNING, STORED_COLUMNS, at

FLAT = 0.05  # of its area at rest: a triangle this flat is about to turn over
CLOSED = 0.1  # of the height of the chamber at rest: the cornea is about to touch its back
CONDITION_GROWTH = 1e3  # over the limit that stencils are chosen by
ENERGY_SHARE = 0.1  # of the largest work done so far
CHURN_SHARE = 0.15  # of the same: fed by the scheme and taken by its dissipation
ENERGY_FLOOR = 1e-10  # J: below it no gain is judged (the default puff works 2e-5 J), see `energy_floor`
OVERTURNED = 15.0  # 1 / cos^2 of a turn by 75 degrees, where there is shear: sections that stayed lie along the wall
LIGHT = 0.3  # mass of the cornea over that of a layer of nodes below which the wall pressure outruns the wall


@dataclass(frozen=True)
class Advice:
    """What a rung tells its user to change; unstable: where energy or a value runs away; back: at the chamber's
    back."""

    unstable: str
    back: str


def least_stress(eye: Eye) -> float:
    """The principal stress [Pa] in the cornea's plane below which it is judged: 0, where a membrane is slack, less for
    a shell."""
    cornea = eye.cornea
    if not cornea.is_shell:
        return 0.0
    rigidity = float(eye.rigidity(cornea.thickness))
    bent = 2.0 * math.sqrt(rigidity * eye.youngs_modulus / cornea.thickness) / eye.section.radius
    return -bent - eye.shear_stiffness


def energy_floor(case: Case) -> float:
    """Energy [J] below which no gain is judged: ENERGY_FLOOR, or in single precision what rounding makes of the energy
    of a wall under tension, whose strains are differences of places: eps R / spacing of its stress times its volume."""
    eye = case.eye
    radius = eye.section.radius
    tension = 2.0 * np.pi * radius**2 * eye.cornea.thickness * eye.rest_stress
    return max(ENERGY_FLOOR, backend.rounding() * radius / case.scheme.spacing * tension)


def check(
    figures: dict[str, float],
    *,
    gained: float,
    largest_work: float,
    case: Case,
    advice: Advice,
    radius_mm,
    time_ms: float,
    lobes: int | None = None,
) -> None:
    """Raise RunStopped where the figures of a state show a run that is no longer valid.

    gained [J]: stored - work of the puff; largest_work [J]: the largest |work| so far; advice: the rung's;
    radius_mm(node): reference radius of a node; lobes: into which a shell folds, None where it does not.
    """
    floor = energy_floor(case)
    allowed = ENERGY_SHARE * largest_work + floor
    viscous, numerical = figures["viscous_loss"], figures["numerical_loss"]

    def stop(what, remedy, node):
        raise RunStopped(what, f"at r = {radius_mm(int(node)):.2f} mm", time_ms, remedy)

    churned = CHURN_SHARE * largest_work + floor
    grew = gained > allowed or gained + numerical > churned
    found = figures["least_stress"]
    shell = case.eye.cornea.is_shell
    failed = lobes is not None if shell else found <= 0.0
    torn = not shell and found < -case.eye.rest_stress
    if failed and not (grew or torn):
        stop(*_failing(found, lobes), figures["slackest_element"])
    if figures["steepest_slant"] > OVERTURNED and not grew:
        stop(
            "the wall has turned by more than 75 degrees",
            "Transverse shear knows walls that turn less: lower puff.peak_kpa, raise eye.iop_mmhg or "
            "cornea.shear_modulus_kpa.",
            figures["slanted_element"],
        )
    if figures["chamber_gap"] < CLOSED:
        stop("the cornea reached the back of the chamber", advice.back, figures["gap_node"])
    if figures["flattest_triangle"] < FLAT:
        stop(
            "nodes are about to cross (the cloud is folded)",
            "Lower puff.peak_kpa or numerics.spacing_mm; raise numerics.dissipation if the wall shows ripples.",
            figures["flat_node"],
        )
    if not figures["worst_condition"] < CONDITION_GROWTH * CONDITION_LIMIT[case.scheme.basis]:
        stop(
            f"a stencil went singular (condition number {figures['worst_condition']:.1e})",
            'Change numerics.spacing_mm, or use numerics.basis = "quadratic".',
            figures["ill_node"],
        )
    if figures["not_finite"] or gained != gained:
        stop("a value is not finite any more", advice.unstable, max(figures["bad_node"], 0))
    unbalanced = gained + viscous > allowed
    # at the size of the spacing the dissipation takes more than viscosity: then the loss is an instability's
    smooth = viscous > max(gained, numerical)
    if grew or failed or unbalanced and not smooth:
        raise RunStopped(
            "energy grew without work",
            f"{(gained + max(numerical, 0.0)) * 1e6:.3g} uJ more than the puff put in, whose largest work so far is "
            f"{largest_work * 1e6:.3g} uJ",
            time_ms,
            advice.unstable,
        )
    if unbalanced:
        raise RunStopped(
            "the energy that viscosity takes is not balanced",
            f"{viscous * 1e6:.3g} uJ, largest work so far {largest_work * 1e6:.3g} uJ",
            time_ms,
            f"Lower aqueous.viscosity_mpa_s (now {case.scene.aqueous.viscosity_mpa_s:g}): the viscous stress on the "
            "cornea is left out of the model and matters here.",
        )
    if figures["coupling_status"] == NOT_CONVERGED:
        raise RunStopped(
            "the coupling iteration did not converge",
            f"in {case.scheme.coupling_iterations_max} sweeps",
            time_ms,
            "Lower numerics.cfl, raise numerics.coupling_iterations_max or numerics.coupling_tolerance, "
            'or use numerics.relaxation = "aitken".',
        )


def _failing(stress: float, lobes: int | None) -> tuple[str, str]:
    """What a cornea under this principal stress [Pa], or a shell that folds, does, and what to change."""
    if lobes is None:
        return (
            f"the cornea went slack (smallest principal stress {stress / 1e3:.3g} kPa)",
            "A membrane carries no compression: lower puff.peak_kpa, raise eye.iop_mmhg or cornea.prestrain.",
        )
    return (
        f"the cornea folded into {lobes} lobes (smallest principal stress {stress / 1e3:.3g} kPa)",
        "Lower puff.peak_kpa, raise eye.iop_mmhg, cornea.prestrain, cornea.flexural_modulus_mpa or "
        "cornea.shear_modulus_kpa.",
    )


class Guard:
    """Watches several eyes from sample to sample.

    cases: theirs; advice: of each, its rung's. largest_work: the largest |work of the puff| so far [J], of each row
    last looked at. `where_calm` says where nothing is to be looked at; what is not calm goes to `stop_of`.
    """

    def __init__(self, cases, advice):
        self.cases, self.advice = cases, advice
        self.least = np.array([least_stress(case.eye) for case in cases])
        self._shells = np.array([case.eye.cornea.is_shell for case in cases])
        self._floor = np.array([energy_floor(case) for case in cases])
        self.largest_work = np.zeros(len(cases))
        self._low, self._high = np.full((2, len(cases), len(QUANTITIES)), [[[-np.inf]], [[np.inf]]])
        condition = [CONDITION_GROWTH * CONDITION_LIMIT[case.scheme.basis] for case in cases]
        for bounds, name, value in (
            (self._low, "least_stress", np.where(self._shells, -np.inf, np.nextafter(self.least, np.inf))),
            (self._low, "chamber_gap", CLOSED),
            (self._low, "flattest_triangle", FLAT),
            (self._high, "not_finite", 0.0),
            (self._high, "steepest_slant", OVERTURNED),
            (self._high, "worst_condition", np.nextafter(np.array(condition), 0.0)),
            (self._high, "coupling_status", RUNNING),
        ):
            bounds[:, at.__dict__[name]] = value

    def where_calm(self, rows: np.ndarray, at_frame) -> np.ndarray:
        """A bool for each row of figures, [eyes, QUANTITIES]; of a single eye also [samples, QUANTITIES], in order.

        at_frame: of each row, or one for all: whether it is a film frame's, at which shells are asked whether they
        fold. A figure that is NaN makes an eye look worse than it is, never better.
        """
        work = np.abs(rows[:, at.puff_work])
        if len(self.cases) == 1:
            work = np.fmax(np.fmax.accumulate(work), self.largest_work[-1])
        else:
            work = np.fmax(self.largest_work, work)
        self.largest_work = work
        gained = gain(rows)
        within = ((rows >= self._low) & (rows <= self._high)).all(1)
        within &= gained + np.maximum(rows[:, at.viscous_loss], 0.0) <= ENERGY_SHARE * work + self._floor
        within &= gained + rows[:, at.numerical_loss] <= CHURN_SHARE * work + self._floor
        return within & ~(at_frame & self.may_fold(slice(None), rows))

    def may_fold(self, eye, rows: np.ndarray):
        """Whether an eye, or each, is a shell so compressed in its row that it is to be asked whether it folds."""
        return self._shells[eye] & ~(rows[..., at.least_stress] > self.least[eye])

    def stop_of(self, eye: int, number: int, row, *, radius_mm, time_ms: float, lobes: int | None) -> RunStopped | None:
        """The stop that row `number` of those last looked at asks for, an eye's figures; None where it asks for none.

        The stop comes without a traceback, which would hold on to fields.
        """
        try:
            check(
                dict(zip(QUANTITIES, row.tolist())),
                gained=float(gain(row[None])[0]),
                largest_work=float(self.largest_work[number]),
                case=self.cases[eye],
                advice=self.advice[eye],
                radius_mm=radius_mm,
                time_ms=time_ms,
                lobes=lobes,
            )
        except RunStopped as stop:
            return stop.with_traceback(None)
        return None

    def left_model(self, eye: int, row: np.ndarray, lobes: int | None) -> bool:
        """Whether a state is none that any rung is made for: a cornea that is slack, folded, turned over or at the
        chamber's back."""
        slack = not self._shells[eye] and row[at.least_stress] <= 0.0
        return lobes is not None or bool(slack or row[at.chamber_gap] < CLOSED or row[at.steepest_slant] > OVERTURNED)


def gain(rows: np.ndarray) -> np.ndarray:
    """Energy [J] that is stored beyond the work of the puff, of rows of figures."""
    return rows[:, STORED_COLUMNS].sum(1) - rows[:, at.puff_work]


def liquid_advice(case: Case) -> Advice:
    """What the resolved liquid's rung says."""
    scene, eye, scheme = case.scene, case.eye, case.scheme
    unstable = (
        f"Lower numerics.cfl (now {scheme.cfl:g}) or raise numerics.dissipation (now "
        f"{scheme.dissipation:g}; below 0.3 the scheme is unstable)."
    )
    mass_ratio = eye.cornea.density * eye.cornea.thickness / (eye.liquid.density * scheme.spacing)
    if mass_ratio < LIGHT:
        unstable += (
            f" The cornea is light against a layer of nodes (mass ratio {mass_ratio:.2g}): halve numerics.cfl or "
            "numerics.spacing_mm."
        )
    if scheme.no_slip:
        unstable += (
            ' numerics.wall_condition = "no_slip" feeds energy where the nodes are coarser than the Stokes layer: use '
            '"slip", or lower numerics.spacing_mm.'
        )
    back = "Lower puff.peak_kpa, raise eye.iop_mmhg or chamber.depth_mm" + (
        "." if scene.chamber.sealed else ", or keep the fluid in: chamber.sealed = true."
    )
    return Advice(unstable, back)
