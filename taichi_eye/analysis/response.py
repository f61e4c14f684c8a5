"""The dynamic corneal response (DCR) parameters of the Corvis ST, from corneal curves over time.

One code for rendered, recorded and computed curves. Definitions (times from the first frame, the clinic's names):

deformation      displacement of the anterior surface along the axis from rest (mean of the first 1.2 ms).
whole-eye movement  mean deformation 3.6 to 4.0 mm from the apex, both sides. deflection: deformation less that.
curvature        of the circle fitted to the central 2 mm (+-1 mm); positive while convex.
A1, A2           the curvature crosses zero, inwards and outwards. Velocity: slope of the apex deformation, local
                 quadratic over +-0.8 ms, about +-3.5 frames. Length: over which the surface leaves its tangent on the
                 axis by less than 10 um, read off a sextic over the central 4 mm, for its ripples come close to that.
                 Amplitude: apex deflection.
HC               the largest apex deformation. Radius: one over the concave curvature then. Peak distance: between the
                 two highest points of the curve. Circle radius: of the circle through these two and the apex, which
                 is the one that the norms of the HC radius are held against: the instrument shows about 8 mm beside a
                 largest inverse radius of .17 per mm (5.9 mm), so its HC radius is no central fit.
DA ratio         apex deformation over the mean deformation at +-1 or +-2 mm; the largest value from A1 to HC.
inverse radius   concave curvature (of the circle fitted to the central 4 mm, over +-0.7 ms): its largest value, and its
                 sum over the camera's frames from A1 to A2. The instrument's zone is not public: in this one, of those
                 that `taichi-eye clinic` tries, a dent that shows the norms' other parameters shows their sum too.
deflection area  between the curve at rest and the deflected one, central 7 mm; delta arc length: change in length of
                 the curve over the same zone.
IOPnct, bIOP     what the instrument would show: the first from the A1 time alone, the second from it, the thickness
                 and the age (`shown_iop_nct_mmhg`, `biop_surrogate_mmhg`).
SP-A1            (air pressure at A1 less bIOP) over the deflection amplitude at A1.

Single values are read off moving polynomials in time, which frames may be missing from.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from taichi_eye.analysis.curves import REST_MS, Curves, nanmean, seen_alike, smooth
from taichi_eye.eye.puff import CORVIS_FALL, CORVIS_PEAK_S, CORVIS_RISE

APEX_MM = 0.10  # half width of the mean that is the apex
SIDE_MM = 3.6, 4.0  # where whole-eye movement is read
CURVATURE_MM = 1.0  # half width of the circle
INVERSE_MM = 2.0  # and of that of the inverse radius
RATIO_MM = 0.10  # half width of the mean at +-1 and +-2 mm
ZONE_MM = 3.5  # half width of area and arc length
FLAT_MM, FLAT_REACH_MM = 0.010, 2.0
SPEED_MS, SHAPE_MS, TOP_MS = 0.8, 0.7, 1.6  # half widths of the moving polynomials
MOVED_MM = 0.05
CORVIS_PEAK_MMHG = 96.4  # Oehring 2021, doi 10.3390/app11062499
SHOWN_IOP = 16.8, 7.36, 0.134  # IOPnct [mmHg] at an A1 time [ms], means of 652 eyes (PMC7001013), and ms a mmHg


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
    hc_circle_radius_mm: float | None = None
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
    iop_nct_mmhg: float | None = None
    biop_mmhg: float | None = None
    sp_a1_mmhg_mm: float | None = None


# how each parameter that has a norm is read, its windows stated
READ_AS = {
    "a1_time_ms": f"the circle over the central +-{CURVATURE_MM:g} mm turns flat, inwards",
    "a1_velocity_m_s": f"slope of the apex deformation at A1, local quadratic over +-{SPEED_MS:g} ms",
    "a1_deflection_mm": f"apex deformation less whole-eye movement (mean at {SIDE_MM[0]:g} to {SIDE_MM[1]:g} mm) at A1",
    "a2_time_ms": f"the circle over the central +-{CURVATURE_MM:g} mm turns flat, outwards",
    "a2_velocity_m_s": f"slope of the apex deformation at A2, local quadratic over +-{SPEED_MS:g} ms",
    "hc_time_ms": f"of the largest apex deformation, local cubic over +-{TOP_MS:g} ms",
    "deformation_amplitude_mm": f"largest apex deformation, mean over +-{APEX_MM:g} mm, whole-eye movement included",
    "peak_distance_mm": "between the two bending peaks at highest concavity",
    "hc_radius_mm": f"circle over the central +-{CURVATURE_MM:g} mm at highest concavity",
    "hc_circle_radius_mm": "circle through both bending peaks and the apex at highest concavity",
    "da_ratio_2mm": f"apex deformation over its mean at +-2 mm (+-{RATIO_MM:g} mm), largest from A1 to HC",
    "integrated_inverse_radius_per_mm": f"concave curvature of the central +-{INVERSE_MM:g} mm, "
    f"over +-{SHAPE_MS:g} ms, summed over the frames from A1 to A2",
    "sp_a1_mmhg_mm": "(air pressure at A1 less bIOP) over the deflection at A1",
    "central_thickness_um": "of the eye at rest",
}


# steps of the grids that these are looked for on: they are read no finer
READS_TO = {
    "a1_length_mm": 0.004,
    "a2_length_mm": 0.004,
    "hc_time_ms": 0.005,
    "whole_eye_movement_time_ms": 0.005,
}


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


def histories(curves: Curves, curvature_mm: float = CURVATURE_MM) -> Histories:
    """Deformation, deflection, curvature (of the circle over +-curvature_mm) and speed over time."""
    time, x = curves.time_ms, curves.x_mm
    height = smooth(curves.height_mm)
    rest = nanmean(height[time <= time[0] + REST_MS])
    deformation = rest - height
    apex = _band(deformation, x, 0.0, APEX_MM)
    middle, half = 0.5 * (SIDE_MM[0] + SIDE_MM[1]), 0.5 * (SIDE_MM[1] - SIDE_MM[0])
    sides = np.stack([_band(deformation, x, side * middle, half) for side in (-1, 1)])
    whole = nanmean(sides)
    return Histories(
        time,
        x,
        height,
        deformation,
        deformation - whole[:, None],
        apex,
        whole,
        circles(x, height, curvature_mm)[0],
        moving(time, apex, time, SPEED_MS, 2, 1),
    )


def respond(
    curves: Curves,
    frame_interval_ms: float = 0.2315,
    biop_mmhg: float | None = None,
    puff_mmhg=measured_puff_mmhg,
    age_years: float | None = None,
    curvature_mm: float = CURVATURE_MM,
    inverse_mm: float = INVERSE_MM,
    ready: Histories | None = None,
) -> Response:
    """DCR parameters of the curves.

    frame_interval_ms: of the camera, for the integrated inverse radius. biop_mmhg: pressure of the eye, and puff_mmhg:
    the air's pressure at the apex [mmHg] at a time [ms], for SP-A1. age_years: of the eye, in place of biop_mmhg:
    IOPnct and bIOP are then those that the instrument would show. curvature_mm, inverse_mm: half widths of the circles
    of the curvature and of the inverse radius. ready: `histories(curves, curvature_mm)` where they are there already.
    """
    h = histories(curves, curvature_mm) if ready is None else ready
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
        left, right = _peaks(x, at_hc)
        found["peak_distance_mm"] = right[0] - left[0]
        apex = float(_band(at_hc[None], x, 0.0, APEX_MM)[0])
        found["hc_circle_radius_mm"] = _circumradius(left, (0.0, apex), right)
    a1, a2 = _applanations(time, h.curvature_per_mm, hc)
    ratio_from = a1 if a1 is not None else time[np.argmax(h.apex_mm > 0.25 * amplitude)]
    for mm in (1, 2):
        found[f"da_ratio_{mm}mm"] = _ratio(h, mm, ratio_from, hc)
    if a1 is not None and a2 is not None:
        grid = np.arange(np.ceil((a1 - time[0]) / frame_interval_ms), np.floor((a2 - time[0]) / frame_interval_ms) + 1)
        wide = circles(x, h.height_mm, inverse_mm)[0]
        inverse = -moving(time, wide, time[0] + frame_interval_ms * grid, SHAPE_MS, 1)
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
    if age_years is not None and a1 is not None and "central_thickness_um" in found:
        found["iop_nct_mmhg"] = shown_iop_nct_mmhg(a1)
        biop_mmhg = biop_surrogate_mmhg(found["iop_nct_mmhg"], found["central_thickness_um"], age_years)
    if biop_mmhg is not None:
        found["biop_mmhg"] = biop_mmhg
        if found.get("a1_deflection_mm", 0.0) > 0.0:
            found["sp_a1_mmhg_mm"] = (puff_mmhg(a1) - biop_mmhg) / found["a1_deflection_mm"]
    return _response(found)


def shown_iop_nct_mmhg(a1_time_ms: float) -> float:
    """IOPnct, the pressure that the instrument reads off its A1 time: linear, `SHOWN_IOP`."""
    mean_mmhg, mean_ms, ms_per_mmhg = SHOWN_IOP
    return mean_mmhg + (a1_time_ms - mean_ms) / ms_per_mmhg


def a1_time_shown_as_ms(iop_nct_mmhg: float) -> float:
    """The A1 time that `shown_iop_nct_mmhg` gives this IOPnct."""
    mean_mmhg, mean_ms, ms_per_mmhg = SHOWN_IOP
    return mean_ms + ms_per_mmhg * (iop_nct_mmhg - mean_mmhg)


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
    time, values, at = time[good], values[good], np.asarray(at, dtype=float)
    out = np.full(len(at), np.nan)
    least = degree + 3
    if len(time) < least:
        return out
    # the nearest frames lie among as many on either side
    near = np.searchsorted(time, at)[:, None] + np.arange(-least, least)
    distance = np.where(
        (near >= 0) & (near < len(time)), np.abs(time[np.clip(near, 0, len(time) - 1)] - at[:, None]), np.inf
    )
    width = np.maximum(half_width, 1.01 * np.partition(distance, least - 1, axis=1)[:, least - 1])
    # only frames within the window count: as many columns as the fullest window has
    first, last = np.searchsorted(time, at - width), np.searchsorted(time, at + width, side="right")
    column = first[:, None] + np.arange((last - first).max(initial=1))
    inside, column = column < last[:, None], np.minimum(column, len(time) - 1)
    late = (time[column] - at[:, None]) / width[:, None]
    weight = np.where(inside, np.clip(1.0 - late**2, 0.0, None) ** 2, 0.0)
    powers = late[:, :, None] ** np.arange(degree + 1)
    weighted = (powers * weight[:, :, None]).transpose(0, 2, 1)
    fit = np.linalg.solve(weighted @ powers, weighted @ values[column][:, :, None])
    return fit[:, derivative, 0] / width**derivative


def circle(x: np.ndarray, height: np.ndarray, reach: float) -> tuple[float, float]:
    """Curvature [1/mm], convex positive, of the circle through |x| <= reach by least squares, and the rms distance of
    the heights from it [mm]; NaN with gaps."""
    bend, off = circles(x, height[None], reach)
    return float(bend[0]), float(off[0])


def circles(x: np.ndarray, height: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """`circle` of each of several curves [curves, points]."""
    near = np.abs(x) <= reach
    z, at = height[:, near], x[near]
    seen = np.isfinite(z)
    bends, offs = np.full((2, len(z)), np.nan)
    for shape, alike in seen_alike(seen):
        if shape.mean() >= 0.9:
            bends[alike], offs[alike] = _circles(at[shape], z[np.ix_(alike, shape)])
    return bends, offs


def _circles(at: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curvatures and rms distances of curves [curves, points] without gaps."""
    bend = np.zeros(len(z))
    for _ in range(4):
        # height of a circle of this curvature over its pole
        sag = at**2 / (1.0 + np.sqrt(np.clip(1.0 - bend[:, None] ** 2 * at**2, 0.04, None)))
        shape = np.stack([sag, np.broadcast_to(at, z.shape), np.ones_like(z)], axis=2)
        across = shape.transpose(0, 2, 1)
        fit = np.linalg.solve(across @ shape, across @ z[:, :, None])
        bend = -fit[:, 0, 0]
    return bend, np.sqrt(np.mean((z - (shape @ fit)[:, :, 0]) ** 2, axis=1))


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


