"""Guards: a run that leaves its validity stops with what failed, where, when and what to change.

Checked at every sample, the first that applies is named. A wall that goes slack comes before what it causes: without
tension the membrane has no transverse waves and any mesh-size ripple grows. Only a wall that within one sample is more
compressed than it was stretched at rest, or whose energy grew without work in the same sample, was torn by an
instability: slackness grows from zero and the energy is balanced then.

A shell (cornea.flexural_modulus_mpa) carries compression until it folds. From the classical stress on at which a
complete sphere does, 2 sqrt(D E h) / (R h), with D its bending stiffness and E Young's modulus in its plane at rest,
every film frame's
state is put to the question whether it is stable against lobes around the axis (`taichi_eye.solver.folding`).

Energy. What is stored must not exceed the work of the puff, and not by much together with what the dissipation took: an
unstable flow that the dissipation holds at a bounded level stores little and would pass on its stored energy alone (no
slip on coarse nodes does that). Violent but sound ringing reaches 0.1 there. The viscous loss is judged apart: the
viscous stress on the cornea is not handed over, so under slip walls what the strain rates lose is never taken from the
motion, and a liquid so viscous that it matters is outside the model.
"""

import math

import numpy as np

from taichi_eye.errors import RunStopped
from taichi_eye.eye.tissue import biaxial_tangent, flexural_rigidity
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.solver.coupling import NOT_CONVERGED, RUNNING
from taichi_eye.units import MM, MMHG

FLAT = 0.05  # of its area at rest: a triangle this flat is about to turn over
CLOSED = 0.1  # of the height of the chamber at rest: the cornea is about to touch its back
CONDITION_GROWTH = 1e3  # over the limit that stencils are chosen by
ENERGY_SHARE = 0.1  # of the largest work done so far
CHURN_SHARE = 0.15  # of the same: fed by the scheme and taken by its dissipation
ENERGY_FLOOR = 1e-10  # J: below it no gain is judged (the default puff works 2e-5 J)
LIGHT = 0.3  # mass of the cornea over that of a layer of nodes below which the wall pressure outruns the wall


def least_stress(scene) -> float:
    """The principal stress [Pa] in the cornea's plane below which it is judged: 0, where a membrane is slack, less for
    a shell."""
    cornea = scene.cornea
    if not is_shell(scene):
        return 0.0
    thickness, nu = cornea.thickness_mm * MM, cornea.poisson_ratio
    rigidity = float(flexural_rigidity(cornea.flexural_modulus_mpa * 1e6, thickness, nu))
    young = (1.0 - nu) * biaxial_tangent(cornea.stiffness_a_pa, cornea.exponent_k, cornea.prestrain)
    return -2.0 * math.sqrt(rigidity * young / thickness) / (cornea.radius_mm * MM)


def check(
    figures: dict[str, float],
    energy_gain: float,
    largest_work: float,
    scene,
    radius_mm,
    time_ms: float,
    viscous_loss: float = 0.0,
    numerical_loss: float = 0.0,
    lobes: int | None = None,
) -> None:
    """Raise RunStopped where the figures of a survey show a run that is no longer valid.

    energy_gain [J]: stored - work of the puff; largest_work [J]: the largest |work| so far; radius_mm(node): reference
    radius of a node; viscous_loss, numerical_loss [J]: taken by viscosity and by the dissipation so far;
    lobes: into which a shell folds, None where it does not.
    """
    numerics = scene.numerics
    allowed = ENERGY_SHARE * largest_work + ENERGY_FLOOR

    def stop(what, advice, node):
        raise RunStopped(what, f"at r = {radius_mm(int(node)):.2f} mm", time_ms, advice)

    stress_at_rest = scene.eye.iop_mmhg * MMHG * scene.cornea.radius_mm / (2.0 * scene.cornea.thickness_mm)
    churned = CHURN_SHARE * largest_work + ENERGY_FLOOR
    grew = energy_gain > allowed or energy_gain + numerical_loss > churned
    found = figures["least_stress"]
    shell = is_shell(scene)
    failed = lobes is not None if shell else found <= 0.0
    torn = not shell and found < -stress_at_rest
    if failed and not (grew or torn):
        stop(*failing(found, lobes), figures["slackest_element"])
    if figures["chamber_gap"] < CLOSED:
        stop(
            "the cornea reached the back of the chamber",
            "Lower puff.peak_kpa, raise eye.iop_mmhg or chamber.depth_mm"
            + ("." if scene.chamber.sealed else ", or keep the fluid in: chamber.sealed = true."),
            figures["gap_node"],
        )
    if figures["flattest_triangle"] < FLAT:
        stop(
            "nodes are about to cross (the cloud is folded)",
            "Lower puff.peak_kpa or numerics.spacing_mm; raise numerics.dissipation if the wall shows ripples.",
            figures["flat_node"],
        )
    if not figures["worst_condition"] < CONDITION_GROWTH * CONDITION_LIMIT[numerics.basis]:
        stop(
            f"a stencil went singular (condition number {figures['worst_condition']:.1e})",
            'Change numerics.spacing_mm, or use numerics.basis = "quadratic".',
            figures["ill_node"],
        )
    unstable = _advice_unstable(scene)
    if figures["not_finite"] or energy_gain != energy_gain:
        stop("a value is not finite any more", unstable, max(figures["bad_node"], 0))
    unbalanced = energy_gain + viscous_loss > allowed
    # at the size of the spacing the dissipation takes more than viscosity: then the loss is an instability's
    smooth = viscous_loss > max(energy_gain, numerical_loss)
    if grew or failed or unbalanced and not smooth:
        gained = energy_gain + max(numerical_loss, 0.0)
        raise RunStopped(
            "energy grew without work",
            f"{gained * 1e6:.3g} uJ more than the puff put in, whose largest "
            f"work so far is {largest_work * 1e6:.3g} uJ",
            time_ms,
            unstable,
        )
    if unbalanced:
        raise RunStopped(
            "the energy that viscosity takes is not balanced",
            f"{viscous_loss * 1e6:.3g} uJ, largest work so far {largest_work * 1e6:.3g} uJ",
            time_ms,
            f"Lower aqueous.viscosity_mpa_s (now {scene.aqueous.viscosity_mpa_s:g}): the viscous stress on the "
            "cornea is left out of the model and matters here.",
        )
    if figures["coupling_status"] == NOT_CONVERGED:
        raise RunStopped(
            "the coupling iteration did not converge",
            f"in {numerics.coupling_iterations_max} sweeps",
            time_ms,
            "Lower numerics.cfl, raise numerics.coupling_iterations_max or numerics.coupling_tolerance, "
            'or use numerics.relaxation = "aitken".',
        )


