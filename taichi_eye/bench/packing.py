"""Packing the default eye's node cloud, boundary to triangles, and how its time grows with the nodes."""

import math

from taichi_eye.bench.rows import at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.cloud.packing import pack
from taichi_eye.cloud.quality import measure as quality
from taichi_eye.eye.eye import eye_of
from taichi_eye.scene import load_scene
from taichi_eye.units import MM

SPACINGS_MM = 0.1, 0.025, 0.00775
EXPONENT = 1.15  # near-linear: a Delaunay triangulation is n log n


def measure(stage, spacings_mm=SPACINGS_MM):
    """Time over the spacings, and its exponent in the nodes."""
    section = eye_of(load_scene(None)).section
    rows, nodes, times = [], [], []
    for spacing in spacings_mm:
        stage(f"at {spacing:g} mm")
        packed = []
        # a large cloud takes long enough to be timed once
        took = best_of({"pack": lambda: packed.append(pack(section, spacing * MM))}, 3 if spacing > 0.02 else 1)["pack"]
        found = quality(packed[0])
        nodes.append(found.nodes)
        times.append(took)
        rows.append(
            figure(
                f"packing {found.nodes} nodes",
                took,
                "s",
                f"spacing {spacing:g} mm, smallest gap "
                f"{found.smallest_gap:.2f}, largest hole {found.largest_hole:.2f} spacings",
            )
        )
    exponent = math.log(times[-1] / times[0]) / math.log(nodes[-1] / nodes[0])
    rows.append(
        at_most(
            "packing time grows with the nodes to the power", exponent, "", EXPONENT, f"{nodes[0]} to {nodes[-1]} nodes"
        )
    )
    return rows, []
