"""The command line: `taichi-eye run SCENE.toml`, `analyze FILM`, `estimate DATA`, `chart SCENE.toml`, and `calibrate`,
`estimates`, `verify`, `stability`, `clinic`, `fit-clinic`, `claims`, `films`, `choices`, `bench`.

Exit status: 0 done; 1 the run left its validity and was stopped (what was computed so far is in the run folder), or a
row of `verify`, `films`, `estimates`, `choices` or `bench` does not hold, or a file or standard output could not be
written; 2 bad input, nothing written; 130 interrupted, 143 ended by SIGTERM, 129 by SIGHUP.
"""

import argparse
import os
import signal
import sys
from pathlib import Path

from taichi_eye import backend, console, estimate_cli
from taichi_eye.errors import FilmError, OutputError, RunStopped, SceneError


def parser() -> argparse.ArgumentParser:
    """The argument parser of `taichi-eye`."""
    top = argparse.ArgumentParser(prog="taichi-eye", description="Mesh-free simulation and film of the air-puff test.")
    commands = top.add_subparsers(dest="command", required=True)
    run = commands.add_parser(
        "run",
        help="simulate a scene and film it into a run folder",
        description="Simulate a scene and film it into a run folder: film.mp4, apex.png, "
        "sheet.png, traces.csv, summary.json, scene.toml.",
    )
    _take_scene(run)
    run.add_argument("--out", metavar="DIR", help="run folder, new or empty (default: a new one under renders/)")
    run.add_argument(
        "--resume",
        metavar="DIR",
        help="go on with the run in this folder, which was cut off; only --threads and --quiet may stand with it",
    )
    run.add_argument(
        "--compare",
        metavar="CSV",
        help="measured history to draw into apex.png: columns time_ms and apex_displacement_mm or deflection_mm",
    )
    run.add_argument("--arch", choices=backend.ARCHES, help="Taichi backend (default: cpu)")
    run.add_argument("--precision", choices=backend.PRECISIONS, help="default: f64")
    run.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
    run.add_argument("--quiet", action="store_true", help="no progress bar")
    run.set_defaults(do=_run)
    _add_analyze(commands)
    studies = (
        "Without --only: optics, reading, damaged and speed, four minutes. Random studies run only when named: "
        "back_edges (300 films, 10 minutes), obstacles (100 films, 7 minutes), mutations (2000 inputs, 14 minutes)."
    )
    for name, what in (
        ("verify", "compare the solver's kernels with exact answers"),
        ("stability", "map where the methods fail, with the theory drawn on"),
        ("films", "hold rendered frames against the instrument's, and their reading against the eyes filmed"),
        ("choices", 'put fidelity = "auto" to varied scenes: its true error and its cost'),
        ("bench", "measure how fast it is, each figure beside what is asked of it"),
    ):
        proof = commands.add_parser(
            name,
            help=what,
            description=f"{what.capitalize()}; writes one table and one page.",
            epilog=studies if name == "films" else None,
        )
        proof.add_argument(
            "--only", metavar="NAME", action="append", default=[], help="one part of it; may be repeated"
        )
        proof.add_argument("--json", metavar="FILE", help="the figures as JSON")
        proof.add_argument("--out", metavar="DIR", help="folder of the page, new or empty (default: under renders/)")
        proof.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
        proof.set_defaults(do=_prove)
    clinic = commands.add_parser(
        "clinic",
        help="what a clinician would measure on a scene's eye, beside living eyes",
        description="Run a scene without a film, at other IOPs and thicknesses, and without each of its switches; "
        "levels, slopes and public tables of living eyes beside it: clinic.html and clinic.png.",
    )
    clinic.add_argument("scene", help="scene file (TOML)")
    clinic.add_argument(
        "--set",
        dest="overrides",
        metavar="SECTION.KEY=VALUE",
        action="append",
        default=[],
        help="override a key of the scene; may be repeated",
    )
    clinic.add_argument("--out", metavar="DIR", help="folder of the page, new or empty (default: under renders/)")
    clinic.add_argument("--json", metavar="FILE", help="the tables as JSON")
    clinic.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
    clinic.add_argument("--quiet", action="store_true", help="no progress bar")
    clinic.set_defaults(do=_clinic)
    refit = commands.add_parser(
        "fit-clinic",
        help="fit keys of a scene to levels and slopes of living eyes",
        description="Fit named numbers of a scene to levels and slopes of living eyes at once, on the cavity rung; "
        "prints a table and the overrides to paste.",
    )
    refit.add_argument("scene", help="scene file (TOML)")
    refit.add_argument(
        "--free", metavar="KEYS", required=True, help="keys to fit, SECTION.KEY,SECTION.KEY,...; any number above 0"
    )
    refit.add_argument(
        "--set",
        dest="overrides",
        metavar="SECTION.KEY=VALUE",
        action="append",
        default=[],
        help="override a key of the scene; may be repeated",
    )
    refit.add_argument(
        "--rounds", type=_rounds, default=12, metavar="N", help="end after so many evaluations with derivatives (12)"
    )
    refit.add_argument("--json", metavar="FILE", help="the figures as JSON")
    refit.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
    refit.add_argument("--quiet", action="store_true", help="no progress bar")
    refit.set_defaults(do=_refit)
    claims = commands.add_parser(
        "claims",
        help="put the paper's claims on delay, asymmetry and IOP to the model",
        description="Run some forty puffs on the default eye that differ in one thing each and "
        "say which of the paper's claims hold: claims.html and claims.csv.",
    )
    claims.add_argument(
        "--out", metavar="DIR", help="folder for the page, new or empty (default: a new one under renders/)"
    )
    claims.add_argument("--spacing-mm", type=float, default=0.25, metavar="H", help="node spacing (default: 0.25)")
    claims.add_argument("--json", metavar="FILE", help="also write claims, sensitivities and all runs as JSON")
    claims.add_argument("--quiet", action="store_true", help="no progress bar")
    claims.set_defaults(do=_claims)
    _add_chart(commands)
    estimate_cli.add(commands)
    return top


