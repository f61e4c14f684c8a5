"""What a shell and its surroundings add, each against its closed form: shear, a jet on a dent, a stiffening globe."""

import numpy as np
from scipy.special import jn_zeros

from taichi_eye.eye import jet
from taichi_eye.eye.eye import REFERENCE_IOP
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.proof.comparison import Comparison, order, relative
from taichi_eye.proof.membranes import Membrane, dry_frequencies
from taichi_eye.solver.globe import Globe
from taichi_eye.units import MM3, MMHG

RADIUS, THICKNESS, DENSITY = 6e-3, 0.55e-3, 1050.0
SHEAR = 9.4e3  # kappa G [Pa], 5/6 of 11.3 kPa
LIMP = (1e-9, 1.0, 0.3, 0.0)  # coefficients of a tissue that bears nothing in its plane, and no prestrain


def _flat(elements: int, radius: float = RADIUS) -> np.ndarray:
    return np.column_stack([np.linspace(0.0, radius, elements + 1), np.zeros(elements + 1)])


def shear(quick: bool = False):
    """A clamped circular plate that shear alone holds, and the waves in it.

    Under a uniform pressure p it deflects by w = p (a^2 - r^2) / (4 kappa G h) while tan of the slope is the slope
    (here 1e-4), which the rings meet to rounding. A pure shear wave travels at sqrt(kappa G / rho): 2.99 m/s, read off
    the frequencies f_n = j_0n c / (2 pi a) of the clamped plate.
    """
    grids = (32, 64) if quick else (32, 64, 128)
    depth, speed = [], []
    stiffness = SHEAR * THICKNESS
    load = 1e-4 * 4.0 * stiffness / RADIUS
    zeros = jn_zeros(0, 3)
    for elements in grids:
        nodes = _flat(elements)
        plate = Membrane(nodes, THICKNESS, LIMP, DENSITY, shear_stiffness=stiffness)
        response, step = np.empty((elements, elements)), 1e-9
        for node in range(elements):
            moved, back = nodes.copy(), nodes.copy()
            moved[node, 1] += step
            back[node, 1] -= step
            response[:, node] = (plate.forces(back)[0] - plate.forces(moved)[0])[:elements, 1] / (2.0 * step)
        lift = plate.forces(nodes)[1][:elements, 1]
        depth.append(np.linalg.solve(response, load * lift))
        found = dry_frequencies(nodes, THICKNESS, DENSITY, LIMP, shear_stiffness=stiffness)
        speed.append(2.0 * np.pi * RADIUS * found / zeros)
    exact_depth = load * (RADIUS**2 - nodes[:-1, 0] ** 2) / (4.0 * stiffness)
    exact = np.sqrt(SHEAR / DENSITY)
    errors = np.abs(np.array(speed) / exact - 1.0)
    worst = float(np.abs(depth[-1] - exact_depth).max() / exact_depth[0])
    note = f"{grids[-1]} elements"
    rows = [
        Comparison(
            "shear plate", "deflection at the centre (m)", exact_depth[0], depth[-1][0], worst, 1e-6, None, None, note
        )
    ]
    rows += [
        Comparison(
            "shear wave",
            f"speed in mode {n + 1} (m/s)",
            float(exact),
            float(speed[-1][n]),
            float(errors[-1, n]),
            2e-3,
            order(1.0 / np.array(grids), errors[:, n]),
            1.8,
            note,
        )
        for n in range(3)
    ]
    lines = [(f"mode {n + 1}", grids, errors[:, n]) for n in range(3)]
    return rows, [
        {
            "title": "Pure shear wave",
            "x": "elements",
            "y": "relative error of the speed",
            "log": True,
            "lines": lines,
            "slope": -2,
        }
    ]


