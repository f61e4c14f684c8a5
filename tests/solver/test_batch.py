"""Many eyes at once: each as if it were alone."""

import json
import subprocess
import sys

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.errors import RunStopped
from taichi_eye.scene import load_scene
from taichi_eye.solver import coupling
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.case import clouds_of
from taichi_eye.solver.simulation import Simulation

BASE = "numerics.spacing_mm=0.35", "numerics.sound_speed_m_s=40", "puff.duration_ms=8"
# node counts, shapes, walls, liquids, loads, clocks and ways of coupling: nothing alike
EYES = [
    ("numerics.duration_ms=4",),
    (
        "numerics.duration_ms=3",
        "eye.iop_mmhg=25",
        "cornea.thickness_mm=0.65",
        "puff.peak_kpa=14",
        "puff.time_course=corvis",
    ),
    (
        "numerics.duration_ms=3.5",
        "numerics.spacing_mm=0.25",
        "cornea.radius_mm=7.1",
        "cornea.limbus_radius_mm=5.4",
        "cornea.density_kg_m3=1200",
        "numerics.cfl=0.5",
    ),
    (
        "numerics.duration_ms=2",
        "chamber.depth_mm=3.4",
        "chamber.lens_radius_mm=10",
        "chamber.lens_height_mm=0.6",
        "aqueous.viscosity_mpa_s=5",
        "numerics.sound_speed_m_s=25",
        "numerics.coupling=loose",
    ),
    (
        "numerics.duration_ms=3",
        "chamber.sealed=false",
        "puff.peak_kpa=3",
        "aqueous.density_kg_m3=1030",
        "camera.frame_interval_ms=0.3",
    ),
    (
        "numerics.duration_ms=3",
        "cornea.flexural_modulus_mpa=0.3",
        "cornea.shear_modulus_kpa=20",
        "cornea.shear_viscosity_ms=0.2",
        "chamber.compliance_mm3_mmhg=1",
        "chamber.globe_law=friedenwald",
        "puff.dent_feedback=0.4",
        "numerics.dissipation=0.7",
        "numerics.wall_condition=no_slip",
        "numerics.relaxation=fixed",
        "puff.radial_profile=gaussian",
    ),
]
SLACK = ("numerics.duration_ms=8", "eye.iop_mmhg=1")


def scene(overrides):
    return load_scene(None, (*BASE, *overrides))


def assert_same(traces, others):
    assert traces.keys() == others.keys()
    for column, values in traces.items():
        np.testing.assert_array_equal(values, others[column], err_msg=column)


@pytest.fixture(scope="module")
def alone():
    """Each eye run by itself: traces, steps, rebuilds and the limit of the last step."""
    backend.init("cpu", "f64")
    found = []
    for overrides in EYES:
        eye = Simulation(scene(overrides))
        found.append((eye.run(), eye.steps, eye.rebuilds, eye.step_limit))
    return found


def test_a_batch_of_unlike_eyes_gives_what_each_gives_alone_bit_for_bit(alone):
    batch = Batch([scene(overrides) for overrides in EYES])
    assert len({cloud.count for cloud in batch.clouds}) > 2
    outcomes = batch.run()
    for eye, (traces, steps, rebuilds, limit) in enumerate(alone):
        assert outcomes[eye].stop is None
        assert_same(outcomes[eye].traces, traces)
        assert (batch.steps[eye], batch.rebuilds[eye], batch.step_limit[eye]) == (steps, rebuilds, limit)
    assert batch.rebuilds.max() > 0


def test_the_order_of_eyes_does_not_matter(alone):
    order = [4, 1, 5, 0, 3, 2]
    for eye, outcome in zip(order, Batch([scene(EYES[k]) for k in order]).run()):
        assert_same(outcome.traces, alone[eye][0])


def test_loops_over_all_nodes_agree_with_an_eye_to_a_thread_to_rounding(alone, monkeypatch):
    # the way of a GPU: eyes that need fewer steps wait
    monkeypatch.setattr(coupling, "SERIAL_NODES", 0)
    monkeypatch.setattr(backend, "threads", lambda: len(EYES) + 1)
    for outcome, (traces, *_) in zip(Batch([scene(overrides) for overrides in EYES]).run(), alone):
        for column, values in traces.items():
            np.testing.assert_allclose(
                outcome.traces[column], values, rtol=1e-7, atol=1e-7 * np.abs(values).max() + 1e-12, err_msg=column
            )


def test_a_slack_eye_stops_alone(alone):
    with pytest.raises(RunStopped) as caught:
        eye = Simulation(scene(SLACK))
        eye.run()
    outcomes = Batch([scene(EYES[0]), scene(SLACK), scene(EYES[1])]).run()
    assert str(outcomes[1].stop) == str(caught.value) and "slack" in outcomes[1].stop.what
    assert_same(outcomes[1].traces, eye.traces)
    assert 0 < outcomes[1].traces["time_ms"][-1] < outcomes[1].stop.time_ms < 8.0
    for outcome, number in ((outcomes[0], 0), (outcomes[2], 1)):
        assert outcome.stop is None
        assert_same(outcome.traces, alone[number][0])


def test_what_ran_before_in_the_same_fields_leaves_no_trace(alone):
    Batch([scene((*EYES[5], "numerics.duration_ms=1")) for _ in EYES]).run()
    assert_same(Batch([scene(overrides) for overrides in EYES]).run()[0].traces, alone[0][0])


def test_eyes_of_one_chamber_share_a_packed_cloud():
    one, other, third = clouds_of(
        [scene(()), scene(("eye.iop_mmhg=22", "cornea.thickness_mm=0.6")), scene(("cornea.radius_mm=7.2",))]
    )
    assert one is other and one is not third


def test_eyes_of_different_bases_do_not_stand_side_by_side():
    with pytest.raises(ValueError, match="numerics.basis"):
        Batch([scene(()), scene(("numerics.basis=cubic",))])


def test_single_precision_gives_the_same_histories_to_its_accuracy(alone):
    program = (
        "import json; from taichi_eye import backend, load_scene; backend.init(precision='f32')\n"
        "from taichi_eye.solver.batch import Batch\n"
        f"out = Batch([load_scene(None, keys) for keys in {[[*BASE, *EYES[k]] for k in (0, 1)]}]).run()\n"
        "print(json.dumps([eye.traces['apex_displacement_mm'].tolist() for eye in out]))"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    for history, number in zip(json.loads(said.stdout.splitlines()[-1]), (0, 1)):
        exact = alone[number][0]["apex_displacement_mm"]
        np.testing.assert_allclose(history, exact, rtol=0, atol=1e-4 * np.abs(exact).max())
