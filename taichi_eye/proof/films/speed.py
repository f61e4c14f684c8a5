"""How fast frames are drawn, and what filming adds to a run.

Frames a second: 576 x 200, from the wall on the device to the image in memory, best of several batches, full optics,
plain band and both views in turn. Share: (run with film - run without)/(run without) of the default eye, which is
configs/seed.toml:
both views, film.mp4 encoded beside the simulation and finished; kernels compiled before, best of two runs each, in
turn.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from matplotlib.figure import Figure

from taichi_eye.bench.rows import Row, at_least, at_most, figure
from taichi_eye.bench.timing import best_of
from taichi_eye.film import FilmView, FilmWriter, FrameState, Scheimpflug
from taichi_eye.proof.films.eyes import EYES, INTERVAL_MS, Studio
from taichi_eye.scene import Scene, load_scene
from taichi_eye.solver.case import cloud_of
from taichi_eye.solver.simulation import Simulation

BATCH, BATCHES = 50, 7
TURNS = 2


def measure(stage) -> tuple[list[Row], list[Figure]]:
    """Frames a second, and the share of a run."""
    stage("frames a second")
    studio, eye = Studio(), EYES[0]
    full, plain = eye.scene(), eye.scene("camera.optics=plain")
    state = studio.state(eye, full, 14.0)
    views = {"full": Scheimpflug(full), "plain": Scheimpflug(plain)}

    def batch(view):
        for k in range(BATCH):
            state.time_ms = k * INTERVAL_MS  # other noise, another stamp
            view.render(state)

    jobs = {name: lambda view=view: batch(view) for name, view in views.items()}
    for job in jobs.values():
        job()
    best = {name: BATCH / seconds for name, seconds in best_of(jobs, BATCHES).items()}
    stage("a run with and without its film")
    scene = load_scene()
    cloud = cloud_of(scene)
    view = _compiled(scene, cloud)
    with tempfile.TemporaryDirectory() as folder:
        took = best_of(
            {
                "without": lambda: Simulation(scene, cloud).run(),
                "with": lambda: _filmed(scene, cloud, view, Path(folder)),
            },
            TURNS,
        )
    share = 100.0 * (took["with"] / took["without"] - 1.0)
    return [
        at_least("full optics, 576 x 200", best["full"], "frames/s", 500.0),
        at_least("plain band, 576 x 200", best["plain"], "frames/s", 1500.0),
        figure("the default eye without a film", took["without"], "s"),
        at_most("what its film adds", share, "%", 15.0, "139 frames, both views, encoder included"),
    ], []


def _compiled(scene: Scene, cloud) -> FilmView:
    """The view of a run that has been drawn and run once: what the runs need is compiled."""
    view, simulation = FilmView(scene), Simulation(scene, cloud)
    simulation.run(lambda eye, frame: view.render(_state(eye)) if frame == 0 else None)
    return view


def _filmed(scene: Scene, cloud, view: FilmView, folder: Path) -> None:
    with FilmWriter(folder / "film.mp4", scene.output.film_fps) as film:
        Simulation(scene, cloud).run(lambda eye, frame: film.write(view.render(_state(eye))))


def _state(eye: Simulation) -> FrameState:
    place, velocity, pressure, count = eye.liquid()
    traces = eye.traces
    return FrameState(
        eye.time_ms,
        eye.cornea.place,
        eye.wall_count,
        place,
        count,
        pressure,
        velocity,
        traces["time_ms"],
        traces["apex_displacement_mm"],
        traces["puff_apex_kpa"],
    )
