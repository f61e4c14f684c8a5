"""Public tables beside the model: living eyes by bIOP, donor corneas inflated without a puff, a stiffened globe, and
keratoconic eyes beside healthy ones.

groups    eyes of the scene at rising pressures, until what the instrument would show covers the groups of 194 living
          eyes; each parameter at the group's bIOP on straight lines between them. Within one standard deviation between
          eyes of a group or not.
donors    apex rise per mmHg of the scene's cornea, inflated slowly from 10 to 30 mmHg (`taichi_eye.proof.donor`).
diseased  a keratoconic scene's eye beside a healthy one: each published difference has the right sign.
stiff     the scene with 30 % less compliance of the globe: DA and PD fall, SP-A1 stays within 5 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from taichi_eye.analysis.simulated import Reading, response_of
from taichi_eye.eye.eye import eye_of
from taichi_eye.proof import clinic
from taichi_eye.proof.donor import apex_rise, free_sphere
from taichi_eye.proof.population import SimulatedEye, at_biop, shown_by, simulate
from taichi_eye.scene import Scene
from taichi_eye.units import MMHG

SWEEP_MMHG = 4.0  # between two eyes of the groups
LEAST_MMHG, MOST_MMHG = 2.0, 45.0  # pressures that the groups may ask for
STIFFER = 0.7  # compliance of a stiffened globe over that of the scene's
UNCHANGED = 0.05
NM = 1e-9


@dataclass(frozen=True)
class GroupRow:
    """A parameter by bIOP: measured means and computed values, None where no simulated eye shows that bIOP.

    spread: standard deviation between living eyes of a group; eyes: the simulated ones, (bIOP, value).
    """

    name: str
    measured: tuple[float, ...]
    spread: float
    computed: tuple[float | None, ...]
    eyes: tuple[tuple[float, float], ...]

    @property
    def holds(self) -> bool:
        """Whether every group lies within the standard deviation between eyes."""
        return all(
            found is not None and abs(found - mean) <= self.spread for found, mean in zip(self.computed, self.measured)
        )


@dataclass(frozen=True)
class DonorRow:
    """Apex rise [nm/mmHg] of the inflated cornea, and of a whole sphere of its tissue in closed form.

    None where such a cornea does not come to rest between the two pressures.
    """

    computed: float | None
    free_sphere: float | None

    @property
    def holds(self) -> bool:
        """Whether it lies among the measured ones."""
        least, most = clinic.DONOR_NM_PER_MMHG
        return self.computed is not None and least <= self.computed <= most


@dataclass(frozen=True)
class StiffRow:
    """A parameter of the eye, and with the stiffened globe."""

    name: str
    before: float | None
    after: float | None

    @property
    def holds(self) -> bool:
        """Whether it fell; SP-A1: whether it stayed."""
        if self.before is None or self.after is None:
            return False
        if self.name == "sp_a1_mmhg_mm":
            return abs(self.after / self.before - 1.0) <= UNCHANGED
        return self.after < self.before


@dataclass(frozen=True)
class DiseaseRow:
    """A parameter of a healthy and of a keratoconic eye, computed and published means."""

    name: str
    healthy: float | None
    ill: float | None
    published_healthy: float
    published_ill: float

    @property
    def share(self) -> float | None:
        """The computed difference over the published one; None where an eye does not show the parameter."""
        if self.healthy is None or self.ill is None:
            return None
        return (self.ill - self.healthy) / (self.published_ill - self.published_healthy)

    @property
    def holds(self) -> bool:
        """Whether the difference has the published one's sign."""
        return self.share is not None and self.share > 0.0


def diseased(healthy: Reading, ill: Reading) -> list[DiseaseRow]:
    """Every published parameter of two readings; a run that was stopped shows what it showed before."""
    return [
        DiseaseRow(name, getattr(healthy.response, name), getattr(ill.response, name), *means)
        for name, means in clinic.KERATOCONUS.items()
    ]


def sweep(
    scene: Scene, known: list[SimulatedEye], run: Callable[[Scene, float, float], SimulatedEye] = simulate
) -> list[SimulatedEye]:
    """Eyes of the scene's thickness and rising pressure whose bIOPs cover the groups, as far as there are such eyes.

    known: eyes of that thickness that were run already.
    """
    eyes, thickness = sorted(known, key=lambda eye: eye.iop_mmhg), 1e3 * scene.cornea.thickness_mm
    # upwards first, then downwards: the eyes are in the order of their pressures
    while not _shows(eyes[-1], clinic.GROUPS_MMHG[-1], 1.0) and eyes[-1].iop_mmhg + SWEEP_MMHG <= MOST_MMHG:
        eyes.append(run(scene, eyes[-1].iop_mmhg + SWEEP_MMHG, thickness))
    while not _shows(eyes[0], clinic.GROUPS_MMHG[0], -1.0) and eyes[0].iop_mmhg - SWEEP_MMHG >= LEAST_MMHG:
        eyes.insert(0, run(scene, eyes[0].iop_mmhg - SWEEP_MMHG, thickness))
    return eyes


def _shows(eye: SimulatedEye, biop_mmhg: float, sign: float) -> bool:
    shown = eye.response.biop_mmhg
    return shown is not None and sign * shown >= sign * biop_mmhg


def groups(eyes: list[SimulatedEye]) -> list[GroupRow]:
    """Every parameter of the groups, from eyes of rising pressure."""
    return [
        GroupRow(
            name,
            measured,
            clinic.GROUPS_SD[name],
            tuple(at_biop(eyes, name, centre) for centre in clinic.GROUPS_MMHG),
            tuple(shown_by(eyes, name)),
        )
        for name, measured in clinic.GROUPS.items()
    ]


def donors(scene: Scene) -> DonorRow:
    """The scene's cornea inflated as donor corneas were."""
    eye, (low, high) = eye_of(scene), (pressure * MMHG for pressure in clinic.DONOR_MMHG)
    per_mmhg = (clinic.DONOR_MMHG[1] - clinic.DONOR_MMHG[0]) * NM
    try:
        return DonorRow(apex_rise(eye, low, high) / per_mmhg, free_sphere(eye, low, high) / per_mmhg)
    except ArithmeticError:
        return DonorRow(None, None)


def stiffened(scene: Scene, own: SimulatedEye) -> list[StiffRow]:
    """The scene with a stiffer globe beside its own eye; no rows where the globe does not yield."""
    if not scene.chamber.compliance_mm3_mmhg > 0.0:
        return []
    stiff = response_of(scene.but({"chamber.compliance_mm3_mmhg": STIFFER * scene.chamber.compliance_mm3_mmhg}))
    return [
        StiffRow(name, getattr(own.response, name), None if stiff.stopped else getattr(stiff.response, name))
        for name in ("deformation_amplitude_mm", "peak_distance_mm", "sp_a1_mmhg_mm")
    ]
