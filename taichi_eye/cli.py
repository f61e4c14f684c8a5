"""The command line: `taichi-eye run SCENE`, `scene`, `analyze FILM`, `estimate DATA`, `sweep STUDY`, `play`,
`docs PAGE`, and the proofs, `check NAME`: `verify`, `stability`, `chart`, `choices`, `error-bars`, `claims`, `films`,
`clinic`, `fit-clinic`, `estimates`, `scenes`, `bench`, each a command by itself as well. Every command is a thin call
of a public function; arguments that several share are in `options`.

Exit status: 0 done; 1 the run left its validity and was stopped (what was computed so far is in the run folder), or a
row of `verify`, `films`, `estimates`, `choices`, `error-bars`, `scenes` or `bench` does not hold, or a file or standard
output could not be written; 2 bad input, nothing written; 130 interrupted, 143 ended by SIGTERM, 129 by SIGHUP.
"""

import argparse
import math
import signal
import sys
from importlib import import_module
from pathlib import Path

from taichi_eye import backend, console, docs, options, provenance, shipped
from taichi_eye.errors import FilmError, OutputError, RunStopped, SceneError
from taichi_eye.estimation import command as estimates
from taichi_eye.page import command as pages
from taichi_eye.studies import command as sweeps

# what a command that was interrupted leaves, and the command that goes on with it
CUT_OFF = {
    "run": ("what was computed so far is", "run"),
    "sweep": ("the eyes that are finished are", "sweep"),
    "chart": ("the points so far are", "check chart"),
}


def parser() -> argparse.ArgumentParser:
    """The argument parser of `taichi-eye`."""
    top = options.Command(
        prog="taichi-eye",
        description="Mesh-free simulation and film of the ophthalmic air-puff test.",
        epilog="What is checked can be asked for without `check` as well: taichi-eye verify.",
        examples=("taichi-eye run quick", "taichi-eye docs", "taichi-eye run --help"),
    )
    top.add_argument("--version", action=Show, const=provenance.versions, help="print versions and exit")
    top.add_argument("--cite", action=Show, const=_citation, help="print how to cite, as BibTeX, and exit")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands)
    _add_scene(commands)
    _add_analyze(commands)
    estimates.add(commands)
    sweeps.add(commands)
    pages.add(commands)
    _add_docs(commands)
    check = commands.add_parser(
        "check",
        help="prove and measure: verify, stability, chart, choices, error-bars, claims, films, clinic, fit-clinic, "
        "estimates, scenes and bench",
        description="The proofs: each runs the program against what is known and writes a table and a page.",
        examples=("taichi-eye check verify --only squeeze", "taichi-eye check films --json films.json"),
    )
    _add_checks(check.add_subparsers(dest="command", required=True, metavar="NAME"), listed=True)
    _add_checks(commands, listed=False)
    return top


class Show(argparse.Action):
    """Print what a function says, and end."""

    def __init__(self, *given, **settings):
        super().__init__(*given, nargs=0, **settings)

    def __call__(self, parser, *_):
        print(self.const())
        parser.exit()


def _citation() -> str:
    from taichi_eye.citation import bibtex

    return bibtex()


def _add_run(commands) -> None:
    run = commands.add_parser(
        "run",
        help="simulate a scene and film it into a run folder",
        description="Simulate a scene and film it into a run folder: film.mp4, apex.png, "
        "sheet.png, report.html, traces.csv, wall.npz, summary.json, scene.toml.",
        examples=(
            "taichi-eye run quick",
            "taichi-eye run seed --set eye.iop_mmhg=25 --set cornea.thickness_mm=0.6",
            "taichi-eye run my.toml --compare measured.csv --out renders/mine",
            "taichi-eye run --resume renders/seed-001",
        ),
    )
    options.take(
        run,
        "scene?",
        "set",
        "out",
        "resume",
        out="run folder, new or empty (default: a new one under renders/)",
        resume="go on with the run in this folder, which was cut off; beside --threads, --watch and --quiet it stands "
        "alone",
    )
    run.add_argument(
        "--compare",
        metavar="CSV",
        help="measured history to draw into apex.png: columns time_ms and apex_displacement_mm or deflection_mm",
    )
    options.take(run, "arch", "precision", "threads", "quiet")
    run.add_argument("--watch", action="store_true", help="print the address of a page that shows the run as it goes")
    pages.add_address(run, "; with --watch")
    run.set_defaults(do=_run)


