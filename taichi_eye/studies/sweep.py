"""A study from its file to its folder: computed in parcels, kept as they come, and gone on with after it was cut off.

The folder holds table.parquet and table.csv, a row an eye in the order of the design; columns.csv, what the columns
mean; responses.png, scatter.png, matters.png and matters.csv; study.html, all of it on a page; summary.json; and
scene.toml with study.toml, from which the same table is made again. While the study is under way the hidden folder .run
holds what `resume` goes on from: the design, and a file for each finished parcel (`taichi_eye.studies.shelf`).
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from taichi_eye.errors import Interrupted, OutputError, SceneError
from taichi_eye.provenance import provenance
from taichi_eye.recording.signals import Signals
from taichi_eye.recording.workroom import WorkRoom, program
from taichi_eye.report.folder import Lock, claim_folder, refuse_taken, write_rows, write_text
from taichi_eye.report.folder import sweep as tidy
from taichi_eye.scene import Scene, dump_scene
from taichi_eye.scene.table import read_text
from taichi_eye.studies.columns import FIGURES, STATUSES, described, schema_of
from taichi_eye.studies.crew import Crew
from taichi_eye.studies.designs import Design, changes, count, draw
from taichi_eye.studies.eyes import COMPUTE, common_of, parcel_of
from taichi_eye.studies.needs import refuse_missing
from taichi_eye.studies.shelf import Shelf, write_tables
from taichi_eye.studies.study import Study, load_study, of_plain, plain_scene, scene_of

PROBED = 16  # eyes that are tried as scenes before anything is written
REASONS = 20  # kinds of stops that a summary tells
BAR = "{desc}{percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} eyes [{elapsed}<{remaining}]"


@dataclass(frozen=True)
class SweepResult:
    """What a study leaves: its folder and the summary as in summary.json; finished_before: whether there was nothing
    left to `resume`."""

    folder: Path
    summary: dict
    finished_before: bool = False

    @property
    def table(self):
        """The study's table as a pandas data frame."""
        import pandas

        return pandas.read_parquet(self.folder / "table.parquet")


def sweep(
    study: str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    *,
    scene: Scene | None = None,
    overrides: Sequence[str] = (),
    scheduler: str | None = None,
    threads: int | None = None,
    progress: bool = False,
    compute: str = COMPUTE,
) -> SweepResult:
    """Run a study into a folder.

    study: a study file, or a dictionary as one holds it (`taichi_eye.studies.study`). out: a new or empty folder; None
    for renders/<name>-001, ... scene: in place of the study's; overrides: "section.key=value" on top of its [set].
    scheduler: address of a Dask scheduler whose workers compute; without one, processes of this machine. threads: of
    this machine, shared out among them (default: all). compute: "module:function" that takes what all parcels share and
    a parcel's items and returns their rows, for studies of something other than eyes. Raises SceneError before anything
    is written; OutputError and Interrupted after which `resume` goes on.
    """
    refuse_missing(cluster=scheduler is not None)
    refuse_taken(out)
    read = load_study(study, scene, overrides)
    design = draw(read)
    files = _files(read, design)
    _refuse_hopeless(read, design)
    with Signals() as signals, _workers(scheduler, compute) as workers:
        parallel = workers.threads if workers is not None else threads or os.cpu_count() or 1
        manifest = {
            "program": program(),
            "name": read.name,
            "study": read.plain(),
            "base": plain_scene(read.base),
            "files": files,
            "keys": read.keys,
            "labels": list(read.labels),
            "count": count(design),
            "size": parcel_of(read.base, count(design), parallel),
            "compute": compute,
        }
        folder, lock = claim_folder(out, read.name)
        try:
            room = WorkRoom(folder)
            with _told(folder):
                room.begin(manifest)
                shelf = _shelf(room, manifest)
                shelf.keep_design(design, read.labels)
            return _finish(room, shelf, read, design, manifest, workers, threads, progress, signals)
        finally:
            lock.release()


