"""Study files: what they say, what is refused in one message, and the way there and back through what is kept."""

import json

import numpy as np
import pytest

from taichi_eye import cli
from taichi_eye.errors import SceneError
from taichi_eye.scene import load_scene
from taichi_eye.studies.designs import changes, count, draw
from taichi_eye.studies.needs import refuse_missing
from taichi_eye.studies.study import load_study, of_plain, plain_scene, scene_of

DESIGN = {"kind": "random", "eyes": 5}
VARY = {"eye": {"iop_mmhg": {"from": 10, "to": 20}}}


def study(**changed):
    """A study that holds, with some of its entries changed."""
    return load_study({"design": DESIGN, "vary": VARY, **changed})


def test_a_file_says_what_a_dictionary_says(tmp_path):
    (tmp_path / "base.toml").write_text("[eye]\niop_mmhg = 18\n[cornea]\nlimbus_thickness_mm = 0.7\n")
    path = tmp_path / "my.toml"
    path.write_text(
        'scene = "base.toml"\nshow = ["hc_time_ms"]\n'
        '[design]\nkind = "latin_hypercube"\neyes = 8\nseed = 3\n'
        'correlations = [["eye.iop_mmhg", "cornea.thickness_mm", 0.3]]\n'
        '[set]\nnumerics.fidelity = "cavity"\nchamber.compliance_mm3_mmhg = 0.2\n'
        "[vary]\neye.iop_mmhg = { sd_percent = 10 }\ncornea.thickness_mm = { within_percent = 5 }\n"
        'cornea.limbus_thickness_mm = { follows = "cornea.thickness_mm", keeping = "difference" }\n'
        '"puff.peak_kpa" = { from = 5, to = 20, scale = "log" }\n'
    )
    read = load_study(path, overrides=["chamber.compliance_mm3_mmhg=0.1"])
    assert read.name == "my" and read.show == ("hc_time_ms",) and read.seed == 3 and read.eyes == 8
    assert read.base.eye.iop_mmhg == 18.0 and read.base.numerics.fidelity == "cavity"
    assert read.base.chamber.compliance_mm3_mmhg == 0.1
    assert read.vary["eye.iop_mmhg"].plain() == {"mean": 18.0, "sd": 1.8, "at_least": 1.0, "at_most": 100.0}
    assert read.vary["cornea.thickness_mm"].plain() == pytest.approx({"from": 0.5225, "to": 0.5775})
    assert read.keys == ["eye.iop_mmhg", "cornea.thickness_mm", "puff.peak_kpa", "cornea.limbus_thickness_mm"]
    design = draw(read)
    np.testing.assert_allclose(
        design["cornea.limbus_thickness_mm"] - design["cornea.thickness_mm"], 0.15, rtol=0, atol=1e-12
    )
    # kept and read back, it draws the same eyes; written and read again, too
    kept = of_plain(json.loads(json.dumps(read.plain())), scene_of(plain_scene(read.base)), "my", read.keys)
    (tmp_path / "again").mkdir()
    from taichi_eye.scene import dump_scene

    (tmp_path / "again" / "scene.toml").write_text(dump_scene(read.base))
    (tmp_path / "again" / "study.toml").write_text(read.text())
    for other in (kept, load_study(tmp_path / "again" / "study.toml")):
        assert other.base == read.base and other.keys == read.keys
        for name, column in draw(other).items():
            np.testing.assert_array_equal(column, design[name])


def test_a_scene_goes_as_plain_values_and_comes_back():
    for overrides in ([], ["eye.iop_mmhg=20", "cornea.prestrain=0.05", "chamber.sealed=false", "numerics.basis=cubic"]):
        scene = load_scene(None, overrides)
        back = scene_of(json.loads(json.dumps(plain_scene(scene))))
        assert back == scene and back.given == scene.given


