"""The mesh-free operators on points of your own: how fast their error falls.

    python -m taichi_eye.examples.laplacian

Points of a square, a grid that is jittered by a fifth of its spacing, and f = sin(3 x) cos(2 z), of which gradient and
Laplacian are known. A table of errors, and the order at which they fall from each spacing to the next: 2 for the
gradient and 1 for the Laplacian with the quadratic basis, 3 and 2 with the cubic one. The jitter is another one at
each spacing, so single orders scatter about these.
"""

import sys

import numpy as np

from taichi_eye import PointCloud


def scattered(side, seed=1):
    """side x side points [side^2, 2] in the unit square, scattered about a grid."""
    steps = (np.arange(side) + 0.5) / side
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return grid + 0.2 / side * np.random.default_rng(seed).uniform(-1.0, 1.0, grid.shape)


def errors(side, basis):
    """Root mean square errors of gradient and Laplacian on side x side points."""
    x, z = (points := scattered(side)).T
    cloud = PointCloud(points, planar=True, basis=basis)
    f = np.sin(3 * x) * np.cos(2 * z)
    slope = np.column_stack([3 * np.cos(3 * x) * np.cos(2 * z), -2 * np.sin(3 * x) * np.sin(2 * z)])
    rms = lambda off: float(np.sqrt(np.mean(off**2)))
    return rms(cloud.gradient(f) - slope), rms(cloud.laplacian(f) + 13 * f)


def main(sides=(12, 24, 48), basis="quadratic"):
    """Print the table; the orders [refinements, 2]."""
    found = np.array([errors(side, basis) for side in sides])
    orders = np.log(found[:-1] / found[1:]) / np.log(np.divide(sides[1:], sides[:-1]))[:, None]
    print("points   gradient    order   Laplacian   order")
    for side, row, order in zip(sides, found, [(np.nan, np.nan), *orders]):
        print(f"{side**2:6}   {row[0]:.3e}   {order[0]:5.2f}   {row[1]:.3e}   {order[1]:5.2f}")
    return orders


if __name__ == "__main__":
    main(basis=sys.argv[1] if len(sys.argv) > 1 else "quadratic")