def resume(
    folder: str | Path,
    *,
    scheduler: str | None = None,
    threads: int | None = None,
    progress: bool = False,
) -> SweepResult:
    """Go on with a study that was cut off, in its folder, here or on a cluster; raises as `sweep` does.

    Parcels that are finished stay as they are, and the table is that of a study that was never cut off. A study that is
    finished is returned as it is.
    """
    refuse_missing(cluster=scheduler is not None)
    folder = Path(folder)
    if not folder.is_dir():
        raise SceneError(f"{folder}: no such folder")
    lock = Lock(folder)
    try:
        room = WorkRoom(folder)
        if (folder / "table.parquet").exists() and not room.path.exists():
            room.tidy()
            return SweepResult(folder, _read_summary(folder), finished_before=True)
        manifest = room.manifest()
        if "study" not in manifest:
            raise SceneError(f"{folder}: holds a run, no study; go on with taichi-eye run --resume {folder}")
        base = scene_of(manifest["base"])
        study = of_plain(manifest["study"], base, manifest["name"], manifest["keys"])
        with Signals() as signals, _workers(scheduler, manifest["compute"]) as workers:
            with _told(folder):
                tidy(folder)
                shelf = _shelf(room, manifest)
                design = shelf.design(manifest["keys"])
                if design is None:
                    if study.table is not None:
                        raise SceneError(f"{folder}: was cut off before its eyes were kept; start the study anew")
                    design = draw(study)
                    shelf.keep_design(design, {})
            return _finish(room, shelf, study, design, manifest, workers, threads, progress, signals)
    finally:
        lock.release()


@contextmanager
def _workers(scheduler: str | None, compute: str) -> Iterator[Any]:
    """The cluster that a scheduler stands for; None without one."""
    if scheduler is None:
        yield None
        return
    # distributed is slow to load, and an extra
    from taichi_eye.studies.cluster import Cluster

    cluster = Cluster(scheduler, compute)
    try:
        yield cluster
    finally:
        cluster.close()


@contextmanager
def _told(folder: Path) -> Iterator[None]:
    """An error in writing, and one that ends a study from outside, says how to go on."""
    try:
        yield
    except KeyboardInterrupt as reason:
        reason.folder = folder
        raise
    except OSError as problem:
        said = f"{problem.filename or folder}: {problem.strerror or problem}"
        raise OutputError(f"{said}\n{_go_on(folder)}") from problem
    except OutputError as problem:
        raise OutputError(f"{problem}\n{_go_on(folder)}") from problem


def _go_on(folder: Path) -> str:
    return (
        f"The eyes that are finished are kept in {folder}. Once that is mended, go on with taichi-eye sweep --resume "
        f"{folder}"
    )


def _shelf(room: WorkRoom, manifest: Mapping[str, Any]) -> Shelf:
    schema = schema_of(manifest["keys"], manifest["labels"])
    return Shelf(room.path, schema, manifest["size"], manifest["count"])


def _files(study: Study, design: Design) -> dict[str, str]:
    """The text of every puff file that an eye reads, by its path; SceneError where one cannot be read."""
    named = {study.base.puff.file, *(design.get("puff.file", ()))} - {"", None}
    return {path: read_text(Path(path)) for path in sorted(named)}


def _refuse_hopeless(study: Study, design: Design) -> None:
    """SceneError where none of some eyes from all over the design is a scene."""
    eyes = np.unique(np.linspace(0, count(design) - 1, PROBED).astype(int))
    refusals = []
    for eye in eyes:
        try:
            study.base.but(changes(design, int(eye)))
            return
        except SceneError as refused:
            refusals.append((eye, refused))
    eye, refused = refusals[0]
    raise SceneError(f"{study.name}: no eye of this study is a scene; eye {eye}: {refused}")


def _finish(
    room: WorkRoom,
    shelf: Shelf,
    study: Study,
    design: Design,
    manifest: Mapping[str, Any],
    cluster: Any,
    threads: int | None,
    progress: bool,
    signals: Signals,
) -> SweepResult:
    """Compute what is missing, then write what the folder is to hold."""
    started, folder = time.perf_counter(), room.folder
    with _told(folder):
        finished = shelf.finished()
        missing = [parcel for parcel in range(shelf.parcels) if parcel not in finished]
        computed = sum(len(shelf.eyes(parcel)) for parcel in missing)
        if missing:
            workers = cluster or _crew(manifest["compute"], len(missing), threads or os.cpu_count() or 1)
            try:
                _compute(shelf, study, design, manifest, workers, missing, progress, signals)
            finally:
                if workers is not cluster:
                    workers.close()
        took = {"compute_s": round(time.perf_counter() - started, 3), "eyes_computed": computed}
        summary = _write(folder, room, shelf, study, manifest, took)
        room.finish()
    return SweepResult(folder, summary)


