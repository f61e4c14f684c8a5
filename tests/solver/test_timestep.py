"""Limits of the time step from made-up figures."""

import math

import numpy as np
import pytest

from taichi_eye.errors import SceneError
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import case_of
from taichi_eye.solver.timestep import NAMES, StepLimits, limits, refuse_endless, rest_limits, stable_step

FIGURES = {
    "smallest_gap": 0.8e-4,
    "membrane_step": 2e-6,
    "membrane_speed": 25.0,
    "transverse_speed": 5.0,
    "pair_weight": 1e7,
}


def every(*overrides, **figures):
    return limits({**FIGURES, **figures}, case_of(load_scene(None, overrides)))


def ratio(name, one, other):
    return other[name] / one[name]


def test_acoustic_limit_goes_as_the_gap_over_the_sound_speed():
    calm = "numerics.dissipation=0"
    base = every(calm)
    assert ratio("acoustic", base, every(calm, smallest_gap=0.4e-4)) == pytest.approx(0.5)
    assert ratio("acoustic", base, every(calm, "numerics.sound_speed_m_s=160")) == pytest.approx(0.5)
    # leapfrog on waves of up to 1.6 c/h, nodes 0.8 h apart: below 2/w
    assert base["acoustic"] <= 2.0 / (1.6 * 80.0 / 1e-4) * 1.1


def test_dissipation_shortens_the_acoustic_limit():
    shares = [every(f"numerics.dissipation={alpha}")["acoustic"] for alpha in (0.0, 0.3, 0.5, 1.0)]
    assert shares == sorted(shares, reverse=True) and shares[-1] < 0.5 * shares[0]


@pytest.mark.parametrize("alpha", [0.5, 1.0])
def test_dissipation_limit_goes_as_the_square_of_the_gap_where_nodes_are_crushed(alpha):
    # the dissipation's coefficient alpha c h keeps the spacing at rest, its operator grows as the gap to the -2
    crushed = [every(f"numerics.dissipation={alpha}", smallest_gap=gap)["acoustic"] for gap in (1e-6, 0.5e-6)]
    assert crushed[1] / crushed[0] == pytest.approx(0.25, rel=0.05)


def test_viscous_limit():
    assert every("aqueous.viscosity_mpa_s=0")["viscous"] == math.inf
    base = every("aqueous.viscosity_mpa_s=10")
    assert base["viscous"] == pytest.approx(FIGURES["smallest_gap"] ** 2 * 1000.0 / (4 * 0.01))
    assert ratio("viscous", base, every("aqueous.viscosity_mpa_s=20")) == pytest.approx(0.5)
    assert ratio("viscous", base, every("aqueous.viscosity_mpa_s=10", smallest_gap=0.4e-4)) == pytest.approx(0.25)


def test_membrane_limits_are_the_time_a_wave_takes_along_the_shortest_element():
    base = every()
    assert base["membrane in plane"] == FIGURES["membrane_step"]
    assert base["membrane transverse"] == pytest.approx(2e-6 * 25.0 / 5.0)
    assert every(transverse_speed=0.0)["membrane transverse"] > 1.0


def test_coupling_limit_goes_as_the_root_of_wall_mass_over_added_mass():
    base = every()
    assert ratio("coupling", base, every("cornea.thickness_mm=0.1375", "cornea.prestrain=auto")) == pytest.approx(0.5)
    assert ratio("coupling", base, every("cornea.density_kg_m3=4200")) == pytest.approx(2.0)
    assert ratio("coupling", base, every("aqueous.density_kg_m3=4000")) == pytest.approx(0.5)
    assert ratio("coupling", base, every("numerics.sound_speed_m_s=160")) == pytest.approx(0.5)
    assert ratio("coupling", base, every(smallest_gap=FIGURES["smallest_gap"] / 4)) == pytest.approx(0.5)


