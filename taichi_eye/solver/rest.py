"""A cornea at rest, as every rung of the ladder starts from it."""

import numpy as np

from taichi_eye.eye.eye import Eye
from taichi_eye.solver.cornea import Cornea


def place_cornea(cornea: Cornea, eye: Eye, elements: int, number: int = 0, first: int = 0) -> np.ndarray:
    """Place an eye's cornea of so many elements at rest, as `Cornea.setup` does; its nodes [elements + 1, 2] (m).

    number, first: of the eye and of its first node in the cornea's fields.
    """
    nodes = eye.section.cornea_nodes(elements)
    middle = 0.5 * (nodes[1:, 0] + nodes[:-1, 0])
    tissue, thickness = eye.cornea, eye.thickness(middle)
    cornea.setup(
        nodes,
        thickness=thickness,
        density=tissue.density,
        coefficients=tissue.coefficients,
        prestrain=eye.prestrain(middle),
        iop=eye.iop,
        load_shape=eye.puff.radial(nodes[:, 0]),
        rigidity=tissue.rigidity(thickness),
        overstress_share=tissue.overstress_share,
        relaxation_time=tissue.relaxation_time,
        eye=number,
        first=first,
    )
    return nodes
