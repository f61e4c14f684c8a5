"""An eye under the hand: what its sliders ask for is the scene that is run, and its film is that scene's film."""

import math
import shlex

import numpy as np
import pytest

from taichi_eye import cli
from taichi_eye.analysis.simulated import response_of
from taichi_eye.errors import SceneError
from taichi_eye.film import FilmView
from taichi_eye.page import hand
from taichi_eye.scene import load_scene
from taichi_eye.scene.schema import keys_of
from taichi_eye.solver.reduced import Cavity


@pytest.fixture(scope="module")
def eyes():
    return hand.load("seed", ["eye.iop_mmhg=17"], ("corvis_healthy", "keratoconus"))


SEED = "seed with --set"


def eye(eyes, name, **values):
    return eyes.eye({"scene": name, "values": values})


def test_the_ends_of_every_slider_lie_within_the_limits_of_its_key(eyes):
    for slider in hand.SLIDERS.values():
        section, name = slider.key.split(".")
        spec = keys_of(section)[name][1]
        assert slider.low < slider.high and spec.holds(slider.low) and spec.holds(slider.high)
        for scene in eyes.scenes:
            for value in (slider.low, slider.high):
                assert eye(eyes, scene, **{slider.name: value}).scene


def test_a_slider_that_stands_where_the_scene_has_it_changes_nothing(eyes):
    for name, (scene, _) in eyes.scenes.items():
        values = {slider: hand.SLIDERS[slider].of(scene) for slider in hand.SLIDERS}
        moved = eye(eyes, name, **values)
        for key, value in moved.changes.items():  # the width of the paper's profile is computed to and fro
            assert value == pytest.approx(scene.values()[key], rel=1e-12)
        assert eye(eyes, name).changes == {} and eye(eyes, name).scene == scene


def test_sliders_move_what_they_say(eyes):
    healthy = eyes.scenes["corvis_healthy"][0]
    moved = eye(eyes, "corvis_healthy", thickness=0.5, stiffness=0.6, radius=7.1, width=1.7, globe=0.2, puff=9, iop=20)
    own = moved.scene.values()
    assert own["cornea.thickness_mm"] == 0.5 and own["cornea.limbus_thickness_mm"] == pytest.approx(0.62)
    for key in hand.TISSUE:
        assert own[key] == pytest.approx(0.6 * healthy.values()[key])
    asked = {"cornea.radius_mm": 7.1, "puff.width_mm": 1.7, "chamber.compliance_mm3_mmhg": 0.2, "puff.peak_kpa": 9.0}
    assert {key: own[key] for key in asked} == asked and own["eye.iop_mmhg"] == 20.0
    # the wall carries the pressure anew
    assert own["cornea.prestrain"] != healthy.cornea.prestrain
    paper = eye(eyes, SEED, width=2.0, radius=8.0).scene
    assert paper.cornea.radius_mm / math.sqrt(paper.puff.spread_a) == pytest.approx(2.0)
    # the slider of the width, which stays, still tells the truth
    stays = eye(eyes, SEED, radius=9.1)
    assert stays.scene.cornea.radius_mm == 9.1 and "puff.spread_a" in stays.command
    assert hand.SLIDERS["width"].of(stays.scene) == pytest.approx(hand.SLIDERS["width"].of(eyes.scenes[SEED][0]))


@pytest.mark.parametrize(
    "asked, said",
    [
        ({"scene": "nobody", "values": {}}, "corvis_healthy"),
        ({"scene": ["seed"], "values": {}}, "seed"),
        ({"scene": "../seed", "values": {}}, "keratoconus"),
        (
            {"scene": SEED, "values": {"iop": 1000}},
            "eye.iop_mmhg = 1000.0: must be a number in mmHg, >= 1 and <= 100",
        ),
        ({"scene": SEED, "values": {"iop": float("nan")}}, "must be a number"),
        ({"scene": SEED, "values": {"iop": float("inf")}}, "must be a number"),
        ({"scene": SEED, "values": {"iop": 10**400}}, "must be a number"),
        ({"scene": SEED, "values": {"iop": True}}, "must be a number"),
        ({"scene": SEED, "values": {"iop": "15"}}, "must be a number"),
        ({"scene": SEED, "values": {"width": 0}}, "puff.spread_a"),
        ({"scene": SEED, "values": {"globe": -0.1}}, "chamber.compliance_mm3_mmhg"),
        ({"scene": SEED, "values": {"stiffness": -1}}, "cornea.stiffness_a_pa"),
        ({"scene": SEED, "values": {"radius": 3}}, "limbus radius"),
        ({"scene": SEED, "values": {"puff.file": "/etc/passwd"}}, "sliders of this eye are iop"),
        ({"scene": SEED, "values": [1]}, "scene and values"),
        ([], "scene and values"),
    ],
)
def test_what_is_no_eye_is_refused_and_said(eyes, asked, said):
    with pytest.raises(hand.Refused, match=".*") as refused:
        eyes.eye(asked)
    assert said in str(refused.value)


def test_a_scene_that_was_changed_hides_no_preset(eyes):
    assert list(eyes.scenes) == [SEED, "corvis_healthy", "keratoconus"]
    both = hand.load("corvis_healthy", ["eye.iop_mmhg=33"], ("corvis_healthy",))
    changed, plain = (both.eye({"scene": name}).scene for name in both.scenes)
    assert changed.eye.iop_mmhg == 33 and plain == load_scene("corvis_healthy")


