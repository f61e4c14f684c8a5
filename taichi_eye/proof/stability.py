"""`taichi-eye stability`: where the methods fail, each map with its theory.

Growth rates are those of the solver's own step about rest (`taichi_eye.proof.spectrum`), in units of c/h.
"""
import json
import math
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.cloud.packing import FREE, Cloud, complete, pack
from taichi_eye.errors import RunStopped
from taichi_eye.eye.section import Section
from taichi_eye.proof.page import COLOURS, picture, table, write_page
from taichi_eye.proof.spectrum import CoupledSystem, exponents, growth, reachable, step_matrix
from taichi_eye.report.folder import create_run_folder, write_text
from taichi_eye.report.history import summarise
from taichi_eye.scene import load_scene
from taichi_eye.solver.simulation import Simulation
from taichi_eye.units import MM, MMHG, MPA_S

ACCEPTED = 1e-4  # c/h: growth that a puff of 32 ms does not notice
SMALL_CFL = 0.05  # time step of the spectra, in h/c


def _eye_setup(scene, sound_speed: float, dissipation: float, **more):
    """What CoupledSystem.setup takes for the eye of a scene."""
    cornea = scene.cornea
    setup = {"thickness": cornea.thickness_mm * MM, "wall_density": cornea.density_kg_m3, "iop": scene.eye.iop_mmhg * MMHG,
             "material": (cornea.stiffness_a_pa, cornea.exponent_k / (1.0 + cornea.poisson_ratio), cornea.poisson_ratio,
                          cornea.prestrain),
             "density": scene.aqueous.density_kg_m3, "viscosity": scene.aqueous.viscosity_mpa_s * MPA_S,
             "sound_speed": sound_speed, "dissipation": dissipation}
    return {**setup, **more}


def jittered(cloud: Cloud, share: float, seed: int = 1) -> Cloud:
    """The cloud with its inner nodes moved at random by up to `share` spacings either way."""
    points = cloud.points.copy()
    inner = cloud.kind == FREE
    move = np.random.default_rng(seed).uniform(-share, share, (int(inner.sum()), 2)) * cloud.spacing
    moved = points[inner] + move
    moved[:, 0] = np.maximum(moved[:, 0], 0.2 * cloud.spacing)
    inside = cloud.section.wall_clearance(moved) > 0.2 * cloud.spacing
    points[inner] = np.where(inside[:, None], moved, points[inner])
    return _again(cloud, points, np.ones(cloud.count, dtype=bool))


def without_node_under_wall(cloud: Cloud) -> Cloud:
    """The cloud without the inner node nearest to the middle of the cornea."""
    middle = cloud.points[cloud.wall_count // 2]
    distance = np.where(cloud.kind == FREE, np.linalg.norm(cloud.points - middle, axis=1), np.inf)
    keep = np.ones(cloud.count, dtype=bool)
    keep[np.argmin(distance)] = False
    return _again(cloud, cloud.points, keep)


def _again(cloud, points, keep):
    boundary = int((cloud.kind != FREE).sum())
    return complete(cloud.section, cloud.spacing, points[keep], cloud.kind[:boundary], cloud.direction[:boundary],
                    cloud.wall_count)


def spectrum(say):
    """Largest growth rate of the coupled semi-discrete system about rest: dissipation, basis, neighbours, cloud."""
    scene, c = load_scene(), 80.0
    spacing = 0.3e-3
    cloud = pack(Section.from_scene(scene), spacing)
    unit = c / spacing
    alphas = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8)
    figures, rows = {}, []
    variants = [("packed, quadratic, 14 neighbours", "quadratic", 14, cloud), ("packed, quadratic, 10", "quadratic", 10, cloud),
                ("packed, quadratic, 20", "quadratic", 20, cloud), ("packed, cubic, 24", "cubic", 24, cloud)]
    variants += [(f"jitter {100 * share:.0f} %, quadratic, 14", "quadratic", 14, jittered(cloud, share))
                 for share in (0.05, 0.1, 0.2, 0.4)]
    variants.append(("one node removed under the wall", "quadratic", 14, without_node_under_wall(cloud)))
    systems = {basis: CoupledSystem(cloud.count, cloud.wall_count, basis=basis) for basis in ("quadratic", "cubic")}
    for name, basis, stencil, nodes in variants:
        rates = []
        for alpha in alphas:
            system = systems[basis]
            system.setup(nodes, stencil=stencil, **_eye_setup(scene, c, alpha))
            dt = SMALL_CFL * spacing / c
            rates.append(growth(step_matrix(system, dt), dt) / unit)
        figures[name] = rates
        rows.append((name, *[f"{rate:.1e}" for rate in rates]))
        say(f"  {name}: " + "  ".join(f"{rate:.1e}" for rate in rates))
    canvas = Figure(figsize=(9, 5), dpi=110, layout="constrained")
    axes = canvas.subplots()
    for k, (name, rates) in enumerate(figures.items()):
        axes.plot(alphas, np.maximum(rates, 1e-8), "o-", color=COLOURS[k % len(COLOURS)],
                  linestyle="-" if k < 8 else "--", label=name, markersize=4)
    axes.axhline(ACCEPTED, color="#22262b", linestyle=":", label="accepted: 1e-4")
    axes.axvline(scene.numerics.dissipation, color="#8a9199", linewidth=1, label="default dissipation")
    axes.set(yscale="log", xlabel="dissipation alpha (0: the naive scheme)", ylabel="largest growth rate (c/h)",
             title=f"Coupled system about rest, h {spacing * 1e3:g} mm, c {c:g} m/s")
    axes.legend(fontsize=8, frameon=False)
    default = figures[variants[0][0]][alphas.index(0.5)]
    text = (f"<p>The default (quadratic, 14 neighbours, dissipation 0.5, packed): {default:.1e} c/h; the naive scheme "
            f"(no dissipation): {figures[variants[0][0]][0]:.1e} c/h.</p>")
    return ([picture(canvas), text, table(("cloud and stencil", *[f"alpha {a:g}" for a in alphas]), rows)],
            {"alpha": alphas, "growth_c_h": figures, "default_growth_c_h": default}, default <= ACCEPTED)


