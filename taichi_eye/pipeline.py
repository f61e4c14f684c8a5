"""From a scene to a run folder: simulate, film while it runs, report.

The folder holds film.mp4, apex.png, sheet.png, traces.csv, wall.npz, summary.json and scene.toml; on request film.gif,
the folder frames/ with a PNG per frame, and fields/ for ParaView. Every file appears whole or not at all. A run that a
guard stops
or the user interrupts leaves the same files up to that time, and its summary says so.
"""

import json
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from taichi_eye import backend
from taichi_eye.errors import RunStopped
from taichi_eye.eye.globe import retreat_mm
from taichi_eye.film import FilmView, FilmWriter, FrameState, write_gif
from taichi_eye.ladder.choose import Choice, choose
from taichi_eye.ladder.rungs import needs_cloud, simulation_of
from taichi_eye.report.compare import Measured, differences, read_measured
from taichi_eye.report.folder import create_run_folder, refuse_taken, write_text
from taichi_eye.report.history import summarise
from taichi_eye.report.traces import write_traces, write_wall
from taichi_eye.scene import Scene, dump_scene
from taichi_eye.solver.simulation import cloud_of
from taichi_eye.units import MM

KEPT_FRAMES = 300  # frames held for the sheet and the GIF; a longer film is thinned
BALANCE_DOUBTED = 0.02  # energy error over the puff's work
SQUEEZE_DOUBTED = 0.01  # volume error of a sealed chamber
GIF_WIDTH_PX, GIF_STRIDE, GIF_COLOURS = 480, 3, 128  # small enough for a README


@dataclass(frozen=True)
class RunResult:
    """What a run leaves: its folder, the summary as in summary.json, and the traces as arrays by column."""

    folder: Path
    summary: dict
    traces: dict[str, np.ndarray]


def run(
    scene: Scene,
    out: str | Path | None = None,
    name: str = "eye",
    compare: str | Path | None = None,
    progress: bool = False,
) -> RunResult:
    """Simulate and film a scene into a run folder.

    out: a new or empty folder; None for renders/<name>-001, -002, ... compare: CSV with a measured history (columns
    time_ms and apex_displacement_mm or deflection_mm). progress: a bar on the terminal.
    Raises SceneError for bad input before anything is written; RunStopped when a guard stops the run, after what was
    computed so far has been written.
    """
    refuse_taken(out)
    measured = read_measured(compare) if compare is not None else None
    backend.real()
    choice = None
    if scene.numerics.fidelity == "auto":
        choice = choose(scene)
        scene = choice.scene
    cloud = cloud_of(scene) if needs_cloud(scene) else None
    return _Recorder(scene, measured, progress, choice).run(cloud, out, name)


