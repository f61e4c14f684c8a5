"""Every key of a scene file, in one table: type, unit, default, allowed values and a line of explanation.

Each section is a frozen dataclass and each key one of its fields; validation, defaults, `dump_scene` and the
documentation all read the `Key` that stands in the field's metadata. To add a key, add a line here.
"""

# No `from __future__ import annotations` here: the loader reads the field types as classes.
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

from taichi_eye.rungs import RUNGS

AUTO = "auto"  # as a value: compute this key from the others


@dataclass(frozen=True)
class Key:
    """What may stand under one key. Bounds are None where there is none; `computed` keys also take "auto"."""

    default: Any
    doc: str
    unit: str = ""
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def computed(self) -> bool:
        return self.default == AUTO

    def holds(self, value: Any) -> bool:
        """True where a value of the right type lies within the bounds or among the choices."""
        if self.choices:
            return value in self.choices
        return not (
            self.at_least is not None
            and not value >= self.at_least
            or self.below is not None
            and not value < self.below
            or self.at_most is not None
            and not value <= self.at_most
        )

    def bounds(self) -> str:
        """The allowed values in words, e.g. ">= 1 and <= 100"; empty where anything goes."""
        if self.choices:
            return " | ".join(f'"{c}"' for c in self.choices)
        pairs = ((">=", self.at_least), ("<", self.below), ("<=", self.at_most))
        return " and ".join(f"{sign} {value:.12g}" for sign, value in pairs if value is not None)


def key(default: Any, doc: str, **limits: Any) -> Any:
    """A field of a section: the default ("auto" where it is computed), a line of explanation, unit and limits."""
    return field(metadata={"key": Key(default, doc, **limits)})


@dataclass(frozen=True)
class Eye:
    """The eye at rest"""

    iop_mmhg: float = key(15.0, "intraocular pressure over atmosphere", unit="mmHg", at_least=1, at_most=100)
    whole_eye_movement_mm: float = key(
        0.0, "largest retreat of the globe, over the measured course; 0: it stays", unit="mm", at_least=0, at_most=2
    )


@dataclass(frozen=True)
class Cornea:
    """A spherical cap, reduced to a membrane; W = A [exp(s ((1-nu)(e1^2+e2^2) + nu (e1+e2)^2)) - 1]"""

    radius_mm: float = key(7.8, "radius of the cap at rest (R)", unit="mm", at_least=0.5, at_most=100)
    limbus_radius_mm: float = key(5.8, "radius of the fixed rim, below radius_mm", unit="mm", at_least=0.1, below=100)
    thickness_mm: float = key(0.55, "thickness (h), on the axis", unit="mm", at_least=0.01, at_most=2)
    limbus_thickness_mm: float = key(
        AUTO, "thickness at the rim, a parabola in between; auto: that on the axis", unit="mm", at_least=0.01, at_most=2
    )
    flexural_modulus_mpa: float = key(
        0.0,
        "Young's modulus of bending, D = E h^3 / (12 (1 - nu^2)); 0: a membrane",
        unit="MPa",
        at_least=0,
        at_most=100,
    )
    shear_modulus_kpa: float = key(
        0.0,
        "modulus of shear across the thickness (G), which resists tilting: energy 5/6 G h/2 tan^2 of the tilt from "
        "rest per area; 0: none",
        unit="kPa",
        at_least=0,
        at_most=1e6,
    )
    shear_viscosity_ms: float = key(0.0, "viscosity of that shear over its modulus", unit="ms", at_least=0, at_most=100)
    pressure_exponent: float = key(
        0.0,
        "n: the moduli of bending and shear hold at 15 mmHg and follow (eye.iop_mmhg / 15)^n; 0: constants",
        at_least=0,
        at_most=4,
    )
    viscoelastic_share: float = key(
        0.0, "stress of a sudden stretch over that of a slow one, less 1 (g); 0: elastic", at_least=0, at_most=20
    )
    relaxation_ms: float = key(
        1.0, "time in which that overstress fades to 1/e (tau)", unit="ms", at_least=0.01, at_most=1e6
    )
    density_kg_m3: float = key(1050.0, "density of the tissue", unit="kg/m^3", at_least=100, at_most=10000)
    stiffness_a_pa: float = key(
        AUTO, "energy scale A; auto: 1562, or what k and the prestrain ask for", unit="Pa", at_least=1e-3, at_most=1e9
    )
    exponent_k: float = key(
        AUTO, "k = s (1 + nu); auto: 86.1, or from s, or what A and the prestrain ask for", at_least=1e-3, at_most=1e5
    )
    exponent_s: float = key(AUTO, "s = k / (1 + nu); auto: from k", at_least=5e-4, at_most=1e5)
    poisson_ratio: float = key(0.49, "in-plane coupling nu", at_least=0, at_most=0.5)
    prestrain: float = key(
        AUTO,
        "Green-Lagrange prestrain eps0; auto: such that the wall carries the IOP at rest",
        at_least=1e-6,
        at_most=0.5,
    )


