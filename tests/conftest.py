"""One Taichi for the whole session: CPU, double precision."""

import pytest

from taichi_eye import backend


@pytest.fixture(scope="session", autouse=True)
def taichi():
    backend.init("cpu", "f64")
