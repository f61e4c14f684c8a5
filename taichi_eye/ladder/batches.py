"""Many scenes in one call, whatever their rungs, and a file from which a call that was cut off goes on.

Scenes of the full model run side by side, those of one basis together and AT_ONCE nodes at a time
(`taichi_eye.solver.batch`); the reduced rungs, which take milliseconds, one after another; "auto" is decided first.

The file (`keep`) holds what is finished and the state of the eyes under way, and replaces itself whole every KEEP_S
seconds. It belongs to its scenes: for others it is refused. Arrays as NumPy's .npz, without pickles.
"""

import ast
import hashlib
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from taichi_eye.errors import RunStopped, SceneError
from taichi_eye.ladder.choose import choose
from taichi_eye.ladder.rungs import simulation_of
from taichi_eye.ladder.trial import run_to_stop
from taichi_eye.report.folder import replacing
from taichi_eye.scene import Scene, dump_scene
from taichi_eye.solver.batch import Batch, Outcome
from taichi_eye.solver.case import clouds_of
from taichi_eye.solver.reduced import Reduced
from taichi_eye.units import MM

AT_ONCE = 2**18  # nodes held in memory, some 3 kB each
KEEP_S = 30.0  # seconds between two states kept; a state of 100 small eyes is some 40 MB
BAR = "{desc}{percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} ms [{elapsed}<{remaining}]"


OnFrame = Callable[[int, float, np.ndarray], None]


def run_batch(
    scenes: Sequence[Scene],
    progress: bool = False,
    keep: str | Path | None = None,
    on_frame: OnFrame | None = None,
) -> list[Outcome]:
    """Run scenes; what became of each, in their order.

    Scenes may differ in everything. An eye that leaves its validity stops alone and keeps its traces up to there. keep:
    a file that an earlier call with the same scenes left when it was cut off, or that this one is to leave; it is
    removed at the end. progress: a bar on the terminal. on_frame(number of the scene, time_ms, wall): called once for
    each film frame that an eye reaches, those of one eye in order, with the places (r, z) of its wall's nodes [mm];
    frames are not kept in a file, so not with keep. Raises SceneError where a chamber cannot be filled, its stencils
    are no good, or the file is of other scenes.
    """
    if keep is not None and on_frame is not None:
        raise ValueError("frames are not kept in a file: leave out keep or on_frame")
    kept = _Kept(Path(keep), scenes) if keep is not None else None
    outcomes: list[Outcome | None] = kept.outcomes() if kept else [None] * len(scenes)
    full = [k for k, scene in enumerate(scenes) if scene.numerics.fidelity == "mfpm"]
    clouds = dict(zip(full, clouds_of([scenes[k] for k in full])))
    total = sum(scene.numerics.duration_ms for scene in scenes)
    with tqdm(
        total=total,
        unit=" ms",
        disable=not progress,
        dynamic_ncols=True,
        bar_format=BAR,
        desc=f"{len(scenes)} eyes: ",
    ) as bar:
        bar.update(sum(scene.numerics.duration_ms for scene, done in zip(scenes, outcomes) if done is not None))
        for k, scene in enumerate(scenes):
            if outcomes[k] is None and k not in clouds:
                outcomes[k] = _alone(k, scene, on_frame)
                bar.update(scene.numerics.duration_ms)
        for chosen in _parcels(scenes, clouds):
            if all(outcomes[k] is not None for k in chosen):
                continue
            before = bar.n
            batch = Batch([scenes[k] for k in chosen], [clouds[k] for k in chosen])
            if kept:
                kept.take_up(batch, chosen)

            def look(batch, chosen=chosen, before=before):
                bar.update(before + float(((batch.recorded - 1) * batch.sample_ms).sum()) - bar.n)
                if kept:
                    kept.hold(outcomes, batch, chosen)
                if on_frame:
                    _show(batch, chosen, on_frame)

            for k, outcome in zip(chosen, batch.run(look)):
                outcomes[k] = outcome
            bar.update(before + sum(scenes[k].numerics.duration_ms for k in chosen) - bar.n)
            if kept:
                kept.write(outcomes)
    if kept:
        kept.path.unlink(missing_ok=True)
    return outcomes


