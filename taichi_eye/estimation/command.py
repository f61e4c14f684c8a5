"""The command line of `estimate DATA` and `calibrate DATA...`: arguments, output."""

from __future__ import annotations

import argparse
import json
import math
import re
import time
from pathlib import Path

from taichi_eye import backend
from taichi_eye.errors import NoEstimate, SceneError
from taichi_eye.options import positive, refuse_unwritable, take

NAME_MAX = 100  # letters of the data's name in the folder's


def add(commands) -> None:
    """The parsers of `estimate` and `calibrate`."""
    estimate = commands.add_parser(
        "estimate",
        help="estimate pressure and tissue of an eye from its motion",
        description="Fit an eye of a scene's model to a trace, a film, a run or a table of clinical parameters; report "
        "pressure and tissue with their intervals: estimate.json, fit.csv, fit.png, corner.png, overlay.mp4.",
        epilog="What an estimate is worth: taichi-eye docs estimate",
        examples=(
            "taichi-eye estimate film.mp4 --scene corvis_healthy",
            "taichi-eye estimate trace.csv --scene corvis_healthy --known thickness_um=552+-5 --age-years 63",
            "taichi-eye estimate renders/seed-001 --free iop_mmhg --model-error-um 0",
        ),
    )
    estimate.add_argument("data", metavar="TRACE.csv|FILM|RUN|TABLE.csv", help="what was measured")
    _add_model(estimate)
    estimate.add_argument(
        "--free",
        metavar="NAMES",
        help="which to estimate, of iop_mmhg, in_plane, out_of_plane, globe (all); the others are the scene's",
    )
    estimate.add_argument("--instrument", metavar="FILE", help="what `taichi-eye calibrate` wrote")
    estimate.add_argument("--row", metavar="N", type=int, help="one row of a table, counted from 1")
    estimate.add_argument(
        "--calibrate-rows",
        action="store_true",
        help="of a table: strength and width of the puff from its own rows, for each row from all the others",
    )
    take(estimate, "out", "json", json="the figures as JSON, a copy of estimate.json")
    estimate.set_defaults(do=_estimate)
    calibrate = commands.add_parser(
        "calibrate",
        help="estimate an instrument's puff from many eyes",
        description="Strength and width of the puff from films, traces, runs or tables of many eyes, for `estimate "
        "--instrument`.",
        examples=(
            "taichi-eye calibrate films/*.mp4 --scene corvis_healthy --json instrument.json",
            "taichi-eye estimate film.mp4 --scene corvis_healthy --instrument instrument.json",
        ),
    )
    calibrate.add_argument("data", metavar="DATA", nargs="+", help="what was measured")
    _add_model(calibrate)
    calibrate.add_argument("--json", metavar="FILE", required=True, help="where the calibration goes")
    calibrate.set_defaults(do=_calibrate)


def _add_model(command) -> None:
    command.add_argument(
        "--scene",
        metavar="SCENE.toml",
        help="the model, a file or the name of a scene that ships; of a run its own, else it has to be named",
    )
    take(command, "set")
    command.add_argument(
        "--known",
        metavar="NAME=VALUE[+-SD]",
        action="append",
        default=[],
        help="what is known: thickness_um, radius_mm; puff, puff_width, whole_eye, in_plane, out_of_plane, globe as "
        "factors on the scene's; exact without +-SD; may be repeated",
    )
    command.add_argument("--age-years", type=float, metavar="YEARS", help="moves what is taken for in_plane beforehand")
    command.add_argument("--noise-um", type=positive, metavar="UM", help="of a value of a trace (default: from itself)")
    command.add_argument(
        "--model-error-um",
        type=_not_negative,
        metavar="UM",
        help="of a history (default: the scene's own misfit to living eyes); 0 for data of the model itself",
    )
    command.add_argument(
        "--tolerance-percent",
        type=positive,
        metavar="P",
        help="end on the cheapest rung within it (default: the scene's numerics.fidelity)",
    )
    for flag, text in (
        ("--pixel-x-mm", "width of a pixel"),
        ("--pixel-y-mm", "height of a pixel"),
        ("--frame-interval-ms", "time between frames"),
    ):
        command.add_argument(flag, type=positive, metavar=flag.rsplit("-", 1)[1].upper(), help=text)
    take(command, "threads", "quiet")


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of 0 or more")
    return value


