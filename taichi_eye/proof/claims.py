"""`taichi-eye claims`: the claims of Montanino, Angelillo and Pandolfi, tested in the model.

(i) the apex lags the jet; (ii) its history is not symmetric in time; (iii) both come from the fluid; (iv) the fluid
influences the motion markedly; (v) the intraocular pressure can be estimated from the motion.

Delay is the time of the apex peak, and the middle of its two half-height times, less the same figures of the load: the
load's own centre is subtracted. A flat-topped peak makes its own time soft, so the middle is the sharper figure.
"""
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.errors import RunStopped
from taichi_eye.proof.page import COLOURS, picture, table, write_page
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.history import summarise
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation

SPACING_MM = 0.25
# Three measured eyes, apex histories of a Scheimpflug tonometer: whole deformation peaks at 16.2/17.6/17.3 ms, deflection (the
# movement of the whole eye subtracted) at 15.0-15.5 ms; the measured load is centred at about 15.5 ms (half heights).
MEASURED_DEFORMATION_MS, MEASURED_DEFLECTION_MS = (16.2, 17.6, 17.3), (15.0, 15.5)
HEAD = ("case", "peak (mm)", "peak delay (ms)", "middle delay (ms)", "width (ms)", "fall : rise", "fate")


def measure(*overrides, density: float | None = None) -> dict:
    """Apex peak [mm], its delays to the load [ms], width at half height [ms], and fall : rise of one run.

    density [kg/m^3] of the liquid: beyond what a scene may ask for, with the sound speed that keeps rho c^2.
    """
    scene = load_scene(None, [f"numerics.spacing_mm={SPACING_MM}", *overrides])
    if density is not None:
        stiff = scene.numerics.sound_speed_m_s * math.sqrt(scene.aqueous.density_kg_m3 / density)
        scene = replace(scene, aqueous=replace(scene.aqueous, density_kg_m3=density),
                        numerics=replace(scene.numerics, sound_speed_m_s=stiff))
    simulation = Simulation(scene)
    fate = "complete"
    try:
        simulation.run()
    except RunStopped as reason:
        fate = f"stopped at {reason.time_ms:.2f} ms: {reason.what}"
    traces = simulation.arrays()
    apex = summarise(traces["time_ms"], traces["apex_displacement_mm"])
    load = summarise(traces["time_ms"], traces["puff_apex_kpa"])

    def middle(history):
        if history.rise_time_ms is None or history.fall_time_ms is None:
            return math.nan
        return 0.5 * (history.rise_time_ms + history.fall_time_ms)

    return {"peak_mm": apex.peak, "peak_delay_ms": apex.peak_time_ms - load.peak_time_ms,
            "middle_delay_ms": middle(apex) - middle(load), "width_ms": apex.fwhm_ms or math.nan,
            "asymmetry": apex.asymmetry or math.nan, "fate": fate,
            "time_ms": traces["time_ms"], "apex_mm": traces["apex_displacement_mm"]}


def _study(say, parameter, cases):
    """Measure each (label, overrides); rows, figures for JSON, and the page's parts."""
    found = {}
    for label, given in cases:
        found[label] = measure(**given) if isinstance(given, dict) else measure(*given)
        say("  " + "  ".join(_cells(label, found[label])))
    canvas = Figure(figsize=(7.5, 4.2), dpi=105, layout="constrained")
    axes = canvas.subplots()
    for k, (label, run) in enumerate(found.items()):
        axes.plot(run["time_ms"], run["apex_mm"], color=COLOURS[k % len(COLOURS)], label=label, linewidth=1.4)
    axes.axvline(15.0, color="#22262b", linestyle=":", linewidth=1)
    axes.set(xlabel="time (ms)", ylabel="apex displacement (mm)", title=parameter)
    axes.legend(fontsize=8, frameon=False)
    figures = {label: {name: value for name, value in run.items() if not isinstance(value, np.ndarray)}
               for label, run in found.items()}
    return figures, [picture(canvas), table(HEAD, [_cells(label, run) for label, run in found.items()])]


def _cells(label, run):
    return (label, f"{run['peak_mm']:.3f}", f"{run['peak_delay_ms']:+.2f}", f"{run['middle_delay_ms']:+.3f}",
            f"{run['width_ms']:.2f}", f"{run['asymmetry']:.3f}", run["fate"])


def sound_speed(say):
    """Delay and asymmetry against the numerical sound speed c: what a soft liquid fakes."""
    return _study(say, "sound speed c", [(f"c {c:g} m/s", [f"numerics.sound_speed_m_s={c}"])
                                         for c in (5.0, 10.0, 20.0, 40.0, 80.0, 160.0)])


def density(say):
    """Delay and asymmetry against the density of the liquid, 0.01 to 3 times water; its bulk stiffness rho c^2 is kept."""
    return _study(say, "liquid density at the same bulk stiffness",
                  [(f"rho_f x {factor:g}", {"density": 1000.0 * factor}) for factor in (0.01, 0.1, 1.0, 3.0)])


