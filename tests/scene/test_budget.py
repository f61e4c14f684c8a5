"""Memory and pixels of a run, estimated from its scene: refused over the budget, with the keys that ask for them."""

import pytest

from taichi_eye.errors import SceneError
from taichi_eye.film import FilmView
from taichi_eye.scene import load_scene
from taichi_eye.scene.budget import MEMORY_MAX, frame_pixels, memory


class Values(dict):
    """A draft's values, read as a draft's are."""


def values(scene):
    found = Values()
    for section in ("cornea", "chamber", "numerics", "camera"):
        found |= {f"{section}.{name}": value for name, value in vars(getattr(scene, section)).items()}
    return found


@pytest.mark.parametrize("view", ["scheimpflug", "particles", "both"])
@pytest.mark.parametrize("size", [(576, 200), (200, 640), (1024, 64)])
def test_pixels_of_a_frame_are_those_of_the_film(view, size):
    keys = [f"camera.view={view}", f"camera.width_px={size[0]}", f"camera.height_px={size[1]}"]
    scene = load_scene(None, [*keys, "camera.apex_column_px=99", "numerics.spacing_mm=0.3"])
    height, width, *_ = FilmView(scene).shape
    assert frame_pixels(values(scene)) == pytest.approx(width * height, rel=0.01)


@pytest.mark.parametrize(
    "keys, named",
    [
        (["numerics.fidelity=added_mass", "numerics.spacing_mm=0.01"], "numerics.spacing_mm"),
        (["camera.frame_interval_ms=0.001", "camera.frame_count=50000", "numerics.spacing_mm=0.01"], "frame_count"),
        (["camera.width_px=4096", "camera.height_px=4096", "camera.frame_interval_ms=0.001"], "camera.width_px"),
    ],
)
def test_over_the_budget_is_refused_with_the_keys_that_ask_for_it(keys, named):
    with pytest.raises(SceneError, match=f"{named}.*at most"):
        load_scene(None, keys)


@pytest.mark.parametrize("fidelity", ["membrane", "cavity", "added_mass", "mfpm"])
@pytest.mark.parametrize("key", ["numerics.spacing_mm=0.05", "camera.frame_interval_ms=0.01", "camera.width_px=2048"])
def test_what_people_run_is_within_it(fidelity, key):
    scene = load_scene(None, [key, f"numerics.fidelity={fidelity}"])
    assert sum(memory(values(scene)).values()) < 0.5 * MEMORY_MAX
