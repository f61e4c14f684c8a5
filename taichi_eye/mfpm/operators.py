"""Modified finite particle method (MFPM) operators: gradient, Laplacian, divergence and dissipation on scattered nodes.

Theory (Asprone, Auricchio, Montanino, Reali, Int. J. Numer. Methods Eng. 99:1, 2014). With d = x_j - x_i and
X = [dr, dz, dr^2/2, dr dz, dz^2/2] (quadratic basis; the cubic one adds dr^3/6, dr^2 dz/2, dr dz^2/2, dz^3/6), the
Taylor expansion f_j - f_i = X_j . D_i is projected on as many functions W as there are unknown derivatives,

    D_i = A_i^-1 sum_j W_j (f_j - f_i),      A_i = sum_j W_j X_j^T   (the moment matrix),

with W = X times a Wendland C2 weight. Lengths are scaled by half the stencil radius and the moment matrix by its
diagonal before it is inverted. A stencil grows until the condition number (1-norm) of that scaled matrix is below
`CONDITION_LIMIT`; the wedge at the limbus needs it.

Axis: a scalar and u_z are even in r, u_r is odd; mirror images complete the stencils there, and the limits
u_r / r -> d u_r / dr, f_r / r -> f_rr replace the quotients on it.

Measured orders on packed clouds (tests/mfpm): quadratic basis gradient 2, Laplacian 1; cubic 3 and 2.

Dissipation. Plain collocation is unstable between walls. `dissipation_at` is a renormalised fourth difference,

    P_i f = sum_j [2 (f_j - f_i) - (grad f_i + grad f_j) . d] w_ij / (|d|^2 sum_k w_ik),

which vanishes for quadratic fields and on even stencils for cubic ones. Always built on the quadratic basis: with
cubic gradients it has growing modes in the limbus wedge (up to 0.02 c/h).
"""
import taichi as ti

from taichi_eye.backend import real
from taichi_eye.mfpm.neighbours import NeighbourLists, image_of, place_of

TERMS = {"quadratic": 5, "cubic": 9}
STENCIL = {"quadratic": 14, "cubic": 24}  # neighbours wanted; ties and the condition number may add some
CONDITION_LIMIT = {"quadratic": 2e4, "cubic": 2e6}
SEARCH_RADIUS = {"quadratic": 3.6, "cubic": 4.6}  # in spacings: holds the wanted neighbours in a one-sided wedge
WIDTH = {"quadratic": 28, "cubic": 44}
WEIGHT_RADIUS = 1.1  # support of the weight, in stencil radii


@ti.func
def wendland(q):
    """Wendland C2 weight of the distance q (1 at 0, 0 beyond 1)."""
    left = ti.max(1.0 - q, 0.0)
    return left * left * left * left * (1.0 + 4.0 * q)


