"""What was measured on living eyes with the Corvis ST, as far as the claims need it. Times in ms from the first frame.

Puff. Time course measured and fitted as in `taichi_eye.eye.puff` (rms 1.7 %); central pressure 96.4 +- 1.4 mmHg
(Oehring 2021, doi 10.3390/app11062499).

Eyes. Apex and edge displacement of three eyes, digitised from published Corvis ST plots (0.0165 mm a pixel, 0.231 ms a
frame); the edges, +-4 mm from the apex, follow the whole eye. Deformation: of the apex. Deflection: deformation less
the retreat of the whole eye. Measured with `taichi_eye.proof.measures`; the three spread by about 0.2 ms. The eyes and
the puff were recorded apart, so a common offset of a few tenths of a ms between their clocks cannot be excluded; it
drops out of the difference between deformation and deflection. At the one frame where the digitised fit and its
published error meet, the inward speed jumps, so speeds are not used.

Slopes. Over 194 eyes (open data, linear in bIOP and thickness), e.g. of the deformation amplitude -0.031 mm per mmHg
and -0.0095 mm per 10 um of thickness.
"""

import numpy as np

# peak [mm], time of the peak, 50 % midpoint, centroid, (fall - peak)/(peak - rise), odd part: three eyes
DEFORMATION = {
    "peak": (1.007, 1.203, 1.250),
    "peak_time": (17.12, 17.53, 17.32),
    "midpoint": (14.95, 14.80, 15.00),
    "centroid": (15.58, 15.51, 15.80),
    "fall_to_rise": (0.46, 0.40, 0.45),
    "odd_share": (0.098, 0.090, 0.097),
}
DEFLECTION = {
    "peak": (0.828, 0.957, 0.984),
    "peak_time": (15.11, 15.44, 15.47),
    "midpoint": (14.79, 14.45, 14.59),
    "centroid": (14.72, 14.57, 14.63),
    "fall_to_rise": (0.89, 0.72, 0.74),
    "odd_share": (0.071, 0.054, 0.060),
}
# retreat of the whole eye [mm], mean of the three
WHOLE_EYE_MS = 0.0, 3.0, 5.5, 7.5, 9.0, 12.0, 15.0, 17.0, 19.0, 20.0, 21.0, 22.0, 23.0, 26.0, 28.0, 30.0, 32.0
WHOLE_EYE_MM = (
    0.0,
    0.011,
    0.023,
    0.076,
    0.114,
    0.134,
    0.179,
    0.253,
    0.334,
    0.351,
    0.327,
    0.290,
    0.268,
    0.190,
    0.094,
    0.040,
    0.030,
)
AMPLITUDE_PER_MMHG = -0.031  # mm
AMPLITUDE_PER_10_UM = -0.0095  # mm
# of the parameters of `taichi_eye.analysis.Response`: per mmHg, per 10 um
SLOPES = {
    "deformation_amplitude_mm": (AMPLITUDE_PER_MMHG, AMPLITUDE_PER_10_UM),
    "a1_velocity_m_s": (-0.0072, -0.0024),
    "a2_velocity_m_s": (0.0078, 0.0016),
    "peak_distance_mm": (-0.094, -0.022),
    "hc_radius_mm": (0.074, 0.117),
    "da_ratio_2mm": (-0.095, -0.077),
    "integrated_inverse_radius_per_mm": (-0.244, -0.179),
    "sp_a1_mmhg_mm": (4.28, 3.28),
}
PUFF_SPREAD = 1.4 / 96.4  # standard deviation of the puff's pressure over its mean


def whole_eye(time_ms) -> np.ndarray:
    """Mean retreat [mm] of the whole eye at the given times [ms]."""
    return np.interp(time_ms, WHOLE_EYE_MS, WHOLE_EYE_MM)
