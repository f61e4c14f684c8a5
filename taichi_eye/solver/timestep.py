"""The stable time step of the coupled scheme: the smallest of all its limits, times the user's `cfl`.

    acoustic + dissipation  g / (c (0.6 + 0.72 alpha h/g)): the leapfrog needs (w dt)^2/4 + d dt/2 <= 1, and the spectra
                            of packed clouds have w up to 1.6 c/h and a dissipation d up to 3.4 alpha c/h, g about 0.8 h;
                            under a dent w grows as 1/g, and d as h/g^2, since alpha c h stays
    dissipation             0.55 / (alpha c h S), S the largest sum over a stencil of its pair weights: d is at most 4 alpha
                            c h S, where every neighbour has the other sign, and lagged it needs d dt <= 2 (0.5); runs
                            into the back blew up at 0.54. Binds only where the cloud is squeezed to half its height
    viscous                 g^2 rho / (4 mu)
    membrane, in plane      L / sqrt((B + S1) / rho_s), B the tangent along the meridian: twice the stiffness at twice
                            the stretch, so it shrinks as the cornea dents
    membrane, transverse    L / sqrt(S1 / rho_s)
    membrane, bending       (L^2 / 2) sqrt(rho_s h_wall / D): the stiffest wave of a plate, D of the thickest part
    coupling                sqrt(g rho_s h_wall / (rho c^2)): half of where a sweep stops contracting; beyond, light walls are
                            unstable even where the iteration converges

g is the smallest distance between two nodes now, h the spacing, L the shortest element of the membrane, alpha the
dissipation.
"""
import math


def limits(figures: dict[str, float], scene) -> dict[str, float]:
    """All limits [s] by name, from a survey's figures and a resolved scene."""
    gap, numerics = figures["smallest_gap"], scene.numerics
    c, rho, mu = numerics.sound_speed_m_s, scene.aqueous.density_kg_m3, scene.aqueous.viscosity_mpa_s * 1e-3
    wall_mass = scene.cornea.density_kg_m3 * min(scene.cornea.thickness_mm, scene.cornea.limbus_thickness_mm) * 1e-3
    length = figures["membrane_step"] * figures["membrane_speed"]
    thickest = max(scene.cornea.thickness_mm, scene.cornea.limbus_thickness_mm) * 1e-3
    rigidity = scene.cornea.flexural_modulus_mpa * 1e6 * thickest**3 / (12.0 * (1.0 - scene.cornea.poisson_ratio**2))
    return {
        "acoustic": gap / (c * (0.6 + 0.72 * numerics.dissipation * numerics.spacing_mm * 1e-3 / gap)),
        "dissipation": 0.55 / max(numerics.dissipation * c * numerics.spacing_mm * 1e-3 * figures["pair_weight"], 1e-30),
        "viscous": gap**2 * rho / (4.0 * mu) if mu > 0.0 else math.inf,
        "membrane in plane": figures["membrane_step"],
        "membrane transverse": length / max(figures["transverse_speed"], 1e-9),
        "membrane bending": 0.5 * length**2 * math.sqrt(wall_mass / rigidity) if rigidity > 0.0 else math.inf,
        "coupling": math.sqrt(gap * wall_mass / rho) / c,
    }


def stable_step(figures: dict[str, float], scene) -> tuple[float, str]:
    """The step to take [s] and the name of the limit that set it."""
    every = limits(figures, scene)
    name = min(every, key=every.get)
    return scene.numerics.cfl * every[name], name
