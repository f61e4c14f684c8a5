"""How a scene is discretised, in SI: the only reader of [numerics] and of the film's times in the solver.

`scheme_of(scene)` gives the resolutions, speeds and switches, `clock_of(scene)` the times at which anything is
recorded.
"""

import math
from dataclasses import dataclass

import numpy as np

from taichi_eye.scene import Scene
from taichi_eye.scene.budget import SAMPLE_MS
from taichi_eye.units import MM, MS


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Lengths in m, speeds in m/s; the meaning of each stands beside its key in `taichi_eye.scene.schema`."""

    spacing: float
    basis: str
    sound_speed: float
    mean_sound_speed: float
    cfl: float
    dissipation: float
    no_slip: bool
    iterated: bool
    aitken: bool
    relaxation_factor: float
    coupling_tolerance: float
    coupling_iterations_max: int
    refresh_travel: float

    @property
    def refresh_distance(self) -> float:
        """Travel of the cornea [m] after which weights or flow maps are made anew."""
        return self.refresh_travel * self.spacing

    @property
    def dissipation_length(self) -> float:
        """alpha c h [m^2/s], the coefficient of the fourth-difference dissipation."""
        return self.dissipation * self.sound_speed * self.spacing


def scheme_of(scene: Scene) -> Scheme:
    """The discretisation that a resolved scene asks for."""
    numerics = scene.numerics
    return Scheme(
        spacing=numerics.spacing_mm * MM,
        basis=numerics.basis,
        sound_speed=numerics.sound_speed_m_s,
        mean_sound_speed=numerics.mean_sound_speed_m_s,
        cfl=numerics.cfl,
        dissipation=numerics.dissipation,
        no_slip=numerics.wall_condition == "no_slip",
        iterated=numerics.coupling == "iterated",
        aitken=numerics.relaxation == "aitken",
        relaxation_factor=numerics.relaxation_factor,
        coupling_tolerance=numerics.coupling_tolerance,
        coupling_iterations_max=numerics.coupling_iterations_max,
        refresh_travel=numerics.refresh_travel,
    )


@dataclass(frozen=True)
class Clock:
    """Film frames, cut into equal samples of at most `SAMPLE_MS`, at each of which the traces have a row.

    sample_ms: time between samples; samples: of the whole run, the one at rest aside; samples_per_frame; frames: of the
    film, the first at rest.
    """

    sample_ms: float
    samples: int
    samples_per_frame: int
    frames: int

    @property
    def sample_s(self) -> float:
        """Time between samples [s]."""
        return self.sample_ms * MS

    def times_ms(self, samples: int) -> np.ndarray:
        """Times [ms] of the first so many samples."""
        return np.arange(samples) * self.sample_ms

    def frame_of(self, sample: int) -> int | None:
        """The film frame that is taken at a sample, None where none is."""
        frame, rest = divmod(sample, self.samples_per_frame)
        return frame if rest == 0 and frame < self.frames else None


def clock_of(scene: Scene) -> Clock:
    """The times of a resolved scene."""
    interval = scene.camera.frame_interval_ms
    per_frame = max(1, math.ceil(interval / SAMPLE_MS - 1e-9))
    sample_ms = interval / per_frame
    samples = math.floor(scene.numerics.duration_ms / sample_ms + 1e-9)
    return Clock(sample_ms, samples, per_frame, min(scene.camera.frame_count, samples // per_frame + 1))
