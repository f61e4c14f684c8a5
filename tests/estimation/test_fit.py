"""The fit: known answers in closed form, honest intervals, and what it refuses."""

import numpy as np
import pytest
from closed_form import BASE, TIMES_MS, apex_mm, motion, seen, use

from taichi_eye.errors import NoEstimate, SceneError
from taichi_eye.estimation.estimate import estimate, estimate_many, problem_of
from taichi_eye.estimation.fit import interval, profile, solve
from taichi_eye.estimation.landmarks import _passed, landmarks_of
from taichi_eye.estimation.observation import of_history, phases, scatter
from taichi_eye.estimation.unknowns import Known, scene_with

ELSE = {"puff": 1.0, "puff_width": 1.0, "thickness_um": 550.0, "radius_mm": 7.8}
TRUTH = {**ELSE, "iop_mmhg": 19.3, "in_plane": 1.25, "globe": 0.85}


def test_an_eye_is_found_again_and_a_deviation_is_what_the_slopes_say(monkeypatch):
    use(monkeypatch)
    scene = scene_with(BASE, TRUTH)
    found = estimate(seen(scene, 5), BASE, ELSE, model_error_um=0.0)
    for name in ("iop_mmhg", "in_plane", "globe"):
        assert abs(found[name].value - TRUTH[name]) < 3.5 * found[name].deviation
    assert found.probability > 1e-3 and found.rung == "mfpm" and not found.warnings
    # by central differences of the closed form itself
    columns = []
    for name in ("iop_mmhg", "in_plane", "globe"):
        ends = [apex_mm(scene_with(BASE, {**TRUTH, name: TRUTH[name] * np.exp(h)})) for h in (1e-4, -1e-4)]
        columns.append((ends[0] - ends[1]) / 2e-4)
    slopes = np.array(columns).T / 0.01
    spread = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes + np.diag([0.0, 1.0, 1.0]) / 0.35**2)))
    for name, value in zip(("iop_mmhg", "in_plane", "globe"), spread):
        assert found[name].deviation == pytest.approx(value * TRUTH[name], rel=0.15)


def test_intervals_of_many_eyes_hold_the_truth_as_often_as_they_say(monkeypatch):
    use(monkeypatch)
    chance = np.random.default_rng(20)
    problems, truths = [], []
    for k in range(12):
        truth = {
            **ELSE,
            "iop_mmhg": float(chance.uniform(9, 33)),
            "in_plane": float(chance.uniform(0.7, 1.5)),
            "globe": 1.0,
        }
        problems.append(
            problem_of(seen(scene_with(BASE, truth), 100 + k), BASE, {**ELSE, "globe": 1.0}, model_error_um=0.0)
        )
        truths.append(truth["iop_mmhg"])
    found = estimate_many(problems)
    ninety_five = sum(one["iop_mmhg"].range95[0] <= t <= one["iop_mmhg"].range95[1] for one, t in zip(found, truths))
    sixty_eight = sum(one["iop_mmhg"].range68[0] <= t <= one["iop_mmhg"].range68[1] for one, t in zip(found, truths))
    assert 10 <= ninety_five and 4 <= sixty_eight
    probability = [one.probability for one in found]
    assert 0.2 < np.mean(probability) < 0.8


def test_derivatives_serve_at_other_places_as_long_as_they_foretell_what_is_shown_there(monkeypatch):
    use(monkeypatch)
    problem = problem_of(seen(scene_with(BASE, TRUTH), 12), BASE, ELSE, model_error_um=0.0)
    place = np.log([TRUTH[name] for name in problem.before.names])
    near = place + np.random.default_rng(13).uniform(0.03, 0.04, len(place))
    problem.slopes(place)
    runs = problem.runs
    bent = problem.slopes(near)
    assert problem.runs == runs + 1  # that of the place itself
    assert bent @ (near - place) == pytest.approx(problem.predict(near) - problem.predict(place), abs=1e-12)
    # by central differences of the closed form
    exact = np.array(
        [(problem.predict(near + step) - problem.predict(near - step)) / 2e-4 for step in 1e-4 * np.eye(len(place))]
    ).T
    anew = problem.slopes(near, anew=True)
    assert np.linalg.norm(anew - exact) < 0.02 * np.linalg.norm(exact)
    assert np.linalg.norm(bent - exact) < 0.2 * np.linalg.norm(exact)
    # both are kept, and the better serves
    runs = problem.runs
    assert problem.slopes(near) == pytest.approx(anew) and problem.runs == runs
    problem.slopes(place + [0.7, -0.5, 0.5])
    assert problem.runs == runs + 1 + len(place)  # too far to foretell anything