def time_step(say):
    """Blow-up over (time step, dissipation): measured in time, and predicted twice.

    Theory for the leapfrog with lagged dissipation, per mode with frequency w and damping d: (w dt)^2/4 + d dt/2 <= 1; the
    solver's own limit is dt = g/(c (0.6 + 0.9 alpha)), g the smallest gap. Prediction: spectral radius of the step at that dt.
    """
    scene, c, spacing = load_scene(), 80.0, 0.5e-3
    cloud = pack(Section.from_scene(scene), spacing)
    gap = min(np.linalg.norm(cloud.points[a] - cloud.points[b])
              for t in cloud.triangles for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])))
    system = CoupledSystem(cloud.count, cloud.wall_count)
    alphas, courant = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2), np.arange(0.1, 2.01, 0.1)
    predicted, measured, by_mode = (np.zeros((len(alphas), len(courant))) for _ in range(3))
    random = np.random.default_rng(3)
    for row, alpha in enumerate(alphas):
        system.setup(cloud, **_eye_setup(scene, c, alpha))
        small = SMALL_CFL * spacing / c
        modes = exponents(step_matrix(system, small), small)
        modes = modes[np.abs(modes) < 8.0 * c / spacing]  # the mass fix acts at once, at any dt: no mode of the liquid
        for column, number in enumerate(courant):
            dt = number * spacing / c
            matrix = step_matrix(system, dt)
            predicted[row, column] = np.abs(np.linalg.eigvals(reachable(matrix))).max()
            by_mode[row, column] = ((modes.imag * dt) ** 2 / 4 - modes.real * dt / 2).max()
            measured[row, column] = _grows(system, dt, random)
        say(f"  alpha {alpha:g}: blows up from " + _first(courant, measured[row]) + " h/c, predicted "
            + _first(courant, predicted[row] > 1 + 5e-3) + ", theory by modes " + _first(courant, by_mode[row] > 1.0))
    canvas = Figure(figsize=(8, 4.8), dpi=110, layout="constrained")
    axes = canvas.subplots()
    for blow, colour, label in ((0, COLOURS[0], "stays"), (1, COLOURS[6], "blows up")):
        at = np.argwhere(measured == blow)
        axes.scatter(courant[at[:, 1]], np.array(alphas)[at[:, 0]], color=colour, marker="ox"[blow], s=22, label=label)
    rates = np.log10(np.maximum(predicted - 1.0, 1e-9))
    axes.contour(courant, alphas, rates, levels=[np.log10(5e-3)], colors=COLOURS[2])
    axes.plot([], [], color=COLOURS[2], label="predicted: spectral radius of the step 1.005")
    axes.contour(courant, alphas, by_mode, levels=[1.0], colors="#22262b", linestyles="--")
    axes.plot([], [], color="#22262b", linestyle="--", label="theory: (w dt)^2/4 + d dt/2 = 1")
    line = np.linspace(0.0, 1.2, 50)
    axes.plot(gap / spacing / (0.6 + 0.9 * line), line, color=COLOURS[1], label="the solver's limit (cfl 1)")
    axes.set(xlabel="c dt / h", ylabel="dissipation alpha", xlim=(0, 2.05), title="Time step: 1500 steps from noise")
    axes.legend(fontsize=8, loc="upper right")
    stable = [bool(not measured[row, courant <= 0.8 * gap / spacing / (0.6 + 0.9 * alpha)].any())
              for row, alpha in enumerate(alphas) if alpha >= 0.3]
    text = f"<p>At cfl 0.8 and dissipation 0.3 or more nothing blows up: {all(stable)}. Below 0.3 the spectrum itself grows.</p>"
    return ([picture(canvas), text], {"alpha": alphas, "c_dt_h": courant.tolist(), "blows_up": measured.tolist(),
                                      "spectral_radius": predicted.tolist()}, all(stable))


