"""How an eye moves, as the estimate runs it: the apex at every sample and the wall at every film frame.

Three models of one scene. `cheap` is the cavity rung, on few elements for the search's beginning, or added mass on a
coarse cloud, for its end; both with the compliance that the full model's speed of sound gives the chamber (their own
would be stiffer, and the dent 2 % shallower). `fine` is the rung that the scene asks for, run a few times an estimate
for what the cheap ones leave out. Lobes of a folding shell are not asked of the cheap ones, where they would cost ten
times the run; the fine one is a run like any other, its guards included.

Measured on three clinical eyes: the cavity is 7 to 15 um (rms) off the full model on 14 elements as on 32, and a run
takes 0.03 s instead of 0.1; added mass is 1 to 2 um off on 20 elements and on 24, in 0.09 and 0.13 s, its slopes with
the pressure 1.5 to 6 % off; on 16 elements they are 3 to 13 % off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from taichi_eye.analysis.curves import REST_MS, SMOOTH_MM, X_STEP_MM, Curves, curves_from_wall, grid
from taichi_eye.analysis.response import SIDE_MM, Histories, histories
from taichi_eye.analysis.simulated import FRAMES_LEAST
from taichi_eye.cloud.packing import packed
from taichi_eye.eye.eye import REFERENCE_IOP, Eye, eye_of
from taichi_eye.ladder.batches import run_batch
from taichi_eye.ladder.choose import choose
from taichi_eye.ladder.trial import run_scene, run_to_stop
from taichi_eye.scene import Scene
from taichi_eye.solver.reduced import AddedMass, Cavity, Membrane
from taichi_eye.units import MM, MM3, MMHG, MS

ROUGH = "rough"  # the cavity rung where a search begins
ELEMENTS = {ROUGH: 16, "membrane": 32, "cavity": 32, "added_mass": 20}
RUNS = {ROUGH: Cavity, "membrane": Membrane, "cavity": Cavity, "added_mass": AddedMass}
TRAVEL = 1.5  # of the wall in spacings between two flow maps: 0.5 um of the apex, and half the time
FRIEDENWALD_MMHG = REFERENCE_IOP / MMHG  # at which such a globe is named
BETWEEN = 12  # places between two nodes of a wall that its curve is taken at


@dataclass(frozen=True, eq=False)
class Motion:
    """time_ms, apex_mm [samples]: of the apex from its place at rest, inward positive, without the eye's retreat;
    frame_ms [frames], walls_mm [frames, nodes, 2]: places (r, z) of the wall; stopped: why it ended early, or empty."""

    scene: Scene
    time_ms: np.ndarray
    apex_mm: np.ndarray
    frame_ms: np.ndarray
    walls_mm: np.ndarray
    stopped: str = ""

    @cached_property
    def eye(self) -> Eye:
        """The eye that moved."""
        return eye_of(self.scene)

    def retreat_mm(self, time_ms: np.ndarray) -> np.ndarray:
        """How far the whole eye has gone back."""
        return self.eye.retreat(np.asarray(time_ms) * MS) / MM

    @cached_property
    def curves(self) -> Curves | None:
        """What a film without a camera would show, the retreat in it; None where there are too few frames."""
        if len(self.frame_ms) < FRAMES_LEAST:
            return None
        r, z = np.moveaxis(self.walls_mm, 2, 0)
        thickness = self.scene.cornea.thickness_mm
        return curves_from_wall(self.frame_ms, r, z - self.retreat_mm(self.frame_ms)[:, None], thickness)

    @cached_property
    def histories(self) -> Histories | None:
        """The histories of these curves."""
        return None if self.curves is None else histories(self.curves)

    @cached_property
    def deflection_mm(self) -> np.ndarray | None:
        """The deflection over `grid()` at every frame, [frames, points], as `taichi_eye.analysis` defines it; None
        where there are too few frames.

        What a film's reading takes a tenth of a second for, in a hundredth: a wall has no gaps, so all frames go at
        once. The retreat of the whole eye, being in no deflection, is left out.
        """
        if len(self.frame_ms) < FRAMES_LEAST:
            return None
        nodes = np.arange(self.walls_mm.shape[1])
        between = np.linspace(0.0, nodes[-1], BETWEEN * nodes[-1] + 1)
        r, z = np.moveaxis(CubicSpline(nodes, self.walls_mm, axis=1)(between), 2, 0)
        x = grid()
        half = x[x >= 0.0]
        right = np.stack([np.interp(half, *one) for one in zip(r, z)])
        height = np.hstack([right[:, :0:-1], right])
        length = 2 * round(0.5 * SMOOTH_MM / X_STEP_MM) + 1
        height = savgol_filter(height, length, 3, axis=1, mode="interp")
        deformation = height[self.frame_ms <= self.frame_ms[0] + REST_MS].mean(axis=0) - height
        flanks = (np.abs(x) >= SIDE_MM[0] - 1e-9) & (np.abs(x) <= SIDE_MM[1] + 1e-9)
        return deformation - deformation[:, flanks].mean(axis=1)[:, None]


def cheap(scene: Scene, rung: str = "cavity") -> Motion:
    """The scene's motion on a cheap rung, one of RUNS."""
    spacing = eye_of(scene).section.cornea_length / MM / ELEMENTS[rung]
    changes = {
        "numerics.fidelity": "cavity" if rung == ROUGH else rung,
        "numerics.spacing_mm": spacing,
        "numerics.refresh_travel": TRAVEL,
        **_softer(scene),
    }
    changed = scene.but(changes, within_limits=False)
    cloud = packed(eye_of(changed).section, spacing * MM) if rung == "added_mass" else None
    run = RUNS[rung](changed, cloud)
    run.judges_folding = False
    stop = run_to_stop(run)
    traces, (frame_ms, walls) = run.traces, run.wall_mm
    apex = np.array(traces["apex_displacement_mm"])
    return Motion(scene, np.array(traces["time_ms"]), apex, frame_ms, walls.copy(), str(stop) if stop else "")


