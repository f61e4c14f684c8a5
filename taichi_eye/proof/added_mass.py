"""The added mass of potential flow against exact frequencies: what the `added_mass` rung rests on.

Modes of (M + rho G N G^T) x'' = -K x with the volume held: K from the cornea's own forces by central differences, G the
rings' area vectors, N the Neumann-to-Dirichlet matrix of `taichi_eye.solver.potential`.
"""

import numpy as np
from scipy.linalg import eig, null_space

from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
from taichi_eye.proof.comparison import Comparison, order
from taichi_eye.proof.domains import Vessel, vessel_cloud
from taichi_eye.proof.membranes import Membrane
from taichi_eye.proof.waves import TENSION, THICKNESS, WALL_DENSITY, tissue
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.potential import PotentialFlow
from taichi_eye.solver.rings import ring_areas

DENSITY = 1000.0
EYE = {"thickness": 0.55e-3, "density": 1100.0, "iop": 2000.0}


def frequencies(cloud, thickness, wall_density, material, iop=0.0, count: int = 3) -> np.ndarray:
    """Lowest frequencies [Hz] of a cornea at rest on an incompressible liquid; SI, `material` as `Cornea.setup`."""
    nodes = cloud.section.cornea_nodes(cloud.wall_count - 1)
    membrane = Membrane(nodes, thickness, material, wall_density)
    free = 2 * (len(nodes) - 1)
    step = 1e-7 * nodes[-1, 0]
    stiffness = np.empty((free, free))
    for column in range(free):
        moved = [nodes.copy(), nodes.copy()]
        for place, sign in zip(moved, (1.0, -1.0)):
            place[column // 2, column % 2] += sign * step
        push = [force + iop * area for force, area in map(membrane.forces, moved)]
        stiffness[:, column] = (push[1] - push[0])[:-1].ravel() / (2.0 * step)
    aqueous = Aqueous(cloud.count, "quadratic")
    aqueous.setup(cloud, density=DENSITY, viscosity=0.0, sound_speed=1.0, dissipation=0.0)
    flow = PotentialFlow(membrane.cornea, aqueous, Motion(membrane.cornea, aqueous))
    flow.setup(cloud)
    membrane.forces(nodes)
    flow.refresh()
    rings = ring_areas(nodes)[:-1]
    area = np.zeros((free, len(rings)))
    for ring in range(2):
        area[ring::2] = np.diag(rings[:, ring])
    mass = np.repeat(membrane.cornea.mass.to_numpy()[: len(rings)], 2)
    inertia = np.diag(mass) + DENSITY * area @ flow.neumann[:-1, :-1] @ area.T
    # the volume is held, and the apex stays on the axis
    held = np.vstack([area.sum(1) / np.abs(area).max(), np.eye(free)[0]])
    allowed = null_space(held)
    values = eig(allowed.T @ stiffness @ allowed, allowed.T @ inertia @ allowed, right=False)
    return np.sqrt(np.sort(values.real)[:count]) / (2.0 * np.pi)


def added_mass(quick: bool = False):
    """Added mass of potential flow: a membrane on a sealed cylinder, and an eye at rest, both incompressible.

    Cylinder a 6, H 3 mm, T 7.8 N/m, m 0.5775 kg/m^2: 266.5039, 526.6147, 799.975 Hz (the characteristic equation of the
    `cylinder` part for c -> infinity). Eye of the `eye` part: 308.7, 549.8, 803.7 Hz, by an independent finite-element
    solution.
    """
    rows, figures = [], []
    spacings = (0.42e-3, 0.3e-3) if quick else (0.3e-3, 0.18e-3, 0.09e-3)
    clouds = [vessel_cloud(Vessel(6e-3, 3e-3), spacing) for spacing in spacings]
    found = [frequencies(cloud, THICKNESS, WALL_DENSITY, tissue(TENSION)) for cloud in clouds]
    _add(rows, figures, "added mass, cylinder", (266.5039, 526.6147, 799.975), spacings, found, quick)
    radius, rim = 7.8e-3, 5.5e-3
    k, prestrain = 20.0, 0.03
    a = EYE["iop"] * radius / (2.0 * EYE["thickness"]) / (2.0 * k * prestrain * np.exp(2.0 * k * prestrain**2))
    section = Section(radius, rim, radius - np.sqrt(radius**2 - rim**2))
    spacings = (0.5e-3, 0.354e-3) if quick else (0.354e-3, 0.2e-3, 0.1e-3)
    found = [
        frequencies(pack(section, spacing), EYE["thickness"], EYE["density"], (a, k, 0.0, prestrain), EYE["iop"])
        for spacing in spacings
    ]
    _add(rows, figures, "added mass, eye at rest", (308.7, 549.8, 803.7), spacings, found, quick)
    return rows, figures


def _add(rows, figures, problem, exact, spacings, found, quick):
    errors = np.abs(np.array(found) / np.asarray(exact) - 1.0)
    common = order(spacings, np.sqrt((errors**2).mean(1)))
    rows += [
        Comparison(
            problem,
            f"mode {m + 1} (Hz)",
            exact[m],
            float(found[-1][m]),
            float(errors[-1, m]),
            None if quick else 0.005,
            common,
            1.8,
            f"spacing {spacings[-1] * 1e3:g} mm; order of the rms over 3 modes",
        )
        for m in range(3)
    ]
    figures.append(
        {
            "title": f"{problem.capitalize()}",
            "x": "spacing (mm)",
            "y": "relative error of the frequency",
            "log": True,
            "slope": 2,
            "lines": [(f"mode {m + 1}", np.asarray(spacings) * 1e3, errors[:, m]) for m in range(3)],
        }
    )