def jet_force(quick: bool = False):
    """The jet's force on walls of one curvature: sum of the load over the rings against its integral.

    p pi w^2, w = w_flat / (1 + c D kappa), D = 2.4 mm, c = 1/2, w_flat = D / sqrt 2, for a cap, a
    flat wall and a dent. Rings carry the mean of the load over them, so any number of them has the force to what lies
    beyond the rim. A flat wall takes the jet's whole momentum p pi D^2 / 2; by momentum a curved one takes
    1 - sin(kappa D) of it: reported beside. The apex keeps its pressure, where flow computations find 6.3 +- 2.2 % less
    in a dent (PMC6982245); a jet of constant force would lose what is reported last.
    """
    grids = (45,) if quick else (45, 180)
    flat, feedback = jet.NOZZLE / np.sqrt(2.0), 0.5
    rows = []
    for name, curvature in (("cap of 7.8 mm", 1.0 / 7.8e-3), ("flat wall", 0.0), ("dent of 7 mm", -1.0 / 7e-3)):
        width = flat / (1.0 + feedback * jet.NOZZLE * curvature)
        exact = np.pi * width**2
        found = []
        for elements in grids:
            rest = _flat(elements, 9e-3)
            place, r = rest.copy(), np.minimum(rest[:, 0], 2e-3)
            place[:, 1] = -curvature * r**2 / (1.0 + np.sqrt(1.0 - (curvature * r) ** 2))
            wall = Membrane(rest, THICKNESS, LIMP, load_rate=1.0 / flat**2, dent_feedback=feedback)
            found.append(float((wall.load(place) * wall.forces(place)[1][:, 1])[:-1].sum()))
        errors = [relative(value, exact) for value in found]
        rows.append(
            Comparison(
                "jet force",
                f"force over apex pressure, {name} (m^2)",
                float(exact),
                found[-1],
                max(errors),
                1e-6,
                note=f"worst of {' and '.join(map(str, grids))} elements",
            )
        )
        momentum = 0.5 * np.pi * jet.NOZZLE**2 * (1.0 - np.sin(curvature * jet.NOZZLE))
        rows.append(
            Comparison(
                "jet force",
                f"by the turn of momentum, {name} (m^2)",
                float(momentum),
                found[-1],
                relative(found[-1], momentum),
                note="c = 1/2, the air leaving at r = D",
            )
        )
    cap, dent = (1.0 + feedback * jet.NOZZLE * kappa for kappa in (1.0 / 7.8e-3, -1.0 / 7e-3))
    rows.append(
        Comparison(
            "jet force",
            "pressure kept at the apex of a dent, over the cap's",
            1.0 - 0.063,
            1.0,
            relative(1.0, 1.0 - 0.063),
            note=f"0.937 +- 0.022 by flow computations; {(dent / cap) ** 2:.2f} of a jet of constant force",
        )
    )
    return rows, []


@ti.data_oriented
class _Filling:
    """A globe that is filled in equal steps of pressure."""

    def __init__(self):
        self.globe = Globe(1)

    @ti.kernel
    def fill(self, compliance: float, rest_pressure: float, pressure: float, steps: int):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.globe.rest(0, compliance, 0.0, rest_pressure)
            for n in range(steps):
                self.globe.take_up(0, 1.0, pressure * (n + 1.0) / steps)

    @ti.kernel
    def stored(self) -> ti.f64:
        return self.globe.stored(0)

    @ti.kernel
    def pressure_for(self, soft: float, volume: float) -> ti.f64:
        return self.globe.pressure_for(0, 1.0, soft, volume)


def friedenwald(quick: bool = False):
    """Friedenwald's globe filled from its pressure P0 at rest to P0 + p.

    V = C P0 ln(1 + p/P0); the work of filling, the integral of p dV = C P0 (p - P0 ln(1 + p/P0)), is what it stores.
    P0 15 mmHg, C 0.33 mm^3/mmHg, p = 2 P0: 5.44 mm^3 and 8.92 uJ. The work is summed by the trapezoidal rule.
    """
    rest, compliance = REFERENCE_IOP, 0.33 * MM3 / MMHG
    pressure, full = 2.0 * rest, compliance * rest
    volume, energy = full * np.log(3.0), full * (pressure - rest * np.log(3.0))
    filling, grids, work = _Filling(), (16, 32, 64), []
    for steps in grids:
        filling.fill(compliance, rest, pressure, steps)
        work.append(filling.globe.work[0])
    errors = [relative(value, energy) for value in work]
    taken, stored = filling.globe.taken_up[0], filling.stored()
    filling.globe.mean_pressure[0] = 0.0
    # the pressure that a volume asks for, beside a liquid that yields in proportion
    soft = 0.1 * compliance
    back = filling.pressure_for(soft, volume + soft * pressure)
    rows = [
        Comparison("globe", "volume taken up (m^3)", volume, taken, relative(taken, volume), 1e-12),
        Comparison("globe", "energy stored (J)", energy, stored, relative(stored, energy), 1e-12),
        Comparison("globe", "pressure of a volume (Pa)", pressure, back, relative(back, pressure), 1e-12),
        Comparison(
            "globe",
            "work of filling (J)",
            energy,
            work[-1],
            errors[-1],
            1e-3,
            order(1.0 / np.array(grids), errors),
            1.8,
            f"{grids[-1]} steps",
        ),
    ]
    return rows, []
