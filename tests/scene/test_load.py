"""Loading, resolving, refusing and writing scenes."""

import math
import random
from pathlib import Path

import pytest

from taichi_eye.errors import SceneError
from taichi_eye.scene import dump_scene, load_scene
from taichi_eye.scene.draft import written
from taichi_eye.scene.schema import AUTO, SECTIONS, all_keys


def refusal(*overrides, path=None):
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides)
    return str(caught.value)


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="eye.toml"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def test_empty_file_is_the_default_eye(write):
    scene = load_scene(write(""))
    assert scene == load_scene()
    for name, kind, spec in all_keys():
        section, key = name.split(".")
        value = getattr(getattr(scene, section), key)
        assert type(value) is kind
        if spec.default != AUTO:
            assert value == spec.default


def test_default_eye_is_resolved():
    scene = load_scene()
    assert scene.cornea.stiffness_a_pa == 1562.0
    assert scene.cornea.exponent_k == 86.1
    assert scene.cornea.exponent_s == pytest.approx(86.1 / 1.49, rel=1e-15)
    assert scene.cornea.prestrain == pytest.approx(0.0400, abs=5e-5)
    assert scene.chamber.depth_mm == pytest.approx(2.585, abs=5e-4)


def test_every_key_has_a_doc_and_its_default_lies_within_its_limits():
    for name, kind, spec in all_keys():
        assert spec.doc, name
        assert spec.computed or type(spec.default) is kind and spec.holds(spec.default), name


# --- what overrides and files may say -------------------------------------------------------------------------------


def test_override_wins_over_the_file_and_the_last_one_wins(write):
    path = write("[eye]\niop_mmhg = 18\n[cornea]\nradius_mm = 7.5\n")
    scene = load_scene(path, ["eye.iop_mmhg=20", "eye.iop_mmhg = 25.5"])
    assert (scene.eye.iop_mmhg, scene.cornea.radius_mm) == (25.5, 7.5)


@pytest.mark.parametrize(
    "text, value",
    [
        ("numerics.spacing_mm=.2", 0.2),
        ("numerics.spacing_mm=2e-1", 0.2),
        ("numerics.spacing_mm=+0.2", 0.2),
        ("numerics.basis=cubic", "cubic"),
        ('numerics.basis="cubic"', "cubic"),
        ("numerics.basis='cubic'", "cubic"),
        ("camera.noise=false", False),
        ("camera.seed=7", 7),
        ("puff.peak_kpa=0", 0.0),
        ("eye.iop_mmhg=1_5", 15.0),
    ],
)
def test_override_values(text, value):
    section, key = text.split("=")[0].split(".")
    got = getattr(getattr(load_scene(None, [text]), section), key)
    assert got == value and type(got) is type(value)


def test_dotted_keys_comments_and_byte_order_mark(write):
    assert load_scene(write("\ufeff# mine\neye.iop_mmhg = 20 # high\n")).eye.iop_mmhg == 20.0


# --- computed keys --------------------------------------------------------------------------------------------------


def rest_error(scene):
    c = scene.cornea
    wall = 2 * c.stiffness_a_pa * c.exponent_k * c.prestrain * math.exp(2 * c.exponent_k * c.prestrain**2)
    return wall / (scene.eye.iop_mmhg * 133.322387415 * c.radius_mm / (2 * c.thickness_mm)) - 1


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("cornea.stiffness_a_pa=3000",),
        ("cornea.exponent_k=50",),
        ("cornea.exponent_s=40",),
        ("cornea.prestrain=0.03",),
        ("cornea.prestrain=0.05", "cornea.exponent_k=60"),
        ("cornea.prestrain=0.05", "cornea.stiffness_a_pa=900"),
        ("eye.iop_mmhg=42", "cornea.thickness_mm=.4"),
    ],
)
def test_rest_condition_holds_whatever_is_left_open(overrides):
    scene = load_scene(None, overrides)
    assert abs(rest_error(scene)) < 1e-12
    assert scene.cornea.exponent_k == pytest.approx(scene.cornea.exponent_s * 1.49, rel=1e-12)
    for text in overrides:
        key, value = text.split("=")
        assert getattr(getattr(scene, key.split(".")[0]), key.split(".")[1]) == float(value)


