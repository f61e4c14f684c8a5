"""A scene's cornea at rest, as every rung of the ladder starts from it."""

import numpy as np

from taichi_eye.eye.puff import Puff
from taichi_eye.eye.section import Section
from taichi_eye.eye.thickness import prestrain, thickness
from taichi_eye.scene import Scene
from taichi_eye.solver.cornea import Cornea
from taichi_eye.units import MMHG, MS


def place_cornea(
    cornea: Cornea, scene: Scene, section: Section, puff: Puff, elements: int, eye: int = 0, first: int = 0
) -> np.ndarray:
    """Place a scene's cornea of so many elements at rest, as `Cornea.setup` does; its nodes [elements + 1, 2] (m)."""
    wall = scene.cornea
    nodes = section.cornea_nodes(elements)
    s = wall.exponent_k / (1.0 + wall.poisson_ratio)
    middle = 0.5 * (nodes[1:, 0] + nodes[:-1, 0])
    cornea.setup(
        nodes,
        thickness(scene, middle),
        wall.density_kg_m3,
        (wall.stiffness_a_pa, s, wall.poisson_ratio, prestrain(scene, middle)),
        scene.eye.iop_mmhg * MMHG,
        puff.radial(nodes[:, 0]),
        wall.flexural_modulus_mpa * 1e6,
        (wall.viscoelastic_share, wall.relaxation_ms * MS),
        eye,
        first,
    )
    return nodes
