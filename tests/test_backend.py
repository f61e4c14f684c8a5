"""Starts of the kernel language: what is there after another one, after somebody else's, and after a fork."""

import pytest
from processes import python

SCENE = """
import taichi_eye
from taichi_eye import backend
from taichi_eye.lang import ti

KEYS = ["numerics.fidelity=%s", "numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "numerics.duration_ms=0.5"]
scene = taichi_eye.load_scene(None, KEYS)
made = lambda: taichi_eye.simulation_of(scene)
def refused(what):
    try:
        what()
    except backend.BackendError as error:
        print(error)
    else:
        print("not refused")
"""


def run(tmp_path, fidelity, text):
    script = tmp_path / "script.py"
    script.write_text(SCENE % fidelity + text)
    done = python(script)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("fidelity", ["mfpm", "cavity"])
def test_a_simulation_of_an_earlier_start_is_refused_and_a_new_one_gives_the_same_bits(tmp_path, fidelity):
    said = run(
        tmp_path,
        fidelity,
        "old = made()\nold.run()\n"
        "unrun = made()\n"
        "before = old.traces['apex_displacement_mm'].copy()\n"
        "taichi_eye.init(threads=1, debug=False)\n"
        "refused(unrun.run)\n"
        "new = made()\nnew.run()\n"
        "print((new.traces['apex_displacement_mm'] == before).all(), len(before) > 1)\n",
    )
    assert "started afresh" in said[0] and said[1:] == ["True True"]


def test_somebody_elses_start_is_noticed_and_an_own_one_mends_it(tmp_path):
    said = run(
        tmp_path,
        "cavity",
        "old = made()\n"
        "ti.init(arch=ti.cpu)\n"
        "refused(old.run)\n"
        "refused(made)\n"
        "taichi_eye.init()\n"
        "new = made()\nnew.run()\n"
        "print(new.traces['time_ms'][-1] > 0.4)\n",
    )
    said = [line for line in said if "Starting on arch" not in line]
    assert "make it anew" in said[0] and "taichi_eye.init()" in said[1] and said[2:] == ["True"]


def test_a_start_before_the_first_simulation_is_not_taken_over(tmp_path):
    said = run(tmp_path, "cavity", "ti.init(arch=ti.cpu)\nx = ti.field(ti.i32, 1)\nrefused(made)\nprint(x[0])\n")
    said = [line for line in said if "Starting on arch" not in line]
    assert "taichi_eye.init()" in said[0] and said[1:] == ["0"]


def test_after_a_reset_the_language_is_started_as_last_time(tmp_path):
    said = run(
        tmp_path,
        "cavity",
        "taichi_eye.init(precision='f32')\nti.reset()\nprint(backend.real() == ti.f32, backend.generation())\n",
    )
    assert said == ["True 2"]


def test_a_forked_worker_is_refused_at_once_and_the_parent_goes_on(tmp_path):
    said = run(
        tmp_path,
        "cavity",
        "import multiprocessing\n"
        "one = made()\none.run()\n"
        "def work(number):\n"
        "    try:\n        made()\n"
        "    except backend.BackendError as error:\n        return str(error)\n"
        "with multiprocessing.get_context('fork').Pool(2) as pool:\n"
        "    answers = pool.map_async(work, range(3)).get(60)\n"
        "print(len(answers), len(set(answers)), answers[0])\n"
        "two = made()\ntwo.run()\nprint((two.traces['time_ms'] == one.traces['time_ms']).all())\n",
    )
    assert said[0].startswith("3 1 ") and "spawn" in said[0] and said[1:] == ["True"]


def test_spawned_workers_do_what_the_message_says(tmp_path):
    said = run(
        tmp_path,
        "cavity",
        "import multiprocessing\n"
        "def work(number):\n"
        "    one = made()\n    one.run()\n    return float(one.traces['apex_displacement_mm'][-1])\n"
        "if __name__ == '__main__':\n"
        "    here = work(0)\n"
        "    with multiprocessing.get_context('spawn').Pool(1) as pool:\n"
        "        print(pool.map_async(work, range(1)).get(120) == [here])\n",
    )
    assert said == ["True"]


def test_a_worker_forked_before_any_start_may_make_its_own(tmp_path):
    said = run(
        tmp_path,
        "cavity",
        "import multiprocessing\n"
        "def work(number):\n"
        "    one = made()\n    one.run()\n    return float(one.traces['apex_displacement_mm'][-1])\n"
        "with multiprocessing.get_context('fork').Pool(1) as pool:\n"
        "    there = pool.map_async(work, range(1)).get(120)\n"
        "print(there == [work(0)])\n",
    )
    assert said == ["True"]
