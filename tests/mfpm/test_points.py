"""The operators as arrays: exact on what they must reproduce, in any unit, and refused where they cannot be had."""

import numpy as np
import pytest

from taichi_eye import PointCloud

RNG = np.random.default_rng(5)
POINTS = RNG.random((150, 2))


@pytest.fixture(scope="module")
def meridian():
    return PointCloud(1e-3 * POINTS)


def test_even_polynomials_are_exact_in_the_half_plane(meridian):
    r, z = 1e-3 * POINTS.T
    f = 3.0 * r**2 - 2.0 * z**2 + z
    np.testing.assert_allclose(meridian.gradient(f), np.column_stack([6 * r, 1 - 4 * z]), atol=1e-9)
    # rounding: of the largest value over the smallest spacing squared
    apart = np.sort(np.hypot(*(POINTS[:, None] - POINTS[None]).T), axis=1)[:, 1]
    np.testing.assert_allclose(
        meridian.laplacian(f), 12.0 - 4.0, atol=1e-13 * np.abs(f).max() / (1e-3 * apart.min()) ** 2
    )
    assert meridian.condition.shape == (150,) and (meridian.condition >= 1.0).all()


@pytest.mark.parametrize("f", [np.ones(149), np.ones((150, 2)), np.full(150, np.nan)], ids=["short", "wide", "nan"])
def test_values_that_are_not_one_a_point_are_refused(meridian, f):
    with pytest.raises(ValueError, match="150 finite values"):
        meridian.gradient(f)


@pytest.mark.parametrize(
    "points, planar, said",
    [
        (np.vstack([POINTS, [[9.0, 9.0]]]), True, r"point 150 at \(9, 9\): has no neighbours"),
        (np.vstack([POINTS, POINTS[7:8]]), True, "another point lies at the same place"),
        (np.column_stack([np.linspace(0, 1, 40), np.zeros(40)]), True, "do not determine its derivatives"),
        (POINTS - 0.5, False, "a radius is not negative"),
        (np.where(np.arange(300).reshape(150, 2) == 8, np.inf, POINTS), True, "point 4 at .*finite"),
        (POINTS[:10], True, r"\[n, 2\] with n > 14"),
        (POINTS.T, True, r"\[n, 2\]"),
    ],
    ids=["apart", "twice", "line", "negative", "infinite", "few", "turned"],
)
def test_points_without_derivatives_are_refused_by_name(points, planar, said):
    with pytest.raises(ValueError, match=said):
        PointCloud(points, planar)


def test_an_unknown_basis_is_refused():
    with pytest.raises(ValueError, match="quadratic, cubic"):
        PointCloud(POINTS, basis="linear")
