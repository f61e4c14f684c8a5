"""Waves with exact frequencies: closed-cylinder acoustics, membrane on a sealed cylinder, the default eye, drop, plane
wave.

Frequencies and damping are eigenvalues of the solver's own step about rest (`taichi_eye.proof.spectrum`).
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0, j1, jn_zeros

from taichi_eye.cloud.packing import pack
from taichi_eye.eye.laws import LAWS
from taichi_eye.eye.section import Section
from taichi_eye.proof.comparison import Comparison, order
from taichi_eye.proof.domains import Vessel, hemisphere_cloud, slip_walls, vessel_cloud
from taichi_eye.proof.flow import Flow
from taichi_eye.proof.membranes import dry_frequencies
from taichi_eye.proof.spectrum import CoupledSystem, mode, step_matrix

DISSIPATION = 0.5  # the solver's default
CFL = 0.2  # far below the stable step: the frequency error of the leapfrog is below 1e-5 here
# wall of the problems with a tense membrane: T = 7.8 N/m, m = 0.5775 kg/m^2
TENSION, THICKNESS, WALL_DENSITY = 7.8, 0.55e-3, 1050.0
AREAL_MASS = WALL_DENSITY * THICKNESS


def tissue(tension: float, k: float = 86.0, prestrain: float = 0.04, nu: float = 0.49):
    """Constants (A, s, nu, eps0) of the solver's tissue with a tension [N/m] at rest."""
    stress = tension / THICKNESS
    return float(stress / (2.0 * k * prestrain * np.exp(2.0 * k * prestrain**2))), k / (1.0 + nu), nu, prestrain


def _refine(system, clouds, exact, sound_speed, dissipation=DISSIPATION, **setup):
    """Frequencies [Hz] and damping [1/s] of the exact ones' modes on each cloud: two arrays [grid, mode].

    setup: what system.setup takes beside the cloud and the sound speed.
    """
    found = []
    for cloud in clouds:
        system.setup(cloud, sound_speed=sound_speed, viscosity=0.0, dissipation=dissipation, **setup)
        dt = CFL * cloud.spacing / sound_speed
        matrix = step_matrix(system, dt)
        found.append([mode(matrix, dt, frequency) for frequency in exact])
    found = np.array(found)
    return found[..., 0], found[..., 1]


def _system(clouds, **options):
    """A coupled system with room for the largest of the clouds."""
    clouds = list(clouds)
    return CoupledSystem(max(cloud.count for cloud in clouds), max(cloud.wall_count for cloud in clouds), **options)


WALL = {
    "thickness": THICKNESS,
    "wall_density": WALL_DENSITY,
    "material": tissue(TENSION),
    "iop": 0.0,
    "density": 1000.0,
}


def _rows(problem, names, exact, spacings, frequencies, damping, limit, order_limit, note):
    errors = np.abs(frequencies / np.asarray(exact) - 1.0)
    # single errors change sign as they converge; their root mean square does not
    common = order(spacings, np.sqrt((errors**2).mean(1)))
    rows = [
        Comparison(
            problem,
            f"{name} (Hz)",
            float(exact[m]),
            float(frequencies[-1, m]),
            float(errors[-1, m]),
            limit,
            common,
            order_limit,
            f"{note}; damping {damping[-1, m]:.2g}/s; order of the rms over {len(exact)} modes",
        )
        for m, name in enumerate(names)
    ]
    return rows, [(name, np.asarray(spacings) * 1e3, errors[:, m]) for m, name in enumerate(names)]


