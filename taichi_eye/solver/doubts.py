"""What a run that no guard stopped should be doubted for: sentences, each with what to change.

A guard ends a run whose state is impossible. A doubt is about a run that looks sound and whose apex may yet be off by
some per cent, by what the scheme leaves out. Each is judged by what the run itself left:

energy       the balance is off by more than BALANCE of the puff's work.
compression  a sealed liquid of the sound speed c_m gives way by dV = V p/(rho c_m^2). Spread over the wall as a
             parabola, that volume lowers the apex by 2 dV / (pi a^2), a the limbus radius. In random scenes the apex
             was off by 0.4 to 2.5 times that, the most in deep dents; more than SUNK of the apex's peak is said.
spot         a load whose half width is below NARROW spacings: its force is whole (`taichi_eye.eye.puff`), but the dent
             under it is as wide as the elements are.
ring         the apex swings to and fro, SWINGS times or more by at least SWING of its peak: a shell without damping
             after its snap, or what follows a hard blow. Frequencies are off by what spacing and compression leave,
             and after many periods two settings are out of step, so that at one and the same time they differ by the
             whole swing, while peak and first times agree.
unseen       the puff comes and goes between two samples: its impulse acts whole, its column in the traces misses it.
"""

from collections.abc import Mapping

import numpy as np

from taichi_eye.solver.case import Case
from taichi_eye.solver.guards import energy_floor
from taichi_eye.units import MM, MS

BALANCE = 0.02  # of the puff's work
SUNK = 0.02  # of the peak of the apex
AIMED = 0.005  # the share of it that the sound speed is recommended for
NARROW = 1.2  # spacings, half width at 1/e of the load
SWING, SWINGS = 0.05, 3  # of the peak of the apex, and how often it turns back by so much
UNSEEN = 0.02  # of the puff's impulse, that the samples' trapezoids miss


def doubts(case: Case, traces: Mapping[str, np.ndarray]) -> list[str]:
    """What the traces of a case are to be doubted for; empty where nothing is."""
    said = (judge(case, traces) for judge in (_energy, _compression, _spot, _ring, _unseen))
    return [sentence for sentence in said if sentence]


def _peak_mm(traces) -> float:
    return float(np.abs(traces["apex_displacement_mm"]).max())


def _energy(case, traces) -> str:
    work, off = (float(np.abs(traces[name]).max()) * 1e-6 for name in ("puff_work_uj", "energy_error_uj"))
    if off <= BALANCE * work or off <= energy_floor(case):
        return ""
    amount = f"by {100.0 * off / work:.1f} % of the puff's work" if off < work else "by more than all work of the puff"
    slip = ', or use numerics.wall_condition = "slip"' if case.scheme.no_slip else ""
    return f"the energy balance is off {amount}: lower numerics.spacing_mm{slip}"


def _compression(case, traces) -> str:
    eye, scheme = case.eye, case.scheme
    if case.scene.numerics.fidelity != "mfpm" or not eye.liquid.sealed:
        return ""
    given_way = float(np.abs(traces["chamber_volume_error"]).max()) * eye.section.volume()
    sunk_mm = 2.0 * given_way / (np.pi * eye.section.limbus_radius**2) / MM
    peak_mm = _peak_mm(traces)
    if sunk_mm <= SUNK * peak_mm:
        return ""
    share = sunk_mm / peak_mm
    return (
        f"the liquid gave way by {given_way / MM**3:.2g} mm^3, which lowers the apex by some {1e3 * sunk_mm:.2g} um "
        f"of its {1e3 * peak_mm:.3g} um: raise numerics.mean_sound_speed_m_s (now {scheme.mean_sound_speed:.4g}) to "
        f"{scheme.mean_sound_speed * np.sqrt(share / AIMED):.4g}, or numerics.sound_speed_m_s"
    )


def _spot(case, traces) -> str:
    narrowest = 1.0 / np.sqrt(case.eye.puff.radial_rate) if case.eye.puff.radial_rate > 0.0 else np.inf
    if narrowest >= NARROW * case.scheme.spacing or not np.any(traces["puff_work_uj"]):
        return ""
    return (
        f"the load is {narrowest / MM:.2g} mm wide and the elements {case.scheme.spacing / MM:.2g} mm: the dent under "
        f"it is that of the elements; lower numerics.spacing_mm to {narrowest / NARROW / MM:.2g}"
    )


def _ring(case, traces) -> str:
    apex, time = traces["apex_displacement_mm"], traces["time_ms"]
    turns = turning_points(apex, SWING * _peak_mm(traces))
    # the rise is the puff's own, and so is the way back, the largest of the swings
    swings = np.sort(np.abs(np.diff(apex[turns[1:]])))[:-1]
    if len(swings) < SWINGS:
        return ""
    return (
        f"the apex rings, {len(swings)} swings of up to {swings[-1]:.2g} mm from {time[turns[1]]:.3g} ms on: two "
        "settings of numerics.spacing_mm or numerics.sound_speed_m_s fall out of step there, so take no times or "
        "velocities from it; damp it (cornea.viscoelastic_share, chamber.globe_delay_ms) or compare two settings"
    )


def turning_points(values: np.ndarray, least: float) -> list[int]:
    """Where values turn back by more than `least`: the numbers of the extremes between two such turns, first value and
    last extreme included."""
    turns, way, best = [0], 0, 0
    for number, value in enumerate(values):
        gone = value - values[best]
        if way == 0:
            if abs(gone) > least:
                way, best = (1 if gone > 0.0 else -1), number
        elif way * gone > 0.0:
            best = number
        elif -way * gone > least:
            turns.append(best)
            way, best = -way, number
    return [*turns, best] if best != turns[-1] else turns


def _unseen(case, traces) -> str:
    time = traces["time_ms"] * MS
    whole = case.eye.puff.impulse_at_apex(time)
    seen = 0.5 * np.diff(time) * (traces["puff_apex_kpa"][1:] + traces["puff_apex_kpa"][:-1]) * 1e3
    if np.abs(seen - whole).sum() <= UNSEEN * np.abs(whole).sum():
        return ""
    return (
        "the puff is shorter than what lies between two rows of the traces: it acts with its whole impulse, "
        "but puff_apex_kpa does not show it"
    )
