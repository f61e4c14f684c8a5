"""Films with full optics and noise, encoded and decoded, read back: edges, histories, parameters, thickness.

Ten eyes that differ in shape, thickness, depth, width and speed of the dent, retreat and place in the frame; some with
several seeds of noise. Each row is the worst over all films. Edges: central 7 mm, against the wall that was drawn.
Apex: of the smoothed history against the true one treated alike. Thickness: mean of the central 1.2 mm; at rest the
mean of the first 3 ms; through the puff the largest departure of a single frame from that mean.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.analysis import analyze, histories, respond
from taichi_eye.bench.rows import Row, at_least, at_most, figure
from taichi_eye.proof.films.eyes import EYES, INTERVAL_MS, Studio, rows_px, truth, write_film

SEEDS = {0: (1, 2, 3), 6: (1, 2, 3), 9: (1, 2, 3)}  # of the eyes by number; one seed for the others
FILMS = tuple((number, seed) for number in range(len(EYES)) for seed in SEEDS.get(number, (1,)))
CENTRAL_MM = 3.5
BIOP_MMHG = 15.0
# name, field of Response, unit, limit; shares in %
PARAMETERS = (
    ("amplitude (DA)", "deformation_amplitude_mm", "um", 10.0),
    ("A1 time", "a1_time_ms", "ms", 0.12),
    ("HC time", "hc_time_ms", "ms", 0.12),
    ("A2 time", "a2_time_ms", "ms", 0.12),
    ("A1 velocity", "a1_velocity_m_s", "%", 5.0),
    ("A2 velocity", "a2_velocity_m_s", "%", 5.0),
    ("DA ratio, 2 mm", "da_ratio_2mm", "%", 2.0),
    ("DA ratio, 1 mm", "da_ratio_1mm", "%", 2.0),
    ("peak distance", "peak_distance_mm", "%", 2.0),
    ("HC radius", "hc_radius_mm", "%", 3.0),
    ("integrated inverse radius", "integrated_inverse_radius_per_mm", "%", 3.0),
    ("HC deflection area", "hc_deflection_area_mm2", "%", 3.0),
    ("HC delta arc length", "hc_delta_arc_length_mm", "%", 5.0),
    ("A1 length", "a1_length_mm", "mm", 0.15),
    ("A2 length", "a2_length_mm", "mm", 0.15),
)
# the others: their errors are listed
LISTED = (
    ("A1 deflection", "a1_deflection_mm", "um"),
    ("A2 deflection", "a2_deflection_mm", "um"),
    ("HC deflection", "hc_deflection_mm", "um"),
    ("A1 deflection area", "a1_deflection_area_mm2", "%"),
    ("A2 deflection area", "a2_deflection_area_mm2", "%"),
    ("A1 delta arc length", "a1_delta_arc_length_mm", "%"),
    ("A2 delta arc length", "a2_delta_arc_length_mm", "%"),
    ("largest inverse radius", "max_inverse_radius_per_mm", "%"),
    ("SP-A1", "sp_a1_mmhg_mm", "%"),
    ("whole-eye movement", "whole_eye_movement_mm", "um"),
    ("its time", "whole_eye_movement_time_ms", "ms"),
)
SCALE = {"um": 1e3, "ms": 1.0, "mm": 1.0}


def difference(measured, true, name: str, unit: str) -> float:
    """|measured - true| of a parameter in its unit, or in % of the true one; infinite where it was not found."""
    read, exact = getattr(measured, name), getattr(true, name)
    if read is None and exact is None:
        return 0.0  # rightly left blank: an eye that does not retreat
    if read is None or exact is None:
        return float("inf")
    return abs(read / exact - 1.0) * 100.0 if unit == "%" else abs(read - exact) * SCALE[unit]


def read_back(studio: Studio, eye, seed: int, folder: Path) -> dict[str, float]:
    """Errors of one film by row."""
    scene = eye.scene(f"camera.seed={seed}")
    result = analyze(write_film(studio.frames(eye, scene), folder / "eye.mp4"), write=False, biop_mmhg=BIOP_MMHG)
    exact = truth(eye, scene)
    true = respond(exact, INTERVAL_MS, BIOP_MMHG)
    camera = scene.camera
    middle = np.abs(np.arange(camera.width_px) - camera.apex_column_px) * camera.pixel_x_mm <= CENTRAL_MM
    off = np.abs(result.edges.anterior - rows_px(eye, scene))[:, middle]
    found = {
        "edge RMS": float(np.sqrt(np.nanmean(off**2))),
        "edge within 1.5 px": 100.0 * float((off <= 1.5).mean()),
        "apex RMS": 1e3 * float(np.sqrt(np.mean((result.histories.apex_mm - histories(exact).apex_mm) ** 2))),
    }
    found |= {name: difference(result.response, true, field, unit) for name, field, unit, _ in PARAMETERS}
    found |= {name: difference(result.response, true, field, unit) for name, field, unit in LISTED}
    thickness, rest = 1e3 * result.curves.thickness_mm, result.response.central_thickness_um
    found["thickness at rest"] = abs(rest - 1e3 * scene.cornea.thickness_mm)
    found["thickness through the puff"] = float(np.abs(thickness - rest).max())
    return found


def worst(films: list[tuple[str, dict[str, float]]], name: str, unit: str, limit: float, least: bool = False) -> Row:
    """The row of a quantity: its worst value over the films, named in the note."""
    pick = min if least else max
    label, errors = pick(films, key=lambda film: film[1][name])
    middle = float(np.median([errors[name] for _, errors in films]))
    note = f"{len(films)} films, median {middle:.3g}; worst: {label}"
    return (at_least if least else at_most)(name, errors[name], unit, limit, note)


def measure(stage, which=FILMS) -> tuple[list[Row], list[Figure]]:
    """Film and read eyes: pairs of an eye's number and a seed of the noise."""
    studio, films = Studio(), []
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in which:
            label = f"{EYES[number].name}, seed {seed}"
            stage(label)
            films.append((label, read_back(studio, EYES[number], seed, Path(folder))))
    limits = {
        "edge RMS": ("px", 0.5),
        "apex RMS": ("um", 6.0),
        **{name: (unit, limit) for name, _, unit, limit in PARAMETERS},
        "thickness at rest": ("um", 10.0),
        "thickness through the puff": ("um", 10.0),
    }
    rows = [worst(films, name, unit, limit) for name, (unit, limit) in limits.items()]
    for name, _, unit in LISTED:
        row = worst(films, name, unit, np.inf)
        rows.append(figure(name, row.value, unit, row.note))
    rows.insert(1, worst(films, "edge within 1.5 px", "%", 99.0, least=True))
    return rows, [_shares(films, limits)]


def _shares(films, limits) -> Figure:
    """Every film's error as a share of what is allowed."""
    share = np.array([[errors[name] / limits[name][1] for name in limits] for _, errors in films])
    canvas = Figure(figsize=(11.0, 0.28 * len(films) + 2.2), dpi=110, layout="constrained")
    axes = canvas.subplots()
    image = axes.imshow(share, vmin=0.0, vmax=1.0, cmap="YlOrRd", aspect="auto")
    axes.set_xticks(range(len(limits)), list(limits), rotation=40, ha="right", fontsize=8)
    axes.set_yticks(range(len(films)), [label for label, _ in films], fontsize=8)
    for (i, j), value in np.ndenumerate(share):
        axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=6, color="white" if value > 0.6 else "#333")
    canvas.colorbar(image, label="error / allowed")
    return canvas