def viscosity(say):
    """Delay and asymmetry against the viscosity."""
    return _study(say, "viscosity", [(f"mu {mu:g} mPa s", [f"aqueous.viscosity_mpa_s={mu}"]) for mu in (0.0, 0.8, 8.0, 80.0)])


def pressure(say):
    """The apex peak against the IOP: whether the IOP can be read from the motion."""
    return _study(say, "intraocular pressure", [(f"IOP {iop:g} mmHg", [f"eye.iop_mmhg={iop}"])
                                                for iop in (10.0, 12.5, 15.0, 20.0, 25.0)])


PARTS = {"sound-speed": sound_speed, "density": density, "viscosity": viscosity, "pressure": pressure}


def _verdicts(figures) -> list[tuple[str, str]]:
    """Each claim and what the runs say, from the studies that were run."""
    said = []
    stiff = figures.get("sound-speed", {}).get("c 160 m/s")
    soft = figures.get("sound-speed", {}).get("c 5 m/s")
    if stiff and soft:
        said.append(("(i) the apex lags the jet",
                     f"With a stiff sealed chamber (c 160 m/s) the middle of the apex history comes {stiff['middle_delay_ms']:+.3f} ms, its "
                     f"flat-topped peak {stiff['peak_delay_ms']:+.2f} ms after the load's. In a chamber made compliant by c 5 m/s: "
                     f"{soft['middle_delay_ms']:+.3f} and {soft['peak_delay_ms']:+.2f} ms. No lag of a millisecond in either."))
        said.append(("(ii) the history is not symmetric", f"fall : rise is {stiff['asymmetry']:.3f} at c 160 m/s and "
                     f"{soft['asymmetry']:.3f} at c 5 m/s (1: symmetric)."))
    rho = figures.get("density")
    if rho:
        light, heavy = rho["rho_f x 0.01"], rho["rho_f x 3"]
        said.append(("(iii) both come from the fluid",
                     f"Its inertia: from 0.01 to 3 times the density at the same bulk stiffness the middle delay goes from "
                     f"{light['middle_delay_ms']:+.3f} to {heavy['middle_delay_ms']:+.3f} ms, fall : rise from {light['asymmetry']:.3f} to "
                     f"{heavy['asymmetry']:.3f}."))
        thick = figures.get("viscosity")
        if thick:
            said[-1] = (said[-1][0], said[-1][1] + f" Its viscosity: from 0 to 80 mPa s (100 times the aqueous humour's) "
                        f"{thick['mu 0 mPa s']['middle_delay_ms']:+.3f} to {thick['mu 80 mPa s']['middle_delay_ms']:+.3f} ms.")
    if stiff and soft:
        said.append(("(iv) the fluid influences the motion markedly",
                     f"By its volume: the peak is {stiff['peak_mm']:.3f} mm at c 160 m/s and {soft['peak_mm']:.3f} mm in a chamber made "
                     "compliant by c 5 m/s; without any liquid, at constant IOP, a membrane of this eye would go 2.8 mm deep "
                     "(computed separately), deeper than the chamber."))
    iop = figures.get("pressure")
    if iop:
        peaks = [(float(label.split()[1]), run["peak_mm"]) for label, run in iop.items()]
        slope = np.polyfit(*np.array(peaks).T, 1)[0]
        said.append(("(v) the IOP can be estimated from the motion",
                     f"The peak falls by {-1e3 * slope:.1f} um per mmHg, from {peaks[0][1]:.3f} mm at {peaks[0][0]:g} mmHg to "
                     f"{peaks[-1][1]:.3f} mm at {peaks[-1][0]:g} mmHg, with the tissue known; tissue and thickness move it too."))
    if stiff:
        said.append(("what of the measured delay this explains",
                     f"Measured: the apex's whole deformation peaks at {', '.join(map(str, MEASURED_DEFORMATION_MS))} ms, its deflection at "
                     f"{MEASURED_DEFLECTION_MS[0]}-{MEASURED_DEFLECTION_MS[1]} ms: the 1-2 ms between them are the whole eye's movement, which "
                     f"a fixed limbus has not got. The model's own delay is {stiff['middle_delay_ms']:+.3f} ms."))
    return said


def report(only=(), out: str | None = None, json_file: str | None = None, say=lambda text: print(text, flush=True)) -> bool:
    """Run the studies named (all without names) and write the page; True once done: verdicts are findings, not failures."""
    folder = create_run_folder(out, "claims")
    figures, parts = {}, []
    for name in only or PARTS:
        started = time.perf_counter()
        say(name)
        figures[name], more = PARTS[name](say)
        say(f"  {name}: {time.perf_counter() - started:.0f} s")
        parts += [f"<h2>{name}</h2><p>{PARTS[name].__doc__}</p>", *more]
    verdicts = _verdicts(figures)
    for claim, finding in verdicts:
        say(f"{claim}: {finding}")
    body = [f"<pre>{__doc__}</pre>", table(("claim", "in the model"), verdicts), *parts]
    write_page(folder / "claims.html", "taichi-eye claims", body)
    if json_file:
        write_text(Path(json_file), json.dumps({"verdicts": verdicts, **figures}, indent=2, default=float) + "\n")
    say(str(folder / "claims.html"))
    return True