BAD = {
    "no design": ({"design": {}}, ["[design] kind", '"latin_hypercube"']),
    "unknown design": ({"design": {"kind": "cube"}}, ['kind = "cube"', '"grid"']),
    "no eyes": ({"design": {"kind": "random"}}, ["eyes = 0", "whole number from 1"]),
    "too many eyes": ({"design": {"kind": "random", "eyes": 10**7}}, ["eyes = 10000000", "1000000"]),
    "a word too much": ({"design": {**DESIGN, "sed": 4}}, ["[design] sed", "eyes, seed, correlations"]),
    "no power of two": ({"design": {"kind": "sensitivity", "base_samples": 100}}, ["base_samples = 100", "power of 2"]),
    "nothing varies": ({"vary": {}}, ["[vary]", "nothing varies"]),
    "unknown key": ({"vary": {"eye": {"iop_mmgh": {"from": 1, "to": 2}}}}, ["eye.iop_mmgh", "eye.iop_mmhg?"]),
    "unknown section": ({"set": {"kornea": {"radius_mm": 7}}}, ["[set] kornea.radius_mm", "no key of a scene"]),
    "a bad setting": ({"set": {"eye": {"iop_mmhg": -3}}}, ["[set] eye.iop_mmhg = -3", ">= 1"]),
    "out of the key's range": ({"vary": {"eye": {"iop_mmhg": {"from": 0, "to": 20}}}}, ["from = 0", ">= 1"]),
    "upside down": ({"vary": {"eye": {"iop_mmhg": {"from": 20, "to": 10}}}}, ["from must be below to"]),
    "half a law": ({"vary": {"eye": {"iop_mmhg": {"mean": 10}}}}, ["{ mean, sd }"]),
    "a word too much in a law": (
        {"vary": {"eye": {"iop_mmhg": {"mean": 10, "sd": 1, "steps": 3}}}},
        ["steps does not belong to mean and sd", "at_least, at_most"],
    ),
    "a number for a law": ({"vary": {"eye": {"iop_mmhg": 15}}}, ["eye.iop_mmhg = 15", "must be a table"]),
    "percent of nothing": (
        {"vary": {"cornea": {"shear_modulus_kpa": {"sd_percent": 5}}}},
        ["shear_modulus_kpa", "own value is 0"],
    ),
    "a word that is no choice": (
        {"vary": {"numerics": {"fidelity": {"values": ["cavity", "cavty"]}}}},
        ["cavty", '"cavity"'],
    ),
    "a choice that is to vary continuously": (
        {"vary": {"chamber": {"sealed": {"from": 0, "to": 1}}}},
        ["chamber.sealed", "values"],
    ),
    "levels are missing": ({"design": {"kind": "grid"}}, ["eye.iop_mmhg", "needs levels"]),
    "levels where none are": (
        {"vary": {"eye": {"iop_mmhg": {"from": 10, "to": 20, "steps": 3}}}},
        ["steps belong to a grid"],
    ),
    "follows what stands still": (
        {"vary": {**VARY, "cornea": {"limbus_thickness_mm": {"follows": "cornea.thickness_mm", "keeping": "ratio"}}}},
        ["cornea.limbus_thickness_mm", "cornea.thickness_mm does not vary"],
    ),
    "a correlation with what stands still": (
        {"design": {**DESIGN, "correlations": [["eye.iop_mmhg", "cornea.radius_mm", 0.2]]}},
        ["cornea.radius_mm does not vary"],
    ),
    "no figure": ({"show": ["deformation"]}, ['"deformation"', "deformation_amplitude_mm?"]),
    "an unknown entry": ({"varies": {}}, ["varies: unknown", "[vary]"]),
    "no scene there": ({"scene": "nowhere.toml"}, ["nowhere.toml", "no such file"]),
    "no table": ({"design": {"kind": "table"}, "vary": {}}, ["[design] file"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_studies_are_refused_by_name_and_value(case):
    changed, parts = BAD[case]
    with pytest.raises(SceneError) as refused:
        study(**changed)
    for part in parts:
        assert part in str(refused.value)
    assert "Traceback" not in str(refused.value)


def test_correlations_that_contradict_each_other_are_refused():
    names = "eye.iop_mmhg", "cornea.thickness_mm", "puff.peak_kpa"
    vary = {name: {"within_percent": 10} for name in names}
    pairs = [[names[0], names[1], 0.9], [names[1], names[2], 0.9], [names[0], names[2], -0.9]]
    with pytest.raises(SceneError, match="contradict"):
        study(vary=vary, design={**DESIGN, "correlations": pairs})


def test_every_problem_is_told_at_once():
    with pytest.raises(SceneError) as refused:
        study(vary={"eye": {"iop_mmhg": {"from": 20, "to": 10}, "iop": {"from": 1, "to": 2}}})
    assert len(str(refused.value).splitlines()) == 2


def test_a_table_of_eyes_brings_its_rows_and_carries_its_labels(tmp_path):
    path = tmp_path / "eyes.csv"
    path.write_text('who;eye.iop_mmhg;chamber.sealed\n"a";12,5;true\nb;15;false\n')
    content = {"design": {"kind": "table", "file": str(path)}}
    read = load_study(content)
    design = draw(read)
    assert count(design) == 2 and list(read.labels["who"]) == ["a", "b"]
    assert changes(design, 0) == {"eye.iop_mmhg": 12.5, "chamber.sealed": True}
    for line, part in (("c;low;true", "row 3"), ("c;200;true", "<= 100"), ("c;12;perhaps", "perhaps")):
        path.write_text(f"who;eye.iop_mmhg;chamber.sealed\na;12,5;true\nb;15;false\n{line}\n")
        with pytest.raises(SceneError, match=part):
            load_study(content)
    for start in ("sep=;\n", "# from a spreadsheet\n"):
        path.write_text(start + 'who;eye.iop_mmhg\n#a;b\n"c;d";12,5\n')
        read = load_study(content)
        assert list(read.labels["who"]) == ["c;d"] and changes(draw(read), 0) == {"eye.iop_mmhg": 12.5}
    for text, part in (
        ("who,eye.iop_mmhg\na,12,13\n", "line 2 has 3 values, the header 2"),
        ("eye.iop_mmhg,eye.iop_mmhg\n12,13\n", "names eye.iop_mmhg more than once"),
        ("who,eye.iop_mmhg\n", "has no rows"),
    ):
        path.write_text(text)
        with pytest.raises(SceneError, match=part):
            load_study(content)
    path.write_text("who;eye.iop\na;12\n")
    with pytest.raises(SceneError, match="column eye.iop is no key"):
        load_study(content)


@pytest.mark.parametrize(
    "words, text",
    [
        (["nowhere.toml"], "no such file"),
        (["broken.toml"], "malformed TOML"),
        (["empty.toml"], "[design]"),
        (["good.toml", "--set", "eye.iop_mmhg=-1"], "--set eye.iop_mmhg"),
        (["hopeless.toml"], "no eye of this study is a scene"),
        ([], "needs a study file"),
        (["--resume", "nowhere"], "no such folder"),
        (["good.toml", "--resume", "."], "leave out a study"),
        (["--resume", "."], "holds no run"),
    ],
)
def test_bad_commands_are_refused_in_one_message_with_nothing_written(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.toml").write_text("[design]\nkind = = 3\n")
    (tmp_path / "empty.toml").write_text("")
    vary = '[design]\nkind = "random"\neyes = 3\n[vary]\neye.iop_mmhg = { from = 10, to = 20 }\n'
    (tmp_path / "good.toml").write_text(vary)
    (tmp_path / "hopeless.toml").write_text(vary + "cornea.radius_mm = { from = 5.0, to = 5.5 }\n")
    before = sorted(path.name for path in tmp_path.iterdir())
    assert cli.main(["sweep", *words]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("taichi-eye: ") and text in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_missing_packages_are_named_with_what_installs_them(monkeypatch):
    from taichi_eye.studies import needs

    monkeypatch.setattr(needs, "find_spec", lambda name: None if name in ("SALib", "distributed") else object())
    with pytest.raises(SceneError, match=r"SALib is not installed.*pip install 'taichi-eye\[studies\]'"):
        refuse_missing()
    with pytest.raises(SceneError, match=r"SALib, distributed are not installed.*taichi-eye\[studies,cluster\]"):
        refuse_missing(cluster=True)
