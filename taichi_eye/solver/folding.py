"""Whether a shell's axisymmetric dent would fold: stability against perturbations with m lobes around the axis.

The model computes axisymmetric states; a shell under hoop compression may leave them. Perturbed places are
x + (rho cos m phi, tau sin m phi, zeta cos m phi) in (r, phi, z), from a state x(s). To second order in the amplitudes,
with S' = d/dS along the meridian at rest, R0 the radius at rest and all cos^2, sin^2 averaged, the energy over pi is

    sum h 2 R0 L / 2 [ C_ij dE_i dE_j + C66 gamma^2 + S1 (rho'^2 + tau'^2 + zeta'^2)
                       + S2 ((m rho + tau)^2 + (rho + m tau)^2 + m^2 zeta^2) / R0^2 ]                         membrane
  + D/2 [ k_s^2 + k_phi^2 + 2 nu k_s k_phi + 2 (1 - nu) k_sphi^2 ]  of w, the part along the normal            bending
  + kappa G h R0 L g [ (3 g - 2) a_s^2 + a_m^2 + 2 t (b_s a_s - b_m a_m) ],                        transverse shear
                       t = tan(phi - phi0),  g = 1 + t^2
  - p/2 (dx . dN)                                                                                follower pressure

    dE_1 = r' rho' + z' zeta',  dE_2 = r (rho + m tau) / R0^2,  gamma = (r tau' - r' (m rho + tau) - m z' zeta) / R0,
    C_ij = dS_i/dE_j,  C66 the tangent of shear in the plane  (of the tissue's law),
    a_s = (n . dx') / |x'|,  a_m = (n_r (m rho + tau) + n_z m zeta) / r   turns of the normal n, along and around,
    b_s = (x' . dx') / |x'|^2,  b_m = tau' / |x'|                         stretch along and turn in the surface,
    k_s = -w'',  k_phi = m^2 w / r^2 - r' w' / r,  k_sphi = m (w' / r - r' w / r^2).

The state is stable where this form is positive definite for every m from 2 on. The chamber's volume does not change to
first order in the amplitude, so its stiffness does not help, and the liquid's inertia only slows what grows. Overstress
of a relaxing tissue is left out: it fades. Rim and apex are held.

A complete sphere under outer pressure folds at 2 E (h/R)^2 / sqrt(3 (1 - nu^2)), the classical value: found to 2.5 %
(tests/solver/test_folding.py). A dent is another matter: compression is confined to the ring around it, with tension on
both sides and the liquid's pressure behind it, and bears 2 to 2.2 times the classical stress 2 sqrt(D E h) / (R h)
before it folds into 5 to 7 lobes (shells as thin in bending as `configs/corvis_healthy.toml`'s). So the classical
stress is where looking begins.
"""

import numpy as np
from scipy.linalg.lapack import dpbtrf

from taichi_eye.eye.eye import Eye

LOBES = tuple(range(2, 17))
BAND = 3  # nodes that a node's bending is felt by: itself and the next two