def _add_scene(commands) -> None:
    scene = commands.add_parser(
        "scene",
        help="print a scene with every key, to edit and run",
        description="Print a scene file with every key, its unit, range and meaning; what is computed from other keys "
        "stands as auto.",
        examples=("taichi-eye scene > my.toml", "taichi-eye scene seed --set eye.iop_mmhg=20 > iop20.toml"),
    )
    options.take(scene, "scene?", "set")
    scene.set_defaults(do=_scene)


def _add_docs(commands) -> None:
    pages = commands.add_parser(
        "docs",
        help="print a page of the guide; without a name, the list of pages",
        description="Print a page of the guide, Markdown text, or the list of pages.",
        examples=("taichi-eye docs", "taichi-eye docs keys"),
    )
    pages.add_argument("page", nargs="?", metavar="NAME", help="a page of the list")
    pages.set_defaults(do=_docs)


def _add_checks(commands, listed: bool) -> None:
    """The proofs; listed: whether the help of `commands` names them."""

    def add(name: str, help: str, **settings):
        shown = {"help": help} if listed else {}
        return commands.add_parser(name, **shown, **{"description": help[:1].upper() + help[1:] + "."} | settings)

    films = (
        "Without --only: optics, reading, damaged and speed, four minutes. Random studies run only when named: "
        "back_edges (300 films, 10 minutes), obstacles (100 films, 7 minutes), mutations (2000 inputs, 14 minutes)."
    )
    for name, what, part, bar in (
        ("verify", "compare the solver's kernels with exact answers", "squeeze", False),
        ("stability", "map where the methods fail, with the theory drawn on", "time-step", False),
        ("films", "hold rendered frames against the instrument's, and their reading against the eyes", "optics", True),
        ("choices", 'put fidelity = "auto" to varied scenes: its true error and its cost', "short-puff", True),
        ("error-bars", "hold the stated numerical errors against the true ones", "cavity", True),
        ("scenes", "put scenes drawn at random to the loader and the solver", "pairs", True),
        ("bench", "measure how fast it is, each figure beside what is asked of it", "startup", True),
    ):
        proof = add(
            name,
            what,
            description=f"{what.capitalize()}; writes one table and one page.",
            epilog=films if name == "films" else None,
            parts=lambda name=name: _proof(name).PARTS,
            examples=(f"taichi-eye check {name}", f"taichi-eye check {name} --only {part} --json {name}.json"),
        )
        options.take(proof, "only", "json", "out", "threads", *(["quiet"] if bar else []))
        proof.set_defaults(do=_prove)
    clinic = add(
        "clinic",
        "what a clinician would measure on a scene's eye, beside living eyes",
        description="Run a scene without a film, at other IOPs and thicknesses, and without each of its switches; "
        "levels, slopes and public tables of living eyes beside it: clinic.html and clinic.png.",
        examples=(
            "taichi-eye check clinic corvis_healthy",
            "taichi-eye check clinic keratoconus --healthy corvis_healthy --json keratoconus.json",
        ),
    )
    options.take(clinic, "scene", "set")
    clinic.add_argument(
        "--healthy", metavar="SCENE", help="a healthy eye's scene file: this eye beside it, as keratoconus is published"
    )
    options.take(clinic, "out", "json", "threads", "quiet", json="the tables as JSON")
    clinic.set_defaults(do=_clinic)
    refit = add(
        "fit-clinic",
        "fit keys of a scene to levels and slopes of living eyes",
        description="Fit named numbers of a scene to levels and slopes of living eyes at once, on the cavity rung; "
        "prints a table and the overrides to paste.",
        examples=("taichi-eye check fit-clinic corvis_healthy --free cornea.stiffness_a_pa,puff.width_mm",),
    )
    options.take(refit, "scene", "set")
    refit.add_argument(
        "--free", metavar="KEYS", required=True, help="keys to fit, SECTION.KEY,SECTION.KEY,...; any number above 0"
    )
    refit.add_argument(
        "--rounds",
        type=options.count("rounds", 1000),
        default=12,
        metavar="N",
        help="end after so many evaluations with derivatives (12)",
    )
    options.take(refit, "json", "threads", "quiet")
    refit.set_defaults(do=_refit)
    study = add(
        "estimates",
        "put the estimate to eyes whose pressure is known",
        description="Estimates of made eyes of a scene: how far off, and whether their intervals hold the truth; by "
        "traces, by films, with a wrong puff, by other models. Writes one table and one page; 40 eyes take an hour or "
        "two.",
        parts=lambda: _proof("estimates").PARTS,
        examples=("taichi-eye check estimates corvis_healthy --only alone --eyes 8",),
    )
    options.take(study, "scene", "set", "only")
    study.add_argument("--eyes", type=options.count("eyes", 10000), default=40, metavar="N", help="eyes of a part (40)")
    study.add_argument("--seed", type=int, default=14, metavar="N", help="of the eyes and their noise (14)")
    options.take(study, "json", "out", "threads", "quiet")
    study.set_defaults(do=_study)
    claims = add(
        "claims",
        "put the paper's claims on delay, asymmetry and IOP to the model",
        description="Run some forty puffs on the default eye that differ in one thing each and "
        "say which of the paper's claims hold: claims.html and claims.csv.",
        examples=("taichi-eye check claims", "taichi-eye check claims --spacing-mm 0.2 --json claims.json"),
    )
    claims.add_argument("--spacing-mm", type=float, default=0.25, metavar="H", help="node spacing (default: 0.25)")
    options.take(
        claims,
        "out",
        "json",
        "threads",
        "quiet",
        json="also write claims, sensitivities and all runs as JSON",
    )
    claims.set_defaults(do=_claims)
    chart = add(
        "chart",
        "chart speed against accuracy: rungs and settings side by side",
        description="Run a scene under every rung of the ladder and many settings, and chart wall time "
        "against error: chart.png, chart.html, chart.json. Can be interrupted and resumed.",
        examples=("taichi-eye check chart seed", "taichi-eye check chart my.toml --budget 60"),
    )
    options.take(chart, "scene?", "set")
    chart.add_argument(
        "--budget",
        type=options.positive,
        default=300.0,
        metavar="SECONDS",
        help="points that do not fit are passed over (default: 300)",
    )
    options.take(
        chart,
        "out",
        "resume",
        "json",
        "threads",
        "quiet",
        resume="go on with the chart in this folder",
        json="the figures as JSON, a copy of chart.json",
    )
    chart.set_defaults(do=_chart)


