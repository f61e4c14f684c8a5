"""What was measured on living eyes with the Corvis ST, as far as the claims need it. Times in ms from the first frame.

Puff. Time course measured and fitted as in `taichi_eye.eye.puff` (rms 1.7 %); central pressure 96.4 +- 1.4 mmHg
(Oehring 2021, doi 10.3390/app11062499).

Eyes. Apex and edge displacement of three eyes, digitised from published Corvis ST plots (0.0165 mm a pixel, 0.231 ms a
frame); the edges, +-4 mm from the apex, follow the whole eye. Deformation: of the apex. Deflection: deformation less
the retreat of the whole eye. Measured with `taichi_eye.proof.measures`; the three spread by about 0.2 ms. The eyes and
the puff were recorded apart, so a common offset of a few tenths of a ms between their clocks cannot be excluded; it
drops out of the difference between deformation and deflection. At the one frame where the digitised fit and its
published error meet, the inward speed jumps, so speeds are not used.

Slopes. Over 194 elderly eyes (openly available data, MIT licence). The instrument's bIOP contains the thickness itself
(R2 .98: `taichi_eye.analysis.response.biop_surrogate_mmhg`), so a slope with thickness at equal bIOP is for the most
part that formula's. `SLOPES` were regressed on what was measured, IOPnct and thickness (and age): slopes with thickness
there are at equal A1 time, those of DA, PD and both velocities zero. At equal bIOP the deformation amplitude has -0.031
mm per mmHg and -0.0095 mm per 10 um. The A1 time goes with the pressure of the eye by the surrogate's inverse.

Donor corneas, inflated slowly from 10 to 30 mmHg without a puff, rise 486 to 585 nm per mmHg (PMC7415307). Stiffened
donor sclerae lower DA and PD and leave SP-A1 as it was (PMC7044755).
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
# of the parameters of `taichi_eye.analysis.Response`: per mmHg of IOPnct and per 10 um of thickness, each with its
# standard error
SLOPES = {
    "deformation_amplitude_mm": ((-0.0278, 0.0019), (0.0001, 0.0017)),
    "a1_velocity_m_s": ((-0.0064, 0.0003), (-0.0001, 0.0003)),
    "a2_velocity_m_s": ((0.0069, 0.0007), (-0.0008, 0.0006)),
    "peak_distance_mm": ((-0.0845, 0.0057), (0.0073, 0.0049)),
    "hc_circle_radius_mm": ((0.063, 0.026), (0.094, 0.023)),
    "da_ratio_2mm": ((-0.084, 0.007), (-0.048, 0.006)),
    "integrated_inverse_radius_per_mm": ((-0.219, 0.019), (-0.104, 0.016)),
    "sp_a1_mmhg_mm": ((3.90, 0.27), (1.96, 0.24)),
}
A1_TIME_PER_MMHG = 0.148  # ms per mmHg of the eye's pressure
A1_TIME_PER_10_UM = 0.0463  # ms, at equal bIOP: .134 * .306 / .885
# means by bIOP: up to 11, 11-13, 13-15, 15-17, 17-19, over 19 mmHg, of which the open ends are some 10 and 20 mmHg in
# the mean; and the standard deviation between eyes of a group
GROUPS_MMHG = 10.0, 12.0, 14.0, 16.0, 18.0, 20.0
GROUPS = {
    "deformation_amplitude_mm": (1.197, 1.135, 1.077, 1.020, 0.951, 0.922),
    "peak_distance_mm": (5.26, 5.05, 4.85, 4.79, 4.57, 4.33),
    "a1_velocity_m_s": (0.164, 0.157, 0.142, 0.128, 0.111, 0.108),
    "sp_a1_mmhg_mm": (100.5, 106.1, 113.0, 116.1, 125.3, 132.4),
    "integrated_inverse_radius_per_mm": (8.53, 7.97, 7.71, 7.47, 7.19, 6.14),
}
GROUPS_SD = {
    "deformation_amplitude_mm": 0.073,
    "peak_distance_mm": 0.22,
    "a1_velocity_m_s": 0.013,
    "sp_a1_mmhg_mm": 10.5,
    "integrated_inverse_radius_per_mm": 0.71,
}
DONOR_MMHG = 10.0, 30.0
DONOR_NM_PER_MMHG = 486.0, 585.0
# means of 60 healthy eyes and of 60 keratoconic ones of 47 patients (Tian 2014, J Ophthalmol 147516)
KERATOCONUS = {
    "central_thickness_um": (546.0, 456.0),
    "a1_time_ms": (7.52, 7.04),
    "a1_velocity_m_s": (0.15, 0.17),
    "a2_velocity_m_s": (-0.39, -0.53),
    "hc_circle_radius_mm": (7.52, 5.59),
}
PUFF_SPREAD = 1.4 / 96.4  # standard deviation of the puff's pressure over its mean


def whole_eye(time_ms) -> np.ndarray:
    """Mean retreat [mm] of the whole eye at the given times [ms]."""
    return np.interp(time_ms, WHOLE_EYE_MS, WHOLE_EYE_MM)