def test_three_tissue_constants_must_agree():
    said = refusal("cornea.stiffness_a_pa=1562", "cornea.exponent_k=86.1", "cornea.prestrain=0.05")
    assert "cornea.prestrain = 0.05" in said and "cornea.prestrain=auto" in said and "leave one" in said
    resolved = load_scene().cornea
    given = [f"cornea.{k}={getattr(resolved, k)!r}" for k in ("stiffness_a_pa", "exponent_k", "prestrain")]
    assert load_scene(None, given).cornea == resolved
    said = refusal(*given, f"cornea.prestrain={resolved.prestrain * (1 + 1e-5)!r}")
    assert "leave one" in said


def spelled_out(scene):
    """A scene file that leaves nothing to compute."""
    lines = []
    for section in SECTIONS:
        lines.append(f"[{section}]")
        lines += [f"{key} = {written(value)}" for key, value in vars(getattr(scene, section)).items()]
    return "\n".join(lines)


def test_a_given_prestrain_contradicts_another_pressure_and_the_message_says_what_to_do(write):
    path = write(spelled_out(load_scene()))
    said = refusal("eye.iop_mmhg=20", path=path)
    assert "eye.iop_mmhg = 20.0" in said and "--set cornea.prestrain=auto" in said
    moved = load_scene(path, ["eye.iop_mmhg=20", "cornea.prestrain=auto"])
    assert moved == load_scene(None, ["eye.iop_mmhg=20"])


def test_given_keys_contradict_another_radius_and_the_message_says_what_to_do(write):
    path = write(spelled_out(load_scene()))
    said = refusal("cornea.radius_mm=7.2", path=path)
    assert "--set cornea.prestrain=auto" in said and "--set chamber.depth_mm=auto" in said
    moved = load_scene(path, ["cornea.radius_mm=7.2", "cornea.prestrain=auto", 'chamber.depth_mm="auto"'])
    assert moved == load_scene(None, ["cornea.radius_mm=7.2"])


def test_k_and_s_must_agree(write):
    said = refusal("cornea.exponent_k=86.1", "cornea.exponent_s=86.1")
    assert "k = s (1 + nu)" in said
    path = write(spelled_out(load_scene()))
    assert "cornea.exponent_s=auto" in refusal("cornea.exponent_k=80", "cornea.prestrain=auto", path=path)
    assert "cornea.exponent_k=auto" in refusal("cornea.exponent_s=60", "cornea.prestrain=auto", path=path)
    scene = load_scene(path, ["cornea.exponent_s=60", "cornea.exponent_k=auto", "cornea.prestrain=auto"])
    assert scene.cornea.exponent_k == 60 * 1.49


def test_solved_constant_out_of_its_limits_is_refused():
    assert "cornea.stiffness_a_pa" in refusal("cornea.prestrain=0.5", "cornea.exponent_k=100000")


# --- one key at a time ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, parts",
    [
        ("cornea.radius_mm=abc", ['cornea.radius_mm = "abc"', "must be a number in mm"]),
        ("cornea.radius_mm=true", ["cornea.radius_mm = true", "must be a number"]),
        ("cornea.radius_mm=[7.8]", ["cornea.radius_mm = an array", "must be a number"]),
        ("cornea.radius_mm={a=1}", ["cornea.radius_mm = a table", "must be a number"]),
        ("cornea.radius_mm=1979-05-27", ["cornea.radius_mm = 1979-05-27", "must be a number"]),
        ("cornea.radius_mm=nan", ["cornea.radius_mm = nan", "must be a number"]),
        ("cornea.radius_mm=-inf", ["cornea.radius_mm = -inf", "must be a number"]),
        ("cornea.radius_mm=1e999", ["cornea.radius_mm = inf", "must be a number"]),
        ("cornea.radius_mm=" + "9" * 400, ["cornea.radius_mm = ", "must be a number"]),
        ("cornea.radius_mm=", ['cornea.radius_mm = ""', "must be a number"]),
        ("cornea.thickness_mm=-0.55", ["cornea.thickness_mm = -0.55", ">= 0.01 and <= 2"]),
        ("cornea.thickness_mm=0", ["cornea.thickness_mm = 0", ">= 0.01"]),
        ("camera.frame_count=100.0", ["camera.frame_count = 100.0", "a whole number"]),
        ("camera.frame_count=true", ["camera.frame_count = true", "a whole number"]),
        ("camera.noise=1", ["camera.noise = 1", "true or false"]),
        ("camera.noise=yes", ['camera.noise = "yes"', "true or false"]),
        ("numerics.basis=linear", ['numerics.basis = "linear"', '"quadratic" | "cubic"']),
        ("numerics.basis=2", ["numerics.basis = 2", '"quadratic" | "cubic"']),
        ("eye.iop_mmhg=auto", ['eye.iop_mmhg = "auto"', "must be a number"]),
        ("cornea.prestrain=-1", ["cornea.prestrain = -1", 'or "auto"']),
        ("puff.file=3", ["puff.file = 3", "must be a string"]),
        ("puff.file=a\0b", ["puff.file", "must be a string"]),
        ("puff.file=a\udc80b", ["puff.file", "must be a string"]),
        ("cornea.radius=7.8", ["cornea.radius = 7.8", "unknown key", "did you mean radius_mm?"]),
        ("cornea.spacing_mm=0.1", ["unknown key", "it is a key of [numerics]"]),
        ("cornee.radius_mm=7.8", ["unknown section [cornee]", "radius_mm is a key of [cornea]"]),
        ("camerra.zoom=7.8", ["unknown section [camerra]", "did you mean camera?"]),
        ("radius_mm=7.8", ["--set radius_mm=7.8", "section.key=value"]),
        ("cornea.radius_mm", ["--set cornea.radius_mm", "section.key=value"]),
        ("cornea.radius_mm.x=1", ["section.key=value"]),
        ("=1", ["section.key=value"]),
        ("cornea.radius_mm=1\nb=2", ["must be a number"]),
        ("cornea.radius_mm=" + "[" * 100000, ["must be a number"]),
    ],
)
def test_bad_override_is_refused(text, parts):
    said = refusal(text)
    for part in ["--set", *parts]:
        assert part in said


