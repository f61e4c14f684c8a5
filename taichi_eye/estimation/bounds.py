"""How well the pressure of a scene's own eye can be known at all: the bound of Cramer and Rao, without a search."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from taichi_eye.estimation.estimate import problem_of
from taichi_eye.estimation.fit import Problem
from taichi_eye.estimation.motion import Motion, cheap
from taichi_eye.estimation.observation import of_history
from taichi_eye.estimation.unknowns import IOP, own_values
from taichi_eye.scene import Scene

FRAMES, INTERVAL_MS = 139, 0.2315


def at_truth(problem: Problem, truth: Mapping[str, float]) -> float:
    """The least standard deviation [mmHg] of the IOP that an unbiased estimate can have at the truth."""
    place, covariance, _ = _linear(problem, truth)
    k = problem.before.names.index(IOP)
    return float(np.exp(place[k]) * np.sqrt(covariance[k, k]))


def best_at_truth(problem: Problem, truth: Mapping[str, float], motion: Motion) -> float:
    """The IOP [mmHg] of the estimate that reaches the bound: that of the problem taken for linear at the truth, whose
    motion is given, with the very noise of the data."""
    place, covariance, slopes = _linear(problem, truth)
    noise = problem.whitened(problem.seen.values - problem.seen.predict(motion))
    before = problem.before
    step = covariance @ (problem.whitened(slopes).T @ noise + before.precision @ (before.mean - place))
    return float(np.exp((place + step)[before.names.index(IOP)]))


def _linear(problem: Problem, truth: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The truth's place, and covariance and derivatives of the data there."""
    place = np.log([truth[name] for name in problem.before.names])
    slopes = problem.slopes(place, anew=True)
    return place, np.linalg.inv(problem.information(place) + problem.before.precision), slopes


def of_own_eye(
    scene: Scene, known: Mapping, noise_um: float = 10.0, model_error_um: float = 0.0, frames: int = FRAMES
) -> float:
    """The same of the scene's eye, its apex seen at a camera's pace; known: as `taichi_eye.estimate` takes it."""
    motion, time_ms = cheap(scene), INTERVAL_MS * np.arange(frames)
    seen = of_history("own", time_ms, np.interp(time_ms, motion.time_ms, motion.apex_mm), False, 1e-3 * noise_um)
    return at_truth(problem_of(seen, scene, known, model_error_um=model_error_um), own_values(scene))