def is_shell(scene) -> bool:
    """Whether the cornea resists bending, and so bears compression."""
    return scene.cornea.flexural_modulus_mpa > 0.0


def failing(stress: float, lobes: int | None) -> tuple[str, str]:
    """What a cornea under this principal stress [Pa], or a shell that folds, does, and what to change."""
    if lobes is None:
        return (
            f"the cornea went slack (smallest principal stress {stress / 1e3:.3g} kPa)",
            "A membrane carries no compression: lower puff.peak_kpa, raise eye.iop_mmhg or cornea.prestrain.",
        )
    return (
        f"the cornea folded into {lobes} lobes (smallest principal stress {stress / 1e3:.3g} kPa)",
        "Lower puff.peak_kpa, raise eye.iop_mmhg, cornea.prestrain or cornea.flexural_modulus_mpa.",
    )


class Calm:
    """Where `check` has nothing to look at, for many eyes at once: figures within bounds and their energy balanced.

    names: columns of the rows; condition_limit: that of their basis; least [eyes]: their `least_stress`.
    """

    def __init__(self, names, condition_limit: float, least: np.ndarray):
        self._low, self._high = np.full((2, len(least), len(names)), [[[-np.inf]], [[np.inf]]])
        self._viscous, self._numerical = names.index("viscous_loss"), names.index("numerical_loss")
        for bounds, name, value in (
            (self._low, "least_stress", np.nextafter(least, np.inf)),
            (self._low, "chamber_gap", CLOSED),
            (self._low, "flattest_triangle", FLAT),
            (self._high, "not_finite", 0.0),
            (self._high, "worst_condition", np.nextafter(CONDITION_GROWTH * condition_limit, 0.0)),
            (self._high, "coupling_status", RUNNING),
        ):
            bounds[:, names.index(name)] = value

    def where(self, rows, energy_gain, largest_work) -> np.ndarray:
        """A bool for each eye; rows: their figures, the viscous and the numerical loss among them.

        A figure that is NaN makes an eye look worse than it is, never better.
        """
        within = ((rows >= self._low) & (rows <= self._high)).all(1)
        within &= energy_gain + np.maximum(rows[:, self._viscous], 0.0) <= ENERGY_SHARE * largest_work + ENERGY_FLOOR
        within &= energy_gain + rows[:, self._numerical] <= CHURN_SHARE * largest_work + ENERGY_FLOOR
        return within


def _advice_unstable(scene) -> str:
    numerics, cornea = scene.numerics, scene.cornea
    advice = (
        f"Lower numerics.cfl (now {numerics.cfl:g}) or raise numerics.dissipation (now "
        f"{numerics.dissipation:g}; below 0.3 the scheme is unstable)."
    )
    mass_ratio = cornea.density_kg_m3 * cornea.thickness_mm / (scene.aqueous.density_kg_m3 * numerics.spacing_mm)
    if mass_ratio < LIGHT:
        advice += (
            f" The cornea is light against a layer of nodes (mass ratio {mass_ratio:.2g}): halve numerics.cfl or "
            "numerics.spacing_mm."
        )
    if numerics.wall_condition == "no_slip":
        advice += (
            ' numerics.wall_condition = "no_slip" feeds energy where the nodes are coarser than the Stokes layer: use '
            '"slip", or lower numerics.spacing_mm.'
        )
    return advice