@pytest.mark.parametrize(
    "content, parts",
    [
        ("[cornea]\nradius_mm = '7.8'\n", ['cornea.radius_mm = "7.8"', "must be a number in mm"]),
        ("[cornea]\nraduis_mm = 7.8\n", ["cornea.raduis_mm = 7.8", "did you mean radius_mm?"]),
        ("[korneum]\n", ["[korneum]", "unknown section", "cornea"]),
        ("radius_mm = 7.8\n", ["radius_mm = 7.8", "must stand in a section", "[cornea]"]),
        ("cornea = 7.8\n", ["cornea = 7.8", "must be a table"]),
        ("[[cornea]]\nradius_mm = 7.8\n", ["cornea = an array", "must be a table"]),
        ("[cornea.radius_mm]\nx = 7.8\n", ["cornea.radius_mm = a table", "must be a number"]),
        ("[cornea]\nradius_mm = \n", ["malformed TOML", "line 2"]),
        ("[cornea]\nradius_mm = 7\nradius_mm = 8\n", ["malformed TOML", "line 3"]),
        ("[eye]\nx = " + "[" * 100000, ["malformed TOML"]),
        (b"[eye]\n\xff\xfe = 1\n", ["line 2", "UTF-8"]),
        (b"\x89PNG\r\n\x1a\n\0\0", ["UTF-8"]),
    ],
)
def test_bad_file_is_refused(write, content, parts):
    path = write(content)
    said = refusal(path=path)
    for part in [str(path), *parts]:
        assert part in said


def test_missing_file_and_directory_are_refused(tmp_path):
    assert f"{tmp_path / 'no.toml'}: no such file" in refusal(path=tmp_path / "no.toml")
    assert f"{tmp_path}: is a directory" in refusal(path=tmp_path)
    assert "cannot be read" in refusal(path=tmp_path / ("x" * 5000))
    assert "cannot be read" in refusal(path="a\0b")
    link = tmp_path / "loop.toml"
    link.symlink_to(link)
    assert "cannot be read" in refusal(path=link)


def test_all_problems_stand_in_one_message(write):
    path = write("[eye]\niop_mmhg = true\npressure = 3\n[cornea]\nthickness_mm = -1\n")
    said = refusal("puff.peak_kpa=lots", path=path)
    assert len(said.splitlines()) == 4
    for part in ("eye.iop_mmhg", "eye.pressure", "cornea.thickness_mm", "--set puff.peak_kpa"):
        assert part in said


