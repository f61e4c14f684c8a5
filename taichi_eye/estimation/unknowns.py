"""What may be unknown of an eye and its puff, what is known of it beforehand, and the scene that values make.

An unknown is a factor on what the scene says, or a length or a pressure; all are positive and are estimated by their
logarithms. Beforehand each is normal in its logarithm: mean and relative standard deviation are those that the user
declares, what the film itself shows, or the defaults of `UNKNOWNS`, which are a population's about the scene's eye.
Nothing is assumed of the IOP but its range. A standard deviation of 0 holds an unknown at its value.

in_plane multiplies the stiffness A of the tissue's law, out_of_plane the moduli of bending and of shear, globe the
globe's compliance; a globe that the scene takes for linear is taken at each pressure anew, as
`taichi_eye.scene.variant` says. Age moves the mean of in_plane: human corneas double their stiffness between 20 and 100
years (inflated donor corneas, Knox Cartwright 2011), told from the age of the eyes that scenes are judged by.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS
from taichi_eye.errors import SceneError
from taichi_eye.scene import Scene
from taichi_eye.scene.schema import AUTO
from taichi_eye.scene.variant import eye_at

DOUBLING_YEARS = 80.0
AGES = 5.0, 110.0
HELD = 1e-9  # relative standard deviation below which a value is held
REACH = 4.0  # standard deviations that an unknown may go from its mean, at least by a factor of FARTHEST
FARTHEST = 1.05


@dataclass(frozen=True)
class Unknown:
    """One unknown. unit: empty for a factor on the scene's own; spread: relative SD over a population, None where
    nothing is assumed; allowed: range of any eye's value; tissue: whether it is estimated for its own sake."""

    name: str
    unit: str
    what: str
    spread: float | None
    allowed: tuple[float, float]
    tissue: bool = False


IOP, IN_PLANE, OUT_OF_PLANE, GLOBE = "iop_mmhg", "in_plane", "out_of_plane", "globe"
PUFF, WIDTH, THICKNESS, RADIUS, RETREAT = "puff", "puff_width", "thickness_um", "radius_mm", "whole_eye"
UNKNOWNS = {
    unknown.name: unknown
    for unknown in (
        Unknown(IOP, "mmHg", "intraocular pressure", None, (4.0, 80.0), True),
        Unknown(IN_PLANE, "", "stiffness in the plane of the cornea", 0.35, (0.05, 20.0), True),
        Unknown(OUT_OF_PLANE, "", "stiffness to bending and shear", 0.35, (0.05, 20.0), True),
        Unknown(GLOBE, "", "compliance of the globe", 0.35, (0.05, 20.0), True),
        # 96.4 +- 1.4 mmHg (Oehring 2021, doi 10.3390/app11062499)
        Unknown(PUFF, "", "pressure of the puff", 1.4 / 96.4, (0.5, 2.0)),
        Unknown(WIDTH, "", "width of the puff", 0.05, (0.5, 2.0)),
        # 551 +- 31 um in 194 eyes; radii of healthy corneas 7.8 +- .26 mm
        Unknown(THICKNESS, "um", "thickness of the cornea", 31.0 / 551.0, (300.0, 800.0)),
        Unknown(RADIUS, "mm", "radius of the cornea", 0.26 / 7.8, (6.0, 10.0)),
        # three eyes: 0.29 to 0.42 mm
        Unknown(RETREAT, "", "retreat of the whole eye", 0.2, (0.1, 5.0)),
    )
}


@dataclass(frozen=True)
class Known:
    """A value and its standard deviation, in the unknown's own unit."""

    value: float
    deviation: float = 0.0


@dataclass(frozen=True)
class Beforehand:
    """The unknowns that are free, and what is known of them.

    base: the scene that factors multiply. names: of the free ones, the IOP first; mean [unknowns] of the logarithms and
    precision [unknowns, unknowns], 0 for the IOP; low, high: bounds of the logarithms; held: values of the others.
    """

    base: Scene
    names: tuple[str, ...]
    mean: np.ndarray
    precision: np.ndarray
    low: np.ndarray
    high: np.ndarray
    held: dict[str, float]

    def values(self, place: np.ndarray) -> dict[str, float]:
        """Every unknown's value where the free ones' logarithms are at a place."""
        return {**self.held, **{name: float(value) for name, value in zip(self.names, np.exp(place))}}

    def scene(self, place: np.ndarray) -> Scene:
        """The eye at a place."""
        return scene_with(self.base, self.values(place))

    def without(self, name: str) -> np.ndarray:
        """The precision, were nothing known of one unknown."""
        k, changed = self.names.index(name), self.precision.copy()
        changed[k, :] = changed[:, k] = 0.0
        return changed


def own_values(scene: Scene) -> dict[str, float]:
    """What the scene says of every unknown that it has."""
    found = {IOP: scene.eye.iop_mmhg, IN_PLANE: 1.0, PUFF: 1.0, WIDTH: 1.0}
    found |= {THICKNESS: 1e3 * scene.cornea.thickness_mm, RADIUS: scene.cornea.radius_mm}
    if scene.cornea.flexural_modulus_mpa or scene.cornea.shear_modulus_kpa:
        found[OUT_OF_PLANE] = 1.0
    if scene.chamber.compliance_mm3_mmhg and scene.chamber.sealed:
        found[GLOBE] = 1.0
    if scene.eye.whole_eye_movement_mm:
        found[RETREAT] = 1.0
    if scene.puff.time_course == "file":
        del found[PUFF]  # a file brings its own pressure
    return found