class Folding:
    """The stability of one cornea's states.

    rest [n + 1, 2] (m): nodes, apex first; thickness (m), prestrain, rigidity D (N m), shear kappa G h (N/m): numbers
    or per element [n]; law, coefficients, poisson_ratio: of the tissue.
    """

    def __init__(self, rest, *, thickness, law, coefficients, poisson_ratio, prestrain, rigidity, shear=0.0):
        self.rest, self.law, self.coefficients, self.nu = np.asarray(rest), law, coefficients, poisson_ratio
        n = len(self.rest) - 1
        self.thickness, self.prestrain, self.rigidity, self.shear = (
            np.broadcast_to(np.asarray(v, dtype=float), n) for v in (thickness, prestrain, rigidity, shear)
        )
        self.length = np.linalg.norm(np.diff(self.rest, axis=0), axis=1)
        self.radius = 0.5 * (self.rest[1:, 0] + self.rest[:-1, 0])
        # an element's mean of rho, tau, zeta and their derivatives, from its six nodal values
        self.mean = np.zeros((n, 3, 6))
        self.slope = np.zeros((n, 3, 6))
        for c in range(3):
            self.mean[:, c, c] = self.mean[:, c, 3 + c] = 0.5
            self.slope[:, c, c], self.slope[:, c, 3 + c] = -1.0 / self.length, 1.0 / self.length

    @classmethod
    def of(cls, eye: Eye, rest) -> "Folding":
        """That of an eye's cornea with the nodes `rest` [n + 1, 2] (m)."""
        middle = 0.5 * (rest[1:, 0] + rest[:-1, 0])
        thickness = eye.thickness(middle)
        return cls(
            rest,
            thickness=thickness,
            law=eye.cornea.law,
            coefficients=eye.cornea.coefficients,
            poisson_ratio=eye.cornea.poisson_ratio,
            prestrain=eye.prestrain(middle),
            rigidity=eye.rigidity(thickness),
            shear=eye.shear_stiffness * thickness,
        )

    def lobes(self, place, pressure, lobes=LOBES) -> int | None:
        """The number of lobes into which the state folds, None where it is stable; a state that is not finite is not
        judged.

        place [n + 1, 2] (m); pressure [n + 1] (Pa): net, outwards, on each node's ring.
        """
        if not (np.isfinite(place).all() and np.isfinite(pressure).all()):
            return None
        # a band's Cholesky factor is there where the form is positive definite
        for m, band in zip(lobes, self._bands(place, pressure, np.array(lobes))):
            if dpbtrf(band, lower=True)[1] != 0:
                return m
        return None

    def form(self, place, pressure, m: int) -> np.ndarray:
        """The quadratic form [J/m^2 over pi/2] of the free nodes, (rho, tau, zeta) node by node; symmetric."""
        band = self._bands(place, pressure, np.array([m]))[0]
        size = band.shape[1]
        lower = sum(np.diag(row[: size - k], -k) for k, row in enumerate(band) if k < size)
        return lower + np.tril(lower, -1).T

    def _bands(self, place, pressure, m: np.ndarray) -> np.ndarray:
        """Lower bands of the forms for several m: [m, k, j] is the entry in row j + k of column j."""
        n, m = len(self.length), m[:, None, None].astype(float)
        band = np.zeros((len(m), 3 * BAND, 3 * (n + 1)))
        of_elements = self._membrane(place, m) + self._tilting(place, m) + self._follower(place, pressure, m)
        _put(band, _gram(of_elements))
        _put(band, _gram(self._bending(place, m)))
        return band[:, :, 3 : 3 * n]

    # each part of the energy as terms (weight, a, b): the sum of weight * a * b, a and b linear in the dofs

    def _terms(self, place):
        shift = np.diff(place, axis=0) / self.length[:, None]
        return (
            shift[:, 0, None],
            shift[:, 1, None],
            0.5 * (place[1:, 0] + place[:-1, 0])[:, None],
            self.mean.swapaxes(0, 1),
        )

    def _membrane(self, place, m):
        rp, zp, r, (rho, tau, zeta) = self._terms(place)
        drho, dtau, dzeta = self.slope.swapaxes(0, 1)
        r0 = self.radius[:, None]
        e1 = 0.5 * ((rp**2 + zp**2)[:, 0] - 1.0) + self.prestrain
        e2 = 0.5 * ((r / r0)[:, 0] ** 2 - 1.0) + self.prestrain
        law = self.law.of_arrays
        s1, s2 = law.stress(e1, e2, self.prestrain, self.coefficients)
        c11, c12, c22, c66 = law.tangent(e1, e2, self.prestrain, self.coefficients)
        along, hoop = rp * drho + zp * dzeta, r / r0**2 * (rho + m * tau)
        shear = (r * dtau - rp * (m * rho + tau) - m * zp * zeta) / r0
        turned = [(m * rho + tau) / r0, (rho + m * tau) / r0, m * zeta / r0]
        weight = 2.0 * self.thickness * self.radius * self.length
        return [
            (weight * c11, along, along),
            (weight * c22, hoop, hoop),
            (weight * c66, shear, shear),
            (2.0 * weight * c12, along, hoop),
            *((weight * s1, vector, vector) for vector in (drho, dtau, dzeta)),
            *((weight * s2, vector, vector) for vector in turned),
        ]

    def _tilting(self, place, m):
        # the normal turns by a_s along the meridian and by a_m around the axis; the sections stay as they were at rest
        rp, zp, r, (rho, tau, zeta) = self._terms(place)
        drho, dtau, dzeta = self.slope.swapaxes(0, 1)
        stretch = np.hypot(rp, zp)
        nr, nz = -zp / stretch, rp / stretch
        along = (nr * drho + nz * dzeta) / stretch
        around = (nr * (m * rho + tau) + nz * m * zeta) / r
        edge = np.diff(self.rest, axis=0)
        tilt = np.arctan2(-zp, rp)[:, 0] - np.arctan2(-edge[:, 1], edge[:, 0])
        slant = 1.0 / np.cos(tilt) ** 2
        weight = 2.0 * self.shear * self.radius * self.length * slant
        slide = 2.0 * weight * np.tan(tilt)
        return [
            (weight * (3.0 * slant - 2.0), along, along),
            (weight, around, around),
            # the second order of the normal's turn, on which the shear at hand works
            (slide, (nz * drho - nr * dzeta) / stretch, along),
            (-slide, dtau / stretch, around),
        ]

    def _follower(self, place, pressure, m):
        # less dx . dN, N = x_S x x_phi
        rp, zp, r, (rho, tau, zeta) = self._terms(place)
        drho, _, dzeta = self.slope.swapaxes(0, 1)
        weight = -(pressure[1:] + pressure[:-1]) * self.length
        return [
            (weight, rho, -r * dzeta - zp * (rho + m * tau)),
            (weight, tau, m * rp * zeta - zp * (m * rho + tau)),
            (weight, zeta, r * drho + rp * (rho + m * tau)),
        ]

    def _bending(self, place, m):
        # of each inner node, over its own dofs and those of its neighbours
        n, nu = len(self.length), self.nu
        step = np.linalg.norm(np.diff(place, axis=0), axis=1)
        before, after = step[:-1, None], step[1:, None]
        chord = place[2:] - place[:-2]
        # displacement along the normal of the node before, the node and the node after; rim and apex are held
        normal = np.zeros((n + 1, 3))
        normal[1:-1, [0, 2]] = np.column_stack([-chord[:, 1], chord[:, 0]]) / np.linalg.norm(chord, axis=1)[:, None]
        behind, here, ahead = (np.zeros((n - 1, 3 * 3)) for _ in range(3))
        behind[:, :3], here[:, 3:6], ahead[:, 6:] = normal[:-2], normal[1:-1], normal[2:]
        r = place[1:-1, 0, None]
        rise = chord[:, 0, None] / (before + after)
        first = (ahead - behind) / (before + after)
        second = 2.0 * ((ahead - here) / after - (here - behind) / before) / (before + after)
        along, hoop, twist = -second, m * m * here / r**2 - rise * first / r, m * (first / r - rise * here / r**2)
        weight = 0.5 * (self.rigidity[1:] + self.rigidity[:-1]) * place[1:-1, 0] * (before + after)[:, 0]
        return [
            (weight, along, along),
            (weight, hoop, hoop),
            (2.0 * (1.0 - nu) * weight, twist, twist),
            (2.0 * nu * weight, along, hoop),
        ]


def _gram(terms) -> np.ndarray:
    """The symmetric form that terms (weight [rows], a, b [rows, dofs] or [m, rows, dofs]) add up to, for every m."""
    shape = np.broadcast_shapes(*(vector.shape for _, *pair in terms for vector in pair))
    left = np.stack([np.broadcast_to(weight[:, None] * a, shape) for weight, a, _ in terms], axis=-1)
    right = np.stack([np.broadcast_to(b, shape) for _, _, b in terms], axis=-2)
    total = left @ right
    return 0.5 * (total + total.swapaxes(-1, -2))


def _put(band: np.ndarray, parts: np.ndarray) -> None:
    """Add forms [m, rows, dofs, dofs], the first dof of row i being 3 i, to the bands."""
    rows, dofs = parts.shape[1:3]
    for a in range(dofs):
        for b in range(a + 1):
            band[:, a - b, b : b + 3 * rows : 3] += parts[:, :, a, b]
