"""Eyes whose apex moves in closed form, in place of the rungs: what an estimate of them must be is known."""

import numpy as np

from taichi_eye.estimation import fit
from taichi_eye.estimation.motion import Motion
from taichi_eye.estimation.observation import of_history
from taichi_eye.scene import load_scene

TIMES_MS = 0.2315 * np.arange(139)
BASE = load_scene(None, ["chamber.compliance_mm3_mmhg=0.1", "numerics.spacing_mm=0.25"])


def apex_mm(scene, time_ms=TIMES_MS, late_ms=0.0, deeper=1.0):
    """Depth falls with the pressure, the flanks steepen with the stiffness, the globe makes the fall late."""
    iop, stiff = scene.eye.iop_mmhg, scene.cornea.stiffness_a_pa / BASE.cornea.stiffness_a_pa
    globe = scene.chamber.compliance_mm3_mmhg * iop / 1.5
    puff = scene.puff.peak_kpa / BASE.puff.peak_kpa
    rise, fall = (
        9.0 + 0.12 * (iop - 15.0) - 0.5 * (puff - 1.0) + late_ms,
        20.5 - 0.1 * (iop - 15.0) + 0.8 * (globe - 1.0),
    )
    depth = deeper * 0.95 * puff**0.9 * (15.0 / iop) ** 0.6 * stiff**-0.1
    width = 2.0 * stiff**0.3
    return 0.5 * depth * (np.tanh((time_ms - rise) / width) - np.tanh((time_ms - fall) / 1.6))


def motion(scene, **other):
    """The motion of a scene."""
    time = np.linspace(0.0, 32.0, 1281)
    return Motion(scene, time, apex_mm(scene, time, **other), np.empty(0), np.empty((0, 0, 2)))


def use(monkeypatch, fine=lambda scene: motion(scene)):
    """Put the closed form in place of the runs."""
    monkeypatch.setattr(fit, "cheap", lambda scene, rung="cavity": motion(scene))
    monkeypatch.setattr(fit, "fine", fine)
    monkeypatch.setattr(fit, "fine_apices", lambda scenes: [fine(scene) for scene in scenes])


def seen(scene, seed, noise_mm=0.01, name="eye", **other):
    """The eye as a camera sees it."""
    noise = np.random.default_rng(seed).standard_normal(len(TIMES_MS))
    return of_history(name, TIMES_MS, apex_mm(scene, **other) + noise_mm * noise, False, noise_mm)
