"""The air puff: its published numbers, the measured course and a user's table."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from taichi_eye.eye.eye import eye_of
from taichi_eye.eye.puff import Puffs
from taichi_eye.scene import load_scene


def puff(*overrides):
    return eye_of(load_scene(None, overrides)).puff


def half_times(load, peak, centre):
    def above_half(t):
        return load.pressure_at_apex(t) - peak / 2

    return brentq(above_half, 0, centre, xtol=1e-12), brentq(above_half, centre, 0.032, xtol=1e-12)


def test_paper_load():
    load = puff()
    assert load.pressure_at_apex(0.015) == 10e3
    assert load.pressure_at_apex(0.0) == pytest.approx(19.3, abs=0.05)
    rise, fall = half_times(load, 10e3, 0.015)
    assert rise + fall == pytest.approx(0.030, abs=1e-10)
    assert fall - rise == pytest.approx(9.99e-3, abs=5e-6)
    assert load.pressure_at_apex(0.015 + 4.243e-3) == pytest.approx(10e3 * np.exp(-0.5), rel=1e-4)


def test_paper_profile():
    load = puff()
    assert load.radial(0.0) == 1.0
    assert brentq(lambda r: load.radial(r) - 0.5, 0, 5e-3) == pytest.approx(1.40e-3, abs=5e-6)
    phi = 0.4
    assert load.radial(7.8e-3 * np.sin(phi)) == pytest.approx(np.exp(-21.5 * np.sin(phi) ** 2), rel=1e-12)
    force, _ = quad(lambda r: load.pressure_at_apex(0.015) * load.radial(r) * 2 * np.pi * r, 0, 5.8e-3)
    assert force == pytest.approx(0.0889, abs=5e-5)


def test_paper_profile_follows_the_angle_not_the_radius():
    steep = puff("cornea.radius_mm=6.5", "cornea.limbus_radius_mm=5")
    assert steep.radial(6.5e-3 * 0.3) == pytest.approx(puff().radial(7.8e-3 * 0.3), rel=1e-12)


def test_gaussian_profile():
    load = puff("puff.radial_profile=gaussian", "puff.width_mm=1.5")
    assert load.radial(1.5e-3) == pytest.approx(np.exp(-1), rel=1e-12)


def test_measured_course():
    load = puff("puff.time_course=corvis", "puff.peak_kpa=12.85")
    assert load.pressure_at_apex(16.15e-3) == pytest.approx(12.85e3, rel=1e-12)
    rise, fall = half_times(load, 12.85e3, 16.15e-3)
    width_ms = 8.00 * np.log(2) ** (1 / 2.59) + 4.175 * np.log(2) ** (1 / 1.547)
    assert fall - rise == pytest.approx(width_ms * 1e-3, rel=1e-9)
    assert width_ms == pytest.approx(10.4, rel=0.02)  # what the fit stands for
    share = load.pressure_at_apex(np.array([5.27e-3, 22.93e-3])) / 12.85e3
    np.testing.assert_allclose(share, 0.1, atol=0.021)  # measured 10 % times
    assert load.pressure_at_apex(0.0) < 0.01 * 12.85e3
    assert np.all(load.pressure_at_apex(np.array([13.8e-3, 16.5e-3])) > 0.95 * 12.85e3)


def test_no_puff():
    assert not np.any(puff("puff.peak_kpa=0").pressure_at_apex(np.linspace(0, 0.03, 7)))


def test_table_is_linear_between_and_zero_outside(tmp_path):
    (tmp_path / "p.csv").write_text("# bench, 2021\ntime_ms, pressure_kpa, valve\n2, 1, a\n4, 5, b\n8, -1, c\n")
    load = puff("puff.time_course=file", f"puff.file={tmp_path / 'p.csv'}", "puff.peak_kpa=3")
    assert load.peak == pytest.approx(5e3, rel=1e-12)
    t_ms = np.array([-1, 1.999, 2, 3, 4, 6, 8, 8.001, 30])
    np.testing.assert_allclose(load.pressure_at_apex(t_ms * 1e-3), [0, 0, 1e3, 3e3, 5e3, 2e3, -1e3, 0, 0], atol=1e-9)


@pytest.mark.parametrize("course", ["gaussian", "corvis"])
def test_shapes(course):
    load = puff(f"puff.time_course={course}")
    t = np.linspace(0, 0.03, 12).reshape(3, 4)
    got = load.pressure_at_apex(t)
    assert got.shape == (3, 4)
    assert got[1, 2] == load.pressure_at_apex(t[1, 2]) and np.ndim(load.pressure_at_apex(0.01)) == 0
    assert load.radial(np.zeros((2, 5))).shape == (2, 5)


def test_puffs_of_many_eyes_are_each_ones_own_bit_for_bit(tmp_path):
    (tmp_path / "puff.csv").write_text("time_ms,pressure_kpa\n0,0\n10,7\n25,0\n", encoding="utf-8")
    loads = [
        puff(),
        puff("puff.time_course=corvis", "puff.peak_kpa=13"),
        puff("puff.duration_ms=20", "puff.spread_b=18"),
        puff("puff.time_course=file", f"puff.file={tmp_path / 'puff.csv'}"),
        puff("puff.time_course=corvis"),
    ]
    t = np.random.default_rng(0).uniform(0.0, 0.032, (len(loads), 40))
    for chosen in (loads, loads[:1], loads[3:4], [loads[0], loads[2]]):
        together = Puffs(chosen).impulse_at_apex(t[: len(chosen)])
        np.testing.assert_array_equal(together, [load.impulse_at_apex(at) for load, at in zip(chosen, t)])


def test_the_impulse_is_the_integral_of_the_pressure(tmp_path):
    (tmp_path / "puff.csv").write_text("time_ms,pressure_kpa\n1,2\n1.3,7\n1.305,-3\n25,1\n", encoding="utf-8")
    spans = [0.0, 0.7e-3, 1.29e-3, 1.31e-3, 8e-3, 8.02e-3, 26e-3, 30e-3]
    for load, spoilt in (
        (puff(), []),
        (puff("puff.duration_ms=2", "puff.spread_b=400"), [1e-3]),
        (puff("puff.time_course=file", f"puff.file={tmp_path / 'puff.csv'}"), [1e-3, 1.3e-3, 1.305e-3, 25e-3]),
    ):
        exact = []
        for start, end in zip(spans, spans[1:]):
            kinks = [t for t in spoilt if start < t < end] or None
            exact.append(quad(load.pressure_at_apex, start, end, points=kinks, epsabs=1e-12, epsrel=1e-11)[0])
        np.testing.assert_allclose(load.impulse_at_apex(spans), exact, rtol=1e-8, atol=1e-9)
    steps = np.arange(0.0, 32e-3, 25e-6)
    load = puff("puff.time_course=corvis")
    whole, _ = quad(load.pressure_at_apex, 0.0, steps[-1], points=[16.15e-3], epsrel=1e-12)
    assert load.impulse_at_apex(steps).sum() == pytest.approx(whole, rel=1e-8)


def test_rings_carry_the_whole_force_of_the_load():
    rng = np.random.default_rng(3)
    r = np.append(0.0, np.sort(rng.uniform(0.0, 5.8e-3, 12)))
    edges = np.concatenate([[0.0], 0.5 * (r[1:] + r[:-1]), r[-1:]])
    for keys in (
        ["puff.spread_a=0"],
        ["puff.spread_a=1e-3"],
        [],
        ["puff.radial_profile=gaussian", "puff.width_mm=0.05"],
    ):
        load = puff(*keys)
        force = (load.on_rings(r) * np.pi * np.diff(edges**2)).sum()
        exact, _ = quad(
            lambda at: load.radial(at) * 2.0 * np.pi * at, 0.0, r[-1], points=[1e-4], epsabs=0, epsrel=1e-12
        )
        assert force == pytest.approx(exact, rel=1e-11)
    fed = puff("puff.dent_feedback=0.5")
    np.testing.assert_allclose(fed.on_rings(np.array([0.0, 1e-7, 2e-7, 3e-7]), -90.0), 1.0, atol=1e-6)
    fine = np.linspace(0.0, 5.8e-3, 4001)
    np.testing.assert_allclose(fed.on_rings(fine, -90.0)[1:-1], fed.radial(fine, -90.0)[1:-1], atol=1e-6)