def known_of(texts: list[str]) -> dict:
    """`NAME=VALUE[+-SD]` of the command line; SceneError where one reads otherwise."""
    from taichi_eye.estimation.unknowns import Known

    found = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        parts = re.split(r"\+-|\+/-|\N{PLUS-MINUS SIGN}", rest)
        try:
            if not equals or len(parts) > 2:
                raise ValueError
            found[name.strip()] = Known(*(float(part) for part in parts))
        except ValueError:
            raise SceneError(
                f"--known {text}: must read NAME=VALUE or NAME=VALUE+-SD, as in thickness_um=552+-5"
            ) from None
    return found


def _scene(given, path: Path):
    from taichi_eye.estimation.reading import run_scene_of
    from taichi_eye.ladder.choose import choose
    from taichi_eye.scene import load_scene

    if given.scene is not None:
        scene = load_scene(given.scene, given.overrides)
    elif (scene := run_scene_of(path)) is not None:
        if given.overrides:
            folder = path if path.is_dir() else path.parent
            scene = load_scene(folder / "scene.toml", given.overrides)
    else:
        raise SceneError(
            f"{path}: says nothing of the model that it is fitted with; name one, as in --scene corvis_healthy"
        )
    backend.init("cpu", "f64", given.threads)
    if given.tolerance_percent is not None:
        changes = {"numerics.fidelity": "auto", "numerics.tolerance_percent": given.tolerance_percent}
        scene = choose(scene.but(changes)).scene
    return scene


def _instrument(given) -> dict:
    return {name: getattr(given, name) for name in ("pixel_x_mm", "pixel_y_mm", "frame_interval_ms")}


def _estimate(given) -> int:
    # plots and solver are slow to load, and other commands do without
    from tqdm import tqdm

    from taichi_eye.estimation import calibration as instruments
    from taichi_eye.estimation import estimate as estimates
    from taichi_eye.estimation import words
    from taichi_eye.estimation.reading import read
    from taichi_eye.report.folder import create_run_folder, refuse_taken, write_text

    path = Path(given.data)
    known = known_of(given.known)
    free = tuple(name.strip() for name in given.free.split(",")) if given.free else estimates.FREE
    if given.calibrate_rows and given.instrument:
        raise SceneError("--calibrate-rows: calibrates by the rows themselves; leave out --instrument")
    refuse_unwritable(given.json)
    refuse_taken(given.out)
    scene = _scene(given, path)
    instrument = instruments.Calibration.read(given.instrument) if given.instrument else None
    found = read(path, scene, given.noise_um, given.age_years, **_instrument(given))
    seen, rows = found.seen, found.rows
    if given.row is not None:
        if rows is None or not 1 <= given.row <= len(seen):
            raise SceneError(f"--row {given.row}: {path} has {f'rows 1 to {len(seen)}' if rows else 'no rows'}")
        seen, rows = [seen[given.row - 1]], [rows[given.row - 1]]
    if given.calibrate_rows and (rows is None or len(rows) < 3):
        raise SceneError("--calibrate-rows: needs a table of at least three rows")
    wide = instruments.wide(scene, known) if given.calibrate_rows else {}
    many = rows is not None and len(rows) > 1
    with tqdm(total=len(seen), unit=" eyes", disable=given.quiet, dynamic_ncols=True, leave=False) as bar:

        def one(observation, known, instrument):
            """The estimate of an eye, or what refuses one of many."""
            problem = estimates.problem_of(
                observation,
                scene,
                known,
                free,
                given.age_years,
                given.model_error_um,
                instrument,
                bar.set_description_str,
            )
            started = time.perf_counter()
            try:
                solution = estimates.solve(problem, not many)
            except NoEstimate as refusal:
                if not many:
                    raise
                return refusal
            finally:
                bar.update()
            return estimates.finished(problem, solution, started, found.film, () if many else found.notes)

        results = [one(observation, known | wide, instrument) for observation in seen]
        whole = None
        if given.calibrate_rows:
            sound = [k for k, result in enumerate(results) if not isinstance(result, NoEstimate)]
            told = [instruments.told(results[k].problem, results[k].solution) for k in sound]
            whole = instruments.combined(scene, told)
            bar.total += len(sound)
            for k, others in zip(sound, instruments.held_out(scene, told)):
                results[k] = one(seen[k], known, others)
    folder = create_run_folder(given.out, f"{path.stem[:NAME_MAX]}-estimate")
    if many:
        content = _report_rows(results, rows, found.notes, whole, folder)
    else:
        from taichi_eye.estimation import pictures

        for line in words.lines(results[0]):
            print(line)
        content = words.as_json(results[0])
        pictures.write(results[0], folder)
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_text(folder / "estimate.json", text)
    if given.json:
        write_text(Path(given.json), text)
    print(folder)
    return 0


