"""What the renderer sees at a frame time."""

from dataclasses import dataclass

import numpy as np

from taichi_eye.lang import ti


@dataclass
class FrameState:
    """The solver's fields at one frame time.

    The fields are the solver's own, the same objects in every frame (a new object recompiles the kernels),
    and may be longer than their counts.

    Attributes:
        time_ms: time since the first frame [ms].
        wall: anterior surface (r, z) [m], apex first, limbus last, an array [nodes, 2] or ti.Vector.field(2).
        wall_count: wall nodes in use, at least 3.
        nodes: fluid nodes (r, z) [m], ti.Vector.field(2); this and the two below None where only the slit is drawn.
        node_count: fluid nodes in use.
        pressure: pressure on the fluid nodes less the IOP [Pa], scalar ti.field.
        velocity: velocity (r, z) of the fluid [m/s], ti.Vector.field(2).
        trace_time_ms: times so far [ms], shape [samples], ascending.
        trace_apex_mm: apex displacement at these times [mm], positive inwards.
        trace_puff_kpa: load on the apex at these times [kPa].
        puff_radial: load now on the wall nodes, shape [wall_count], in any unit (only its shape along the
            wall is drawn), or None for the scene's profile.
        retreat_mm: of the whole eye from the camera, added in the slit image.
        passed: what stands beside the bar of a marked slit image, one line.
    """

    time_ms: float
    wall: np.ndarray | ti.MatrixField
    wall_count: int
    nodes: ti.MatrixField | None
    node_count: int
    pressure: ti.ScalarField | None
    velocity: ti.MatrixField | None
    trace_time_ms: np.ndarray
    trace_apex_mm: np.ndarray
    trace_puff_kpa: np.ndarray
    puff_radial: np.ndarray | None = None
    retreat_mm: float = 0.0
    passed: str = ""