def _first(values, flags) -> str:
    at = np.nonzero(flags)[0]
    return f"{values[at[0]]:.1f}" if len(at) else "nowhere"


def _grows(system, dt: float, random, steps: int = 1500) -> bool:
    """Whether noise of 1 mm/s in the liquid has grown 30-fold after `steps` steps of the solver, or is no number."""
    state = np.zeros(system.size)
    state[:3 * system.count] = 1e-3 * random.standard_normal(3 * system.count)
    state = system.step(state, dt)
    before = np.abs(state[:3 * system.count]).max()
    state = system.run(state, dt, steps)
    after = np.abs(state[:3 * system.count]).max()
    return not after < 30.0 * before


def coupling(say):
    """Loose and iterated coupling over (mass ratio, time step), and how the iteration contracts.

    Theory: a sweep contracts by (dt/2)^2 rho c^2/(g rho_s h_wall), g the first nodes' distance under the wall: as dt^2 at
    fixed h, as dt at a fixed CFL number (van Brummelen 2009); for an incompressible liquid it would tend to a constant,
    rho_f mu_max/(rho_s h_wall) = 10 for this eye, so that loose coupling would never hold (Causin, Gerbeau, Nobile 2005).
    """
    scene, c, spacing = load_scene(), 80.0, 0.5e-3
    cloud = pack(Section.from_scene(scene), spacing)
    system = CoupledSystem(cloud.count, cloud.wall_count)
    own = scene.cornea.density_kg_m3
    factors = np.array([1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0])
    courant = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    ratio = own * factors * scene.cornea.thickness_mm * MM / (scene.aqueous.density_kg_m3 * spacing)
    radius = np.zeros((2, len(factors), len(courant)))
    sweeps = np.zeros((len(factors), len(courant)))
    for row, factor in enumerate(factors):
        system.setup(cloud, **_eye_setup(scene, c, 0.5, wall_density=own * factor))
        for column, number in enumerate(courant):
            dt = number * spacing / c
            for mode, iterated in enumerate((False, True)):
                system.iterated = iterated
                radius[mode, row, column] = np.abs(np.linalg.eigvals(reachable(step_matrix(system, dt)))).max()
            sweeps[row, column] = system.sweeps_to(dt, 1e-8)
        say(f"  mass ratio {ratio[row]:.3g}: loose unstable from " + _first(courant, radius[0, row] > 1.005) + " h/c, iterated from "
            + _first(courant, radius[1, row] > 1.005) + f", sweeps to 1e-8 at 0.8 h/c: {sweeps[row, -1]:.0f}")
    canvas = Figure(figsize=(12, 4.4), dpi=100, layout="constrained")
    panels = canvas.subplots(1, 3)
    for axes, flags, title in ((panels[0], radius[0] > 1.005, "loose"), (panels[1], radius[1] > 1.005, "iterated (plain, 60 sweeps)")):
        for blow, colour in ((0, COLOURS[0]), (1, COLOURS[6])):
            at = np.argwhere(flags == blow)
            axes.scatter(courant[at[:, 1]], ratio[at[:, 0]], color=colour, marker="ox"[blow], s=24,
                         label=("stable", "unstable")[blow])
        axes.plot(courant, (0.5 * courant) ** 2 * spacing / (0.8 * spacing), color="#22262b", linestyle="--",
                  label="theory: contraction 1")
        axes.axhline(ratio[factors == 1.0][0], color=COLOURS[1], linewidth=1, label="this eye at h 0.5 mm")
        axes.set(yscale="log", xlabel="c dt / h", ylabel="rho_s h_wall / (rho_f h)", title=title)
        axes.legend(fontsize=8)
    contraction, theory, fine = _contraction(system, scene, cloud, c)
    panels[2].loglog(fine, contraction, "o-", color=COLOURS[0], label="measured, h 0.5 mm")
    panels[2].loglog(fine, theory, "--", color="#22262b", label="theory, dt^2 at fixed h")
    refined = _contraction_refined(scene, c)
    panels[2].loglog(*refined, "s-", color=COLOURS[1], label="measured, fixed c dt/h 0.5, h 0.5 ... 0.25 mm")
    panels[2].set(xlabel="dt (s)", ylabel="contraction per sweep", title="contraction of the iteration")
    panels[2].legend(fontsize=8)
    slope = np.polyfit(np.log(refined[0]), np.log(refined[1]), 1)[0]
    fixed = np.polyfit(np.log(fine), np.log(contraction), 1)[0]
    at_eye = radius[0, list(factors).index(1.0)]
    text = (f"<p>Contraction goes as dt^{fixed:.2f} at fixed h and as dt^{slope:.2f} at a fixed CFL number. For this eye at h 0.5 mm "
            f"loose coupling is unstable from {_first(courant, at_eye > 1.005)} h/c on; its largest multiplier at 0.8 h/c is "
            f"{at_eye[-1]:.5f}. Iterated coupling: {radius[1, list(factors).index(1.0), -1]:.5f}.</p>")
    say(f"  contraction ~ dt^{fixed:.2f} at fixed h, dt^{slope:.2f} at fixed CFL")
    return ([picture(canvas), text], {"mass_ratio": ratio.tolist(), "c_dt_h": courant.tolist(), "radius_loose": radius[0].tolist(),
                                      "radius_iterated": radius[1].tolist(), "sweeps": sweeps.tolist(),
                                      "slope_fixed_h": fixed, "slope_fixed_cfl": slope}, slope > 0.8)


