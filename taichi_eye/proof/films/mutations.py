"""Damaged input at random: films, folders of images, run folders and option values, mutated and put to `analyze`.

Bytes flipped, zeroed and cut off, files of other kinds, other types and sizes, wrong tables, options at the ends of
what a number can be; and pictures of anything but a cornea. Asked: a result or one line of refusal, each within 30 s,
and no parameters where there is no cornea. The films are short, every twelfth frame, so that thousands can be read.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from taichi_eye.analysis import analyze
from taichi_eye.bench.rows import Row, at_most, figure, skipped
from taichi_eye.errors import FilmError, SceneError
from taichi_eye.film import FilmWriter, frame_name
from taichi_eye.proof.films.eyes import EYES, TIMES_MS, walls_mm
from taichi_eye.proof.films.made_up import Look, draw, stamped
from taichi_eye.report.traces import COLUMNS, write_traces, write_wall

INPUTS, SEED = 2000, 77
EVERY = 12  # frames
SECONDS, MEGABYTES = 30.0, 2000.0
OPTIONS = ("pixel_x_mm", "pixel_y_mm", "frame_interval_ms", "angle_deg", "refractive_index", "biop_mmhg", "age_years")
EXTREMES = (
    0.0,
    -1.0,
    1e-300,
    1e-6,
    1e-3,
    0.0156,
    0.2315,
    1.0,
    1.376,
    45.0,
    720.0,
    999999.0,
    1e300,
    float("inf"),
    float("nan"),
)


class Source:
    """A good film, folder and run to be mutated, in a folder of their own."""

    def __init__(self, folder: Path):
        self.film, self.images, self.run = folder / "eye.mp4", folder / "images", folder / "run"
        eye, times = EYES[0], TIMES_MS[::EVERY]
        frames = draw(eye, Look(), 540.0, 1, slice(None, None, EVERY))
        stamped(frames, times)
        for target in (self.images, self.run):
            target.mkdir()
        with FilmWriter(self.film, 25) as film:
            for k, (frame, when) in enumerate(zip(frames, times)):
                film.write(frame)
                Image.fromarray(frame).save(self.images / frame_name(EVERY * k, when))
        shutil.copy(self.film, self.run / "film.mp4")
        scene = 'camera.view = "scheimpflug"\n'
        (self.run / "scene.toml").write_text(scene + f"camera.frame_interval_ms = {EVERY * 0.2315}\n", encoding="utf-8")
        write_wall(self.run / "wall.npz", times, walls_mm(eye, eye.scene())[::EVERY])
        columns = {name: np.zeros(len(times)) for name in COLUMNS} | {"time_ms": times}
        write_traces(self.run / "traces.csv", columns)


def harmed(data: bytes, random: np.random.Generator) -> bytes:
    """A file's bytes flipped, zeroed, cut off, doubled or replaced."""
    way, held = random.integers(6), bytearray(data)
    place = int(random.integers(max(len(held), 1)))
    if way == 0:
        for _ in range(int(random.integers(1, 40))):
            held[int(random.integers(len(held)))] ^= 1 << int(random.integers(8))
    elif way == 1:
        held[place : place + len(held) // 2] = bytes(len(held[place : place + len(held) // 2]))
    elif way == 2:
        del held[place:]
    elif way == 3:
        held[place:place] = random.bytes(int(random.integers(1, 300)))
    elif way == 4:
        held = bytearray(random.bytes(int(random.integers(0, 2000))))
    else:
        held += held[place:]
    return bytes(held)


def harmed_film(source: Source, folder: Path, random: np.random.Generator) -> tuple[Path, dict, bool]:
    """A damaged film."""
    path = folder / str(
        random.choice(["eye.mp4", "eye.avi", "eye.png", "eye.tif", "eye.cst", "eye.webp"], p=[0.7] + 5 * [0.06])
    )
    path.write_bytes(harmed(source.film.read_bytes(), random))
    return path, {}, True


def harmed_folder(source: Source, folder: Path, random: np.random.Generator) -> tuple[Path, dict, bool]:
    """A folder with damaged, doubled, renamed, resized or retyped images."""
    path = folder / "images"
    shutil.copytree(source.images, path)
    files = sorted(path.iterdir())
    for file in random.choice(files, int(random.integers(1, 6)), replace=False):
        way = random.integers(7)
        if way < 2:
            file.write_bytes(harmed(file.read_bytes(), random))
        elif way == 2:
            shutil.copy(file, path / f"{file.stem} ({random.integers(1, 9)}).png")
        elif way == 3:
            file.rename(
                path
                / random.choice(
                    ["\u00b21.png", "x" * 200 + ".png", "._1.png", "a\nb.png", "9" * 200 + ".png", "-1.png"]
                )
            )
        elif way == 4:
            Image.open(file).resize((int(random.integers(1, 900)), int(random.integers(1, 300)))).save(file)
        elif way == 5:
            level = np.asarray(Image.open(file)).astype(random.choice(["uint16", "float32", "int32"]))
            file.unlink()
            Image.fromarray(level * level.dtype.type(random.choice([1, 4, 257]))).save(file.with_suffix(".tif"))
        else:
            Image.open(file).convert(str(random.choice(["RGB", "RGBA", "P", "1", "LA", "CMYK"]))).save(
                file.with_suffix(".tif")
            )
            file.unlink()
    return path, {}, True


def harmed_run(source: Source, folder: Path, random: np.random.Generator) -> tuple[Path, dict, bool]:
    """A run folder with a damaged file."""
    path = folder / "run"
    shutil.copytree(source.run, path)
    name = str(random.choice(["wall.npz", "traces.csv", "scene.toml", "film.mp4"]))
    way = random.integers(4)
    if way == 0 and name == "wall.npz":
        with np.load(path / name) as held:
            wall = dict(held)
        key = str(random.choice(list(wall)))
        wall[key] = [
            wall[key] * np.nan,
            wall[key][:-1],
            wall[key].astype(object),
            wall[key].astype(str),
            np.zeros(0),
            1e300 + wall[key],
        ][int(random.integers(6))]
        if random.random() < 0.3:
            del wall[key]
        np.savez(path / name, **wall)
    elif way == 0 and name == "traces.csv":
        lines = (path / name).read_text(encoding="utf-8").splitlines()
        lines[int(random.integers(len(lines)))] = str(
            random.choice(["", "one,two", "nan," * 18 + "nan", "\x00", "1e999," * 19])
        )
        (path / name).write_text("\n".join(lines[: int(random.integers(len(lines) + 1))]), encoding="utf-8")
    elif way == 1 and name == "scene.toml":
        key, value = (
            random.choice(["width_px", "height_px", "pixel_x_mm", "angle_deg"]),
            random.choice([1, 64, 577, 1000]),
        )
        (path / name).write_text(f'camera.view = "scheimpflug"\ncamera.{key} = {value}\n', encoding="utf-8")
    elif way == 2:
        (path / name).unlink()
    else:
        (path / name).write_bytes(harmed((path / name).read_bytes(), random))
    return path, {}, True


def odd_options(source: Source, folder: Path, random: np.random.Generator) -> tuple[Path, dict, bool]:
    """A good folder with one or two options at extremes."""
    names = random.choice(OPTIONS, int(random.integers(1, 3)), replace=False)
    return source.images, {str(name): float(random.choice(EXTREMES)) for name in names}, True


def no_cornea(source: Source, folder: Path, random: np.random.Generator) -> tuple[Path, dict, bool]:
    """Frames of something else: a band of another shape that moves, noise, black, or a cornea upside down."""
    count, way = 1 + 138 // EVERY, random.integers(6)
    x, rows = np.linspace(-4.5, 4.5, 576), np.arange(200)[:, None]
    dent = np.exp(-(((TIMES_MS[::EVERY] - 16.0) / 5.0) ** 2)) * random.uniform(10, 70)
    shape = (
        [0.0 * x, random.uniform(-12, 12) * x, 15.0 * np.sin(x * random.uniform(1, 4)), 25.0 * np.abs(x), -4.0 * x**2]
    )[min(way, 4)]
    random_level = random.integers(0, int(random.integers(2, 256)), (count, 200, 576))
    for k in range(count):
        below = rows - (60.0 + shape + dent[k] - min(shape.min(), 0.0) * (way == 4))
        level = 7.0 + 50.0 * ((below > 0) & (below < random.uniform(5, 30))) + random.normal(0.0, 3.0, below.shape)
        level = random_level[k] if way == 5 else level
        Image.fromarray(np.clip(level, 0, 255).astype(np.uint8)).save(
            folder / frame_name(EVERY * k, TIMES_MS[EVERY * k])
        )
    return folder, {}, False


KINDS: dict[str, Callable] = {
    "films": harmed_film,
    "folders": harmed_folder,
    "run folders": harmed_run,
    "options": odd_options,
    "no cornea": no_cornea,
}


def measure(stage, inputs: int = INPUTS, seed: int = SEED) -> tuple[list[Row], list[Figure]]:
    """Put so many inputs to `analyze`, each kind as often."""
    random = np.random.default_rng(seed)
    broken, seen_where_none, slowest, refused = [], 0, (0.0, ""), 0
    with tempfile.TemporaryDirectory() as held:
        (Path(held) / "source").mkdir()
        source = Source(Path(held) / "source")
        for k in range(inputs):
            name = list(KINDS)[k % len(KINDS)]
            stage(f"{name}, {k + 1} of {inputs}")
            with tempfile.TemporaryDirectory() as folder:
                path, options, cornea = KINDS[name](source, Path(folder), random)
                start = time.perf_counter()
                try:
                    result = analyze(path, write=False, **options)
                    seen_where_none += not cornea and result.response.deformation_amplitude_mm is not None
                except (FilmError, SceneError) as error:
                    refused += 1
                    if len(str(error).splitlines()) > 3:
                        broken.append(f"{name}, input {k}: a refusal of many lines")
                except Exception as error:  # what this study looks for
                    broken.append(f"{name}, input {k}: {type(error).__name__}: {error}")
                slowest = max(slowest, (time.perf_counter() - start, f"{name}, input {k}"))
    memory = "largest memory of a process"
    try:
        import resource  # not on Windows

        peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1e3
        held = at_most(memory, peak, "MB", MEGABYTES)
    except ImportError:
        held = skipped(memory, "this system does not tell it", f"<= {MEGABYTES:g}")
    return [
        at_most(
            "tracebacks", len(broken), "inputs", 0, "; ".join(broken[:3])[:300] or f"{inputs} inputs, {refused} refused"
        ),
        at_most("parameters where there is no cornea", seen_where_none, "inputs", 0),
        at_most("slowest input", slowest[0], "s", SECONDS, slowest[1]),
        held,
        figure("refused", refused, "inputs"),
    ], []
