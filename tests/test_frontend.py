"""Kernels as users write them, also by the short ways of Taichi's front end: in classes, in scripts, and broken."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.lang import NAME, ti
from taichi_eye.mfpm import neighbours
from taichi_eye.solver.cornea import Cornea

NAME_ERROR = {"taichi": "TaichiNameError", "quadrants": "QuadrantsNameError"}[NAME]


@ti.data_oriented
class Counter:
    def __init__(self):
        self.value = ti.field(ti.i32, ())

    @ti.func
    def increased(self, by):
        return self.value[None] + by

    @ti.kernel
    def count(self, by: int) -> int:
        self.value[None] = self.increased(by)
        return self.value[None]


@ti.kernel
def broken() -> int:
    return never_heard_of  # noqa: F821


@pytest.mark.parametrize(
    "function",
    [neighbours.NeighbourLists.search, neighbours.place_of, Cornea.setup, backend.init],
    ids=lambda function: function.__name__,
)
@pytest.mark.skipif(NAME != "taichi", reason="only Taichi's front end is shortened")
def test_source_lines_are_those_of_inspect(function):
    from taichi_eye import frontend

    function = inspect.unwrap(getattr(function, "fn", function))
    assert frontend._source_lines(function) == inspect.getsourcelines(function)


def test_kernels_in_a_class_know_their_object():
    backend.real()
    one, other = Counter(), Counter()
    assert [one.count(2), one.count(3), other.count(4)] == [2, 5, 4]


def test_a_script_may_have_kernels_of_its_own(tmp_path):
    script = tmp_path / "mine.py"
    script.write_text(
        "from taichi_eye import backend\nfrom taichi_eye.lang import ti\nbackend.init()\n\n"
        "@ti.kernel\ndef twice(x: int) -> int:\n    return 2 * x\n\nprint(twice(21))\n"
    )
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    assert done.stdout.split()[-1:] == ["42"], done.stderr


def test_a_compile_error_says_file_line_and_function():
    backend.real()
    line = inspect.getsourcelines(broken)[1] + 2
    with pytest.raises(getattr(ti, NAME_ERROR), match=f'test_frontend.py", line {line}, in broken'):
        broken()


@ti.kernel
def add(number: int, to: ti.types.ndarray()):
    for i in range(to.shape[0]):
        to[i] += number


def test_a_launcher_does_what_the_kernel_does():
    backend.real()
    launch, x, y, whole = backend.launcher(add), np.zeros(5), np.zeros(9), np.zeros(4, dtype=np.int32)
    for number, to in ((1, x), (2, x), (3, y), (4, whole), (5, x), (6, x), (-7, y), (8, whole)):
        launch(number, to)
    assert [x.tolist(), y.tolist(), whole.tolist()] == [[14.0] * 5, [-4.0] * 9, [12] * 4]
    for _ in range(3):
        with pytest.raises(ValueError, match="[Cc]ontiguous"):
            launch(1, np.zeros(8)[::2])
    launch(1, x)
    assert x.tolist() == [15.0] * 5
