"""One eye under one puff, in SI: the only reader of the physics in a scene.

`eye_of(scene)` turns the user's mm, mmHg, MPa and ms into an `Eye`; solver, film and ladder take it from there. An Eye
is frozen, and what follows from its numbers is computed when it is asked for: `eye.but(iop=2500.0)` is another eye of
the same tissue whose prestrain carries the new pressure.

Some stiffnesses follow the pressure, and are named at REFERENCE_IOP, 15 mmHg: those of shear and bending grow as
(IOP / 15 mmHg)^n, since a cornea's lamellae grip one another by the pressure that presses them together (pigs' shear
moduli double between 5 and 20 mmHg); in its plane the tissue's own law does it. A globe after Friedenwald (1937) takes
up V = C P0 ln(1 + p/P0) at p over its pressure P0 at rest, the IOP; its compliance C falls as 15 mmHg / IOP.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from taichi_eye.errors import SceneError
from taichi_eye.eye.laws import Law, law_of
from taichi_eye.eye.puff import Puff, read_puff
from taichi_eye.eye.retreat import Retreat
from taichi_eye.eye.section import Section
from taichi_eye.eye.tissue import biaxial_tangent, flexural_rigidity
from taichi_eye.scene import Scene
from taichi_eye.scene.calibration import rest_stress
from taichi_eye.scene.draft import written
from taichi_eye.units import KPA, MM, MM3, MMHG, MPA, MPA_S, MS

REFERENCE_IOP = 15.0 * MMHG  # at which stiffnesses that follow the pressure are named
SHEAR_CORRECTION = 5.0 / 6.0  # kappa: shear spread as a parabola over the thickness


@dataclass(frozen=True, kw_only=True)
class Cornea:
    """The tissue and the shape of its thickness; lengths in m, stresses in Pa.

    law, constants: the tissue's, as `Law.coefficients` takes them; thickness: on the axis, rim_thickness: at the
    limbus, a parabola in the radius between; poisson_ratio: the in-plane coupling, also of bending; flexural_modulus:
    Young's modulus of bending, shear_modulus: of transverse shear, both 0 for a membrane and both at REFERENCE_IOP;
    pressure_exponent: the power of the IOP that they follow; shear_delay [s]: viscosity of the shear over its modulus;
    overstress_share g, relaxation_time tau [s]: of a sudden stretch; density [kg/m^3].
    """

    law: Law
    constants: tuple[float, ...]
    poisson_ratio: float
    thickness: float
    rim_thickness: float
    density: float
    flexural_modulus: float = 0.0
    shear_modulus: float = 0.0
    shear_delay: float = 0.0
    pressure_exponent: float = 0.0
    overstress_share: float = 0.0
    relaxation_time: float = 1.0

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Those that the law's functions take."""
        return self.law.coefficients(*self.constants)

    @property
    def is_shell(self) -> bool:
        """Whether the cornea resists bending or transverse shear, and so bears compression."""
        return self.flexural_modulus > 0.0 or self.shear_modulus > 0.0

    @property
    def thinnest(self) -> float:
        """The smaller of the thicknesses on the axis and at the rim."""
        return min(self.thickness, self.rim_thickness)

    @property
    def thickest(self) -> float:
        """The larger of them."""
        return max(self.thickness, self.rim_thickness)


@dataclass(frozen=True, kw_only=True)
class Globe:
    """The rest of the globe behind a sealed chamber: what it takes up per pressure [m^3/Pa], and how late [s].

    friedenwald: whether its compliance is one at REFERENCE_IOP that falls as the pressure rises.
    """

    compliance: float = 0.0
    delay: float = 0.0
    friedenwald: bool = False


@dataclass(frozen=True, kw_only=True)
class Liquid:
    """The aqueous humour: density [kg/m^3] and dynamic viscosity [Pa s]; sealed: whether none of it leaves."""

    density: float
    viscosity: float
    sealed: bool = True