def _alone(number: int, scene: Scene, on_frame: OnFrame | None) -> Outcome:
    """What becomes of a scene that runs alone: one of a reduced rung, or one that has to be decided."""
    decided = choose(scene).scene if scene.numerics.fidelity == "auto" else scene
    simulation = simulation_of(decided)
    if on_frame is None or not isinstance(simulation, Reduced):
        show = on_frame and (lambda run, _: on_frame(number, run.time_ms, _wall_mm(run.cornea, 0, run.wall_count)))
        stop = run_to_stop(simulation, show)
        return Outcome(scene, simulation.traces, stop)
    # a reduced rung keeps its frames: to ask for them afterwards spares it a stop at each
    stop = run_to_stop(simulation)
    for time_ms, wall in zip(*simulation.wall_mm):
        on_frame(number, float(time_ms), wall)
    return Outcome(scene, simulation.traces, stop)


def _show(batch: Batch, chosen: list[int], on_frame: OnFrame) -> None:
    """Hand on the walls of the eyes that have just reached a film frame."""
    frames = [clock.frame_of(batch.sample) for clock in batch.clocks]
    there = [eye for eye, frame in enumerate(frames) if frame is not None and batch.recorded[eye] == batch.sample + 1]
    if there:
        places = batch.cornea.place.to_numpy() / MM
        for eye in there:
            first = int(batch.first[eye])
            wall = places[first : first + batch.clouds[eye].wall_count].copy()
            on_frame(chosen[eye], float(batch.sample * batch.sample_ms[eye]), wall)


def _wall_mm(cornea, first: int, count: int) -> np.ndarray:
    return cornea.place.to_numpy()[first : first + count] / MM


def _parcels(scenes, clouds) -> Iterator[list[int]]:
    """Numbers of the scenes that run side by side: one basis, AT_ONCE nodes or a single eye."""
    for basis in sorted({scenes[k].numerics.basis for k in clouds}):
        parcel, nodes = [], 0
        for k, cloud in clouds.items():
            if scenes[k].numerics.basis != basis:
                continue
            if parcel and nodes + cloud.count > AT_ONCE:
                yield parcel
                parcel, nodes = [], 0
            parcel.append(k)
            nodes += cloud.count
        yield parcel


class _Kept:
    """The file of a call: outcomes by number, and the state of the parcel under way."""

    def __init__(self, path: Path, scenes: Sequence[Scene]):
        self.path, self._scenes, self._last = path, scenes, time.monotonic()
        self._digest = hashlib.sha256("\0".join(dump_scene(scene) for scene in scenes).encode()).hexdigest()
        self._read: dict[str, np.ndarray] = {}
        if path.exists():
            try:
                with np.load(path, allow_pickle=False) as held:
                    self._read = dict(held)
                found = str(self._read.get("scenes", ""))
            except (OSError, ValueError, zipfile.BadZipFile) as problem:
                raise SceneError(f"{path}: cannot be gone on from ({problem}); remove it to start anew") from None
            if found != self._digest:
                raise SceneError(f"{path}: was kept by a call with other scenes; name another file")

    def outcomes(self) -> list[Outcome | None]:
        """What the file holds, None where a scene is not finished."""
        found: list[Outcome | None] = [None] * len(self._scenes)
        for k, scene in enumerate(self._scenes):
            prefix = f"outcome.{k}."
            traces = {name[len(prefix) :]: column for name, column in self._read.items() if name.startswith(prefix)}
            if traces:
                stop = str(traces.pop("stop"))
                found[k] = Outcome(scene, traces, RunStopped(*ast.literal_eval(stop)) if stop else None)
        return found

    def take_up(self, batch: Batch, chosen: list[int]) -> None:
        """Put the batch where the file left it, if it is the one that was under way."""
        if "state.chosen" in self._read and self._read["state.chosen"].tolist() == chosen:
            batch.restore({name[6:]: values for name, values in self._read.items() if name.startswith("state.")})

    def hold(self, outcomes, batch: Batch, chosen: list[int]) -> None:
        """Write the state, if KEEP_S have passed."""
        if time.monotonic() - self._last >= KEEP_S:
            self.write(outcomes, {**batch.state(), "chosen": np.array(chosen)})

    def write(self, outcomes, state=None) -> None:
        """Replace the file."""
        arrays = {"scenes": np.array(self._digest)}
        for k, outcome in enumerate(outcomes):
            if outcome is not None:
                arrays |= {f"outcome.{k}.{name}": column for name, column in outcome.traces.items()}
                arrays[f"outcome.{k}.stop"] = np.array(repr(outcome.stop.args) if outcome.stop else "")
        arrays |= {f"state.{name}": values for name, values in (state or {}).items()}
        with replacing(self.path, durable=True) as temporary, open(temporary, "wb") as file:
            np.savez(file, **arrays)
        self._last = time.monotonic()
