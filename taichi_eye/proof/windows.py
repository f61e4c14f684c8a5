"""How much of a corneal response is its definition: the same simulated eyes read with other windows.

zones     the half width of the circle whose flatness is applanation and whose curvature is HC radius and IR.
speeds    velocity at an applanation as the difference over so many frames before and after, straight between frames,
          beside the local quadratic of `taichi_eye.analysis.response`.

The program of the instrument is not public, so neither window is known; where a parameter or its slope hangs on one, a
difference of that size from the norms says nothing about the eye.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.response import histories
from taichi_eye.proof.population import SimulatedEye, slopes

ZONES_MM = 0.75, 1.0, 1.25, 1.5, 2.0
FRAMES = 1, 2, 3, 4, 5
ZONE_PARAMETERS = (
    "a1_time_ms",
    "a1_velocity_m_s",
    "a1_deflection_mm",
    "a2_time_ms",
    "hc_radius_mm",
    "integrated_inverse_radius_per_mm",
    "sp_a1_mmhg_mm",
)


@dataclass(frozen=True)
class ZoneRow:
    """Parameters of the scene's own eye over a zone, and two slopes of the population: A1 time (ms per mmHg of IOP) and
    A1 velocity (m/s per mmHg of IOPnct)."""

    zone_mm: float
    values: dict[str, float | None]
    a1_time_per_mmhg: float
    a1_velocity_per_mmhg: float


@dataclass(frozen=True)
class SpeedRow:
    """Velocities [m/s] of the scene's own eye as differences over +-frames; None where an applanation is missing."""

    frames: int
    a1_velocity_m_s: float | None
    a2_velocity_m_s: float | None


def zones(own: SimulatedEye, eyes: Sequence[SimulatedEye]) -> list[ZoneRow]:
    """The eyes read once more over every zone."""
    rows = []
    for zone in ZONES_MM:
        kept = {
            id(eye): eye.observed.read(curvature_mm=zone, inverse_mm=zone).response
            for eye in {id(e): e for e in (own, *eyes)}.values()
        }
        read = lambda eye, kept=kept: kept[id(eye)]
        rows.append(
            ZoneRow(
                zone,
                {name: getattr(kept[id(own)], name) for name in ZONE_PARAMETERS},
                slopes(eyes, "a1_time_ms", read)[0],
                slopes(eyes, "a1_velocity_m_s", read)[0],
            )
        )
    return rows


def speeds(own: SimulatedEye) -> list[SpeedRow]:
    """The scene's own eye, its velocities as plain differences."""
    if own.observed.curves is None:
        return [SpeedRow(frames, None, None) for frames in FRAMES]
    history, interval = histories(own.observed.curves), own.observed.scene.camera.frame_interval_ms
    apex = lambda at: float(np.interp(at, history.time_ms, history.apex_mm))

    def speed(at: float | None, late: float) -> float | None:
        return None if at is None else (apex(at + late) - apex(at - late)) / (2.0 * late)

    return [
        SpeedRow(
            frames,
            speed(own.response.a1_time_ms, frames * interval),
            speed(own.response.a2_time_ms, frames * interval),
        )
        for frames in FRAMES
    ]