@dataclass(frozen=True, kw_only=True)
class Eye:
    """An eye at rest and its puff. iop: intraocular pressure [Pa]; retreat: of the whole eye in its socket."""

    section: Section
    iop: float
    cornea: Cornea
    liquid: Liquid
    globe: Globe
    puff: Puff
    retreat: Retreat

    def but(self, **changes) -> Eye:
        """The same eye with other values: `eye.but(iop=2500.0)`, `eye.but(globe=Globe(compliance=1e-12))`."""
        return replace(self, **changes)

    def thickness(self, r: ArrayLike) -> np.ndarray:
        """Thickness [m] at reference radii r [m]: h0 + (h1 - h0) (r/a)^2, that of the rim beyond the limbus a.

        Healthy corneas measure about 0.55 mm at the centre and 0.67 mm near the rim.
        """
        share = np.minimum(np.abs(np.asarray(r, dtype=float)) / self.section.limbus_radius, 1.0) ** 2
        return self.cornea.thickness + (self.cornea.rim_thickness - self.cornea.thickness) * share

    def prestrain(self, r: ArrayLike) -> np.ndarray:
        """Prestrain eps0 at reference radii r [m] that carries the IOP there.

        The membrane at rest is a sphere under a uniform tension IOP R/2, so where it is thicker its stress is lower and
        its prestrain smaller.
        """
        r = np.asarray(r, dtype=float)
        if self.cornea.rim_thickness == self.cornea.thickness:
            return np.full(r.shape, self.apex_prestrain)
        return np.array([self._prestrain(h) for h in self.thickness(r).ravel()]).reshape(r.shape)

    def _prestrain(self, thickness: float) -> float:
        stress = rest_stress(self.iop, self.section.radius, thickness)
        return self.cornea.law.prestrain(stress, *self.cornea.constants)

    @cached_property
    def apex_prestrain(self) -> float:
        """Prestrain on the axis."""
        return self._prestrain(self.cornea.thickness)

    @property
    def stiffening(self) -> float:
        """What the IOP makes of the moduli of shear and bending, over those at REFERENCE_IOP."""
        return (self.iop / REFERENCE_IOP) ** self.cornea.pressure_exponent

    def rigidity(self, thickness: ArrayLike) -> np.ndarray:
        """Bending stiffness D [N m] of the slow tissue at a thickness [m]."""
        modulus = self.stiffening * self.cornea.flexural_modulus
        return flexural_rigidity(modulus, thickness, self.cornea.poisson_ratio)

    @property
    def sudden_rigidity(self) -> float:
        """D [N m] that a sudden bend of the thickest part meets."""
        return float((1.0 + self.cornea.overstress_share) * self.rigidity(self.cornea.thickest))

    @property
    def shear_stiffness(self) -> float:
        """kappa G [Pa] of transverse shear, per thickness."""
        return SHEAR_CORRECTION * self.stiffening * self.cornea.shear_modulus

    @property
    def globe_compliance(self) -> float:
        """What the globe takes up per pressure at rest [m^3/Pa]."""
        return self.globe.compliance * (REFERENCE_IOP / self.iop if self.globe.friedenwald else 1.0)

    @property
    def globe_pressure(self) -> float:
        """P0 [Pa] of a globe after Friedenwald; infinite where it is linear."""
        return self.iop if self.globe.friedenwald else math.inf

    @cached_property
    def rest_stress(self) -> float:
        """Principal stress [Pa] of the wall at rest, on the axis (Laplace)."""
        return rest_stress(self.iop, self.section.radius, self.cornea.thickness)

    @cached_property
    def youngs_modulus(self) -> float:
        """Young's modulus [Pa] in the plane at rest, from the law's biaxial tangent."""
        tangent = biaxial_tangent(self.cornea.law, self.cornea.coefficients, self.apex_prestrain)
        return (1.0 - self.cornea.poisson_ratio) * tangent


def eye_of(scene: Scene) -> Eye:
    """The eye that a resolved scene describes; SceneError where its pressure file has gone bad meanwhile."""
    wall, chamber, aqueous = scene.cornea, scene.chamber, scene.aqueous
    section = Section(
        wall.radius_mm * MM,
        wall.limbus_radius_mm * MM,
        chamber.depth_mm * MM,
        chamber.lens_radius_mm * MM,
        chamber.lens_height_mm * MM,
    )
    law, constants = law_of(wall)
    return Eye(
        section=section,
        iop=scene.eye.iop_mmhg * MMHG,
        cornea=Cornea(
            law=law,
            constants=constants,
            poisson_ratio=wall.poisson_ratio,
            thickness=wall.thickness_mm * MM,
            rim_thickness=wall.limbus_thickness_mm * MM,
            density=wall.density_kg_m3,
            flexural_modulus=wall.flexural_modulus_mpa * MPA,
            shear_modulus=wall.shear_modulus_kpa * KPA,
            shear_delay=wall.shear_viscosity_ms * MS,
            pressure_exponent=wall.pressure_exponent,
            overstress_share=wall.viscoelastic_share,
            relaxation_time=wall.relaxation_ms * MS,
        ),
        liquid=Liquid(density=aqueous.density_kg_m3, viscosity=aqueous.viscosity_mpa_s * MPA_S, sealed=chamber.sealed),
        globe=Globe(
            compliance=chamber.compliance_mm3_mmhg * MM3 / MMHG,
            delay=chamber.globe_delay_ms * MS,
            friedenwald=chamber.globe_law == "friedenwald",
        ),
        puff=_puff_of(scene, section),
        retreat=Retreat(scene.eye.whole_eye_movement_mm * MM),
    )


def refuse_no_puff(scene: Scene, where: str = "the scene") -> None:
    """SceneError, which names the key, where the puff of a scene never presses: such an eye has no response."""
    if eye_of(scene).puff.peak == 0.0:
        key = "puff.file" if scene.puff.time_course == "file" else "puff.peak_kpa"
        raise SceneError(f"{where}: {key} = {written(scene.values()[key])}: an eye without a puff does not move")


def _puff_of(scene: Scene, section: Section) -> Puff:
    puff = scene.puff
    if puff.radial_profile == "paper":
        rate = puff.spread_a / section.radius**2
    else:
        rate = 1.0 / (puff.width_mm * MM) ** 2
    samples = read_puff(puff.file) if puff.time_course == "file" else None
    peak = puff.peak_kpa * KPA if samples is None else float(np.abs(samples[1]).max())
    return Puff(puff.time_course, peak, puff.duration_ms * MS, puff.spread_b, rate, samples, puff.dent_feedback)
