"""Corners: odd scenes of which each must either be right or stop with the right diagnosis.

A run that got to its end is held against the same scene at a finer spacing, a smaller time step, iterated coupling and
the quadratic basis. It failed in silence where its apex history is more than `APART` of the peak off, or the energy it
stores or dissipates exceeds the work by more than `GAIN`. A stopped run must name the cause that the scene was built to
have.
"""

import numpy as np

from taichi_eye.proof.maps.result import Map, finish, panels
from taichi_eye.proof.maps.runs import run

APART, GAIN = 0.03, 0.15
FINER = {
    "numerics.spacing_mm": 0.2,
    "numerics.cfl": 0.6,
    "numerics.basis": "quadratic",
    "numerics.coupling": "iterated",
    "numerics.dissipation": 0.5,
}
# name: keys, and the words of which a stop must hold one; "" where the run may get to its end
CORNERS = {
    "default": ({}, ("",)),
    "very coarse": ({"numerics.spacing_mm": 0.5}, ("",)),
    "low c": ({"numerics.sound_speed_m_s": 2.0}, ("",)),
    "low c, deep": ({"numerics.sound_speed_m_s": 1.0, "puff.peak_kpa": 20.0}, ("back", "cross")),
    "loose": ({"numerics.coupling": "loose"}, ("",)),
    "thin wall, loose, cfl 1": (
        {"numerics.coupling": "loose", "cornea.thickness_mm": 0.05, "numerics.cfl": 1.0},
        ("",),
    ),
    "thin and light wall": ({"cornea.thickness_mm": 0.05, "cornea.density_kg_m3": 100.0}, ("",)),
    "cubic": ({"numerics.basis": "cubic"}, ("",)),
    "no dissipation": ({"numerics.dissipation": 0.0}, ("energy",)),
    "dissipation 0.2": ({"numerics.dissipation": 0.2}, ("energy",)),
    "cfl 1.8": ({"numerics.cfl": 1.8}, ("energy",)),
    "no slip on coarse nodes": ({"numerics.wall_condition": "no_slip"}, ("",)),
    "the same, 50 ms": ({"numerics.wall_condition": "no_slip", "numerics.duration_ms": 50.0}, ("energy",)),
    "deep dent": ({"puff.peak_kpa": 80.0}, ("",)),
    "deep dent, soft eye": ({"puff.peak_kpa": 80.0, "eye.iop_mmhg": 3.0}, ("energy", "cross", "back")),
    "fast puff": ({"puff.duration_ms": 5.0, "numerics.duration_ms": 8.0}, ("",)),
    "fast puff, soft eye": ({"puff.duration_ms": 5.0, "numerics.duration_ms": 12.0, "eye.iop_mmhg": 3.0}, ("slack",)),
    "long after": ({"numerics.duration_ms": 60.0}, ("",)),
    "syrup, 100 mPa s": ({"aqueous.viscosity_mpa_s": 100.0}, ("",)),
    "tar, 1000 mPa s": ({"aqueous.viscosity_mpa_s": 1000.0}, ("viscosity",)),
    "fast puff, long ringing": ({"puff.duration_ms": 5.0, "numerics.duration_ms": 16.0}, ("energy",)),
    "one sweep": ({"numerics.coupling_iterations_max": 1}, ("converge",)),
}


def corners(say=print) -> Map:
    """Every corner once, and again finer where it ran to its end."""
    body, broken, figures, apart_of, gain_of = [], [], {}, {}, {}
    for name, (keys, causes) in CORNERS.items():
        each = run(keys)
        if each.stop is None:
            finer = run({**keys, **FINER})
            common = min(len(each.traces["time_ms"]), len(finer.traces["time_ms"]))
            history, other = (o.traces["apex_displacement_mm"][:common] for o in (each, finer))
            apart_of[name] = float(np.sqrt(np.mean((history - other) ** 2)) / other.max())
            work = np.abs(each.traces["puff_work_uj"]).max()
            gain_of[name] = float((each.traces["energy_error_uj"] - each.traces["viscous_loss_uj"]).max() / work)
            outcome = (
                f"ran: {100 * apart_of[name]:.2f} % from the finer run, energy gained {100 * gain_of[name]:.2g} %"
                + (f"; the finer run: {finer.stop.what}" if finer.stop else "")
            )
            if apart_of[name] > APART or gain_of[name] > GAIN:
                broken.append(f"{name}: {outcome}")
        else:
            outcome = f"stopped: {each.stop.what} at {each.stop.time_ms:.2f} ms"
        if not any(word in each.stop.what if each.stop else word == "" for word in causes if word or not each.stop):
            broken.append(f"{name}: {outcome}; expected {' or '.join(word or 'to run' for word in causes)}")
        body.append(
            (
                name,
                ", ".join(f"{key} {value}" for key, value in keys.items()),
                f"{each.apex.peak:.3f}",
                outcome,
                each.stop.advice if each.stop else "",
            )
        )
        figures[name] = outcome
        say(f"  {name}: {outcome}")
    canvas, ((axes,),) = panels(1, width=8.0)
    names = list(apart_of)
    axes.barh(
        np.arange(len(names)) - 0.2,
        [100 * apart_of[n] for n in names],
        0.38,
        color="#14539a",
        label="apex history off the finer run, rms over peak",
    )
    axes.barh(
        np.arange(len(names)) + 0.2,
        [100 * max(gain_of[n], 1e-6) for n in names],
        0.38,
        color="#c9641a",
        label="energy gained over work",
    )
    axes.axvline(100 * APART, color="#22262b", linewidth=1, linestyle=":", label="history: silent failure beyond")
    axes.set_yticks(np.arange(len(names)), names)
    finish(axes, "corners that ran to their end", "%", "", log="x", legend="upper left")
    axes.set_ylim(len(names) - 0.4, -2.4)
    stopped = sum("stopped" in line for line in figures.values())
    found = [
        f"{len(CORNERS)} corners: {stopped} stopped, {len(names)} ran to their end, "
        f"{len(broken)} failed in silence or with "
        "the wrong diagnosis."
    ]
    return Map(
        "corners", canvas, found, ("corner", "keys", "peak, mm", "what became of it", "advice"), body, figures, broken
    )
