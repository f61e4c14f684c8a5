"""A puff whose width follows the dent: the load in the step is that of the law at the wall's own shape."""

import numpy as np
import pytest

from taichi_eye import backend
from taichi_eye.eye import jet
from taichi_eye.eye.eye import eye_of
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.scene import load_scene

EYE = (
    "numerics.spacing_mm=0.35",
    "numerics.sound_speed_m_s=20",
    "puff.radial_profile=gaussian",
    "puff.width_mm=1.7",
    "puff.dent_feedback=0.5",
    "numerics.duration_ms=13",
)


@pytest.fixture(scope="module", autouse=True)
def cpu():
    backend.init("cpu", "f64")


@pytest.mark.parametrize("rung", ["cavity", "mfpm"])
def test_the_load_is_the_laws_at_the_shape_of_the_moment(rung):
    scene = load_scene(None, (*EYE, f"numerics.fidelity={rung}"))
    eye, run, seen = eye_of(scene), simulation_of(scene), []

    def keep(run, frame):
        place = run.cornea.place.to_numpy()[: run.wall_count]
        seen.append((run.time_ms, place, run.cornea.load_shape.to_numpy()[: run.wall_count]))

    run.run(on_frame=keep)
    rest = seen[0][1][:, 0]
    curvatures = []
    for _, place, found in seen[1:]:
        curvatures.append(jet.central_curvature(place, rest))
        # the load is that of the step that led there
        expected = eye.puff.on_rings(rest, curvatures[-1])
        np.testing.assert_allclose(found, expected, atol=2e-3)
    assert curvatures[0] == pytest.approx(1.0 / 7.8e-3, rel=0.01) and min(curvatures) < -20.0
    assert seen[-1][2][5] > seen[1][2][5] + 0.05


def test_a_dent_that_widens_the_jet_is_deeper_and_its_work_closes():
    runs = [
        simulation_of(load_scene(None, (*EYE[:-2], "numerics.fidelity=cavity", f"puff.dent_feedback={c}"))).run()
        for c in (0.0, 0.3, 0.6)
    ]
    work = [traces["puff_work_uj"].max() for traces in runs]
    for traces, most in zip(runs, work):
        assert np.abs(traces["energy_error_uj"]).max() < 2e-3 * most
    # narrower than on a flat wall at first, wider in the dent: less is moved early
    early = [traces["apex_displacement_mm"][traces["time_ms"] < 7.0][-1] for traces in runs]
    assert early[0] > early[1] > early[2]
