"""summary.json, the last of a run's files: what came out, what it may be doubted for, how long it took."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from taichi_eye.provenance import provenance
from taichi_eye.recording.observer import Observer
from taichi_eye.report.compare import differences
from taichi_eye.report.folder import write_text
from taichi_eye.report.history import summarise
from taichi_eye.solver.doubts import doubts
from taichi_eye.units import MM, MS

if TYPE_CHECKING:
    from taichi_eye.analysis.error_bar import ErrorBar


class Summary(Observer):
    """Makes `Recording.summary` and writes it."""

    def closed(self, ending) -> None:
        recording = self.recording
        recording.summary = summary = summary_of(recording, ending)
        write_text(recording.folder / "summary.json", json.dumps(summary, indent=2) + "\n")


def summary_of(recording, ending) -> dict:
    """What summary.json holds of a run that has ended."""
    traces, history, simulation = ending.traces, ending.history, recording.simulation
    clock = recording.clock | {"total_s": recording.elapsed_s()}
    load = summarise(traces["time_ms"], traces["puff_apex_kpa"])
    retreat_mm = simulation.eye.retreat(traces["time_ms"] * MS) / MM
    whole = summarise(traces["time_ms"], traces["apex_displacement_mm"] + retreat_mm)
    work = float(np.abs(traces["puff_work_uj"]).max())
    apex = {
        **asdict(history),
        "fwhm_ms": history.fwhm_ms,
        "fall_to_rise": history.fall_to_rise,
        "delay_to_puff_ms": history.peak_time_ms - load.peak_time_ms if history.peak > 0 else None,
    }
    summary = {
        "status": "complete" if ending.stop is None else "stopped",
        "reason": None if ending.stop is None else (str(ending.stop) or "interrupted"),
        "simulated_ms": float(traces["time_ms"][-1]),
        "apex_displacement_mm": apex,
        "apex_deformation_mm": {"peak": whole.peak, "peak_time_ms": whole.peak_time_ms},
        "fluid_pressure_apex_max_kpa": float(traces["fluid_pressure_apex_kpa"].max()),
        "cornea_min_stress_kpa": float(traces["cornea_min_stress_kpa"].min()),
        "chamber_volume_error_max": float(np.abs(traces["chamber_volume_error"]).max()),
        "energy_error_share_of_work": float(np.abs(traces["energy_error_uj"]).max()) / work if work > 0 else 0.0,
        "fidelity": recording.scene.numerics.fidelity,
        **simulation.facts(),
        "provenance": provenance(),
        "wall_clock": {name: round(seconds, 3) for name, seconds in clock.items()},
    }
    summary["warnings"] = doubts(simulation.case, traces)
    if recording.measured is not None:
        measured = recording.measured
        summary["warnings"] += [f"--compare {measured.name}: {note}" for note in measured.notes]
        summary["against"] = {
            "file": measured.name,
            **differences(traces["time_ms"], traces["apex_displacement_mm"], measured),
        }
    if recording.error_bar is not None:
        summary |= _error_bar(recording.error_bar)
    summary["warnings"] += recording.notes
    if recording.choice is not None:
        summary["choice"] = recording.choice
        summary["warnings"] += recording.choice["doubts"]
    return summary


def _error_bar(bar: ErrorBar) -> dict:
    """The clinical parameters, and beside every figure its numerical error and its extrapolated value."""
    numerics = bar.twin.scene.numerics

    def beside(kind: str) -> dict:
        blocks = {"apex_displacement_mm": bar.apex, "apex_deformation_mm": bar.deformation, "response": bar.response}
        return {name: getattr(block, kind) for name, block in blocks.items()}

    return {
        "response": bar.response.values,
        "numerical_error": {**beside("errors"), "apex_history_mm": float(bar.band_mm.max())},
        "extrapolated": beside("extrapolated"),
        "twin": {
            "spacing_mm": numerics.spacing_mm,
            "sound_speed_m_s": numerics.sound_speed_m_s if numerics.fidelity == "mfpm" else None,
            "ratio": bar.twin.ratio,
        },
    }
