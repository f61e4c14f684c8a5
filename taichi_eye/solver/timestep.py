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
    membrane, transverse    L / sqrt((S1 + 1.21 kappa G s (3 s - 2)) / rho_s), kappa G the modulus of transverse shear,
                            s = 1 / cos^2 of the wall's turn from rest
    membrane, bending       0.338 L^2 sqrt(rho_s h_wall / D), D of the thickest part: the stiffest wave, which sits at
                            the apex, where the hoop term is as stiff as the meridian's; a flat strip has 0.5
    membrane, shear         the t with (t / t_transverse)^2 + b t = 1, b = 2.42 (kappa G / rho_s) delay s^2 / L^2, s
                            the largest: what is left of the transverse limit by the shear's viscosity, taken from the
                            step before
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

from taichi_eye.errors import SceneError
from taichi_eye.solver.cornea import STIFFEST_SHEAR

NAMES = (
    "acoustic",
    "dissipation",
    "viscous",
    "membrane in plane",
    "membrane transverse",
    "membrane bending",
    "coupling",
    "volume",
    "membrane shear",
)
STIFFEST_BENDING = 35.008  # as STIFFEST_SHEAR, of bending, over D / (rho_s h_wall L^4)
NODE_STEPS_MAX = 2e11  # of a run: some five hours on one core


class StepLimits:
    """The limits of several cases together, arrays over them."""

    def __init__(self, cases):
        constants = [_constants(case.eye, case.scheme) for case in cases]
        column = lambda name: np.array([found[name] for found in constants])
        self._slope, self._offset, self._damping = column("slope"), column("offset"), column("damping")
        self._friction, self._bending, self._coupling = column("friction"), column("bending"), column("coupling")
        self._cfl = np.array([case.scheme.cfl for case in cases])
        self._table = np.empty((len(NAMES), len(constants)))
        self._table[7] = column("volume")
        self._shear, self._table[8] = column("shear"), math.inf
        self._viscous_wall = bool(self._shear.any())

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
            if self._viscous_wall:
                damping = self._shear * (figures["steepest_slant"] / length) ** 2
                limit = 2.0 / (damping + np.sqrt(damping * damping + 4.0 / (table[4] * table[4])))
                table[8] = np.where(self._shear > 0.0, limit, math.inf)
        return table

    def stable_steps(self, figures) -> tuple[np.ndarray, np.ndarray]:
        """The steps to take [s] and the limits that set them, as numbers in NAMES, one for each scene."""
        table = self.of(figures)
        return self._cfl * table.min(0), table.argmin(0)


def _constants(eye, scheme) -> dict[str, float]:
    """What of the limits does not change in a run, by name."""
    c, density, wall_mass = scheme.sound_speed, eye.liquid.density, eye.cornea.density * eye.cornea.thinnest
    damping, friction = scheme.dissipation_length, 4.0 * eye.liquid.viscosity
    return {
        "slope": 0.6 * c,
        "offset": 0.72 * damping,
        "damping": 0.55 / max(damping, 1e-30),
        "friction": density / friction if friction > 0.0 else math.inf,
        "bending": bending_limit(eye),
        "shear": shear_damping(eye),
        "coupling": math.sqrt(wall_mass / density) / c,
        "volume": _volume_limit(eye, scheme, wall_mass),
    }


def bending_limit(eye) -> float:
    """The plate's limit [s] over the square of the element's length [m]; infinite for a membrane."""
    rigidity, mass = eye.sudden_rigidity, eye.cornea.density * eye.cornea.thinnest
    return 2.0 / math.sqrt(STIFFEST_BENDING) * math.sqrt(mass / rigidity) if rigidity > 0.0 else math.inf


def shear_damping(eye) -> float:
    """Rate b of the shear's viscosity times the square of the element's length [m^2/s]; 0 where there is none."""
    return 0.5 * STIFFEST_SHEAR * eye.shear_stiffness / eye.cornea.density * eye.cornea.shear_delay


def rest_limits(case, nodes_flow: bool) -> dict[str, float]:
    """About what the limits [s] of a case are at rest, by the keys that set them; nodes_flow: whether its liquid is
    resolved."""
    eye, scheme = case.eye, case.scheme
    tissue, length = eye.cornea, scheme.spacing
    strain = eye.apex_prestrain
    along = float(tissue.law.of_arrays.tangent(strain, strain, strain, tissue.coefficients)[0])
    shear, density = eye.shear_stiffness, tissue.density
    stiff = (1.0 + tissue.overstress_share) * along + eye.rest_stress + 0.5 * shear
    transverse = length / math.sqrt((eye.rest_stress + 0.25 * STIFFEST_SHEAR * shear) / density)
    damping = shear_damping(eye) / length**2
    found = {
        "cornea.stiffness_a_pa": length / math.sqrt(stiff / density),
        "cornea.flexural_modulus_mpa": bending_limit(eye) * length**2,
        "cornea.shear_modulus_kpa": transverse,
        "cornea.shear_viscosity_ms": 2.0 / (damping + math.sqrt(damping**2 + 4.0 / transverse**2)),
    }
    if nodes_flow:
        found["numerics.sound_speed_m_s"] = 0.8 * length / (scheme.sound_speed * (0.6 + 0.9 * scheme.dissipation))
        if eye.liquid.viscosity > 0.0:
            found["aqueous.viscosity_mpa_s"] = (0.8 * length) ** 2 * eye.liquid.density / (4.0 * eye.liquid.viscosity)
    return found


def refuse_endless(case, nodes: int, nodes_flow: bool) -> None:
    """SceneError where a run of so many nodes would take more node-steps than anybody waits for."""
    limits = rest_limits(case, nodes_flow)
    key = min(limits, key=limits.get)
    steps = case.clock.samples * case.clock.sample_s / (case.scheme.cfl * limits[key])
    if steps * nodes > NODE_STEPS_MAX:
        value = case.scene.values()[key]
        raise SceneError(
            f"{key} = {value:g}: allows time steps of {case.scheme.cfl * limits[key]:.2g} s, so that the run would "
            f"take {steps:.2g} of them on {nodes} nodes; at most {NODE_STEPS_MAX / nodes:.2g} are allowed: change it, "
            f"or raise numerics.spacing_mm = {case.scene.numerics.spacing_mm:g}, or lower numerics.duration_ms = "
            f"{case.scene.numerics.duration_ms:g}"
        )


def _volume_limit(eye, scheme, wall_mass: float) -> float:
    section = eye.section
    area = 2.0 * math.pi * section.radius * section.apex_z
    spread = scheme.mean_sound_speed**2 - scheme.sound_speed**2
    if not eye.liquid.sealed or spread <= 0.0:
        return math.inf
    return math.sqrt(wall_mass * section.volume() / (eye.liquid.density * area * spread))


def limits(figures: dict[str, float], case) -> dict[str, float]:
    """All limits [s] by name, from a survey's figures of one eye."""
    return {name: float(value) for name, (value,) in zip(NAMES, StepLimits([case]).of(figures))}


def stable_step(figures: dict[str, float], case) -> tuple[float, str]:
    """The step to take [s] and the name of the limit that set it."""
    every = limits(figures, case)
    name = min(every, key=every.get)
    return case.scheme.cfl * every[name], name
