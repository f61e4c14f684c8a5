"""What a finished run is doubted for, and what it is not."""

import numpy as np
import pytest

from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.ladder.trial import run_scene
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import case_of
from taichi_eye.solver.doubts import doubts, turning_points

T = np.linspace(0.0, 32.0, 1281)
HUMP = np.exp(-(((T - 15.0) / 6.0) ** 2))


def said(*overrides, **columns):
    case = case_of(load_scene(None, overrides))
    traces = {
        "time_ms": T,
        "apex_displacement_mm": 0.9 * HUMP,
        "puff_apex_kpa": case.eye.puff.pressure_at_apex(T * 1e-3) * 1e-3,
        "puff_work_uj": 20.0 * HUMP,
        "energy_error_uj": 0.01 * HUMP,
        "chamber_volume_error": 3e-4 * HUMP,
    }
    return doubts(case, {**traces, **columns})


def test_a_sound_run_is_not_doubted():
    assert said() == []
    assert said("numerics.spacing_mm=0.25", "numerics.sound_speed_m_s=40", chamber_volume_error=1.3e-3 * HUMP) == []


def test_an_energy_balance_is_told_in_a_sentence_however_far_off():
    (sentence,) = said(energy_error_uj=1.0 * HUMP)
    assert "5.0 % of the puff's work" in sentence and "numerics.spacing_mm" in sentence
    (sentence,) = said(energy_error_uj=3e7 * HUMP, puff_work_uj=1e-9 * HUMP)
    assert "more than all work of the puff" in sentence and "%" not in sentence
    assert "slip" in said("numerics.wall_condition=no_slip", energy_error_uj=1.0 * HUMP)[0]


def test_compression_is_judged_by_what_it_lowers_the_apex_by():
    # 145 mm^3 of liquid: 0.87 mm^3 spread over 106 mm^2 is 8 um in the mean, 16 at the apex: 1.8 % of 0.9 mm
    assert said(chamber_volume_error=6e-3 * HUMP) == []
    (sentence,) = said(chamber_volume_error=8e-3 * HUMP)
    assert "numerics.mean_sound_speed_m_s" in sentence and "22 um of its 900 um" in sentence
    shallow = {"apex_displacement_mm": 0.03 * HUMP, "chamber_volume_error": 3e-4 * HUMP}
    assert "gave way" in said(**shallow)[0]
    assert said("chamber.sealed=false", **shallow) == said("numerics.fidelity=cavity", **shallow) == []


def test_the_sound_speed_that_is_recommended_takes_the_doubt_away():
    keys = ["cornea.limbus_radius_mm=2", "chamber.depth_mm=3", "numerics.spacing_mm=0.25", "numerics.duration_ms=16"]
    scene = load_scene(None, [*keys, "numerics.sound_speed_m_s=40"])
    soft = run_scene(scene)
    (sentence,) = doubts(case_of(scene), soft.traces)
    speed = float(sentence.split(" to ")[1].split(",")[0])
    stiff_scene = scene.but({"numerics.mean_sound_speed_m_s": speed})
    stiff = run_scene(stiff_scene)
    assert doubts(case_of(stiff_scene), stiff.traces) == []
    exact = run_scene(scene.but({"numerics.mean_sound_speed_m_s": 4.0 * speed}))
    assert soft.apex.peak > 1.1 * exact.apex.peak and stiff.apex.peak == pytest.approx(exact.apex.peak, rel=0.02)


def test_a_spot_narrower_than_the_elements_is_told_and_its_force_is_whole():
    spot = ["puff.radial_profile=gaussian", "puff.width_mm=0.05", "numerics.fidelity=cavity", "puff.peak_kpa=20"]
    keys = [*spot, "numerics.duration_ms=16"]
    coarse, fine = (load_scene(None, [*keys, f"numerics.spacing_mm={h}"]) for h in (0.25, 0.04))
    assert "0.05 mm wide" in doubts(case_of(coarse), run_scene(coarse).traces)[0]
    runs = [simulation_of(scene) for scene in (coarse, fine)]
    for run in runs:
        run.run()
    assert doubts(case_of(fine), runs[1].traces) == []
    # the dents differ by their widths; the volumes that they displace do not
    volumes = [run.traces["chamber_volume_error"].min() for run in runs]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.02)
    assert runs[0].traces["apex_displacement_mm"].max() < 2.0 * runs[1].traces["apex_displacement_mm"].max()


def test_a_ring_is_told_and_a_ripple_is_not():
    ring = 0.1 * np.sin(2.0 * np.pi * T / 1.7) * (T > 8.0)
    (sentence,) = said(apex_displacement_mm=0.9 * HUMP + ring)
    assert "rings" in sentence and "cornea.viscoelastic_share" in sentence
    assert said(apex_displacement_mm=0.9 * HUMP + 0.2 * ring) == []


def test_turning_points():
    values = np.array([0.0, 0.2, 1.0, 0.95, 1.1, 0.3, 0.5, 0.1, 0.15, 0.7])
    assert turning_points(values, 0.3) == [0, 4, 7, 9]
    assert turning_points(values, 0.1) == [0, 4, 5, 6, 7, 9]
    assert turning_points(np.zeros(5), 0.1) == [0]
    assert turning_points(-values, 0.3) == [0, 4, 7, 9]


@pytest.mark.parametrize("rung", ["cavity", "mfpm"])
def test_a_pulse_shorter_than_a_step_acts_with_its_whole_impulse(rung):
    peaks, unseen = [], []
    for duration, peak in ((0.001, 100.0), (0.0371, 100.0 * 0.001 / 0.0371)):
        scene = load_scene(
            None,
            [
                f"numerics.fidelity={rung}",
                "numerics.spacing_mm=0.4",
                "numerics.sound_speed_m_s=20",
                "numerics.duration_ms=1.5",
                f"puff.duration_ms={duration}",
                f"puff.peak_kpa={peak}",
            ],
        )
        trial = run_scene(scene)
        peaks.append(np.abs(trial.traces["apex_displacement_mm"]).max())
        unseen.append(any("whole impulse" in doubt for doubt in doubts(case_of(scene), trial.traces)))
    assert peaks[0] == pytest.approx(peaks[1], rel=0.03) and peaks[0] > 1e-6
    assert unseen == [True, True]