def _add_analyze(commands) -> None:
    analyze = commands.add_parser(
        "analyze",
        help="measure a Corvis ST film, recorded or computed",
        description="Find the edges of the cornea in a film, a folder of images or a run, undo "
        "refraction and write the dynamic corneal response: parameters.csv, parameters.json, "
        "histories.csv, edges.npz, overlay.mp4, analysis.png, report.html.",
        examples=(
            "taichi-eye analyze film.avi --iop-nct-mmhg 16 --age-years 60",
            "taichi-eye analyze renders/corvis_healthy-001",
            "taichi-eye analyze films/a.avi films/b.avi --table all.csv",
        ),
    )
    analyze.add_argument(
        "film", nargs="+", metavar="FILM|FOLDER|RUN", help="film (mp4, avi, ...), folder of images, or run folder"
    )
    analyze.add_argument(
        "--table", metavar="FILE", help="one table of all exams, CSV or Parquet, a row each, in place of folders"
    )
    options.take(analyze, "threads", "out", "quiet", threads="with --table: exams read at a time")
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
        analyze.add_argument(flag, type=options.positive, metavar=unit, help=text)
    analyze.set_defaults(do=_analyze)


@console.steady
def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    given = parser().parse_args(arguments)
    try:
        backend.refuse_homeless()
        with provenance.command(sys.argv[1:] if arguments is None else arguments):
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
        folder, where = getattr(error, "folder", None), ""
        if folder is not None and given.command in CUT_OFF:
            kept, command = CUT_OFF[given.command]
            where = f"; {kept} in {folder}, go on with: taichi-eye {command} --resume {folder}"
        print(f"taichi-eye: {error if str(error) else 'interrupted'}{where}", file=sys.stderr)
        return 128 + getattr(error, "number", signal.SIGINT)


