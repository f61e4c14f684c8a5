"""The eyes of a study: a value for each key that varies, by the study's design. The same study draws the same eyes.

Correlations are those of the keys' normal scores (a Gaussian copula): of normal laws they are the correlations
themselves, and every key keeps its own law.
"""

from __future__ import annotations

import itertools
import warnings

import numpy as np

from taichi_eye.studies.laws import EDGE
from taichi_eye.studies.study import Study, correlation_matrix

Design = dict[str, np.ndarray]  # by key, [eyes]; None, in arrays of objects, where an eye keeps what the scene has


def draw(study: Study) -> Design:
    """The values of every key that varies, followers included, [eyes] each."""
    if study.table is not None:
        columns = dict(study.table)
    elif study.kind == "grid":
        columns = _grid(study)
    elif study.kind == "one_at_a_time":
        columns = _one_at_a_time(study)
    else:
        shares = _SHARES[study.kind](study)
        columns = {name: law.at(shares[:, k]) for k, (name, law) in enumerate(study.vary.items())}
    own = study.base.values()
    for name, law in study.followers.items():
        columns[name] = _beside(columns[law.follows], law, own[name], own[law.follows])
    return columns


def changes(design: Design, eye: int) -> dict:
    """What an eye changes in the scene."""
    values = {name: column[eye] for name, column in design.items()}
    return {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in values.items()
        if value is not None
    }


def count(design: Design) -> int:
    """Eyes of a design."""
    return len(next(iter(design.values())))


def _beside(values: np.ndarray, law, own: float, leader: float) -> np.ndarray:
    if values.dtype != object:
        return law.beside(values, own, leader)
    found = np.full(len(values), None, dtype=object)
    moved = np.array([value is not None for value in values])
    found[moved] = law.beside(values[moved].astype(float), own, leader)
    return found


def _column(values: list) -> np.ndarray:
    plain = all(isinstance(value, float | int) for value in values)
    return np.array(values) if plain else np.array([*values, None], dtype=object)[:-1]


def _grid(study: Study) -> Design:
    rows = itertools.product(*(law.levels for law in study.vary.values()))
    return {name: _column(list(values)) for name, values in zip(study.vary, zip(*rows))}


def _one_at_a_time(study: Study) -> Design:
    names = list(study.vary)
    rows: list[dict] = [{}]
    rows += [{name: level} for name in names for level in study.vary[name].levels]
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _seeded(engine, study: Study, **options):
    """A quasi-random engine of scipy with the study's seed, whose keyword has changed its name."""
    try:
        return engine(len(study.vary), rng=np.random.default_rng(study.seed), **options)
    except TypeError:
        return engine(len(study.vary), seed=np.random.default_rng(study.seed), **options)


def _random(study: Study) -> np.ndarray:
    return _correlated(study, np.random.default_rng(study.seed).random((study.eyes, len(study.vary))))


def _latin_hypercube(study: Study) -> np.ndarray:
    from scipy.stats import qmc

    return _correlated(study, _seeded(qmc.LatinHypercube, study).random(study.eyes))


def _sobol(study: Study) -> np.ndarray:
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of the balance of a number of eyes that is no power of 2
        return _correlated(study, _seeded(qmc.Sobol, study, scramble=True).random(study.eyes))


def problem_of(study: Study) -> dict:
    """The study's factors as SALib takes them: shares of the unit interval."""
    return {"num_vars": len(study.vary), "names": list(study.vary), "bounds": [[0.0, 1.0]] * len(study.vary)}


def _sensitivity(study: Study) -> np.ndarray:
    from SALib.sample import sobol

    return sobol.sample(problem_of(study), study.eyes, calc_second_order=False, scramble=True, seed=study.seed)


_SHARES = {
    "random": _random,
    "latin_hypercube": _latin_hypercube,
    "sobol": _sobol,
    "sensitivity": _sensitivity,
}


def _correlated(study: Study, shares: np.ndarray) -> np.ndarray:
    if not study.correlations:
        return shares
    # scipy.special is quick to load, scipy.stats is not
    from scipy.special import ndtr, ndtri

    scores = ndtri(np.clip(shares, EDGE, 1.0 - EDGE))
    return ndtr(scores @ np.linalg.cholesky(correlation_matrix(list(study.vary), study.correlations)).T)