def acoustics(quick: bool = False):
    """Sound in a closed rigid cylinder: p = J0(k_n r) cos(m pi z/H) cos wt, J1(k_n a) = 0, w^2 = c^2 (k_n^2 + (m
    pi/H)^2).

    a 6, H 3 mm, c 30 m/s: the first three are radial 3049.2, axial 5000, radial 5582.8 Hz. Both bases.
    """
    a, depth, c = 6e-3, 3e-3, 30.0
    radial = jn_zeros(1, 2) / a * c / (2.0 * np.pi)
    exact = (radial[0], c / (2.0 * depth), radial[1])
    names = ("radial 1", "axial 1", "radial 2")
    spacings = (0.6e-3, 0.42e-3) if quick else (0.6e-3, 0.42e-3, 0.3e-3)
    clouds = [slip_walls(vessel_cloud(Vessel(a, depth), spacing)) for spacing in spacings]
    rows, lines = [], []
    # the default basis needs about 40 nodes for what the cubic one does with 20: its rows are for information
    for basis, limit, order_limit in (("cubic", 0.005, 1.8), ("quadratic", None, None)):
        frequencies, damping = _refine(Flow(clouds[-1].count, basis=basis), clouds, exact, c, density=1000.0)
        more, drawn = _rows(
            "cylinder acoustics",
            [f"{name}, {basis} basis" for name in names],
            exact,
            spacings,
            frequencies,
            damping,
            None if quick else limit,
            order_limit,
            f"{round(a / spacings[-1])} nodes across the radius",
        )
        rows += more
        lines += drawn
    return rows, [
        {
            "title": "Closed cylinder, c 30 m/s",
            "x": "spacing (mm)",
            "y": "relative error of the frequency",
            "log": True,
            "lines": lines,
            "slope": 2,
        }
    ]


def cylinder_frequencies(
    sound_speed: float, count: int = 3, a: float = 6e-3, depth: float = 3e-3, density: float = 1000.0, terms: int = 400
) -> list[float]:
    """Exact frequencies [Hz] of a flat membrane (T 7.8 N/m, m 0.5775 kg/m^2) on a sealed rigid cylinder.

    beta^2 = m w^2/T, J1(k_n a) = 0 with k_0 = 0, q_n^2 = k_n^2 - w^2/c^2, G_n = coth(q_n H)/q_n, G_0 = -(c/w) cot(w
    H/c); the roots of J0(beta a) + sum_n [2 beta J1(beta a)/(a (beta^2 - k_n^2))] rho w^2 G_n/(T k_n^2 - (m + rho G_n)
    w^2) = 0, without those at beta = k_n. c = 30: 265.5412, 524.7111, 796.995 Hz; c = 100: 266.4176, 526.4479,
    799.7255.
    """
    k = np.concatenate([[0.0], jn_zeros(1, terms) / a])

    def characteristic(f):
        w = 2.0 * np.pi * f
        beta = w * np.sqrt(AREAL_MASS / TENSION)
        q = np.sqrt((k**2 - (w / sound_speed) ** 2).astype(complex))
        g = (1.0 / (np.tanh(q * depth) * q)).real
        weight = 2.0 * beta * j1(beta * a) / (a * (beta**2 - k**2))
        return float(
            j0(beta * a) + (weight * density * w**2 * g / (TENSION * k**2 - (AREAL_MASS + density * g) * w**2)).sum()
        )

    roots = []
    grid = np.arange(50.0, 4000.0, 1.7)
    values = [characteristic(f) for f in grid]
    for low, high, left, right in zip(grid, grid[1:], values, values[1:]):
        if left * right < 0.0:
            root = brentq(characteristic, low, high, xtol=1e-9)
            beta = 2.0 * np.pi * root * np.sqrt(AREAL_MASS / TENSION)
            pole = abs(characteristic(root)) > 1e-3
            if not pole and np.abs(beta - k).min() > 1e-4 * beta:
                roots.append(root)
                if len(roots) == count:
                    break
    return roots