def _contraction(system, scene, cloud, c):
    fine = np.array([0.1, 0.2, 0.4, 0.8]) * cloud.spacing / c
    system.setup(cloud, **_eye_setup(scene, c, 0.5))
    measured = [system.contraction(dt) for dt in fine]
    mass = scene.cornea.density_kg_m3 * scene.cornea.thickness_mm * MM
    theory = (0.5 * fine) ** 2 * scene.aqueous.density_kg_m3 * c**2 / (0.85 * cloud.spacing * mass)
    return np.array(measured), theory, fine


def _contraction_refined(scene, c):
    clouds = [pack(Section.from_scene(scene), spacing) for spacing in (0.5e-3, 0.354e-3, 0.25e-3)]
    system = CoupledSystem(clouds[-1].count, clouds[-1].wall_count)
    steps, found = [], []
    for cloud in clouds:
        system.setup(cloud, **_eye_setup(scene, c, 0.5))
        steps.append(0.5 * cloud.spacing / c)
        found.append(system.contraction(steps[-1]))
    return np.array(steps), np.array(found)


def _puff(*overrides):
    """History, figures and fate of a puff at 0.25 mm: (summary or None, traces, stop or None, seconds)."""
    scene = load_scene(None, ["numerics.spacing_mm=0.25", *overrides])
    started = time.perf_counter()
    simulation = Simulation(scene)
    stop = None
    try:
        simulation.run()
    except RunStopped as reason:
        stop = reason
    traces = simulation.arrays()
    history = summarise(traces["time_ms"], traces["apex_displacement_mm"])
    return history, traces, stop, time.perf_counter() - started


