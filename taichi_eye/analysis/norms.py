"""Published DCR parameters of healthy corneas, mean and standard deviation, and z-scores against them.

elderly: 194 eyes, computed from openly available data (MIT licence), IOP 16.6 +- 2.8 mmHg, thickness 551 +- 31 um.
iran: 652 eyes (PMC7001013), 16.8 +- 2.9 mmHg, 531 +- 31 um. china: controls of Tian 2014, 546 +- 30 um.
"""

from __future__ import annotations

from taichi_eye.analysis.response import Response

NORMS: dict[str, dict[str, tuple[float, float]]] = {
    "elderly": {
        "a1_velocity_m_s": (0.137, 0.022),
        "a2_velocity_m_s": (-0.264, 0.034),
        "deformation_amplitude_mm": (1.058, 0.108),
        "peak_distance_mm": (4.83, 0.32),
        "hc_radius_mm": (8.09, 1.06),
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
        "hc_radius_mm": (7.35, 1.39),
        "central_thickness_um": (531.0, 31.0),
    },
    "china": {
        "a1_time_ms": (7.52, 0.43),
        "a1_velocity_m_s": (0.15, 0.03),
        "a2_time_ms": (22.18, 0.52),
        "a2_velocity_m_s": (-0.39, 0.08),
        "hc_time_ms": (16.72, 0.49),
        "hc_radius_mm": (7.52, 1.05),
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
