"""One view shows any scene that fits into its fields, with the pixels of a view of that scene's own."""

import numpy as np

from taichi_eye.film import FilmView
from taichi_eye.lang import program
from taichi_eye.scene import load_scene

WIDE = ("camera.view=scheimpflug",)
OTHERS = (
    ("camera.width_px=300", "camera.height_px=150", "camera.apex_column_px=100", "camera.pixel_x_mm=0.03"),
    ("camera.angle_deg=60", "camera.refractive_index=1.3", "cornea.radius_mm=9", "cornea.thickness_mm=0.4"),
    ("camera.noise=false", "camera.iris=false", "camera.lens=false", "camera.seed=7"),
)


def test_another_camera_takes_over_the_fields_and_leaves_no_trace(synthetic_eye):
    first, *eyes = (synthetic_eye((*WIDE, *overrides)) for overrides in ((), *OTHERS))
    view = FilmView(first.scene)
    shown = view.render(first.state)
    trees = program().get_snode_tree_size()
    for eye in eyes:
        assert FilmView.capacities(eye.scene) == FilmView.capacities(first.scene)
        view.setup(eye.scene)
        other = view.render(eye.state)
        assert other.shape == (eye.scene.camera.height_px, eye.scene.camera.width_px)
        assert program().get_snode_tree_size() == trees
        assert not np.array_equal(other, shown)
    own = FilmView(eye.scene)
    np.testing.assert_array_equal(own.render(eye.state), other)
    own.setup(first.scene)
    np.testing.assert_array_equal(own.render(first.state), shown)


def test_a_larger_frame_asks_for_larger_fields():
    small, large = (load_scene(None, (f"camera.width_px={w}",)) for w in (576, 3000))
    assert FilmView.capacities(small) < FilmView.capacities(large)
    assert all(held >= needed for held, needed in zip(FilmView.capacities(large), (0, 3000 * 200, 0)))
