"""The dynamic corneal response (DCR) parameters of the Corvis ST, from corneal curves over time.

One code for rendered, recorded and computed curves. Definitions (times from the first frame, the clinic's names):

deformation      displacement of the anterior surface along the axis from rest (mean of the first 1.2 ms).
whole-eye movement  mean deformation 3.6 to 4.0 mm from the apex, both sides. deflection: deformation less that.
curvature        of the circle fitted to the central 2 mm; positive while convex.
A1, A2           the curvature crosses zero, inwards and outwards. Velocity: slope of the apex deformation, local
                 quadratic over +-0.8 ms. Length: over which the surface leaves its tangent on the axis by less than
                 10 um, read off a sextic over the central 4 mm, for its ripples come close to that. Amplitude: apex
                 deflection.
HC               the largest apex deformation. Radius: one over the concave curvature then. Peak distance: between the
                 two highest points of the curve.
DA ratio         apex deformation over the mean deformation at +-1 or +-2 mm; the largest value from A1 to HC.
inverse radius   concave curvature: its largest value, and its sum over the camera's frames from A1 to A2.
deflection area  between the curve at rest and the deflected one, central 7 mm; delta arc length: change in length of
                 the curve over the same zone.
SP-A1            (air pressure at A1 less bIOP) over the deflection amplitude at A1.

Single values are read off moving polynomials in time, which frames may be missing from.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from taichi_eye.analysis.curves import REST_MS, Curves, smooth
from taichi_eye.eye.puff import CORVIS_FALL, CORVIS_PEAK_S, CORVIS_RISE

APEX_MM = 0.10  # half width of the mean that is the apex
SIDE_MM = 3.6, 4.0  # where whole-eye movement is read
CURVATURE_MM = 1.0  # half width of the circle
RATIO_MM = 0.10  # half width of the mean at +-1 and +-2 mm
ZONE_MM = 3.5  # half width of area and arc length
FLAT_MM, FLAT_REACH_MM = 0.010, 2.0
SPEED_MS, SHAPE_MS, TOP_MS = 0.8, 0.7, 1.6  # half widths of the moving polynomials
MOVED_MM = 0.05
CORVIS_PEAK_MMHG = 96.4  # Oehring 2021, doi 10.3390/app11062499


@dataclass(frozen=True)
class Response:
    """DCR parameters; None where the curves do not show them. Units stand in the names."""

    a1_time_ms: float | None = None
    a1_velocity_m_s: float | None = None
    a1_length_mm: float | None = None
    a1_deflection_mm: float | None = None
    a1_deflection_area_mm2: float | None = None
    a1_delta_arc_length_mm: float | None = None
    a2_time_ms: float | None = None
    a2_velocity_m_s: float | None = None
    a2_length_mm: float | None = None
    a2_deflection_mm: float | None = None
    a2_deflection_area_mm2: float | None = None
    a2_delta_arc_length_mm: float | None = None
    hc_time_ms: float | None = None
    deformation_amplitude_mm: float | None = None
    hc_deflection_mm: float | None = None
    hc_radius_mm: float | None = None
    peak_distance_mm: float | None = None
    hc_deflection_area_mm2: float | None = None
    hc_delta_arc_length_mm: float | None = None
    da_ratio_1mm: float | None = None
    da_ratio_2mm: float | None = None
    max_inverse_radius_per_mm: float | None = None
    integrated_inverse_radius_per_mm: float | None = None
    whole_eye_movement_mm: float | None = None
    whole_eye_movement_time_ms: float | None = None
    central_thickness_um: float | None = None
    biop_mmhg: float | None = None
    sp_a1_mmhg_mm: float | None = None


@dataclass(frozen=True)
class Histories:
    """What the parameters are read from: arrays [frames] at time_ms, maps [frames, points] over x_mm.

    deformation, deflection (maps, mm), apex_mm (apex deformation), whole_eye_mm, curvature_per_mm (convex positive),
    velocity_m_s (of the apex, inward positive), height_mm (smoothed curves).
    """

    time_ms: np.ndarray
    x_mm: np.ndarray
    height_mm: np.ndarray
    deformation_mm: np.ndarray
    deflection_mm: np.ndarray
    apex_mm: np.ndarray
    whole_eye_mm: np.ndarray
    curvature_per_mm: np.ndarray
    velocity_m_s: np.ndarray


def measured_puff_mmhg(time_ms: float) -> float:
    """Air pressure at the apex [mmHg] of the instrument's measured puff."""
    late = time_ms * 1e-3 - CORVIS_PEAK_S
    width, power = CORVIS_RISE if late < 0.0 else CORVIS_FALL
    return CORVIS_PEAK_MMHG * float(np.exp(-((abs(late) / width) ** power)))


