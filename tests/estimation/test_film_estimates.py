"""Films: the surface over frames and stations, and the fitted eye's edge in the frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_eye.analysis import Instrument
from taichi_eye.estimation.estimate import estimate
from taichi_eye.estimation.motion import cheap
from taichi_eye.estimation.observation import of_film, of_history
from taichi_eye.estimation.pictures import fitted_rows
from taichi_eye.estimation.unknowns import Known, own_values, scene_with
from taichi_eye.scene import load_scene

SCENE = load_scene(None, ["puff.time_course=corvis", "numerics.fidelity=cavity", "eye.whole_eye_movement_mm=0.3"])


@pytest.fixture(scope="module")
def filmed():
    """An eye, what a film shows of it with 3 um of noise, and the estimate from that."""
    truth = {**own_values(SCENE), "iop_mmhg": 19.2}
    motion = cheap(scene_with(SCENE, truth))
    clean = motion.histories
    noise = 0.003 * np.random.default_rng(6).standard_normal(clean.deflection_mm.shape)
    kept = slice(None, None, 3)  # a camera that takes every third frame
    seen = replace(clean, time_ms=clean.time_ms[kept], deflection_mm=(clean.deflection_mm + noise)[kept])
    film = of_film("film", seen, {"thickness_um": Known(550.0, 5.0)})
    known = {"puff": 1.0, "puff_width": 1.0, "radius_mm": 7.8}
    return motion, film, estimate(film, SCENE, known, free=("iop_mmhg",), model_error_um=0.0)


def test_a_film_tells_the_pressure_and_more_than_its_apex_alone(filmed):
    motion, film, found = filmed
    iop = found["iop_mmhg"]
    assert abs(iop.value - 19.2) < 4.0 * iop.deviation and iop.deviation < 0.2
    # its own thickness is what is known of it, and its retreat is in no deflection
    assert found["thickness_um"].before == Known(pytest.approx(550.0), pytest.approx(5.0))
    assert "whole_eye" not in [quantity.name for quantity in found.quantities] and not film.retreats
    apex = film.x_mm == 0.0
    alone = of_history("apex", film.time_ms[apex], film.values[apex], False, film.noise_mm, read=True)
    known = {"puff": 1.0, "puff_width": 1.0, "radius_mm": 7.8, "thickness_um": (550.0, 5.0)}
    from_apex = estimate(alone, SCENE, known, free=("iop_mmhg",), model_error_um=0.0)
    assert from_apex.laplace_mmhg > found.laplace_mmhg


def test_the_fitted_edge_lies_where_the_recorded_one_does(filmed):
    motion, _, found = filmed
    curves = SimpleNamespace(tilt_deg=0.0, axis_column_px=280.0, apex_row_px=14.0)
    film = SimpleNamespace(
        time_ms=motion.frame_ms, frames=np.zeros((len(motion.frame_ms), 200, 576)), instrument=Instrument()
    )
    shown = replace(found, film=SimpleNamespace(film=film, curves=curves, histories=motion.histories))
    rows = fitted_rows(shown)
    assert rows[0, 280] == pytest.approx(14.0, abs=0.05)
    x = (np.arange(576) - 280.0) * 0.015625
    inside = np.abs(x) < 4.3
    cap = 14.0 + (7.8 - np.sqrt(7.8**2 - x**2)) / 0.0165
    assert rows[0, inside] == pytest.approx(cap[inside], abs=0.1)
    deep = int(np.argmax(motion.histories.apex_mm))
    assert rows[deep, 280] - rows[0, 280] == pytest.approx(motion.histories.apex_mm[deep] / 0.0165, abs=0.5)
