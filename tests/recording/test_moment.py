"""What a film frame shows of the air."""

from types import SimpleNamespace

import numpy as np
import pytest

from taichi_eye.eye.eye import eye_of
from taichi_eye.recording.observer import Moment
from taichi_eye.scene import load_scene


def moment(depth_mm, *keys):
    eye = eye_of(load_scene(None, keys))
    wall = eye.section.cornea_nodes(30)
    wall[:, 1] -= 1e-3 * depth_mm * np.exp(-((wall[:, 0] / 2e-3) ** 2))
    place = SimpleNamespace(to_numpy=lambda: wall)
    simulation = SimpleNamespace(eye=eye, time_ms=15.0, wall_count=31, cornea=SimpleNamespace(place=place))
    return Moment(SimpleNamespace(simulation=simulation), 0), eye.section.cornea_nodes(30)[:, 0]


@pytest.mark.parametrize("feedback", [0.3, 0.6])
def test_the_jet_is_drawn_as_wide_as_the_dent_makes_it(feedback):
    keys = ("puff.radial_profile=gaussian", "puff.width_mm=1.5", f"puff.dent_feedback={feedback}")
    widths = []
    for depth in (0.0, 1.0):
        shown, r = moment(depth, *keys)
        widths.append(1e3 * r[5] / np.sqrt(-np.log(shown.load[5])))
    # 1.5 mm over 1 + c D kappa, kappa of the cap of 7.8 mm at first; then the wall is hollow
    assert widths[0] == pytest.approx(1.5 / (1.0 + feedback * 2.4 / 7.8), rel=5e-3)
    assert widths[1] > 1.5
    assert moment(1.0)[0].load is None