class _Recorder:
    """Holds what one run writes as it goes."""

    def __init__(self, scene, measured: Measured | None, progress, choice: Choice | None = None):
        self.scene, self.measured, self.progress, self.choice = scene, measured, progress, choice
        self.frames: list[tuple[float, np.ndarray]] = []
        self.colour_frames: list[np.ndarray] = []
        self.walls: list[tuple[float, np.ndarray]] = []
        self.stride = math.ceil(scene.camera.frame_count / KEPT_FRAMES)
        self.clock: dict[str, float] = {}
        self.paraview = None

    def run(self, cloud, out, name) -> RunResult:
        """Run to the end, to a guard's stop or to an interrupt; write everything in any case.

        The folder is made once the solver has accepted the scene.
        """
        started = time.perf_counter()
        scene, output = self.scene, self.scene.output
        with tqdm(
            total=scene.numerics.duration_ms,
            unit=" ms",
            disable=not self.progress,
            dynamic_ncols=True,
            bar_format="{desc}{percentage:3.0f}%|{bar}| {n:.1f}/{total:g} ms [{elapsed}<{remaining}]",
        ) as bar:
            bar.set_description_str("compiling kernels: ")
            simulation = self._simulation(cloud)
            self.folder = create_run_folder(out, name)
            write_text(self.folder / "scene.toml", dump_scene(scene))
            view = FilmView(scene)
            self.clock["setup_s"] = time.perf_counter() - started
            if self.progress:
                bar.write(_announce(simulation))
                if self.choice is not None:
                    bar.write(f"auto     {self.choice.reason}")
            bar.set_description_str("air puff: ")
            stop: BaseException | None = None
            if output.node_fields:
                # meshio is slow to load, and few runs need it
                from taichi_eye.report.paraview import ParaviewWriter

                self.paraview = ParaviewWriter(self.folder / "fields")
            with FilmWriter(
                self.folder / "film.mp4", output.film_fps, self.folder / "frames" if output.png_frames else None
            ) as film:

                def on_frame(_, frame):
                    before = time.perf_counter()
                    self._film(simulation, view, film, frame)
                    self.clock["film_s"] = self.clock.get("film_s", 0.0) + time.perf_counter() - before

                def on_sample(_):
                    bar.update(min(simulation.time_ms, bar.total) - bar.n)

                try:
                    simulation.run(on_frame, on_sample)
                    bar.update(bar.total - bar.n)
                except (RunStopped, KeyboardInterrupt) as reason:
                    stop = reason
        self.clock["total_s"] = time.perf_counter() - started
        result = self._report(simulation, stop)
        if stop is not None:
            raise stop
        return result

    def _simulation(self, cloud):
        ready = self.choice.simulation if self.choice is not None else None
        if ready is None:
            return simulation_of(self.scene, cloud)
        # the pilot that was chosen has run already and is only filmed
        ready.cloud = cloud
        return ready

    def _film(self, simulation, view, film, frame):
        scene, traces = self.scene, simulation.traces
        retreat = float(retreat_mm(scene, simulation.time_ms))
        place, velocity, pressure, count = simulation.liquid() if needs_cloud(scene) else (None, None, None, 0)
        state = FrameState(
            time_ms=simulation.time_ms,
            wall=simulation.cornea.place,
            wall_count=simulation.wall_count,
            nodes=place,
            node_count=count,
            pressure=pressure,
            velocity=velocity,
            trace_time_ms=traces["time_ms"],
            trace_apex_mm=traces["apex_displacement_mm"],
            trace_puff_kpa=traces["puff_apex_kpa"],
            retreat_mm=retreat,
        )
        image = view.render(state)
        film.write(image, simulation.time_ms)
        wall = simulation.cornea.place.to_numpy()[: simulation.wall_count] / MM
        self.walls.append((simulation.time_ms, wall - [0.0, retreat]))
        if frame % self.stride == 0 or frame == scene.camera.frame_count - 1:
            slit = view.scheimpflug_frame(state) if view.slit is None else view.slit
            self.frames.append((simulation.time_ms, slit))
            if scene.output.gif and frame % (GIF_STRIDE * self.stride) == 0:
                self.colour_frames.append(image)
        if self.paraview is not None:
            walls = simulation.wall_count
            self.paraview.add_frame(
                simulation.time_ms,
                place.to_numpy()[:count],
                simulation.cloud.triangles,
                {"excess_pressure_pa": pressure.to_numpy()[:count], "velocity_m_s": velocity.to_numpy()[:count]},
                simulation.cornea.place.to_numpy()[:walls],
                {"velocity_m_s": simulation.cornea.velocity.to_numpy()[:walls]},
            )

    def _report(self, simulation, stop) -> RunResult:
        traces = simulation.arrays()
        if not traces:
            return RunResult(self.folder, {}, {})
        # matplotlib's figures are slow to load: not before the film is done
        from taichi_eye.report.plots import plot_apex, plot_sheet, sheet_times

        before = time.perf_counter()
        write_traces(self.folder / "traces.csv", traces)
        if self.walls:
            times, walls = zip(*self.walls)
            write_wall(self.folder / "wall.npz", np.array(times), np.array(walls))
        plot_apex(self.folder / "apex.png", traces, self.measured)
        history = summarise(traces["time_ms"], traces["apex_displacement_mm"])
        if self.frames:
            times = np.array([at for at, _ in self.frames])
            chosen = [
                self.frames[int(np.argmin(np.abs(times - wanted)))] for wanted in sheet_times(history, float(times[-1]))
            ]
            plot_sheet(self.folder / "sheet.png", chosen)
        if self.colour_frames:
            write_gif(
                self.colour_frames,
                self.folder / "film.gif",
                width_px=GIF_WIDTH_PX,
                fps=self.scene.output.film_fps / (GIF_STRIDE * self.stride),
                colours=GIF_COLOURS,
            )
        self.clock["report_s"] = time.perf_counter() - before
        summary = _summary(simulation, traces, history, stop, self.clock, self.measured)
        if self.choice is not None:
            summary["choice"] = self.choice.as_dict()
        write_text(self.folder / "summary.json", json.dumps(summary, indent=2) + "\n")
        return RunResult(self.folder, summary, traces)