def histories(curves: Curves) -> Histories:
    """Deformation, deflection, curvature and speed over time."""
    time, x = curves.time_ms, curves.x_mm
    height = smooth(curves.height_mm)
    rest = _nanmean(height[time <= time[0] + REST_MS])
    deformation = rest - height
    apex = _band(deformation, x, 0.0, APEX_MM)
    middle, half = 0.5 * (SIDE_MM[0] + SIDE_MM[1]), 0.5 * (SIDE_MM[1] - SIDE_MM[0])
    sides = np.stack([_band(deformation, x, side * middle, half) for side in (-1, 1)])
    whole = _nanmean(sides)
    curvature = np.array([circle_curvature(x, one) for one in height])
    return Histories(
        time,
        x,
        height,
        deformation,
        deformation - whole[:, None],
        apex,
        whole,
        curvature,
        moving(time, apex, time, SPEED_MS, 2, 1),
    )


def respond(
    curves: Curves, frame_interval_ms: float = 0.2315, biop_mmhg: float | None = None, puff_mmhg=measured_puff_mmhg
) -> Response:
    """DCR parameters of the curves.

    frame_interval_ms: of the camera, for the integrated inverse radius. biop_mmhg: pressure of the eye, and puff_mmhg:
    the air's pressure at the apex [mmHg] at a time [ms], for SP-A1.
    """
    h = histories(curves)
    time, x = h.time_ms, h.x_mm
    found: dict[str, float] = {}
    if curves.thickness_mm is not None:
        found["central_thickness_um"] = _rest_thickness(curves)
    if np.isfinite(h.whole_eye_mm).sum() > 5:
        whole_time, whole = _top(time, h.whole_eye_mm, 2.5)
        if whole > 0.02:
            found |= {"whole_eye_movement_mm": whole, "whole_eye_movement_time_ms": whole_time}
    if not (np.nan_to_num(h.apex_mm) > MOVED_MM).any():
        return _response(found)
    hc, amplitude = _top(time, h.apex_mm, TOP_MS)
    found |= {"hc_time_ms": hc, "deformation_amplitude_mm": amplitude}
    at_hc = _curve_at(h, h.height_mm, hc)
    deflected_hc = _curve_at(h, h.deflection_mm, hc)
    found["hc_deflection_mm"] = float(_band(deflected_hc[None], x, 0.0, APEX_MM)[0])
    found |= _zone(h, hc, "hc")
    concave = -moving(time, h.curvature_per_mm, np.array([hc]), SHAPE_MS, 1)[0]
    if concave > 0.0:
        found["hc_radius_mm"] = 1.0 / concave
        found["peak_distance_mm"] = _peak_distance(x, at_hc)
    a1, a2 = _applanations(time, h.curvature_per_mm, hc)
    ratio_from = a1 if a1 is not None else time[np.argmax(h.apex_mm > 0.25 * amplitude)]
    for mm in (1, 2):
        found[f"da_ratio_{mm}mm"] = _ratio(h, mm, ratio_from, hc)
    if a1 is not None and a2 is not None:
        grid = np.arange(np.ceil((a1 - time[0]) / frame_interval_ms), np.floor((a2 - time[0]) / frame_interval_ms) + 1)
        inverse = -moving(time, h.curvature_per_mm, time[0] + frame_interval_ms * grid, SHAPE_MS, 1)
        found["integrated_inverse_radius_per_mm"] = float(np.clip(inverse, 0.0, None).sum())
        found["max_inverse_radius_per_mm"] = float(inverse.max())
    for name, at in (("a1", a1), ("a2", a2)):
        if at is None:
            continue
        deflected = _curve_at(h, h.deflection_mm, at)
        found |= {
            f"{name}_time_ms": at,
            f"{name}_velocity_m_s": float(moving(time, h.apex_mm, np.array([at]), SPEED_MS, 2, 1)[0]),
            f"{name}_length_mm": _flat_length(x, _curve_at(h, h.height_mm, at)),
            f"{name}_deflection_mm": float(_band(deflected[None], x, 0.0, APEX_MM)[0]),
            **_zone(h, at, name),
        }
    if biop_mmhg is not None:
        found["biop_mmhg"] = biop_mmhg
        if found.get("a1_deflection_mm", 0.0) > 0.0:
            found["sp_a1_mmhg_mm"] = (puff_mmhg(a1) - biop_mmhg) / found["a1_deflection_mm"]
    return _response(found)