def _run(given) -> int:
    if not given.watch and (given.host or given.port):
        raise SceneError("--host and --port are those of the page that --watch serves: add it, or leave them out")
    if given.resume is not None:
        others = {"a scene": given.scene, "--set": given.overrides, "--out": given.out, "--compare": given.compare}
        others |= {"--arch": given.arch, "--precision": given.precision}
        if beside := [name for name, value in others.items() if value]:
            raise SceneError(f"--resume {given.resume}: goes on as the run began, so leave out {', '.join(beside)}")
        # solver and film are slow to load, and a bad command is refused without them
        from taichi_eye.pipeline import resume

        with pages.watching(given) as watch:
            result = resume(given.resume, not given.quiet, given.threads, watch)
        if result.finished_before:
            print(f"{result.folder}: this run was finished already")
    else:
        from taichi_eye.pipeline import run
        from taichi_eye.scene import load_scene

        compare = None if given.compare is None else shipped.find(given.compare, shipped.HISTORIES)
        scene = load_scene(given.scene, given.overrides)
        backend.init(given.arch or "cpu", given.precision or "f64", given.threads)
        name = Path(given.scene).stem if given.scene else "eye"
        with pages.watching(given) as watch:
            result = run(scene, given.out, name, compare, progress=not given.quiet, watch=watch)
    if result.summary["status"] != "complete":
        print(f"{result.folder}: is finished: {result.summary['reason']}")
        return 1
    for warning in result.summary["warnings"]:
        print(f"warning: {warning}")
    if "numerical_error" in result.summary:
        for line in _with_errors(result.summary):
            print(line)
    said = f"apex deflection {_peak(result.summary, 'apex_displacement_mm')}"
    if result.summary["apex_deformation_mm"]["peak"] != result.summary["apex_displacement_mm"]["peak"]:
        said += f", deformation {_peak(result.summary, 'apex_deformation_mm')}"
    print(f"{result.folder}: {said}, {result.summary['wall_clock']['total_s']:.1f} s")
    return 0


def _peak(summary: dict, name: str) -> str:
    """A peak and its time, with their numerical errors where they are stated."""
    peak, time = summary[name]["peak"], summary[name]["peak_time_ms"]
    if "numerical_error" not in summary:
        return f"{peak:.3f} mm at {time:.2f} ms"
    errors = summary["numerical_error"][name]
    return f"{_with_error(peak, errors['peak'])} mm at {_with_error(time, errors['peak_time_ms'])} ms"


def _with_errors(summary: dict) -> list[str]:
    """A table of the clinical parameters: value, numerical error, extrapolated value."""
    lines = [f"{'parameter':34}{'computed':>12}{'num. error':>12}{'extrapolated':>14}"]
    errors, limits = (summary[kind]["response"] for kind in ("numerical_error", "extrapolated"))
    for name, value in summary["response"].items():
        if value is not None and errors[name] is not None:
            limit = "-" if limits[name] is None else f"{limits[name]:.5g}"
            lines.append(f"{name:34}{value:>12.5g}{errors[name]:>12.2g}{limit:>14}")
    return lines if len(lines) > 1 else []


def _with_error(value: float, error: float | None) -> str:
    """A value to two figures of its error, as in 0.9670 +- 0.0016."""
    if error is None:
        return f"{value:.3f}"
    digits = min(max(2 - math.ceil(math.log10(error)), 0), 9) if error > 0.0 else 3
    return f"{value:.{digits}f} +- {error:.{digits}f}"


