"""What matters: how much each key of a study moves each figure.

sensitivity     Sobol's indices by Saltelli's estimators (SALib): `first`, the share of a figure's variance that a key
                explains alone, and `total`, the share that is left while all others are known, with 95 % intervals by
                resampling. A base sample with an eye that shows no figure is left out whole; how many were used stands
                beside.
one_at_a_time   `low` and `high`: a figure's least and largest value over a key's levels, less that of the scene's eye.
other designs   `slope`: standardised coefficients of a linear fit (change of a figure in its standard deviations for
                one of the key's), each with its 95 % interval; `explained`: the share of the variance that the fit has.
                Where that is small the coefficients say little.

Keys that are no numbers are left out; those that follow another key go with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_eye.studies.designs import problem_of
from taichi_eye.studies.study import Study

RESAMPLED = 200
SURE = 1.959963984540054  # standard errors on either side of a 95 % interval
SPREAD_LEAST = 1e-9  # of a figure over its size, below which nothing moves it


@dataclass(frozen=True)
class Effect:
    """How a key moves a figure. value: total index, slope, or the larger of the two spans; interval: half width of its
    95 % interval, None where it has none; first, first_interval, low, high, explained: as above, None elsewhere; eyes:
    that it was taken from."""

    figure: str
    key: str
    value: float
    interval: float | None = None
    first: float | None = None
    first_interval: float | None = None
    low: float | None = None
    high: float | None = None
    explained: float | None = None
    eyes: int = 0


def effects(study: Study, frame, figures: Sequence[str]) -> list[Effect]:
    """The effects on some figures, in their order; frame: the study's table in the order of the design."""
    found = []
    for figure in figures:
        values = frame[figure].to_numpy(dtype=float)
        values = np.where(frame["status"].to_numpy() == "complete", values, np.nan)
        good = values[np.isfinite(values)]
        if len(good) < 2 or np.std(good) <= SPREAD_LEAST * np.abs(good).max():
            continue
        if study.kind == "sensitivity":
            found += _sobol(study, figure, values)
        elif study.kind == "one_at_a_time":
            found += _spans(study, figure, values)
        else:
            found += _slopes(study, frame, figure, values)
    return found


def _sobol(study: Study, figure: str, values: np.ndarray) -> list[Effect]:
    from SALib.analyze import sobol

    blocks = values.reshape(study.eyes, -1)
    whole = blocks[np.isfinite(blocks).all(axis=1)]
    if len(whole) < 8:
        return []
    answer = sobol.analyze(
        problem_of(study), whole.ravel(), calc_second_order=False, num_resamples=RESAMPLED, seed=study.seed
    )
    columns = (answer[name] for name in ("ST", "ST_conf", "S1", "S1_conf"))
    return [
        Effect(figure, key, *(float(value) for value in four), eyes=whole.size)
        for key, *four in zip(study.vary, *columns)
    ]


def _spans(study: Study, figure: str, values: np.ndarray) -> list[Effect]:
    found, first = [], 1
    for key, law in study.vary.items():
        change = values[first : first + len(law.levels)] - values[0]
        first += len(law.levels)
        change = change[np.isfinite(change)]
        if len(change):
            low, high = float(min(change.min(), 0.0)), float(max(change.max(), 0.0))
            found.append(Effect(figure, key, max(-low, high), low=low, high=high, eyes=len(change) + 1))
    return found


def _slopes(study: Study, frame, figure: str, values: np.ndarray) -> list[Effect]:
    good = np.isfinite(values)
    columns = {}
    for key in study.factors:
        if frame[key].dtype.kind in "fib":
            column = frame[key].to_numpy(dtype=float)[good]
            if np.std(column) > 0.0:
                columns[key] = (column - column.mean()) / np.std(column)
    if not columns or good.sum() < len(columns) + 3:
        return []
    shape = np.column_stack([np.ones(good.sum()), *columns.values()])
    target = (values[good] - values[good].mean()) / np.std(values[good])
    inverse = np.linalg.pinv(shape.T @ shape)
    fit = inverse @ (shape.T @ target)
    left = target - shape @ fit
    error = np.sqrt(np.diag(inverse) * (left @ left) / (len(target) - shape.shape[1]))
    explained = float(1.0 - left @ left / (target @ target))
    return [
        Effect(figure, key, float(fit[k]), float(SURE * error[k]), explained=explained, eyes=len(target))
        for k, key in enumerate(columns, 1)
    ]
