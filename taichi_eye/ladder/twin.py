"""A run's twin: the same scene on coarser settings, whose difference from the run tells the run's numerical error.

The errors of every rung fall as the square of the spacing, those of `mfpm` also as the inverse square of the sound
speeds. A twin is coarser in all of them by one ratio q, so one difference tells both: the run's error is
share = 1 / (q^2 - 1) times twin less run, and run less that is Richardson's limit. q is that of the elements of both
walls, which are whole numbers: about RATIO, at which a twin takes three quarters of the time of a wall alone, which is
milliseconds, and some third of that of the resolved liquid; less where the chamber takes no coarser nodes, or the twin
would have fewer than LEAST elements.

How good the bars are that `taichi_eye.analysis.error_bar` makes of it: `taichi-eye check error-bars`.
"""

import math
from dataclasses import dataclass

from taichi_eye.cloud.packing import cornea_elements
from taichi_eye.errors import SceneError
from taichi_eye.eye.eye import eye_of
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.rungs import RUNGS
from taichi_eye.scene import Scene
from taichi_eye.scene.resolve import coarsest_spacing_mm
from taichi_eye.solver.scheme import clock_of
from taichi_eye.units import MM

RATIO = 2.0  # of coarser over own settings, where the eye takes it
CLOSEST = 1.25  # of runs that lie nearer, noise is most of the difference
LEAST = 8  # elements of a twin's wall


@dataclass(frozen=True)
class Twin:
    """A coarser scene, and the ratio of its settings to those of the run."""

    scene: Scene
    ratio: float

    @property
    def share(self) -> float:
        """The run's error over the difference between twin and run."""
        return 1.0 / (self.ratio**2 - 1.0)


def twin_of(scene: Scene) -> Twin:
    """The twin of a resolved scene of a decided fidelity; SceneError where the eye takes no coarser spacing."""
    numerics, section = scene.numerics, eye_of(scene).section
    packed = RUNGS[numerics.fidelity].packs_nodes
    if clock_of(scene).samples < 1:
        raise SceneError(
            f"numerics.duration_ms = {numerics.duration_ms:g}, numerics.error_bar = true: is shorter than the time "
            "between two samples, so there is no history to compare"
        )
    elements = cornea_elements(section, numerics.spacing_mm * MM)
    least = LEAST
    if packed:
        widest = coarsest_spacing_mm(scene.values()) / numerics.spacing_mm
        least = max(LEAST, math.ceil(elements / widest))
    ratio = elements / max(round(elements / RATIO), least)
    if ratio < CLOSEST:
        raise SceneError(
            f"numerics.spacing_mm = {numerics.spacing_mm:g}, numerics.error_bar = true: the error bar needs a run of "
            f"a spacing {CLOSEST:g} times as wide beside this one, which this eye does not take; at most "
            f"{section.cornea_length / MM / math.ceil(CLOSEST * least):.3g} mm"
        )
    changes = {"spacing_mm": numerics.spacing_mm * ratio, "error_bar": False}
    if numerics.fidelity == "mfpm":
        changes["sound_speed_m_s"] = numerics.sound_speed_m_s / ratio
        changes["mean_sound_speed_m_s"] = numerics.mean_sound_speed_m_s / ratio
    if packed:
        return Twin(with_numerics(scene, **changes), ratio)
    # a wall alone may be coarser than a chamber with nodes would take
    changes = {f"numerics.{name}": value for name, value in changes.items()}
    return Twin(scene.but(changes, within_limits=False), ratio)