# --- keys against each other ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "overrides, parts",
    [
        (["cornea.limbus_radius_mm=8"], ["cornea.limbus_radius_mm = 8.0", "cornea.radius_mm = 7.8 (default)", "below"]),
        (["cornea.radius_mm=5.8"], ["cornea.radius_mm = 5.8", "below"]),
        (["chamber.depth_mm=2.5"], ["chamber.depth_mm = 2.5", "2.58463807"]),
        (["chamber.lens_radius_mm=10"], ["chamber.lens_height_mm = 0.0 (default)", "both"]),
        (["chamber.lens_height_mm=1"], ["chamber.lens_radius_mm = 0.0 (default)", "both"]),
        (["chamber.lens_radius_mm=3", "chamber.lens_height_mm=3"], ["height below the radius"]),
        (["chamber.lens_radius_mm=10", "chamber.lens_height_mm=2.4"], ["inside the limbus radius"]),
        (["chamber.lens_radius_mm=8", "chamber.lens_height_mm=2.3"], ["of the cornea at rest"]),
        (["numerics.spacing_mm=0.7"], ["numerics.spacing_mm = 0.7", "at most 0.6462 mm"]),
        (["chamber.lens_radius_mm=10", "chamber.lens_height_mm=1", "numerics.spacing_mm=0.45"], ["at most 0.3962 mm"]),
        (["numerics.spacing_mm=0.007"], ["numerics.spacing_mm = 0.007", "200000"]),
        (
            ["numerics.mean_sound_speed_m_s=79"],
            ["numerics.mean_sound_speed_m_s = 79", "sound_speed_m_s = 80.0 (default)", "at least 80 m/s"],
        ),
        (["numerics.duration_ms=10", "camera.frame_count=45"], ["numerics.duration_ms = 10.0", "at most 44 frames"]),
        (["camera.width_px=577"], ["camera.width_px = 577", "even"]),
        (["camera.apex_column_px=576"], ["camera.apex_column_px = 576", "at most 575"]),
        (["camera.height_px=100", "camera.apex_row_px=100"], ["camera.apex_row_px = 100", "at most 99"]),
        (["puff.time_course=file"], ["puff.file", "time_ms,pressure_kpa"]),
        (["puff.file=puff.csv"], ["puff.file", 'puff.time_course = "file"']),
    ],
)
def test_keys_that_contradict_each_other_are_refused(overrides, parts):
    said = refusal(*overrides)
    for part in ["--set", *parts]:
        assert part in said


def test_frames_fill_the_duration_by_default():
    assert load_scene().camera.frame_count == 139
    assert load_scene(None, ["numerics.duration_ms=10"]).camera.frame_count == 44


def test_just_enough_is_accepted():
    assert load_scene(None, ["numerics.duration_ms=10", "camera.frame_count=44"]).camera.frame_count == 44
    assert load_scene(None, ["numerics.duration_ms=9.9545", "camera.frame_count=44"]).camera.frame_count == 44
    assert load_scene(None, ["numerics.spacing_mm=0.646"]).numerics.spacing_mm == 0.646
    assert load_scene(None, ["numerics.spacing_mm=0.0073"]).numerics.spacing_mm == 0.0073
    lens = load_scene(None, ["chamber.lens_radius_mm=10", "chamber.lens_height_mm=1"]).chamber
    assert (lens.lens_radius_mm, lens.lens_height_mm) == (10.0, 1.0)


def test_contradiction_names_the_file_that_said_it(write):
    path = write("[cornea]\nlimbus_radius_mm = 7.5\n")
    assert refusal("cornea.radius_mm=7", path=path).startswith(f"{path} with --set: ")


# --- the user's puff ------------------------------------------------------------------------------------------------

GOOD = "time_ms,pressure_kpa\n0,0\n10,8.5\n20,0\n"


def test_puff_file_stands_beside_the_scene_and_is_resolved(write, tmp_path, monkeypatch):
    write(GOOD, "p.csv")
    path = write('[puff]\ntime_course = "file"\nfile = "p.csv"\n')
    scene = load_scene(path)
    assert Path(scene.puff.file) == tmp_path / "p.csv"
    (tmp_path / "run").mkdir()
    copy = tmp_path / "run" / "scene.toml"
    copy.write_text(dump_scene(scene))
    assert load_scene(copy) == scene
    monkeypatch.chdir(tmp_path)
    assert load_scene("eye.toml") == scene
    assert load_scene(None, ["puff.time_course=file", "puff.file=p.csv"]) == scene
    monkeypatch.chdir(tmp_path / "run")
    assert load_scene("../eye.toml", ["puff.file=../p.csv"]).puff.peak_kpa == 10.0


