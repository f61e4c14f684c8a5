"""An instrument's puff over many eyes: in closed form, through its file, and held."""

import json

import numpy as np
import pytest
from closed_form import BASE, seen, use

from taichi_eye.errors import SceneError
from taichi_eye.estimation.calibration import SHARED, WIDE, Calibration, Told, combined, held_out, told, updated
from taichi_eye.estimation.estimate import estimate, problem_of
from taichi_eye.estimation.fit import solve
from taichi_eye.estimation.unknowns import Known, scene_with

ELSE = {"thickness_um": 550.0, "radius_mm": 7.8, "in_plane": 1.0, "globe": 1.0}


def of(mean, noise, model):
    return Told("eye", np.array(mean), noise + model, noise)


def test_many_eyes_are_surer_than_one_but_not_of_what_their_model_gets_wrong():
    noise, model = np.diag([4e-4, 9e-4]), np.diag([1e-4, 1e-4])
    one, many = (
        combined(BASE, [of([0.0, 0.0], noise, 0 * noise)]),
        combined(BASE, [of([0.0, 0.0], noise, 0 * noise)] * 9),
    )
    before = np.diag([(1.4 / 96.4) ** -2, 0.05**-2])
    assert np.linalg.inv(one.covariance) == pytest.approx(np.linalg.inv(noise) + before, rel=1e-6, abs=1e-6)
    assert np.linalg.inv(many.covariance) == pytest.approx(9.0 * np.linalg.inv(noise) + before, rel=1e-6, abs=1e-6)
    wrong = combined(BASE, [of([0.01, 0.02], noise, model)] * 900)
    assert np.sqrt(wrong.covariance[0, 0]) > 0.8 / np.sqrt(1e4 + before[0, 0])
    alone = combined(BASE, [])
    assert np.sqrt(np.diag(alone.covariance)) == pytest.approx([1.4 / 96.4, 0.05]) and alone.eyes == 0
    apart = held_out(BASE, [of([0.02, 0.0], noise, model), of([-0.02, 0.0], noise, model)])
    assert apart[0].mean[0] < 0.0 < apart[1].mean[0] and {one.eyes for one in apart} == {1}


def test_a_puff_is_found_over_eyes_and_narrows_an_estimate_that_holds_it(monkeypatch, tmp_path):
    use(monkeypatch)
    true, eyes, chance = 1.03, [], np.random.default_rng(4)
    for number in range(4):
        values = {**ELSE, "iop_mmhg": float(chance.uniform(11, 25)), "puff": true, "puff_width": 1.0}
        wide = {**ELSE, **{name: (1.0, WIDE) for name in SHARED}}
        problem = problem_of(seen(scene_with(BASE, values), number, 0.003), BASE, wide, model_error_um=0.0)
        eyes.append(told(problem, solve(problem)))
    found = combined(BASE, eyes)
    puff = found.known()["puff"]
    assert abs(puff.value - true) < 4.0 * puff.deviation and puff.deviation < 0.8 * 1.4 / 96.4
    found.write(tmp_path / "instrument.json")
    again = Calibration.read(tmp_path / "instrument.json")
    assert again.names == found.names and again.covariance == pytest.approx(found.covariance) and again.eyes == 4
    data = seen(scene_with(BASE, {**ELSE, "iop_mmhg": 17.0, "puff": true, "puff_width": 1.0}), 50, 0.003)
    held = estimate(data, BASE, ELSE, model_error_um=0.0, calibration=again)
    free = estimate(data, BASE, ELSE, model_error_um=0.0)
    assert held["iop_mmhg"].deviation < free["iop_mmhg"].deviation
    assert abs(held["iop_mmhg"].value - 17.0) < 4.0 * held["iop_mmhg"].deviation
    # to first order the same without solving anew
    wide = problem_of(data, BASE, {**ELSE, **{name: (1.0, WIDE) for name in SHARED}}, model_error_um=0.0)
    solution = solve(wide)
    place, covariance = updated(wide, solution, again)
    assert np.exp(place[0]) == pytest.approx(held["iop_mmhg"].value, abs=held["iop_mmhg"].deviation)
    assert np.sqrt(covariance[0, 0]) < np.sqrt(solution.covariance[0, 0])


def test_a_calibration_of_another_puff_or_no_calibration_is_refused(tmp_path):
    found = combined(BASE, [])
    with pytest.raises(SceneError, match="another puff: puff.peak_kpa"):
        found.refuse_other(BASE.but({"puff.peak_kpa": 12.0}))
    found.refuse_other(BASE.but({"eye.iop_mmhg": 20.0}))
    path = tmp_path / "bad.json"
    for content in ("{", "[]", json.dumps({"calibration": {}})):
        path.write_text(content)
        with pytest.raises(SceneError, match="is no calibration"):
            Calibration.read(path)
    assert found.known()["puff"] == Known(1.0, pytest.approx(1.4 / 96.4))
