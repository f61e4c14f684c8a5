"""Liquids, chambers and whole eyes that the tests of the solver share; compiling one takes seconds."""

import pytest
from eye_bench import run_eye
from liquid_bench import Liquid

from taichi_eye.cloud.packing import pack
from taichi_eye.eye.section import Section
from taichi_eye.units import MM


@pytest.fixture(scope="session")
def liquid_of():
    """Liquids by basis, each made once."""
    kept = {}

    def make(basis):
        if basis not in kept:
            kept[basis] = Liquid(basis)
        return kept[basis]

    return make


@pytest.fixture(scope="session")
def liquid(liquid_of):
    """The liquid on the default basis."""
    return liquid_of("quadratic")


@pytest.fixture(scope="session")
def chamber():
    """Packed clouds: chamber(spacing_mm, radius_mm, depth_mm or None for the limbus plane)."""
    kept = {}

    def cloud(spacing_mm=0.25, radius_mm=7.8, depth_mm=None):
        key = spacing_mm, radius_mm, depth_mm
        if key not in kept:
            cap = Section(radius_mm * MM, 5.8 * MM, 0.0).apex_z
            kept[key] = pack(Section(radius_mm * MM, 5.8 * MM, depth_mm * MM if depth_mm else cap), spacing_mm * MM)
        return kept[key]

    return cloud


@pytest.fixture(scope="session")
def whole_run():
    """The whole puff on the coarse eye."""
    return run_eye()