def _announce(simulation) -> str:
    scene = simulation.scene
    return (
        f"cornea   {simulation.wall_count - 1} elements, R {scene.cornea.radius_mm:g} mm, limbus "
        f"{scene.cornea.limbus_radius_mm:g} mm, {scene.cornea.thickness_mm:g} mm thick, IOP "
        f"{scene.eye.iop_mmhg:g} mmHg\n"
        f"aqueous  {scene.numerics.fidelity}: {simulation.about()}\n"
        f"puff     {scene.puff.time_course}, {float(simulation.puff.peak) / 1e3:g} kPa"
    )


def _summary(simulation, traces, history, stop, clock, measured) -> dict:
    load = summarise(traces["time_ms"], traces["puff_apex_kpa"])
    work = float(np.abs(traces["puff_work_uj"]).max())
    apex = {
        **asdict(history),
        "fwhm_ms": history.fwhm_ms,
        "asymmetry": history.asymmetry,
        "delay_to_puff_ms": history.peak_time_ms - load.peak_time_ms if history.peak > 0 else None,
    }
    summary = {
        "status": "complete" if stop is None else "stopped",
        "reason": None if stop is None else (str(stop) or "interrupted"),
        "simulated_ms": float(traces["time_ms"][-1]),
        "apex_displacement_mm": apex,
        "fluid_pressure_apex_max_kpa": float(traces["fluid_pressure_apex_kpa"].max()),
        "cornea_min_stress_kpa": float(traces["cornea_min_stress_kpa"].min()),
        "chamber_volume_error_max": float(np.abs(traces["chamber_volume_error"]).max()),
        "energy_error_share_of_work": float(np.abs(traces["energy_error_uj"]).max()) / work if work > 0 else 0.0,
        "fidelity": simulation.scene.numerics.fidelity,
        **simulation.facts(),
        "wall_clock": {name: round(seconds, 3) for name, seconds in clock.items()},
    }
    summary["warnings"] = _warnings(summary, simulation.scene)
    if measured is not None:
        summary["warnings"] += [f"--compare {measured.name}: {note}" for note in measured.notes]
        summary["against"] = {
            "file": measured.name,
            **differences(traces["time_ms"], traces["apex_displacement_mm"], measured),
        }
    return summary


def _warnings(summary, scene) -> list[str]:
    """What a finished run should be doubted for, though no guard stopped it."""
    said = []
    balance, squeezed = summary["energy_error_share_of_work"], summary["chamber_volume_error_max"]
    if balance > BALANCE_DOUBTED:
        said.append(
            f"the energy balance is off by {100 * balance:.1f} % of the puff's work: lower numerics.spacing_mm"
            + (', or use numerics.wall_condition = "slip"' if scene.numerics.wall_condition == "no_slip" else "")
        )
    if scene.chamber.sealed and scene.numerics.fidelity != "membrane" and squeezed > SQUEEZE_DOUBTED:
        said.append(
            f"the liquid was compressed by {100 * squeezed:.1f} %, which deepens the dent: raise "
            "numerics.sound_speed_m_s"
        )
    return said
