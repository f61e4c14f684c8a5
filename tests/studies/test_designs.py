"""Designs and laws: marginals, strata, correlations and levels are what a study says."""

import itertools

import numpy as np
import pytest
from scipy.stats import norm, spearmanr, truncnorm

from taichi_eye.studies.designs import changes, count, draw
from taichi_eye.studies.laws import Choice, Normal, Uniform
from taichi_eye.studies.study import load_study

IOP, THICK, PUFF = "eye.iop_mmhg", "cornea.thickness_mm", "puff.peak_kpa"


def drawn(vary, **design):
    return draw(load_study({"design": design, "vary": vary}))


def test_laws_are_their_quantiles():
    share = np.linspace(0.001, 0.999, 97)
    np.testing.assert_allclose(Uniform(2.0, 6.0).at(share), 2.0 + 4.0 * share)
    np.testing.assert_allclose(np.log(Uniform(1.0, 100.0, log=True).at(share)), share * np.log(100.0), atol=1e-12)
    np.testing.assert_allclose(Normal(15.0, 2.0, -np.inf, np.inf).at(share), norm.ppf(share, 15.0, 2.0))
    cut = Normal(15.0, 4.0, 12.0, 16.0).at(share)
    np.testing.assert_allclose(cut, truncnorm.ppf(share, -0.75, 0.25, 15.0, 4.0))
    ends = Normal(15.0, 4.0, 12.0, 16.0).at(np.array([0.0, 1.0]))
    assert 12.0 <= ends[0] < 12.001 and 15.999 < ends[1] <= 16.0
    assert Choice(("a", "b")).at(np.array([0.0, 0.49, 0.51, 1.0])).tolist() == ["a", "a", "b", "b"]


def test_a_grid_is_every_level_with_every_other():
    levels = {"from": 10, "to": 30, "steps": 5}
    design = drawn(
        {IOP: levels, THICK: {"values": [0.5, 0.6]}, "chamber.sealed": {"values": [True, False]}}, kind="grid"
    )
    rows = [tuple(changes(design, eye).values()) for eye in range(count(design))]
    assert rows == list(itertools.product((10.0, 15.0, 20.0, 25.0, 30.0), (0.5, 0.6), (True, False)))
    assert all(type(value) in (float, bool) for row in rows for value in row)


def test_one_at_a_time_starts_from_the_scene_and_changes_one_key():
    vary = {
        IOP: {"from": 10, "to": 30, "steps": 3},
        THICK: {"values": [0.5, 0.6]},
        "cornea.limbus_thickness_mm": {"follows": THICK, "keeping": "ratio"},
    }
    design = drawn(vary, kind="one_at_a_time")
    assert [changes(design, eye) for eye in range(count(design))] == [
        {},
        {IOP: 10.0},
        {IOP: 20.0},
        {IOP: 30.0},
        {THICK: 0.5, "cornea.limbus_thickness_mm": pytest.approx(0.5)},
        {THICK: 0.6, "cornea.limbus_thickness_mm": pytest.approx(0.6)},
    ]


@pytest.mark.parametrize("kind", ["random", "latin_hypercube", "sobol"])
@pytest.mark.parametrize("seed", [1, 2026])
def test_draws_have_the_laws_and_correlations_asked_for(kind, seed):
    vary = {IOP: {"mean": 15, "sd": 2.5}, THICK: {"mean": 0.55, "sd": 0.03}, PUFF: {"from": 8, "to": 12}}
    pairs = [[IOP, THICK, 0.6], [THICK, PUFF, -0.4]]
    design = drawn(vary, kind=kind, eyes=4096, seed=seed, correlations=pairs)
    assert design[IOP].mean() == pytest.approx(15.0, abs=0.15) and design[IOP].std() == pytest.approx(2.5, rel=0.05)
    assert design[PUFF].min() >= 8.0 and design[PUFF].max() <= 12.0
    assert design[PUFF].mean() == pytest.approx(10.0, abs=0.1)
    assert np.corrcoef(design[IOP], design[THICK])[0, 1] == pytest.approx(0.6, abs=0.04)
    # of normal scores rho, ranks have 6/pi asin(rho/2)
    ranks = spearmanr(design[THICK], design[PUFF]).statistic
    assert ranks == pytest.approx(6.0 / np.pi * np.arcsin(-0.2), abs=0.05)
    assert abs(np.corrcoef(design[IOP], design[PUFF])[0, 1]) < 0.06


def test_a_latin_hypercube_has_one_eye_in_each_stratum():
    design = drawn({IOP: {"from": 10, "to": 20}, PUFF: {"from": 8, "to": 12}}, kind="latin_hypercube", eyes=50, seed=7)
    for name, low, high in ((IOP, 10, 20), (PUFF, 8, 12)):
        strata = np.floor(50 * (design[name] - low) / (high - low)).astype(int)
        assert sorted(strata) == list(range(50))


def test_the_same_study_draws_the_same_eyes_and_another_seed_others():
    for kind in ("random", "latin_hypercube", "sobol"):
        one, same, other = (
            drawn({IOP: {"from": 10, "to": 20}}, kind=kind, eyes=16, seed=seed)[IOP] for seed in (5, 5, 6)
        )
        np.testing.assert_array_equal(one, same)
        assert (one != other).all()


def test_a_sensitivity_design_is_saltellis():
    # each base sample: A, then A with one column of B at a time, then B
    design = drawn({IOP: {"from": 10, "to": 20}, PUFF: {"from": 8, "to": 12}}, kind="sensitivity", base_samples=8)
    points = np.column_stack([design[IOP], design[PUFF]]).reshape(8, 4, 2)
    for a, first, second, b in points:
        assert first.tolist() == [b[0], a[1]] and second.tolist() == [a[0], b[1]]