def test_volume_limit_is_that_of_the_mean_pressures_stiffness_beyond_the_waves():
    assert every()["volume"] == math.inf
    stiff = "numerics.sound_speed_m_s=30"
    base = every(stiff, "numerics.mean_sound_speed_m_s=50")  # 50^2 - 30^2 = 40^2
    # the wall's mass on the spring of a chamber of 145.6 mm^3 under a cap of 2 pi 7.8 2.585 mm^2
    mass, area, volume = 1050.0 * 0.55e-3, 2.0 * math.pi * 7.8e-3 * 2.585e-3, 145.6e-9
    assert base["volume"] == pytest.approx(math.sqrt(mass * volume / (1000.0 * area)) / 40.0, rel=2e-3)
    assert ratio("volume", base, every(stiff, "numerics.mean_sound_speed_m_s=85.44003745")) == pytest.approx(0.5)
    assert every(stiff, "numerics.mean_sound_speed_m_s=50", "chamber.sealed=false")["volume"] == math.inf


@pytest.mark.parametrize(
    "overrides, figures, name",
    [
        ((), {}, "acoustic"),
        (("aqueous.viscosity_mpa_s=1000",), {"smallest_gap": 1e-6}, "viscous"),
        ((), {"membrane_step": 1e-9, "membrane_speed": 50.0}, "membrane in plane"),
        (("numerics.sound_speed_m_s=1",), {"transverse_speed": 40.0}, "membrane transverse"),
        (("cornea.density_kg_m3=100", "cornea.thickness_mm=0.01", "numerics.dissipation=0"), {}, "coupling"),
    ],
)
@pytest.mark.parametrize("cfl", [0.1, 0.8])
def test_step_is_the_smallest_limit_times_cfl(overrides, figures, name, cfl):
    case = case_of(load_scene(None, [*overrides, f"numerics.cfl={cfl}"]))
    step, limit = stable_step({**FIGURES, **figures}, case)
    assert limit == name
    assert step == pytest.approx(cfl * min(limits({**FIGURES, **figures}, case).values()))


def test_many_scenes_have_each_its_own_step():
    overrides = [
        (),
        ("numerics.sound_speed_m_s=160", "numerics.cfl=0.5"),
        ("aqueous.viscosity_mpa_s=1000",),
        ("cornea.density_kg_m3=100", "cornea.thickness_mm=0.01"),
        ("cornea.flexural_modulus_mpa=40",),
    ]
    cases = [case_of(load_scene(None, keys)) for keys in overrides]
    figures = [{name: value * (1.0 + 0.3 * k) for name, value in FIGURES.items()} for k in range(len(cases))]
    steps, which = StepLimits(cases).stable_steps({name: np.array([f[name] for f in figures]) for name in FIGURES})
    names = [NAMES[limit] for limit in which]
    assert len(set(names)) > 2
    assert list(zip(steps, names)) == [stable_step(f, case) for f, case in zip(figures, cases)]


@pytest.mark.parametrize("rung", ["cavity", "mfpm"])
def test_the_steps_of_a_run_are_foreseen(rung):
    keys = ["numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "numerics.duration_ms=1", "puff.peak_kpa=0"]
    scene = load_scene(None, [*keys, f"numerics.fidelity={rung}"])
    run, case = simulation_of(scene), case_of(scene)
    run.run()
    foreseen = 1e-3 / (case.scheme.cfl * min(rest_limits(case, rung == "mfpm").values()))
    # a sample takes a whole number of steps
    assert foreseen / 1.2 < run.steps < 2.0 * foreseen


@pytest.mark.parametrize(
    "keys, named",
    [
        (["cornea.shear_viscosity_ms=100", "cornea.shear_modulus_kpa=1e6"], "cornea.shear_viscosity_ms = 100"),
        (["cornea.flexural_modulus_mpa=100", "cornea.thickness_mm=2", "numerics.spacing_mm=0.02"], "flexural_modulus"),
        (["numerics.sound_speed_m_s=2000", "numerics.duration_ms=1000"], "numerics.sound_speed_m_s = 2000"),
    ],
)
def test_a_run_without_end_is_refused_with_the_key_that_makes_it_so(keys, named):
    with pytest.raises(SceneError, match=f"{named}.*numerics.duration_ms"):
        refuse_endless(case_of(load_scene(None, keys)), 20000, nodes_flow=True)
    refuse_endless(case_of(load_scene(None, [])), 20000, nodes_flow=True)
