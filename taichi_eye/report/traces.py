"""traces.csv, the history of a run, one row per recorded time, and wall.npz, the membrane at every frame."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

import numpy as np

from taichi_eye.report.folder import replacing

COLUMNS = (
    "time_ms",
    "apex_displacement_mm",  # inward positive
    "apex_velocity_m_s",  # inward positive
    "puff_apex_kpa",  # load on the apex
    "fluid_pressure_apex_kpa",  # gauge pressure of the fluid under the apex
    "chamber_volume_error",  # volume less that at rest, over it; what left where fluid may leave
    "puff_work_uj",  # work of the puff since t = 0
    "cornea_elastic_uj",
    "cornea_kinetic_uj",
    "aqueous_kinetic_uj",
    "aqueous_elastic_uj",
    "viscous_loss_uj",  # lost to viscosity since t = 0
    "numerical_loss_uj",  # lost to the dissipation of the scheme since t = 0
    "outflow_loss_uj",  # carried off by fluid that left an open chamber since t = 0
    "tissue_loss_uj",  # to the relaxing part of the cornea's stress and the globe's delay since t = 0
    "energy_error_uj",  # work in, less what is stored, less what is lost
    "coupling_iterations",
    "coupling_residual",
    "cornea_min_stress_kpa",  # smallest principal stress in the wall; slack at 0
)
WHOLE = ("coupling_iterations",)


def write_traces(path: Path, traces: Mapping[str, np.ndarray]) -> None:
    """Write the columns COLUMNS, arrays of one length [samples], to full precision; the file is whole or absent."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(COLUMNS)
        _write_rows(file, traces, 0)


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write a table of columns of one length to full precision; the file is whole or absent."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True))


def append_traces(path: Path, traces: Mapping[str, np.ndarray], first: int) -> None:
    """Add the rows from `first` on to a file of `write_traces`."""
    with open(path, "a", encoding="utf-8", newline="") as file:
        _write_rows(file, traces, first)


def _write_rows(file: TextIO, traces: Mapping[str, np.ndarray], first: int) -> None:
    columns = [np.asarray(traces[name])[first:].astype(int if name in WHOLE else float).tolist() for name in COLUMNS]
    csv.writer(file, lineterminator="\n").writerows(zip(*columns, strict=True))


def read_traces(path: Path) -> dict[str, np.ndarray]:
    """Read what `write_traces` wrote, bit for bit: float64 arrays by column, int64 for counts.

    ValueError where a row is cut, a cell is no number, or one of a count is no whole one.
    """
    with open(path, encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    if any(len(row) != len(header) for row in rows):
        raise ValueError("a row is cut")
    columns = {name: np.array([row[i] for row in rows], dtype=float) for i, name in enumerate(header)}
    for name in set(WHOLE) & set(columns):
        if not (columns[name] == np.trunc(columns[name])).all() or not (np.abs(columns[name]) < 2**53).all():
            raise ValueError(f"{name} holds what is no count")
        columns[name] = columns[name].astype(int)
    return columns


def write_wall(path: Path, time_ms: np.ndarray, places_mm: np.ndarray) -> None:
    """Write the membrane's nodes at the film's frames: time_ms [frames], places (r, z) [frames, nodes, 2] in mm.

    The file holds time_ms, r_mm and z_mm, apex first, and is whole or absent.
    """
    with replacing(path) as temporary:
        np.savez_compressed(temporary, time_ms=time_ms, r_mm=places_mm[:, :, 0], z_mm=places_mm[:, :, 1])
