"""The guide says what is so: its commands parse and its short ones run, its keys and columns exist, its headline
figures are those that the commands themselves ask, its pages ship."""

import ast
import re
import shlex
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import taichi_eye
from taichi_eye import cli, docs, options, shipped
from taichi_eye.analysis.norms import NORMS, POPULATIONS
from taichi_eye.analysis.response import Response
from taichi_eye.report.traces import COLUMNS
from taichi_eye.scene import load_scene
from taichi_eye.scene.schema import SECTIONS, all_keys
from taichi_eye.studies.study import load_study

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = README + "".join(docs.text(name) for name in docs.names())
LINES_MOST = 170
KEYS = {name for name, _, _ in all_keys()}
OWN = {"my.toml", "my_puff.csv", "my_study.toml"}  # files that a reader brings


def fenced(language, text=README):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(text):
    """The taichi-eye commands of shell text, as words without the program's name; pipes, && and > end one."""
    for line in text.splitlines():
        words, found = shlex.split(line, comments=True), None
        for word in [*words, "&&"]:
            if word in ("&&", "|", ">"):
                if found is not None:
                    yield tuple(found)
                found = None
            elif word.rsplit("/", 1)[-1] == "taichi-eye":
                found = []
            elif found is not None:
                found.append(word)


def leaves(parser, words=()):
    """Every command that ends in something to do: its words and its parser."""
    groups = [action for action in parser._actions if hasattr(action, "choices") and isinstance(action.choices, dict)]
    if not groups:
        yield words, parser
    for group in groups:
        for name, below in group.choices.items():
            yield from leaves(below, (*words, name))


SHELL = [words for block in fenced("sh") for words in commands(block)]
INLINE = [
    words
    for text in re.findall(r"`(taichi-eye [a-z][^`]*)`", GUIDE)
    for words in commands(text)
    if not re.search(r"\b([A-Z]{3,}|[A-Z])\b", text)  # what the reader fills in
]
PARSERS = dict(leaves(cli.parser()))
EXAMPLES = [words for parser in PARSERS.values() for line in parser.examples for words in commands(line)]


@pytest.mark.parametrize("words", [*dict.fromkeys([*SHELL, *INLINE, *EXAMPLES])], ids=" ".join)
def test_every_command_that_is_shown_parses_and_its_scene_is_one(words, capsys):
    if len(words) == 1 and any(known[0] == words[0] for known in PARSERS):
        return  # a command that is spoken of
    try:
        given = cli.parser().parse_args(words)
    except SystemExit as ended:
        assert ended.code == 0, capsys.readouterr().err
        return
    study = getattr(given, "study", None)
    if study is not None and study not in OWN:
        assert load_study(ROOT / study if "/" in study else study).keys
    scene = getattr(given, "scene", None)
    overrides = [entry for entry in getattr(given, "overrides", ()) if not OWN & set(entry.split("="))]
    overrides = [entry for entry in overrides if entry != "puff.time_course=file"]
    if scene not in OWN and (scene is not None or overrides):
        load_scene(None if scene is None else ROOT / scene if "/" in scene else scene, overrides)


SHORT = [
    words
    for words in [*SHELL, *EXAMPLES, ("--version",), ("--cite",)]
    if words[0] in ("docs", "scene", "--version", "--cite")
]


