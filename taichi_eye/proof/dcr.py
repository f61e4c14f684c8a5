"""`taichi-eye clinic SCENE`: what a clinic would measure on a scene's eye, beside what is measured on living eyes.

Parameters are read from the computed wall itself (`taichi_eye.analysis.simulated`), no film between. The eye has the
IOPnct and the bIOP that the instrument would show. What is compared: levels, with z-scores against every published
population (`taichi_eye.analysis.norms`) and a verdict by one of them; slopes with pressure and thickness over a small
population of simulated eyes (`taichi_eye.proof.population`) beside those over 194 living eyes; three public tables
(`taichi_eye.proof.public`); and what depends on the reading's windows (`taichi_eye.proof.windows`). The scene with one
switch at a time set back to the default eye shows what each does. A run that a guard stops shows why.

`study` computes, `report` also prints and writes the page (`taichi_eye.proof.clinic_page`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from taichi_eye import backend
from taichi_eye.analysis.error_bar import error_bar
from taichi_eye.analysis.norms import NORMS, judged_by, z_scores
from taichi_eye.analysis.response import Response
from taichi_eye.analysis.simulated import Observed, Reading, observe_many, response_of
from taichi_eye.eye.eye import refuse_no_puff
from taichi_eye.ladder.twin import twin_of
from taichi_eye.proof import clinic, public, windows
from taichi_eye.proof.population import SimulatedEye, crossed, simulate_many, slopes
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.schema import AUTO, all_keys

SHOWN = {
    "a1_time_ms": "A1 time, ms",
    "a1_velocity_m_s": "A1 velocity, m/s",
    "a1_deflection_mm": "A1 deflection, mm",
    "a2_time_ms": "A2 time, ms",
    "a2_velocity_m_s": "A2 velocity, m/s",
    "hc_time_ms": "HC time, ms",
    "deformation_amplitude_mm": "DA, mm",
    "peak_distance_mm": "PD, mm",
    "hc_radius_mm": "HC radius (central fit), mm",
    "hc_circle_radius_mm": "HC radius (circle), mm",
    "da_ratio_2mm": "DA ratio 2 mm",
    "integrated_inverse_radius_per_mm": "IR, 1/mm",
    "sp_a1_mmhg_mm": "SP-A1, mmHg/mm",
}
SWITCHES = {
    "whole-eye movement": ("eye.whole_eye_movement_mm",),
    "bending stiffness": ("cornea.flexural_modulus_mpa",),
    "in-plane stiffness": ("cornea.stiffness_a_pa", "cornea.exponent_k", "cornea.exponent_s", "cornea.prestrain"),
    "in-plane coupling": ("cornea.poisson_ratio",),
    "transverse shear": ("cornea.shear_modulus_kpa",),
    "stiffness that follows the pressure": ("cornea.pressure_exponent",),
    "relaxing tissue": ("cornea.viscoelastic_share",),
    "thicker rim": ("cornea.limbus_thickness_mm",),
    "yielding globe": ("chamber.compliance_mm3_mmhg",),
    "globe after Friedenwald": ("chamber.globe_law",),
    "late globe": ("chamber.globe_delay_ms",),
    "air that feels the dent": ("puff.dent_feedback",),
    "width of the puff": ("puff.radial_profile", "puff.width_mm"),
    "course of the puff": ("puff.time_course", "puff.file"),
}
FACTOR = 1.5  # within which a slope counts as that of the living eyes
PER_MMHG, PER_10_UM = "per mmHg", "per 10 um"


@dataclass(frozen=True)
class Level:
    """A parameter beside the norms. norms: (mean, SD, z) by population; judge: the one of the verdict, or None;
    numerical_error: of the value, where the scene asks for it and its twin got to its end."""

    name: str
    value: float | None
    norms: dict[str, tuple[float, float, float | None]]
    judge: str | None
    numerical_error: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether it lies within one standard deviation of the judging population's mean; None without a judge."""
        if self.judge is None:
            return None
        z = self.norms[self.judge][2]
        return z is not None and abs(z) <= 1.0


@dataclass(frozen=True)
class Slope:
    """A slope beside the measured one; error: that one's standard error, None where it is not known."""

    name: str
    unit: str
    computed: float
    measured: float
    error: float | None

    @property
    def ratio(self) -> float:
        """Computed over measured."""
        return self.computed / self.measured

    @property
    def measured_zero(self) -> bool:
        """Whether the measured slope is none, by two standard errors."""
        return self.error is not None and abs(self.measured) < 2.0 * self.error

    @property
    def verdict(self) -> str:
        """yes, only the sign, or NO: of a zero within two standard errors; else of the sign and within FACTOR."""
        if self.measured_zero:
            return "yes" if abs(self.computed - self.measured) <= 2.0 * self.error else "NO"
        if 1.0 / FACTOR <= self.ratio <= FACTOR:
            return "yes"
        return "sign only" if self.ratio > 0.0 else "NO"


@dataclass(frozen=True)
class Study:
    """All that the command finds out about a scene; line: eyes of its thickness and rising pressure."""

    name: str
    scene: Scene
    own: SimulatedEye
    levels: list[Level]
    slopes: list[Slope]
    groups: list[public.GroupRow]
    line: list[SimulatedEye]
    donors: public.DonorRow
    stiffened: list[public.StiffRow]
    diseased: list[public.DiseaseRow]
    zones: list[windows.ZoneRow]
    speeds: list[windows.SpeedRow]
    switches: dict[str, Reading]
    population: list[SimulatedEye]


