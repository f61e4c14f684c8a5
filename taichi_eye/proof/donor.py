"""A cornea inflated slowly and without a puff, as donor corneas are: the solver's own cornea, brought to rest.

The wall of an eye, in-plane tissue and all that resists bending, is taken from its rest at its own pressure to its rest
at another one, with the limbus held: statics of the whole shell, not a closed form and no dynamics. Newton's method on
the solver's own forces; a node feels no more than two neighbours on either side, so five colours of perturbed nodes
give the whole banded Jacobian. The pressure is changed in steps. What relaxes (overstress) has relaxed. A uniform shell
rises as a whole sphere does, by p R^2 (1 - nu)/(2 E h) while strains are small (`free_sphere`, which takes the law as
it is), and by what its held edge adds, of a membrane (1 + nu) sqrt(p R/(2 E h)) of that.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import brentq

from taichi_eye.eye.eye import Eye
from taichi_eye.eye.tissue import strain
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.solver.cornea import Cornea
from taichi_eye.units import MMHG

ELEMENTS = 96
NEIGHBOURS = 2  # on either side, that a node's force depends on
STEP_MMHG = 2.5
SETTLED = 1e-9  # move of Newton's method, of an element
ROUNDS = 60


@ti.data_oriented
class HeldCornea:
    """An eye's cornea at rest, held at its limbus, under whatever pressure.

    place: of its nodes [n, 2] (m); pressure [Pa]. Both are those of the last `inflate`, of the eye at rest before.
    """

    def __init__(self, eye: Eye, elements: int = ELEMENTS):
        self.count = elements + 1
        self.cornea = Cornea(self.count)
        self.place = self.cornea.build(eye, elements).copy()
        self.pressure = eye.iop
        free = np.ones((self.count, 2), dtype=bool)
        free[0, 0] = free[-1, 0] = free[-1, 1] = False
        self._free = free.ravel()

    @ti.kernel
    def _evaluate(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, 0.0)
        ti.loop_config(serialize=True)
        for i in range(self.count):
            self.cornea.collect_forces(0, i)

    def _forces(self, place: np.ndarray) -> np.ndarray:
        self.cornea.place.from_numpy(np.ascontiguousarray(place))
        self._evaluate()
        return self.cornea.force_solid.to_numpy().ravel()

    def inflate(self, pressure: float) -> None:
        """Bring the cornea to rest under a pressure [Pa], in steps; ArithmeticError where it finds none."""
        steps = max(1, int(np.ceil(abs(pressure - self.pressure) / (STEP_MMHG * MMHG))))
        for step in np.linspace(self.pressure, pressure, steps + 1)[1:]:
            self.cornea.iop[0] = float(step)
            self._settle()
            self.pressure = float(step)

    def _settle(self) -> None:
        length = float(np.hypot(*np.diff(self.place[:2], axis=0)[0]))
        for _ in range(ROUNDS):
            move = self._newton(1e-5 * length)
            largest = float(np.abs(move).max()) / length
            # no node moves by more than a tenth of an element at once
            self.place = self.place + move * min(1.0, 0.1 / max(largest, SETTLED))
            if largest < SETTLED:
                return
        raise ArithmeticError(f"no rest found at {self.cornea.iop[0] / MMHG:.3g} mmHg")

    def _newton(self, step: float) -> np.ndarray:
        force = self._forces(self.place)
        half, size = 2 * NEIGHBOURS + 1, 2 * self.count
        band, rows = np.zeros((2 * half + 1, size)), np.arange(size)
        colours = 2 * NEIGHBOURS + 1
        for colour in range(colours):
            # the perturbed node nearest to each row's
            near = rows // 2 + (colour - rows // 2 + NEIGHBOURS) % colours - NEIGHBOURS
            for axis in range(2):
                moved, back = self.place.copy(), self.place.copy()
                moved[colour::colours, axis] += step
                back[colour::colours, axis] -= step
                change = (self._forces(moved) - self._forces(back)) / (2.0 * step)
                column = 2 * near + axis
                known = (near >= 0) & (near < self.count) & (np.abs(rows - column) <= half)
                band[(half + rows - column)[known], column[known]] = change[known]
        stiff = float(np.abs(band[half]).max())
        for held in np.nonzero(~self._free)[0]:
            row = np.arange(max(0, held - half), min(size, held + half + 1))
            band[half + row - held, held] = 0.0
            band[half + held - row, row] = 0.0
            band[half, held] = -stiff
        try:
            return solve_banded((half, half), band, np.where(self._free, -force, 0.0)).reshape(-1, 2)
        except (np.linalg.LinAlgError, ValueError):  # singular, or no numbers any more
            raise ArithmeticError(f"no rest found at {self.cornea.iop[0] / MMHG:.3g} mmHg") from None


def apex_rise(eye: Eye, low: float, high: float) -> float:
    """By how much the apex rises [m] when the pressure goes slowly from low to high [Pa]."""
    cornea = HeldCornea(eye)
    cornea.inflate(low)
    before = cornea.place[0, 1]
    cornea.inflate(high)
    return float(cornea.place[0, 1] - before)


def free_sphere(eye: Eye, low: float, high: float) -> float:
    """The same of a whole sphere of the eye's central tissue [m], S(lam) = p R lam / (2 h) with Piola-Kirchhoff's S."""
    law, coefficients, shift = eye.cornea.law.of_arrays, eye.cornea.coefficients, eye.apex_prestrain
    radius, thickness = eye.section.radius, eye.cornea.thickness

    def excess(stretch: float, pressure: float) -> float:
        e = float(strain(stretch)) + shift
        return 2.0 * thickness * float(law.stress(e, e, shift, coefficients)[0]) / (radius * stretch) - pressure

    at = lambda pressure: radius * brentq(excess, 0.7, 1.3, args=(pressure,), xtol=1e-14)
    # a stretch that no tissue reaches is one of infinite pressure
    with np.errstate(over="ignore"):
        return at(high) - at(low)
