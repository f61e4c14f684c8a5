"""What `taichi-eye films` measures with: eyes in closed form, harms done to films, rows; and the frame's own rows."""

import numpy as np
import pytest

from taichi_eye.analysis import Response
from taichi_eye.bench.rows import within
from taichi_eye.proof import films
from taichi_eye.proof.films import PARTS, STANDARD, damaged, optics, reading
from taichi_eye.proof.films.eyes import EYES, TIMES_MS, TOP_MS, Eye, rows_px, truth, walls_mm
from taichi_eye.scene import load_scene


def test_a_figure_lies_within_its_range_give_or_take_the_slack():
    assert within("n", 4.0, "px", 5.0, 6.0, 1.0).holds and not within("n", 3.9, "px", 5.0, 6.0, 1.0).holds
    assert not within("n", float("nan"), "px", 5.0, 6.0, 1.0).holds
    assert (
        within("n", 5.0, "px", 5.0, 5.0, 0.0).asked == "5"
        and within("n", 5.0, "px", 5.0, 6.0, 1.0).asked == "5 to 6 +- 1"
    )


@pytest.mark.parametrize("eye", EYES, ids=lambda eye: eye.name)
def test_eyes_start_at_rest_and_dent_as_deep_as_they_say(eye):
    assert eye.dent_mm(0.0) == 0.0 and eye.dent_mm(TOP_MS) == pytest.approx(eye.depth_mm)
    assert eye.dent_mm(TIMES_MS).max() < 1.05 * eye.depth_mm and abs(eye.dent_mm(TIMES_MS[-1])) < 0.02 * eye.depth_mm
    scene = eye.scene()
    wall = eye.wall_mm(scene, 0.0)
    sphere = np.hypot(wall[:, 0], wall[:, 1] + np.sqrt(scene.cornea.radius_mm**2 - scene.cornea.limbus_radius_mm**2))
    assert sphere == pytest.approx(scene.cornea.radius_mm)


def test_truth_and_rows_hold_dent_and_retreat():
    eye = Eye("retreats", 0.8, bulge=0.0, overrides=("eye.whole_eye_movement_mm=0.3",))
    scene = eye.scene()
    moved = walls_mm(eye, scene)[0, 0, 1] - walls_mm(eye, scene)[:, 0, 1]
    curves = truth(eye, scene)
    middle = len(curves.x_mm) // 2
    assert -curves.height_mm[:, middle] == pytest.approx(moved, abs=1e-9)
    rows = rows_px(eye, scene)
    assert rows[:, 288] - 16.0 == pytest.approx(moved / 0.0165, abs=1e-6)
    assert moved.max() > 1.0


def test_a_turned_film_shows_a_line_under_the_angle_in_millimetres():
    frames = np.zeros((1, 200, 576), np.uint8)
    frames[0, 98:102] = 200
    image = np.maximum(damaged.turned(frames, 5.0)[0].astype(float) - 50.0, 0.0)  # without the filling
    columns = np.array([100, 470])
    rows = np.array([np.arange(200) @ image[:, k] / image[:, k].sum() for k in columns])
    slope = np.diff(rows)[0] * 0.0165 / (np.diff(columns)[0] * 0.015625)
    assert abs(slope) == pytest.approx(np.tan(np.radians(5.0)), rel=0.02)
    assert rows.mean() == pytest.approx(99.5, abs=1.0)


def test_harms_do_what_they_say():
    frames = np.random.default_rng(0).integers(0, 60, (139, 200, 576)).astype(np.uint8)
    kept = damaged.dropped(frames)
    assert 115 <= len(kept) <= 132 and np.array_equal(kept[0], frames[0])
    assert (damaged.logo(frames[:1])[0, 165:195, 6:116] == 235).mean() > 0.3
    assert damaged.jpeg(frames[:1]).shape == (1, 200, 576) and not np.array_equal(damaged.jpeg(frames[:1]), frames[:1])


def test_differences_and_the_worst_film():
    read, true = (
        Response(hc_radius_mm=7.2, deformation_amplitude_mm=1.01),
        Response(hc_radius_mm=7.5, deformation_amplitude_mm=1.0),
    )
    assert reading.difference(read, true, "hc_radius_mm", "%") == pytest.approx(4.0)
    assert reading.difference(read, true, "deformation_amplitude_mm", "um") == pytest.approx(10.0)
    assert reading.difference(Response(), true, "hc_radius_mm", "%") == float("inf")
    read_films = [("a", {"q": 1.0}), ("b", {"q": 3.0}), ("c", {"q": 2.0})]
    row = reading.worst(read_films, "q", "px", 2.5)
    assert row.value == 3.0 and row.holds is False and "worst: b" in row.note and "median 2" in row.note
    assert reading.worst(read_films, "q", "%", 1.0, least=True).holds


def test_every_row_of_the_frame_holds():
    rows, figures = optics.measure(lambda text: None)
    assert [row.name for row in rows if row.holds is False] == [] and len(figures) == 1
    assert load_scene().cornea.thickness_mm == 0.55 and list(PARTS) == [
        "optics",
        "reading",
        "damaged",
        "back_edges",
        "obstacles",
        "mutations",
        "speed",
    ]


def test_long_studies_run_only_when_named(monkeypatch):
    asked = []
    monkeypatch.setattr(films.bench, "report", lambda only, *_, **__: asked.append(tuple(only)) or True)
    films.report()
    films.report(("mutations",))
    assert asked == [("optics", "reading", "damaged", "speed"), ("mutations",)] and asked[0] == STANDARD
    assert set(PARTS) - set(STANDARD) == {"back_edges", "obstacles", "mutations"}
