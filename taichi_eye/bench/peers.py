"""This solver's liquid beside PySPH's weakly compressible schemes: same machine, same run, same flows, in turns.

PySPH (Ramachandran et al., ACM Trans. Math. Softw. 47:4, 2021) is installed by pip into an environment of its own in
the user's cache folder and runs its own Taylor-Green example (`taichi_eye.bench.pysph_cases`): Re 100, c = 10 U, unit
periodic box, the example's kernel and time step, with OpenMP on one thread and on all that the bench has, in turns: the
quicker counts. Entered are EDAC, the best of its schemes here, on the lattice and on a lattice perturbed by 0.2 dx as
its authors do, and the example's default, TVF, perturbed. At n = 50 to t = 1: EDAC 5 %, perturbed 1.3 %; TVF 45 %,
perturbed 9 %; GTVF 26 %; WCSPH 90 %. A scheme that is nearer on a coarser lattice keeps that point.

Here: the solver's own fluid kernels (`taichi_eye.proof.flow`) with the default dissipation of 0.5, f64, on the same
whole box, all four vortices, one thread. Nodes rest, as they do in the eye where the wall rests; PySPH's particles are
carried along. Both have the exact velocity as their measure: L2 error at t = 1, at their own nodes. Compilation and
set-up count for neither. Time at equal error: between runs by log-log interpolation, from the quickest run or scheme at
that error.

Sound in a closed box: u = A sin(2 pi x) over two periods, inviscid; the walls are planes of symmetry of the periodic
box. Entered are WCSPH and TVF, whose lattice never moves there.

Both on one thread, times here over PySPH's at equal error: Taylor-Green at 10 / 5 / 2 % 20 / 26 / 41 times less, sound
at 2 / 0.5 / 0.2 % 66 / 37 / 26 times less; 3 M updates/s against 0.06 and 0.12. Node for node PySPH is the nearer of
the two on the vortices (625 nodes for 2.4 %, here some 2800), whose error here is the dissipation's, third order in h:
it is the price of stability between walls, and with 0.1 instead of 0.5 it would be a seventh.

Not entered: jax-sph (pip found no distribution of it when tried) and Warp, which has kernels and a neighbour grid but
no solver of such flows: it would be a solver of this project.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye import backend
from taichi_eye.bench.rows import at_least, figure, skipped
from taichi_eye.bench.timing import best_of
from taichi_eye.proof.domains import periodic_box
from taichi_eye.proof.flow import Flow
from taichi_eye.proof.viscous import DISSIPATION, stable_step
from taichi_eye.report.page import COLOURS

ASKED = 10.0
LEVELS = 0.1, 0.05, 0.02  # L2 errors at which Taylor-Green is compared
WAVE_LEVELS = 0.02, 0.005, 0.002
REYNOLDS, SOUND_SPEED, PERIODS = 100.0, 10.0, 2.0
SPACINGS = 0.05, 0.0354, 0.025, 0.0177, 0.0125
LATTICES = 12, 18, 25, 50
SCHEMES = {"EDAC": ("edac", 0.0), "EDAC, perturbed": ("edac", 0.2), "TVF, perturbed": ("tvf", 0.2)}
WAVE_SCHEMES = {"WCSPH": ("wcsph", 0.0), "TVF": ("tvf", 0.0)}
PACKAGE = "pysph"
PATIENCE_S = 1200.0


class PeerMissing(Exception):
    """The other code cannot be had; says why."""


def measure(stage):
    """Updates/s of both codes, times and their ratio at equal error, for both flows; a log-log plot of each."""
    try:
        python = environment(stage)
    except PeerMissing as reason:
        return [skipped("Taylor-Green against PySPH", str(reason), f">= {ASKED:g}")], []
    rows, figures = [], []
    flow_of = _Box(SPACINGS)
    for case, title, schemes, levels, asked in (
        ("taylor-green", "Taylor-Green, Re 100", SCHEMES, LEVELS, ASKED),
        ("standing-wave", "sound in a closed box", WAVE_SCHEMES, WAVE_LEVELS, None),
    ):
        ours: dict[float, Run] = {}
        theirs: dict[tuple, Run] = {}
        for threads in threads_in_turn():
            for nx in LATTICES:
                for name, (scheme, perturb) in schemes.items():
                    stage(f"{title}: PySPH {name}, {nx} x {nx}, {threads} threads")
                    _keep(theirs, (name, nx), run_pysph(python, case, scheme, nx, perturb, threads))
            for spacing in SPACINGS:
                stage(f"{title}: spacing {spacing:g}")
                _keep(ours, spacing, flow_of.run(case, spacing))
        mine = [list(ours.values())]
        peers = [[theirs[name, nx] for nx in LATTICES] for name in schemes]
        rows += compare(title, mine, peers, levels, asked)
        figures.append(
            plot(title, {"taichi_eye": mine[0], **{f"PySPH {name}": runs for name, runs in zip(schemes, peers)}})
        )
    rows.append(skipped("jax-sph, Warp", "no distribution found by pip; no solver of such flows"))
    return rows, figures


def threads_in_turn() -> list[int]:
    """What PySPH runs on, in turns: one thread, and all that the bench has."""
    return [1, max(backend.threads(), 2)]


class Run(dict):
    """One run: nodes, steps, seconds, error."""

    @property
    def rate(self) -> float:
        """Node updates per second."""
        return self["nodes"] * self["steps"] / self["seconds"]


def _keep(runs, key, run):
    if key not in runs or run["seconds"] < runs[key]["seconds"]:
        runs[key] = run


def environment(stage) -> str:
    """The Python of an environment with PySPH, made on first use in the user's cache folder; else PeerMissing."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taichi_eye" / "peers"
    python = cache / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ready = (str(python), "-c", "import pysph.examples.taylor_green")
    try:
        if not python.exists() or subprocess.run(ready, capture_output=True, timeout=PATIENCE_S).returncode:
            stage(f"installing {PACKAGE} in {cache}")
            for command in (
                (sys.executable, "-m", "venv", str(cache)),
                (str(python), "-m", "pip", "install", PACKAGE),
                ready,
            ):
                done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
                if done.returncode:
                    last = (done.stderr.strip() or "no message").splitlines()[-1]
                    raise PeerMissing(f"{PACKAGE} cannot be installed ({last})")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PeerMissing(f"{PACKAGE} cannot be installed ({error})") from None
    return str(python)