def _softer(scene: Scene) -> dict[str, float]:
    """What makes a cheap rung's chamber yield as the full model's does by its numerical speed of sound."""
    if scene.numerics.fidelity != "mfpm" or not scene.chamber.sealed:
        return {}
    stiffness = scene.aqueous.density_kg_m3 * scene.numerics.mean_sound_speed_m_s**2
    give = eye_of(scene).section.volume() / stiffness / MM3 * MMHG
    if scene.chamber.globe_law == "friedenwald":
        give *= scene.eye.iop_mmhg / FRIEDENWALD_MMHG
    return {"chamber.compliance_mm3_mmhg": scene.chamber.compliance_mm3_mmhg + give}


def fine(scene: Scene) -> Motion:
    """The scene's motion on its own rung."""
    if scene.numerics.fidelity == "auto":
        scene = choose(scene).scene
    times, walls = [], []

    def keep(run, frame):
        times.append(run.time_ms)
        walls.append(run.cornea.place.to_numpy()[: run.wall_count] / MM)

    trial = run_scene(scene, on_frame=keep)
    traces, stop = trial.traces, trial.stop
    apex = np.array(traces["apex_displacement_mm"])
    return Motion(scene, np.array(traces["time_ms"]), apex, np.array(times), np.array(walls), str(stop) if stop else "")


def fine_apices(scenes: Sequence[Scene]) -> list[Motion]:
    """The motions of many scenes on their own rungs, their apices alone: side by side."""
    found = []
    for scene, outcome in zip(scenes, run_batch(scenes)):
        time, apex = (np.array(outcome.traces[name]) for name in ("time_ms", "apex_displacement_mm"))
        none = np.empty(0), np.empty((0, 0, 2))
        found.append(Motion(scene, time, apex, *none, str(outcome.stop) if outcome.stop else ""))
    return found