@ti.data_oriented
class MfpmOperators:
    """Operator coefficients over neighbour lists.

    neighbours: lists whose entries the stencils take, nearest first. After `choose_stencils` and `rebuild`:
    size[i] entries, gradient weights [1/m], Laplacian weights [1/m^2] (axisymmetric), pair weights [1/m^2], and the
    condition number of each scaled moment matrix. Where the lists are planar, r and z are plain Cartesian coordinates.
    """

    def __init__(self, neighbours: NeighbourLists, basis: str):
        self.neighbours, self.basis, self.planar = neighbours, basis, neighbours.planar
        self.terms = TERMS[basis]
        fp, shape = real(), (neighbours.capacity, neighbours.width)
        self.size = ti.field(ti.i32, neighbours.capacity)
        self.gradient_weight = ti.Vector.field(2, fp, shape)
        self.laplacian_weight = ti.field(fp, shape)
        self.pair_weight = ti.field(fp, shape)
        self.pair_arm = ti.Vector.field(2, fp, shape)
        self.condition = ti.field(fp, neighbours.capacity)
        self.moment = ti.field(fp, (neighbours.capacity, self.terms, self.terms))
        self.scale = ti.field(fp, (neighbours.capacity, self.terms))
        self.basis_value = ti.field(fp, (neighbours.capacity, self.terms))

    def choose_stencils(self, points, wanted: int, limit: float, eye: int = 0) -> None:
        """Take `wanted` nearest entries per node (ties included), more where the moment matrix is worse than `limit`."""
        self._choose_stencils(points, wanted, limit, eye)

    @ti.kernel
    def _choose_stencils(self, points: ti.template(), wanted: int, limit: float, eye: int):
        for i in range(self.neighbours.first[eye], self.neighbours.first[eye] + self.neighbours.count[eye]):
            self.size[i] = 0
            least = wanted
            growing = True
            while growing:
                self.size[i] = self.neighbours.with_ties(i, least)
                self._invert_moments(i, points)
                least = self.size[i] + 1
                growing = self.condition[i] > limit and self.size[i] < self.neighbours.found[i]

    def rebuild(self, points, due=None) -> None:
        """Compute all weights for the nodes at `points`; the stencils stay. due [eyes]: 1 for the eyes it is done for."""
        self._rebuild(points, self.neighbours.everyone() if due is None else due)

    @ti.kernel
    def _rebuild(self, points: ti.template(), due: ti.types.ndarray()):
        for i in range(self.neighbours.total[None]):
            if due[self.neighbours.eye_of[i]] == 1:
                self._invert_moments(i, points)
                self._weights(i, points)

    @ti.func
    def _radius(self, i, points):
        radius2 = 0.0
        for k in range(self.size[i]):
            radius2 = ti.max(radius2, (place_of(points, self.neighbours.entry[i, k]) - points[i]).norm_sqr())
        return ti.sqrt(radius2)

    @ti.func
    def _evaluate_basis(self, i, d):
        # the scratch row of node i; d is scaled
        self.basis_value[i, 0] = d[0]
        self.basis_value[i, 1] = d[1]
        self.basis_value[i, 2] = 0.5 * d[0] * d[0]
        self.basis_value[i, 3] = d[0] * d[1]
        self.basis_value[i, 4] = 0.5 * d[1] * d[1]
        if ti.static(self.terms == 9):
            self.basis_value[i, 5] = d[0] * d[0] * d[0] / 6.0
            self.basis_value[i, 6] = 0.5 * d[0] * d[0] * d[1]
            self.basis_value[i, 7] = 0.5 * d[0] * d[1] * d[1]
            self.basis_value[i, 8] = d[1] * d[1] * d[1] / 6.0

    @ti.func
    def _invert_moments(self, i, points):
        m = self.terms
        radius = self._radius(i, points)
        for a in range(m):
            for b in range(m):
                self.moment[i, a, b] = 0.0
        for k in range(self.size[i]):
            d = place_of(points, self.neighbours.entry[i, k]) - points[i]
            weight = wendland(d.norm() / (WEIGHT_RADIUS * radius))
            self._evaluate_basis(i, d * (2.0 / radius))
            for a in range(m):
                left = weight * self.basis_value[i, a]
                for b in range(m):
                    self.moment[i, a, b] += left * self.basis_value[i, b]
        for a in range(m):
            self.scale[i, a] = 1.0 / ti.sqrt(ti.max(self.moment[i, a, a], 1e-30))
        norm = 0.0
        for a in range(m):
            row = 0.0
            for b in range(m):
                self.moment[i, a, b] *= self.scale[i, a] * self.scale[i, b]
                row += ti.abs(self.moment[i, a, b])
            norm = ti.max(norm, row)
        # Gauss-Jordan in place; symmetric positive definite, so no pivoting is needed
        singular = 0
        for pivot in range(m):
            value = self.moment[i, pivot, pivot]
            # also true for NaN
            if not value > 1e-14:
                singular = 1
                value = 1.0
            inverse = 1.0 / value
            self.moment[i, pivot, pivot] = 1.0
            for b in range(m):
                self.moment[i, pivot, b] *= inverse
            for a in range(m):
                if a != pivot:
                    factor = self.moment[i, a, pivot]
                    self.moment[i, a, pivot] = 0.0
                    for b in range(m):
                        self.moment[i, a, b] -= factor * self.moment[i, pivot, b]
        inverse_norm = 0.0
        for a in range(m):
            row = 0.0
            for b in range(m):
                row += ti.abs(self.moment[i, a, b])
            inverse_norm = ti.max(inverse_norm, row)
        self.condition[i] = norm * inverse_norm
        if singular == 1 or self.size[i] < m:
            self.condition[i] = ti.math.inf

    @ti.func
    def _weights(self, i, points):
        radius = self._radius(i, points)
        per_length = 2.0 / radius
        axis_distance = points[i][0]
        weight_sum = 0.0
        for k in range(self.size[i]):
            d = place_of(points, self.neighbours.entry[i, k]) - points[i]
            weight = wendland(d.norm() / (WEIGHT_RADIUS * radius))
            weight_sum += weight
            self._evaluate_basis(i, d * per_length)
            derivative = ti.Vector([0.0, 0.0, 0.0, 0.0, 0.0])
            for row in ti.static(range(5)):
                for b in range(self.terms):
                    derivative[row] += (self.moment[i, row, b] * self.scale[i, b] * self.basis_value[i, b])
                derivative[row] *= self.scale[i, row] * weight
            gradient = ti.Vector([derivative[0], derivative[1]]) * per_length
            second_r = derivative[2] * per_length * per_length
            second_z = derivative[4] * per_length * per_length
            self.gradient_weight[i, k] = gradient
            if ti.static(self.planar):
                self.laplacian_weight[i, k] = second_r + second_z
            elif axis_distance > 0.0:
                self.laplacian_weight[i, k] = second_r + second_z + gradient[0] / axis_distance
            else:
                self.laplacian_weight[i, k] = 2.0 * second_r + second_z
            self.pair_weight[i, k] = weight / d.norm_sqr()
            self.pair_arm[i, k] = d * (weight / d.norm_sqr())
        for k in range(self.size[i]):
            self.pair_weight[i, k] /= weight_sum
            self.pair_arm[i, k] /= weight_sum

    @ti.func
    def gradient_at(self, i, f: ti.template()):
        """Gradient (f_r, f_z) at node i of an even scalar field."""
        here = f[i]
        total = ti.Vector([0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = image_of(self.neighbours.entry[i, k])
            total += self.gradient_weight[i, k] * (f[j] - here)
        return total

    @ti.func
    def laplacian_at(self, i, f: ti.template()):
        """Axisymmetric Laplacian f_rr + f_r / r + f_zz at node i of an even scalar field."""
        here = f[i]
        total = 0.0
        for k in range(self.size[i]):
            j, sign = image_of(self.neighbours.entry[i, k])
            total += self.laplacian_weight[i, k] * (f[j] - here)
        return total

    @ti.func
    def velocity_gradient_at(self, i, u: ti.template()):
        """Derivatives [[u_r,r, u_r,z], [u_z,r, u_z,z]] at node i of a velocity field (u_r odd, u_z even)."""
        here = u[i]
        total = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
        for k in range(self.size[i]):
            j, sign = image_of(self.neighbours.entry[i, k])
            weight = self.gradient_weight[i, k]
            there = u[j]
            dr, dz = sign * there[0] - here[0], there[1] - here[1]
            total += ti.Matrix([[dr * weight[0], dr * weight[1]], [dz * weight[0], dz * weight[1]]])
        return total

    @ti.func
    def divergence_from(self, i, points: ti.template(), u: ti.template(), gradient):
        """Axisymmetric divergence u_r,r + u_r / r + u_z,z at node i from its velocity gradient."""
        hoop = gradient[0, 0]
        if ti.static(self.planar):
            hoop = 0.0
        elif points[i][0] > 0.0:
            hoop = u[i][0] / ti.max(points[i][0], 1e-30)
        return gradient[0, 0] + hoop + gradient[1, 1]

    @ti.func
    def velocity_laplacian_at(self, i, points: ti.template(), u: ti.template()):
        """Vector Laplacian at node i: (lap u_r - u_r / r^2, lap u_z)."""
        here = u[i]
        total = ti.Vector([0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = image_of(self.neighbours.entry[i, k])
            there = u[j]
            weight = self.laplacian_weight[i, k]
            total[0] += weight * (sign * there[0] - here[0])
            total[1] += weight * (there[1] - here[1])
        if ti.static(not self.planar):
            if points[i][0] > 0.0:
                total[0] -= here[0] / ti.max(points[i][0] ** 2, 1e-30)
            else:
                total[0] = 0.0
        return total

    @ti.kernel
    def gradient(self, f: ti.template(), out: ti.template()):
        """out[i] = gradient of the even scalar field f at every node."""
        for i in range(self.neighbours.total[None]):
            out[i] = self.gradient_at(i, f)

    @ti.kernel
    def laplacian(self, f: ti.template(), out: ti.template()):
        """out[i] = axisymmetric Laplacian of the even scalar field f at every node."""
        for i in range(self.neighbours.total[None]):
            out[i] = self.laplacian_at(i, f)

    @ti.kernel
    def divergence(self, points: ti.template(), u: ti.template(), out: ti.template()):
        """out[i] = axisymmetric divergence of the velocity field u at every node."""
        for i in range(self.neighbours.total[None]):
            out[i] = self.divergence_from(i, points, u, self.velocity_gradient_at(i, u))

    @ti.kernel
    def velocity_laplacian(self, points: ti.template(), u: ti.template(), out: ti.template()):
        """out[i] = vector Laplacian of the velocity field u at every node."""
        for i in range(self.neighbours.total[None]):
            out[i] = self.velocity_laplacian_at(i, points, u)
