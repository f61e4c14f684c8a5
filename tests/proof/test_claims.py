"""The measures on histories with known delay and asymmetry, the open chamber, and the command on invented runs."""

import json
import math

import numpy as np
import pytest

from taichi_eye import backend, cli
from taichi_eye.errors import RunStopped
from taichi_eye.ladder.trial import Trial
from taichi_eye.proof import claims
from taichi_eye.proof.claims import Answer, Case, Results, delays, quasi_static
from taichi_eye.proof.measures import lag_of_best_match, measure
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation

TIME = np.arange(0.0, 32.0, 0.025)


def gaussian(centre, width=4.0, late_width=None):
    spread = np.where(TIME < centre, width, late_width or width)
    return np.exp(-0.5 * ((TIME - centre) / spread) ** 2)


def answer(case, apex, load, stop=None):
    traces = {"time_ms": TIME[: len(apex)], "apex_displacement_mm": apex, "puff_apex_kpa": load}
    nothing = np.zeros_like(apex)
    traces |= {name: nothing for name in ("chamber_volume_error", "energy_error_uj", "puff_work_uj")}
    return Answer(case, Trial(load_scene(None, case.overrides), traces, stop, 1, 1, 0.0, 0.0))


# --- measures -------------------------------------------------------------------------------------------------------


def test_a_shift_is_found_by_every_measure():
    for name, delay in delays(TIME, 0.7 * gaussian(15.337, 5.0), gaussian(15.0)).items():
        assert delay == pytest.approx(0.337, abs=2e-4), name


def test_a_symmetric_history_has_no_asymmetry():
    m = measure(TIME, gaussian(15.2))
    assert m.fall_to_rise == pytest.approx(1.0, abs=1e-3)
    assert m.speed_ratio == pytest.approx(1.0, abs=1e-4)
    assert abs(m.skewness) < 1e-4 and m.odd_share < 1e-4


def test_two_half_gaussians():
    m = measure(TIME, 1.3 * gaussian(14.0, 3.0, 4.5))
    half = math.sqrt(2.0 * math.log(2.0))
    assert m.peak == pytest.approx(1.3, rel=2e-3)
    assert m.half_rise_ms == pytest.approx(14.0 - 3.0 * half, abs=0.01)
    assert m.half_fall_ms == pytest.approx(14.0 + 4.5 * half, abs=0.01)
    assert m.midpoint_ms == pytest.approx(14.0 + 0.75 * half, abs=0.01)
    assert m.fall_to_rise == pytest.approx(1.5, abs=0.1)  # a quartic rounds the jump of the curvature at the peak
    assert m.speed_ratio == pytest.approx(3.0 / 4.5, rel=2e-3)
    assert m.skewness > 0.15 and m.odd_share > 0.05


def test_first_order_lag_delays_the_centroid_by_its_time_constant():
    tau, kernel = 0.4, np.exp(-TIME / 0.4)
    lagged = np.convolve(gaussian(15.0, 3.0), kernel / kernel.sum())[: len(TIME)]
    assert lag_of_best_match(TIME, lagged, gaussian(15.0, 3.0)) == pytest.approx(tau, abs=0.03)


def test_flat_top_does_not_disturb_the_time_of_the_peak():
    rng = np.random.default_rng(3)
    flat = np.exp(-(((TIME - 15.0) / 5.0) ** 4)) + 1e-3 * rng.standard_normal(len(TIME))
    assert measure(TIME, flat).peak_time_ms == pytest.approx(15.0, abs=0.15)


def test_a_history_that_does_not_come_back_has_no_measures():
    assert measure(TIME, np.tanh(TIME / 5.0)) is None
    assert measure(TIME, np.zeros_like(TIME)) is None


def test_quasi_static_answer_removes_a_delay():
    load = 10.0 * gaussian(15.0)
    static = lambda pressure: np.log1p(pressure) / 2.5
    late = static(10.0 * gaussian(15.2))
    reference = answer(Case("reference", "", 1.0), late, load)
    other = 9.0 * gaussian(13.0, 2.0, 5.0)
    assert np.abs(quasi_static(reference, other) - static(other)).max() < 0.02


# --- open chamber ---------------------------------------------------------------------------------------------------


def simulate(*overrides):
    simulation = Simulation(load_scene(None, ("numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=60", *overrides)))
    mean = []

    def look(_):
        count = simulation.cloud.count
        volume = simulation.aqueous.volume.to_numpy()[:count]
        mean.append(float((volume * simulation.aqueous.pressure.to_numpy()[:count]).sum() / volume.sum()))

    simulation.run(on_sample=look)
    return simulation.traces, np.array(mean)


