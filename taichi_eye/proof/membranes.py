"""The cornea alone against closed forms: inflation of a sphere, and Hencky's clamped membrane."""

import numpy as np
from scipy.linalg import solve_banded

from taichi_eye.eye.section import Section
from taichi_eye.eye.tissue import inflation_pressure
from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.proof.comparison import Comparison, order, relative
from taichi_eye.solver.cornea import Cornea

# Hencky's solution: w0 = C1 (q a^4/(E h))^(1/3) at the centre, N(0) = C2 (E h q^2 a^2)^(1/3)
HENCKY = {0.3: (0.653443, 0.431101), 0.49: (0.598243, 0.459382)}


@ti.data_oriented
class Membrane:
    """The solver's cornea without a liquid: forces of its tissue and its area vectors at a given place.

    material: the coefficients of the tissue law and, last, the prestrain.
    """

    def __init__(self, nodes, thickness: float, material, density: float = 1000.0):
        self.count = len(nodes)
        self.cornea = Cornea(self.count)
        *coefficients, prestrain = material
        self.cornea.setup(
            nodes,
            thickness=thickness,
            density=density,
            coefficients=coefficients,
            prestrain=prestrain,
            iop=0.0,
            load_shape=np.zeros(self.count),
        )
        self.force = ti.Vector.field(2, self.cornea.place.dtype, self.count)
        self.area = ti.Vector.field(2, self.cornea.place.dtype, self.count)

    @ti.kernel
    def _evaluate(self):
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.cornea.deform(0, 0.0)
        ti.loop_config(serialize=True)
        for i in range(self.count):
            self.force[i] = self.cornea.elastic_force(0, i)
            self.area[i] = self.cornea.volume_gradient(0, i)

    def forces(self, place):
        """Tissue forces [n, 2] (N) and area vectors [n, 2] (m^2) with the nodes at `place` [n, 2] (m)."""
        self.cornea.place.from_numpy(np.ascontiguousarray(place))
        self._evaluate()
        return self.force.to_numpy(), self.area.to_numpy()


def inflation(quick: bool = False):
    """Uniform inflation of a spherical cap by a stretch lam.

    p = (2 h/(R lam)) 2 A k e exp(2 k e^2), e = (lam^2 - 1)/2 + eps0; from the energy of Montanino, Angelillo, Pandolfi
    for equibiaxial strain. R 7.8 mm, h 0.55 mm, k 86, eps0 0.04, A 1565.401 Pa: 839.571 Pa at lam 0.98, 2000 at 1,
    13819.07 at 1.05. The pressure is read off each node as the load that balances its tissue force.
    """
    radius, rim, thickness, a, k, prestrain, nu = 7.8e-3, 5.8e-3, 0.55e-3, 1565.401, 86.0, 0.04, 0.49
    section = Section(radius, rim, radius - np.sqrt(radius**2 - rim**2))
    stretches = (0.98, 0.99, 1.0, 1.01, 1.02, 1.03, 1.05)
    grids = (64, 128, 256) if quick else (64, 128, 256, 512, 1024)
    exact = np.array([inflation_pressure(lam, radius, thickness, a, k, prestrain) for lam in stretches])
    errors, mean = [], None
    centre = np.array([0.0, section.centre_z])
    for elements in grids:
        nodes = section.cornea_nodes(elements)
        membrane = Membrane(nodes, thickness, (a, k / (1.0 + nu), nu, prestrain))
        found = []
        for lam in stretches:
            force, area = membrane.forces(centre + lam * (nodes - centre))
            # the rim is held, so it carries what is left
            found.append(-(force * area).sum(1)[:-1] / (area**2).sum(1)[:-1])
        found = np.array(found)
        errors.append(np.abs(found / exact[:, None] - 1.0).max(1))
        mean = found[np.arange(len(stretches)), np.abs(found / exact[:, None] - 1.0).argmax(1)]
    errors = np.array(errors)
    rows = [
        Comparison(
            "membrane inflation",
            f"pressure at lam {lam:g} (Pa), worst node",
            float(exact[j]),
            float(mean[j]),
            float(errors[-1, j]),
            None if quick else 1e-6,
            order(1.0 / np.array(grids), errors[:, j]),
            1.9,
            f"{grids[-1]} elements",
        )
        for j, lam in enumerate(stretches)
    ]
    figure = {
        "title": "Membrane inflation",
        "x": "elements",
        "y": "relative error of the pressure, worst node",
        "log": True,
        "lines": [(f"lam {lam:g}", grids, errors[:, j]) for j, lam in enumerate(stretches)],
        "slope": -2,
    }
    return rows, [figure]