@pytest.mark.parametrize(
    "words, said",
    [
        (["camera.width_px=2048", "camera.height_px=1024"], "camera.width_px = 2048"),
        (["camera.frame_interval_ms=0.01"], "camera.frame_interval_ms = 0.01"),
        (["camera.frame_interval_ms=0.01", "camera.frame_count=2"], "numerics.duration_ms = 3"),
    ],
)
def test_a_film_too_large_for_a_tab_is_refused(words, said):
    with pytest.raises(SceneError) as refused:
        hand.load("seed", words, ())
    assert said in str(refused.value) and "pixels" in str(refused.value)


def test_a_scene_with_a_frame_count_of_its_own_is_filmed_to_its_end():
    eyes = hand.load("seed", ["numerics.duration_ms=3", "camera.frame_count=2"], ())
    shown = hand.Hand().run(eye(eyes, SEED).scene, hand.DRAGGED)
    assert shown.time_ms[-1] == pytest.approx(3.0, abs=shown.scene.camera.frame_interval_ms)


def test_a_puff_from_a_file_has_no_slider_for_its_peak(tmp_path):
    (tmp_path / "puff.csv").write_text("time_ms,pressure_kpa\n0,0\n15,9\n30,0\n")
    words = ["puff.time_course=file", f"puff.file={tmp_path / 'puff.csv'}"]
    eyes = hand.load("seed", words, ())
    assert "puff" not in hand.of_scene(eyes.scenes[SEED][0])
    with pytest.raises(hand.Refused):
        eye(eyes, SEED, puff=3)


def test_the_command_runs_the_same_eye(eyes):
    moved = eye(eyes, SEED, iop=21.5, stiffness=1.3, width=1.9)
    given = cli.parser().parse_args(shlex.split(moved.command)[1:])
    assert given.command == "run" and load_scene(given.scene, given.overrides) == moved.scene
    assert eye(eyes, SEED).command == "taichi-eye run seed --set eye.iop_mmhg=17"


def test_the_film_is_that_of_the_cavity_rung_and_its_parameters_those_of_its_wall(eyes):
    asked = eye(eyes, "corvis_healthy", iop=15 + 3 * np.random.default_rng().random())
    worked = hand.Hand()
    shown, *pieces = hand.film_of(worked, asked)
    count = asked.scene.camera.frame_count
    film = np.concatenate([pixels for _, pixels in pieces])
    assert [first for first, _ in pieces] == list(range(0, count, hand.FRAMES_A_PIECE)) and len(film) == count
    simulation = Cavity(shown.scene)
    images = []
    view = FilmView(shown.scene)
    simulation.run(lambda eye, frame: images.append(eye.frame()) if frame % 20 == 5 else None)
    for k, image in enumerate(images):
        np.testing.assert_array_equal(film[20 * k + 5], image)
    assert view.shape == film.shape[1:]
    np.testing.assert_allclose(
        shown.apex_mm, np.interp(shown.time_ms, simulation.traces["time_ms"], simulation.traces["apex_displacement_mm"])
    )
    read, truth = hand.parameters_of(shown), response_of(shown.scene).response
    assert read == vars(truth) and read["a1_time_ms"] is not None
    # coarse, and yet within a per cent of what 48 elements have
    fine = worked.run(asked.scene, 48)
    assert shown.apex_mm.max() == pytest.approx(fine.apex_mm.max(), rel=3e-3)
    assert worked.run(asked.scene, hand.DRAGGED).apex_mm.max() == pytest.approx(fine.apex_mm.max(), rel=8e-3)
    # dragged: the frame of the time that is looked at, and the history up to there
    time_ms = 10.0
    told, pixels = hand.frame_of(worked, asked, time_ms)
    number = told["frame"]
    assert number == math.floor(time_ms / asked.scene.camera.frame_interval_ms) == len(told["time_ms"]) - 1
    whole = worked.run(asked.scene, hand.DRAGGED)
    np.testing.assert_allclose(told["deflection_mm"], whole.apex_mm[: number + 1], atol=2e-5)
    np.testing.assert_array_equal(pixels, worked.frames(whole, range(number, number + 1)))


def test_an_eye_that_leaves_its_validity_says_so_and_shows_what_there_is(eyes):
    shown, *pieces = hand.film_of(hand.Hand(), eye(eyes, SEED, iop=5, puff=25, globe=3))
    assert "stopped at" in shown.stop and 0 < len(shown.time_ms) < eyes.scenes[SEED][0].camera.frame_count
    assert sum(len(pixels) for _, pixels in pieces) == len(shown.time_ms)


def test_a_shell_that_folds_is_said_to_after_its_film(eyes):
    worked, asked = hand.Hand(), eye(eyes, "corvis_healthy", iop=5, puff=25, globe=3)
    shown = worked.run(asked.scene, hand.FILMED)
    assert "folded" in hand.fold_of(worked, asked, shown)
    assert hand.fold_of(worked, eye(eyes, SEED), worked.run(eyes.scenes[SEED][0], hand.FILMED)) == ""
