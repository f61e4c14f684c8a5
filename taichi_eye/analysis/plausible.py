"""What a film must be like for its numbers to be believed.

`refuse_what_is_no_cornea` asks of a film what every cornea under an air puff shows: at rest it is convex with the
radius of an eye, and has a back; what moves is its middle, its flanks hardly do. `believed` leaves blank what the film
cannot tell, and says why: without a rest at its start there is no displacement, without frames around an event no
event, with time running backwards no times. A number that is left stands on what was seen.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from taichi_eye.analysis.curves import REST_MS, Curves, nanmean
from taichi_eye.analysis.response import Histories, Response, circle
from taichi_eye.errors import FilmError

EYE_RADIUS_MM = 5.0, 12.0
CAP_REACH_MM, CAP_OFF_MM = 2.8, 0.04  # half width that the circle is fitted to, rms from it
THICKNESS_UM = 150.0, 1200.0  # of anything that may be a cornea
USUAL_THICKNESS_UM = 300.0, 800.0
WHOLE_MAX_MM, WHOLE_SHARE_MAX = 0.8, 0.7  # of the flanks; as a share of the amplitude
AMPLITUDE_MAX_MM = 2.0
STILL_MS, STILL_MM = 2.0, 0.04  # at rest the apex moves less than that
GAP_MS = 1.4  # between frames around an event
END_MS = 1.0  # the deepest instant lies so far inside the film
HIDDEN_EVENT_MM, HIDDEN_REST_MM = 1.3, 3.2  # bridged width of a dented and of a convex curve
BACKWARDS = 1.25  # the fall takes so many times as long as the rise: no puff is like that

APART_MS, SPEED_MAX_M_S = 1.5, 1.2  # an applanation and the deepest instant; an apex at its fastest

CLOCK = "a1_time_ms", "a2_time_ms", "hc_time_ms", "whole_eye_movement_time_ms", "sp_a1_mmhg_mm"
SPEED = "a1_velocity_m_s", "a2_velocity_m_s"
RATES = "max_inverse_radius_per_mm", "integrated_inverse_radius_per_mm"
# parameters that are displacements from rest
FROM_REST = tuple(
    f.name
    for f in fields(Response)
    if any(part in f.name for part in ("deflection", "arc_length", "amplitude", "da_ratio", "whole_eye", "sp_a1"))
)
TIMED = ("file names", "stamps in the frames", "the scene's frame interval")


def refuse_what_is_no_cornea(curves: Curves, history: Histories, response: Response) -> None:
    """FilmError where the curves are not those of a cornea under an air puff."""
    first, last = _ends(history)
    rests = _like_an_eye(history.x_mm, first)
    if not (rests or _like_an_eye(history.x_mm, last)):
        curvature, off = circle(history.x_mm, first, CAP_REACH_MM)
        if curvature < -1.0 / EYE_RADIUS_MM[1]:
            raise FilmError("no cornea: what is seen is concave at rest; is the picture upside down?")
        seen = (
            "no convex curve of an eye's width"
            if not curvature > 1e-3
            else (f"a radius of {1.0 / curvature:.3g} mm and lies {1e3 * off:.0f} um (rms) off a circle")
        )
        raise FilmError(
            f"no cornea: at rest what is seen has {seen}; a cornea is convex with {EYE_RADIUS_MM[0]:g} to "
            f"{EYE_RADIUS_MM[1]:g} mm"
        )
    if curves.thickness_profile_mm is None or not np.isfinite(curves.thickness_profile_mm).any():
        raise FilmError("no cornea: what is seen has no posterior edge")
    thickness = response.central_thickness_um
    if thickness is not None and not THICKNESS_UM[0] <= thickness <= THICKNESS_UM[1]:
        raise FilmError(f"no cornea: what is seen is {thickness:.0f} um thick")
    if not rests:
        return
    amplitude, whole = response.deformation_amplitude_mm, response.whole_eye_movement_mm or 0.0
    if whole > WHOLE_MAX_MM or (amplitude is not None and whole > max(WHOLE_SHARE_MAX * amplitude, 0.1)):
        raise FilmError(f"no air puff on a cornea: its flanks move by {whole:.2f} mm, as its middle does")
    if amplitude is not None and amplitude > AMPLITUDE_MAX_MM:
        raise FilmError(f"no air puff on a cornea: a deformation of {amplitude:.2f} mm")


def believed(response: Response, curves: Curves, history: Histories, timed_by: str) -> tuple[Response, list[str]]:
    """The response without what the film cannot tell, and the reasons."""
    doubts: dict[str, str] = {}

    def doubt(names, reason: str) -> None:
        for name in names:
            if getattr(response, name) is not None:
                doubts.setdefault(name, reason)

    notes = []
    thickness, time = response.central_thickness_um, history.time_ms
    if thickness is None:
        notes.append("the posterior edge is not seen at rest: no thickness")
    elif not USUAL_THICKNESS_UM[0] <= thickness <= USUAL_THICKNESS_UM[1]:
        notes.append(f"a thickness of {thickness:.0f} um is unusual; check the pixel size and the overlay film")
    if response.deformation_amplitude_mm is None:
        return response, notes
    first, _ = _ends(history)
    early = time <= time[0] + STILL_MS
    apex = history.apex_mm[early]
    creep = np.ptp(apex[np.isfinite(apex)]) if np.isfinite(apex).any() else 0.0
    if creep > STILL_MM or not _like_an_eye(history.x_mm, first):
        reason = "the film does not start at rest"
        doubt(FROM_REST, reason)
        if timed_by not in TIMED:
            doubt(CLOCK, reason)
    if curves.hidden_mm is not None:
        if np.median(curves.hidden_mm[time <= time[0] + REST_MS]) > HIDDEN_REST_MM:
            doubt((*FROM_REST, "central_thickness_um"), "the top of the cornea at rest is not in the picture")
    _doubt_events(response, curves, time, doubt)
    a1, hc, a2 = response.a1_time_ms, response.hc_time_ms, response.a2_time_ms
    sure = None not in (a1, a2) and not doubts.keys() & {"a1_time_ms", "hc_time_ms", "a2_time_ms"}
    if sure and timed_by != TIMED[2] and a2 - hc > BACKWARDS * (hc - a1):
        doubt((*FROM_REST, *CLOCK, *SPEED), "the dent forms faster than it goes, as in a film that runs backwards")
    speeds = [abs(v) for v in (response.a1_velocity_m_s, response.a2_velocity_m_s) if v is not None]
    if any(abs(at - hc) < APART_MS for at in (a1, a2) if at is not None) or max(speeds, default=0.0) > SPEED_MAX_M_S:
        every = [f.name for f in fields(Response) if f.name not in ("central_thickness_um", "biop_mmhg")]
        doubt(every, "the edge jumps where no cornea does: frames of it are damaged or missing")
    by_reason: dict[str, list[str]] = {}
    for name, reason in doubts.items():
        by_reason.setdefault(reason, []).append(name)
    notes += [f"{reason}: left blank {', '.join(names)}" for reason, names in by_reason.items()]
    return replace(response, **dict.fromkeys(doubts)), notes


def _doubt_events(response: Response, curves: Curves, time: np.ndarray, doubt) -> None:
    of = {name: [f.name for f in fields(Response) if f.name.startswith(f"{name}_")] for name in ("a1", "a2", "hc")}
    of["hc"] += ["deformation_amplitude_mm", "peak_distance_mm", "da_ratio_1mm", "da_ratio_2mm", *RATES]
    of["a1"] += ["sp_a1_mmhg_mm", *RATES]
    of["a2"] += RATES
    for name, group in of.items():
        at = getattr(response, f"{name}_time_ms")
        if at is None:
            continue
        after = int(np.clip(np.searchsorted(time, at), 1, len(time) - 1))
        if time[after] - time[after - 1] > GAP_MS:
            doubt(group, f"no frames from {time[after - 1]:.2f} to {time[after]:.2f} ms")
        if curves.hidden_mm is not None and curves.hidden_mm[after - 1 : after + 1].min() > HIDDEN_EVENT_MM:
            doubt(group, f"too much of the edge is masked at {at:.2f} ms")
    hc = response.hc_time_ms
    if hc > time[-1] - END_MS or hc < time[0] + END_MS:
        doubt(
            of["hc"],
            "the film ends, or begins, before the dent is deepest",
        )


def _ends(history: Histories) -> tuple[np.ndarray, np.ndarray]:
    """The mean curves of the film's first and last REST_MS."""
    time, height = history.time_ms, history.height_mm
    return nanmean(height[time <= time[0] + REST_MS]), nanmean(height[time >= time[-1] - REST_MS])


def _like_an_eye(x: np.ndarray, height: np.ndarray) -> bool:
    curvature, off = circle(x, height, CAP_REACH_MM)
    low, high = EYE_RADIUS_MM
    return bool(1.0 / high <= curvature <= 1.0 / low and off <= CAP_OFF_MM)
