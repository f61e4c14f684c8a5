"""One Taichi for the whole session: CPU, double precision. Slow files first, so that two processes end together."""

from pathlib import Path

import pytest

from taichi_eye import backend

SLOW = (
    "test_studies.py",
    "test_resume.py",
    "test_film_studies.py",
    "test_cli.py",
    "test_sweep.py",
    "test_reduced.py",
    "test_batch.py",
    "test_guards.py",
    "test_simulation.py",
    "test_proof.py",
    "test_state.py",
    "test_fit.py",
    "test_pipeline.py",
)


def pytest_collection_modifyitems(items):
    """SLOW files in their order, then the rest as collected."""
    rank = {name: k for k, name in enumerate(SLOW)}
    items.sort(key=lambda item: rank.get(Path(item.fspath).name, len(SLOW)))


@pytest.fixture(scope="session", autouse=True)
def taichi():
    backend.init("cpu", "f64")