def sound_speed(say):
    """Peak, half-height times and run time against c; the chamber's compliance makes the error of the peak go as c^-2."""
    speeds = (3.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0)
    _puff("numerics.duration_ms=0.1")  # compiles, so that the run times are those of runs
    rows = []
    for c in speeds:
        history, traces, stop, seconds = _puff(f"numerics.sound_speed_m_s={c}")
        rows.append((c, history.peak, history.peak_time_ms, history.rise_time_ms, history.fall_time_ms, seconds,
                     "" if stop is None else stop.what))
        say(f"  c {c:g}: peak {history.peak:.4f} mm at {history.peak_time_ms:.2f} ms, 50 % {history.rise_time_ms or math.nan:.2f} and "
            f"{history.fall_time_ms or math.nan:.2f} ms, {seconds:.1f} s {rows[-1][-1]}")
    whole = [row for row in rows if not row[-1]]
    c, peak = np.array([row[0] for row in whole]), np.array([row[1] for row in whole])
    canvas = Figure(figsize=(11, 4), dpi=100, layout="constrained")
    panels = canvas.subplots(1, 3)
    limit = peak[-1]
    panels[0].loglog(c[:-1], peak[:-1] - limit, "o-", color=COLOURS[0], label="peak less its value at c 300")
    panels[0].loglog(c[:-1], (peak[1] - limit) * (c[1] / c[:-1]) ** 2, "--", color="#22262b", label="c^-2")
    panels[0].set(xlabel="c (m/s)", ylabel="mm")
    panels[1].semilogx(c, [row[2] for row in whole], "o-", color=COLOURS[0], label="peak")
    panels[1].semilogx(c, [0.5 * (row[3] + row[4]) if row[3] and row[4] else math.nan for row in whole], "s-",
                       color=COLOURS[1], label="middle of the 50 % times")
    panels[1].axhline(15.0, color="#22262b", linestyle=":", label="centre of the load")
    panels[1].set(xlabel="c (m/s)", ylabel="ms")
    panels[2].loglog(c, [row[5] for row in whole], "o-", color=COLOURS[2], label="run time, s")
    panels[2].set(xlabel="c (m/s)")
    for axes in panels:
        axes.legend(fontsize=8)
    head = ("c (m/s)", "peak (mm)", "at (ms)", "50 % rise (ms)", "50 % fall (ms)", "run time (s)", "stopped")
    body = [[cell if isinstance(cell, str) else "" if cell is None else f"{cell:.4g}" for cell in row] for row in rows]
    return [picture(canvas), table(head, body)], {"rows": rows}, True


def wall(say):
    """Where the cornea goes slack or meets the back, and what the guards call it.

    A corner that fails must stop with its own diagnosis; one that completes must have closed its energy balance (1 % of
    the work) with its wall taut throughout.
    """
    rows, silent = [], 0
    for iop in (5.0, 10.0, 15.0, 25.0):
        for peak in (5.0, 10.0, 20.0, 40.0):
            for prestrain in (0.01, 0.04):
                case = (f"eye.iop_mmhg={iop}", f"puff.peak_kpa={peak}", f"cornea.prestrain={prestrain}",
                        "numerics.spacing_mm=0.35", "numerics.sound_speed_m_s=40")
                try:
                    history, traces, stop, _ = _puff(*case)
                except Exception as error:  # a scene that cannot be: its message is the diagnosis
                    rows.append((iop, peak, prestrain, "", "", "", f"refused: {error}"))
                    continue
                least, work = traces["cornea_min_stress_kpa"].min(), np.abs(traces["puff_work_uj"]).max()
                balance = np.abs(traces["energy_error_uj"]).max() / work
                fate = "completes" if stop is None else f"{stop.time_ms:.2f} ms: {stop.what}"
                suspect = stop is None and (least <= 0.0 or balance > 0.01 or not np.isfinite(history.peak))
                silent += suspect
                rows.append((iop, peak, prestrain, f"{history.peak:.3f}", f"{least:.2f}", f"{100 * balance:.2f} %",
                             fate + (" SILENT FAILURE" if suspect else "")))
        say(f"  IOP {iop:g} mmHg: " + ", ".join(f"{row[1]:g} kPa/{row[2]:g} {row[-1]}" for row in rows if row[0] == iop))
    text = f"<p>Completed runs with a slack wall, an open energy balance (over 1 %) or no number: {silent}.</p>"
    head = ("IOP (mmHg)", "puff (kPa)", "eps0", "peak (mm)", "least stress (kPa)", "energy error / work", "fate")
    return [text, table(head, rows, [i for i, row in enumerate(rows) if "SILENT" in row[-1]])], {"rows": rows}, silent == 0


PARTS = {"spectrum": spectrum, "time-step": time_step, "coupling": coupling, "sound-speed": sound_speed, "wall": wall}


def report(only=(), out: str | None = None, json_file: str | None = None, say=lambda text: print(text, flush=True)) -> bool:
    """Draw the maps named (all without names) into one page; whether every map's own requirement holds."""
    folder = create_run_folder(out, "stability")
    parts, figures, held = [], {}, []
    for name in only or PARTS:
        started = time.perf_counter()
        say(name)
        more, numbers, good = PARTS[name](say)
        figures[name] = {"holds": bool(good), **numbers}
        held.append(good)
        say(f"  {name}: {'holds' if good else 'DOES NOT HOLD'}, {time.perf_counter() - started:.0f} s")
        parts += [f"<h2>{name}</h2><pre>{PARTS[name].__doc__}</pre>", *more]
        write_page(folder / "stability.html", "taichi-eye stability", parts)
    if json_file:
        write_text(Path(json_file), json.dumps(figures, indent=2, default=float) + "\n")
    say(str(folder / "stability.html"))
    return all(held)
