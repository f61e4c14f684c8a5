"""No cornea, no numbers; and what a film cannot tell is left blank with the reason."""

import numpy as np
import pytest
from PIL import Image

from taichi_eye.analysis import Curves, analyze, histories, respond
from taichi_eye.analysis.curves import grid
from taichi_eye.analysis.following import following
from taichi_eye.analysis.plausible import believed, refuse_what_is_no_cornea
from taichi_eye.errors import FilmError
from taichi_eye.proof.films import made_up
from taichi_eye.proof.films.eyes import EYES, TIMES_MS, truth

EYE = EYES[6]
RESPONSE = respond(truth(EYE, EYE.scene()))
X = (np.arange(576) - 288) * 0.015625
CAP_PX = (7.8 - np.sqrt(7.8**2 - X**2)) / 0.0165


def told(curves, timed_by="counting"):
    """What is believed of curves, and the reasons."""
    history = histories(curves)
    response = respond(curves)
    refuse_what_is_no_cornea(curves, history, response)
    return believed(response, curves, history, timed_by)


def seen(keep=slice(None), eye=EYE, **changes):
    """The eye's true curves at some of the frames, as a film would have given them."""
    whole = truth(eye, eye.scene())
    count = len(whole.time_ms[keep])
    fields = {"thickness_mm": np.full(count, 0.55), "thickness_profile_mm": np.full(len(grid()), 0.55)} | changes
    times = fields.pop("time_ms", whole.time_ms[keep])
    return Curves(times, whole.x_mm, whole.height_mm[keep], **fields)


def test_a_whole_film_is_believed():
    response, notes = told(seen())
    assert response == respond(seen()) and notes == []


def test_an_event_without_frames_is_left_blank_and_the_rest_kept():
    keep = np.abs(TIMES_MS - RESPONSE.hc_time_ms) > 2.2
    response, notes = told(seen(keep))
    assert response.deformation_amplitude_mm is None and response.hc_radius_mm is None and response.hc_time_ms is None
    assert response.a1_time_ms == pytest.approx(RESPONSE.a1_time_ms, abs=0.02)
    assert response.a2_time_ms == pytest.approx(RESPONSE.a2_time_ms, abs=0.02)
    assert any("no frames from" in note for note in notes)
    response, _ = told(seen((TIMES_MS < 6.5) | (TIMES_MS > 9.5)))
    assert response.a1_time_ms is None and response.deformation_amplitude_mm == pytest.approx(
        RESPONSE.deformation_amplitude_mm, abs=2e-3
    )


@pytest.mark.parametrize("start", [28, 34, 60])
def test_a_film_that_starts_in_the_motion_has_no_displacements(start):
    curves = seen(slice(start, None))
    counted, notes = told(Curves(**{**vars(curves), "time_ms": curves.time_ms - curves.time_ms[0]}))
    assert counted.deformation_amplitude_mm is None and counted.hc_time_ms is None and counted.a2_time_ms is None
    assert any("does not start at rest" in note for note in notes)
    stamped, _ = told(curves, "stamps in the frames")
    assert stamped.deformation_amplitude_mm is None
    assert stamped.a2_time_ms == pytest.approx(RESPONSE.a2_time_ms, abs=0.03)


def test_time_that_runs_backwards_has_no_times():
    curves = seen()
    response, notes = told(Curves(**{**vars(curves), "height_mm": curves.height_mm[::-1]}))
    assert response.a1_time_ms is None and response.a2_velocity_m_s is None
    assert response.hc_radius_mm == pytest.approx(RESPONSE.hc_radius_mm, rel=0.02)
    assert any("backwards" in note for note in notes)


@pytest.mark.parametrize("stop", [60, 70])
def test_a_film_that_ends_in_the_dent_has_no_amplitude(stop):
    response, notes = told(seen(slice(0, stop)))
    assert response.deformation_amplitude_mm is None and any("ends" in note for note in notes)
    assert response.a1_time_ms == pytest.approx(RESPONSE.a1_time_ms, abs=0.02)


@pytest.mark.parametrize("thickness_um", [252.0, 860.0])
def test_an_unusual_thickness_is_noted(thickness_um):
    response, notes = told(seen(thickness_mm=np.full(len(TIMES_MS), 1e-3 * thickness_um)))
    assert response.central_thickness_um == pytest.approx(thickness_um) and any("unusual" in note for note in notes)