@pytest.mark.parametrize("words", [*dict.fromkeys(SHORT)], ids=" ".join)
def test_short_commands_run(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        status = cli.main(list(words))
    except SystemExit as ended:
        status = ended.code
    said = capsys.readouterr()
    assert status == 0 and said.out.strip() and not said.err
    assert not list(tmp_path.iterdir())


def test_every_command_has_help_with_an_example():
    assert {("check", name) for name in ("verify", "stability", "chart", "choices", "claims", "films", "bench")} < set(
        PARSERS
    )
    for words, parser in PARSERS.items():
        assert any(
            example[: len(words)] == words or example[1:][: len(words)] == words
            for example in [each for line in parser.examples for each in commands(line)]
        ), words


def test_old_names_of_the_proofs_do_the_same():
    proofs = {words[1]: parser for words, parser in PARSERS.items() if words[0] == "check"}
    for name, parser in proofs.items():
        old = PARSERS[(name,)]
        assert old.get_default("do") is parser.get_default("do")
        assert [action.option_strings for action in old._actions] == [
            action.option_strings for action in parser._actions
        ]
    for before in ([], ["check"]):
        assert cli.parser().parse_args([*before, "verify", "--only", "squeeze"]).command == "verify"


@pytest.mark.parametrize("name", ["verify", "films"])
def test_help_names_the_parts(name, capsys):
    with pytest.raises(SystemExit):
        cli.main(["check", name, "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert ", ".join(cli._proof(name).PARTS) in said


def test_shared_options_are_the_same_everywhere():
    flags = {flag: settings for flag, settings in options.SHARED.values()}
    for words, parser in PARSERS.items():
        for action in parser._actions:
            for flag in action.option_strings:
                if flag in flags:
                    assert action.metavar == flags[flag].get("metavar"), (words, flag)
                    assert action.type == flags[flag].get("type"), (words, flag)


def test_readme_is_short_and_its_python_is_python():
    assert len(README.splitlines()) <= LINES_MOST
    for text in (README, docs.text("python")):
        for block in fenced("python", text):
            for name in re.findall(r"taichi_eye\.(\w+)", block):
                assert name in taichi_eye.__all__ or (ROOT / "taichi_eye" / name).exists(), name
            ast.parse(block)


def test_readme_shows_the_two_commands_that_ci_runs():
    runs, tests = (line for block in fenced("sh") for line in block.splitlines() if "-m venv" in line)
    assert runs.endswith(".venv/bin/taichi-eye run configs/seed.toml")
    assert tests.endswith(".venv/bin/pip install '.[test]' && .venv/bin/python -m pytest")
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert '"$venv/bin/python" -m pip install --quiet --disable-pip-version-check ".[test]"' in ci
    assert '"$venv/bin/python" -m pytest\n' in ci


def test_keys_that_the_guide_names_exist():
    named = set(re.findall(rf"\b((?:{'|'.join(SECTIONS)})\.\w+)\b(?!\()", README))
    assert len(named) > 20
    assert {name for name in named if not name.endswith(".file")} <= KEYS


def test_files_that_the_guide_names_exist():
    for path in re.findall(r"\((renders/[\w.]+|\.github/[\w.]+)\)", README):
        assert (ROOT / path).is_file(), path
    for path in re.findall(r"`((?:tests|configs)/[\w./]+)`", GUIDE):
        assert (ROOT / path).exists(), path


def test_headline_figures_are_those_that_the_commands_ask():
    from taichi_eye.bench import default
    from taichi_eye.proof import choices, verify
    from taichi_eye.proof.films import reading

    trust = README[README.index("## Can I trust it?") : README.index("## When something is wrong")]
    limits = {field: (limit, unit) for _, field, unit, limit in reading.PARAMETERS}
    spelled = {12: "twelve", 16: "sixteen"}
    assert f"{spelled[len(verify.PARTS)]} problems" in trust
    assert f"within {default.ERROR:g} % of {default.PEAK_MM:g} mm" in trust
    assert f"{default.LIMITS_ERROR:g} % extrapolated" in trust
    assert "{:g}, {:g} and {:g} %".format(*choices.TOLERANCES) in trust
    assert f"{spelled[len(choices.PARTS)]} scenes" in trust
    assert "amplitude within {:g} {}".format(*limits["deformation_amplitude_mm"]) in trust
    assert {limits[f"{name}_time_ms"] for name in ("a1", "a2")} == {(0.12, "ms")} and "times within 0.12 ms" in trust


def test_pages_name_every_column_key_and_norm():
    outputs, parameters, keys = (docs.text(name) for name in ("outputs", "parameters", "keys"))
    for column in COLUMNS:
        assert f"`{column}`" in outputs
    for f in fields(Response):
        assert f"`{f.name}`" in parameters
    for population, norms in NORMS.items():
        assert POPULATIONS[population].source in parameters
        for name in norms:
            assert f"| `{name}` |" in parameters
    for name in KEYS:
        assert f"| `{name.split('.')[1]}` |" in keys


def test_pages_of_the_guide_are_listed_and_have_a_title(capsys):
    assert cli.main(["docs"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == docs.names()
    asked = "theory accuracy rungs proof speed clinic limits numerics films outputs keys".split()
    assert set(asked) <= set(docs.names())
    for name in docs.names():
        assert len(docs.title(name)) > 10 and "<!--" not in docs.text(name)
    for name in re.findall(r"taichi-eye docs ([a-z]\w+)", GUIDE):
        assert name in docs.names()


def test_an_unknown_page_is_refused_in_one_line(capsys):
    assert cli.main(["docs", "acuracy"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    assert "acuracy" in said.err and "did you mean accuracy?" in said.err and "theory" in said.err


def test_package_data_and_packages_are_all_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    told = project["tool"]["setuptools"]
    there = {".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "taichi_eye").rglob("__init__.py")}
    assert set(told["packages"]) == there | {"taichi_eye.configs"}
    assert told["package-dir"]["taichi_eye.configs"] == "configs"
    data = told["package-data"]
    for package, folder in (
        ("taichi_eye.docs", ROOT / "taichi_eye/docs"),
        ("taichi_eye.configs", ROOT / "configs"),
        ("taichi_eye.page", ROOT / "taichi_eye/page"),
    ):
        ships = {path for pattern in data[package] for path in folder.glob(pattern)}
        code = {path for path in folder.rglob("*.py*")}
        assert ships == {path for path in folder.rglob("*") if path.is_file()} - code
    assert project["project"]["license"] == "MIT" and (ROOT / project["project"]["license-files"][0]).is_file()


def test_what_ships_is_found_by_name_and_a_file_here_goes_before(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert {"quick", "seed", "corvis_healthy"} <= set(shipped.named())
    assert load_scene("quick") == load_scene(ROOT / "configs" / "quick.toml")
    assert shipped.find("measured_deflection", shipped.HISTORIES).is_file()
    (tmp_path / "quick").write_text("[eye]\niop_mmhg = 33\n")
    assert load_scene("quick").eye.iop_mmhg == 33.0
    assert cli.main(["run", "qwick"]) == 2
    said = capsys.readouterr().err
    assert "qwick: no such file" in said and "seed" in said and len(said.splitlines()) == 1


@pytest.mark.parametrize("name", [None, "quick", "corvis_healthy"])
def test_a_printed_scene_has_every_key_and_runs_as_the_one_it_was_made_of(name, capsys, tmp_path):
    assert cli.main(["scene", *([name] if name else [])]) == 0
    printed = tmp_path / "my.toml"
    printed.write_text(capsys.readouterr().out)
    assert load_scene(printed) == load_scene(name)
    content = tomllib.loads(printed.read_text())
    assert {f"{section}.{key}" for section, keys in content.items() for key in keys} == KEYS
    for line in printed.read_text().splitlines():
        assert "#" in line or not line
    edited = load_scene(printed, ["eye.iop_mmhg=21", "cornea.thickness_mm=0.5"])
    assert edited == load_scene(name, ["eye.iop_mmhg=21", "cornea.thickness_mm=0.5"])


@pytest.mark.parametrize("number", range(len(fenced("python"))))
def test_python_of_the_readme_runs(number, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    brief = '"numerics.fidelity=cavity", "numerics.duration_ms=1", "camera.view=scheimpflug", "eye.iop_mmhg=20"'
    shown = {}
    exec(compile(fenced("python")[number].replace('"eye.iop_mmhg=20"', brief), "README.md", "exec"), shown)
    if "slopes" in shown:
        np.testing.assert_allclose(shown["slopes"], shown["points"] * (2, 0), atol=1e-9)
    else:
        assert (tmp_path / "renders" / "iop20" / "film.mp4").is_file() and capsys.readouterr().out


def test_the_newest_change_is_that_of_this_version():
    changes = (ROOT / ".github" / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\S+)$", changes, re.MULTILINE)[0] == taichi_eye.__version__
