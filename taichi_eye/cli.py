"""The command line: `taichi-eye run SCENE.toml`, and `verify`, `stability`, `claims`.

Exit status: 0 done; 1 the run left its validity and was stopped (what was computed so far is in the run folder), or a
row of `verify` failed; 2 bad input, nothing written; 130 interrupted.
"""
import argparse
import sys
from pathlib import Path

from taichi_eye import backend
from taichi_eye.errors import RunStopped, SceneError


def parser() -> argparse.ArgumentParser:
    """The argument parser of `taichi-eye`."""
    top = argparse.ArgumentParser(prog="taichi-eye", description="Mesh-free simulation and film of the air-puff test.")
    commands = top.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="simulate a scene and film it into a run folder",
                              description="Simulate a scene and film it into a run folder: film.mp4, apex.png, "
                              "sheet.png, traces.csv, summary.json, scene.toml.")
    run.add_argument("scene", nargs="?", help="scene file (TOML); without one, the default eye")
    run.add_argument("--set", dest="overrides", metavar="SECTION.KEY=VALUE", action="append", default=[],
                     help="override a key of the scene; may be repeated")
    run.add_argument("--out", metavar="DIR", help="run folder, new or empty (default: a new one under renders/)")
    run.add_argument("--compare", metavar="CSV", help="measured history to draw into apex.png: columns time_ms and "
                     "apex_displacement_mm or deflection_mm")
    run.add_argument("--arch", choices=backend.ARCHES, default="cpu", help="Taichi backend (default: cpu)")
    run.add_argument("--precision", choices=backend.PRECISIONS, default="f64", help="default: f64")
    run.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
    run.add_argument("--quiet", action="store_true", help="no progress bar")
    for name, what in (("verify", "compare the solver's kernels with exact answers"),
                       ("stability", "map where the methods fail, with the theory drawn on"),
                       ("claims", "test the paper's claims in the model")):
        proof = commands.add_parser(name, help=what, description=f"{what.capitalize()}; writes one table and one page.")
        proof.add_argument("--only", metavar="NAME", action="append", default=[], help="one part of it; may be repeated")
        proof.add_argument("--json", metavar="FILE", help="the figures as JSON")
        proof.add_argument("--out", metavar="DIR", help="folder of the page, new or empty (default: under renders/)")
        proof.add_argument("--threads", type=_threads, metavar="N", help="CPU threads (default: all)")
    return top


def _threads(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of threads from 1 to 1024")
    return int(text)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    given = parser().parse_args(arguments)
    try:
        return _run(given) if given.command == "run" else _prove(given)
    except (SceneError, backend.BackendError) as error:
        print(f"taichi-eye: {error}", file=sys.stderr)
        return 2
    except RunStopped as error:
        print(f"taichi-eye: {error}\nWhat was computed so far is in the run folder.", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("taichi-eye: interrupted; what was computed so far is in the run folder.", file=sys.stderr)
        return 130


def _run(given) -> int:
    from taichi_eye.pipeline import run
    from taichi_eye.scene import load_scene

    scene = load_scene(given.scene, given.overrides)
    backend.init(given.arch, given.precision, given.threads)
    name = Path(given.scene).stem if given.scene else "eye"
    result = run(scene, given.out, name, given.compare, progress=not given.quiet)
    apex = result.summary["apex_displacement_mm"]
    print(f"{result.folder}: apex {apex['peak']:.3f} mm at {apex['peak_time_ms']:.2f} ms, "
          f"{result.summary['wall_clock']['total_s']:.1f} s")
    return 0


def _prove(given) -> int:
    from importlib import import_module

    proof = import_module(f"taichi_eye.proof.{given.command}")
    unknown = [name for name in given.only if name not in proof.PARTS]
    if unknown:
        raise SceneError(f"--only {unknown[0]}: {given.command} has {', '.join(proof.PARTS)}")
    backend.init("cpu", "f64", given.threads)
    return 0 if proof.report(given.only, given.out, given.json) else 1