def hencky(quick: bool = False):
    """A flat clamped circular membrane without tension under a uniform pressure, small strains.

    Hencky's series: w0 = C1 (q a^4/(E h))^(1/3), N(0) = C2 (E h q^2 a^2)^(1/3), (C1, C2) = (0.653443, 0.431101) at
    nu = 0.3 and (0.598243, 0.459382) at nu = 0.49. The tissue law becomes linear elastic for s -> 0 at
    2 A s = E/(1 - nu^2); q a/(E h) = 1e-8 keeps strains near 1e-6. Newton's method on the tissue's forces.
    """
    a, thickness, youngs, load = 6e-3, 0.5e-3, 1e6, 1e-8
    q = load * youngs * thickness / a
    grids = (16, 32, 64) if quick else (16, 32, 64, 128)
    rows, lines = [], []
    for nu, (c1, c2) in HENCKY.items():
        s = 1e-3
        material = (youngs / (1.0 - nu**2) / (2.0 * s), s, nu, 0.0)
        depth, tension = [], []
        for elements in grids:
            nodes = np.column_stack([np.linspace(0.0, a, elements + 1), np.zeros(elements + 1)])
            place, membrane = _hencky_place(
                nodes, thickness, material, q, c1 * (q * a**4 / (youngs * thickness)) ** (1 / 3)
            )
            depth.append(place[0, 1] / (q * a**4 / (youngs * thickness)) ** (1 / 3))
            stress = membrane.cornea.stress.to_numpy()[:elements]
            # two elements continue the even profile to the axis at second order
            centre = 1.125 * stress[0].mean() - 0.125 * stress[1].mean()
            tension.append(thickness * centre / (youngs * thickness * q**2 * a**2) ** (1 / 3))
        for name, values, exact in (("C1 (deflection)", depth, c1), ("C2 (tension at the centre)", tension, c2)):
            errors = [relative(v, exact) for v in values]
            rows.append(
                Comparison(
                    "Hencky",
                    f"{name}, nu {nu:g}",
                    exact,
                    float(values[-1]),
                    errors[-1],
                    1e-3,
                    order(1.0 / np.array(grids), errors),
                    1.8 if values is depth else None,
                    f"{grids[-1]} elements",
                )
            )
            lines.append((f"{name}, nu {nu:g}", grids, errors))
    return rows, [
        {"title": "Hencky's membrane", "x": "elements", "y": "relative error", "log": True, "lines": lines, "slope": -2}
    ]


def dry_frequencies(nodes, thickness: float, density: float, material, count: int = 3):
    """Lowest transverse frequencies [Hz] of a flat membrane without a liquid, from its linearised tissue forces and
    masses."""
    membrane = Membrane(nodes, thickness, material, density)
    free = len(nodes) - 1
    stiffness = np.empty((free, free))
    step = 1e-7 * nodes[-1, 0]
    for node in range(free):
        moved, back = nodes.copy(), nodes.copy()
        moved[node, 1] += step
        back[node, 1] -= step
        change = membrane.forces(back)[0] - membrane.forces(moved)[0]
        stiffness[:, node] = change[:free, 1] / (2.0 * step)
    values = np.linalg.eigvals(stiffness / membrane.cornea.mass.to_numpy()[:free, None])
    return np.sqrt(np.sort(values.real)[:count]) / (2.0 * np.pi)


def _hencky_place(nodes, thickness, material, q, depth):
    """Equilibrium places under the pressure q [Pa], from a parabola of the given depth [m]."""
    membrane = Membrane(nodes, thickness, material)
    count = len(nodes)
    radius = nodes[-1, 0]
    place = nodes.copy()
    place[:, 1] = depth * (1.0 - (nodes[:, 0] / radius) ** 2)
    free = np.ones((count, 2), dtype=bool)
    free[0, 0] = free[-1, 0] = free[-1, 1] = False
    free = free.ravel()
    scale = radius * np.array([(depth / radius) ** 2, depth / radius])

    def residual(at):
        force, area = membrane.forces(at)
        return (force + q * area).ravel()

    reference = np.abs(q * membrane.forces(nodes)[1]).sum()
    for _ in range(60):
        force = residual(place)
        if np.abs(force[free]).max() < 1e-12 * reference:
            break
        # a node feels its neighbours only: three colours of perturbed nodes give the whole banded Jacobian
        band = np.zeros((7, 2 * count))
        rows = np.arange(2 * count)
        for colour in range(3):
            near = rows // 2 + (colour - rows // 2 + 1) % 3 - 1
            for axis in range(2):
                step = 1e-5 * scale[axis]
                moved, back = place.copy(), place.copy()
                moved[colour::3, axis] += step
                back[colour::3, axis] -= step
                change = (residual(moved) - residual(back)) / (2.0 * step)
                column = 2 * near + axis
                known = (near >= 0) & (near < count) & (np.abs(rows - column) <= 3)
                band[(3 + rows - column)[known], column[known]] = change[known]
        for held in np.nonzero(~free)[0]:
            row = np.arange(max(0, held - 3), min(2 * count, held + 4))
            band[3 + row - held, held] = 0.0
            band[3 + held - row, row] = 0.0
            band[3, held] = -reference / radius
        move = solve_banded((3, 3), band, np.where(free, -force, 0.0)).reshape(-1, 2)
        largest = np.abs(move / scale).max()
        place = place + move * min(1.0, 0.3 / largest)
    return place, membrane