def biop_surrogate_mmhg(iop_nct_mmhg: float, thickness_um: float, age_years: float) -> float:
    """Biomechanically corrected IOP, a linear fit over 194 eyes (R2 0.98) of what the instrument reports."""
    return 19.98 + 0.885 * iop_nct_mmhg - 0.0306 * thickness_um - 0.0438 * age_years


def moving(
    time: np.ndarray, values: np.ndarray, at: np.ndarray, half_width: float, degree: int, derivative: int = 0
) -> np.ndarray:
    """Moving least-squares polynomial with the weights (1 - u^2)^2, its value or a derivative at `at`.

    The window grows where frames are missing until it holds degree + 3 of them. values [frames]; NaN counts as missing.
    """
    good = np.isfinite(values)
    time, values = time[good], values[good]
    out = np.full(len(at), np.nan)
    least = degree + 3
    if len(time) < least:
        return out
    for k, t in enumerate(at):
        distance = np.abs(time - t)
        width = max(half_width, 1.01 * np.partition(distance, least - 1)[least - 1])
        near = distance < width
        weight = 1.0 - (distance[near] / width) ** 2
        powers = np.vander(time[near] - t, degree + 1, increasing=True) * weight[:, None]
        fit = np.linalg.lstsq(powers, values[near] * weight, rcond=None)[0]
        out[k] = fit[derivative]
    return out


def circle_curvature(x: np.ndarray, height: np.ndarray) -> float:
    """Curvature [1/mm] of the circle through the central 2 mm by least squares, convex positive; NaN with gaps."""
    return circle(x, height, CURVATURE_MM)[0]


def circle(x: np.ndarray, height: np.ndarray, reach: float) -> tuple[float, float]:
    """Curvature [1/mm], convex positive, of the circle through |x| <= reach by least squares, and the rms distance of
    the heights from it [mm]; NaN with gaps."""
    near = np.abs(x) <= reach
    z, at = height[near], x[near]
    good = np.isfinite(z)
    if good.mean() < 0.9:
        return np.nan, np.nan
    z, at = z[good], at[good]
    bend = 0.0
    for _ in range(4):
        # height of a circle of this curvature over its pole
        sag = at**2 / (1.0 + np.sqrt(np.clip(1.0 - bend**2 * at**2, 0.04, None)))
        shape = np.column_stack([sag, at, np.ones_like(at)])
        fit = np.linalg.lstsq(shape, z, rcond=None)[0]
        bend = -fit[0]
    return float(bend), float(np.sqrt(np.mean((z - shape @ fit) ** 2)))


def _response(found: dict[str, float | None]) -> Response:
    return Response(
        **{
            f.name: float(found[f.name])
            for f in fields(Response)
            if found.get(f.name) is not None and np.isfinite(found[f.name])
        }
    )


def _rest_thickness(curves: Curves) -> float:
    rest = curves.thickness_mm[curves.time_ms <= curves.time_ms[0] + 3.0]
    rest = rest[np.isfinite(rest)]
    return 1e3 * float(rest.mean()) if len(rest) else np.nan


