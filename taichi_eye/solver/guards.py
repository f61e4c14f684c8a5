"""Guards: a run that leaves its validity stops with what failed, where, when and what to change.

Checked at every sample, the first that applies is named. A wall that goes slack comes before what it causes: without
tension the membrane has no transverse waves and any mesh-size ripple grows.
"""
from taichi_eye.errors import RunStopped
from taichi_eye.mfpm.operators import CONDITION_LIMIT
from taichi_eye.solver.coupling import NOT_CONVERGED

FLAT = 0.05  # of its area at rest: a triangle this flat is about to turn over
CLOSED = 0.1  # of the height of the chamber at rest: the cornea is about to touch its back
CONDITION_GROWTH = 1e3  # over the limit that stencils are chosen by
ENERGY_SHARE = 0.1  # of the largest work done so far
ENERGY_FLOOR = 1e-10  # J: below it no gain is judged (the default puff works 2e-5 J)


def check(figures: dict[str, float], energy_gain: float, largest_work: float, scene, radius_mm,
          time_ms: float) -> None:
    """Raise RunStopped where the figures of a survey show a run that is no longer valid.

    energy_gain [J]: stored + dissipated by viscosity - work of the puff; largest_work [J]: the largest |work| so far; radius_mm(node): reference radius of a node.
    """
    numerics = scene.numerics

    def stop(what, node, advice):
        raise RunStopped(what, f"at r = {radius_mm(int(node)):.2f} mm", time_ms, advice)

    if figures["least_stress"] <= 0.0:
        stop(f"the cornea went slack (smallest principal stress {figures['least_stress'] / 1e3:.3g} kPa)",
             figures["slackest_element"],
             "A membrane carries no compression: lower puff.peak_kpa, raise eye.iop_mmhg or cornea.prestrain.")
    if figures["chamber_gap"] < CLOSED:
        stop("the cornea reached the back of the chamber", figures["gap_node"],
             "Lower puff.peak_kpa, raise eye.iop_mmhg or chamber.depth_mm"
             + ("." if scene.chamber.sealed else ", or keep the fluid in: chamber.sealed = true."))
    if figures["flattest_triangle"] < FLAT:
        stop("nodes are about to cross (the cloud is folded)", figures["flat_node"],
             "Lower puff.peak_kpa or numerics.spacing_mm; raise numerics.dissipation if the wall shows ripples.")
    if not figures["worst_condition"] < CONDITION_GROWTH * CONDITION_LIMIT[numerics.basis]:
        stop(f"a stencil went singular (condition number {figures['worst_condition']:.1e})", figures["ill_node"],
             "Change numerics.spacing_mm, or use numerics.basis = \"quadratic\".")
    unstable = (f"Lower numerics.cfl (now {numerics.cfl:g}) or raise numerics.dissipation (now "
                f"{numerics.dissipation:g}; below 0.3 the scheme is unstable).")
    if figures["not_finite"] or energy_gain != energy_gain:
        stop("a value is not finite any more", max(figures["bad_node"], 0), unstable)
    if energy_gain > ENERGY_SHARE * largest_work + ENERGY_FLOOR:
        raise RunStopped("energy grew without work", f"{energy_gain * 1e6:.3g} uJ more than the puff put in, whose largest "
                         f"work so far is {largest_work * 1e6:.3g} uJ", time_ms, unstable)
    if figures["coupling_status"] == NOT_CONVERGED:
        raise RunStopped("the coupling iteration did not converge",
                         f"in {numerics.coupling_iterations_max} sweeps", time_ms,
                         "Lower numerics.cfl, raise numerics.coupling_iterations_max or numerics.coupling_tolerance, "
                         "or use numerics.relaxation = \"aitken\".")