@dataclass(frozen=True)
class Chamber:
    """The anterior chamber behind the cornea; its back is rigid"""

    sealed: bool = key(
        True, "no fluid leaves; false: it leaves everywhere at the rate that holds the mean pressure at the IOP"
    )

    depth_mm: float = key(
        AUTO,
        "apex to back plane on the axis, at least the cap depth; auto: the cap depth",
        unit="mm",
        at_least=0.01,
        at_most=100,
    )
    compliance_mm3_mmhg: float = key(
        0.0,
        "volume that the rest of the globe takes up per pressure, where sealed",
        unit="mm^3/mmHg",
        at_least=0,
        at_most=100,
    )
    globe_law: str = key(
        "linear",
        "of that volume: in proportion to the pressure, or C P0 ln(1 + p/P0) with P0 the IOP at rest and C as given "
        "at 15 mmHg, falling as 15/IOP",
        choices=("linear", "friedenwald"),
    )
    globe_delay_ms: float = key(
        0.0,
        "time in which the globe follows the pressure, its wall being viscous; 0: at once",
        unit="ms",
        at_least=0,
        at_most=1000,
    )
    lens_radius_mm: float = key(
        0.0, "radius of curvature of a lens cap on the back plane; 0: none", unit="mm", at_least=0, at_most=100
    )
    lens_height_mm: float = key(
        0.0, "height of that cap over the back plane, below its radius; 0: none", unit="mm", at_least=0, at_most=100
    )


@dataclass(frozen=True)
class Aqueous:
    """The aqueous humour: Newtonian, weakly compressible"""

    density_kg_m3: float = key(1000.0, "density at rest", unit="kg/m^3", at_least=1, at_most=10000)
    viscosity_mpa_s: float = key(0.8, "dynamic viscosity", unit="mPa s", at_least=0, at_most=1000)


@dataclass(frozen=True)
class PuffLoad:
    """The air puff: pressure at the apex over time, times a radial profile"""

    time_course: str = key(
        "gaussian",
        "eq. 2 of the paper, the course measured on a Corvis ST, or puff.file",
        choices=("gaussian", "corvis", "file"),
    )
    peak_kpa: float = key(
        10.0, "largest pressure at the apex; a file brings its own", unit="kPa", at_least=0, at_most=100
    )
    duration_ms: float = key(30.0, "T of the gaussian course, centred at T/2", unit="ms", at_least=1e-3, at_most=1000)
    spread_b: float = key(25.0, "b of the gaussian course exp(-b (2t-T)^2/(4T^2))", at_least=1e-3, at_most=1e4)
    spread_a: float = key(21.5, "a of the paper's radial profile exp(-a sin^2 phi)", at_least=0, at_most=1e4)
    radial_profile: str = key("paper", "exp(-a sin^2 phi), or exp(-r^2/w^2)", choices=("paper", "gaussian"))
    width_mm: float = key(1.2, "w of the gaussian radial profile", unit="mm", at_least=0.01, at_most=100)
    dent_feedback: float = key(
        0.0,
        "c: the profile is that on a flat wall, its width over 1 + c D kappa, D = 2.4 mm the nozzle and kappa the "
        "curvature under it; 0: the wall's shape does not matter",
        at_least=0,
        at_most=2,
    )
    file: str = key("", "CSV with columns time_ms,pressure_kpa, relative to the scene file; zero outside its times")


@dataclass(frozen=True)
class Numerics:
    """What is modelled, and the discretisation of the fluid, the membrane and their coupling"""

    fidelity: str = key(
        "mfpm",
        "model of the liquid: none, IOP constant; uniform pressure of the sealed chamber; added mass "
        "of potential flow; the resolved flow; or the cheapest of them that keeps the tolerance, at a "
        "spacing and sound speed that do",
        choices=(*RUNGS, "auto"),
    )
    tolerance_percent: float = key(
        1.0,
        "for auto: largest error of the apex's peak, 50 % times and whole history",
        unit="%",
        at_least=0.1,
        at_most=50,
    )
    tolerance_on: str = key(
        "apex",
        "for auto: what the tolerance holds for; pressure: that under the apex as well",
        choices=("apex", "pressure"),
    )
    spacing_mm: float = key(0.1, "node spacing of the fluid", unit="mm", at_least=1e-3, at_most=10)
    basis: str = key("quadratic", "Taylor basis of the mesh-free operators", choices=("quadratic", "cubic"))
    sound_speed_m_s: float = key(
        80.0, "numerical speed of sound; its compliance deepens the dent as c^-2", unit="m/s", at_least=1, at_most=2000
    )
    mean_sound_speed_m_s: float = key(
        AUTO,
        "of the mean pressure of a sealed chamber, at least sound_speed_m_s: takes the "
        "compliance out of the dent at no cost; auto: sound_speed_m_s",
        unit="m/s",
        at_least=1,
        at_most=2000,
    )
    cfl: float = key(0.8, "factor on the stable time step", at_least=0.01, at_most=1)
    dissipation: float = key(
        0.5, "fourth-difference dissipation of p and u, in units of c h; unstable below 0.3", at_least=0, at_most=1
    )
    wall_condition: str = key("slip", "fluid at the walls", choices=("slip", "no_slip"))
    coupling: str = key(
        "iterated",
        "fluid and membrane iterated to the tolerance, or one exchange a step",
        choices=("iterated", "loose"),
    )
    relaxation: str = key("aitken", "relaxation of the coupling iteration", choices=("aitken", "fixed"))
    relaxation_factor: float = key(1.0, "relaxation factor, the first one with aitken", at_least=0.01, at_most=2)
    coupling_tolerance: float = key(1e-8, "relative residual at which the iteration ends", at_least=1e-15, at_most=0.1)
    coupling_iterations_max: int = key(20, "the run stops where a step needs more", at_least=1, at_most=1000)
    refresh_travel: float = key(
        AUTO,
        "travel of the cornea, in spacings, after which operator weights (mfpm) or the flow's "
        "map (added_mass) are made anew; auto: 0.05, and 0.5",
        at_least=1e-4,
        at_most=10,
    )
    error_bar: bool = key(
        False,
        "state the numerical error of the apex history and of every parameter, by a second run at up to twice the "
        "spacing and half the sound speed; of run and check clinic",
    )
    duration_ms: float = key(32.0, "simulated time", unit="ms", at_least=1e-3, at_most=1000)