def _band(values: np.ndarray, x: np.ndarray, centre: float, half: float) -> np.ndarray:
    return nanmean(values[:, np.abs(x - centre) <= half + 1e-9].T)


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
    rest = nanmean(h.height_mm[h.time_ms <= h.time_ms[0] + REST_MS])[zone]
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


def _peaks(x: np.ndarray, z: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Places and heights [mm] of the two bending peaks, left and right; NaN where a side is not seen."""
    tops = []
    for side in (-1, 1):
        here = side * x > 0.3
        at, height = x[here], z[here]
        if not np.isfinite(height).any():
            return ((np.nan, np.nan),) * 2
        top = at[int(np.nanargmax(height))]
        near = (np.abs(x - top) <= 0.45) & np.isfinite(z)
        c2, c1, c0 = np.polyfit(x[near] - top, z[near], 2)
        off = -np.clip(0.5 * c1 / c2, -0.45, 0.45) if c2 < 0.0 else 0.0
        tops.append((float(top + off), float(c0 + c1 * off + c2 * off**2)))
    return tops[0], tops[1]


def _circumradius(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Radius of the circle through three points, b the lowest; NaN where they do not lie on a dent."""
    twice = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    sides = [float(np.hypot(p[0] - q[0], p[1] - q[1])) for p, q in ((a, b), (b, c), (c, a))]
    return float(np.prod(sides)) / (2.0 * twice) if twice > 0.0 else np.nan
