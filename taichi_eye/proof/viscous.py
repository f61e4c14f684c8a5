"""Viscous flows with exact or well-known answers: Poiseuille decay, Womersley, Taylor-Green, the lid-driven cavity."""

import math

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.special import j0, jv

from taichi_eye.cloud.packing import WALL
from taichi_eye.proof.comparison import Comparison, order
from taichi_eye.proof.domains import Vessel, mirrored, no_slip_walls, slip_walls, tube_cloud, vessel_cloud, with_kinds
from taichi_eye.proof.flow import Flow

DISSIPATION = 0.5  # the solver's default


def stable_step(spacing: float, sound_speed: float, nu: float, dissipation: float = DISSIPATION) -> float:
    """A step [s] below the acoustic and viscous limits of `taichi_eye.solver.timestep`, at cfl 0.7."""
    gap = 0.8 * spacing
    return 0.7 * min(gap / (sound_speed * (0.6 + 0.9 * dissipation)), gap**2 / (4.0 * nu))


def _tubes(spacings, sound_speed):
    """For each spacing the flow, at rest in its tube, and the radii of its nodes; one flow takes all tubes in turn."""
    tubes = [tube_cloud(1.0, 1.0, spacing) for spacing in spacings]
    flow = Flow(max(cloud.count + len(images.source) for cloud, images in tubes))
    for cloud, images in tubes:
        flow.setup(cloud, images, density=1.0, viscosity=1.0, sound_speed=sound_speed, dissipation=DISSIPATION)
        yield flow, cloud.points[:, 0]


def _run(flow, span, start=0.0, amplitude=0.0, frequency=0.0, nu=1.0):
    steps = math.ceil(span / stable_step(flow.cloud.spacing, flow.sound_speed, nu))
    flow.advance(steps, span / steps, start, amplitude, frequency)


def poiseuille(quick: bool = False):
    """Decay of an axial flow in a tube at rest otherwise: u_z = J0(j r/a) exp(-j^2 nu t/a^2), j = 2.404826.

    a = rho = nu = 1, c = 5, to t = 1/j^2 (one e-fold). L2 norm of the error over that of the exact profile.
    """
    j = 2.404825557695773
    grids = (0.2, 0.1414, 0.1) if quick else (0.2, 0.1414, 0.1, 0.0707, 0.05)
    errors = []
    for flow, r in _tubes(grids, 5.0):
        flow.set(np.column_stack([np.zeros_like(r), j0(j * r)]))
        _run(flow, 1.0 / j**2)
        exact = j0(j * r) * math.exp(-1.0)
        errors.append(np.linalg.norm(flow.velocity()[:, 1] - exact) / np.linalg.norm(exact))
    row = Comparison(
        "Poiseuille decay",
        "axial velocity after one e-fold, L2",
        0.0,
        errors[-1],
        errors[-1],
        0.01,
        order(grids, errors),
        1.8,
        f"{round(1 / grids[-1])} nodes across the radius",
    )
    return [row], [
        {
            "title": "Poiseuille decay",
            "x": "spacing / radius",
            "y": "relative L2 error",
            "log": True,
            "lines": [("quadratic", grids, errors)],
            "slope": 2,
        }
    ]


def womersley_profile(r, time: float, alpha: float):
    """u_z under -dp/dz = cos(w t), a = nu = rho = 1, w = alpha^2 (Womersley 1955).

    Re{1/(i w) [1 - J0(i^1.5 alpha r)/J0(i^1.5 alpha)] exp(i w t)}; alpha 5, r 0.5, t = pi/(2 w): 0.042393.
    """
    w, turn = alpha**2, 1j**1.5 * alpha
    return np.real((1.0 - jv(0, turn * r) / jv(0, turn)) / (1j * w) * np.exp(1j * w * time))


