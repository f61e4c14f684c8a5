"""Stability maps: scenes set beyond their limits, causes read off stops, predictions exact where they can be, the
page."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from taichi_eye.errors import SceneError
from taichi_eye.proof import stability
from taichi_eye.proof.maps import cloud, coupling, spectrum, time_step
from taichi_eye.proof.maps.result import Map
from taichi_eye.proof.maps.runs import cause, cloud_for, run, scene_with, unguarded
from taichi_eye.solver import guards
from taichi_eye.solver.simulation import Simulation

TINY = {"numerics.spacing_mm": 0.5, "numerics.duration_ms": 0.5}


def test_keys_of_the_numerics_are_set_beyond_what_a_scene_file_may_hold():
    scene = scene_with({"numerics.cfl": 3.0, "cornea.density_kg_m3": 1.0, "numerics.spacing_mm": 0.4})
    assert scene.numerics.cfl == 3.0 and scene.cornea.density_kg_m3 == 1.0 and scene.numerics.spacing_mm == 0.4
    with pytest.raises(SceneError):
        scene_with({"eye.iop_mmhg": -1.0})


def test_a_stop_is_told_by_its_cause_and_lets_its_fields_go():
    each = run({**TINY, "numerics.coupling_iterations_max": 1})
    assert cause(each) == "converge" and each.stop.__traceback__ is None
    assert cause(run(TINY)) == ""


def test_the_guards_are_back_after_an_unguarded_run():
    before = guards.check
    with unguarded():
        each = run({**TINY, "numerics.coupling_iterations_max": 1})
    assert each.stop is None and guards.check is before


def test_the_limit_of_a_damped_leapfrog_is_where_its_multiplier_leaves_the_circle():
    w, d = 3.0e5, 2.0e5
    least, _ = time_step.largest_steps(w, d)

    def radius(dt):
        a, s = 1.0 - d * dt, w * dt
        return np.abs(np.linalg.eigvals(np.array([[a, -s], [s * a, a - s * s]]))).max()

    assert radius(0.999 * least) < 1.0 < radius(1.001 * least)


def test_the_limit_of_a_mode_damped_in_one_variable():
    w, d = 3.0e5, 2.0e5
    _, largest = time_step.largest_steps(w, d)

    def radius(dt):
        s, a = w * dt, 1.0 - d * dt
        return np.abs(np.linalg.eigvals(np.array([[a, -s], [s * a, 1.0 - s * s]]))).max()

    assert radius(0.999 * largest) < 1.0 + 1e-12 < radius(1.001 * largest)


def test_measured_radii_scale_with_sound_speed_and_dissipation():
    found = []
    for c, alpha in ((40.0, 0.5), (80.0, 0.25)):
        scene = scene_with({**TINY, "numerics.sound_speed_m_s": c, "numerics.dissipation": alpha})
        found.append(time_step.Radii(Simulation(scene, cloud_for(scene))).measure())
    (w, d), (w_fast, d_fast) = found
    assert w_fast == pytest.approx(2.0 * w, rel=1e-9)
    assert d_fast == pytest.approx(d, rel=1e-9)
    assert 1.0 < w / (40.0 / 0.5e-3) < 2.5


def test_a_sweep_contracts_as_the_square_of_the_step_and_inversely_as_the_mass_of_the_wall():
    light = {**TINY, "cornea.density_kg_m3": 100.0}
    dt = 2e-6
    q = coupling.contraction(light, dt)
    assert coupling.contraction(light, 0.5 * dt) == pytest.approx(0.25 * q, rel=0.01)
    assert coupling.contraction({**light, "cornea.density_kg_m3": 200.0}, dt) == pytest.approx(0.5 * q, rel=0.01)


def test_noise_changes_a_twin_by_its_own_size_and_frozen_nodes_stay():
    keys = {**TINY, "numerics.spacing_mm": 0.4}
    plain, _, volume, _, _, _ = cloud._run(keys, "all nodes frozen")
    noisy, health, _, _, _, _ = cloud._run(keys, "all nodes frozen", (0.0,))
    apart = cloud._norms(noisy, plain, volume, scene_with(keys))
    assert apart[0] == 0.0 and 0.0 < apart[-1] < apart[1]
    assert np.ptp(health[:, 0]) == 0.0


def test_jitter_moves_inner_nodes_only_and_a_gap_takes_one():
    packed = cloud_for(scene_with(TINY))
    moved, gap = spectrum.jittered(packed, 0.2), spectrum.without_node_under_wall(packed)
    boundary = packed.kind != spectrum.FREE
    assert np.array_equal(moved.points[boundary], packed.points[boundary])
    step = np.abs(moved.points - packed.points)[~boundary]
    assert 0.0 < step.max() <= 0.2 * packed.spacing * 1.0000001
    assert gap.count == packed.count - 1


def test_the_page_holds_every_map_and_a_silent_failure_decides_the_verdict(tmp_path, monkeypatch):
    def sound(say):
        return Map("sound", Figure(), ["all < well"], ("a",), [("1",)], {"value": np.float64(2.0)})

    def broken(say):
        return Map("broken", Figure(), ["not well"], broken=["a run went on"])

    monkeypatch.setattr(stability, "PARTS", {"sound": sound, "broken": broken})
    heard = []
    assert stability.report(["sound"], tmp_path / "one", say=heard.append)
    assert not stability.report([], tmp_path / "two", tmp_path / "maps.json", say=heard.append)
    page = (tmp_path / "two" / "stability.html").read_text()
    assert "all &lt; well" in page and "a run went on" in page
    assert {p.name for p in (tmp_path / "two").iterdir()} == {
        "stability.html",
        "stability.md",
        "sound.png",
        "broken.png",
    }
    figures = json.loads((tmp_path / "maps.json").read_text())
    assert figures["sound"]["value"] == 2.0 and figures["broken"]["failed_in_silence"] == ["a run went on"]