def test_the_end_is_that_of_the_fine_model_though_the_search_is_the_cheap_ones(monkeypatch):
    use(monkeypatch, lambda scene: motion(scene, late_ms=0.1, deeper=1.01))
    scene = scene_with(BASE, TRUTH)
    data = seen(scene, 7, 0.002, late_ms=0.1, deeper=1.01)
    exact = estimate(data, BASE, {**ELSE, "in_plane": 1.25, "globe": 0.85}, model_error_um=0.0)
    assert abs(exact["iop_mmhg"].value - 19.3) < 4.0 * exact["iop_mmhg"].deviation and exact.rounds <= 3
    with pytest.raises(NoEstimate, match="no eye of this scene moves like that"):
        estimate(data, BASE, {**ELSE, "in_plane": 1.25, "globe": 0.85}, model_error_um=0.0, finely=False)


def test_a_fine_run_that_is_stopped_is_taken_beside_and_a_model_that_always_stops_is_said(monkeypatch):
    from dataclasses import replace

    low = lambda scene: replace(motion(scene), stopped="folded" if scene.eye.iop_mmhg < 19.8 else "")
    use(monkeypatch, low)
    data = seen(scene_with(BASE, TRUTH), 8)
    beside = estimate(data, BASE, ELSE, model_error_um=0.0)
    assert beside.rung == "mfpm" and abs(beside["iop_mmhg"].value - 19.3) < 4.0 * beside["iop_mmhg"].deviation
    use(monkeypatch, lambda scene: replace(motion(scene), stopped="folded"))
    never = estimate(data, BASE, ELSE, model_error_um=0.0)
    assert never.rung == "added_mass" and any("folded" in text for text in never.warnings)


def test_what_no_eye_could_do_is_refused_and_with_a_model_error_the_intervals_widen(monkeypatch):
    use(monkeypatch)
    scene, known = scene_with(BASE, TRUTH), {**ELSE, "in_plane": 1.25, "globe": 0.85}
    bent = seen(scene, 9).values + 0.05 * np.sin(TIMES_MS / 1.2) * (apex_mm(scene) > 0.1)
    data = of_history("bent", TIMES_MS, bent, False, 0.01)
    with pytest.raises(NoEstimate, match="bent: no eye of this scene moves like that: chi"):
        estimate(data, BASE, known, model_error_um=0.0)
    wide = estimate(data, BASE, known, model_error_um=20.0)
    sure = estimate(seen(scene, 9), BASE, known, model_error_um=20.0)
    assert wide.widened > 1.2 and wide["iop_mmhg"].deviation > 1.2 * sure["iop_mmhg"].deviation
    assert any("larger" in text or "times as large" in text for text in wide.warnings)
    wild = of_history("wild", TIMES_MS, bent * np.cos(TIMES_MS) ** 2, False, 0.01)
    with pytest.raises(NoEstimate, match="the nearest is .* um off"):
        estimate(wild, BASE, known, model_error_um=100.0)


def test_an_eye_unlike_what_is_known_has_wider_intervals_or_none(monkeypatch):
    use(monkeypatch)
    data = seen(scene_with(BASE, {**TRUTH, "in_plane": 1.45}), 15)
    known = {**ELSE, "globe": 0.85}
    like = estimate(data, BASE, {**known, "in_plane": (1.45, 0.1)}, model_error_um=15.0)
    unlike = estimate(data, BASE, {**known, "in_plane": (1.0, 0.1)}, model_error_um=15.0)
    assert like.widened == 1.0 and not like.warnings
    assert unlike.widened >= 1.5 and unlike["iop_mmhg"].deviation > 1.3 * like["iop_mmhg"].deviation
    # of one value alone, five standard deviations off, and hidden in the sum over 139 others
    with pytest.raises(NoEstimate, match="only an eye unlike all that is known.* in_plane 1"):
        estimate(data, BASE, {**known, "in_plane": (1.0, 0.067)}, model_error_um=0.0)


def test_a_model_error_does_not_take_noise_for_a_dent_too_shallow(monkeypatch):
    use(monkeypatch)
    off = []
    for seed in range(6):
        known = {**ELSE, "in_plane": (1.25, 0.4), "globe": (0.85, 0.3)}
        problem = problem_of(seen(scene_with(BASE, TRUTH), seed), BASE, known, model_error_um=100.0)
        solution = solve(problem)
        off.append((solution.place[0] - np.log(19.3)) / np.sqrt(solution.covariance[0, 0]))
    # the intervals have the model error, which these eyes have not: what noise does is little beside it
    assert abs(np.mean(off)) < 0.15 and np.max(np.abs(off)) < 0.5


def test_what_is_known_narrows_and_what_is_not_costs(monkeypatch):
    use(monkeypatch)
    data = seen(scene_with(BASE, TRUTH), 3)
    loose = estimate(
        data, BASE, {n: v for n, v in ELSE.items() if n != "puff"} | {"puff": (1.0, 0.02)}, model_error_um=0.0
    )
    tight = estimate(data, BASE, ELSE, model_error_um=0.0)
    assert loose["iop_mmhg"].deviation > tight["iop_mmhg"].deviation
    cost = next(one for one in loose.costs if one.name == "puff")
    assert cost.exact < cost.known < cost.unknown
    assert cost.exact == pytest.approx(tight.laplace_mmhg, rel=0.1)
    assert {share.part for share in tight.shares} == set(data.groups)
    assert all(share.deviation_without >= 0.999 * tight.laplace_mmhg for share in tight.shares)


