"""Short forms of the random studies of `taichi-eye films`, their verdicts asserted; and the cases they grew from."""

import numpy as np
import pytest

from taichi_eye.analysis import Instrument, curves_from_edges, find_edges, histories, optics, respond
from taichi_eye.analysis.curves import grid
from taichi_eye.analysis.plausible import believed
from taichi_eye.proof.films import back_edges, made_up, mutations, obstacles, reading
from taichi_eye.proof.films.eyes import EYES, TIMES_MS, truth, walls_mm


def broken(rows):
    return [f"{row.name}: {row.value:.3g} {row.note}" for row in rows if row.holds is False]


def test_back_edges_drawn_at_random():
    rows, _ = back_edges.measure(lambda text: None, films=5, seed=2)
    assert broken(rows) == []


@pytest.mark.parametrize("number", range(len(EYES)))
def test_the_made_up_back_is_seen_at_the_thickness_that_was_asked_for(number):
    # at rest and in the deepest dent, whose radius in the narrowest eye is 1 mm
    walls = walls_mm(EYES[number], EYES[number].scene())[[0, 72, 84]]
    inner, at, camera = grid(), np.linspace(-4.0, 4.0, 17), Instrument()
    height = np.stack([np.interp(np.abs(inner), r, z) for r, z in walls.transpose(0, 2, 1)])
    apparent = np.stack([np.interp(at, inner, one) for one in height])
    apparent -= camera.pixel_y_mm * made_up.apparent_depth_px(at, height, 600.0)
    seen = optics.thickness(inner, height, at, apparent, camera.angle_deg, camera.refractive_index)
    np.testing.assert_allclose(1e3 * seen, 600.0, atol=0.1)


def test_obstacles_drawn_at_random():
    rows, _ = obstacles.measure(lambda text: None, films=2, seed=3)
    assert broken(rows) == []


def test_mutated_inputs():
    rows, _ = mutations.measure(lambda text: None, inputs=10, seed=4)
    assert broken(rows) == []
    assert 0 < rows[-1].value < 10


def test_reading_of_a_thin_and_of_a_thick_eye():
    # the thin one dents far, so that its back is seen short and iris and lens close behind it
    rows, _ = reading.measure(lambda text: None, which=[(9, 2), (1, 1)])
    assert broken(rows) == []


@pytest.mark.parametrize("back_sigma_px, seam", [(0.8, 0.0), (1.5, 4.0), (1.5, -6.0), (3.5, 4.0)])
def test_a_sharp_back_or_a_seam_before_it_does_not_thin_the_cornea(back_sigma_px, seam):
    look = made_up.Look(back_sigma_px=back_sigma_px, seam=seam, noise=4.0)
    frames = made_up.draw(EYES[0], look, 535.0, 7, which=slice(None, None, 6))
    curves = curves_from_edges(find_edges(frames), TIMES_MS[::6], Instrument())
    assert respond(curves).central_thickness_um == pytest.approx(535.0, abs=15.0)


@pytest.mark.parametrize(
    "bars",
    [
        [((13.5, 270), (13.5, 309), 8, 200, (0, 0))],
        [((13.5, 270), (13.5, 309), 8, 75, (0, 0))],
        [((5, 200), (60, 330), 5, 150, (0, 0))],
        [((20, 100), (90, 180), 4, 120, (10, 60)), ((0, 330), (80, 380), 4, 110, (0, 0))],
    ],
    ids=["over the apex", "faint", "slanted", "several, one moving"],
)
def test_the_edge_does_not_climb_a_lash(bars):
    eye = EYES[0]
    frames = made_up.draw(eye, obstacles.LOOK, 540.0, 3, which=slice(None, None, 2))
    for start, stop, width_px, level, drift in bars:
        made_up.lash(frames, start, stop, width_px, level, drift)
    curves = curves_from_edges(find_edges(frames), TIMES_MS[::2], Instrument())
    read, notes = believed(respond(curves), curves, histories(curves), "counting")
    true, said = respond(truth(eye, eye.scene())), [*curves.notes, *notes]
    for name, limit in (("deformation_amplitude_mm", 0.02), ("a1_time_ms", 0.25), ("a2_time_ms", 0.25)):
        if getattr(read, name) is None:
            assert any(name in note for note in said) and any("masked" in note for note in said)
        else:
            assert getattr(read, name) == pytest.approx(getattr(true, name), abs=limit), name


def test_made_up_films_hold_the_depth_that_a_thickness_shows():
    from taichi_eye.analysis import optics
    from taichi_eye.analysis.curves import grid

    height = np.sqrt(7.8**2 - grid() ** 2)[None] - 7.8
    x = np.array([-1.0, 0.0, 2.0])
    depth = made_up.apparent_depth_px(x, height, 500.0) * Instrument().pixel_y_mm
    seen = optics.thickness(grid(), height, x, np.interp(x, grid(), height[0]) - depth, 45.0, 1.376)
    assert seen[0] == pytest.approx(0.5, abs=1e-4)
    assert depth[0, 1] / 0.5 == pytest.approx(0.627, abs=0.01)
