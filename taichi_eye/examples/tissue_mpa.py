"""A cornea of a given Young's modulus in its plane [MPa]: which keys say that?

    python -m taichi_eye.examples.tissue_mpa 0.4

The exponential tissue has no one modulus: it stiffens with stretch, and at rest it is stretched by the IOP. Its tangent
there, with C1 and C2 what a strain along and across costs, is C1 = c (1 + 2 k m e^2), C2 = c (nu + 2 k m e^2) with
m = 1 + nu, e the prestrain and c = S0/(m e), since the wall carries S0 = IOP R/(2h) at rest. Young's modulus is
(C1^2 - C2^2)/C1. For a given k it falls with the prestrain e to a least value, below which no tissue of that k lies.
"""

import sys

from scipy.optimize import brentq

import taichi_eye
from taichi_eye.scene.calibration import rest_stress
from taichi_eye.units import MM, MMHG


def young_mpa(scene, prestrain=None):
    """Young's modulus in the plane at rest [MPa] of a scene's cornea, or at another prestrain that carries its IOP."""
    cornea, nu = scene.cornea, scene.cornea.poisson_ratio
    e = cornea.prestrain if prestrain is None else prestrain
    s0 = rest_stress(scene.eye.iop_mmhg * MMHG, cornea.radius_mm * MM, cornea.thickness_mm * MM)
    c, bent = s0 / ((1.0 + nu) * e), 2.0 * cornea.exponent_k * (1.0 + nu) * e**2
    along, across = c * (1.0 + bent), c * (nu + bent)
    return 1e-6 * (along**2 - across**2) / along


def with_young(scene, wanted_mpa):
    """The scene with a cornea of a wanted modulus: the prestrain is found, the energy scale A follows from it."""
    loosest = 0.5 * scene.cornea.exponent_k**-0.5
    if not young_mpa(scene, loosest) < wanted_mpa < young_mpa(scene, 1e-6):
        raise SystemExit(f"{wanted_mpa} MPa: k = {scene.cornea.exponent_k:g} allows {young_mpa(scene, loosest):.3g} up")
    prestrain = brentq(lambda e: young_mpa(scene, e) - wanted_mpa, 1e-6, loosest, xtol=1e-15)
    return scene.but({"cornea.prestrain": prestrain, "cornea.stiffness_a_pa": "auto"})


def main(wanted_mpa=0.4, name="quick"):
    """Print the options for `taichi-eye run`; the scene."""
    base = taichi_eye.load_scene(name)
    scene = with_young(base, wanted_mpa)
    a, k = scene.cornea.stiffness_a_pa, scene.cornea.exponent_k
    print(f"{name}: {young_mpa(base):.3f} MPa; for {wanted_mpa:g} MPa add")
    print(f"--set cornea.stiffness_a_pa={a!r} --set cornea.exponent_k={k!r}")
    return scene


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))