def test_an_estimate_on_a_bound_says_so(monkeypatch):
    use(monkeypatch)
    known = {**ELSE, "globe": 1.0, "in_plane": (1.0, 0.01)}
    scene = scene_with(BASE, {**TRUTH, "in_plane": 1.0, "globe": 1.0, "iop_mmhg": 79.8})
    found = estimate(seen(scene, 2, 0.03), BASE, known, model_error_um=0.0)
    assert any("iop_mmhg lies on the bound" in text for text in found.warnings)


def test_a_profile_of_a_linear_problem_is_a_parabola(monkeypatch):
    use(monkeypatch)
    problem = problem_of(
        seen(scene_with(BASE, TRUTH), 11, 0.001), BASE, {**ELSE, "in_plane": 1.25, "globe": 0.85}, model_error_um=0.0
    )
    solution = solve(problem)
    place, root, lowest = profile(problem, solution)
    deviations = (place - solution.place[0]) / np.sqrt(solution.covariance[0, 0])
    assert root == pytest.approx(deviations, abs=0.1)
    ends = interval(place, root, 1.0, (0.0, 10.0))
    assert ends == pytest.approx(solution.place[0] + np.array([-1, 1]) * np.sqrt(solution.covariance[0, 0]), rel=1e-3)


@pytest.mark.parametrize("left_out", [0.0, 0.15])
def test_the_sum_with_a_larger_model_error_is_that_of_the_widened_problem(monkeypatch, left_out):
    use(monkeypatch)
    problem = problem_of(seen(scene_with(BASE, TRUTH), 7), BASE, ELSE)
    problem.widen(1.2, left_out)
    place = problem.before.mean + 0.05
    found = problem.sums(place, 2.5)
    assert problem.factor == 1.2 and found < problem.cost(place)
    problem.widen(2.5, left_out)
    assert found == pytest.approx(problem.cost(place), rel=1e-9)
    wrong = problem.seen.model_error(problem.model, problem.seen.values)
    if not left_out:
        assert problem.covariance == pytest.approx(problem.seen.noise() + 2.5**2 * wrong, rel=1e-12)


def test_landmarks_are_passed_where_they_are():
    time = np.linspace(0.0, 32.0, 641)
    depth = np.interp(time, [0, 8, 16, 20, 32], [0, 0, 0.8, 0.8, 0])
    levels = np.array([0.2, 0.6])
    found = _passed(time, depth, levels)
    assert found == pytest.approx([10.0, 14.0, 29.0, 23.0, 0.8], abs=1e-6)
    # a level that is just not reached is passed where a level just reached is
    higher = _passed(time, depth * 0.74, levels)
    assert higher[1] <= 20.0 and higher[3] >= 16.0 and np.isfinite(higher).all()
    marks = landmarks_of(seen(scene_with(BASE, TRUTH), 4))
    exact = marks.predict(motion(scene_with(BASE, TRUTH)))
    assert (np.abs(exact - marks.values) < 4.0 * marks.deviations).all()


def test_noise_is_read_off_a_history_and_parts_are_told():
    scene = scene_with(BASE, TRUTH)
    quiet = [scatter(TIMES_MS, seen(scene, seed, 0.008).values) for seed in range(8)]
    assert np.mean(quiet) == pytest.approx(0.008, rel=0.15)
    parts = phases(TIMES_MS, apex_mm(scene))
    assert list(dict.fromkeys(parts)) == ["first motion", "inwards", "deepest", "outwards", "after the puff"]


@pytest.mark.parametrize(
    "known, free, words",
    [
        ({"thickness": 550.0}, None, "known thickness = 550: no such unknown"),
        ({"thickness_um": 0.55}, None, "known thickness_um = 0.55: allowed is 300 to 800 um"),
        ({"iop_mmhg": 15.0}, None, "is what is estimated"),
        ({"puff": (1.0, -0.1)}, None, "the deviation is 0 to the value"),
        ({"out_of_plane": 1.0}, None, "the scene has none"),
        ({}, ("in_plane",), "iop_mmhg is what is estimated"),
        ({}, ("iop_mmhg", "puff"), "free puff: allowed are iop_mmhg, in_plane"),
    ],
)
def test_what_cannot_be_known_or_free_is_refused(known, free, words, monkeypatch):
    use(monkeypatch)
    with pytest.raises(SceneError) as refusal:
        estimate(seen(BASE, 1), BASE, known, **({} if free is None else {"free": free}), model_error_um=0.0)
    assert words in str(refusal.value) and isinstance(Known(1.0), Known)
