"""From a scene to a run folder: simulate while observers look on (`taichi_eye.recording`), and resume what was cut off.

The folder holds film.mp4, apex.png, sheet.png, report.html, traces.csv, wall.npz, summary.json and scene.toml; on
request film.gif, error_bar.csv, the folder frames/ with a PNG per frame, and fields/ for ParaView. Every file appears
whole or not at all. A run that a guard stops or a signal ends leaves the same files up to that time, and its summary
says so. While it is under way, and after it was cut off by anything but a guard, the hidden folder .run holds what
`resume` goes on from.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_eye import backend
from taichi_eye.errors import Interrupted, OutputError, RunStopped, SceneError
from taichi_eye.film import EncoderError, ffmpeg
from taichi_eye.film.file import FilmFile
from taichi_eye.ladder.choose import choose
from taichi_eye.ladder.rungs import needs_cloud, simulation_of
from taichi_eye.recording.checkpoint import Checkpoint
from taichi_eye.recording.error_bar import run_twin
from taichi_eye.recording.observer import Ending, Moment, Recording, Watcher
from taichi_eye.recording.progress import Progress
from taichi_eye.recording.signals import Signals
from taichi_eye.recording.table import SINKS
from taichi_eye.recording.workroom import WorkRoom, program
from taichi_eye.report import result as page
from taichi_eye.report.compare import Measured, read_measured
from taichi_eye.report.dataframe import framed
from taichi_eye.report.folder import Lock, claim_folder, refuse_taken, sweep, write_text
from taichi_eye.report.traces import read_traces
from taichi_eye.scene import Scene, dump_scene, load_scene
from taichi_eye.solver.case import cloud_of


@dataclass(frozen=True)
class RunResult:
    """What a run leaves: its folder, the summary as in summary.json, and the traces as arrays by column.

    finished_before: whether there was nothing left to `resume`. A notebook shows it as its report.html.
    """

    folder: Path
    summary: dict
    traces: dict[str, np.ndarray]
    finished_before: bool = False

    @property
    def film(self) -> FilmFile:
        """The film, which a notebook plays."""
        return FilmFile(self.folder / "film.mp4")

    def plot(self):
        """The history of the apex under the load, as a matplotlib Figure; apex.png has error band and measured history,
        too."""
        # matplotlib's figures are slow to load
        from taichi_eye.report.plots import draw_apex

        return draw_apex(self.traces)

    def to_dataframe(self):
        """The traces as a pandas DataFrame, a row a sample; the columns are those of traces.csv."""
        return framed(self.traces)

    def _repr_html_(self) -> str:
        """What a notebook shows: report.html, or a line where there is none."""
        return page.read(self.folder) or page.paragraph(f"A run in {self.folder}, {self.summary.get('status')}.")


def run(
    scene: Scene,
    out: str | Path | None = None,
    name: str = "eye",
    compare: str | Path | None = None,
    progress: bool = False,
    watch: Watcher | None = None,
) -> RunResult:
    """Simulate and film a scene into a run folder.

    out: a new or empty folder; None for renders/<name>-001, -002, ... compare: CSV with a measured history (columns
    time_ms and apex_displacement_mm or deflection_mm). progress: a bar on the terminal. watch: an observer that may end
    the run (`taichi_eye.page.watch.Watch`). Raises SceneError for bad input before anything is written. After what was
    computed so far has been written: RunStopped when a guard stops the run, Interrupted when SIGINT, SIGTERM or SIGHUP
    ends it, OutputError when a file cannot be written; from the last two `resume` goes on.
    """
    started = time.perf_counter()
    refuse_taken(out)
    measured = read_measured(compare) if compare is not None else None
    _refuse_without_encoder()
    backend.real()
    with Signals() as signals, Progress(scene.numerics.duration_ms, progress) as bar:
        _let_end(watch, signals)
        choice = choose(scene) if scene.numerics.fidelity == "auto" else None
        ready, about = None, None
        if choice is not None:
            bar.decided(choice)
            # a pilot that was chosen has run already and is only filmed
            scene, ready, about = choice.scene, choice.simulation, choice.as_dict()
        coarse, clock = _twin(scene, bar, signals)
        cloud = cloud_of(scene) if needs_cloud(scene) else None
        if ready is None:
            ready = simulation_of(scene, cloud)
        else:
            ready.cloud = cloud
        folder, lock = claim_folder(out, name)
        try:
            room = WorkRoom(folder)
            recording = Recording(folder, room.path, scene, ready, measured, about, clock, started, coarse)
            try:
                room.begin(_manifest(scene, measured, about))
                write_text(folder / "scene.toml", dump_scene(scene))
            except OSError as problem:
                raise _unwritten(recording, problem) from problem
            return _record(recording, room, signals, bar, {}, watch)
        finally:
            lock.release()


def resume(
    folder: str | Path, progress: bool = False, threads: int | None = None, watch: Watcher | None = None
) -> RunResult:
    """Go on with a run that was cut off, in its folder; raises as `run` does.

    It ends with the same bits in traces, walls and frames as a run that was never cut off. A run that is finished is
    returned as it is. threads: of the CPU, where Taichi is not started yet (default: as the run began). SceneError,
    with nothing changed, where the folder holds no run, the run was begun by another program, its scene was edited,
    its checkpoint is damaged, or Taichi runs with another arch or precision.
    """
    started = time.perf_counter()
    folder = Path(folder)
    if not folder.is_dir():
        raise SceneError(f"{folder}: no such run folder")
    lock = Lock(folder)
    try:
        room = WorkRoom(folder)
        if (folder / "summary.json").exists() and not room.path.exists():
            room.tidy()
            return _finished(folder)
        manifest = room.manifest()
        if "study" in manifest:
            raise SceneError(f"{folder}: holds a study, no run; go on with taichi-eye sweep --resume {folder}")
        scene = _scene_of(folder, manifest)
        checkpoint = room.load(scene)
        _refuse_without_encoder()
        _start_as_begun(folder, manifest, threads)
        measured = manifest["measured"]
        if measured is not None:
            measured = Measured.from_plain(measured)
        with Signals() as signals, Progress(scene.numerics.duration_ms, progress) as bar:
            _let_end(watch, signals)
            header, state = checkpoint if checkpoint is not None else ({}, None)
            # what a twin left stands beside a checkpoint
            coarse, clock = _twin(scene, bar, signals) if state is None else (None, header["clock"])
            cloud = cloud_of(scene) if needs_cloud(scene) else None
            simulation = simulation_of(scene, cloud)
            if state is not None:
                simulation.restore(state)
            recording = Recording(
                folder, room.path, scene, simulation, measured, manifest["choice"], clock, started, coarse
            )
            try:
                sweep(folder)
            except OSError as problem:
                raise _unwritten(recording, problem) from problem
            return _record(recording, room, signals, bar, header.get("held", {}), watch)
    finally:
        lock.release()


def _twin(scene: Scene, bar: Progress, signals: Signals) -> tuple[dict[str, np.ndarray] | None, dict[str, float]]:
    """What the twin of a scene left that asks for an error bar, and the clock so far."""
    if not scene.numerics.error_bar:
        return None, {}

    def tell(what: str, simulated_ms: float) -> None:
        if signals.asked is not None:
            raise Interrupted(signals.asked)
        bar.show(what, simulated_ms)

    before = time.perf_counter()
    found = run_twin(scene, tell)
    took = time.perf_counter() - before
    # set-up lasts from the start of the run to its first step, and this is no part of it
    return found, {"twin_s": took, "setup_s": -took}


def _refuse_without_encoder() -> None:
    try:
        ffmpeg()
    except EncoderError as missing:
        raise SceneError(str(missing)) from None


def _manifest(scene: Scene, measured: Measured | None, choice: dict | None) -> dict:
    begun = backend.settings()
    return {
        "program": program(),
        "scene": dump_scene(scene),
        "measured": None if measured is None else measured.as_plain(),
        "choice": choice,
        **{name: begun[name] for name in ("arch", "precision", "threads")},
    }


def _scene_of(folder: Path, manifest: dict) -> Scene:
    path = folder / "scene.toml"
    if not path.exists():
        write_text(path, manifest["scene"])
    if path.read_text(encoding="utf-8", errors="replace") != manifest["scene"]:
        raise SceneError(
            f"{path}: was edited since this run began, so it cannot be resumed; run it into another folder"
        )
    return load_scene(path)


def _start_as_begun(folder: Path, manifest: dict, threads: int | None) -> None:
    begun, now = (manifest["arch"], manifest["precision"]), backend.settings()
    if not now:
        backend.init(*begun, manifest["threads"] if threads is None else threads)
    elif (now["arch"], now["precision"]) != begun:
        raise SceneError(
            f"{folder}: was begun on {begun[0]} in {begun[1]}, this is {now['arch']} in {now['precision']}"
        )


def _finished(folder: Path) -> RunResult:
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return RunResult(folder, summary, read_traces(folder / "traces.csv"), finished_before=True)
    except (OSError, ValueError) as problem:
        raise SceneError(f"{folder}: is finished, but cannot be read ({problem})") from None


def _let_end(watch: Watcher | None, signals: Signals) -> None:
    if watch is not None:
        watch.signals = signals


def _record(
    recording: Recording, room: WorkRoom, signals: Signals, bar: Progress, held: dict, watch: Watcher | None
) -> RunResult:
    """Run to the end, to a guard's stop or to what else ends it; let the observers write in any case."""
    sinks = [sink() for sink in SINKS if sink.wanted(recording.scene)]
    observers = [bar, *filter(None, [watch]), *sinks, Checkpoint(room, sinks, signals)]
    simulation, clock = recording.simulation, recording.clock
    stop: BaseException | None = None

    def on_sample(_):
        for observer in observers:
            observer.sample()

    def on_frame(_, frame):
        before = time.perf_counter()
        moment = Moment(recording, frame)
        for observer in observers:
            observer.frame(moment)
        clock["film_s"] = clock.get("film_s", 0.0) + time.perf_counter() - before

    try:
        for observer in observers:
            observer.opened(recording, held.get(type(observer).__name__))
    except (OSError, OutputError) as problem:
        raise _unwritten(recording, problem) from problem
    except KeyboardInterrupt as reason:
        reason.folder = recording.folder
        raise
    clock["setup_s"] = clock.get("setup_s", 0.0) + time.perf_counter() - recording.started
    signals.note()
    try:
        simulation.run(on_frame, on_sample)
    except (Exception, KeyboardInterrupt) as reason:
        stop = reason
    signals.shield()
    ending = Ending(simulation.traces, stop)
    failures = _close(observers, ending, clock) if len(ending.traces["time_ms"]) else []
    if isinstance(stop, (OSError, OutputError)):
        failures.insert(0, stop)
    for problem in failures:
        raise (_unwritten(recording, problem) if isinstance(problem, (OSError, OutputError)) else problem) from stop
    if stop is None or isinstance(stop, RunStopped):
        room.finish()
    if stop is not None:
        stop.folder = recording.folder
        raise stop
    return RunResult(recording.folder, recording.summary, ending.traces)


def _close(observers, ending: Ending, clock: dict[str, float]) -> list[Exception]:
    """Let every observer write, whatever befell the others; what went wrong."""
    failures, before, earlier = [], time.perf_counter(), clock.get("report_s", 0.0)
    for observer in observers:
        clock["report_s"] = earlier + time.perf_counter() - before
        try:
            observer.closed(ending)
        except Exception as problem:
            failures.append(problem)
    return failures


def _unwritten(recording: Recording, problem: Exception) -> OutputError:
    """What went wrong in writing, what is kept, and how to go on."""
    if isinstance(problem, OSError):
        said = f"{problem.filename or recording.folder}: {problem.strerror or problem}"
    else:
        said = str(problem)
    kept = sorted(path.name for path in recording.folder.iterdir() if not path.name.startswith("."))
    return OutputError(
        f"{said}\nKept in {recording.folder}: {', '.join(kept) or 'nothing yet'}. Once that is mended, go on with "
        f"taichi-eye run --resume {recording.folder}"
    )
