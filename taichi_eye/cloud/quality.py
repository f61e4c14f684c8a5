"""How good a node cloud is: smallest gap, largest hole, evenness."""

from dataclasses import dataclass

from scipy.spatial import cKDTree

from taichi_eye.cloud.packing import Cloud, circumradii


@dataclass(frozen=True)
class CloudQuality:
    """Figures in spacings: nearest-neighbour distances and the largest empty disc between nodes."""

    nodes: int
    smallest_gap: float
    mean_gap: float
    largest_hole: float


def measure(cloud: Cloud, points=None) -> CloudQuality:
    """Quality of a cloud at rest, or with its nodes at `points` [n, 2] (m) in a deformed state."""
    points = cloud.points if points is None else points
    gap = cKDTree(points).query(points, k=2)[0][:, 1]
    hole = circumradii(points, cloud.triangles)
    middle = points[cloud.triangles].mean(1)
    # a flat triangle along the boundary is no hole: its circle lies mostly outside
    inside = cloud.section.wall_clearance(middle) > 0.02 * cloud.spacing if points is cloud.points else hole > 0.0
    return CloudQuality(
        len(points),
        float(gap.min() / cloud.spacing),
        float(gap.mean() / cloud.spacing),
        float(hole[inside].max() / cloud.spacing),
    )