def _scene(given) -> int:
    from taichi_eye.scene import dump_scene, load_scene

    print(dump_scene(load_scene(given.scene, given.overrides)), end="")
    return 0


def _docs(given) -> int:
    if given.page is not None:
        print(docs.text(given.page))
        return 0
    width = max(map(len, docs.names()))
    for name in docs.names():
        print(f"{name:{width}}  {docs.title(name)}")
    return 0


def _proof(name: str):
    """The module of a proof that consists of parts."""
    return import_module(f"taichi_eye.{'bench' if name == 'bench' else 'proof'}.{name.replace('-', '_')}")


def _asked(given):
    """The proof of a command; SceneError where it has no such parts, or its figures could not be written."""
    proof = _proof(given.command)
    unknown = [name for name in given.only if name not in proof.PARTS]
    if unknown:
        raise SceneError(f"--only {unknown[0]}: {given.command} has {', '.join(proof.PARTS)}")
    options.refuse_unwritable(given.json)
    return proof


def _study(given) -> int:
    from taichi_eye.scene import load_scene

    proof, scene = _asked(given), load_scene(given.scene, given.overrides)
    backend.init("cpu", "f64", given.threads)
    found = proof.report(scene, given.only, given.eyes, given.seed, given.out, given.json, progress=not given.quiet)
    return 0 if found else 1


def _prove(given) -> int:
    proof = _asked(given)
    backend.init("cpu", "f64", given.threads)
    bar = {"progress": not given.quiet} if hasattr(given, "quiet") else {}
    return 0 if proof.report(given.only, given.out, given.json, **bar) else 1


def _analyze(given) -> int:
    if given.table is not None:
        return sweeps.analyze(given)
    if len(given.film) > 1:
        raise SceneError(f"{len(given.film)} exams: name the table that they go into, as in --table all.csv")
    from taichi_eye.analysis import analyze, table

    kept = ("command", "do", "film", "out", "table", "threads", "quiet")
    options = {name: value for name, value in vars(given).items() if name not in kept}
    result = analyze(given.film[0], given.out, progress=not given.quiet, **options)
    print(table(result))
    for note in result.notes:
        print(f"note: {note}")
    print(f"{result.folder}: parameters, histories, overlay film and plots of {len(result.film.frames)} frames")
    return 0


def _clinic(given) -> int:
    from taichi_eye.proof import dcr
    from taichi_eye.scene import load_scene

    load_scene(given.scene, given.overrides)
    if given.healthy:
        load_scene(given.healthy)
    options.refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
    dcr.report(given.scene, given.overrides, given.out, given.json, not given.quiet, healthy=given.healthy)
    return 0


def _refit(given) -> int:
    from taichi_eye.proof import refit
    from taichi_eye.scene import load_scene

    names = [name.strip() for name in given.free.split(",")]
    refit.free_keys(load_scene(given.scene, given.overrides), names)
    options.refuse_unwritable(given.json)
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
    options.refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
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
    options.refuse_unwritable(given.json)
    backend.init("cpu", "f64", given.threads)
    points = chart.read(Path(given.resume), scene) if given.resume else {}
    folder = Path(given.resume) if given.resume else create_run_folder(given.out, "chart")
    with tqdm(unit=" points", disable=given.quiet, dynamic_ncols=True) as bar:

        def tell(label, done, total):
            bar.total = total
            bar.set_description_str(label)
            bar.update(done - bar.n)

        try:
            charted = chart.measure(scene, folder, points, given.budget, tell)
        except KeyboardInterrupt as reason:
            reason.folder = folder
            raise
    page = chart_page.write(charted, folder, f"taichi-eye chart {given.scene or ''}")
    if given.json:
        write_text(Path(given.json), (folder / "chart.json").read_text(encoding="utf-8"))
    for line in chart_page.words(charted):
        print(line)
    print(page)
    return 0
