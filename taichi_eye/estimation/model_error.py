"""What the model itself gets wrong: the term of the likelihood that noise does not explain.

Of a history: a Gaussian process in time, Matern 3/2 with a time of TIME_MS, in films along the cornea, too (REACH_MM),
times the square root of the dent's depth over its largest, so that an eye at rest is at rest in the model as well. What
a model gets wrong goes on for milliseconds and does not average out over frames as noise does. A trace's holds as much
again of what lasts the whole puff: a dent too deep by a share, and one too late. Of a row of parameters:
an independent error of each.

How large it is by default is what the scene's own eye is off living eyes (`taichi_eye.analysis.norms`), at their mean
pressure and thickness, on the cavity rung. A parameter's error is its distance from the judging population's mean, at
least LEAST_SHARE of that population's standard deviation: a level that was fitted is not known better for it. The
history's is the root mean square of three distances: the largest deformation, and those by which the apex is early or
late at both applanations (time times velocity); at least LEAST_MM, at most MOST_MM. Independent models of the same eyes
leave 20 to 30 um.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS, judged_by
from taichi_eye.analysis.response import respond
from taichi_eye.estimation.motion import cheap
from taichi_eye.estimation.parameters import REPEATABILITY
from taichi_eye.scene import Scene
from taichi_eye.scene.variant import eye_at

LIVING_MMHG, LIVING_UM = 14.75, 551.0  # means of the 194 eyes
TIME_MS, REACH_MM = 2.0, 1.0
LEAST_MM, MOST_MM = 0.020, 0.15
LEAST_SHARE = 0.25
UNJUDGED_SHARE = 0.10  # of a parameter's value, where no population has it


@dataclass(frozen=True)
class ModelError:
    """history_mm: standard deviation of a history where the dent is deepest; parameters: of those that have norms;
    share: of the value of another parameter."""

    history_mm: float
    parameters: Mapping[str, float]
    share: float

    def of(self, name: str, value: float) -> float:
        """The error of a parameter."""
        return self.parameters.get(name, self.share * abs(value))


NONE = ModelError(0.0, {}, 0.0)
CAVITY = ModelError(0.05, {}, 0.05)  # what the cheapest model leaves out


@lru_cache(maxsize=16)
def of_scene(scene: Scene) -> ModelError:
    """The model error of a scene, from its eye beside living ones."""
    motion = cheap(eye_at(scene, LIVING_MMHG, LIVING_UM))
    found = (
        respond(motion.curves, scene.camera.frame_interval_ms, age_years=ELDERLY_AGE_YEARS) if motion.curves else None
    )
    parameters, off = {}, {}
    for name in REPEATABILITY:
        judge, value = judged_by(name), getattr(found, name, None)
        if judge is None:
            continue
        off[name] = 2.0 * judge[2] if value is None else value - judge[1]
        parameters[name] = max(abs(off[name]), LEAST_SHARE * judge[2])
    norms = {name: judged_by(name)[1] for name in ("a1_velocity_m_s", "a2_velocity_m_s")}
    distances = (
        off["deformation_amplitude_mm"],
        off["a1_time_ms"] * norms["a1_velocity_m_s"],
        off["a2_time_ms"] * norms["a2_velocity_m_s"],
    )
    size = float(np.sqrt(np.mean(np.square(distances))))
    return ModelError(float(np.clip(size, LEAST_MM, MOST_MM)), parameters, UNJUDGED_SHARE)


def correlation(distance: np.ndarray, reach: float) -> np.ndarray:
    """Matern 3/2 at distances [any shape]."""
    r = np.sqrt(3.0) * np.abs(distance) / reach
    return (1.0 + r) * np.exp(-r)


def lasting(depth: np.ndarray, pace: np.ndarray) -> np.ndarray:
    """Correlation of an error that lasts the whole history: too deep by a share, and too late, each by one standard
    deviation where it shows most."""
    deep, fast = (one / max(float(np.abs(one).max()), 1e-9) for one in (depth, pace))
    return np.outer(deep, deep) + np.outer(fast, fast)


def envelope(depth: np.ndarray) -> np.ndarray:
    """How much of the error shows at depths of the dent over a history: 0 at rest, 1 where it is deepest."""
    top = max(float(np.nanmax(depth)), 1e-9)
    return np.sqrt(np.clip(np.nan_to_num(depth) / top, 0.0, 1.0))