def womersley(quick: bool = False):
    """Pulsating flow in a tube, alpha = 1, 5, 10, from the exact profile at t = 0 over a period.

    The error is the L2 norm over the quarter points of the period, over that of the exact flow at the same times.
    c is 10 times the largest velocity or 1, whichever is more (nothing is compressed: c sets dt and dissipation).
    """
    rows, lines = [], []
    for alpha, grids in (
        (1.0, (0.2, 0.1414, 0.1, 0.0707)),
        (5.0, (0.1414, 0.1, 0.0707, 0.05)),
        (10.0, (0.1, 0.0707, 0.05, 0.0354)),
    ):
        if quick:
            grids = grids[:2]
        w = alpha**2
        errors = []
        for flow, r in _tubes(grids, 3.0):
            flow.set(np.column_stack([np.zeros_like(r), womersley_profile(r, 0.0, alpha)]))
            wrong = right = 0.0
            quarter = 0.5 * math.pi / w
            for part in range(4):
                _run(flow, quarter, part * quarter, 1.0, w)
                exact = womersley_profile(r, (part + 1) * quarter, alpha)
                wrong += ((flow.velocity()[:, 1] - exact) ** 2).sum()
                right += (exact**2).sum()
            errors.append(math.sqrt(wrong / right))
        rows.append(
            Comparison(
                "Womersley",
                f"axial velocity, alpha {alpha:g}, L2",
                0.0,
                errors[-1],
                errors[-1],
                0.01,
                order(grids, errors),
                1.8,
                f"{round(1 / grids[-1])} nodes across the radius",
            )
        )
        lines.append((f"alpha {alpha:g}", grids, errors))
    return rows, [
        {
            "title": "Womersley flow",
            "x": "spacing / radius",
            "y": "relative L2 error",
            "log": True,
            "lines": lines,
            "slope": 2,
        }
    ]


def taylor_green(quick: bool = False):
    """Decaying vortices, Re 100: u = sin 2 pi x cos 2 pi z e^bt, w = -cos 2 pi x sin 2 pi z e^bt, b = -8 pi^2/Re.

    The paper's own -cos 2 pi x sin 2 pi y form shifted by a quarter wave, so that one vortex fills a box of half a wave
    with free-slip walls, which mirror images make exact. p = rho/4 (cos 4 pi x + cos 4 pi z) e^2bt. U = rho = 1, c =
    10:
    what is left of the error at fine spacing is of order 1/c^2. To t = 1.
    """
    nu, span = 0.01, 1.0
    grids = (0.05, 0.0354, 0.025) if quick else (0.05, 0.0354, 0.025, 0.0177, 0.0125)
    decay = math.exp(-8.0 * math.pi**2 * nu * span)
    errors = []
    clouds = [slip_walls(vessel_cloud(Vessel(0.5, 0.5, planar=True), spacing)) for spacing in grids]
    flow = Flow(max(cloud.count + len(mirrored(cloud).source) for cloud in clouds), planar=True)
    for cloud in clouds:
        points = cloud.points
        x, z = 2.0 * np.pi * points.T
        shape = np.column_stack([np.sin(x) * np.cos(z), -np.cos(x) * np.sin(z)])
        flow.setup(cloud, mirrored(cloud), density=1.0, viscosity=nu, sound_speed=10.0, dissipation=DISSIPATION)
        flow.set(shape, 0.25 * (np.cos(2 * x) + np.cos(2 * z)))
        _run(flow, span, nu=nu)
        errors.append(np.linalg.norm(flow.velocity() - decay * shape) / np.linalg.norm(decay * shape))
    row = Comparison(
        "Taylor-Green",
        "velocity at t = 1, Re 100, L2",
        0.0,
        errors[-1],
        errors[-1],
        0.01,
        order(grids, errors),
        1.8,
        f"{round(1 / grids[-1])} nodes to a wave length, c 10",
    )
    return [row], [
        {
            "title": "Taylor-Green vortex, Re 100",
            "x": "spacing / wave length",
            "y": "relative L2 error",
            "log": True,
            "lines": [("quadratic", grids, errors)],
            "slope": 2,
        }
    ]