def _nanmean(values: np.ndarray) -> np.ndarray:
    good = np.isfinite(values)
    count = good.sum(axis=0)
    return np.where(count > 0, np.where(good, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _band(values: np.ndarray, x: np.ndarray, centre: float, half: float) -> np.ndarray:
    return _nanmean(values[:, np.abs(x - centre) <= half + 1e-9].T)


def _top(time: np.ndarray, values: np.ndarray, half_width: float) -> tuple[float, float]:
    """Time and height of the largest value of the moving quadratic."""
    near = time[int(np.nanargmax(moving(time, values, time, 0.5 * half_width, 2)))]
    fine = np.arange(max(near - half_width, time[0]), min(near + half_width, time[-1]) + 1e-9, 0.005)
    smoothed = moving(time, values, fine, half_width, 3)
    best = int(np.argmax(smoothed))
    return float(fine[best]), float(smoothed[best])


def _curve_at(h: Histories, values: np.ndarray, at: float) -> np.ndarray:
    """A curve at a time between frames: local linear regression over SHAPE_MS."""
    near = np.abs(h.time_ms - at) < SHAPE_MS
    if near.sum() < 3:
        near = np.argsort(np.abs(h.time_ms - at))[:4]
    late = h.time_ms[near] - at
    weight = 1.0 - (late / (np.abs(late).max() * 1.05)) ** 2
    powers = np.column_stack([np.ones_like(late), late]) * weight[:, None]
    return (np.linalg.pinv(powers)[0] * weight) @ values[near]


def _applanations(time: np.ndarray, curvature: np.ndarray, hc: float) -> tuple[float | None, float | None]:
    fine = np.arange(time[0], time[-1], 0.01)
    bend = moving(time, curvature, fine, SHAPE_MS, 1)
    top = int(np.argmin(np.abs(fine - hc)))
    if not bend[top] < 0.0:
        return None, None
    before, after = np.flatnonzero(bend[:top] > 0.0), np.flatnonzero(bend[top:] > 0.0)
    a1 = fine[before[-1]] + 0.01 * bend[before[-1]] / (bend[before[-1]] - bend[before[-1] + 1]) if len(before) else None
    if not len(after):
        return a1, None
    k = top + after[0]
    return a1, fine[k] - 0.01 * bend[k] / (bend[k] - bend[k - 1])


def _ratio(h: Histories, mm: float, start: float, stop: float) -> float:
    here = (h.time_ms >= start) & (h.time_ms <= stop)
    side = 0.5 * (_band(h.deformation_mm, h.x_mm, mm, RATIO_MM) + _band(h.deformation_mm, h.x_mm, -mm, RATIO_MM))
    apex = moving(h.time_ms, h.apex_mm, h.time_ms[here], SHAPE_MS, 1)
    side = moving(h.time_ms, side, h.time_ms[here], SHAPE_MS, 1)
    good = side > 0.0
    return float((apex[good] / side[good]).max()) if good.any() else np.nan


def _zone(h: Histories, at: float, name: str) -> dict[str, float]:
    zone = np.abs(h.x_mm) <= ZONE_MM + 1e-9
    x = h.x_mm[zone]
    area = (
        np.trapezoid(_curve_at(h, h.deflection_mm, at)[zone], x)
        if hasattr(np, "trapezoid")
        else np.trapz(_curve_at(h, h.deflection_mm, at)[zone], x)
    )
    rest = _nanmean(h.height_mm[h.time_ms <= h.time_ms[0] + REST_MS])[zone]
    arc = [np.hypot(np.diff(x), np.diff(z)).sum() for z in (_curve_at(h, h.height_mm, at)[zone], rest)]
    return {f"{name}_deflection_area_mm2": area, f"{name}_delta_arc_length_mm": arc[0] - arc[1]}


def _flat_length(x: np.ndarray, z: np.ndarray) -> float:
    near = (np.abs(x) <= FLAT_REACH_MM) & np.isfinite(z)
    if near.sum() < 0.9 * (np.abs(x) <= FLAT_REACH_MM).sum():
        return np.nan
    fit = np.polynomial.polynomial.polyfit(x[near], z[near], 6)
    fine = np.arange(-FLAT_REACH_MM, FLAT_REACH_MM, 0.002)
    off = np.abs(np.polynomial.polynomial.polyval(fine, fit) - fit[0] - fit[1] * fine) > FLAT_MM
    left, right = np.flatnonzero(off & (fine < 0.0)), np.flatnonzero(off & (fine > 0.0))
    if not len(left) or not len(right):
        return np.nan
    return float(fine[right[0]] - fine[left[-1]])


def _peak_distance(x: np.ndarray, z: np.ndarray) -> float:
    places = []
    for side in (-1, 1):
        here = side * x > 0.3
        at, height = x[here], z[here]
        if not np.isfinite(height).any():
            return np.nan
        top = at[int(np.nanargmax(height))]
        near = (np.abs(x - top) <= 0.45) & np.isfinite(z)
        c2, c1, _ = np.polyfit(x[near] - top, z[near], 2)
        places.append(top - (np.clip(0.5 * c1 / c2, -0.45, 0.45) if c2 < 0.0 else 0.0))
    return float(places[1] - places[0])
