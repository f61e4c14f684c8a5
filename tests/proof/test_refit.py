"""The clinical fit: known answers are found again, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from taichi_eye.analysis import Response
from taichi_eye.cli import main
from taichi_eye.errors import SceneError
from taichi_eye.eye.eye import eye_of
from taichi_eye.proof import refit
from taichi_eye.proof.population import SimulatedEye, eye_at
from taichi_eye.scene import load_scene

QUICK = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.25"]
HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"


def asked_of(scene, units):
    """Targets of those units that a scene meets."""
    targets = [target for target in refit.clinical_targets() if target.unit in units]
    return [
        refit.Target(target.name, target.unit, value, target.scale)
        for target, value in zip(targets, refit.figures(scene, targets))
    ]


def test_levels_that_a_scene_made_lead_back_to_it_from_a_tenth_off():
    # a membrane: no snap, so that one minimum lies near
    truth = load_scene(None, [*QUICK, "puff.radial_profile=gaussian"])
    names = ["cornea.stiffness_a_pa", "puff.width_mm"]
    own = truth.values()
    start = truth.but({name: factor * own[name] for name, factor in zip(names, (0.9, 1.1))})
    found = refit.fit(start, names, asked_of(truth, [refit.LEVEL]))
    assert found.finished and found.cost[1] < 1e-4 * found.cost[0]
    for name, (before, after, error) in found.keys.items():
        assert before == start.values()[name] and after == pytest.approx(own[name], rel=1e-3) and np.isfinite(error)


def synthetic(scene, iop_mmhg, thickness_um):
    """An eye in closed form: levels and slopes hang on three keys of a scene, each in its own way."""
    eye = eye_at(scene, iop_mmhg, thickness_um)
    own = load_scene(HEALTHY)
    stiff = eye.cornea.stiffness_a_pa / own.cornea.stiffness_a_pa
    globe = eye_of(eye).globe_compliance / eye_of(own).globe_compliance
    puff, thin = eye.puff.width_mm / own.puff.width_mm, 550.0 / thickness_um
    a1 = 5.0 + 0.1 * iop_mmhg * stiff + 0.5 / puff
    if puff > 1.6:
        return SimulatedEye(iop_mmhg, thickness_um, None, Response(), "stopped")
    response = Response(
        a1_time_ms=a1,
        iop_nct_mmhg=16.8 + (a1 - 7.36) / 0.134,
        deformation_amplitude_mm=1.0 * globe * puff**2 * thin / iop_mmhg**0.5 / stiff,
        peak_distance_mm=4.0 * globe**0.5 * puff**0.2 / stiff,
        sp_a1_mmhg_mm=90.0 * stiff * (thickness_um / 550.0) ** 2 + iop_mmhg * stiff,
    )
    return SimulatedEye(iop_mmhg, thickness_um, None, response)


@pytest.mark.parametrize("units", [[refit.LEVEL], ["per mmHg", "per 10 um"], [refit.LEVEL, "per mmHg", "per 10 um"]])
def test_levels_and_slopes_lead_back_in_closed_form(monkeypatch, units):
    monkeypatch.setattr(refit, "simulate", synthetic)
    names = ["cornea.stiffness_a_pa", "chamber.compliance_mm3_mmhg", "puff.width_mm"]
    truth = load_scene(HEALTHY, QUICK)
    own = truth.values()
    targets = [target for target in asked_of(truth, units) if target.value is not None]
    start = truth.but({name: factor * own[name] for name, factor in zip(names, (1.3, 0.8, 1.4))})
    found = refit.fit(start, names, targets, rounds=40)
    assert [found.keys[name][1] for name in names] == pytest.approx([own[name] for name in names], rel=2e-3)


def test_what_the_own_rung_shows_beyond_the_cheap_one_is_taken_along(monkeypatch):
    def rung_by_rung(scene, iop_mmhg, thickness_um):
        eye = synthetic(scene, iop_mmhg, thickness_um)
        if scene.numerics.fidelity == "mfpm":
            levels = {**vars(eye.response), "deformation_amplitude_mm": 0.1 + eye.response.deformation_amplitude_mm}
            eye = SimulatedEye(iop_mmhg, thickness_um, None, Response(**levels))
        return eye

    monkeypatch.setattr(refit, "simulate", rung_by_rung)
    names = ["cornea.stiffness_a_pa", "chamber.compliance_mm3_mmhg", "puff.width_mm"]
    truth = load_scene(HEALTHY)
    own = truth.values()
    targets = [target for target in asked_of(truth, [refit.LEVEL]) if target.value is not None]
    start = truth.but({name: factor * own[name] for name, factor in zip(names, (1.2, 0.9, 1.1))})
    found = refit.fit(start, names, targets, rounds=40)
    assert [found.keys[name][1] for name in names] == pytest.approx([own[name] for name in names], rel=2e-3)


def test_the_targets_are_all_levels_and_slopes_and_a_factor_of_one_and_a_half_counts_alike():
    targets = {(target.name, target.unit): target for target in refit.clinical_targets()}
    assert len(targets) == 12 + 18 + 1
    stopped = targets.pop((refit.STOPPED, "eyes"))
    assert refit.residuals([2.0], [stopped])[0] == 2.0 * refit.MISSING
    off = {key: refit.residuals([1.5 * target.value], [target])[0] for key, target in targets.items()}
    assert off["deformation_amplitude_mm", "per mmHg"] == pytest.approx(-2.5)
    # 194 eyes know that one less well than by a fifth
    assert abs(off["hc_circle_radius_mm", "per mmHg"]) == pytest.approx(0.5 * 0.063 / 0.026)
    zero = targets["deformation_amplitude_mm", "per 10 um"]
    assert zero.scale == 0.0017 and refit.residuals([None], [zero])[0] == refit.MISSING
    assert targets["a1_time_ms", refit.LEVEL].value == 7.52


def test_a_stopped_eye_counts_and_its_figures_do_not(monkeypatch):
    stops = lambda scene, iop, thickness: (
        SimulatedEye(iop, thickness, None, Response(a1_time_ms=1.0), "folded")
        if iop < scene.eye.iop_mmhg
        else synthetic(scene, iop, thickness)
    )
    scene, targets = load_scene(HEALTHY, QUICK), refit.clinical_targets()
    monkeypatch.setattr(refit, "simulate", synthetic)
    whole = dict(zip(targets, refit.figures(scene, targets)))
    monkeypatch.setattr(refit, "simulate", stops)
    lost = dict(zip(targets, refit.figures(scene, targets)))
    count = next(target for target in targets if target.name == refit.STOPPED)
    assert (whole[count], lost[count]) == (0.0, 1.0)
    time = next(target for target in targets if (target.name, target.unit) == ("a1_time_ms", "per mmHg"))
    assert lost[time] == pytest.approx(whole[time], rel=1e-6)


def test_a_key_that_nothing_hangs_on_is_said_to_be_unknown(monkeypatch):
    monkeypatch.setattr(refit, "simulate", synthetic)
    scene = load_scene(HEALTHY, QUICK)
    found = refit.fit(scene, ["aqueous.viscosity_mpa_s", "puff.width_mm"], refit.clinical_targets(), rounds=4)
    assert not np.isfinite(found.keys["aqueous.viscosity_mpa_s"][2]) and np.isfinite(found.keys["puff.width_mm"][2])
    assert any("viscosity" in line and "not at all" in line for line in refit.lines(found))


@pytest.mark.parametrize(
    "keys, words",
    [
        ("cornea.stifness_a_pa", "--free cornea.stifness_a_pa: unknown key; did you mean stiffness_a_pa?"),
        ("stiffness_a_pa", "unknown section [stiffness_a_pa]"),
        ("chamber.sealed", "chamber.sealed: is True"),
        ("chamber.lens_radius_mm", "is 0.0 in the scene"),
        ("camera.seed", "camera.seed: is 1"),
        ("cornea.stiffness_a_pa,cornea.stiffness_a_pa", "twice"),
        ("cornea.stiffness_a_pa,", "name the keys"),
    ],
)
def test_keys_that_cannot_be_fitted_are_refused(keys, words, capsys):
    assert main(["fit-clinic", str(HEALTHY), "--free", keys]) == 2
    said = capsys.readouterr().err
    assert words in said


def test_an_eye_that_stops_is_no_start():
    with pytest.raises(SceneError, match="no start: the cornea"):
        refit.fit(
            load_scene(HEALTHY, [*QUICK, "cornea.flexural_modulus_mpa=0"]), ["puff.width_mm"], refit.clinical_targets()
        )


def test_the_command_prints_overrides_that_can_be_pasted(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(refit, "simulate", synthetic)
    monkeypatch.chdir(tmp_path)
    free = "cornea.stiffness_a_pa,puff.width_mm"
    assert main(["fit-clinic", str(HEALTHY), "--free", free, "--json", "fit.json", "--quiet", "--rounds", "3"]) == 0
    last = capsys.readouterr().out.strip().splitlines()[-1]
    found = json.loads(Path("fit.json").read_text())
    changes = last.replace("--set ", "").split()
    scene = load_scene(HEALTHY, changes)
    for name, value in found["overrides"].items():
        assert scene.values()[name] == pytest.approx(value, rel=1e-5)
    assert found["cost"]["after"] < found["cost"]["before"] and len(found["targets"]) == 31
    assert [path.name for path in tmp_path.iterdir()] == ["fit.json"]