def switches_of(scene: Scene) -> dict[str, dict[str, Any]]:
    """The changes (see `Scene.but`) that set back each switch which the scene sets.

    A switch of keys with plain defaults is set where a value differs from its default; one of computed keys where a key
    was given: it goes back to "auto", and what is computed from it follows.
    """
    default, own, found = {name: spec.default for name, _, spec in all_keys()}, scene.values(), {}
    for name, keys in SWITCHES.items():
        if any(key in scene.given if default[key] == AUTO else own[key] != default[key] for key in keys):
            found[name] = {key: default[key] for key in keys}
    return found


def levels_of(response: Response, errors: Mapping[str, float | None] | None = None) -> list[Level]:
    """Every shown parameter beside every population; errors: the numerical ones by name."""
    scores, found = z_scores(response), []
    for name in SHOWN:
        judge = judged_by(name)
        found.append(
            Level(
                name,
                getattr(response, name),
                {p: (*NORMS[p][name], scores.get(name, {}).get(p)) for p in NORMS if name in NORMS[p]},
                None if judge is None else judge[0],
                (errors or {}).get(name),
            )
        )
    return found


def errors_of(own: Observed) -> dict[str, float | None]:
    """The numerical errors of what a scene's eye shows, by its coarser twin; empty where the scene asks for none, or
    one of the two was stopped."""
    if own.stopped or not own.scene.numerics.error_bar:
        return {}
    twin = twin_of(own.scene)
    coarse = observe_many([twin.scene])[0]
    return {} if coarse.stopped else error_bar(twin, own, coarse).response.errors


def slopes_of(eyes: list[SimulatedEye]) -> list[Slope]:
    """Every measured slope beside that of the simulated eyes."""
    measured = {"a1_time_ms": ((clinic.A1_TIME_PER_MMHG, None), (clinic.A1_TIME_PER_10_UM, None)), **clinic.SLOPES}
    found = []
    for name, pairs in measured.items():
        for unit, computed, (value, error) in zip((PER_MMHG, PER_10_UM), slopes(eyes, name), pairs):
            found.append(Slope(name, unit, computed, value, error))
    return found


def _parcels(items: list) -> list[list]:
    """As many at once as threads run side by side."""
    size = backend.threads()
    return [items[k : k + size] for k in range(0, len(items), size)]


def study(
    scene: Scene,
    name: str = "scene",
    tell: Callable[[str, int, int], None] = lambda *_: None,
    healthy: Scene | None = None,
) -> Study:
    """Run a scene's eye, its population, its switches and the public tables; tell(label, done, total) at each run.

    healthy: another scene that it is set beside, as keratoconic eyes are beside healthy ones.
    """
    switched, asked = switches_of(scene), crossed(scene)
    own_place = scene.eye.iop_mmhg, 1e3 * scene.cornea.thickness_mm
    total, eyes = len(asked) + len(switched) + 2, []
    for parcel in _parcels(asked):
        tell(f"{parcel[0][0]:g} mmHg, {parcel[0][1]:.0f} um", len(eyes), total)
        eyes += simulate_many(scene, parcel)
    own = eyes[asked.index(own_place)]
    readings = {"scene": Reading(own.response, own.stopped)}
    for parcel in _parcels(list(switched)):
        tell(f"without {parcel[0]}", len(asked) + len(readings) - 1, total)
        observed = observe_many([scene.but(switched[what]) for what in parcel])
        readings |= {what: found.read() for what, found in zip(parcel, observed)}
    tell("public tables", total - 2, total)
    errors = errors_of(own.observed)
    line = public.sweep(scene, [eye for eye in eyes if eye.thickness_um == own.thickness_um])
    donors, stiffened = public.donors(scene), public.stiffened(scene, own)
    diseased = public.diseased(response_of(healthy), readings["scene"]) if healthy is not None else []
    tell("windows", total - 1, total)
    return Study(
        name,
        scene,
        own,
        levels_of(own.response, errors),
        slopes_of(eyes),
        public.groups(line),
        line,
        donors,
        stiffened,
        diseased,
        windows.zones(own, eyes),
        windows.speeds(own),
        readings,
        eyes,
    )


def report(
    path: str,
    overrides=(),
    out: str | None = None,
    json_file: str | None = None,
    progress: bool = True,
    say=lambda text: print(text, flush=True),
    healthy: str | None = None,
) -> Path:
    """Study the scene; print the tables, write clinic.html and clinic.png; the page's path. healthy: a scene file.

    Raises SceneError before anything is written where the scene is bad or without a puff.
    """
    # plots are slow to load
    from taichi_eye.proof import clinic_page

    scene = load_scene(path, overrides)
    beside = load_scene(healthy) if healthy else None
    for file, one in ((path, scene), (healthy, beside)):
        if one is not None:
            refuse_no_puff(one, file)
    if scene.numerics.error_bar and scene.numerics.fidelity != "auto":
        twin_of(scene)
    folder = create_run_folder(out, "clinic")
    with tqdm(unit=" runs", disable=not progress, dynamic_ncols=True, leave=False) as bar:

        def tell(label: str, done: int, total: int) -> None:
            bar.total = total
            bar.set_description_str(label)
            bar.update(done - bar.n)

        found = study(scene, Path(path).name, tell, beside)
    for line in clinic_page.words(found):
        say(line)
    for title, (head, body, _) in clinic_page.tables(found).items():
        say(f"\n{title}")
        widths = [max(len(str(row[k])) for row in [head, *body]) for k in range(len(head))]
        for row in [head, *body]:
            say("  ".join(f"{str(cell):<{width}}" for cell, width in zip(row, widths)).rstrip())
    page = clinic_page.write(found, folder)
    if json_file:
        write_text(Path(json_file), json.dumps(clinic_page.as_json(found), indent=2, allow_nan=False) + "\n")
    say(f"\n{page}")
    return page