@dataclass(frozen=True)
class Camera:
    """The film: view, image geometry and frame times"""

    view: str = key(
        "both", "slit image, node cloud, or the one above the other", choices=("scheimpflug", "particles", "both")
    )
    colour_by: str = key("speed", "colour of the nodes", choices=("pressure", "speed"))
    width_px: int = key(576, "width of the slit image, even", unit="px", at_least=64, at_most=4096)
    height_px: int = key(200, "height of the slit image, even", unit="px", at_least=64, at_most=4096)
    pixel_x_mm: float = key(0.015625, "width of a pixel", unit="mm", at_least=1e-4, at_most=1)
    pixel_y_mm: float = key(0.0165, "height of a pixel", unit="mm", at_least=1e-4, at_most=1)
    frame_interval_ms: float = key(0.2315, "time between frames", unit="ms", at_least=1e-3, at_most=1000)
    frame_count: int = key(
        AUTO, "frames, the first at rest; as many as fit into numerics.duration_ms", at_least=1, at_most=100000
    )
    angle_deg: float = key(45.0, "camera axis to slit plane", unit="deg", at_least=1, at_most=89)
    refractive_index: float = key(1.376, "of the cornea; shortens what lies behind its front", at_least=1, at_most=2)
    apex_column_px: int = key(288, "image column of the axis", unit="px", at_least=0, at_most=4095)
    apex_row_px: int = key(16, "image row of the apex at rest", unit="px", at_least=0, at_most=4095)
    optics: str = key(
        "full", "what the instrument's camera sees, or a plain band between the two edges", choices=("full", "plain")
    )
    epithelium: bool = key(True, "bright anterior line")
    stroma: bool = key(True, "scatter of the stroma")
    iris: bool = key(True, "iris beside the pupil")
    lens: bool = key(True, "haze of the lens")
    fall_off: bool = key(True, "slit light fainter towards the sides")
    specks: bool = key(True, "rare specular specks on the anterior line")
    noise: bool = key(True, "grain of the sensor")
    seed: int = key(1, "seed of the grain", at_least=0, at_most=2**31 - 1)
    stamp: bool = key(True, "time stamp in the image")
    marks: bool = key(
        False,
        "a bar of 1 mm in the slit image, and the times of A1, HC and A2 once they are passed; no instrument has them",
    )


@dataclass(frozen=True)
class Output:
    """What the run folder holds beside the film, the plots and the traces"""

    film_fps: int = key(25, "playing speed of film.mp4", unit="frames/s", at_least=1, at_most=240)
    png_frames: bool = key(False, "also every frame as a PNG")
    gif: bool = key(False, "also a small looping GIF of the film")
    node_fields: bool = key(False, "also the fields at every frame for ParaView")
    checkpoint_s: float = key(
        5.0,
        "a checkpoint, from which the run can be resumed, after so long, or longer where they would cost more than "
        "2 % of the run; 0: wherever the film can be cut",
        unit="s",
        at_least=0,
        at_most=1e6,
    )


@dataclass(frozen=True)
class Sections:
    """One attribute per section, each with one attribute per key; `taichi_eye.scene.scene.Scene` fills them in."""

    eye: Eye
    cornea: Cornea
    chamber: Chamber
    aqueous: Aqueous
    puff: PuffLoad
    numerics: Numerics
    camera: Camera
    output: Output


SECTIONS: dict[str, type] = {section.name: section.type for section in fields(Sections)}


@cache
def keys_of(section: str) -> dict[str, tuple[type, Key]]:
    """The keys of a section by name: (type, Key)."""
    return {f.name: (f.type, f.metadata["key"]) for f in fields(SECTIONS[section])}


def all_keys() -> Iterator[tuple[str, type, Key]]:
    """Every key as ("section.key", type, Key), in the order of the table."""
    for section in SECTIONS:
        for name, (kind, spec) in keys_of(section).items():
            yield f"{section}.{name}", kind, spec
