"""How deep the puff dents the eye at each pressure inside it: a chart as an instrument's maker would want it.

    python -m taichi_eye.examples.iop_chart

Twenty-one eyes that differ in their intraocular pressure (IOP) alone are computed at once, on the rung that keeps the
chamber's volume and nothing else of the liquid: half a percent off at the peak, milliseconds an eye. The prestrain of
the wall is computed and follows the pressure. A table, and iop_chart.png beside you.
"""

import numpy as np
from matplotlib.figure import Figure

import taichi_eye


def dents(iops_mmhg, name="quick"):
    """Largest apex displacement [mm] and its time [ms] of a scene's eye at each IOP [mmHg]."""
    base = taichi_eye.load_scene(name, ["numerics.fidelity=cavity"])
    scenes = [base.but({"eye.iop_mmhg": float(iop)}) for iop in iops_mmhg]
    peaks, times = [], []
    for outcome in taichi_eye.run_batch(scenes):
        if outcome.stop is not None:  # an eye that left the model's validity says why
            raise outcome.stop
        apex = outcome.traces["apex_displacement_mm"]
        peaks.append(apex.max())
        times.append(outcome.traces["time_ms"][apex.argmax()])
    return np.array(peaks), np.array(times)


def main(iops_mmhg=range(10, 31), picture="iop_chart.png"):
    """Print the table and draw the chart; the peaks [mm]."""
    iops = np.array(iops_mmhg, dtype=float)
    peaks, times = dents(iops)
    print("IOP, mmHg   dent, mm   at, ms   slope, mm/mmHg")
    for row in zip(iops, peaks, times, np.gradient(peaks, iops)):
        print("{:9.1f}   {:8.4f}   {:6.2f}   {:+.4f}".format(*row))
    canvas = Figure(figsize=(6, 4), layout="constrained")
    axes = canvas.subplots()
    axes.plot(iops, peaks, "o-")
    axes.set(xlabel="intraocular pressure, mmHg", ylabel="largest apex displacement, mm")
    canvas.savefig(picture)
    return peaks


if __name__ == "__main__":
    main()
