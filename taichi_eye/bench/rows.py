"""Rows of the bench's table: a measured figure beside what is asked of it."""

import math
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Row:
    """One measured figure.

    value: None where it could not be had, and `note` says why; asked: in words, empty where nothing is; holds: whether
    the value is what is asked, None where nothing is asked or nothing was measured; note: sizes and settings.
    """

    name: str
    value: float | None
    unit: str = ""
    asked: str = ""
    holds: bool | None = None
    note: str = ""

    def as_dict(self) -> dict:
        """The row for the JSON file; a figure that is not finite becomes null."""
        return {**asdict(self), "value": self.value if self.value is not None and math.isfinite(self.value) else None}


def figure(name: str, value: float, unit: str = "", note: str = "") -> Row:
    """A figure of which nothing is asked."""
    return Row(name, value, unit, note=note)


def at_most(name: str, value: float, unit: str, limit: float, note: str = "") -> Row:
    """A figure that is to be `limit` or less; NaN is not."""
    return Row(name, value, unit, f"<= {limit:g}", bool(value <= limit), note)


def at_least(name: str, value: float, unit: str, limit: float, note: str = "") -> Row:
    """A figure that is to be `limit` or more; NaN is not."""
    return Row(name, value, unit, f">= {limit:g}", bool(value >= limit), note)


def skipped(name: str, reason: str, asked: str = "") -> Row:
    """A figure that cannot be had here."""
    return Row(name, None, asked=asked, note=f"skipped: {reason}")


def within(name: str, value: float, unit: str, low: float, high: float, slack: float, note: str = "") -> Row:
    """A figure that is to lie from `low` to `high`, give or take `slack`; NaN does not."""
    asked = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    return Row(
        name, value, unit, f"{asked} +- {slack:g}" if slack else asked, bool(low - slack <= value <= high + slack), note
    )
