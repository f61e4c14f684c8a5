"""MFPM operators: what they must reproduce to rounding, and how fast they converge on the rest."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.special import j0, j1

from taichi_eye.cloud.packing import FREE
from taichi_eye.mfpm.operators import CONDITION_LIMIT

ROUNDING = 1e-9  # times the largest value over the spacing to the order of the derivative
LENGTH = 3e-3
SECTIONS = {
    "flat back": {},
    "flat cornea": {"radius": 9.5e-3},
    "side wall": {"depth": 4e-3},
    "lens": {"depth": 3.2e-3, "lens": (10e-3, 0.6e-3)},
}


def jittered(cloud, share, seed):
    """The points of a cloud, the free ones moved by up to `share` spacings in r and z."""
    points = cloud.points.copy()
    free = cloud.kind == FREE
    points[free] += share * cloud.spacing * np.random.default_rng(seed).uniform(-1.0, 1.0, (free.sum(), 2))
    return points


def even(r, z, degree, rng):
    """A random polynomial in r^2 and z with its gradient and axisymmetric Laplacian."""
    x, y = r / LENGTH, z / LENGTH
    a = rng.normal(size=6)
    f = a[0] + a[1] * y + a[2] * y**2 + a[3] * x**2
    slope = np.column_stack([2 * a[3] * x, a[1] + 2 * a[2] * y])
    laplacian = 2 * a[2] + 4 * a[3] + 0.0 * x
    if degree == 3:
        f = f + a[4] * y**3 + a[5] * x**2 * y
        slope = slope + np.column_stack([2 * a[5] * x * y, 3 * a[4] * y**2 + a[5] * x**2])
        laplacian = laplacian + 6 * a[4] * y + 4 * a[5] * y
    return f, slope / LENGTH, laplacian / LENGTH**2


def odd(r, z, degree, rng):
    """A random polynomial odd in r: f, f_r + f / r, and the Laplacian less f / r^2."""
    x, y = r / LENGTH, z / LENGTH
    a = rng.normal(size=4)
    f, ring, laplacian = a[0] * x + a[1] * x * y, 2 * a[0] + 2 * a[1] * y, 0.0 * x
    if degree == 3:
        f = f + a[2] * x**3 + a[3] * x * y**2
        ring = ring + 4 * a[2] * x**2 + 2 * a[3] * y**2
        laplacian = laplacian + 8 * a[2] * x + 2 * a[3] * x
    return f, ring / LENGTH, laplacian / LENGTH**2


def assert_reproduced(bench, points, spacing, seed):
    """Every operator of the bench is exact to rounding on a random polynomial of its degree, axis included."""
    degree = 3 if bench.basis == "cubic" else 2
    rng = np.random.default_rng(seed)
    r, z = points.T
    assert np.any(r == 0.0)
    f, slope, laplacian = even(r, z, degree, rng)
    scale = np.abs(f).max()
    np.testing.assert_allclose(bench.gradient(f), slope, rtol=0, atol=ROUNDING * scale / spacing)
    np.testing.assert_allclose(bench.laplacian(f), laplacian, rtol=0, atol=ROUNDING * scale / spacing**2)
    u_r, ring, curl_part = odd(r, z, degree, rng)
    u = np.column_stack([u_r, f])
    scale = np.abs(u).max()
    np.testing.assert_allclose(bench.divergence(u), ring + slope[:, 1], rtol=0, atol=ROUNDING * scale / spacing)
    np.testing.assert_allclose(
        bench.velocity_laplacian(u), np.column_stack([curl_part, laplacian]), rtol=0, atol=ROUNDING * scale / spacing**2
    )


@pytest.fixture(params=["quadratic", "cubic"])
def bench(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("spacing_mm", [0.31, 0.17])
def test_polynomials_of_the_basis_are_reproduced(bench, cloud_at, section, spacing_mm):
    cloud = cloud_at(spacing_mm, **SECTIONS[section])
    for seed in range(3):
        points = jittered(cloud, 0.1 * seed, seed)
        bench.build(points, cloud.spacing)
        assert_reproduced(bench, points, cloud.spacing, seed)


@pytest.mark.parametrize("dent_mm", [0.6, 1.2])
def test_rebuilt_weights_reproduce_polynomials_on_moved_nodes(bench, cloud_at, dent_mm):
    cloud = cloud_at(0.2)
    bench.build(cloud.points, cloud.spacing)
    sizes = bench.operators.size.to_numpy()
    moved = cloud.points.copy()
    moved[:, 1] -= dent_mm * 1e-3 * cloud.height_fraction * np.exp(-((moved[:, 0] / 1.8e-3) ** 2))
    bench.move(moved)
    np.testing.assert_array_equal(bench.operators.size.to_numpy(), sizes)
    assert_reproduced(bench, moved, cloud.spacing, seed=7)
    bench.move(cloud.points)
    assert_reproduced(bench, cloud.points, cloud.spacing, seed=8)


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("spacing_mm", [0.31, 0.22, 0.15])
def test_no_stencil_is_near_singular(bench, cloud_at, section, spacing_mm):
    cloud = cloud_at(spacing_mm, **SECTIONS[section])
    bench.build(cloud.points, cloud.spacing)
    assert bench.condition.max() < CONDITION_LIMIT[bench.basis]
    assert bench.condition.min() >= 1.0


def wave(points, k, m, phase):
    """J0(k r) cos(m z + phase) as scalar and a velocity of the same waves, with their exact derivatives."""
    r, z = points.T
    c, s = np.cos(m * z + phase), np.sin(m * z + phase)
    f = j0(k * r) * c
    u = np.column_stack([j1(k * r) * s, f])
    return (
        f,
        np.column_stack([-k * j1(k * r) * c, -m * j0(k * r) * s]),
        -(k * k + m * m) * f,
        u,
        (k - m) * j0(k * r) * s,
        -(k * k + m * m) * u,
    )


@pytest.mark.parametrize("jitter", [0.0, 0.12])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name, first, second", [("quadratic", 1.8, 0.8), ("cubic", 2.7, 1.8)])
def test_operators_converge_at_the_order_of_their_basis(request, cloud_at, name, first, second, seed, jitter):
    bench, rng = request.getfixturevalue(name), np.random.default_rng(seed)
    # several waves: the worst node of a single one falls unevenly
    waves = np.column_stack([rng.uniform(400, 800, 6), rng.uniform(600, 1000, 6), rng.uniform(0, 3, 6)])
    spacings = (0.36, 0.25, 0.18, 0.125, 0.09)
    errors = np.empty((len(spacings), len(waves), 4))
    for h, spacing_mm in enumerate(spacings):
        cloud = cloud_at(spacing_mm)
        points = jittered(cloud, jitter, seed)
        bench.build(points, cloud.spacing)
        for n, (k, m, phase) in enumerate(waves):
            f, slope, laplacian, u, divergence, vector_laplacian = wave(points, k, m, phase)
            errors[h, n] = [
                np.abs(got - exact).max()
                for got, exact in (
                    (bench.gradient(f), slope),
                    (bench.divergence(u), divergence),
                    (bench.laplacian(f), laplacian),
                    (bench.velocity_laplacian(u), vector_laplacian),
                )
            ]
    order = np.polyfit(np.log(spacings), np.log(errors).mean(1), 1)[0]
    assert np.all(order[:2] > first), order
    assert np.all(order[2:] > second), order


THREADS_SCRIPT = """
import hashlib, sys
from taichi_eye import backend
backend.init("cpu", "f64", threads=int(sys.argv[1]))
sys.path.insert(0, sys.argv[2])
from conftest import Bench
from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
cloud = pack(Section(7.8e-3, 5.8e-3, 2.7e-3), 0.25e-3)
bench = Bench("quadratic").build(cloud.points, cloud.spacing)
digest = hashlib.sha256(bench.gradient(cloud.points[:, 0] ** 2).tobytes())
for field in (bench.operators.gradient_weight, bench.operators.laplacian_weight, bench.operators.pair_weight,
              bench.operators.arm_sum,
              bench.neighbours.entry, bench.operators.size):
    digest.update(field.to_numpy().tobytes())
print(digest.hexdigest())
"""


def test_bits_do_not_depend_on_the_thread_count(request):
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    digests = set()
    for threads in (1, 2):
        command = [sys.executable, "-c", THREADS_SCRIPT, str(threads), str(request.path.parent)]
        run = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        digests.add(run.stdout.split()[-1])
    assert len(digests) == 1 and len(digests.pop()) == 64