def _report_rows(results, rows, notes, calibration, folder: Path) -> dict:
    """Print a table's estimates and their agreement with its own pressures; what the JSON file holds."""
    from taichi_eye.estimation import words
    from taichi_eye.estimation.estimate import Estimate
    from taichi_eye.report.folder import write_rows

    content: dict = {}
    if calibration is not None:
        print("puff from these rows: " + _calibrated(calibration))
        content["calibration"] = {n: [k.value, k.deviation] for n, k in calibration.known().items()}
    for line in words.table_lines(results, rows):
        print(line)
    for note in notes:
        print(f"note: left out: {note}")
    agreement = words.agreement(results, rows)
    if agreement is not None:
        for line in words.agreement_lines(agreement):
            print(line)
        content["agreement"] = vars(agreement)
    content["rows"] = [words.as_json(one) if isinstance(one, Estimate) else {"refused": str(one)} for one in results]
    names = list(dict.fromkeys(q.name for one in results if isinstance(one, Estimate) for q in one.quantities))
    head = ["row", *(f"{n}{end}" for n in names for end in ("", "_low95", "_high95")), "chi2", "refused"]
    lines = []
    for one, row in zip(results, rows):
        found = {q.name: (q.value, *q.range95) for q in one.quantities} if isinstance(one, Estimate) else {}
        figures = [f"{value:.6g}" if value != "" else "" for n in names for value in found.get(n, ("",) * 3)]
        ends = [f"{one.chi2:.4g}", ""] if isinstance(one, Estimate) else ["", str(one)]
        lines.append([row.label, *figures, *ends])
    write_rows(folder / "estimates.csv", head, lines)
    return content


def _calibrated(calibration) -> str:
    return ", ".join(f"{n} {k.value:.4f} +- {k.deviation:.4f}" for n, k in calibration.known().items())


def _calibrate(given) -> int:
    from tqdm import tqdm

    from taichi_eye.estimation import calibration as instruments
    from taichi_eye.estimation import estimate as estimates
    from taichi_eye.estimation.reading import read
    from taichi_eye.estimation.unknowns import IOP

    known = known_of(given.known)
    refuse_unwritable(given.json)
    if len({Path(data).resolve() for data in given.data}) < len(given.data):
        raise SceneError("the same data are named twice; a calibration counts each eye once")
    scene = _scene(given, Path(given.data[0]))
    wide = instruments.wide(scene, known)
    told, solved = [], []
    with tqdm(total=len(given.data), unit=" files", disable=given.quiet, dynamic_ncols=True, leave=False) as bar:
        for data in given.data:
            found = read(data, scene, given.noise_um, given.age_years, **_instrument(given))
            for seen in found.seen:
                problem = estimates.problem_of(
                    seen,
                    scene,
                    known | wide,
                    estimates.FREE,
                    given.age_years,
                    given.model_error_um,
                    None,
                    bar.set_description_str,
                )
                try:
                    solution = estimates.solve(problem, len(found.seen) == 1)
                except NoEstimate as refusal:
                    print(f"left out: {refusal}")
                    continue
                told.append(instruments.told(problem, solution))
                solved.append((problem, solution))
            bar.update()
    if not told:
        raise NoEstimate("no eye is left to calibrate with")
    calibration = instruments.combined(scene, told)
    calibration.write(Path(given.json))
    anybody = instruments.combined(scene, [])
    print(f"{'eye':32}{'IOP, mmHg, any instrument':>28}{'this one':>18}")
    for problem, solution in solved:
        cells = []
        for instrument in (anybody, calibration):
            place, covariance = instruments.updated(problem, solution, instrument)
            k = problem.before.names.index(IOP)
            iop = math.exp(place[k])
            cells.append(f"{iop:.2f} +- {iop * covariance[k, k] ** 0.5:.2f}")
        print(f"{problem.seen.name[:30]:32}{cells[0]:>28}{cells[1]:>18}")
    print(f"{calibration.eyes} eyes: {_calibrated(calibration)} (any instrument: {_calibrated(anybody)})")
    print(given.json)
    return 0
