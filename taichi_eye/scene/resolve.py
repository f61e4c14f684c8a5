"""The computed keys of a scene, and what must hold between several of its keys."""

from __future__ import annotations

import math
from pathlib import Path

from taichi_eye.errors import SceneError
from taichi_eye.scene.budget import refuse_costly
from taichi_eye.scene.calibration import (
    DEFAULT_A_PA,
    DEFAULT_K,
    rest_stress,
    solve_exponent,
    solve_prestrain,
    solve_stiffness,
)
from taichi_eye.scene.draft import Draft
from taichi_eye.scene.schema import AUTO, all_keys
from taichi_eye.scene.table import read_puff_file
from taichi_eye.units import MM, MMHG

CONSISTENT = 1e-6  # relative agreement asked of keys that determine each other
NODES_MAX = 200_000  # of the fluid: beyond it a run would take days
SPACINGS_DEEP = 4  # the chamber on the axis is at least so many spacings deep
REFRESH_TRAVEL = 0.05, 0.5  # mfpm, added_mass
LENS_CLEARANCE = 2  # spacings between lens and cornea at rest


def resolve(draft: Draft) -> None:
    """Fill in the computed keys of a draft and check its values against each other; SceneError lists every problem."""
    if not draft["cornea.limbus_radius_mm"] < draft["cornea.radius_mm"]:
        draft.refuse(
            "the limbus radius must be below the radius of the cornea", "cornea.limbus_radius_mm", "cornea.radius_mm"
        )
    draft.stop_if_refused()
    _exponent(draft)
    draft.stop_if_refused()
    _tissue(draft)
    _chamber(draft)
    _numerics(draft)
    _sound_speeds(draft)
    _puff(draft)
    _camera(draft)
    for name, _, spec in all_keys():
        if spec.computed and not spec.holds(draft[name]):
            draft.refuse(f"computed from the other keys, must be {spec.bounds()}", name)
    draft.stop_if_refused()
    refuse_costly(draft)
    draft.stop_if_refused()


def _exponent(draft: Draft) -> None:
    """k = s (1 + nu), whichever of the two was given."""
    k, s, nu = "cornea.exponent_k", "cornea.exponent_s", "cornea.poisson_ratio"
    if draft.given(s) and not draft.given(k):
        draft.values[k] = draft[s] * (1.0 + draft[nu])
        draft.origin[k] = draft.origin[s]
    elif draft.given(s) and abs(draft[s] * (1.0 + draft[nu]) - draft[k]) > CONSISTENT * draft[k]:
        draft.refuse(
            f"k = s (1 + nu) does not hold; give one of the two and leave the other out, or set it to "
            f'"auto" (--set {s if draft.origin[k] == "--set" else k}=auto)',
            k,
            s,
            nu,
        )


def _tissue(draft: Draft) -> None:
    """Solve the rest condition for the tissue constant left open, or check it where none is."""
    a, k, eps0 = names = "cornea.stiffness_a_pa", "cornea.exponent_k", "cornea.prestrain"
    if draft["cornea.limbus_thickness_mm"] == AUTO:
        draft.values["cornea.limbus_thickness_mm"] = draft["cornea.thickness_mm"]
    s0 = rest_stress(draft["eye.iop_mmhg"] * MMHG, draft["cornea.radius_mm"] * MM, draft["cornea.thickness_mm"] * MM)
    if all(draft.given(name) for name in names):
        exponent = 2.0 * draft[k] * draft[eps0] ** 2
        off = math.log(2.0 * draft[a] * draft[k] * draft[eps0] / s0) + exponent
        if abs(off) > CONSISTENT:
            draft.refuse(
                "the first three fix the stress of the wall at rest, 2 A k eps0 exp(2 k eps0^2), which must "
                f"be IOP R/(2h) = {s0:.6g} Pa and is {100 * math.expm1(min(off, 700.0)):+.3g} % off; leave "
                'one of the three out, or set it to "auto" (--set cornea.prestrain=auto)',
                *names,
                "eye.iop_mmhg",
                "cornea.radius_mm",
                "cornea.thickness_mm",
            )
    elif draft.given(eps0):
        if draft.given(a):
            draft.values[k] = solve_exponent(s0, draft[a], draft[eps0])
        else:
            draft.values[k] = draft[k] if draft.given(k) else DEFAULT_K
            draft.values[a] = solve_stiffness(s0, draft[k], draft[eps0])
    else:
        draft.values[a] = draft[a] if draft.given(a) else DEFAULT_A_PA
        draft.values[k] = draft[k] if draft.given(k) else DEFAULT_K
        draft.values[eps0] = solve_prestrain(s0, draft[a], draft[k])
    if not draft.given("cornea.exponent_s"):
        draft.values["cornea.exponent_s"] = draft[k] / (1.0 + draft["cornea.poisson_ratio"])


