"""What auto picks, and why."""

from pathlib import Path

import numpy as np
import pytest

from taichi_eye.ladder.choose import MAP_ORDER, RAREST, cheapest_maps, choose, viscous_share
from taichi_eye.ladder.misfit import misfit
from taichi_eye.ladder.rungs import simulation_of, with_numerics
from taichi_eye.rungs import RUNGS
from taichi_eye.scene import load_scene


def auto(tolerance, *overrides):
    return choose(load_scene(None, ('numerics.fidelity="auto"', f"numerics.tolerance_percent={tolerance}", *overrides)))


def rung(choice):
    return list(RUNGS).index(choice.scene.numerics.fidelity)


def test_a_tighter_tolerance_never_takes_a_cheaper_rung_or_a_coarser_spacing():
    choices = [auto(tolerance) for tolerance in (10, 3, 1, 0.3)]
    assert [rung(choice) for choice in choices] == sorted(rung(choice) for choice in choices)
    for loose, tight in zip(choices, choices[1:]):
        if rung(loose) == rung(tight):
            assert tight.scene.numerics.spacing_mm <= loose.scene.numerics.spacing_mm
    assert {choice.scene.numerics.fidelity for choice in choices} >= {"cavity", "added_mass"}


SHORT_AND_HEAVY = ("puff.duration_ms=10", "aqueous.density_kg_m3=3000", "numerics.duration_ms=8")


def test_inertia_decides_between_cavity_and_added_mass():
    slow, quick = auto(10), auto(10, *SHORT_AND_HEAVY)
    assert slow.scene.numerics.fidelity == "cavity" and quick.scene.numerics.fidelity == "added_mass"
    assert "inertia" in quick.reason and slow.estimates["cavity"]["inertia"] < 3.0


def test_flow_maps_that_age_too_fast_ask_for_the_resolved_liquid():
    choice = auto(1, *SHORT_AND_HEAVY)
    numerics = choice.scene.numerics
    assert numerics.fidelity == "mfpm" and "flow maps" in choice.reason
    assert numerics.mean_sound_speed_m_s >= numerics.sound_speed_m_s
    assert sum(choice.estimates["mfpm"].values()) <= 1.0


@pytest.mark.parametrize("tolerance", [10, 1])
def test_the_true_error_keeps_the_tolerance(tolerance):
    scene = load_scene(None, (f"numerics.tolerance_percent={tolerance}", "eye.iop_mmhg=20"))
    choice = choose(scene)
    picked = choice.simulation or simulation_of(choice.scene)
    close = simulation_of(with_numerics(scene, fidelity="added_mass", spacing_mm=0.12))
    assert misfit(picked.run(), close.run()).of("apex") < tolerance


def test_a_pilot_that_is_the_answer_is_not_run_again():
    choice = auto(10)
    assert choice.simulation is not None and choice.simulation.scene == choice.scene
    assert choice.seconds > 0.0


def test_an_open_chamber_at_a_slow_load_needs_no_liquid():
    choice = auto(10, "chamber.sealed=false", "puff.peak_kpa=2")
    assert choice.scene.numerics.fidelity == "membrane"


def test_viscosity_asks_for_the_resolved_liquid():
    choice = auto(1, "aqueous.viscosity_mpa_s=100")
    assert choice.scene.numerics.fidelity == "mfpm" and "viscosity" in choice.reason


@pytest.mark.parametrize(
    "overrides",
    [
        ("chamber.sealed=false", "puff.peak_kpa=10"),
        ("cornea.prestrain=0.002", "cornea.exponent_k=86.1", "puff.peak_kpa=15"),
    ],
)
def test_rungs_that_leave_their_validity_are_refused(overrides):
    choice = auto(10, *overrides)
    assert "cavity" in choice.refused and choice.scene.numerics.fidelity == "mfpm"
    assert all("stopped at" in why for why in choice.refused.values()) and "refused" in choice.reason


def test_viscous_share_goes_with_the_viscosity():
    shares = []
    for viscosity in (0.8, 8.0):
        run = simulation_of(
            load_scene(
                None, ('numerics.fidelity="cavity"', "numerics.spacing_mm=0.4", f"aqueous.viscosity_mpa_s={viscosity}")
            )
        )
        run.run()
        shares.append(viscous_share(run))
    assert shares[1] == pytest.approx(10.0 * shares[0], rel=1e-6) and 0.0 < shares[0] < 0.1
    assert np.isfinite(shares).all()


def test_a_shell_that_holds_is_not_refused_for_the_lobes_of_a_coarse_pilot():
    healthy = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"
    choice = choose(load_scene(healthy, ("numerics.fidelity=auto", "numerics.tolerance_percent=5")))
    assert not choice.refused and choice.scene.numerics.fidelity == "added_mass"
    run = simulation_of(choice.scene)
    assert run.judges_folding and run.run()["time_ms"][-1] > 31.9


@pytest.mark.parametrize("seed", range(4))
def test_flow_maps_are_set_where_they_are_made_soonest(seed):
    random = np.random.default_rng(seed)
    space, age, left, coarsest = random.uniform(1.0, 40.0), random.uniform(0.1, 12.0), random.uniform(0.1, 3.0), 0.4
    spacing, travel = cheapest_maps(space, age, left, coarsest)
    cost = lambda h, t: h**-MAP_ORDER / (t * h)
    error = lambda h, t: space * h**2 + age * t * h
    assert error(spacing, travel) <= left * (1.0 + 1e-12) and spacing <= coarsest and travel <= RAREST
    h, t = np.meshgrid(np.geomspace(0.01, coarsest, 600), np.geomspace(1e-3, RAREST, 600))
    assert cost(spacing, travel) <= cost(h, t)[error(h, t) <= left].min() * (1.0 + 1e-9)


def test_no_error_left_makes_no_flow_maps():
    assert cheapest_maps(1.0, 1.0, -0.1, 0.4) == (0.0, 0.0)
