"""A run that is saved and taken up again goes on to the same bits, on every rung."""

import numpy as np
import pytest

from taichi_eye.errors import RunStopped
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.rungs import RUNGS
from taichi_eye.scene import load_scene
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.figures import COLUMNS
from taichi_eye.solver.simulation import Simulation

CHEAP = ("numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "numerics.duration_ms=14", "puff.duration_ms=18")
SHELL = (
    "cornea.flexural_modulus_mpa=0.1",
    "cornea.viscoelastic_share=0.3",
    "chamber.compliance_mm3_mmhg=0.2",
    "chamber.globe_delay_ms=0.5",
)
SCENES = {
    "membrane": ("puff.peak_kpa=3",),
    "cavity": SHELL,
    "added_mass": SHELL,
    "mfpm": SHELL,
    "cubic": ("numerics.basis=cubic",),
    "open": ("chamber.sealed=false", "puff.peak_kpa=3"),
}


def scene_of(name):
    fidelity = name if name in RUNGS else "mfpm"
    return load_scene(None, (*CHEAP, f"numerics.fidelity={fidelity}", *SCENES[name]))


def assert_same(one, other):
    assert list(one) == list(COLUMNS) == list(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.parametrize("name", SCENES)
def test_a_run_taken_up_goes_on_to_the_same_bits(name):
    scene, rng = scene_of(name), np.random.default_rng(len(name))
    whole, states, seen = simulation_of(scene), {}, []
    chosen = {int(k) for k in rng.integers(0, 60, 2)} | {0}

    def keep(simulation, frame):
        place, velocity, pressure, count = simulation.liquid()
        seen.append((frame, *(field.to_numpy()[:count].tobytes() for field in (place, velocity, pressure))))
        if frame in chosen:
            states[frame] = simulation.state()

    traces = whole.run(on_frame=keep)
    walls = whole.cornea.place.to_numpy()
    del whole
    for frame, state in states.items():
        other, later = simulation_of(scene), seen[: frame + 1]
        kept, seen = seen, later
        other.restore(state)
        assert_same(other.traces, {column: values[: len(state["figures"])] for column, values in traces.items()})
        assert_same(other.run(on_frame=keep), traces)
        assert seen == kept
        assert other.cornea.place.to_numpy().tobytes() == walls.tobytes()
        del other


def test_a_batch_taken_up_goes_on_to_the_same_bits():
    scenes = [scene_of("mfpm"), scene_of("open"), load_scene(None, (*CHEAP, "cornea.prestrain=0.002"))]
    whole, states = Batch(scenes), []
    outcomes = whole.run(lambda batch: states.append(batch.state()) if batch.sample in (7, 390) else None)
    assert outcomes[2].stop is not None
    del whole
    for state in states:
        other = Batch(scenes)
        other.restore(state)
        for one, two in zip(other.run(), outcomes):
            assert_same(one.traces, two.traces)
            assert (one.stop and one.stop.args) == (two.stop and two.stop.args)
        del other


def test_a_state_survives_a_file(tmp_path):
    scene, states = scene_of("mfpm"), []
    traces = Simulation(scene).run(on_frame=lambda eye, frame: states.append(eye.state()) if frame == 20 else None)
    np.savez(tmp_path / "state.npz", allow_pickle=False, **states[0])
    with np.load(tmp_path / "state.npz", allow_pickle=False) as read:
        eye = Simulation(scene)
        eye.restore(dict(read))
    assert_same(eye.run(), traces)


@pytest.mark.parametrize("name", ["cavity", "mfpm"])
def test_a_state_of_another_scene_is_refused(name):
    states = []
    simulation_of(scene_of(name)).run(on_frame=lambda eye, frame: states.append(eye.state()) if frame == 9 else None)
    with pytest.raises(ValueError):
        simulation_of(load_scene(None, (*CHEAP, f"numerics.fidelity={name}", "numerics.duration_ms=1"))).restore(
            states[0]
        )


@pytest.mark.parametrize("name", ["membrane", "cavity", "added_mass", "mfpm"])
def test_a_run_that_is_stopped_ends_before_what_stopped_it(name):
    # weak tissue under a strong puff: slack, or at the back of the chamber
    keys = ("cornea.prestrain=0.002", "puff.peak_kpa=30", f"numerics.fidelity={name}")
    simulation = simulation_of(load_scene(None, (*CHEAP, *keys)))
    with pytest.raises(RunStopped) as stopped:
        simulation.run()
    times = simulation.traces["time_ms"]
    assert stopped.value.time_ms == pytest.approx(times[-1] + simulation.clock.sample_ms)
    for column in simulation.traces.values():
        assert np.isfinite(column).all()
