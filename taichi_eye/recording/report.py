"""report.html: the run on one page."""

from __future__ import annotations

import numpy as np

from taichi_eye.film import EncoderError, slim
from taichi_eye.film.display import gain_of
from taichi_eye.recording.observer import Observer
from taichi_eye.recording.summary import summary_of
from taichi_eye.report import result as page
from taichi_eye.scene import Scene, load_scene
from taichi_eye.scene.draft import written
from taichi_eye.scene.schema import all_keys
from taichi_eye.units import MM

WORST = {  # of the summary: full name, unit
    "energy_error_share_of_work": ("largest error of the energy balance, share of the puff's work", ""),
    "chamber_volume_error_max": ("largest change of the chamber's volume, over it", ""),
    "cornea_min_stress_kpa": ("smallest principal stress in the cornea", "kPa"),
    "fluid_pressure_apex_max_kpa": ("largest pressure of the liquid under the apex", "kPa"),
    "steps": ("time steps", ""),
    "elements": ("elements of the cornea", ""),
    "operator_rebuilds": ("operator weights made anew", ""),
    "flow_maps": ("flow maps made", ""),
    "step_limit": ("what limited the last time step", ""),
}


class Report(Observer):
    """The page, from what the other sinks have written by then."""

    def closed(self, ending) -> None:
        recording = self.recording
        name = recording.folder.name
        page.write(recording.folder / page.NAME, name, page.fragment(name, _parts(recording, ending)))


def _parts(recording, ending) -> list[str]:
    summary, scene, folder = summary_of(recording, ending), recording.scene, recording.folder
    apex, deformation = summary["apex_displacement_mm"], summary["apex_deformation_mm"]
    lead = (
        f"Eye of {scene.eye.iop_mmhg:g} mmHg and {1e3 * scene.cornea.thickness_mm:g} \N{MICRO SIGN}m under a puff of "
        f"{float(recording.simulation.puff.peak) / 1e3:g} kPa: the apex sinks by {apex['peak']:.3f} mm at "
        f"{apex['peak_time_ms']:.2f} ms"
    )
    if deformation["peak"] != apex["peak"]:
        lead += f", {deformation['peak']:.3f} mm with the retreat of the whole eye"
    doubts = list(summary["warnings"])
    if summary["status"] != "complete":
        doubts.insert(0, f"Not complete: {summary['reason']}")
    film, parameters = folder / "film.mp4", ""
    try:
        gain = gain_of(scene) if scene.camera.view == "scheimpflug" else 1.0
        shown = page.video(slim(film), gain) if film.is_file() else ""
    except (EncoderError, OSError) as problem:
        shown = ""
        doubts.append(f"the film is not on this page: {problem}")
    try:
        parameters = _parameters(recording, ending)
    except Exception as problem:  # a wall that shows no response is no reason to lose the page
        doubts.append(f"the response cannot be read: {type(problem).__name__}: {problem}")
    plot = folder / "apex.png"
    return [
        page.paragraph(lead + "."),
        page.warnings(doubts),
        shown,
        page.section("Apex", page.image(plot.read_bytes(), "apex and load over time") if plot.is_file() else ""),
        page.section("Parameters, read from the computed wall", parameters),
        page.section(
            "What differs from the default scene",
            page.rows(["key", "here", "default", "unit", "meaning"], differing(scene), words=(0, 3, 4))
            or page.paragraph("Nothing: this is the default eye."),
        ),
        page.section("Numerics", page.rows(["what", "value", "unit"], _numerics(scene, summary), words=(0, 2))),
    ]


def _parameters(recording, ending) -> str:
    """The clinic's parameters of the wall; a sentence where there are too few frames."""
    # SciPy's filters are slow to load, and a run of a few frames has no use for them
    from taichi_eye.analysis.curves import curves_from_wall
    from taichi_eye.analysis.norms import ELDERLY_AGE_YEARS
    from taichi_eye.analysis.report import parameters
    from taichi_eye.analysis.response import Response
    from taichi_eye.analysis.simulated import FRAMES_LEAST, Observed

    walls, scene = recording.walls.read(), recording.scene
    if len(walls) < FRAMES_LEAST:
        return page.paragraph(f"{len(walls)} frames are too few; a response needs {FRAMES_LEAST}.")
    places = walls["wall"] / MM
    r, z = places[..., 0], places[..., 1] - walls["retreat_mm"][:, None]
    curves = curves_from_wall(np.asarray(walls["time_ms"]), r, z, scene.cornea.thickness_mm)
    stopped = "" if ending.stop is None else str(ending.stop) or "interrupted"
    response = Observed(scene, recording.simulation.eye, curves, stopped).read().response
    shown, names = [response], ["computed"]
    if recording.error_bar is not None:
        names.append("numerical error")
        shown.append(Response(**recording.error_bar.response.errors))
    said = parameters(names, *shown)
    if not said:
        return page.paragraph("The cornea shows no response to a puff.")
    return said + page.paragraph(
        f"IOPnct, bIOP and with it SP-A1 are what the instrument would show at {ELDERLY_AGE_YEARS:g} years; taichi-eye "
        "analyze of this folder takes the simulated pressure for bIOP."
    )


def differing(scene: Scene) -> list[list[str]]:
    """Keys that were given another value than the default scene has; what is computed from them is left out."""
    own, default, body = scene.values(), load_scene().values(), []
    for name, _, spec in all_keys():
        given = name in scene.given or not spec.computed
        if given and own[name] != default[name]:
            body.append([name, _text(own[name]), _text(default[name]), spec.unit, spec.doc])
    return body


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else written(value)


def _numerics(scene: Scene, summary: dict) -> list[list[object]]:
    numerics = scene.numerics
    body = [
        ["model of the liquid (numerics.fidelity)", summary["fidelity"], ""],
        ["spacing", f"{numerics.spacing_mm:.4g}", "mm"],
    ]
    if summary["fidelity"] == "mfpm":
        body.append(["numerical speed of sound", f"{numerics.sound_speed_m_s:g}", "m/s"])
    body += [[said, page.shown(summary[name]), unit] for name, (said, unit) in WORST.items() if name in summary]
    cloud, sweeps, choice = (summary.get(name) or {} for name in ("cloud", "coupling_iterations", "choice"))
    for name, said in (("nodes", "nodes of the liquid"), ("worst_stencil_condition", "worst condition of a stencil")):
        if name in cloud:
            body.append([said, page.shown(cloud[name]), ""])
    if sweeps:
        body.append(["sweeps of the coupling in a step, mean and most", f"{sweeps['mean']:.3g}, {sweeps['most']}", ""])
    if choice:
        body.append(["how auto chose", choice["reason"], ""])
        for rung, errors in choice["estimates_percent"].items():
            said = ", ".join(f"{source} {error:.2g}" for source, error in errors.items())
            body.append([f"errors expected of {rung}", said, "%"])
    against = dict(summary.get("against") or {})
    measured = against.pop("file", "")
    for name, figure in against.items():
        said = name.removesuffix("_mm").removesuffix("_ms").replace("_difference", "").replace("_", " ")
        body.append([f"computed less {measured}: {said}", page.shown(figure), name.rsplit("_", 1)[-1]])
    body.append(["wall-clock time so far", f"{summary['wall_clock']['total_s']:.1f}", "s"])
    return body
