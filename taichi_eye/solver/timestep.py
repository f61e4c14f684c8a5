"""The stable time step of the coupled scheme: the smallest of all its limits, times the user's `cfl`.

    acoustic + dissipation  g / (c (0.6 + 0.72 alpha h/g)): the leapfrog needs (w dt)^2/4 + d dt/2 <= 1, and the spectra
                            of packed clouds have w up to 1.6 c/h and a dissipation d up to 3.4 alpha c/h, g about 0.8
                            h; under a dent w grows as 1/g, and d as h/g^2, since alpha c h stays
    dissipation             0.55 / (alpha c h S), S the largest sum over a stencil of its pair weights: d is at most 4
                            alpha c h S, where every neighbour has the other sign, and lagged it needs d dt <= 2 (0.5);
                            runs
                            into the back blew up at 0.54. Binds only where the cloud is squeezed to half its height
    viscous                 g^2 rho / (4 mu)
    membrane, in plane      L / sqrt((B + S1) / rho_s), B the tangent along the meridian: twice the stiffness at twice
                            the stretch, so it shrinks as the cornea dents
    membrane, transverse    L / sqrt(S1 / rho_s)
    membrane, bending       (L^2 / 2) sqrt(rho_s h_wall / D): the stiffest wave of a plate, D of the thickest part
    coupling                sqrt(g rho_s h_wall / (rho c^2)): half of where a sweep stops contracting; beyond, light
                            walls are unstable even where the iteration converges
    volume                  sqrt(rho_s h_wall V / (rho A (c_m^2 - c^2))), A the area of the cornea: half of where the
                            explicit part of the mean pressure's stiffness rings with the wall's mass. Without a limit
                            the
                            default eye at h 0.2 mm, c 20 m/s rings at 1.4 and blows up at 1.9 times this

g is the smallest distance between two nodes now, h the spacing, L the shortest element of the membrane, alpha the
dissipation, c_m the sound speed of the mean pressure.
"""

import math

import numpy as np

from taichi_eye.eye.section import Section
from taichi_eye.eye.tissue import flexural_rigidity

NAMES = (
    "acoustic",
    "dissipation",
    "viscous",
    "membrane in plane",
    "membrane transverse",
    "membrane bending",
    "coupling",
    "volume",
)


class StepLimits:
    """The limits of several resolved scenes together, arrays over the scenes."""

    def __init__(self, scenes):
        self._slope, self._offset, self._damping, self._friction, self._bending, self._coupling, volume, self._cfl = (
            np.array([self._constants(scene) for scene in scenes]).T
        )
        self._table = np.empty((len(NAMES), len(volume)))
        self._table[7] = volume

    @staticmethod
    def _constants(scene):
        numerics, cornea, density = scene.numerics, scene.cornea, scene.aqueous.density_kg_m3
        c, alpha, spacing = numerics.sound_speed_m_s, numerics.dissipation, numerics.spacing_mm
        wall_mass = cornea.density_kg_m3 * min(cornea.thickness_mm, cornea.limbus_thickness_mm) * 1e-3
        thickest = max(cornea.thickness_mm, cornea.limbus_thickness_mm) * 1e-3
        sudden = (1.0 + cornea.viscoelastic_share) * cornea.flexural_modulus_mpa * 1e6
        rigidity = flexural_rigidity(sudden, thickest, cornea.poisson_ratio)
        friction = 4.0 * scene.aqueous.viscosity_mpa_s * 1e-3
        return (
            0.6 * c,
            0.72 * alpha * spacing * 1e-3 * c,
            0.55 / max(alpha * c * spacing * 1e-3, 1e-30),
            density / friction if friction > 0.0 else math.inf,
            0.5 * math.sqrt(wall_mass / rigidity) if rigidity > 0.0 else math.inf,
            math.sqrt(wall_mass / density) / c,
            StepLimits._volume_limit(scene, wall_mass),
            numerics.cfl,
        )

    @staticmethod
    def _volume_limit(scene, wall_mass: float) -> float:
        section, numerics = Section.from_scene(scene), scene.numerics
        area = 2.0 * math.pi * section.radius * section.apex_z
        spread = numerics.mean_sound_speed_m_s**2 - numerics.sound_speed_m_s**2
        if not scene.chamber.sealed or spread <= 0.0:
            return math.inf
        return math.sqrt(wall_mass * section.volume() / (scene.aqueous.density_kg_m3 * area * spread))

    def of(self, figures) -> np.ndarray:
        """All limits [s] of the scenes, a row to each of NAMES, from a survey's figures; the next call overwrites
        them."""
        gap, table = figures["smallest_gap"], self._table
        squared, length = gap * gap, figures["membrane_step"] * figures["membrane_speed"]
        # an eye that was stopped may have left anything
        with np.errstate(all="ignore"):
            table[0] = squared / (self._slope * gap + self._offset)
            table[1] = self._damping / figures["pair_weight"]
            table[2] = squared * self._friction
            table[3] = figures["membrane_step"]
            table[4] = length / np.maximum(figures["transverse_speed"], 1e-9)
            table[5] = length * length * self._bending
            table[6] = np.sqrt(gap) * self._coupling
        return table

    def stable_steps(self, figures) -> tuple[np.ndarray, np.ndarray]:
        """The steps to take [s] and the limits that set them, as numbers in NAMES, one for each scene."""
        table = self.of(figures)
        return self._cfl * table.min(0), table.argmin(0)


def limits(figures: dict[str, float], scene) -> dict[str, float]:
    """All limits [s] by name, from a survey's figures and a resolved scene."""
    return {name: float(value) for name, (value,) in zip(NAMES, StepLimits([scene]).of(figures))}


def stable_step(figures: dict[str, float], scene) -> tuple[float, str]:
    """The step to take [s] and the name of the limit that set it."""
    every = limits(figures, scene)
    name = min(every, key=every.get)
    return scene.numerics.cfl * every[name], name
