"""How one key of a scene varies over the eyes of a study.

A law turns a share u of the unit interval into a value, by its quantile function, and gives the levels of a grid:

    { from = 10, to = 30 }                       uniform; scale = "log": uniform in the logarithm
    { from = 10, to = 30, steps = 21 }           for grids: so many levels, ends included
    { values = [10, 15, 30] }                    these, equally likely; also true, false and strings
    { mean = 0.55, sd = 0.031 }                  normal, cut off at the key's limits; at_least, at_most: nearer
    { within_percent = 20 }                      uniform about the scene's own value; steps, scale as above
    { sd_percent = 5 }                           normal about the scene's own value
    { follows = "cornea.thickness_mm", keeping = "difference" }     with another key; or "ratio"

What is relative is made absolute once the scene is known, so a study is kept with numbers alone.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

STEPS_MAX = 10_000
EDGE = 1e-12  # shares are kept so far from 0 and 1, where a normal law has no value


@dataclass(frozen=True)
class Uniform:
    """Uniform from `low` to `high`, or in their logarithms; steps: of a grid, None where none were named."""

    low: float
    high: float
    log: bool = False
    steps: int | None = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares of the unit interval."""
        share = np.asarray(share)
        if self.log:
            return np.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        return self.low + share * (self.high - self.low)

    @property
    def levels(self) -> list[float] | None:
        """The levels of a grid, the ends as they were written; None without steps."""
        if self.steps is None:
            return None
        inner = self.at(np.linspace(0.0, 1.0, self.steps))[1:-1].tolist()
        return [self.low, *inner, self.high] if self.steps > 1 else [float(self.at(np.array(0.5)))]

    def plain(self) -> dict[str, Any]:
        """As it is written in a study."""
        found: dict[str, Any] = {"from": self.low, "to": self.high}
        return found | ({"scale": "log"} if self.log else {}) | ({"steps": self.steps} if self.steps else {})


@dataclass(frozen=True)
class Normal:
    """Normal, cut off at `low` and `high`."""

    mean: float
    sd: float
    low: float
    high: float
    levels = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares of the unit interval."""
        # scipy.stats is slow to load
        from scipy.stats import truncnorm

        ends = (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd
        values = truncnorm.ppf(np.clip(share, EDGE, 1.0 - EDGE), *ends, loc=self.mean, scale=self.sd)
        return np.clip(values, self.low, self.high)

    def plain(self) -> dict[str, Any]:
        """As it is written in a study."""
        found = {"mean": self.mean, "sd": self.sd}
        ends = {"at_least": self.low, "at_most": self.high}
        return found | {name: value for name, value in ends.items() if math.isfinite(value)}


@dataclass(frozen=True)
class Choice:
    """One of some values, equally likely."""

    values: tuple

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares of the unit interval."""
        at = np.minimum((np.asarray(share) * len(self.values)).astype(int), len(self.values) - 1)
        return np.array(self.values, dtype=object if isinstance(self.values[0], str) else None)[at]

    @property
    def levels(self) -> list:
        """All values."""
        return list(self.values)

    def plain(self) -> dict[str, Any]:
        """As it is written in a study."""
        return {"values": list(self.values)}


@dataclass(frozen=True)
class Follower:
    """A key that goes with another one, keeping its difference from it, or its ratio to it, in the scene."""

    follows: str
    keeping: str

    def beside(self, values: np.ndarray, own: float, leader: float) -> np.ndarray:
        """Its values where the leader has `values`; own, leader: of the scene."""
        return own + (values - leader) if self.keeping == "difference" else own * (values / leader)

    def plain(self) -> dict[str, Any]:
        """As it is written in a study."""
        return asdict(self)


Law = Uniform | Normal | Choice
FORMS = {
    ("from", "to"): ("scale", "steps"),
    ("values",): (),
    ("mean", "sd"): ("at_least", "at_most"),
    ("within_percent",): ("scale", "steps"),
    ("sd_percent",): ("at_least", "at_most"),
    ("follows", "keeping"): (),
}
KEEPING = ("difference", "ratio")


class BadLaw(ValueError):
    """What is wrong with a law, in words."""


