"""Time step: blow-up or not over (cfl, dissipation), against what leapfrog and lagged dissipation predict.

The leapfrog takes u' = (1 - d dt) u - w dt p, p' = (1 - d dt) p + w dt u' for a mode of frequency w whose pressure and
velocity the dissipation damps at d, both lagged. Its multipliers have product (1 - d dt)^2 and sum
2 (1 - d dt) - (w dt)^2; one passes -1 where (w + d) dt = 2. The highest w and the highest d belong to different modes
(a zigzag is damped most and has no gradient), so (w + d) dt = 2 with both spectral radii is sufficient, and
(w dt)^2/4 + d dt/2 = 1, the limit of a mode damped in one variable only, lies beyond it. w and d are measured with the
solver's kernels: w^2 is the spectral radius of rho c^2 div (grad p / rho) between rigid walls, d that of alpha c h P.

A sample of the traces holds a whole number of steps, some 16 at cfl 1 here, so the steps taken are up to 6 % shorter
than the cfl asked for.
"""

import numpy as np

from taichi_eye.lang import ONE_TASK, ti
from taichi_eye.proof.maps.result import Map, dots, finish, panels
from taichi_eye.proof.maps.runs import cause, cloud_for, run, scene_with
from taichi_eye.solver import timestep
from taichi_eye.solver.case import case_of
from taichi_eye.solver.simulation import Simulation

PUFF = {"puff.duration_ms": 4.0, "numerics.duration_ms": 4.4, "numerics.sound_speed_m_s": 120.0}
CFL = (0.4, 0.8, 1.0, 1.1, 1.2, 1.3, 1.4, 1.6, 1.8)
DISSIPATION = (0.0, 0.1, 0.2, 0.25, 0.3, 0.5, 0.75, 1.0)
SWEEPS = 300  # of the power iteration