@pytest.mark.parametrize(
    "content, parts",
    [
        ("", ["is empty"]),
        ("time_ms,pressure_kpa\n", ["has 0 row(s)"]),
        ("time_ms,pressure_kpa\n0,0\n", ["has 1 row(s)"]),
        ("0,0\n1,2\n", ['header is "0,0"', "time_ms and pressure_kpa"]),
        ("time_s,pressure_kpa\n0,0\n1,2\n", ["time_ms and pressure_kpa"]),
        ("time_ms,time_ms,pressure_kpa\n0,0,0\n1,1,1\n", ["time_ms more than once"]),
        ("time_ms,pressure_kpa\n0,0\n1\n", ["line 3 has 1 values"]),
        ("time_ms,pressure_kpa\n0,0\n1,x\n", ["line 3", 'pressure_kpa = "x"']),
        ("time_ms,pressure_kpa\n0,0\n1,nan\n", ["line 3", "finite"]),
        ("time_ms,pressure_kpa\n0,0\n1,1\n1,2\n", ["line 4", "does not increase"]),
        ("time_ms,pressure_kpa\n0,0\n1,96000\n", ["96000", "kPa"]),
        (b"time_ms,pressure_kpa\n0,0\n1,\xff\n", ["line 3", "UTF-8"]),
        ('time_ms,pressure_kpa\n0,"' + "1" * 200000 + '"\n', ["line 2"]),
    ],
)
def test_bad_puff_file_is_refused(write, content, parts):
    csv = write(content, "p.csv")
    path = write('[puff]\ntime_course = "file"\nfile = "p.csv"\n')
    said = refusal(path=path)
    for part in [str(path), "puff.file", str(csv), *parts]:
        assert part in said


def test_missing_puff_file_is_refused(write, tmp_path):
    path = write('[puff]\ntime_course = "file"\nfile = "none.csv"\n')
    assert f"{tmp_path / 'none.csv'}: no such file" in refusal(path=path)
    path = write('[puff]\ntime_course = "file"\nfile = "."\n')
    assert "is a directory" in refusal(path=path)


# --- writing --------------------------------------------------------------------------------------------------------


def test_written_scene_spells_out_and_explains_every_key():
    lines = dump_scene(load_scene()).splitlines()
    for name, _, spec in all_keys():
        key = name.split(".")[1]
        assert any(line.startswith(f"{key} = ") and spec.doc in line for line in lines), name


def random_scene_text(rng, file):
    """Valid overrides, drawn over the whole of each key's range where nothing else depends on it."""
    radius = rng.uniform(6, 9)
    texts = {
        "cornea.radius_mm": radius,
        "cornea.limbus_radius_mm": radius * rng.uniform(0.6, 0.9),
        "numerics.duration_ms": rng.uniform(5, 40),
        "camera.frame_count": rng.randint(1, 20),
        "camera.frame_interval_ms": rng.uniform(0.01, 0.2),
        "numerics.spacing_mm": rng.uniform(0.03, 0.3),
        "camera.width_px": 2 * rng.randint(150, 400),
        "camera.height_px": 2 * rng.randint(50, 400),
    }
    if rng.random() < 0.5:
        texts |= {"puff.time_course": "file", "puff.file": file}
    if rng.random() < 0.5:
        texts |= {
            "chamber.lens_radius_mm": rng.uniform(8, 12),
            "chamber.lens_height_mm": rng.uniform(0.05, 0.3),
            "chamber.depth_mm": radius,
        }
    fixed = {*texts, "puff.time_course", "puff.file", "camera.apex_column_px"}
    for name, kind, spec in all_keys():
        if name in fixed or spec.computed or name.startswith("chamber"):
            continue
        if kind is str:
            texts[name] = rng.choice(spec.choices)
        elif kind is bool:
            texts[name] = rng.choice([True, False])
        else:
            low = spec.above if spec.at_least is None else spec.at_least
            high = spec.at_most if spec.at_most is not None else spec.below
            if name == "camera.apex_row_px":
                high = 99
            texts[name] = rng.randint(low, high) if kind is int else low + (high - low) * rng.uniform(1e-3, 0.999)
    return [f"{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in texts.items()]


@pytest.mark.parametrize("seed", range(40))
def test_written_scene_loads_to_the_same_bits(seed, write, tmp_path):
    rng = random.Random(seed)
    file = write(GOOD, 'p "ü\\ \x7f#.csv')
    scene = load_scene(None, random_scene_text(rng, file))
    path = write(dump_scene(scene), "scene.toml")
    assert load_scene(path) == scene
    assert dump_scene(load_scene(path)) == dump_scene(scene)
