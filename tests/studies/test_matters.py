"""What matters, against functions whose answers are known."""

import numpy as np
import pytest

from taichi_eye.studies.study import load_study
from taichi_eye.studies.sweep import sweep

# of Ishigami's function with a = 7, b = 0.1 (Ishigami and Homma 1990), by its variance's parts
A, B = 7.0, 0.1
V1 = 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2
V2, V13 = A**2 / 8.0, B**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
V = V1 + V2 + V13
FIRST, TOTAL = (V1 / V, V2 / V, 0.0), ((V1 + V13) / V, V2 / V, V13 / V)
KEYS = "eye.iop_mmhg", "cornea.thickness_mm", "puff.peak_kpa"


def test_sobol_indices_of_a_known_function_lie_within_their_intervals(tmp_path):
    study = {
        "design": {"kind": "sensitivity", "base_samples": 1024, "seed": 4},
        "show": ["deformation_amplitude_mm"],
        "set": {"numerics.fidelity": "cavity"},
        "vary": {
            KEYS[0]: {"from": 10, "to": 20},
            KEYS[1]: {"from": 0.5, "to": 0.6},
            KEYS[2]: {"from": 5, "to": 15},
        },
    }
    result = sweep(study, tmp_path / "out", threads=1, compute="stubs:ishigami")
    assert result.summary["eyes"] == 1024 * 5 == result.summary["status"]["complete"]
    lines = (tmp_path / "out" / "matters.csv").read_text().splitlines()
    head, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    found = {row[1]: dict(zip(head, row)) for row in rows}
    assert list(found) == list(KEYS)
    for key, first, total in zip(KEYS, FIRST, TOTAL):
        row = found[key]
        for value, interval, exact in (("first", "first_interval", first), ("value", "interval", total)):
            # 95 % intervals of six indices: once more as wide is 1e-4 for one
            assert abs(float(row[value]) - exact) < 2.0 * float(row[interval]) + 1e-3, (key, value)
            assert float(row[interval]) < 0.2
    assert (tmp_path / "out" / "matters.png").stat().st_size > 5000


def _frame(study, values):
    import pandas

    from taichi_eye.studies.designs import draw

    design = draw(study)
    frame = pandas.DataFrame({**design, "deformation_amplitude_mm": values(design)})
    frame["status"] = "complete"
    return frame


def test_slopes_are_those_of_a_linear_function():
    from taichi_eye.studies.matters import effects

    study = load_study(
        {
            "design": {"kind": "random", "eyes": 400, "seed": 9},
            "vary": {KEYS[0]: {"mean": 15, "sd": 2}, KEYS[1]: {"from": 0.5, "to": 0.6}},
        }
    )
    frame = _frame(study, lambda d: 3.0 * d[KEYS[0]] - 40.0 * d[KEYS[1]])
    found = {e.key: e for e in effects(study, frame, ["deformation_amplitude_mm"])}
    spread = frame["deformation_amplitude_mm"].std()
    assert found[KEYS[0]].value == pytest.approx(3.0 * frame[KEYS[0]].std() / spread)
    assert found[KEYS[1]].value == pytest.approx(-40.0 * frame[KEYS[1]].std() / spread)
    assert found[KEYS[0]].explained == pytest.approx(1.0)
    # noise widens the intervals, which still hold the slopes
    rng = np.random.default_rng(1)
    frame["deformation_amplitude_mm"] += rng.normal(0.0, spread, 400)
    for effect, slope in zip(effects(study, frame, ["deformation_amplitude_mm"]), (3.0, -40.0)):
        exact = slope * frame[effect.key].std() / frame["deformation_amplitude_mm"].std()
        assert abs(effect.value - exact) < 2.0 * effect.interval and 0.3 < effect.explained < 0.7


def test_an_eye_that_stopped_counts_in_no_effect():
    from taichi_eye.studies.matters import effects

    study = load_study(
        {
            "design": {"kind": "one_at_a_time"},
            "vary": {KEYS[0]: {"values": [10.0, 20.0, 30.0]}, KEYS[1]: {"values": [0.5]}},
        }
    )
    import pandas

    frame = pandas.DataFrame({"deformation_amplitude_mm": [1.0, 1.3, 0.9, 50.0, 1.1], "status": ["complete"] * 5})
    frame.loc[3, "status"] = "stopped"
    iop, thick = effects(study, frame, ["deformation_amplitude_mm"])
    assert (iop.low, iop.high) == pytest.approx((-0.1, 0.3)) and (thick.low, thick.high) == pytest.approx((0.0, 0.1))
