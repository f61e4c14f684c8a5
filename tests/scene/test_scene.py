"""Changing a resolved scene, in memory and in its file: the computed follows, the given stays or contradicts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_eye.errors import SceneError
from taichi_eye.scene import dump_scene, load_scene
from taichi_eye.scene.resolve import coarsest_spacing_mm
from taichi_eye.scene.schema import AUTO, all_keys

COMPUTED = {name for name, _, spec in all_keys() if spec.computed}

# each computed key with a change that it depends on
DEPENDS = {
    "cornea.prestrain": {"eye.iop_mmhg": 25.0},
    "cornea.limbus_thickness_mm": {"cornea.thickness_mm": 0.6},
    "cornea.exponent_s": {"cornea.poisson_ratio": 0.3},
    "cornea.exponent_k": {"cornea.exponent_s": 40.0},
    "cornea.stiffness_a_pa": {"cornea.prestrain": 0.03},
    "chamber.depth_mm": {"cornea.radius_mm": 7.2},
    "numerics.mean_sound_speed_m_s": {"numerics.sound_speed_m_s": 20.0},
    "numerics.refresh_travel": {"numerics.fidelity": "added_mass"},
    "camera.frame_count": {"numerics.duration_ms": 10.0},
}


def overrides(changes):
    return [f"{name}={value!r}" for name, value in changes.items()]


def test_every_computed_key_has_a_change_that_moves_it():
    assert DEPENDS.keys() == COMPUTED


@pytest.mark.parametrize("name", DEPENDS)
def test_a_computed_key_follows_what_it_depends_on(name, tmp_path):
    scene = load_scene()
    moved = scene.but(DEPENDS[name])
    assert moved == load_scene(None, overrides(DEPENDS[name]))
    assert moved.values()[name] != scene.values()[name]
    path = tmp_path / "scene.toml"
    path.write_text(dump_scene(scene))
    assert load_scene(path, overrides(DEPENDS[name])) == moved


def test_a_run_whose_scene_file_is_edited_is_computed_anew(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        dump_scene(load_scene())
        .replace("iop_mmhg = 15.0", "iop_mmhg = 22.0")
        .replace("\nthickness_mm = 0.55", "\nthickness_mm = 0.5")
    )
    edited = load_scene(path)
    assert edited == load_scene(None, ["eye.iop_mmhg=22", "cornea.thickness_mm=0.5"])
    assert edited.cornea.limbus_thickness_mm == 0.5


def test_the_file_shows_what_was_computed():
    scene = load_scene()
    line = next(line for line in dump_scene(scene).splitlines() if line.startswith("prestrain"))
    assert line.startswith('prestrain = "auto"') and f"here {scene.cornea.prestrain!r};" in line


def test_given_keys_stay_and_a_contradiction_names_both():
    scene = load_scene(None, ["numerics.mean_sound_speed_m_s=100", "cornea.limbus_thickness_mm=0.7"])
    assert scene.given == {"numerics.mean_sound_speed_m_s", "cornea.limbus_thickness_mm"}
    moved = scene.but({"numerics.sound_speed_m_s": 90, "cornea.thickness_mm": 0.6})
    assert moved.numerics.mean_sound_speed_m_s == 100.0 and moved.cornea.limbus_thickness_mm == 0.7
    with pytest.raises(SceneError) as caught:
        scene.but({"numerics.sound_speed_m_s": 120})
    for part in ("scene with changes: ", "numerics.mean_sound_speed_m_s = 100.0", "sound_speed_m_s = 120.0", "auto"):
        assert part in str(caught.value)
    freed = scene.but({"numerics.sound_speed_m_s": 120, "numerics.mean_sound_speed_m_s": AUTO})
    assert freed.numerics.mean_sound_speed_m_s == 120.0 and "numerics.mean_sound_speed_m_s" not in freed.given


def test_a_changed_scene_can_be_changed_back():
    scene = load_scene(None, ["cornea.exponent_s=40"])
    there = scene.but({"eye.iop_mmhg": 31.0, "cornea.radius_mm": 7.3, "numerics.fidelity": "added_mass"})
    back = there.but({"eye.iop_mmhg": 15.0, "cornea.radius_mm": 7.8, "numerics.fidelity": "mfpm"})
    assert back == scene and back.given == scene.given and dump_scene(back) == dump_scene(scene)


@pytest.mark.parametrize(
    "changes, parts",
    [
        ({"eye.iop": 20}, ["changes eye.iop = 20: unknown key", "did you mean iop_mmhg?"]),
        ({"eye": 20}, ["changes eye = 20"]),
        ({"eye.iop_mmhg": -1}, ["eye.iop_mmhg = -1", ">= 1"]),
        ({"eye.iop_mmhg": "auto"}, ["must be a number"]),
        ({"eye.iop_mmhg": None}, ["must be a number"]),
        ({"eye.iop_mmhg": np.nan}, ["must be a number"]),
        ({"chamber.sealed": 1}, ["true or false"]),
        ({"numerics.spacing_mm": 0.7}, ["numerics.spacing_mm = 0.7", "at most 0.6462 mm"]),
    ],
)
def test_bad_changes_are_refused(changes, parts):
    with pytest.raises(SceneError) as caught:
        load_scene().but(changes)
    for part in parts:
        assert part in str(caught.value)


def test_numbers_of_numpy_become_plain_ones():
    scene = load_scene().but(
        {"eye.iop_mmhg": np.float32(20.5), "camera.seed": np.int64(3), "puff.peak_kpa": np.int32(9)}
    )
    values = scene.eye.iop_mmhg, scene.camera.seed, scene.puff.peak_kpa
    assert values == (20.5, 3, 9.0) and [type(value) for value in values] == [float, int, float]


def test_studies_go_beyond_the_limits_and_what_is_computed_still_follows():
    scene = load_scene().but({"numerics.cfl": 3.0, "numerics.sound_speed_m_s": 0.5, "numerics.spacing_mm": 2.0}, False)
    numerics = scene.numerics
    assert (numerics.cfl, numerics.mean_sound_speed_m_s, numerics.spacing_mm) == (3.0, 0.5, 2.0)
    with pytest.raises(SceneError, match="numerics.basis"):
        load_scene().but({"numerics.basis": "linear"}, within_limits=False)
    with pytest.raises(SceneError, match="must be a number"):
        load_scene().but({"numerics.cfl": "fast"}, within_limits=False)


@pytest.mark.parametrize(
    "overrides",
    [(), ("chamber.lens_radius_mm=10", "chamber.lens_height_mm=0.6", "chamber.depth_mm=3.2"), ("chamber.depth_mm=4",)],
)
def test_the_coarsest_spacing_is_the_last_that_is_taken(overrides):
    scene = load_scene(None, overrides)
    widest = coarsest_spacing_mm(scene.values())
    assert scene.but({"numerics.spacing_mm": widest}).numerics.spacing_mm == widest
    with pytest.raises(SceneError, match="numerics.spacing_mm"):
        scene.but({"numerics.spacing_mm": 1.0001 * widest})


def within(low, high):
    return st.floats(low, high, allow_nan=False)


# of each tissue at most two of A, k (or s) and the prestrain are given
TISSUES = st.one_of(
    st.fixed_dictionaries(
        {}, optional={"cornea.stiffness_a_pa": within(300, 1e5), "cornea.exponent_s": within(20, 200)}
    ),
    st.fixed_dictionaries({"cornea.prestrain": within(0.01, 0.08)}, optional={"cornea.exponent_k": within(30, 300)}),
    st.fixed_dictionaries({"cornea.prestrain": within(0.02, 0.06), "cornea.stiffness_a_pa": within(500, 5e3)}),
)
EYES = st.fixed_dictionaries(
    {},
    optional={
        "eye.iop_mmhg": within(5, 60),
        "cornea.radius_mm": within(7, 9),
        "cornea.thickness_mm": within(0.3, 0.9),
        "cornea.poisson_ratio": within(0, 0.5),
        "cornea.limbus_thickness_mm": within(0.3, 0.9),
        "chamber.depth_mm": within(4.5, 6),
        "numerics.sound_speed_m_s": within(10, 100),
        "numerics.mean_sound_speed_m_s": within(100, 200),
        "numerics.fidelity": st.sampled_from(["membrane", "cavity", "added_mass", "mfpm"]),
        "numerics.duration_ms": within(2, 60),
        "camera.frame_count": st.integers(1, 5),
    },
)


@settings(max_examples=60, deadline=None)
@given(first=st.tuples(TISSUES, EYES), second=EYES)
def test_a_dumped_scene_is_the_same_to_the_bit_and_changes_as_the_original_does(first, second, tmp_path_factory):
    tissue, eye = first
    scene = load_scene(None, overrides({**tissue, **eye}))
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(dump_scene(scene))
    again = load_scene(path)
    assert again == scene and again.given == scene.given and dump_scene(again) == dump_scene(scene)
    assert scene.given == COMPUTED & {*tissue, *eye}
    afresh = load_scene(None, overrides({**tissue, **eye, **second}))
    assert scene.but(second) == afresh == load_scene(path, overrides(second))