def run_pysph(python: str, case: str, scheme: str, nx: int, perturb: float, threads: int) -> Run:
    """One run of PySPH in its environment."""
    script = Path(__file__).with_name("pysph_cases.py")
    done = subprocess.run(
        [python, str(script), case, scheme, str(nx), str(perturb)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env=os.environ | {"OMP_NUM_THREADS": str(threads)},
    )
    if done.returncode:
        raise RuntimeError(f"PySPH {scheme} at {nx} x {nx} failed:\n{done.stderr[-2000:]}")
    return Run(json.loads(done.stdout.splitlines()[-1]))


class _Box:
    """The periodic unit box on this side; one `Flow` takes all spacings."""

    def __init__(self, spacings):
        self.boxes = {spacing: periodic_box(spacing) for spacing in spacings}
        self.flow = Flow(max(cloud.count + len(images.source) for cloud, images in self.boxes.values()), planar=True)

    def run(self, case: str, spacing: float) -> Run:
        """One run to t = 1 or over the periods of the wave."""
        (cloud, images), flow = self.boxes[spacing], self.flow
        x, z = 2.0 * np.pi * cloud.points.T
        viscous = case == "taylor-green"
        nu = 1.0 / REYNOLDS if viscous else 0.0
        span = 1.0 if viscous else PERIODS / SOUND_SPEED
        limit = stable_step(spacing, SOUND_SPEED, max(nu, 1e-12))
        steps = math.ceil(span / limit)
        dt = span / steps
        if viscous:
            before = np.column_stack([np.sin(x) * np.cos(z), -np.cos(x) * np.sin(z)])
            after = math.exp(-8.0 * math.pi**2 * nu * span) * before
            pressure = 0.25 * (np.cos(2.0 * x) + np.cos(2.0 * z))
        else:
            # velocities live half a step before the pressures
            late = math.cos(2.0 * math.pi * SOUND_SPEED * 0.5 * dt)
            before = after = 1e-3 * late * np.column_stack([np.sin(x), np.zeros_like(x)])
            pressure = np.zeros_like(x)
        flow.setup(cloud, images, density=1.0, viscosity=nu, sound_speed=SOUND_SPEED, dissipation=DISSIPATION)
        flow.advance(0, dt, 0.0, 0.0, 0.0)  # compiles
        flow.set(before, pressure)
        took = best_of({"run": lambda: flow.advance(steps, dt, 0.0, 0.0, 0.0)}, 1)["run"]
        error = np.linalg.norm(flow.velocity() - after) / np.linalg.norm(after)
        return Run(nodes=cloud.count, steps=steps, seconds=took, error=float(error))


def time_at(error: float, series) -> float:
    """Shortest time [s] at which one of several series of runs, each in order of size, has the error; inf where none
    has.

    Between neighbours of a series that lie on both sides of the error: log-log; a run below it counts as it is.
    """
    best = math.inf
    for runs in series:
        best = min([best, *(run["seconds"] for run in runs if run["error"] <= error)])
        for a, b in zip(runs, runs[1:]):
            low, high = sorted((a["error"], b["error"]))
            if low <= error <= high and low < high:
                share = math.log(error / a["error"]) / math.log(b["error"] / a["error"])
                best = min(best, a["seconds"] * (b["seconds"] / a["seconds"]) ** share)
    return best


def compare(title, mine, peers, levels, asked):
    """Rows of one flow: updates/s, and times at equal error with their ratio."""
    rows = []
    for name, series in (("taichi_eye", mine), ("PySPH", peers)):
        best = max((run for runs in series for run in runs), key=lambda run: run.rate)
        rows.append(figure(f"{title}: updates/s, {name}", 1e-6 * best.rate, "M/s", f"{best['nodes']} nodes"))
    for level in levels:
        here, there = time_at(level, mine), time_at(level, peers)
        name = f"{title}: quicker than PySPH at {100 * level:g} % error"
        if not math.isfinite(here) or not math.isfinite(there):
            who = "taichi_eye" if not math.isfinite(here) else "PySPH"
            rows.append(skipped(name, f"{who} does not reach it at the resolutions run"))
        else:
            note = f"{here:.3g} s against {there:.3g} s"
            rows.append(
                at_least(name, there / here, "times", asked, note)
                if asked
                else figure(name, there / here, "times", note)
            )
    return rows


def plot(title, series) -> Figure:
    """Time against error of each series, log-log."""
    canvas = Figure(figsize=(6.4, 4.3), dpi=110, layout="constrained")
    axes = canvas.subplots()
    for (name, runs), colour in zip(series.items(), COLOURS):
        axes.loglog(
            [run["error"] for run in runs],
            [run["seconds"] for run in runs],
            "o-",
            color=colour,
            label=name,
            markersize=4,
            linewidth=1.5,
        )
        for run in runs:
            axes.annotate(
                str(run["nodes"]),
                (run["error"], run["seconds"]),
                (4, 4),
                textcoords="offset points",
                fontsize=7,
                color=colour,
            )
    axes.set(title=f"{title}: time to an error (numbers: nodes)", xlabel="L2 error of the velocity", ylabel="seconds")
    axes.grid(color="#e4e7ea", linewidth=0.6)
    axes.legend(fontsize=8, frameon=False)
    return canvas
