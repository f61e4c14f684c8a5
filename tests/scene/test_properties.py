"""Scenes drawn at random: what is accepted dumps and loads equal, all else is a SceneError, whatever was written."""

import math
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taichi_eye.errors import SceneError
from taichi_eye.scene import dump_scene, load_scene
from taichi_eye.scene.draft import written
from taichi_eye.scene.schema import AUTO, SECTIONS, all_keys

SCENES = settings(max_examples=100, deadline=None)
TABLE = {name: (kind, spec) for name, kind, spec in all_keys()}


SMALLEST = sys.float_info.min  # numbers below it are zero once the kernel language runs


def ends(kind, spec):
    """The first and the last value that a number's key allows, and their neighbours within."""

    def step(value, to):
        if kind is int:
            return value + (1 if to > 0 else -1)
        return math.nextafter(value, to) if value else SMALLEST

    found = []
    if spec.at_least is not None:
        found += [spec.at_least, step(spec.at_least, math.inf)]
    if spec.below is not None:
        found.append(step(spec.below, -math.inf))
    if spec.at_most is not None:
        found += [step(spec.at_most, -math.inf), spec.at_most]
    return [kind(value) for value in found]


def allowed(name):
    """Values that a key allows on its own, those at the ends often."""
    kind, spec = TABLE[name]
    if spec.choices:
        values = st.sampled_from(spec.choices)
    elif kind is bool:
        values = st.booleans()
    elif kind is str:
        values = st.just("")
    else:
        highest = spec.at_most if spec.at_most is not None else math.nextafter(spec.below, -math.inf)
        if kind is int:
            within = st.integers(spec.at_least, highest)
        else:
            within = st.floats(spec.at_least, highest, allow_subnormal=False)
        values = st.sampled_from(ends(kind, spec)) | within
    return st.just(AUTO) | values if spec.computed else values


def overrides(values=allowed):
    """Overrides of some keys, each once."""
    names = st.lists(st.sampled_from(sorted(TABLE)), unique=True, max_size=len(TABLE))
    return names.flatmap(lambda chosen: st.tuples(*(values(name).map(lambda v, n=name: (n, v)) for name in chosen)))


def typed(pairs):
    return [f"{name}={written(value)}" for name, value in pairs]


def from_text(text):
    """The scene of a file with this text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
        return load_scene(path)


def taken(load, *arguments):
    """The scene, or None where it was refused as bad input is."""
    try:
        return load(*arguments)
    except SceneError as refusal:
        assert str(refusal).strip()
        return None


def test_every_number_has_two_ends():
    for name, (kind, spec) in TABLE.items():
        if kind in (int, float) and not spec.choices:
            assert spec.at_least is not None and (spec.at_most is not None or spec.below is not None), name


@SCENES
@given(overrides())
@example([("cornea.stiffness_a_pa", 1e-160)])
@example([("cornea.stiffness_a_pa", 1e9), ("cornea.exponent_k", 1e5)])
@example([("numerics.spacing_mm", 1e-310)])
@example([("cornea.thickness_mm", 5e-324)])
@example([("cornea.prestrain", 1e-200)])
@example([("camera.frame_count", 1), ("camera.frame_interval_ms", 1e-9)])
@example([("camera.width_px", 4096), ("camera.height_px", 4096), ("output.gif", True)])
def test_values_at_the_ends_of_their_ranges_make_a_scene_or_a_refusal(pairs):
    scene = taken(load_scene, None, typed(pairs))
    if scene is not None:
        again = from_text(dump_scene(scene))
        assert again == scene
        for name, value in pairs:
            section, key = name.split(".")
            if value != AUTO and name != "puff.file":
                assert getattr(getattr(again, section), key) == value, name


@SCENES
@given(overrides())
def test_a_file_and_overrides_with_the_same_values_make_the_same_scene(pairs):
    lines = {section: [] for section in SECTIONS}
    for name, value in pairs:
        section, key = name.split(".")
        lines[section].append(f"{key} = {written(value)}")
    text = "\n".join(f"[{section}]\n" + "\n".join(keys) for section, keys in lines.items())
    assert taken(from_text, text) == taken(load_scene, None, typed(pairs))


@SCENES
@given(overrides(), st.randoms())
def test_the_order_of_overrides_of_different_keys_is_of_no_account(pairs, chance):
    shuffled = list(pairs)
    chance.shuffle(shuffled)
    assert taken(load_scene, None, typed(pairs)) == taken(load_scene, None, typed(shuffled))


ANY = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=20)
    | st.dates().map(str)
    | st.sampled_from(["[1, 2]", "{a = 1}", "1e999", "-0.0", "0x" + "f" * 400, "1_0", "'x'", "nan", "inf", "+5", ".5"])
)


@SCENES
@given(overrides(lambda name: ANY | allowed(name)), st.lists(st.text(max_size=30), max_size=3))
def test_any_value_and_any_words_make_a_scene_or_a_refusal(pairs, words):
    taken(load_scene, None, [f"{name}={value}" for name, value in pairs] + words)


@SCENES
@given(st.text(max_size=400))
@example("\ufeff[eye]\r\niop_mmhg = 15")
@example("[eye]\niop_mmhg = 15\x00")
def test_any_text_makes_a_scene_or_a_refusal(text):
    taken(from_text, text)


@SCENES
@given(overrides(), st.data())
def test_a_damaged_file_makes_a_scene_or_a_refusal(pairs, data):
    scene = taken(load_scene, None, typed(pairs))
    text = dump_scene(load_scene() if scene is None else scene)
    at = data.draw(st.integers(0, len(text)))
    text = text[:at] + data.draw(st.text(max_size=3)) + text[at + data.draw(st.integers(0, 40)) :]
    taken(from_text, text)


@pytest.mark.parametrize("depth", [500, 5000])
@pytest.mark.parametrize(
    "text",
    ["{path} = 1", "[eye]\n{path} = 1", "[{path}]\nx = 1", "[eye]\niop_mmhg.{path} = 1", "[eye]\niop_mmhg = {arrays}"],
)
def test_a_table_however_deep_is_refused(text, depth):
    path, arrays = ".".join(["a"] * depth), "[" * depth + "]" * depth
    assert taken(from_text, text.format(path=path, arrays=arrays)) is None
    assert taken(load_scene, None, [f"eye.{path}=1"]) is None
    assert taken(load_scene, None, [f"eye.iop_mmhg={{{path}=1}}"]) is None
