"""Coupling: where loose and iterated coupling blow up, how fast the iteration contracts, how far it may be relaxed.

A sweep answers an acceleration of the wall with the pressure that one step's compression of the nodes under it gives,
so it multiplies an error by -q, q = (dt/2)^2 rho c^2 / (g rho_s h_wall), g the height of liquid that one wall node
compresses. Loose coupling takes each sweep as the next step's acceleration and grows where q > 1. The plain iteration
(factor 1) diverges at the same place, factor omega converges below 2 / (1 + q), Aitken's finds the factor itself.

van Brummelen (2009): the added mass of a compressible flow goes to zero with dt. Here at a fixed spacing q goes as dt^2
(once c dt is below the spacing, a step reaches one node only, so the liquid that takes part no longer shrinks as c dt),
and at a fixed CFL number as dt.

Causin, Gerbeau, Nobile (2005), incompressible: loose coupling is unstable at any dt where rho_s h_wall / (rho_f mu_max)
< 1, mu_i = L / (i pi tanh(i pi H / L)), and the relaxed iteration converges below 2 m / (m + rho_f mu_max), m = rho_s
h_wall. These take the whole added mass at once; an explicit compressible step never meets more of it than q.
"""

import math

import numpy as np

from taichi_eye.proof.maps.result import Map, dots, finish, panels
from taichi_eye.proof.maps.runs import COARSE, cause, cloud_for, run, scene_with
from taichi_eye.solver import timestep
from taichi_eye.solver.case import case_of
from taichi_eye.solver.figures import RUNNING
from taichi_eye.solver.simulation import Simulation

BASE = {"numerics.sound_speed_m_s": 300.0, "puff.peak_kpa": 1.0, "puff.duration_ms": 1.0, "numerics.duration_ms": 0.7}
MASS_RATIOS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 2.0)
STEPS = (0.2, 0.35, 0.5, 0.7, 0.9, 1.1)  # over the acoustic limit
CONTRACTION_SWEEPS = 40
SPACINGS = (0.4, 0.28, 0.2, 0.14)


def _wall_mass(scene) -> float:
    return scene.cornea.density_kg_m3 * scene.cornea.thickness_mm * 1e-3


def mass_ratio(scene) -> float:
    """rho_s h_wall / (rho_f h)."""
    return _wall_mass(scene) / (scene.aqueous.density_kg_m3 * scene.numerics.spacing_mm * 1e-3)


def _rest_figures(keys: dict) -> tuple[dict, object]:
    scene = scene_with(keys)
    simulation = Simulation(scene, cloud_for(scene))
    return simulation.survey.take(), scene


def theory(dt: float, gap: float, scene) -> float:
    """q of a sweep over dt [s], g = gap [m]."""
    return (0.5 * dt) ** 2 * scene.aqueous.density_kg_m3 * scene.numerics.sound_speed_m_s**2 / (gap * _wall_mass(scene))


def contraction(keys: dict, dt: float) -> float:
    """What a plain sweep multiplies the error of the wall's acceleration by, in the step of dt [s] from rest.

    The ratio of the misses of sweeps CONTRACTION_SWEEPS and the one before it; fewer where they are down to rounding.
    """
    misses = []
    for sweeps in range(2, CONTRACTION_SWEEPS + 1):
        scene = scene_with(
            {
                **keys,
                "numerics.relaxation": "fixed",
                "numerics.relaxation_factor": 1.0,
                "numerics.coupling_tolerance": 0.0,
                "numerics.coupling_iterations_max": sweeps,
            }
        )
        simulation = Simulation(scene, cloud_for(scene))
        simulation.coupling.advance(np.array([1000.0]), dt, dt)
        miss = simulation.coupling.miss.to_numpy()[: simulation.cloud.wall_count]
        misses.append(float(np.linalg.norm(miss)))
        if misses[-1] < 1e-11 * misses[0] or misses[-1] > 1e11 * misses[0]:
            break
    return misses[-1] / misses[-2]


