"""The coupled step against a bare gather, on one thread and on all, and what small scenes pay on top.

Bare gather: one kernel that for every node reads the frozen weights which a step needs at the least, gradient and
Laplacian of its stencil, gathers pressure and velocity of the neighbours and writes grad p, grad u and lap u; f64, the
same 14 neighbours, the same weights, one pass, images only where a stencil has them. The coupled step has to do more
than that: its two passes gather pressure, velocity and the gradients of both (the dissipation's), and between them the
cornea moves and is matched to the liquid. "Own gathers" is those two passes without what is done with their results.
On the processor's own counters a step takes 2.2 bare gathers at 4089 nodes and 2.6 at 16093, whose fields no longer fit
the core's cache; launching the bare gather adds to its clock what a busy machine makes of waking a thread.

Node-updates per second are nodes over time; the puff rises by 1 kPa/ms, about its steepest. A small scene is held
against its nodes times the time of a node-update at 4000 nodes, all on one thread.
"""

import numpy as np

from taichi_eye import backend
from taichi_eye.backend import real
from taichi_eye.bench.rows import Row, at_least, at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.lang import ti
from taichi_eye.mfpm.neighbours import image_of
from taichi_eye.scene import load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation
from taichi_eye.solver.timestep import stable_step

LARGE_MM, SMALL_MM = (0.055, 0.0275), (0.25, 0.2, 0.115)
SHARE = 0.5  # of a bare gather's node-updates per second
SMALL_COST = 1.5  # of the nodes times a node-update's time at 4000 nodes
TURNS = 15
RISE = 1e6  # Pa/s


@ti.data_oriented
class Gathers:
    """The bare gather, and the step's own two, on the fields of a simulation."""

    def __init__(self, simulation: Simulation):
        self.aqueous, self.operators = simulation.aqueous, simulation.aqueous.operators
        self.out = ti.Vector.field(8, real(), self.aqueous.capacity)

    @ti.func
    def _row(self, i, images: ti.template()):
        p, u = self.aqueous.pressure[i], self.aqueous.velocity[i]
        slope, laplacian = ti.Vector([0.0, 0.0]), ti.Vector([0.0, 0.0])
        slopes = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
        for k in range(self.operators.size[i]):
            j, sign = self.aqueous.neighbours.entry[i, k], 1
            if ti.static(images):
                j, sign = image_of(j)
            weight, d = self.operators.gradient_weight[i, k], self.aqueous.velocity[j]
            if ti.static(images):
                d[0] *= sign
            d -= u
            slope += weight * (self.aqueous.pressure[j] - p)
            laplacian += self.operators.laplacian_weight[i, k] * d
            slopes += ti.Matrix([[d[0] * weight[0], d[0] * weight[1]], [d[1] * weight[0], d[1] * weight[1]]])
        self.out[i] = ti.Vector(
            [slope[0], slope[1], laplacian[0], laplacian[1], slopes[0, 0], slopes[0, 1], slopes[1, 0], slopes[1, 1]]
        )

    @ti.kernel
    def bare(self):
        """grad p, grad u and lap u at every node."""
        for i in range(self.aqueous.count[0]):
            if self.operators.mirrored[i] == 0:
                self._row(i, False)
            else:
                self._row(i, True)

    @ti.kernel
    def own(self):
        """The two passes of a step over the stencils."""
        for i in range(self.aqueous.count[0]):
            rough = self.aqueous.differentiate_pressure(i)
            self.out[i][0], self.out[i][1] = rough[0], rough[1]
        for i in range(self.aqueous.count[0]):
            self.out[i][2] = self.aqueous.differentiate_velocity(i)


def steps_of(scene, cloud, count: int):
    """A simulation at rest, and a call that takes `count` coupled steps of it under a rising puff."""
    simulation = Simulation(scene, cloud)
    dt, _ = stable_step(simulation.survey.take(), simulation.case)
    taken = 0

    def advance():
        nonlocal taken
        simulation.coupling.advance(RISE * dt * np.arange(taken, taken + count), dt, dt)
        taken += count
        ti.sync()

    advance()
    return simulation, advance


def measure(stage, large_mm=LARGE_MM, small_mm=SMALL_MM):
    """Shares of the bare gather by size and threads, and the small scenes' cost."""
    threads = backend.threads()
    rows: list[Row] = []
    node_update = None
    try:
        for count in sorted({1, threads}):
            backend.init("cpu", "f64", count)
            for spacing in large_mm:
                stage(f"{spacing:g} mm on {count} thread{'s' * (count > 1)}")
                found, took = _compare(spacing, count)
                rows += found
                node_update = node_update or took
        backend.init("cpu", "f64", 1)
        for spacing in small_mm:
            stage(f"{spacing:g} mm on 1 thread")
            rows.append(_small(spacing, node_update))
    finally:
        backend.init("cpu", "f64", threads)
    return rows, []


def _scene(spacing):
    scene = load_scene(None, [f"numerics.spacing_mm={spacing}"])
    return scene, cloud_of(scene)


def _compare(spacing, threads):
    scene, cloud = _scene(spacing)
    count = 20
    simulation, advance = steps_of(scene, cloud, count)
    gathers = Gathers(simulation)

    def repeated(kernel):
        def run():
            for _ in range(count):
                kernel()
            ti.sync()

        run()
        return run

    best = best_of({"step": advance, "bare": repeated(gathers.bare), "own": repeated(gathers.own)}, TURNS)
    took = {name: seconds / count / cloud.count for name, seconds in best.items()}
    where = f"{cloud.count} nodes, {threads} thread{'s' * (threads > 1)}"
    sweeps = f"at most {simulation.coupling.sweeps[0]} sweeps a step, best of {TURNS}"
    return [
        figure(f"bare gather, {where}", 1e-6 / took["bare"], "M/s", "node-updates per second"),
        figure(f"coupled step, {where}", 1e-6 / took["step"], "M/s", sweeps),
        at_least(f"coupled step over bare gather, {where}", took["bare"] / took["step"], "", SHARE, sweeps),
        figure(f"coupled step over its own gathers, {where}", took["own"] / took["step"], "", sweeps),
    ], took["step"]


def _small(spacing, node_update):
    scene, cloud = _scene(spacing)
    count = 200
    _, advance = steps_of(scene, cloud, count)
    took = best_of({"step": advance}, TURNS)["step"] / count
    return at_most(
        f"step of {cloud.count} nodes over {cloud.count} node-updates",
        took / (cloud.count * node_update),
        "",
        SMALL_COST,
        f"{1e6 * took:.1f} us a step on one thread",
    )
