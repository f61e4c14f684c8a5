"""Wall: where the cornea goes slack over (IOP, peak, prestrain, duration), and whether the guard speaks in time.

Quasi-static theory: with prestrain eps0 the wall stays taut through an isometric inversion, so a slow puff slackens it
nowhere. Inertia does: a wall that a fast puff throws at v meets the strain v / c_w of a one-dimensional wave of speed c_w
(the in-plane wave at rest), and it is slack where that outgrows eps0.
"""
import numpy as np

from taichi_eye.proof.maps.result import Map, dots, finish, panels
from taichi_eye.proof.maps.runs import run, scene_with, unguarded
from taichi_eye.solver.simulation import Simulation

IOPS = (3.0, 5.0, 8.0, 15.0, 25.0, 40.0)
PEAKS = (5.0, 10.0, 20.0, 40.0, 80.0)
PRESTRAINS = (0.002, 0.005, 0.01, 0.02, 0.04, 0.06)
SLOW, FAST = 30.0, 5.0
BAD_ENERGY = 0.05  # of the work: from here on the numbers of an unguarded run are bad


def _puff(duration: float) -> dict:
    return {"puff.duration_ms": duration, "numerics.duration_ms": duration * 1.1}


def _fastest(outcome) -> float:
    return float(np.abs(outcome.traces["apex_velocity_m_s"]).max())


def wall(say=print) -> Map:
    """Runs over (IOP, peak) for a slow and a fast puff and over (prestrain, peak); one corner with and without guard."""
    canvas, ((slow, fast, strained), (scatter, late, ripple)) = panels(3, 2)
    every, broken = [], []
    for panel, duration in ((slow, SLOW), (fast, FAST)):
        cases = [(iop, peak, run({**_puff(duration), "eye.iop_mmhg": iop, "puff.peak_kpa": peak}))
                 for iop in IOPS for peak in PEAKS]
        every += cases
        dots(panel, [iop for iop, _, _ in cases], [peak for _, peak, _ in cases], [o.cause for _, _, o in cases])
        finish(panel, f"puff of {duration:g} ms", "IOP (mmHg)", "peak (kPa)", log="xy", legend="upper left")
        say(f"  puff of {duration:g} ms: " + ", ".join(f"IOP {iop:g}/{peak:g} kPa {o.cause} {o.stop.time_ms:.1f} ms"
                                                       for iop, peak, o in cases if o.stop))
    cases = [(eps, peak, run({**_puff(FAST), "cornea.prestrain": eps, "puff.peak_kpa": peak}))
             for eps in PRESTRAINS for peak in PEAKS]
    every += cases
    dots(strained, [eps for eps, _, _ in cases], [peak for _, peak, _ in cases], [o.cause for _, _, o in cases])
    finish(strained, f"puff of {FAST:g} ms, IOP 15 mmHg", r"prestrain $\epsilon_0$", "peak (kPa)", log="xy",
           legend="upper left")
    say("  prestrain: " + ", ".join(f"{eps:g}/{peak:g} kPa {o.cause} {o.stop.time_ms:.1f} ms"
                                    for eps, peak, o in cases if o.stop))
    return canvas, every