def read_law(written: Any, kind: type, spec: Any, own: Any) -> Law | Follower:
    """The law that a table of a study says; BadLaw otherwise.

    kind, spec: of the key, as in `taichi_eye.scene.schema.keys_of`; own: its value in the scene.
    """
    forms = "; ".join("{ " + ", ".join(form) + " }" for form in FORMS)
    if not isinstance(written, Mapping):
        raise BadLaw(f"must be a table, one of {forms}")
    form = next((form for form in FORMS if set(form) <= set(written)), None)
    if form is None:
        raise BadLaw(f"must be one of {forms}")
    unknown = [name for name in written if name not in (*form, *FORMS[form])]
    if unknown:
        beside = f"; beside {' and '.join(form)} may stand {', '.join(FORMS[form])}" if FORMS[form] else ""
        raise BadLaw(f"{unknown[0]} does not belong to {' and '.join(form)}{beside}")
    if form == ("values",):
        return _choice(written["values"], kind, spec)
    if kind is not float:
        raise BadLaw("only numbers vary continuously: name the values of this key, { values = [...] }")
    if form == ("follows", "keeping"):
        if written["keeping"] not in KEEPING or not isinstance(written["follows"], str):
            raise BadLaw('follows must name a key, keeping be "difference" or "ratio"')
        return Follower(written["follows"], written["keeping"])
    if form[0].endswith("percent"):
        return _relative(form[0], written, spec, own)
    return _uniform(written, spec) if form == ("from", "to") else _normal(written, spec)


def _number(written: Mapping, name: str) -> float:
    value = written[name]
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise BadLaw(f"{name} must be a finite number")
    return float(value)


def _held(spec: Any, value: float, name: str) -> None:
    if not spec.holds(value):
        raise BadLaw(f"{name} = {value:g} is out of the key's range, {spec.bounds()}")


def _uniform(written: Mapping, spec: Any) -> Uniform:
    low, high = _number(written, "from"), _number(written, "to")
    for name, value in (("from", low), ("to", high)):
        _held(spec, value, name)
    if not low < high:
        raise BadLaw("from must be below to")
    if written.get("scale", "linear") not in ("linear", "log"):
        raise BadLaw('scale must be "linear" or "log"')
    log = written.get("scale") == "log"
    if log and low <= 0.0:
        raise BadLaw("a logarithmic scale needs a from above 0")
    steps = written.get("steps")
    if steps is not None and (isinstance(steps, bool) or not isinstance(steps, int) or not 2 <= steps <= STEPS_MAX):
        raise BadLaw(f"steps must be a whole number from 2 to {STEPS_MAX}")
    return Uniform(low, high, log, steps)


def _normal(written: Mapping, spec: Any) -> Normal:
    mean, sd = _number(written, "mean"), _number(written, "sd")
    if not sd > 0.0:
        raise BadLaw("sd must be above 0")
    below = spec.at_most if spec.at_most is not None else spec.below and math.nextafter(spec.below, -math.inf)
    low = -math.inf if spec.at_least is None else float(spec.at_least)
    high = math.inf if below is None else float(below)
    if "at_least" in written:
        low = max(low, _number(written, "at_least"))
    if "at_most" in written:
        high = min(high, _number(written, "at_most"))
    if not low < high or not low <= mean <= high:
        raise BadLaw(f"the mean must lie within what is allowed, {low:g} to {high:g}")
    return Normal(mean, sd, low, high)


def _relative(form: str, written: Mapping, spec: Any, own: float) -> Uniform | Normal:
    percent, rest = _number(written, form), {name: value for name, value in written.items() if name != form}
    if not 0.0 < percent < 100.0:
        raise BadLaw(f"{form} must lie above 0 and below 100")
    if own == 0.0:
        raise BadLaw("the scene's own value is 0, of which there is no percentage: say from and to, or mean and sd")
    if form == "sd_percent":
        return _normal({"mean": own, "sd": abs(own) * percent / 100.0, **rest}, spec)
    ends = sorted((own * (1.0 - percent / 100.0), own * (1.0 + percent / 100.0)))
    return _uniform({"from": ends[0], "to": ends[1], **rest}, spec)


def _choice(values: Any, kind: type, spec: Any) -> Choice:
    if not isinstance(values, list) or not 1 <= len(values) <= STEPS_MAX:
        raise BadLaw(f"values must be an array of 1 to {STEPS_MAX} values")
    found = []
    for value in values:
        wanted = {float: numbers.Real, int: numbers.Integral}.get(kind, kind)
        if isinstance(value, bool) != (kind is bool) or not isinstance(value, wanted) or not spec.holds(kind(value)):
            raise BadLaw(f"{value!r} is none of the key's values, {spec.bounds() or kind.__name__}")
        found.append(kind(value))
    if len(set(found)) < len(found):
        raise BadLaw("the same value stands there twice")
    return Choice(tuple(found))
