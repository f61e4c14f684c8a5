"""An instrument's puff, estimated once over many eyes and held afterwards.

Two stages. Each eye is solved with strength and width of the puff nearly unknown (WIDE); what its data then tell of the
two, its other unknowns let go, is a mean and an inverse covariance. The eyes' sum over what is known of any instrument
is the instrument's. What the model gets wrong is the same for all eyes of one model: that part of a covariance does
not fall with their number, and the mean of it over the eyes is added to the sum of the rest.

A single eye estimated with the calibration is the same problem with another mean and precision of two unknowns
(`updated` says to first order what it comes to); where the eye took part in the calibration, `held_out` gives the one
of all the others.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_eye.errors import SceneError
from taichi_eye.estimation.fit import Problem, Solution
from taichi_eye.estimation.unknowns import PUFF, UNKNOWNS, WIDTH, Known, own_values
from taichi_eye.report.folder import write_text
from taichi_eye.scene import Scene
from taichi_eye.scene.table import read_text

SHARED = PUFF, WIDTH
WIDE = 0.15  # relative standard deviation that each eye is solved with


@dataclass(frozen=True)
class Told:
    """What one eye tells of the puff: mean of the logarithms, their covariance with the model's error and without."""

    name: str
    mean: np.ndarray
    covariance: np.ndarray
    noise_alone: np.ndarray


@dataclass(frozen=True)
class Calibration:
    """An instrument. names: of the unknowns; mean, covariance: of their logarithms; eyes: how many told of it; puff:
    the values of the scene's [puff] that the factors multiply."""

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    eyes: int
    puff: dict

    def known(self) -> dict[str, Known]:
        """Value and deviation of each."""
        values = np.exp(self.mean)
        return {
            n: Known(float(v), float(v * s)) for n, v, s in zip(self.names, values, np.sqrt(np.diag(self.covariance)))
        }

    def joint(self, names: tuple[str, ...]) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and the covariance of their logarithms together."""
        kept = [self.names.index(name) for name in names]
        return names, self.covariance[np.ix_(kept, kept)]

    def refuse_other(self, scene: Scene) -> None:
        """SceneError where the scene has another puff than the calibration's."""
        if self.puff != puff_of(scene):
            differ = [name for name, value in puff_of(scene).items() if self.puff.get(name) != value]
            raise SceneError(
                f"the calibration is of another puff: {', '.join(differ)}; calibrate with the scene that is fitted"
            )

    def write(self, path: Path) -> None:
        """As a JSON file."""
        known = {name: {"value": k.value, "deviation": k.deviation} for name, k in self.known().items()}
        content = {
            "calibration": known,
            "mean_of_logarithms": self.mean.tolist(),
            "covariance_of_logarithms": self.covariance.tolist(),
            "eyes": self.eyes,
            "puff": self.puff,
        }
        write_text(path, json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, path: str | Path) -> Calibration:
        """What `write` wrote; SceneError where it is something else."""
        try:
            content = json.loads(read_text(Path(path)))
            names = tuple(content["calibration"])
            mean, covariance = np.array(content["mean_of_logarithms"]), np.array(content["covariance_of_logarithms"])
            sound = (
                covariance.shape == (len(names),) * 2 and mean.shape == (len(names),) and set(names) <= set(UNKNOWNS)
            )
            if not sound or not np.isfinite(covariance).all() or not (np.linalg.eigvalsh(covariance) > 0.0).all():
                raise ValueError("its numbers are no means and covariance")
            return cls(names, mean, covariance, int(content["eyes"]), dict(content["puff"]))
        except (ValueError, KeyError, TypeError) as problem:
            raise SceneError(f"{path}: is no calibration of `taichi-eye calibrate` ({problem})") from None


def puff_of(scene: Scene) -> dict:
    """The puff's keys and values, as JSON keeps them."""
    return {name: value for name, value in scene.values().items() if name.startswith("puff.")}


def wide(scene: Scene, known: Collection[str]) -> dict[str, Known]:
    """What each eye of a calibration is told of the puff: next to nothing. SceneError where it is known already."""
    for name in SHARED:
        if name in known:
            raise SceneError(f"known {name}: is what is calibrated; leave it out")
    return {name: Known(1.0, WIDE) for name in SHARED if name in own_values(scene)}


def told(problem: Problem, solution: Solution) -> Told:
    """What an eye solved with a nearly unknown puff tells of it."""
    names = problem.before.names
    places = [names.index(name) for name in SHARED if name in names]
    wide = np.eye(len(places)) / WIDE**2
    mean_before = problem.before.mean[places]
    alone = np.linalg.pinv(problem.information_of_noise(solution.place) + problem.before.precision)
    parts = []
    for covariance in (solution.covariance, alone):
        values, vectors = np.linalg.eigh(np.linalg.inv(covariance[np.ix_(places, places)]) - wide)
        parts.append((vectors * np.maximum(values, 1e-6)) @ vectors.T)
    inverse = np.linalg.inv(solution.covariance[np.ix_(places, places)])
    mean = np.linalg.solve(parts[0], inverse @ solution.place[places] - wide @ mean_before)
    return Told(problem.seen.name, mean, np.linalg.inv(parts[0]), np.linalg.inv(parts[1]))


def combined(scene: Scene, eyes: Sequence[Told]) -> Calibration:
    """The instrument of these eyes."""
    names = tuple(name for name in SHARED if name in own_values(scene))
    any_instrument = np.diag([UNKNOWNS[name].spread ** -2 for name in names])
    common = np.mean([eye.covariance - eye.noise_alone for eye in eyes], axis=0) if eyes else 0.0
    values, vectors = np.linalg.eigh(np.atleast_2d(common))
    common = (vectors * np.maximum(values, 0.0)) @ vectors.T
    weights = [np.linalg.inv(eye.covariance) for eye in eyes]
    if not eyes:
        return Calibration(names, np.zeros(len(names)), np.linalg.inv(any_instrument), 0, puff_of(scene))
    mean = np.linalg.solve(sum(weights), sum(w @ eye.mean for w, eye in zip(weights, eyes)))
    spread = np.linalg.inv(sum(np.linalg.inv(eye.noise_alone) for eye in eyes)) + common
    precision = np.linalg.inv(spread)
    covariance = np.linalg.inv(precision + any_instrument)
    return Calibration(names, covariance @ precision @ mean, covariance, len(eyes), puff_of(scene))


def held_out(scene: Scene, eyes: Sequence[Told]) -> list[Calibration]:
    """For each eye the instrument of all the others."""
    return [combined(scene, [*eyes[:k], *eyes[k + 1 :]]) for k in range(len(eyes))]


def updated(problem: Problem, solution: Solution, calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Place and covariance of a solved eye, were its puff known as the calibration knows it: to first order."""
    names = problem.before.names
    places = [names.index(name) for name in calibration.names]
    precision = problem.before.precision.copy()
    precision[np.ix_(places, places)] = np.linalg.inv(calibration.covariance)
    mean = problem.before.mean.copy()
    mean[places] = calibration.mean
    data = np.linalg.inv(solution.covariance) - problem.before.precision
    covariance = np.linalg.inv(data + precision)
    gain = np.linalg.inv(solution.covariance) @ solution.place - problem.before.precision @ problem.before.mean
    return covariance @ (gain + precision @ mean), covariance