def test_open_chamber_holds_the_mean_pressure_and_its_energy_balance():
    backend.init()
    traces, mean = simulate("chamber.sealed=false", "puff.peak_kpa=2", "numerics.duration_ms=18")
    assert np.abs(mean).max() < 2.0  # Pa, of the 2000 of the puff
    assert traces["chamber_volume_error"].min() < -0.02
    assert np.abs(traces["energy_error_uj"]).max() < 5e-3 * traces["puff_work_uj"].max()
    sealed, _ = simulate("puff.peak_kpa=2", "numerics.duration_ms=18")
    assert sealed["chamber_volume_error"].min() > -1e-3
    assert np.all(sealed["outflow_loss_uj"] == 0.0)
    # constant IOP (membrane alone): a third deeper than with the volume kept
    assert traces["apex_displacement_mm"].max() / sealed["apex_displacement_mm"].max() == pytest.approx(1.37, abs=0.06)


def test_open_chamber_under_the_full_puff_hits_the_back():
    backend.init()
    with pytest.raises(RunStopped, match="reached the back"):
        simulate("chamber.sealed=false")


# --- the study ------------------------------------------------------------------------------------------------------


def test_lighter_fluid_keeps_the_acoustic_stiffness():
    for case in claims.cases():
        scene = load_scene(None, (f"numerics.sound_speed_m_s={claims.C_BASE}", *case.overrides))
        stiffness = scene.aqueous.density_kg_m3 * scene.numerics.sound_speed_m_s**2
        if case.study == "fluid density":
            assert stiffness == pytest.approx(1000.0 * claims.C_BASE**2, rel=1e-12)


def test_stiffness_cases_change_the_tangent_by_what_they_say():
    # (S0/eps0)(1 + 4 k eps0^2), S0 the same in all
    tangent = lambda scene: (1.0 + 4.0 * scene.cornea.exponent_k * scene.cornea.prestrain**2) / scene.cornea.prestrain
    rest = tangent(load_scene())
    for case in claims.cases():
        if case.study == "stiffness":
            assert tangent(load_scene(None, case.overrides)) / rest == pytest.approx(1.0 + case.value, rel=1e-9)


def invented(case, spacing_mm):
    """A run whose peak goes as IOP^-0.5 and puff^0.5, with a delay of 0.4 ms and a width that falls with the IOP."""
    scene = load_scene(None, case.overrides)
    strength = (scene.puff.peak_kpa / 10.0 * 15.0 / scene.eye.iop_mmhg) ** 0.5
    apex, load = strength * gaussian(15.4, 4.0 * strength**0.2), scene.puff.peak_kpa * gaussian(15.0)
    if case.label == "open, 10 kPa":
        return answer(case, apex[:500], load[:500], RunStopped("the cornea reached the back", "there", 12.5, ""))
    return answer(case, apex, load)


def test_pressure_read_off_the_peak():
    results = Results([invented(case, 0.25) for case in claims.cases()])
    for share in (-0.1, 0.1):
        puff = next(o for o in results.of("puff") if o.case.value == share)
        assert results.pressure_seen(puff) == pytest.approx(15.0 / (1.0 + share), rel=2e-3)
    table = results.elasticities()
    assert table["IOP"]["peak"] == pytest.approx(-0.5, abs=5e-3)
    assert table["puff"]["peak"] == pytest.approx(0.5, abs=5e-3)
    assert claims.likeness(table["IOP"], table["puff"]) == pytest.approx(-1.0, abs=0.02)


def test_command_writes_page_and_tables(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(claims, "run_case", invented)
    out, table = tmp_path / "page", tmp_path / "claims.json"
    assert cli.main(["claims", "--out", str(out), "--json", str(table), "--quiet"]) == 0
    page = (out / "claims.html").read_text()
    assert page.count("data:image/png;base64,") == 4 and "the cornea reached the back" in page
    rows = (out / "claims.csv").read_text().splitlines()
    assert len(rows) == 1 + len(claims.cases())
    judged = {entry["claim"]: entry["holds"] for entry in json.loads(table.read_text())["claims"]}
    assert judged["(i) the apex lags the jet"] == "yes"  # 0.4 ms, more than a frame
    assert judged["(ii) its history is not symmetric in time"] == "no"
    assert "claims.html" in capsys.readouterr().out


def test_command_refuses_a_spacing_that_the_chamber_cannot_hold(tmp_path, capsys):
    assert cli.main(["claims", "--out", str(tmp_path / "x"), "--spacing-mm", "2"]) == 2
    assert "numerics.spacing_mm" in capsys.readouterr().err and not (tmp_path / "x").exists()
