"""What auto picks, and why."""

import numpy as np
import pytest

from taichi_eye.ladder.choose import choose, viscous_share
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
