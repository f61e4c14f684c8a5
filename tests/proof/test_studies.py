"""Every long study in a short form: few parts, coarse settings, seconds; what is asserted is the study's own verdict.

The commands run in full take minutes each and are run by hand. Here the same commands run on so little that a change
which breaks a study shows at once; `films` and `chart` have theirs in test_film_rows.py and tests/ladder/test_chart.py.
"""

import json
from functools import partial
from pathlib import Path

import pytest

from taichi_eye.cli import main
from taichi_eye.proof import choices, claims, clinic, dcr, error_bars, population, public, stability, verify, windows
from taichi_eye.proof.maps import corners, runs, sound_speed

HEALTHY = Path(__file__).parents[2] / "configs" / "corvis_healthy.toml"


@pytest.fixture
def there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_verify_passes_on_small_problems(there, monkeypatch, capsys):
    few = {name: partial(verify.PARTS[name], quick=True) for name in ("inflation", "hencky")}
    monkeypatch.setattr(verify, "PARTS", few)
    assert main(["verify", "--out", "page", "--json", "rows.json"]) == 0
    rows = json.loads((there / "rows.json").read_text())
    assert len(rows) == 11 and all(row["passed"] for row in rows)
    assert f"{len(rows)} of {len(rows)} rows passed; page" in capsys.readouterr().out


def test_stability_finds_no_silent_failure_on_a_coarse_eye(there, monkeypatch, capsys):
    monkeypatch.setattr(runs, "COARSE", {"numerics.spacing_mm": 0.4, "numerics.sound_speed_m_s": 40.0})
    monkeypatch.setattr(sound_speed, "SPEEDS", (3.0, 5.0, 10.0, 20.0, 30.0, 60.0))
    monkeypatch.setattr(corners, "FINER", {**corners.FINER, "numerics.spacing_mm": 0.3})
    few = ("low c", "low c, deep", "loose", "no dissipation", "fast puff, soft eye", "one sweep")
    monkeypatch.setattr(corners, "CORNERS", {name: corners.CORNERS[name] for name in few})
    monkeypatch.setattr(stability, "PARTS", {name: stability.PARTS[name] for name in ("sound-speed", "corners")})
    assert main(["stability", "--out", "maps", "--json", "maps.json"]) == 0
    said = capsys.readouterr().out
    assert "Every failing corner ended in a stop with its diagnosis." in said and "SILENCE" not in said
    figures = json.loads((there / "maps.json").read_text())
    assert sum("stopped" in figures["corners"][name] for name in few) == 4
    # with independent potential flow, and the law of the compliance
    assert figures["sound-speed"]["order"] == pytest.approx(2.0, abs=0.15)
    assert figures["sound-speed"]["peak_mm"]["3"] == pytest.approx(1.55, rel=0.03)


def test_claims_come_to_their_verdicts_on_coarse_nodes(there, monkeypatch):
    # without the runs whose many steps the verdicts do not need
    slow = {"c = 160 m/s", "rho_f x 0.01", "rho_f x 0.1", "mu = 0.8 mPa s, no slip"}
    kept = [case for case in claims.cases() if case.label not in slow]
    monkeypatch.setattr(claims, "cases", lambda: kept)
    assert main(["claims", "--spacing-mm", "0.5", "--out", "page", "--json", "claims.json", "--quiet"]) == 0
    verdicts = [entry["holds"] for entry in json.loads((there / "claims.json").read_text())["claims"]]
    assert verdicts == [
        "no",
        "no",
        "in part",
        "yes, by its volume",
        "yes, as well as model and puff are known",
        "the globe moves",
    ]


def test_choices_keep_their_tolerance_on_a_coarse_reference(there, monkeypatch):
    # a reference that is good to a few tenths of a percent
    monkeypatch.setattr(choices, "PARTS", {"half": ("puff.duration_ms=16", "numerics.duration_ms=14")})
    monkeypatch.setattr(choices, "TOLERANCES", (10.0, 3.0))
    monkeypatch.setattr(choices, "LEVELS", ((0.2, 40.0), (0.2, 40.0), (0.2828, 40.0)))
    monkeypatch.setattr(choices, "grid", lambda: [choices.Setting("cavity", 0.2), choices.Setting("added_mass", 0.4)])
    status = main(["choices", "--out", "page", "--json", "rows.json"])
    rows = json.loads((there / "rows.json").read_text())
    assert len(rows) == 2 and all(row["error"] <= row["tolerance"] for row in rows)
    assert status == (0 if all(row["passed"] for row in rows) else 1)


