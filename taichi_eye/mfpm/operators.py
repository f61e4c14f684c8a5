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

Dissipation. Plain collocation is unstable between walls. P ("roughness") is a renormalised fourth difference,

    P_i f = sum_j [2 (f_j - f_i) - (grad f_i + grad f_j) . d] w_ij / (|d|^2 sum_k w_ik),

which vanishes for quadratic fields and on even stencils for cubic ones. Always built on the quadratic basis: with
cubic gradients it has growing modes in the limbus wedge (up to 0.02 c/h). It is summed as

    P_i f = sum_j w'_ij [(s_j - s_i) + x_i . (g_j - g_i)] - g_i . sum_j w'_ij d,    s = 2 f - g . x,  g = grad f,
    w'_ij = w_ij / (|d|^2 sum_k w_ik):

what belongs to a neighbour is put together once, where the neighbour is, and one weight serves all its parts. Equal to
the sum above to rounding (at most 3e-14 of the apex history); x are the places that the weights were computed for.

Speed (`taichi-eye bench --only step`; here in cycles a node of one thread of an EPYC, by the processor's counters,
since clocks on a shared machine are no guide; 16093 nodes). A time step is two passes over the stencils, each reading
its weights once and gathering pressure and velocity together: 130 + 140, beside 130 of a bare gather; with products of
weight and distance d stored and each neighbour's gradients multiplied by them it took 180 + 195. Rows without images
skip their decoding. Sums are four numbers wide and kept by component, so that LLVM's vectoriser takes them: with one
number in four left unread it gives up, 590 instructions against 430. What did not pay: dissipation and Laplacian
weights in f32 (their conversion costs what their memory saves, 112 against 99 for a bare gather), all weights of an
entry in one vector (220 against 127), unrolling 14 neighbours (compiles ten times longer, runs the same). Rows packed
one after the other instead of WIDTH apart save 15 % of a pass, of the bare gather as well.
"""

from taichi_eye.backend import real
from taichi_eye.lang import ti
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


@ti.func
def _flat(matrix):
    # LLVM's vectoriser takes four numbers in a row, and not a matrix of them
    return ti.Vector([matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]])


@ti.data_oriented
class MfpmOperators:
    """Operator coefficients over neighbour lists.

    neighbours: lists whose entries the stencils take, nearest first. After `choose_stencils` or `rebuild`:
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
        self.pair_sum = ti.field(fp, neighbours.capacity)
        self.anchor, self.arm_sum = ti.Vector.field(2, fp), ti.Vector.field(2, fp)
        ti.root.dense(ti.i, neighbours.capacity).place(self.anchor, self.arm_sum)
        self.mirrored = ti.field(ti.i32, neighbours.capacity)  # 1 where a stencil holds images
        self.condition = ti.field(fp, neighbours.capacity)
        self.moment = ti.field(fp, (neighbours.capacity, self.terms, self.terms))
        self.scale = ti.field(fp, (neighbours.capacity, self.terms))
        self.basis_value = ti.field(fp, (neighbours.capacity, self.terms))

    def choose_stencils(self, points, wanted: int, limit: float, eye: int = 0) -> None:
        """Take `wanted` nearest entries per node (ties included), more where the moment matrix is worse than `limit`.

        All weights follow at once: at a start, `rebuild` need not be compiled before the cornea has moved.
        """
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
            self.mirrored[i] = 0
            for k in range(self.size[i]):
                if self.neighbours.entry[i, k] < 0:
                    self.mirrored[i] = 1
            self._weights(i, points)

    def rebuild(self, points, due=None) -> None:
        """Compute all weights for the nodes at `points`; the stencils stay. due [eyes]: 1 for the eyes it is done
        for."""
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
                    derivative[row] += self.moment[i, row, b] * self.scale[i, b] * self.basis_value[i, b]
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
        pair_sum, arm_sum = 0.0, ti.Vector([0.0, 0.0])
        for k in range(self.size[i]):
            self.pair_weight[i, k] /= weight_sum
            pair_sum += self.pair_weight[i, k]
            arm_sum += self.pair_weight[i, k] * (place_of(points, self.neighbours.entry[i, k]) - points[i])
        self.anchor[i], self.pair_sum[i], self.arm_sum[i] = points[i], pair_sum, arm_sum

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
    def gradient_of_first(self, i, f: ti.template()):
        """Gradient at node i of the first component, an even scalar, of a vector field."""
        here = f[i][0]
        total = ti.Vector([0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = image_of(self.neighbours.entry[i, k])
            total += self.gradient_weight[i, k] * (f[j][0] - here)
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
    def _neighbour(self, i, k, images: ti.template()):
        # node and sign of an entry; without images there is nothing to decode
        j, sign = self.neighbours.entry[i, k], 1.0
        if ti.static(images):
            node, side = image_of(j)
            j, sign = node, float(side)
        return j, sign

    @ti.func
    def row_of_velocity(self, i, f, u, slopes):
        """What `gradient_and_roughness` gathers from node i besides slopes: f, 2 u - slopes . x."""
        x = self.anchor[i]
        return ti.Vector(
            [
                f,
                2.0 * u[0] - (slopes[0, 0] * x[0] + slopes[0, 1] * x[1]),
                2.0 * u[1] - (slopes[1, 0] * x[0] + slopes[1, 1] * x[1]),
                0.0,
            ]
        )

    @ti.func
    def row_of_scalar(self, i, f, slope):
        """What a scalar's roughness is gathered from at node i: 2 f - slope . x, slope."""
        return ti.Vector([2.0 * f - slope.dot(self.anchor[i]), slope[0], slope[1], 0.0])

    @ti.func
    def gradient_and_roughness(self, i, rows: ti.template(), slopes: ti.template()):
        """grad f of an even scalar and P u of a velocity field in one pass over node i; rows: `row_of_velocity`."""
        gradient, rough = ti.Vector([0.0, 0.0]), ti.Vector([0.0, 0.0])
        if self.mirrored[i] == 0:
            gradient, rough = self._gradient_and_roughness(i, rows, slopes, False)
        else:
            gradient, rough = self._gradient_and_roughness(i, rows, slopes, True)
        return gradient, rough

    @ti.func
    def _gradient_and_roughness(self, i, rows: ti.template(), slopes: ti.template(), images: ti.template()):
        here, slope = rows[i], _flat(slopes[i])
        gradient, apart = ti.Vector([0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0, 0.0])
        bent = ti.Vector([0.0, 0.0, 0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = self._neighbour(i, k, images)
            d, other, weight = rows[j], _flat(slopes[j]), self.pair_weight[i, k]
            if ti.static(images):
                # d/dz of an odd field and d/dr of an even one change sign at an image
                d[1] *= sign
                other[1] *= sign
                other[2] *= sign
            d -= here
            apart += weight * d
            bent += weight * (other - slope)
            gradient += self.gradient_weight[i, k] * d[0]
        x, arm = self.anchor[i], self.arm_sum[i]
        bent = bent * ti.Vector([x[0], x[1], x[0], x[1]]) - slope * ti.Vector([arm[0], arm[1], arm[0], arm[1]])
        # what is not needed of the four is read too, see `_scalar_roughness`
        unused = 0.0 * apart[0] + apart[3]
        rough = ti.Vector([unused + apart[1] + (bent[0] + bent[1]), apart[2] + (bent[2] + bent[3])])
        return gradient, rough

    @ti.func
    def derivatives_and_roughness(self, i, points: ti.template(), u: ti.template(), rows: ti.template()):
        """Gradient and vector Laplacian of u, and P f of a scalar, in one pass over node i; rows: `row_of_scalar`."""
        gradient, laplacian, rough = ti.Matrix([[0.0, 0.0], [0.0, 0.0]]), ti.Vector([0.0, 0.0]), 0.0
        if self.mirrored[i] == 0:
            gradient, laplacian, rough = self._derivatives_and_roughness(i, u, rows, False)
        else:
            gradient, laplacian, rough = self._derivatives_and_roughness(i, u, rows, True)
        return gradient, self._vector_laplacian(i, points, u, laplacian), rough

    @ti.func
    def _derivatives_and_roughness(self, i, u: ti.template(), rows: ti.template(), images: ti.template()):
        u_here, here = u[i], rows[i]
        gradient, laplacian = ti.Vector([0.0, 0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0])
        apart = ti.Vector([0.0, 0.0, 0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = self._neighbour(i, k, images)
            weight, d, other = self.gradient_weight[i, k], u[j], rows[j]
            if ti.static(images):
                d[0] *= sign
                other[1] *= sign
            d -= u_here
            other -= here
            gradient += ti.Vector([weight[0] * d[0], weight[1] * d[0], weight[0] * d[1], weight[1] * d[1]])
            laplacian += self.laplacian_weight[i, k] * d
            apart += self.pair_weight[i, k] * other
        return (
            ti.Matrix([[gradient[0], gradient[1]], [gradient[2], gradient[3]]]),
            laplacian,
            self._scalar_roughness(i, here, apart),
        )

    @ti.func
    def _scalar_roughness(self, i, here, apart):
        x, arm = self.anchor[i], self.arm_sum[i]
        # the fourth is 0, and read so that the sum stays four numbers wide: LLVM's vectoriser takes those
        return apart[0] + (apart[1] * x[0] + apart[2] * x[1]) - (here[1] * arm[0] + here[2] * arm[1]) + apart[3]

    @ti.func
    def roughness_at(self, i, rows: ti.template()):
        """P f at node i of a scalar; rows: `row_of_scalar`."""
        here, apart = rows[i], ti.Vector([0.0, 0.0, 0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = self._neighbour(i, k, True)
            other = rows[j]
            other[1] *= sign
            apart += self.pair_weight[i, k] * (other - here)
        return self._scalar_roughness(i, here, apart)

    @ti.func
    def divergence_at(self, i, points: ti.template(), u: ti.template()):
        """Axisymmetric divergence at node i of a velocity field (u_r odd, u_z even)."""
        here, total = u[i], ti.Vector([0.0, 0.0])
        for k in range(self.size[i]):
            j, sign = self._neighbour(i, k, True)
            d = u[j]
            d[0] *= sign
            total += (d - here) * self.gradient_weight[i, k]
        return self.divergence_from(i, points, u, ti.Matrix([[total[0], 0.0], [0.0, total[1]]]))

    @ti.func
    def _vector_laplacian(self, i, points: ti.template(), u: ti.template(), componentwise):
        # (lap u_r - u_r / r^2, lap u_z)
        total = componentwise
        if ti.static(not self.planar):
            if points[i][0] > 0.0:
                total[0] -= u[i][0] / ti.max(points[i][0] ** 2, 1e-30)
            else:
                total[0] = 0.0
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
        return self._vector_laplacian(i, points, u, total)

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
            out[i] = self.divergence_at(i, points, u)

    @ti.kernel
    def velocity_laplacian(self, points: ti.template(), u: ti.template(), out: ti.template()):
        """out[i] = vector Laplacian of the velocity field u at every node."""
        for i in range(self.neighbours.total[None]):
            out[i] = self.velocity_laplacian_at(i, points, u)
