"""Published DCR parameters of healthy corneas, mean and standard deviation, and z-scores against them.

`POPULATIONS` says who was measured. The norms of the HC radius are held against the circle through both bending peaks
and the apex (`taichi_eye.analysis.response`). A parameter is judged by REFERENCE where that population gives it, else
by FALLBACK, one for all: never by the population that happens to lie nearest.
"""

from __future__ import annotations

from dataclasses import dataclass

from taichi_eye.analysis.response import Response


@dataclass(frozen=True)
class Population:
    """Whose eyes: a short name and the source; mean and SD of the pressure [mmHg], None where not known."""

    name: str
    source: str
    iop_mmhg: tuple[float, float] | None


POPULATIONS = {
    "elderly": Population(
        "194 elderly eyes",
        "194 elderly eyes, computed from openly available data (MIT licence); about 70 years old, IOPnct 16.6 +- 2.8 "
        "mmHg; A1 deflection as implied by their SP-A1",
        (16.6, 2.8),
    ),
    "iran": Population(
        "652 eyes, Iran 2020",
        "right eyes of 652 healthy candidates for refractive surgery, Iran (PMC7001013), 28 +- 5 years; their A2 time "
        "is an outlier among the published ones",
        (16.8, 2.9),
    ),
    "china": Population(
        "60 controls, Tian 2014",
        "60 healthy controls, China: Tian et al. 2014, J Ophthalmol 147516",
        None,
    ),
}
REFERENCE, FALLBACK = "elderly", "china"
# from the means of the 194 eyes, IOPnct 16.6, thickness 551 um and bIOP 14.75, by the surrogate
ELDERLY_AGE_YEARS = 70.0

NORMS: dict[str, dict[str, tuple[float, float]]] = {
    "elderly": {
        "a1_velocity_m_s": (0.137, 0.022),
        "a1_deflection_mm": (0.105, 0.0105),
        "a2_velocity_m_s": (-0.264, 0.034),
        "deformation_amplitude_mm": (1.058, 0.108),
        "peak_distance_mm": (4.83, 0.32),
        "hc_circle_radius_mm": (8.09, 1.06),
        "da_ratio_2mm": (4.08, 0.38),
        "integrated_inverse_radius_per_mm": (7.59, 1.00),
        "sp_a1_mmhg_mm": (114.0, 17.0),
        "central_thickness_um": (551.0, 31.0),
    },
    "iran": {
        "a1_time_ms": (7.36, 0.39),
        "a1_velocity_m_s": (0.12, 0.04),
        "a2_time_ms": (20.13, 0.48),
        "hc_time_ms": (16.84, 0.64),
        "deformation_amplitude_mm": (1.05, 0.10),
        "peak_distance_mm": (4.60, 1.01),
        "hc_circle_radius_mm": (7.35, 1.39),
        "central_thickness_um": (531.0, 31.0),
    },
    "china": {
        "a1_time_ms": (7.52, 0.43),
        "a1_velocity_m_s": (0.15, 0.03),
        "a2_time_ms": (22.18, 0.52),
        "a2_velocity_m_s": (-0.39, 0.08),
        "hc_time_ms": (16.72, 0.49),
        "hc_circle_radius_mm": (7.52, 1.05),
        "central_thickness_um": (546.0, 30.0),
    },
}


def z_scores(response: Response) -> dict[str, dict[str, float]]:
    """(value - mean)/SD of every parameter that has a norm: {parameter: {population: z}}."""
    scores: dict[str, dict[str, float]] = {}
    for population, norms in NORMS.items():
        for name, (mean, deviation) in norms.items():
            value = getattr(response, name)
            if value is not None:
                scores.setdefault(name, {})[population] = (value - mean) / deviation
    return scores


def judged_by(name: str) -> tuple[str, float, float] | None:
    """The population, mean and SD that a parameter is judged by; None where neither has it."""
    for population in (REFERENCE, FALLBACK):
        if name in NORMS[population]:
            return population, *NORMS[population][name]
    return None
