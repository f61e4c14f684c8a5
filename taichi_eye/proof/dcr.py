"""`taichi-eye clinic SCENE`: the dynamic corneal response of a scene beside published norms, and what its switches do.

Parameters are read from the computed wall itself (`taichi_eye.analysis.simulated`), no film between. Three tables: the
scene, with z-scores against the published populations (`taichi_eye.analysis.norms`) and whether it lies within one
standard
deviation of one of them; the scene with one switch at a time set back to the default eye; slopes with IOP and central
thickness (the
rim along with it) by a straight line through five eyes, beside those over 194 eyes. A globe's compliance falls as one
over
its pressure (Friedenwald), so it does along the eyes of other IOPs. A run that a guard stops shows why.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from taichi_eye.analysis import Response
from taichi_eye.analysis.norms import NORMS, z_scores
from taichi_eye.analysis.simulated import Reading, response_of
from taichi_eye.errors import SceneError
from taichi_eye.proof.clinic import SLOPES
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.page import table, write_page
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.schema import AUTO, all_keys

SHOWN = {
    "a1_time_ms": "A1 ms",
    "a1_velocity_m_s": "A1 m/s",
    "a1_deflection_mm": "A1 defl mm",
    "a2_time_ms": "A2 ms",
    "a2_velocity_m_s": "A2 m/s",
    "hc_time_ms": "HC ms",
    "deformation_amplitude_mm": "DA mm",
    "peak_distance_mm": "PD mm",
    "hc_radius_mm": "HC R mm",
    "da_ratio_2mm": "DA ratio",
    "integrated_inverse_radius_per_mm": "IR 1/mm",
    "sp_a1_mmhg_mm": "SP-A1",
}
SWITCHES = {
    "whole-eye movement": ("eye.whole_eye_movement_mm",),
    "bending stiffness": ("cornea.flexural_modulus_mpa",),
    "in-plane stiffness": ("cornea.stiffness_a_pa", "cornea.exponent_k", "cornea.exponent_s", "cornea.prestrain"),
    "in-plane coupling": ("cornea.poisson_ratio",),
    "relaxing tissue": ("cornea.viscoelastic_share",),
    "thicker rim": ("cornea.limbus_thickness_mm",),
    "yielding globe": ("chamber.compliance_mm3_mmhg",),
    "late globe": ("chamber.globe_delay_ms",),
    "width of the puff": ("puff.radial_profile", "puff.width_mm"),
    "course of the puff": ("puff.time_course", "puff.file"),
}
IOP_STEPS_MMHG = -4.0, -2.0, 0.0, 2.0, 4.0
THICKNESS_STEPS_UM = -40.0, -20.0, 0.0, 20.0, 40.0
FACTOR = 1.5  # within which a slope counts as that of the living eyes


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


def slope(steps, outcomes: list[Reading], name: str) -> float:
    """Of a parameter over the steps, NaN where fewer than three eyes show it."""
    pairs = [(step, getattr(outcome.response, name)) for step, outcome in zip(steps, outcomes) if not outcome.stopped]
    pairs = [(step, value) for step, value in pairs if value is not None]
    return float(np.polyfit(*zip(*pairs), 1)[0]) if len(pairs) >= 3 else float("nan")


def report(
    path: str,
    overrides=(),
    out: str | None = None,
    json_file: str | None = None,
    progress: bool = True,
    say=lambda text: print(text, flush=True),
) -> Path:
    """Run the scene, its switches and its slopes; print the tables, write clinic.html; its path.

    Raises SceneError before anything is written where the scene is bad or without a puff.
    """
    scene = load_scene(path, overrides)
    if scene.puff.peak_kpa == 0.0:
        raise SceneError(f"{path}: puff.peak_kpa = 0: an eye without a puff has no dynamic response")
    switched = switches_of(scene)
    iop, cornea = scene.eye.iop_mmhg, scene.cornea
    runs = [("scene", {}), *switched.items()]
    runs += [
        (
            f"IOP {step:+g} mmHg",
            {
                "eye.iop_mmhg": iop + step,
                "chamber.compliance_mm3_mmhg": scene.chamber.compliance_mm3_mmhg * iop / (iop + step),
            },
        )
        for step in IOP_STEPS_MMHG
    ]
    runs += [
        (
            f"thickness {step:+g} um",
            {
                "cornea.thickness_mm": cornea.thickness_mm + 1e-3 * step,
                "cornea.limbus_thickness_mm": cornea.limbus_thickness_mm + 1e-3 * step,
            },
        )
        for step in THICKNESS_STEPS_UM
    ]
    scenes = [scene.but(changes) for _, changes in runs]
    folder = create_run_folder(out, "clinic")
    outcomes = []
    with tqdm(total=len(runs), unit=" runs", disable=not progress, dynamic_ncols=True, leave=False) as bar:
        for (name, _), each in zip(runs, scenes):
            bar.set_description_str(name)
            outcomes.append(response_of(each))
            bar.update()
    own = outcomes[0]
    first, second = 1 + len(switched), 1 + len(switched) + len(IOP_STEPS_MMHG)
    tables = {
        "The scene beside the norms": norms_table(own.response),
        "One switch at a time set back": switch_table(dict(zip([name for name, _ in runs[:first]], outcomes[:first]))),
        "Slopes": slope_table(outcomes[first:second], outcomes[second:]),
    }
    for title, (head, body) in tables.items():
        say(f"\n{title}")
        widths = [max(len(str(row[k])) for row in [head, *body]) for k in range(len(head))]
        for row in [head, *body]:
            say("  ".join(f"{str(cell):<{width}}" for cell, width in zip(row, widths)).rstrip())
    page = folder / "clinic.html"
    write_page(
        page,
        f"taichi-eye clinic {Path(path).name}",
        [f"<pre>{__doc__}</pre>"] + [f"<h2>{title}</h2>{table(head, body)}" for title, (head, body) in tables.items()],
    )
    if json_file:
        plain = {title: [dict(zip(head, row)) for row in body] for title, (head, body) in tables.items()}
        write_text(Path(json_file), json.dumps(plain, indent=2) + "\n")
    say(f"\n{page}")
    return page


def norms_table(response: Response) -> tuple[list[str], list[list[str]]]:
    """Every shown parameter that has a norm: value, mean +- SD and z of each population, whether within 1 SD of one."""
    scores, body = z_scores(response), []
    for name, label in SHOWN.items():
        norms = {population: NORMS[population][name] for population in NORMS if name in NORMS[population]}
        if not norms:
            continue
        z = scores.get(name, {})
        within = "yes" if any(abs(value) <= 1.0 for value in z.values()) else "NO"
        cells = [f"{norms[p][0]:g} +- {norms[p][1]:g} ({z[p]:+.1f})" if p in z else "" for p in NORMS]
        body.append([label, _cell(getattr(response, name)), *cells, within])
    return ["parameter", "computed", *(f"{p} (z)" for p in NORMS), "within 1 SD of one"], body


def switch_table(outcomes: dict[str, Reading]) -> tuple[list[str], list[list[str]]]:
    """The scene, then the scene without each switch."""
    body = [
        [
            ("without " if name != "scene" else "") + name,
            *(_cell(getattr(outcome.response, field)) for field in SHOWN),
            outcome.stopped,
        ]
        for name, outcome in outcomes.items()
    ]
    return ["", *SHOWN.values(), "stopped"], body


def slope_table(iop: list[Reading], thickness: list[Reading]) -> tuple[list[str], list[list[str]]]:
    """Slopes per mmHg and per 10 um beside those of living eyes: computed, measured, their ratio, within FACTOR or
    not."""
    body = []
    for name, (per_mmhg, per_10_um) in SLOPES.items():
        row = [SHOWN[name]]
        for steps, outcomes, unit, measured in (
            (IOP_STEPS_MMHG, iop, 1.0, per_mmhg),
            (THICKNESS_STEPS_UM, thickness, 10.0, per_10_um),
        ):
            found = unit * slope(steps, outcomes, name)
            ratio = found / measured
            row += [f"{found:.4f}", f"{measured:g}", f"{ratio:.2f}", "yes" if 1.0 / FACTOR <= ratio <= FACTOR else "NO"]
        body.append(row)
    return ["", "per mmHg", "measured", "ratio", "holds", "per 10 um", "measured", "ratio", "holds"], body


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