def _take_scene(command) -> None:
    command.add_argument("scene", nargs="?", help="scene file (TOML); without one, the default eye")
    command.add_argument(
        "--set",
        dest="overrides",
        metavar="SECTION.KEY=VALUE",
        action="append",
        default=[],
        help="override a key of the scene; may be repeated",
    )


def _add_chart(commands) -> None:
    chart = commands.add_parser(
        "chart",
        help="chart speed against accuracy: rungs and settings side by side",
        description="Run a scene under every rung of the ladder and many settings, and chart wall time "
        "against error: chart.png, chart.html, chart.json. Can be interrupted and resumed.",
    )
    _take_scene(chart)
    chart.add_argument(
        "--budget",
        type=_positive,
        default=300.0,
        metavar="SECONDS",
        help="points that do not fit are passed over (default: 300)",
    )
    chart.add_argument("--out", metavar="DIR", help="folder of the chart, new or empty (default: under renders/)")
    chart.add_argument("--resume", metavar="DIR", help="go on with the chart in this folder")
    chart.add_argument("--json", metavar="FILE", help="the figures as JSON, a copy of chart.json")
    chart.add_argument("--quiet", action="store_true", help="no progress bar")
    chart.set_defaults(do=_chart)


def _add_analyze(commands) -> None:
    analyze = commands.add_parser(
        "analyze",
        help="measure a Corvis ST film, recorded or computed",
        description="Find the edges of the cornea in a film, a folder of images or a run, undo "
        "refraction and write the dynamic corneal response: parameters.csv, parameters.json, "
        "histories.csv, edges.npz, overlay.mp4, analysis.png.",
    )
    analyze.add_argument(
        "film", metavar="FILM|FOLDER|RUN", help="film (mp4, avi, ...), folder of images, or run folder"
    )
    analyze.add_argument(
        "--out", metavar="DIR", help="results folder, new or empty (default: a new one under renders/)"
    )
    for flag, unit, text in (
        ("--pixel-x-mm", "MM", "width of a pixel (default 0.015625)"),
        ("--pixel-y-mm", "MM", "height of a pixel (default 0.0165)"),
        ("--frame-interval-ms", "MS", "time between frames (default 0.2315)"),
        ("--angle-deg", "DEG", "camera to slit plane (default 45)"),
        ("--refractive-index", "N", "of the cornea (default 1.376)"),
        ("--biop-mmhg", "MMHG", "pressure of the eye, for SP-A1"),
        ("--iop-nct-mmhg", "MMHG", "pressure that the instrument shows; with --age-years, for SP-A1"),
        ("--age-years", "YEARS", "see --iop-nct-mmhg"),
    ):
        analyze.add_argument(flag, type=_positive, metavar=unit, help=text)
    analyze.set_defaults(do=_analyze)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _threads(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of threads from 1 to 1024")
    return int(text)


def _rounds(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of rounds from 1 to 1000")
    return int(text)


@console.steady
def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    given = parser().parse_args(arguments)
    try:
        backend.refuse_homeless()
        return given.do(given)
    except (SceneError, FilmError, backend.BackendError) as error:
        print(f"taichi-eye: {error}", file=sys.stderr)
        return 2
    except RunStopped as error:
        where = f"\nWhat was computed so far is in {error.folder}." if error.folder is not None else ""
        print(f"taichi-eye: {error}{where}", file=sys.stderr)
        return 1
    except OutputError as error:
        print(f"taichi-eye: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"taichi-eye: {where}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as error:
        folder = getattr(error, "folder", None)
        where = (
            f"; what was computed so far is in {folder}, go on with: taichi-eye run --resume {folder}" if folder else ""
        )
        print(f"taichi-eye: {error if str(error) else 'interrupted'}{where}", file=sys.stderr)
        return 128 + getattr(error, "number", signal.SIGINT)


def _run(given) -> int:
    if given.resume is not None:
        others = {"a scene": given.scene, "--set": given.overrides, "--out": given.out, "--compare": given.compare}
        others |= {"--arch": given.arch, "--precision": given.precision}
        if beside := [name for name, value in others.items() if value]:
            raise SceneError(f"--resume {given.resume}: goes on as the run began, so leave out {', '.join(beside)}")
        # solver and film are slow to load, and a bad command is refused without them
        from taichi_eye.pipeline import resume

        result = resume(given.resume, not given.quiet, given.threads)
        if result.finished_before:
            print(f"{result.folder}: this run was finished already")
    else:
        from taichi_eye.pipeline import run
        from taichi_eye.scene import load_scene

        scene = load_scene(given.scene, given.overrides)
        backend.init(given.arch or "cpu", given.precision or "f64", given.threads)
        name = Path(given.scene).stem if given.scene else "eye"
        result = run(scene, given.out, name, given.compare, progress=not given.quiet)
    if result.summary["status"] != "complete":
        print(f"{result.folder}: is finished: {result.summary['reason']}")
        return 1
    for warning in result.summary["warnings"]:
        print(f"warning: {warning}")
    apex = result.summary["apex_displacement_mm"]
    print(
        f"{result.folder}: apex {apex['peak']:.3f} mm at {apex['peak_time_ms']:.2f} ms, "
        f"{result.summary['wall_clock']['total_s']:.1f} s"
    )
    return 0


def _refuse_unwritable(json_file: str | None) -> None:
    """SceneError where `--json` cannot be written, said before the minutes of work it would hold."""
    if json_file is None:
        return
    path = Path(json_file)
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise SceneError(
            f"--json {json_file}: cannot be written; name a file in an existing folder that may be written"
        )


def _prove(given) -> int:
    from importlib import import_module

    room = "bench" if given.command == "bench" else "proof"
    proof = import_module(f"taichi_eye.{room}.{given.command}")
    unknown = [name for name in given.only if name not in proof.PARTS]
    if unknown:
        raise SceneError(f"--only {unknown[0]}: {given.command} has {', '.join(proof.PARTS)}")
    _refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
    return 0 if proof.report(given.only, given.out, given.json) else 1


def _analyze(given) -> int:
    from taichi_eye.analysis import analyze, table

    options = {name: value for name, value in vars(given).items() if name not in ("command", "do", "film", "out")}
    result = analyze(given.film, given.out, **options)
    print(table(result))
    for note in result.notes:
        print(f"note: {note}")
    print(f"{result.folder}: parameters, histories, overlay film and plots of {len(result.film.frames)} frames")
    return 0


def _clinic(given) -> int:
    from taichi_eye.proof import dcr
    from taichi_eye.scene import load_scene

    load_scene(given.scene, given.overrides)
    _refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
    dcr.report(given.scene, given.overrides, given.out, given.json, not given.quiet)
    return 0


def _refit(given) -> int:
    from taichi_eye.proof import refit
    from taichi_eye.scene import load_scene

    names = [name.strip() for name in given.free.split(",")]
    refit.free_keys(load_scene(given.scene, given.overrides), names)
    _refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
    refit.report(given.scene, names, given.overrides, given.rounds, given.json, not given.quiet)
    return 0


def _claims(given) -> int:
    # plots and solver are slow to load, and other commands do without
    from tqdm import tqdm

    from taichi_eye.proof import claims, claims_page
    from taichi_eye.report.folder import create_run_folder, write_text
    from taichi_eye.scene import load_scene

    load_scene(None, (f"numerics.spacing_mm={given.spacing_mm}",))
    _refuse_unwritable(given.json)
    backend.init()
    folder = create_run_folder(given.out, "claims")
    listed = claims.cases()
    with tqdm(total=len(listed), unit=" runs", disable=given.quiet, dynamic_ncols=True) as bar:
        outcomes = []
        for case in listed:
            bar.set_description_str(case.label)
            outcomes.append(claims.run_case(case, given.spacing_mm))
            bar.update()
    results = claims.Results(outcomes)
    page = claims_page.write(results, folder, given.spacing_mm)
    if given.json:
        write_text(Path(given.json), claims_page.as_json(results))
    for verdict in claims_page.verdicts(results):
        print(f"{verdict.claim}: {verdict.holds}")
    print(page)
    return 0


def _chart(given) -> int:
    from tqdm import tqdm

    from taichi_eye.ladder import chart, chart_page
    from taichi_eye.report.folder import create_run_folder, write_text
    from taichi_eye.scene import load_scene

    scene = load_scene(given.scene, given.overrides)
    if given.resume and given.out:
        raise SceneError("--resume goes on in the chart's own folder: leave --out out")
    _refuse_unwritable(given.json)
    points = chart.read(Path(given.resume), scene) if given.resume else {}
    folder = Path(given.resume) if given.resume else create_run_folder(given.out, "chart")
    with tqdm(unit=" points", disable=given.quiet, dynamic_ncols=True) as bar:

        def tell(label, done, total):
            bar.total = total
            bar.set_description_str(label)
            bar.update(done - bar.n)

        try:
            charted = chart.measure(scene, folder, points, given.budget, tell)
        except KeyboardInterrupt:
            bar.close()
            print(f"taichi-eye: interrupted; go on with --resume {folder}", file=sys.stderr)
            return 130
    page = chart_page.write(charted, folder, f"taichi-eye chart {given.scene or ''}")
    if given.json:
        write_text(Path(given.json), (folder / "chart.json").read_text(encoding="utf-8"))
    for line in chart_page.words(charted):
        print(line)
    print(page)
    return 0
