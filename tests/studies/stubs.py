"""Studies of something other than eyes: what workers compute in the tests, by name ("stubs:linear")."""

import os
import signal
import time

import numpy as np

DEADLY_MMHG = 66.0


def linear(common, items):
    """Figures that are simple functions of an eye's pressure and thickness."""
    return [_row(item) for item in items]


def slow(common, items):
    """The same, at a pace at which a study can be cut off."""
    time.sleep(0.02 * len(items))
    return linear(common, items)


def deadly(common, items):
    """The same, but one eye takes its process with it and another raises."""
    for item in items:
        if item["eye.iop_mmhg"] == DEADLY_MMHG:
            os.kill(os.getpid(), signal.SIGKILL)
        if item["eye.iop_mmhg"] == DEADLY_MMHG + 1.0:
            raise ZeroDivisionError("nothing to be divided by")
    return linear(common, items)


def ishigami(common, items):
    """The test function of sensitivity analysis, a = 7 and b = 0.1, of three keys that vary from 10 to 20, 0.5 to 0.6
    and 5 to 15."""
    low, span = np.array([10.0, 0.5, 5.0]), np.array([10.0, 0.1, 10.0])
    names = "eye.iop_mmhg", "cornea.thickness_mm", "puff.peak_kpa"
    x = np.pi * (2.0 * (np.array([[item[name] for name in names] for item in items]) - low) / span - 1.0)
    value = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return [{"deformation_amplitude_mm": float(one), "status": "complete"} for one in value]


def exams(common, items):
    """Rows as the reading of films gives them."""
    figures = {"a1_time_ms": 7.25, "peak_distance_mm": 4.5, "frames": 139, "notes": common.get("note")}
    bad = {"status": "refused", "reason": "no film"}
    return [bad if "bad" in item["exam"] else {**figures, "status": "complete", "reason": None} for item in items]


def _row(item):
    iop, thickness = item["eye.iop_mmhg"], item.get("cornea.thickness_mm", 0.55)
    figures = {"deformation_amplitude_mm": 2.0 - 0.05 * iop - thickness, "a1_time_ms": 5.0 + 0.15 * iop}
    return {**figures, "fidelity": "cavity", "status": "complete"}
