"""How time and memory of the coupled step grow with the nodes, and the time of a whole run with 1/h.

A step is timed under a rising puff, as in the part `step`, on all threads. Memory is what the process holds more once
a simulation has stepped than before it was made, fields, cloud and stencils; fields are made for a power of two of
nodes, of which only what is written takes memory. A whole run takes nodes (h^-2) times steps (h^-1).
"""

import math
import os

import numpy as np

from taichi_eye import backend
from taichi_eye.bench.rows import at_most, figure, skipped
from taichi_eye.bench.step import steps_of
from taichi_eye.bench.timing import best_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

SPACINGS_MM = 0.05, 0.025, 0.0125, 0.00775
RUN_MM = 0.2, 0.1414, 0.1
EXPONENT, RUN_EXPONENT = 1.05, 3.2
STEPS, TURNS = 10, 5


def measure(stage, spacings_mm=SPACINGS_MM, run_mm=RUN_MM):
    """The table over the nodes, its exponents, and that of whole runs."""
    threads = backend.threads()
    rows, nodes, times, held = [], [], [], []
    for spacing in spacings_mm:
        scene = load_scene(None, [f"numerics.spacing_mm={spacing}"])
        stage(f"packing at {spacing:g} mm")
        cloud = cloud_of(scene)
        stage(f"{cloud.count} nodes")
        before = _memory()
        _, advance = steps_of(scene, cloud, STEPS)
        times.append(best_of({"step": advance}, TURNS)["step"] / STEPS)
        held.append(_memory() - before)
        nodes.append(cloud.count)
        rows.append(
            figure(
                f"coupled step at {cloud.count} nodes",
                1e3 * times[-1],
                "ms",
                f"{cloud.count / times[-1] / 1e6:.1f} M node-updates/s on {threads} threads"
                + (
                    ""
                    if math.isnan(held[-1])
                    else f", {held[-1] / 2**20:.0f} MB, {held[-1] / cloud.count:.0f} bytes a node"
                ),
            )
        )
    span = f"{nodes[0]} to {nodes[-1]} nodes"
    rows.append(at_most("time of a step grows with the nodes to the power", _slope(nodes, times), "", EXPONENT, span))
    memory = "memory grows with the nodes to the power"
    if math.isnan(held[-1]):
        rows.append(skipped(memory, "needs /proc, as Linux has it", f"<= {EXPONENT:g}"))
    else:
        rows.append(at_most(memory, _slope(nodes, held), "", EXPONENT, span))
    backend.init("cpu", "f64", 1)
    took = []
    for spacing in run_mm:
        stage(f"whole runs, {spacing:g} mm")
        scene = load_scene(None, [f"numerics.spacing_mm={spacing}", "numerics.duration_ms=4"])
        cloud = cloud_of(scene)
        Simulation(scene, cloud).run()
        took.append(best_of({"run": lambda: Simulation(scene, cloud).run()}, 3)["run"])
    backend.init("cpu", "f64", threads)
    rows.append(
        at_most(
            "time of a run grows with 1/h to the power",
            -_slope(run_mm, took),
            "",
            RUN_EXPONENT,
            "4 ms on one thread at h "
            + ", ".join(f"{h:g}" for h in run_mm)
            + " mm: "
            + ", ".join(f"{seconds:.2f}" for seconds in took)
            + " s",
        )
    )
    return rows, []


def _slope(sizes, values) -> float:
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _memory() -> float:
    """Resident memory of this process in bytes; NaN where the system does not tell it in /proc."""
    try:
        with open("/proc/self/statm", encoding="ascii") as numbers:
            return int(numbers.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return math.nan
