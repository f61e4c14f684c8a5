"""A small population of simulated eyes, and how their response goes with pressure and thickness.

The eyes differ from a scene's in intraocular pressure and thickness alone, the rim's along with the centre's, crossed
and spread like those of the 194 living eyes (SD 2.8 mmHg, 31 um). A globe's compliance falls as one over its pressure
(Friedenwald), so it does along the eyes. Like is compared with like: each eye has the IOPnct that the instrument would
show from its A1 time, and slopes are those of a plane over (IOPnct, thickness), as with the living eyes; slopes with
thickness are thus at equal A1 time. The A1 time itself goes over (IOP, thickness). An eye whose run a guard stopped
counts with none of its figures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.response import Response
from taichi_eye.analysis.simulated import Observed, observe, observe_many
from taichi_eye.scene import Scene
from taichi_eye.scene.variant import eye_at

IOP_STEPS_MMHG = -4.0, -2.0, 0.0, 2.0, 4.0
THICKNESS_STEPS_UM = -38.0, 0.0, 38.0


@dataclass(frozen=True, eq=False)
class SimulatedEye:
    """An eye of the population; observed: its curves, to be read once more with other windows."""

    iop_mmhg: float
    thickness_um: float
    observed: Observed
    response: Response
    stopped: str = ""


def simulate(scene: Scene, iop_mmhg: float, thickness_um: float) -> SimulatedEye:
    """Run the scene's eye at a pressure and a thickness."""
    observed = observe(eye_at(scene, iop_mmhg, thickness_um))
    reading = observed.read()
    return SimulatedEye(iop_mmhg, thickness_um, observed, reading.response, reading.stopped)


def simulate_many(scene: Scene, places: Sequence[tuple[float, float]]) -> list[SimulatedEye]:
    """The same at several pressures and thicknesses, those of the full model side by side."""
    found = []
    for (iop, thickness), observed in zip(places, observe_many([eye_at(scene, *place) for place in places])):
        reading = observed.read()
        found.append(SimulatedEye(iop, thickness, observed, reading.response, reading.stopped))
    return found


def crossed(scene: Scene) -> list[tuple[float, float]]:
    """Pressure [mmHg] and thickness [um] of every eye of the population about a scene."""
    iop, thickness = scene.eye.iop_mmhg, 1e3 * scene.cornea.thickness_mm
    return [(iop + rise, thickness + more) for more in THICKNESS_STEPS_UM for rise in IOP_STEPS_MMHG]


def starred(scene: Scene) -> list[tuple[float, float]]:
    """The fewest eyes that show both slopes about a scene: its own, then the ends of the two lines through it."""
    iop, thickness = scene.eye.iop_mmhg, 1e3 * scene.cornea.thickness_mm
    along = [(iop + rise, thickness) for rise in (min(IOP_STEPS_MMHG), max(IOP_STEPS_MMHG))]
    across = [(iop, thickness + more) for more in (min(THICKNESS_STEPS_UM), max(THICKNESS_STEPS_UM))]
    return [(iop, thickness), *along, *across]


def slopes(
    eyes: Iterable[SimulatedEye], name: str, read: Callable[[SimulatedEye], Response] = lambda eye: eye.response
) -> tuple[float, float]:
    """Of a parameter per mmHg (of IOPnct; of IOP for the A1 time) and per 10 um; NaN where too few eyes show it."""
    rows, values = [], []
    for eye in eyes:
        response = read(eye)
        pressure = eye.iop_mmhg if name == "a1_time_ms" else response.iop_nct_mmhg
        value = getattr(response, name)
        if not eye.stopped and pressure is not None and value is not None:
            rows.append((pressure, 0.1 * eye.thickness_um, 1.0))
            values.append(value)
    if len(rows) < 3:
        return float("nan"), float("nan")
    plane = np.array(rows) - [*np.mean(rows, axis=0)[:2], 0.0]
    fit, _, rank, _ = np.linalg.lstsq(plane, np.array(values), rcond=1e-9)
    return (float(fit[0]), float(fit[1])) if rank == 3 else (float("nan"), float("nan"))


def shown_by(eyes: Sequence[SimulatedEye], name: str) -> list[tuple[float, float]]:
    """The eyes that ran to their ends as pairs of bIOP and a parameter, in the order of their bIOP."""
    return sorted(
        (eye.response.biop_mmhg, getattr(eye.response, name))
        for eye in eyes
        if not eye.stopped and eye.response.biop_mmhg is not None and getattr(eye.response, name) is not None
    )


def at_biop(eyes: Sequence[SimulatedEye], name: str, biop_mmhg: float) -> float | None:
    """A parameter at a bIOP, on straight lines between eyes of one thickness; None beyond what they show."""
    pairs = shown_by(eyes, name)
    if not pairs or not pairs[0][0] <= biop_mmhg <= pairs[-1][0]:
        return None
    return float(np.interp(biop_mmhg, *zip(*pairs)))