def _chamber(draft: Draft) -> None:
    """The depth of the chamber, the room for a lens cap, and a node spacing that suits both."""
    radius, limbus = draft["cornea.radius_mm"], draft["cornea.limbus_radius_mm"]
    centre = math.sqrt(radius**2 - limbus**2)  # of the corneal sphere, below the limbus plane
    cap = radius - centre
    if draft["chamber.depth_mm"] == AUTO:
        draft.values["chamber.depth_mm"] = cap
    depth = draft["chamber.depth_mm"]
    if depth < cap:
        draft.refuse(
            f"the chamber must reach the limbus plane: at least the cap depth {cap!r} mm, or "
            '"auto" (--set chamber.depth_mm=auto)',
            "chamber.depth_mm",
            "cornea.radius_mm",
            "cornea.limbus_radius_mm",
        )
        return
    spacing = draft["numerics.spacing_mm"]
    angle = math.asin(limbus / radius)
    area = 0.5 * radius**2 * (angle - math.sin(angle) * math.cos(angle)) + limbus * (depth - cap)
    room = depth
    if draft["chamber.lens_radius_mm"] or draft["chamber.lens_height_mm"]:
        lens = _lens(draft, centre, cap - depth)
        if lens is None:
            return
        area -= lens
        room -= draft["chamber.lens_height_mm"]
    if area > NODES_MAX * spacing**2:
        draft.refuse(
            f"some {area / spacing**2:.3g} nodes; at most {NODES_MAX} are allowed, "
            f"so at least {math.sqrt(area / NODES_MAX):.4g} mm",
            "numerics.spacing_mm",
        )
    elif SPACINGS_DEEP * spacing > room:
        draft.refuse(
            f"the chamber, {room:.4g} mm deep on the axis, must hold at least {SPACINGS_DEEP} spacings, "
            f"so at most {room / SPACINGS_DEEP:.4g} mm",
            "numerics.spacing_mm",
        )


def _sound_speeds(draft: Draft) -> None:
    """The mean pressure is as stiff as the waves, or stiffer."""
    mean, waves = "numerics.mean_sound_speed_m_s", "numerics.sound_speed_m_s"
    if draft[mean] == AUTO:
        draft.values[mean] = draft[waves]
    elif draft[mean] < draft[waves]:
        draft.refuse(
            f'the mean pressure is at least as stiff as the waves: at least {draft[waves]:g} m/s, or "auto" '
            f"(--set {mean}=auto)",
            mean,
            waves,
        )


def _lens(draft: Draft, centre: float, back: float) -> float | None:
    """Half the area of the lens cap's section [mm^2]; None where the cap cannot stand in the chamber.

    centre: depth of the centre of the corneal sphere below the limbus plane, back: height of the back plane [mm].
    """
    names = "chamber.lens_radius_mm", "chamber.lens_height_mm"
    radius, height = (draft[name] for name in names)
    if not 0 < height < radius:
        draft.refuse("a lens cap needs both, the height below the radius (both 0: no lens)", *names)
        return None
    base = math.sqrt(height * (2.0 * radius - height))
    if not base < draft["cornea.limbus_radius_mm"]:
        draft.refuse(
            f"the base of the lens cap, {base:.4g} mm in radius, must lie inside the limbus radius",
            *names,
            "cornea.limbus_radius_mm",
        )
        return None
    # the point of a circular arc that is farthest from a point of its axis is its pole or its rim
    farthest = max(abs(back + height + centre), math.hypot(base, back + centre))
    gap, spacing = draft["cornea.radius_mm"] - farthest, draft["numerics.spacing_mm"]
    if gap < LENS_CLEARANCE * spacing:
        draft.refuse(
            f"the lens cap comes within {gap:.4g} mm of the cornea at rest; at least {LENS_CLEARANCE} "
            f"spacings, {LENS_CLEARANCE * spacing:.4g} mm, must stay free",
            *names,
            "chamber.depth_mm",
            "numerics.spacing_mm",
        )
        return None
    angle = math.acos(1.0 - height / radius)
    return 0.5 * radius**2 * (angle - math.sin(angle) * math.cos(angle))


def _numerics(draft: Draft) -> None:
    """How often operators or flow maps are made anew, by what they are for."""
    if draft["numerics.refresh_travel"] == AUTO:
        draft.values["numerics.refresh_travel"] = REFRESH_TRAVEL[draft["numerics.fidelity"] == "added_mass"]


def _puff(draft: Draft) -> None:
    """The user's pressure file, where the time course asks for one."""
    course, file = "puff.time_course", "puff.file"
    if draft[course] != "file":
        if draft[file]:
            draft.refuse(
                'a puff file is read only where puff.time_course = "file"; set that, or leave the file out',
                file,
                course,
            )
    elif not draft[file]:
        draft.refuse("puff.file must name a CSV with the columns time_ms,pressure_kpa", course, file)
    else:
        try:
            read_puff_file(Path(draft[file]))
        except SceneError as error:
            draft.refuse(str(error), file)


def _camera(draft: Draft) -> None:
    """Frame times within the run, the apex within the image, and a size that the encoder takes."""
    count, interval, duration = "camera.frame_count", "camera.frame_interval_ms", "numerics.duration_ms"
    fits = int(draft[duration] / draft[interval] * (1.0 + 1e-12)) + 1
    if not draft.given(count):
        draft.values[count] = fits
    elif draft[count] > fits:
        draft.refuse(
            f"the last frame, at {(draft[count] - 1) * draft[interval]:.6g} ms, must lie within the run; "
            f"at most {fits} frames",
            count,
            interval,
            duration,
        )
    for size, place in (("camera.width_px", "camera.apex_column_px"), ("camera.height_px", "camera.apex_row_px")):
        if draft[size] % 2:
            draft.refuse("must be even, as the film's encoding asks", size)
        if not draft[place] < draft[size]:
            draft.refuse(f"the apex must lie in the image: at most {draft[size] - 1}", place, size)