def test_hidden_parts_leave_what_they_hide_blank():
    hidden = np.where(TIMES_MS < 6.0, 4.0, 0.0)
    response, notes = told(seen(hidden_mm=hidden))
    assert response.deformation_amplitude_mm is None and response.a1_time_ms is not None
    hidden = np.where(np.abs(TIMES_MS - RESPONSE.a1_time_ms) < 1.0, 2.0, 0.0)
    response, notes = told(seen(hidden_mm=hidden))
    assert response.a1_time_ms is None and response.deformation_amplitude_mm is not None


def test_frames_that_do_not_follow_are_found_and_no_others():
    random = np.random.default_rng(5)
    height = truth(EYE, EYE.scene()).height_mm.copy()
    keep = np.sort(random.choice(len(TIMES_MS), 110, replace=False))
    assert following(TIMES_MS[keep], height[keep]).all()
    bad = random.choice(len(TIMES_MS), 12, replace=False)
    height[bad] += random.choice([-1.0, 1.0], 12)[:, None] * random.uniform(0.2, 1.5, 12)[:, None]
    found = ~following(TIMES_MS, height)
    assert found[bad].all() and found.sum() <= len(bad) + 3


DENT = np.exp(-(((TIMES_MS[::3] - 16.0) / 5.0) ** 2))


def band(folder, row, thick_px=20.0):
    """A folder of frames with a lit band under row(k) [columns]."""
    random = np.random.default_rng(2)
    for k in range(len(DENT)):
        below = np.arange(200)[:, None] - row(k)
        level = 7.0 + 55.0 * ((below > 0) & (below < thick_px)) + 30.0 * np.exp(-0.5 * ((below - 2.5) / 2.2) ** 2)
        level += 3.0 * random.standard_normal(level.shape)
        Image.fromarray(np.clip(level, 0, 255).astype(np.uint8)).save(folder / f"{3 * k:03d}.png")
    return folder


@pytest.mark.parametrize(
    "row",
    [
        lambda k: 40.0 + 60.0 * DENT[k] + 0.0 * X,
        lambda k: 90.0 + 9.6 * X + 60.0 * DENT[k],
        lambda k: 60.0 + 15.0 * np.sin(X / 0.63) + 60.0 * DENT[k],
        lambda k: 20.0 + 19.0 * np.abs(X) * (1.0 - DENT[k]) + 60.0 * DENT[k],
        lambda k: 100.0 - CAP_PX - 60.0 * DENT[k],
        lambda k: CAP_PX + 10.0 + 70.0 * np.random.default_rng(k).random(),
        lambda k: CAP_PX + 16.0 + 60.0 * DENT[k],
    ],
    ids=["flat", "tilted", "sine", "V", "bowl", "jumping", "a cap that moves as a whole"],
)
def test_what_moves_but_is_no_cornea_is_refused(tmp_path, row):
    with pytest.raises(FilmError, match="no cornea|no air puff"):
        analyze(band(tmp_path, row), write=False)


@pytest.mark.parametrize("thick_px", [4.0, 70.0])
def test_a_band_without_the_thickness_of_a_cornea_is_refused(tmp_path, thick_px):
    with pytest.raises(FilmError, match="no cornea"):
        analyze(
            band(tmp_path, lambda k: CAP_PX + 16.0 + 60.0 * DENT[k] * np.exp(-((X / 1.7) ** 2)), thick_px), write=False
        )


@pytest.mark.parametrize("turned", [lambda f: f[:, ::-1], lambda f: f[:, ::-1, ::-1], lambda f: f.transpose(0, 2, 1)])
def test_an_eye_upside_down_or_on_its_side_is_refused(tmp_path, turned):
    for k, frame in enumerate(turned(made_up.draw(EYE, made_up.Look(), 540.0, 1, which=slice(None, None, 6)))):
        Image.fromarray(frame).save(tmp_path / f"{TIMES_MS[6 * k]:.2f}ms.png")
    with pytest.raises(FilmError, match="no cornea|shape of the instrument"):
        analyze(tmp_path, write=False)


def test_a_history_that_jumps_has_no_parameters():
    curves = seen()
    late = TIMES_MS > RESPONSE.hc_time_ms + 0.3
    height = np.where(late[:, None], curves.height_mm[0], curves.height_mm)
    response, notes = told(Curves(**{**vars(curves), "height_mm": height}))
    assert response.deformation_amplitude_mm is None and response.a2_time_ms is None
    assert response.central_thickness_um == pytest.approx(550.0)
    assert any("jumps" in note for note in notes)