# Ghia, Ghia, Shin (1982), J. Comput. Phys. 48: u on x = 1/2 and v on y = 1/2; v(0.9063) at Re 400 is a known misprint
GHIA_Y = (
    0.9766,
    0.9688,
    0.9609,
    0.9531,
    0.8516,
    0.7344,
    0.6172,
    0.5,
    0.4531,
    0.2813,
    0.1719,
    0.1016,
    0.0703,
    0.0625,
    0.0547,
)
GHIA_X = (
    0.9688,
    0.9609,
    0.9531,
    0.9453,
    0.9063,
    0.8594,
    0.8047,
    0.5,
    0.2344,
    0.2266,
    0.1563,
    0.0938,
    0.0781,
    0.0703,
    0.0625,
)
GHIA = {
    100: (
        (
            0.84123,
            0.78871,
            0.73722,
            0.68717,
            0.23151,
            0.00332,
            -0.13641,
            -0.20581,
            -0.21090,
            -0.15662,
            -0.10150,
            -0.06434,
            -0.04775,
            -0.04192,
            -0.03717,
        ),
        (
            -0.05906,
            -0.07391,
            -0.08864,
            -0.10313,
            -0.16914,
            -0.22445,
            -0.24533,
            0.05454,
            0.17527,
            0.17507,
            0.16077,
            0.12317,
            0.10890,
            0.10091,
            0.09233,
        ),
    ),
    400: (
        (
            0.75837,
            0.68439,
            0.61756,
            0.55892,
            0.29093,
            0.16256,
            0.02135,
            -0.11477,
            -0.17119,
            -0.32726,
            -0.24299,
            -0.14612,
            -0.10338,
            -0.09266,
            -0.08186,
        ),
        (
            -0.12146,
            -0.15663,
            -0.19254,
            -0.22847,
            None,
            -0.44993,
            -0.38598,
            0.05186,
            0.30174,
            0.30203,
            0.28124,
            0.22965,
            0.20920,
            0.19713,
            0.18360,
        ),
    ),
}


def cavity(quick: bool = False):
    """Lid-driven cavity at Re 100 and 400 against Ghia, Ghia, Shin (1982).

    U = L = rho = 1. The error is the largest difference on both centre lines over the lid's speed. The lid's end
    nodes stand still. Run until the velocity changes by less than 1e-5 in a unit of time. Re 400 needs the full
    dissipation: advection is central and one Euler step, and at 0.3 the largest difference grows from 1.5 to 2.6 %.
    """
    rows, figures = [], []
    spacing = 1 / 32 if quick else 1 / 60
    cloud = no_slip_walls(vessel_cloud(Vessel(1.0, 1.0, planar=True), spacing))
    flow = Flow(cloud.count, planar=True)
    for reynolds, sound_speed in ((100, 10.0), (400, 5.0)):
        kind, lid = cloud.kind.copy(), np.zeros((cloud.count, 2))
        top = np.arange(1, cloud.wall_count - 1)
        kind[top], lid[top, 0] = WALL, 1.0
        flow.setup(
            with_kinds(cloud, kind),
            density=1.0,
            viscosity=1.0 / reynolds,
            sound_speed=sound_speed,
            dissipation=DISSIPATION,
        )
        flow.set()
        flow.prescribe(lid)
        time, before = 0.0, flow.velocity()
        while time < 60.0:
            _run(flow, 2.0, nu=1.0 / reynolds)
            time += 2.0
            now = flow.velocity()
            if np.abs(now - before).max() < 2e-5:
                break
            before = now
        u, v = (CloughTocher2DInterpolator(cloud.points, now[:, a]) for a in range(2))
        along = np.linspace(0.0, 1.0, 101)
        lines = []
        for name, at, coordinate, exact in (
            ("u on x = 1/2", lambda s: u(0.5, s - 1.0), GHIA_Y, GHIA[reynolds][0]),
            ("v on y = 1/2", lambda s: v(s, -0.5), GHIA_X, GHIA[reynolds][1]),
        ):
            known = [(s, e) for s, e in zip(coordinate, exact) if e is not None]
            place, values = np.array(known).T
            error = float(np.abs(at(place) - values).max())
            rows.append(
                Comparison(
                    "cavity",
                    f"{name}, Re {reynolds}, largest difference / U",
                    None,
                    None,
                    error,
                    0.02,
                    note=(
                        f"{cloud.count} nodes ({round(1 / spacing) + 1} to a side), steady at t "
                        f"= {time:g}, c {sound_speed:g}, dissipation {DISSIPATION:g}"
                    ),
                )
            )
            lines += [(name, along, at(along)), (f"{name}, Ghia et al.", place, values)]
        figures.append(
            {
                "title": f"Lid-driven cavity, Re {reynolds}",
                "x": "y or x",
                "y": "velocity / lid speed",
                "log": False,
                "lines": lines,
                "points": True,
            }
        )
    return rows, figures
