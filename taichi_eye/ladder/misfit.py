"""How far one run of a scene is from another: the quantities of interest that a tolerance holds for."""

from dataclasses import asdict, dataclass

import numpy as np

from taichi_eye.report.history import summarise


@dataclass(frozen=True)
class Misfit:
    """Errors in percent.

    peak: of the apex displacement; half_times: the later of the two shifts of the 50 % times over the width at half
    height; history: largest difference at any time over the peak; rms: the same, root mean square; pressure: largest
    difference of the pressure under the apex over its largest excess.
    """

    peak: float
    half_times: float
    history: float
    rms: float
    pressure: float

    def of(self, wanted: str) -> float:
        """The largest of those that `numerics.tolerance_on` holds for: "apex" or "pressure" (apex and pressure)."""
        worst = max(self.peak, self.half_times, self.history)
        return max(worst, self.pressure) if wanted == "pressure" else worst

    def as_dict(self) -> dict:
        """By name."""
        return asdict(self)


def misfit(traces, reference) -> Misfit:
    """Errors of `traces` against `reference`, both dicts of arrays as simulations return them, on the same samples.

    A run that ends early is judged where both are; a history without half height where the other has one is 100 % off.
    """
    count = min(len(traces["time_ms"]), len(reference["time_ms"]))
    apex, exact = (np.asarray(run["apex_displacement_mm"])[:count] for run in (traces, reference))
    time = np.asarray(reference["time_ms"])[:count]
    found, true = summarise(time, apex), summarise(time, exact)
    top = max(abs(true.peak), 1e-9)
    apart = np.abs(apex - exact) / top
    pressure, pressure0 = (np.asarray(run["fluid_pressure_apex_kpa"])[:count] for run in (traces, reference))
    rise = max(float(np.abs(pressure0 - pressure0[0]).max()), 1e-9)
    if true.fwhm_ms is None:
        half = 0.0
    elif found.fwhm_ms is None:
        half = 1.0
    else:
        half = (
            max(abs(found.half_rise_ms - true.half_rise_ms), abs(found.half_fall_ms - true.half_fall_ms)) / true.fwhm_ms
        )
    return Misfit(
        *(
            100.0 * float(value)
            for value in (
                abs(found.peak - true.peak) / top,
                half,
                apart.max(),
                np.sqrt((apart**2).mean()),
                np.abs(pressure - pressure0).max() / rise,
            )
        )
    )


def extrapolate(fine, coarse, ratio: float, order: float = 2.0) -> dict[str, np.ndarray]:
    """Richardson's limit of two runs whose error goes as size^order; ratio: coarse size over fine size, above 1."""
    share = 1.0 / (ratio**order - 1.0)
    return {
        name: np.asarray(fine[name]) + share * (np.asarray(fine[name]) - np.asarray(coarse[name]))
        if name in ("apex_displacement_mm", "fluid_pressure_apex_kpa")
        else np.asarray(fine[name])
        for name in fine
    }