def _crew(compute: str, parcels: int, threads: int) -> Crew:
    """As many workers as there are threads, or parcels; what is left of the threads is theirs."""
    workers = min(threads, parcels)
    return Crew(compute, workers, threads // workers)


def _compute(shelf, study, design, manifest, workers, missing, progress, signals) -> None:
    """Compute the missing parcels and keep each as it comes."""
    common = common_of(manifest["base"], manifest["keys"], manifest["files"])
    labels = shelf.design(manifest["labels"]) if manifest["labels"] else {}
    jobs = ((parcel, [changes(design, eye) for eye in shelf.eyes(parcel)]) for parcel in missing)

    def look() -> None:
        if signals.asked is not None:
            raise Interrupted(signals.asked)

    done = shelf.count - sum(len(shelf.eyes(parcel)) for parcel in missing)
    signals.note()
    with tqdm(
        total=shelf.count,
        initial=done,
        disable=not progress,
        dynamic_ncols=True,
        bar_format=BAR,
        desc=f"{study.name}: ",
        smoothing=0.05,
    ) as bar:
        for parcel, rows in workers.run(common, jobs, look):
            eyes = shelf.eyes(parcel)
            asked = ({**{name: column[eye] for name, column in labels.items()}, **changes(design, eye)} for eye in eyes)
            shelf.put(parcel, [{"eye": eye, **own, **row} for eye, own, row in zip(eyes, asked, rows)])
            bar.update(len(eyes))


def _write(folder, room, shelf, study, manifest, took) -> dict[str, Any]:
    import pandas

    # plots are slow to load
    from taichi_eye.studies import page
    from taichi_eye.studies.matters import Effect, effects

    write_tables(folder, shelf.tables(), shelf.schema)
    frame = pandas.read_parquet(folder / "table.parquet", columns=[*manifest["keys"], *FIGURES, "status", "reason"])
    found = effects(study, frame, study.show)
    summary = {
        "study": study.name,
        "kind": study.kind,
        "eyes": shelf.count,
        "status": {status: int((frame["status"] == status).sum()) for status in STATUSES},
        "reasons": _reasons(frame["reason"]),
        "figures": _figures(frame),
        "provenance": provenance(),
        "wall_clock": took,
        "program": manifest["program"],
    }
    write_rows(
        folder / "columns.csv",
        ("column", "unit", "instrument", "meaning"),
        described([*manifest["labels"], *manifest["keys"]]),
    )
    names = [f.name for f in fields(Effect)]
    write_rows(folder / "matters.csv", names, [[_text(asdict(effect)[name]) for name in names] for effect in found])
    write_text(folder / "scene.toml", dump_scene(study.base))
    write_text(folder / "study.toml", study.text())
    if study.table is not None:
        design = pandas.read_parquet(room.path / "design.parquet")
        write_rows(folder / "design.csv", list(design.columns), design.to_numpy().tolist())
    page.write(study, frame, found, summary, folder)
    write_text(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def _text(value: Any) -> Any:
    return "" if value is None else value


def _reasons(column) -> dict[str, int]:
    """Eyes by what stopped them, the times and places left out, the most frequent first."""
    told = Counter(_kind_of(reason) for reason in column if isinstance(reason, str))
    return dict(told.most_common(REASONS))


def _kind_of(reason: str) -> str:
    """A reason without time and place: what eyes that stopped for the same have in common."""
    if reason.startswith("stopped at "):
        reason = reason.split(": ", 1)[1].split(" (", 1)[0]
    return reason[:200]


def _figures(frame) -> dict[str, dict[str, float]]:
    found = {}
    whole = frame[frame["status"] == "complete"]
    for name in FIGURES:
        values = whole[name].to_numpy(dtype=float)
        values = values[np.isfinite(values)]
        if len(values):
            sd = float(values.std(ddof=1)) if len(values) > 1 else 0.0
            found[name] = {
                "mean": float(values.mean()),
                "sd": sd,
                "least": float(values.min()),
                "most": float(values.max()),
                "eyes": len(values),
            }
    return found


def _read_summary(folder: Path) -> dict:
    try:
        return json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise SceneError(f"{folder}: is finished, but cannot be read ({problem})") from None