@ti.data_oriented
class Radii:
    """Spectral radii of the aqueous humour's operators at the present places of a simulation.

    Overwrites its pressures and velocities: the simulation is of no further use.
    """

    def __init__(self, simulation: Simulation):
        self.aqueous, self.cornea = simulation.aqueous, simulation.cornea
        self.count = simulation.cloud.count

    @ti.kernel
    def _wave(self, p: ti.types.ndarray(), after: ti.types.ndarray()):
        # after = rho c^2 div (grad p / rho), the velocity meeting resting walls
        nodes, walls = self.aqueous.count[0], self.aqueous.wall_count[0]
        zero = ti.Vector([0.0, 0.0])
        length = self.aqueous.dissipation_length[0]
        for i in range(nodes):
            self.aqueous.velocity[i], self.aqueous.laplacian[i], self.aqueous.pressure[i] = zero, zero, 0.0
            self.aqueous.velocity_gradient[i] = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            self.aqueous.slopes[i] = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            self.aqueous.lay_momentum_row(i, p[i])
        for i in range(walls):
            self.cornea.velocity[i] = zero
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.aqueous.dissipation_length[0] = 0.0
        for i in range(nodes):
            self.aqueous.kick(0, i, 1.0, self.cornea.velocity)
        for i in range(walls):
            self.aqueous.velocity[i] = self.aqueous.meet_wall(0, i, self.cornea.place, zero)
        for i in range(nodes):
            self.aqueous.find_velocity_gradient(0, i)
        for i in range(nodes):
            after[i] = self.aqueous.density0[0] * self.aqueous.sound_speed[0] ** 2 * self.aqueous.divergence[i]
        ti.loop_config(serialize=True)
        for _ in range(ONE_TASK):
            self.aqueous.dissipation_length[0] = length

    @ti.kernel
    def _damp(self, p: ti.types.ndarray(), after: ti.types.ndarray()):
        # after = alpha c h P p
        nodes = self.aqueous.count[0]
        for i in range(nodes):
            self.aqueous.velocity[i], self.aqueous.pressure[i] = ti.Vector([0.0, 0.0]), 0.0
            self.aqueous.lay_momentum_row(i, p[i])
        for i in range(nodes):
            self.aqueous.kick(0, i, 0.0, self.cornea.velocity)
        for i in range(nodes):
            after[i] = self.aqueous.dissipation_length[0] * self.aqueous.differentiate_velocity(i)

    def _radius(self, operator) -> float:
        vector = np.random.default_rng(1).standard_normal(self.count)
        after = np.empty_like(vector)
        grown = []
        for _ in range(SWEEPS):
            vector /= np.linalg.norm(vector)
            operator(vector, after)
            grown.append(np.linalg.norm(after))
            vector, after = after.copy(), vector
        # a pair of equal moduli makes the growth swing; its mean over the tail does not
        return float(np.exp(np.mean(np.log(grown[SWEEPS // 2 :]))))

    def measure(self) -> tuple[float, float]:
        """w [rad/s] and, for the dissipation of the scene, d [1/s]."""
        return np.sqrt(self._radius(self._wave)), self._radius(self._damp)


def _radii(time_ms: float) -> tuple[float, float, dict]:
    """w and d per unit of dissipation at a time of the puff, and the survey's figures then."""
    scene = scene_with({**PUFF, "numerics.duration_ms": max(time_ms, 0.01)})
    simulation = Simulation(scene, cloud_for(scene))
    simulation.run()
    figures = simulation.survey.take()
    simulation.aqueous.rebuild()
    w, d = Radii(simulation).measure()
    return w, d / scene.numerics.dissipation, figures


def largest_steps(w: float, d: float) -> tuple[float, float]:
    """dt [s] at which (w + d) dt = 2 and at which (w dt)^2/4 + d dt/2 = 1."""
    return 2.0 / (w + d), (-d + np.sqrt(d * d + 4.0 * w * w)) / (w * w)


def time_step(say=print) -> Map:
    """Runs over (cfl, dissipation), the border predicted from measured radii at rest and at the deepest dent."""
    base = run(PUFF)
    deepest = base.apex.peak_time_ms
    places = {"at rest": _radii(0.0), f"at {deepest:.1f} ms, dented {base.apex.peak:.2f} mm": _radii(deepest)}
    unit = base.scene.numerics.sound_speed_m_s / (base.scene.numerics.spacing_mm * 1e-3)
    outcomes = []
    for dissipation in DISSIPATION:
        row = [run({**PUFF, "numerics.cfl": cfl, "numerics.dissipation": dissipation}) for cfl in CFL]
        outcomes += row
        say(
            f"  dissipation {dissipation:4.2f}: "
            + " ".join(f"{cfl:g}{'' if each.stop is None else '!'}" for cfl, each in zip(CFL, row))
            + "   (! stopped)"
        )
    broken, border = [], {}
    for each in outcomes:
        numerics = each.scene.numerics
        off = abs(each.apex.peak / base.apex.peak - 1.0)
        if each.stop is None and (off > 0.02 or each.energy_share > 0.03):
            broken.append(
                f"cfl {numerics.cfl:g}, dissipation {numerics.dissipation:g}: ran on, peak {100 * off:.1f} % "
                f"off, energy error {100 * each.energy_share:.1f} %"
            )
        if each.stop is None:
            border[numerics.dissipation] = max(border.get(numerics.dissipation, 0.0), numerics.cfl)
    canvas, ((left, right),) = panels(2)
    dots(
        left,
        [each.scene.numerics.dissipation for each in outcomes],
        [each.scene.numerics.cfl for each in outcomes],
        [cause(each) for each in outcomes],
    )
    fine = np.linspace(0.0, 1.0, 101)
    predicted = {}
    for (label, (w, per_unit, figures)), colour in zip(places.items(), ("#14539a", "#c9641a")):
        lines = [[], []]
        for alpha in fine:
            scene = scene_with({**PUFF, "numerics.dissipation": float(alpha)})
            limit = min(timestep.limits(figures, case_of(scene)).values())
            for line, step in zip(lines, largest_steps(w, per_unit * alpha)):
                line.append(step / limit)
        left.plot(fine, lines[0], color=colour, label=f"(w + d) dt = 2, {label}")
        left.plot(fine, lines[1], color=colour, linestyle="--", label="(w dt)$^2$/4 + d dt/2 = 1")
        predicted[label] = {
            "w_c_per_h": w / unit,
            "d_c_per_h_per_unit": per_unit / unit,
            "cfl_at_0.5": [float(np.interp(0.5, fine, line)) for line in lines],
        }
    left.axhline(1.0, color="#22262b", linewidth=1, linestyle=":", label="cfl = 1, the most a scene may ask for")
    left.axvspan(-0.03, 0.225, color="#b03a48", alpha=0.06, label="grows at any step (spectrum)")
    left.set_ylim(0.3, 3.0)
    finish(
        left,
        f"{PUFF['puff.duration_ms']:g} ms puff, h 0.28 mm, c 120 m/s",
        "dissipation (c h)",
        "time step over the solver's stable step (cfl)",
        legend="upper right",
    )
    for dissipation, colour in zip((0.0, 0.2, 0.3, 0.5, 1.0), ("#b03a48", "#c9641a", "#a88a1a", "#3d8b57", "#14539a")):
        chosen = [each for each in outcomes if each.scene.numerics.dissipation == dissipation]
        right.plot(
            CFL,
            [each.stop.time_ms if each.stop else PUFF["numerics.duration_ms"] for each in chosen],
            "o-",
            color=colour,
            markersize=4,
            label=f"dissipation {dissipation:g}",
        )
    right.axhline(PUFF["numerics.duration_ms"], color="#22262b", linewidth=1, linestyle=":", label="end of the run")
    finish(right, "when the guard stops it", "cfl", "simulated time reached (ms)")
    stable = [a for a in DISSIPATION if border.get(a, 0.0) >= 1.0]
    first = places["at rest"]
    found = [
        f"Measured radii at rest: w = {first[0] / unit:.2f} c/h, d = {first[1] / unit:.2f} dissipation c/h.",
        f"With dissipation {min(stable, default=float('nan')):g} and above every cfl up to 1 "
        "runs; below it no time step "
        "helps: the semi-discrete system itself grows (see the spectrum)."
        if stable
        else "No dissipation was stable at cfl 1.",
        "Largest cfl that ran: " + ", ".join(f"{border[a]:g} at {a:g}" for a in stable) + ".",
    ]
    head = ("dissipation", *(f"cfl {cfl:g}" for cfl in CFL))
    body = [
        (
            f"{a:g}",
            *(
                "ran" if each.stop is None else f"{cause(each)} {each.stop.time_ms:.1f} ms"
                for each in outcomes
                if each.scene.numerics.dissipation == a
            ),
        )
        for a in DISSIPATION
    ]
    return Map(
        "time-step",
        canvas,
        found,
        head,
        body,
        {"largest_cfl": {f"{a:g}": value for a, value in border.items()}, "predicted": predicted},
        broken,
    )