def _converges(keys: dict, dt: float, factor: float) -> bool:
    """Whether the iteration with a fixed factor converges in the step of dt [s] from rest, in sweeps too few to
    overflow."""
    scene = scene_with(
        {
            **keys,
            "numerics.relaxation": "fixed",
            "numerics.relaxation_factor": factor,
            "numerics.coupling_tolerance": 1e-4,
            "numerics.coupling_iterations_max": 200,
        }
    )
    simulation = Simulation(scene, cloud_for(scene))
    simulation.coupling.advance(np.array([1000.0]), dt, dt)
    return simulation.coupling.status[0] == RUNNING


def coupling(say=print) -> Map:
    """Runs over (mass ratio, dt) for both couplings, contraction against dt, relaxation limits."""
    canvas, axes = panels(3, 2)
    found, broken, figures = [], [], {}
    thickness, h = 0.55e-3, COARSE["numerics.spacing_mm"] * 1e-3
    rest, scene = _rest_figures(BASE)
    acoustic = timestep.limits(rest, case_of(scene))["acoustic"]

    # g from the measured contraction at one dt; all else is then predicted
    say("  contraction against dt")
    times = acoustic * np.array([0.1, 0.2, 0.4, 0.8, 1.0])
    light = {**BASE, "cornea.density_kg_m3": 0.1 * 1000.0 * h / thickness}
    fixed_h = [contraction(light, float(dt)) for dt in times]
    gap = theory(times[2], 1.0, scene_with(light)) / fixed_h[2]
    slope_h = float(np.polyfit(np.log(times), np.log(fixed_h), 1)[0])
    fixed_cfl, cfl_times = [], []
    for spacing in SPACINGS:
        keys = {**BASE, "numerics.spacing_mm": spacing, "cornea.density_kg_m3": 0.1 * 1000.0 * h / thickness}
        own, own_scene = _rest_figures(keys)
        cfl_times.append(0.8 * timestep.limits(own, case_of(own_scene))["acoustic"])
        fixed_cfl.append(contraction(keys, cfl_times[-1]))
    slope_cfl = float(np.polyfit(np.log(cfl_times), np.log(fixed_cfl), 1)[0])
    panel = axes[0, 2]
    panel.plot(times * 1e6, fixed_h, "o", color="#14539a", label=f"fixed spacing: measured order {slope_h:.2f}")
    panel.plot(
        times * 1e6,
        [theory(dt, gap, scene_with(light)) for dt in times],
        color="#14539a",
        label=f"$(dt/2)^2 \\rho c^2/(g \\rho_s h_w)$, g = {gap * 1e3 / (h * 1e3):.2f} h",
    )
    panel.plot(
        np.array(cfl_times) * 1e6,
        fixed_cfl,
        "s",
        color="#c9641a",
        label=f"fixed CFL 0.8, h {SPACINGS[0]}..{SPACINGS[-1]} mm: order {slope_cfl:.2f}",
    )
    panel.plot(
        np.array(cfl_times) * 1e6,
        fixed_cfl[0] * np.array(cfl_times) / cfl_times[0],
        "--",
        color="#c9641a",
        label="order 1 (van Brummelen)",
    )
    finish(
        panel,
        "contraction per sweep, mass ratio 0.1 at h 0.28 mm",
        "dt (\N{MICRO SIGN}s)",
        "factor on the error",
        log="xy",
    )
    found.append(
        f"A sweep's error factor goes as dt^{slope_h:.2f} at a fixed spacing (theory 2) and as dt^{slope_cfl:.2f} "
        f"at a fixed CFL number (theory 1); the height of liquid a wall node compresses is g = {gap / h:.2f} h."
    )

    grid = {"loose": [], "iterated": []}
    for way, outcomes in grid.items():
        for ratio in MASS_RATIOS:
            keys = {**BASE, "cornea.density_kg_m3": ratio * 1000.0 * h / thickness, "numerics.coupling": way}
            own, own_scene = _rest_figures(keys)
            limit = min(timestep.limits(own, case_of(own_scene)).values())
            for step in STEPS:
                outcomes.append((ratio, step, run({**keys, "numerics.cfl": step * acoustic / limit})))
            say(
                f"  {way:8s} mass ratio {ratio:5.2f}: "
                + " ".join(f"{step:g}{'' if each.stop is None else '!'}" for _, step, each in outcomes[-len(STEPS) :])
            )
    ratios = np.geomspace(0.7 * MASS_RATIOS[0], 1.4 * MASS_RATIOS[-1], 60)
    peaks = {}
    for panel, (way, outcomes) in zip(axes[0, :2], grid.items()):
        dots(panel, [r for r, _, _ in outcomes], [s for _, s, _ in outcomes], [cause(o) for _, _, o in outcomes])
        q_one, in_plane, used = [], [], []
        for ratio in ratios:
            density = ratio * 1000.0 * h / thickness
            light_scene = scene_with({**BASE, "cornea.density_kg_m3": density})
            q_one.append(1.0 / math.sqrt(theory(acoustic, gap, light_scene)))
            in_plane.append(rest["membrane_step"] * math.sqrt(density / scene.cornea.density_kg_m3) / acoustic)
            heavier = dict(
                rest,
                membrane_step=in_plane[-1] * acoustic,
                transverse_speed=rest["transverse_speed"],
                membrane_speed=rest["membrane_speed"],
            )
            used.append(timestep.limits(heavier, case_of(light_scene))["coupling"] / acoustic)
        panel.plot(ratios, q_one, color="#14539a", label="q = 1, with the measured g")
        panel.plot(ratios, used, "--", color="#14539a", label="the coupling limit in the solver's time step")
        panel.plot(ratios, in_plane, "--", color="#8c3a8c", label="in-plane wave of the membrane: dt = L/speed")
        panel.axhline(1.0, color="#22262b", linewidth=1, linestyle=":", label="acoustic limit")
        panel.set_ylim(0.1, 2.5)
        finish(
            panel,
            f"{way} coupling, 0.7 ms",
            r"mass ratio $\rho_s h_{wall} / (\rho_f h)$",
            "dt over the acoustic limit",
            log="x",
            legend="upper left",
        )
        for ratio, step, each in outcomes:
            if each.stop is None:
                peaks.setdefault((ratio, step), {})[way] = each.apex.peak
                if each.energy_share > 0.05:
                    broken.append(
                        f"{way}, mass ratio {ratio:g}, dt {step:g}: ran on with an energy error of "
                        f"{100 * each.energy_share:.0f} %"
                    )
    apart = [abs(both["loose"] / both["iterated"] - 1.0) for both in peaks.values() if len(both) == 2]
    figures["loose_against_iterated_peak"] = max(apart)
    found.append(
        f"Where both run, the apex peaks of loose and iterated coupling agree within {100 * max(apart):.2g} %."
    )

    panel = axes[1, 0]
    for step, colour in zip(STEPS, ("#14539a", "#2a9d9d", "#3d8b57", "#a88a1a", "#c9641a", "#b03a48")):
        chosen = [(r, o) for r, s, o in grid["iterated"] if s == step and o.stop is None]
        if chosen:
            panel.plot(
                [r for r, _ in chosen],
                [o.traces["coupling_iterations"][1:].max() for _, o in chosen],
                "o-",
                color=colour,
                markersize=4,
                label=f"dt {step:g} of the acoustic limit",
            )
    finish(
        panel,
        "most sweeps of a step (Aitken, to 1e-8)",
        r"mass ratio $\rho_s h_{wall} / (\rho_f h)$",
        "sweeps",
        log="x",
    )

    say("  relaxation limits")
    qs, limits_found = [], []
    for ratio in (0.02, 0.05, 0.1, 0.3, 1.0):
        keys = {**BASE, "cornea.density_kg_m3": ratio * 1000.0 * h / thickness, "numerics.duration_ms": 0.1}
        qs.append(contraction(keys, acoustic))
        low, high = 0.0, 2.2
        while high - low > 0.02:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if _converges(keys, acoustic, middle) else (low, middle)
        limits_found.append(0.5 * (low + high))
    panel = axes[1, 1]
    fine = np.geomspace(0.5 * min(qs), 2.0 * max(qs), 80)
    panel.plot(fine, 2.0 / (1.0 + fine), color="#14539a", label="2 / (1 + q)")
    panel.plot(qs, limits_found, "o", color="#c9641a", label="measured: largest factor that converges")
    mu = _added_height(scene)
    m = 1050.0 * thickness
    panel.axhline(
        2.0 * m / (m + 1000.0 * mu),
        color="#3d8b57",
        linestyle="--",
        label="Causin, Gerbeau, Nobile: the eye's wall, incompressible",
    )
    finish(
        panel, "relaxation factor (fixed), dt at the acoustic limit", "q of a plain sweep, measured", "factor", log="x"
    )
    worst = max(abs(w * (1.0 + q) / 2.0 - 1.0) for w, q in zip(limits_found, qs))
    found.append(
        f"Fixed relaxation converges up to 2/(1 + q), measured within {100 * worst:.0f} %. "
        "Causin, Gerbeau and Nobile's "
        f"limit for an incompressible liquid under the eye's wall is {2.0 * m / (m + 1000.0 * mu):.2f} (their mass "
        f"ratio {m / (1000.0 * mu):.3f} says that loose coupling never holds); a compressible explicit step never "
        "meets that added mass."
    )

    panel = axes[1, 2]
    spacings = np.geomspace(0.05, 2.0, 60)
    factor = mass_ratio(scene_with({})) * SPACINGS[1]
    eye = fixed_cfl[1] * 0.1 * spacings / factor
    panel.plot(spacings, eye, color="#14539a", label="predicted for the eye's wall, cfl 0.8, any c")
    eye_h, eye_q = [], []
    for spacing in SPACINGS:
        keys = {"numerics.spacing_mm": spacing}
        own, own_scene = _rest_figures(keys)
        eye_h.append(spacing)
        eye_q.append(contraction(keys, 0.8 * timestep.limits(own, case_of(own_scene))["acoustic"]))
    panel.plot(eye_h, eye_q, "o", color="#c9641a", label="measured")
    panel.axhline(1.0, color="#22262b", linestyle=":", linewidth=1, label="loose coupling blows up above")
    finish(panel, "the eye: factor per sweep against spacing", "spacing h (mm)", "q", log="xy")
    reach = eye_h[0] / eye_q[0]
    figures.update(
        {
            "order_fixed_spacing": slope_h,
            "order_fixed_cfl": slope_cfl,
            "gap_over_h": gap / h,
            "relaxation": {"q": qs, "largest_factor": limits_found},
            "eye_q": dict(zip(map(str, eye_h), eye_q)),
            "eye_loose_until_mm": reach,
        }
    )
    found.append(
        f"The eye (rho_s h_wall = {m:.3f} kg/m2): q is {eye_q[-1]:.3f} at h {eye_h[-1]:g} mm and proportional to h, so "
        f"loose coupling is enough at every spacing the chamber can hold (q would reach 1 at h = {reach:.1f} mm) and "
        "gives the same history; iterated coupling costs 4 to 6 sweeps over the wall nodes alone."
    )
    lost = {way: max((r for r, s, o in outcomes if s == 0.9 and o.stop), default=0.0) for way, outcomes in grid.items()}
    found.append(
        f"Light walls: at 0.9 of the acoustic limit loose coupling blows up at mass ratios up to {lost['loose']:g} and "
        f"iterated coupling up to {lost['iterated']:g}. Iterating buys little there: it converges (in more sweeps), "
        "yet the converged step is itself unstable near q = 1 and, below a mass ratio of 0.05, from q about 0.5 on. So "
        "the step, not the number of sweeps, has to shrink; every such run was stopped."
    )
    late = [
        (way, r, s)
        for way, outcomes in grid.items()
        for r, s, o in outcomes
        if o.stop is None
        and theory(s * acoustic, gap, scene_with({**BASE, "cornea.density_kg_m3": r * 1000.0 * h / thickness})) > 1.5
    ]
    broken += [f"{way}, mass ratio {r:g}, dt {s:g}: q above 1.5 and no stop" for way, r, s in late]
    body = [
        (
            way,
            f"{r:g}",
            *("ran" if o.stop is None else f"{cause(o)} {o.stop.time_ms:.3f} ms" for rr, _, o in outcomes if rr == r),
        )
        for way, outcomes in grid.items()
        for r in MASS_RATIOS
    ]
    return Map(
        "coupling", canvas, found, ("coupling", "mass ratio", *(f"dt {s:g}" for s in STEPS)), body, figures, broken
    )


def _added_height(scene) -> float:
    """Largest mu_i of Causin, Gerbeau and Nobile [m] for a chamber of twice the limbus radius and the cap's depth."""
    length, depth = 2.0e-3 * scene.cornea.limbus_radius_mm, 1e-3 * scene.chamber.depth_mm
    return length / (math.pi * math.tanh(math.pi * depth / length))
