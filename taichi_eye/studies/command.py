"""`taichi-eye sweep STUDY.toml`, and `taichi-eye analyze A.avi B.avi ... --table all.csv`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from taichi_eye.errors import SceneError
from taichi_eye.options import refuse_unwritable, take

SUFFIXES = ".csv", ".parquet"


def add(commands) -> None:
    """The parser of `sweep`."""
    parser = commands.add_parser(
        "sweep",
        help="a study: one scene as many eyes, on this machine or a Dask cluster",
        description="Run a study: draw eyes from a design over keys of a scene, compute all of them, and write one "
        "table: table.parquet, table.csv, columns.csv, plots, study.html. A study that was cut off goes on with "
        "--resume.",
        epilog="How a study is written: taichi-eye docs sweep",
        examples=(
            "taichi-eye sweep iop_chart",
            "taichi-eye sweep my_study.toml --threads 2",
            "taichi-eye sweep --resume renders/my_study-001",
        ),
    )
    parser.add_argument("study", nargs="?", help="study file (TOML), or the name of a study that ships")
    take(
        parser,
        "set",
        "out",
        "resume",
        set="override a key of the study's scene; may be repeated",
        out="folder of the study, new or empty (default: under renders/)",
        resume="go on with the study in this folder; only --scheduler, --threads and --quiet may stand with it",
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers compute, as in tcp://host:8786"
    )
    take(parser, "threads", "quiet", threads="CPU threads of this machine (default: all)")
    parser.set_defaults(do=run)


def run(given: argparse.Namespace) -> int:
    """`taichi-eye sweep`; the exit status."""
    from taichi_eye.studies.sweep import resume, sweep

    options = {"scheduler": given.scheduler, "threads": given.threads, "progress": not given.quiet}
    if given.scheduler and given.threads:
        raise SceneError(
            f"--threads {given.threads}: are those of this machine; with --scheduler the workers say theirs"
        )
    if given.resume is not None:
        others = {"a study": given.study, "--set": given.overrides, "--out": given.out}
        if beside := [name for name, value in others.items() if value]:
            raise SceneError(f"--resume {given.resume}: goes on as the study began, so leave out {', '.join(beside)}")
        result = resume(given.resume, **options)
    elif given.study is None:
        raise SceneError("sweep needs a study file, as in taichi-eye sweep configs/studies/iop_chart.toml")
    else:
        result = sweep(given.study, given.out, overrides=given.overrides, **options)
    if result.finished_before:
        print(f"{result.folder}: this study was finished already")
    status, took = result.summary["status"], result.summary["wall_clock"]
    for reason, eyes in result.summary["reasons"].items():
        print(f"{_eyes(eyes)}: {reason}")
    counts = ", ".join(f"{eyes} {name}" for name, eyes in status.items() if eyes)
    print(f"{result.folder}: {_eyes(result.summary['eyes'])} ({counts}), {took['compute_s']:.1f} s")
    return 0 if status["complete"] else 1


def _eyes(number: int) -> str:
    return f"{number} eye{'s' * (number != 1)}"


def refuse_bad_table(path: str) -> None:
    """SceneError where `--table` names no table that can be written, said before the minutes of work it would hold."""
    table = Path(path)
    if table.suffix.lower() not in SUFFIXES:
        raise SceneError(f"--table {path}: must end in {' or '.join(SUFFIXES)}")
    refuse_unwritable(path, "--table")


def analyze(given: argparse.Namespace) -> int:
    """`taichi-eye analyze` with a table of several exams; the exit status."""
    from taichi_eye.studies.exams import measure_all

    refuse_bad_table(given.table)
    if given.out is not None:
        raise SceneError("--out: several exams go into one table and no folders; leave out --out or --table")
    kept = ("command", "do", "film", "out", "table", "threads", "quiet")
    options = {name: value for name, value in vars(given).items() if name not in kept and value is not None}
    counts, first = measure_all(given.film, Path(given.table), options, given.threads, progress=not given.quiet)
    if not counts["complete"]:
        print(f"taichi-eye: none of {len(given.film)} exams could be read; the first: {first}", file=sys.stderr)
        return 2
    said = ", ".join(f"{number} {status}" for status, number in counts.items() if number)
    print(f"{given.table}: {len(given.film)} exams ({said})")
    return 0
