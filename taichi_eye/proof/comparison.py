"""A measured figure beside its exact value, and measured orders of convergence."""

from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class Comparison:
    """One measured figure against its exact value.

    error: relative to `exact` unless `quantity` says otherwise; limit: the largest error allowed (None: reported only);
    order: measured order of convergence, order_limit: the least allowed; note: resolution and settings.
    """

    problem: str
    quantity: str
    exact: float | None
    value: float | None
    error: float
    limit: float | None = None
    order: float | None = None
    order_limit: float | None = None
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether error and order are within their limits; NaN is not."""
        near = self.limit is None or self.error <= self.limit
        steep = self.order_limit is None or (self.order is not None and self.order >= self.order_limit)
        return bool(near and steep)

    def as_dict(self) -> dict:
        """The row for the JSON file; a figure that is not finite becomes null."""
        plain = {
            name: (None if isinstance(value, float) and not np.isfinite(value) else value)
            for name, value in asdict(self).items()
        }
        return {**plain, "passed": self.passed}


def relative(value: float, exact: float) -> float:
    """|value - exact| / |exact|."""
    return abs(value - exact) / abs(exact)


def order(sizes, errors) -> float:
    """Slope of log error over log size by least squares: the measured order over all the refinements given."""
    sizes, errors = np.asarray(sizes, dtype=float), np.asarray(errors, dtype=float)
    if len(sizes) < 2 or not np.all(np.isfinite(errors)) or np.any(errors <= 0.0):
        return float("nan")
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