def scene_with(base: Scene, values: Mapping[str, float]) -> Scene:
    """The scene's eye with other values of its unknowns; SceneError where there can be no such eye."""
    scene = eye_at(base, values[IOP], values[THICKNESS])
    own, changes = scene.values(), {}
    if values[IN_PLANE] != 1.0:
        changes["cornea.stiffness_a_pa"] = values[IN_PLANE] * own["cornea.stiffness_a_pa"]
        changes["cornea.exponent_k"] = own["cornea.exponent_k"]
        changes["cornea.prestrain"] = AUTO
    factors = {
        "cornea.flexural_modulus_mpa": values.get(OUT_OF_PLANE, 1.0),
        "cornea.shear_modulus_kpa": values.get(OUT_OF_PLANE, 1.0),
        "chamber.compliance_mm3_mmhg": values.get(GLOBE, 1.0),
        "puff.peak_kpa": values.get(PUFF, 1.0),
        "eye.whole_eye_movement_mm": values.get(RETREAT, 1.0),
    }
    if base.puff.radial_profile == "gaussian":
        factors["puff.width_mm"] = values[WIDTH]
    else:
        factors["puff.spread_a"] = values[WIDTH] ** -2
    changes |= {name: factor * own[name] for name, factor in factors.items() if factor != 1.0 and own[name]}
    if values[RADIUS] != base.cornea.radius_mm:
        changes["cornea.radius_mm"] = values[RADIUS]
        if "chamber.depth_mm" in base.given:
            # the back stays where it is below the limbus
            cap = [
                r - math.sqrt(r**2 - base.cornea.limbus_radius_mm**2) for r in (values[RADIUS], own["cornea.radius_mm"])
            ]
            changes["chamber.depth_mm"] = own["chamber.depth_mm"] + cap[0] - cap[1]
    return scene.but(changes) if changes else scene


def checked(scene: Scene, known: Mapping[str, Known]) -> None:
    """SceneError where what is declared cannot be."""
    own = own_values(scene)
    for name, given in known.items():
        if name not in UNKNOWNS:
            raise SceneError(f"known {name} = {given.value:g}: no such unknown; there are {', '.join(UNKNOWNS)}")
        unknown = UNKNOWNS[name]
        low, high = unknown.allowed
        if name not in own:
            raise SceneError(f"known {name} = {given.value:g}: the scene has none ({unknown.what}), so leave it out")
        if not low <= given.value <= high:
            raise SceneError(f"known {name} = {given.value:g}: allowed is {low:g} to {high:g} {unknown.unit}".rstrip())
        if name == IOP and given.deviation == 0.0:
            raise SceneError(
                f"known {name} = {given.value:g}: is what is estimated; leave it out, or give it +- a deviation"
            )
        if not 0.0 <= given.deviation <= given.value:
            raise SceneError(f"known {name} = {given.value:g} +- {given.deviation:g}: the deviation is 0 to the value")


def beforehand(
    scene: Scene,
    known: Mapping[str, Known],
    age_years: float | None = None,
    retreats: bool = True,
    joint: tuple[tuple[str, ...], np.ndarray] | None = None,
) -> Beforehand:
    """What is known of a scene's unknowns: `known` where it says so, else the population about the scene's eye.

    retreats: whether what was measured holds the retreat of the whole eye; without it that unknown plays no part.
    joint: names whose logarithms have a covariance together, in place of the deviations in `known`.
    """
    checked(scene, known)
    if age_years is not None and not AGES[0] <= age_years <= AGES[1]:
        raise SceneError(f"age_years = {age_years:g}: allowed is {AGES[0]:g} to {AGES[1]:g}")
    own = own_values(scene)
    if not retreats:
        own.pop(RETREAT, None)
    names, mean, spread, held = [], [], [], {}
    for name, value in own.items():
        unknown = UNKNOWNS[name]
        if name == IN_PLANE and age_years is not None:
            value *= 2.0 ** ((age_years - ELDERLY_AGE_YEARS) / DOUBLING_YEARS)
        relative = unknown.spread
        if name in known:
            value, relative = known[name].value, known[name].deviation / known[name].value
        if relative is not None and relative < HELD:
            held[name] = value
            continue
        names.append(name)
        mean.append(math.log(value))
        spread.append(math.inf if relative is None else relative)
    mean, spread = np.array(mean), np.array(spread)
    precision = np.diag(1.0 / spread**2)
    if joint is not None:
        places = [names.index(name) for name in joint[0] if name in names]
        kept = [k for k, name in enumerate(joint[0]) if name in names]
        precision[np.ix_(places, places)] = np.linalg.inv(np.asarray(joint[1])[np.ix_(kept, kept)])
    reach = np.maximum(REACH * spread, math.log(FARTHEST))
    limits = np.log([UNKNOWNS[name].allowed for name in names]).reshape(-1, 2)
    return Beforehand(
        scene,
        tuple(names),
        mean,
        precision,
        np.maximum(mean - reach, limits[:, 0]),
        np.minimum(mean + reach, limits[:, 1]),
        held,
    )
