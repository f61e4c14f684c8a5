"""What pip is told: each Python gets one kernel language, the one that has a wheel for it."""

import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from taichi_eye.lang import NAMES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def languages(python):
    """Requirements on a kernel language under a version of Python."""
    wanted = [Requirement(line) for line in PROJECT["dependencies"]]
    there = {"python_version": python, "python_full_version": f"{python}.0"}
    return [r for r in wanted if r.name in NAMES and (r.marker is None or r.marker.evaluate(there))]


@pytest.mark.parametrize("python", ["3.10", "3.11", "3.12", "3.13"])
def test_pythons_with_a_wheel_of_taichi_get_that_and_no_other(python):
    (only,) = languages(python)
    assert only.name == "taichi" and "1.7.4" in only.specifier


def test_python_without_a_wheel_of_taichi_gets_its_twin():
    (only,) = languages("3.14")
    assert only.name == "quadrants"
    assert {version: version in only.specifier for version in ("1.3.3", "1.4.0", "1.9", "2.0")} == {
        "1.3.3": False,  # no wheel for 3.14
        "1.4.0": True,
        "1.9": True,
        "2.0": False,
    }


def test_the_pythons_allowed_are_those_with_a_language():
    allowed = SpecifierSet(PROJECT["requires-python"])
    assert [python for python in ("3.9", "3.10", "3.13", "3.14", "3.15") if f"{python}.0" in allowed] == [
        "3.10",
        "3.13",
        "3.14",
    ]
