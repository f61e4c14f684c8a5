"""The computed keys of a scene, and what must hold between several of its keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from taichi_eye.errors import SceneError
from taichi_eye.rungs import refresh_travel
from taichi_eye.scene.budget import refuse_costly
from taichi_eye.scene.calibration import (
    DEFAULT_A_PA,
    DEFAULT_K,
    rest_stress,
    solve_exponent,
    solve_prestrain,
    solve_stiffness,
)
from taichi_eye.scene.draft import CHANGE, Draft
from taichi_eye.scene.schema import AUTO, all_keys
from taichi_eye.scene.table import read_puff_file
from taichi_eye.units import MM, MMHG

CONSISTENT = 1e-6  # relative agreement asked of keys that determine each other
NODES_MAX = 200_000  # of the fluid: beyond it a run would take days
SPACINGS_DEEP = 4  # the chamber on the axis is at least so many spacings deep
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
        if draft.within_limits and spec.computed and not spec.holds(draft[name]):
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
            f'"auto" (--set {s if draft.origin[k] == CHANGE else k}=auto)',
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
    cap = _cap_depth(draft.values)
    if draft["chamber.depth_mm"] == AUTO:
        draft.values["chamber.depth_mm"] = cap
    if draft["chamber.depth_mm"] < cap:
        draft.refuse(
            f"the chamber must reach the limbus plane: at least the cap depth {cap!r} mm, or "
            '"auto" (--set chamber.depth_mm=auto)',
            "chamber.depth_mm",
            "cornea.radius_mm",
            "cornea.limbus_radius_mm",
        )
    elif _lens_fits(draft) and draft.within_limits:
        _spacing(draft)


def _cap_depth(values: Mapping[str, float]) -> float:
    """From the apex at rest to the limbus plane [mm]."""
    return values["cornea.radius_mm"] - _sphere_depth(values)


def _sphere_depth(values: Mapping[str, float]) -> float:
    """Depth [mm] of the centre of the corneal sphere below the limbus plane."""
    return math.sqrt(values["cornea.radius_mm"] ** 2 - values["cornea.limbus_radius_mm"] ** 2)


def _segment(radius: float, angle: float) -> float:
    """Half the area [mm^2] that an arc of a half angle [rad] cuts from a disc of a radius [mm]."""
    return 0.5 * radius**2 * (angle - math.sin(angle) * math.cos(angle))


def _has_lens(values: Mapping[str, float]) -> bool:
    return bool(values["chamber.lens_radius_mm"] or values["chamber.lens_height_mm"])


def _lens_base(values: Mapping[str, float]) -> float:
    """Radius [mm] of the circle in which the lens cap stands on the back plane."""
    height = values["chamber.lens_height_mm"]
    return math.sqrt(height * (2.0 * values["chamber.lens_radius_mm"] - height))


def _lens_fits(draft: Draft) -> bool:
    """Whether there is no lens cap, or one that can stand on the back plane; what is wrong with it is recorded."""
    if not _has_lens(draft.values):
        return True
    names = "chamber.lens_radius_mm", "chamber.lens_height_mm"
    radius, height = (draft[name] for name in names)
    if not 0 < height < radius:
        draft.refuse("a lens cap needs both, the height below the radius (both 0: no lens)", *names)
        return False
    if not _lens_base(draft.values) < draft["cornea.limbus_radius_mm"]:
        draft.refuse(
            f"the base of the lens cap, {_lens_base(draft.values):.4g} mm in radius, must lie inside the limbus radius",
            *names,
            "cornea.limbus_radius_mm",
        )
        return False
    return True


def _lens_gap(values: Mapping[str, float]) -> float:
    """What the lens cap leaves free [mm] before the cornea at rest; infinite without one."""
    if not _has_lens(values):
        return math.inf
    # the point of a circular arc that is farthest from a point of its axis is its pole or its rim
    back = _cap_depth(values) - values["chamber.depth_mm"] + _sphere_depth(values)
    farthest = max(abs(back + values["chamber.lens_height_mm"]), math.hypot(_lens_base(values), back))
    return values["cornea.radius_mm"] - farthest


def _room(values: Mapping[str, float]) -> float:
    """Depth of the liquid on the axis [mm]."""
    return values["chamber.depth_mm"] - values["chamber.lens_height_mm"]


def coarsest_spacing_mm(values: Mapping[str, float]) -> float:
    """The widest numerics.spacing_mm that a chamber takes; values: by "section.key", as `Scene.values` has them."""
    return min(_room(values) / SPACINGS_DEEP, _lens_gap(values) / LENS_CLEARANCE)


def section_area_mm2(values: Mapping[str, float]) -> float:
    """Area [mm^2] of the liquid's half section, where the nodes are."""
    radius, limbus = values["cornea.radius_mm"], values["cornea.limbus_radius_mm"]
    area = _segment(radius, math.asin(limbus / radius)) + limbus * (values["chamber.depth_mm"] - _cap_depth(values))
    if _has_lens(values):
        lens, height = values["chamber.lens_radius_mm"], values["chamber.lens_height_mm"]
        area -= _segment(lens, math.acos(1.0 - height / lens))
    return area


def _spacing(draft: Draft) -> None:
    """Enough nodes in the chamber and not too many."""
    spacing = draft["numerics.spacing_mm"]
    area, room, gap = (measure(draft.values) for measure in (section_area_mm2, _room, _lens_gap))
    if gap < LENS_CLEARANCE * spacing:
        draft.refuse(
            f"the lens cap comes within {gap:.4g} mm of the cornea at rest; at least {LENS_CLEARANCE} "
            f"spacings, {LENS_CLEARANCE * spacing:.4g} mm, must stay free",
            "chamber.lens_radius_mm",
            "chamber.lens_height_mm",
            "chamber.depth_mm",
            "numerics.spacing_mm",
        )
    elif area > NODES_MAX * spacing**2:
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


def _numerics(draft: Draft) -> None:
    """How often operators or flow maps are made anew, by what they are for."""
    if draft["numerics.refresh_travel"] == AUTO:
        draft.values["numerics.refresh_travel"] = refresh_travel(draft["numerics.fidelity"])


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
