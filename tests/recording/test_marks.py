"""The marks of a film: the curvature that they go by, and the bar, as long as it says."""

import numpy as np
import pytest

import taichi_eye
from taichi_eye.film import FilmView
from taichi_eye.recording.marks import curvature
from taichi_eye.recording.observer import Moment, Recording

WORDS = ["numerics.fidelity=cavity", "numerics.spacing_mm=0.25", "camera.view=scheimpflug", "camera.noise=false"]


def test_curvature_is_that_of_the_sphere():
    radius = 5.0 + 5.0 * np.random.default_rng().random()
    r = np.linspace(0.0, 3.0, 40)
    assert curvature(np.column_stack([r, np.sqrt(radius**2 - r**2)])) == pytest.approx(1.0 / radius, rel=0.02)


def test_the_bar_is_a_millimetre_and_the_rest_of_the_frame_stays():
    plain, marked = (
        taichi_eye.load_scene("seed", [*WORDS, f"camera.marks={marks}", "camera.pixel_x_mm=0.02"])
        for marks in ("false", "true")
    )
    eye = taichi_eye.simulation_of(plain)
    frames = []
    for scene in (plain, marked):
        recording = Recording(None, None, scene, eye)
        recording.__dict__["view"] = FilmView(scene)
        frames.append(Moment(recording, 0).image.astype(int))
    changed = np.argwhere(frames[0] != frames[1])
    rows = plain.camera.height_px
    assert changed[:, 0].min() > 0.85 * rows and changed[:, 1].max() < 0.3 * plain.camera.width_px
    bar = np.flatnonzero(frames[1][rows - 5] == 205)
    assert (
        bar[0] == 6 and (np.diff(bar[: round(1 / 0.02)]) == 1).all() and bar[round(1 / 0.02) - 1] == 5 + round(1 / 0.02)
    )