def coupled_cylinder(quick: bool = False):
    """A tense flat membrane on a sealed rigid cylinder of liquid (see `cylinder_frequencies`), and the same dry.

    Dry: J0(beta a) = 0: 234.436, 538.128, 843.613 Hz. a 6, H 3 mm. The dissipation is alpha c h, so at c 100 m/s its
    price shows: with alpha 0.5 the errors at 0.106 mm are 0.06 / 0.15 / 0.23 % and fall at order 1.6; the rows take
    0.3, the least that is stable.
    """
    a, depth = 6e-3, 3e-3
    grids = {
        10.0: (0.42e-3, 0.3e-3, 0.21e-3, 0.15e-3),
        30.0: (0.42e-3, 0.3e-3, 0.21e-3, 0.15e-3),
        100.0: (0.21e-3, 0.15e-3, 0.106e-3),
    }  # dissipation grows with c: the coarse clouds lose mode 3 there
    if quick:
        grids = {30.0: grids[30.0][:2]}
    clouds = {spacing: vessel_cloud(Vessel(a, depth), spacing) for spacing in sorted(set().union(*grids.values()))}
    system = _system(clouds.values())
    rows, figures = [], []
    for c, spacings in grids.items():
        exact = cylinder_frequencies(c)
        alpha = 0.3 if c == 100.0 else DISSIPATION
        frequencies, damping = _refine(system, [clouds[spacing] for spacing in spacings], exact, c, alpha, **WALL)
        more, lines = _rows(
            "coupled cylinder",
            [f"mode {m + 1}, c {c:g} m/s" for m in range(3)],
            exact,
            spacings,
            frequencies,
            damping,
            None if quick else 0.005,
            1.8,
            f"spacing {spacings[-1] * 1e3:g} mm, dissipation {alpha:g}",
        )
        rows += more
        figures.append(
            {
                "title": f"Membrane on a sealed cylinder, c {c:g} m/s",
                "x": "spacing (mm)",
                "y": "relative error of the frequency",
                "log": True,
                "lines": lines,
                "slope": 2,
            }
        )
    exact = jn_zeros(0, 3) / a * np.sqrt(TENSION / AREAL_MASS) / (2.0 * np.pi)
    elements = np.array((20, 40, 80))
    dry = np.array(
        [dry_frequencies(Vessel(a, depth).cornea_nodes(n), THICKNESS, WALL_DENSITY, tissue(TENSION)) for n in elements]
    )
    rows += _rows(
        "coupled cylinder",
        [f"mode {m + 1}, dry" for m in range(3)],
        exact,
        1.0 / elements,
        dry,
        0.0 * dry,
        0.001,
        1.8,
        f"{elements[-1]} elements, the membrane alone",
    )[0]
    return rows, figures


def eye_modes(quick: bool = False):
    """First coupled modes of an eye at rest: 308.7, 549.8, 803.7 Hz.

    R 7.8, limbus 5.5, h 0.55 mm, rho_s 1100, IOP 2000 Pa, k 20 with nu 0, eps0 0.03, A from equilibrium;
    incompressible. Reference: an independent finite-element added-mass solution (potential flow). Here c = 100 m/s.
    """
    exact, c = (308.7, 549.8, 803.7), 100.0
    radius, rim, iop, k, prestrain = 7.8e-3, 5.5e-3, 2000.0, 20.0, 0.03
    a = float(iop * radius / (2.0 * THICKNESS) / (2.0 * k * prestrain * np.exp(2.0 * k * prestrain**2)))
    section = Section(radius, rim, radius - np.sqrt(radius**2 - rim**2))
    spacings = (0.5e-3, 0.354e-3) if quick else (0.354e-3, 0.25e-3, 0.177e-3, 0.125e-3)
    clouds = [pack(section, spacing) for spacing in spacings]
    frequencies, damping = _refine(
        _system(clouds),
        clouds,
        exact,
        c,
        thickness=THICKNESS,
        wall_density=1100.0,
        iop=iop,
        material=(a, k, 0.0, prestrain),
        density=1000.0,
    )
    rows, lines = _rows(
        "eye at rest",
        [f"mode {m + 1}" for m in range(3)],
        exact,
        spacings,
        frequencies,
        damping,
        None if quick else 0.005,
        1.8,
        f"spacing {spacings[-1] * 1e3:g} mm, c {c:g} m/s",
    )
    return rows, [
        {
            "title": "Eye at rest, coupled modes",
            "x": "spacing (mm)",
            "y": "relative error of the frequency",
            "log": True,
            "lines": lines,
            "slope": 2,
        }
    ]


