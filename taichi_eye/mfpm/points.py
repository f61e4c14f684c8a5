"""The operators on scattered points as NumPy sees them: arrays in, arrays out.

    cloud = PointCloud(points)                 # [n, 2]: r >= 0 and z of an axisymmetric half plane, any unit
    cloud.gradient(f), cloud.laplacian(f)      # f [n]: even in r

planar: x and z of a plane instead. The theory is that of `taichi_eye.mfpm.operators`. Every point takes its nearest
neighbours, more where these leave it ill conditioned; a point that stays so, or stands apart from all others, has no
derivatives worth the name, and the cloud is refused. Fields and kernels of a cloud stay with the process: make one and
use it for many fields.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye import backend
from taichi_eye.lang import ti
from taichi_eye.mfpm.neighbours import NeighbourLists
from taichi_eye.mfpm.operators import CONDITION_LIMIT, STENCIL, WIDTH, MfpmOperators

APART = 4.0  # reach of a point's stencil over that of its neighbours' beyond which it stands apart
MARGIN = 1.5  # of the search beyond what the stencils want: some take more


class PointCloud:
    """Gradient and Laplacian on scattered points.

    points [n, 2], basis "quadratic" (gradient of 2nd order, Laplacian of 1st) or "cubic" (3rd, 2nd). After it is made:
    condition [n], of each scaled moment matrix. ValueError names the point that cannot be had and why.
    """

    def __init__(self, points: ArrayLike, planar: bool = False, basis: str = "quadratic"):
        if basis not in STENCIL:
            raise ValueError(f"basis = {basis!r}: allowed are {', '.join(STENCIL)}")
        self.points = np.array(points, dtype=float)
        self.count, self.planar = len(self.points), planar
        self._refuse_bad_shape(STENCIL[basis])
        reach = self._reach(STENCIL[basis])
        fp = backend.real()
        self._generation = backend.generation()
        self._place, self._slope = (ti.Vector.field(2, fp, self.count) for _ in range(2))
        self._value, self._result = (ti.field(fp, self.count) for _ in range(2))
        neighbours = NeighbourLists(self.count, WIDTH[basis], planar)
        self._operators = MfpmOperators(neighbours, basis)
        # lengths in mean reaches, so that any unit will do in single precision, too
        self._unit = float(np.mean(reach))
        self._place.from_numpy(self._typed(self.points / self._unit))
        neighbours.search(self._place, self.count, MARGIN * float(reach.max()) / self._unit)
        self._operators.choose_stencils(self._place, STENCIL[basis], CONDITION_LIMIT[basis])
        self.condition = self._operators.condition.to_numpy().astype(float)
        bad = ~(self.condition <= CONDITION_LIMIT[basis])
        if bad.any():
            i = int(bad.argmax())
            raise ValueError(
                f"{self._named(i)}: its neighbours do not determine its derivatives (condition "
                f"{self.condition[i]:.3g}, at most {CONDITION_LIMIT[basis]:g}; {int(bad.sum())} such points): they may "
                "lie on a line; add points"
            )

    def gradient(self, f: ArrayLike) -> np.ndarray:
        """Gradient [n, 2] of a scalar f [n]."""
        self._take(f)
        self._operators.gradient(self._value, self._slope)
        return self._slope.to_numpy().astype(float) / self._unit

    def laplacian(self, f: ArrayLike) -> np.ndarray:
        """Laplacian [n] of a scalar f [n]: f_rr + f_r/r + f_zz, or f_xx + f_zz where planar."""
        self._take(f)
        self._operators.laplacian(self._value, self._result)
        return self._result.to_numpy().astype(float) / self._unit**2

    def _take(self, f: ArrayLike) -> None:
        values = np.asarray(f, dtype=float)
        if values.shape != (self.count,) or not np.isfinite(values).all():
            raise ValueError(f"f has the shape {values.shape}: {self.count} finite values are needed, one a point")
        backend.refuse_lost(self._generation)
        self._value.from_numpy(self._typed(values))

    @staticmethod
    def _typed(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float64 if backend.real() == ti.f64 else np.float32)

    def _named(self, i: int) -> str:
        return f"point {i} at ({self.points[i, 0]:g}, {self.points[i, 1]:g})"

    def _refuse_bad_shape(self, wanted: int) -> None:
        if self.points.ndim != 2 or self.points.shape[1:] != (2,) or self.count <= wanted:
            raise ValueError(f"points have the shape {self.points.shape}; [n, 2] with n > {wanted} is needed")
        bad = ~np.isfinite(self.points).all(axis=1)
        if bad.any():
            raise ValueError(f"{self._named(int(bad.argmax()))}: both coordinates must be finite")
        if not self.planar and (self.points[:, 0] < 0.0).any():
            i = int(self.points[:, 0].argmin())
            raise ValueError(f"{self._named(i)}: a radius is not negative (planar=True takes any)")

    def _reach(self, wanted: int) -> np.ndarray:
        """Distance [n] to the farthest neighbour that a stencil wants; refuses what coincides or stands apart."""
        from scipy.spatial import cKDTree  # slow to load

        distance, other = cKDTree(self.points).query(self.points, wanted + 1)
        twin = distance[:, 1] <= 1e-9 * distance[:, -1]
        if twin.any():
            raise ValueError(f"{self._named(int(twin.argmax()))}: another point lies at the same place")
        reach = distance[:, -1]
        lonely = reach > APART * np.median(reach[other[:, 1:]], axis=1)
        if lonely.any():
            raise ValueError(
                f"{self._named(int(lonely.argmax()))}: has no neighbours, the {wanted} nearest points reach "
                f"{reach[lonely.argmax()]:.3g} away; leave it out or add points around it"
            )
        return reach