def test_error_bars_hold_the_true_errors_on_coarse_nodes(there, monkeypatch, capsys):
    few = ("corvis-puff",)
    monkeypatch.setattr(error_bars, "SCENES", {name: error_bars.SCENES[name] for name in few})
    monkeypatch.setattr(error_bars, "PARTS", {"cavity": 4.0, "mfpm": 2.0})
    monkeypatch.setattr(error_bars, "SPACING_MM", 0.33)
    monkeypatch.setattr(error_bars, "SOUND_SPEED_M_S", 25.0)
    assert main(["error-bars", "--out", "page", "--json", "bars.json", "--quiet"]) == 0
    found = json.loads((there / "bars.json").read_text())
    for rung in ("cavity", "mfpm"):
        history, every = found[rung]["rows"][:2]
        assert history["passed"] and history["better"] < 1.0 and len(history["inside"]) == len(few)
        assert every["passed"] and len(every["inside"]) > 25
        assert found[rung]["order"] == pytest.approx(2.0, abs=0.2)
    said = capsys.readouterr().out
    assert "| mfpm | apex peak |" in said and "rows hold; page" in said


def test_the_clinical_scene_stays_within_the_norms(there, monkeypatch, capsys):
    monkeypatch.setattr(population, "IOP_STEPS_MMHG", (-1.0, 0.0, 3.0))
    monkeypatch.setattr(population, "THICKNESS_STEPS_UM", (0.0, 30.0))
    monkeypatch.setattr(public, "LEAST_MMHG", 12.0)
    monkeypatch.setattr(windows, "ZONES_MM", (1.0, 1.5))
    monkeypatch.setattr(dcr, "SWITCHES", {name: dcr.SWITCHES[name] for name in ("yielding globe", "thicker rim")})
    words = ("numerics.fidelity=cavity", "numerics.spacing_mm=0.25", "numerics.error_bar=true")
    coarse = [word for entry in words for word in ("--set", entry)]
    assert main(["clinic", str(HEALTHY), *coarse, "--out", "page", "--json", "tables.json", "--quiet"]) == 0
    found = json.loads((there / "tables.json").read_text())
    fitted = ("a1_time_ms", "a2_time_ms", "hc_time_ms", "deformation_amplitude_mm", "da_ratio_2mm", "sp_a1_mmhg_mm")
    assert [found["levels"][name]["within_1_sd"] for name in fitted] == [True] * len(fitted)
    assert all(0.0 < found["levels"][name]["numerical_error"] < 1.0 for name in fitted)
    slopes = {(row["parameter"], row["unit"]): row for row in found["slopes"]}
    assert len(slopes) == 18 and slopes["deformation_amplitude_mm", "per mmHg"]["verdict"] == "yes"
    assert found["eye"]["iop_nct_mmhg"] > found["eye"]["biop_mmhg"] > 10.0
    # softer in its plane than donor corneas by no more than a factor 1.5
    assert clinic.DONOR_NM_PER_MMHG[0] < found["donors"]["computed_nm_per_mmhg"] < 1.5 * clinic.DONOR_NM_PER_MMHG[1]
    assert all(row["holds"] for row in found["stiffened_globe"].values())
    # a wider zone turns flat later, and the zone of the tables is among those of the study
    usual, wide = found["zones"]
    assert usual["a1_time_ms"] == found["levels"]["a1_time_ms"]["computed"] < wide["a1_time_ms"]
    assert set(found["switches"]) == {"scene", "yielding globe", "thicker rim"}
    said = capsys.readouterr().out
    assert "would show IOPnct" in said and "numerical error" in said and "60 controls, Tian 2014" in said
    assert {path.name for path in (there / "page").iterdir()} == {"clinic.html", "clinic.md", "clinic.png"}
    assert "0.0278" in (there / "page" / "clinic.html").read_text()