def drop(quick: bool = False):
    """A drop held by surface tension, with a heavy skin: w_n^2 = (n - 1)(n + 2) T/[R^2 (rho_s h + rho R/n)].

    Lamb's drop with the skin's mass added. R 7.8 mm, T 7.8 N/m, m 0.5775 kg/m^2: n = 2, 4 (even: half a drop on its
    plane of symmetry): 53.8623, 152.0770 Hz. Skin of constant tension T whatever its stretch.
    """
    radius, c = 7.8e-3, 30.0
    spacings = (0.8e-3, 0.56e-3) if quick else (0.8e-3, 0.56e-3, 0.4e-3)
    orders = np.array([2, 4])
    exact = np.sqrt((orders - 1) * (orders + 2) * TENSION / (radius**2 * (AREAL_MASS + 1000.0 * radius / orders))) / (
        2 * np.pi
    )

    clouds = [hemisphere_cloud(radius, spacing) for spacing in spacings]
    frequencies, damping = _refine(
        _system(clouds, law=LAWS["film"], rim="sliding_r"),
        clouds,
        exact,
        c,
        **{**WALL, "iop": 2.0 * TENSION / radius, "material": (TENSION / THICKNESS, 0.0)},
    )
    rows, lines = _rows(
        "drop",
        [f"n = {n}" for n in orders],
        exact,
        spacings,
        frequencies,
        damping,
        None if quick else 0.005,
        1.8,
        f"spacing {spacings[-1] * 1e3:g} mm, c {c:g} m/s",
    )
    return rows, [
        {
            "title": "Drop with surface tension",
            "x": "spacing (mm)",
            "y": "relative error of the frequency",
            "log": True,
            "lines": lines,
            "slope": 2,
        }
    ]


def plane_wave(quick: bool = False):
    """Waves of a tense membrane on a liquid layer: w^2 = T k^2/(m + rho coth(k H)/k), H 3 mm.

    Wavelengths 3/6/12 mm: 906.37, 375.58, 142.70 Hz. A travelling wave is two standing ones a quarter period apart, so
    half a wavelength between planes of symmetry gives its frequency. Planar liquid and membrane.
    """
    depth, c = 3e-3, 100.0
    rows, lines = [], []
    for length, spacings in (
        (12e-3, (0.3e-3, 0.21e-3, 0.15e-3)),
        (6e-3, (0.3e-3, 0.21e-3, 0.15e-3)),
        (3e-3, (0.21e-3, 0.15e-3, 0.105e-3)),
    ):
        if quick:
            spacings = spacings[:2]
        k = 2.0 * np.pi / length
        exact = [np.sqrt(TENSION * k**2 / (AREAL_MASS + 1000.0 / (k * np.tanh(k * depth)))) / (2.0 * np.pi)]
        clouds = [vessel_cloud(Vessel(length / 2, depth, planar=True), spacing) for spacing in spacings]
        frequencies, damping = _refine(_system(clouds, planar=True, rim="sliding_z"), clouds, exact, c, **WALL)
        more, drawn = _rows(
            "plane wave",
            [f"wavelength {length * 1e3:g} mm"],
            exact,
            spacings,
            frequencies,
            damping,
            None if quick else 0.005,
            1.8,
            f"spacing {spacings[-1] * 1e3:g} mm, c {c:g} m/s",
        )
        rows += more
        lines += drawn
    return rows, [
        {
            "title": "Plane wave on a layer",
            "x": "spacing (mm)",
            "y": "relative error of the frequency",
            "log": True,
            "lines": lines,
            "slope": 2,
        }
    ]
