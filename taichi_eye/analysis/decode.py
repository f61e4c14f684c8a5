"""Grey pictures out of image files and films, in bounded memory and time.

Shape and count are read from headers, and refused there, before a pixel is decoded; each picture is brought to the
shape asked for as soon as it is decoded. Orientation in the files' own metadata is honoured: EXIF in images, the
display matrix in films. Frames of a film pass as they are: none is repeated or dropped to even out its rate.
Images of more than eight bits keep their range: they are scaled by the bits that the whole film uses (10, 12 or 16),
floats by 1 or 255. Raises FilmError that names the file; what the decoders say stands in the message or in the notes.
"""

from __future__ import annotations

import os
import re
import stat
import subprocess
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image, ImageOps

from taichi_eye.errors import FilmError

IMAGES = ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"
FRAMES_MIN, FRAMES_MAX = 8, 1000
PIXELS_MAX = 4_000_000  # of a frame
ALL_PIXELS_MAX = 1_500_000_000  # of a film, as decoded
DECODE_SECONDS = 25.0
ALIKE_MIN = 0.8  # share of a folder's images that must have one size
TALL_BITS = 8, 10, 12, 16
COLOURED, HUE_SHARE = 60, 0.004  # spread of the channels of a coloured pixel; share of a picture in each of two hues


@dataclass(frozen=True)
class Pictures:
    """Frames uint8 [frames, rows, columns]; names: the stem of each one's file, or empty for a film; notes."""

    frames: np.ndarray
    names: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Wanted:
    """What to make of a picture: its upper left `part` (columns, rows), brought to `size` (columns, rows).

    coloured: whether it may be in colours.
    """

    part: tuple[int, int]
    size: tuple[int, int]
    coloured: bool = False

    def of(self, grey: np.ndarray) -> np.ndarray:
        """The part of a grey picture, in the size wanted."""
        grey = grey[: self.part[1], : self.part[0]]
        if grey.shape == self.size[::-1]:
            return grey
        whole = all(a % b == 0 for a, b in zip(self.part, self.size))
        way = Image.Resampling.BOX if whole else Image.Resampling.BICUBIC
        return np.asarray(Image.fromarray(grey).resize(self.size, way))


# what to make of pictures of so many columns and rows; FilmError where they will not do
Shape = Callable[[int, int], Wanted]
COMPOSITE = (
    "this is in colours, not the instrument's slit frames; of a run that filmed both views, analyse the run folder"
)


def decode(path: Path, shape: Shape) -> Pictures:
    """The pictures of a folder of images, of an image of many pages, or of a film."""
    if kind(path) == "folder":
        return _folder(path, shape)
    if path.suffix.lower() in IMAGES:
        return _pages(path, shape)
    return _film(path, shape)


def kind(path: Path) -> str:
    """ "folder" or "file"; FilmError for what is neither, or cannot be looked at."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise FilmError(f"{path}: there is no such file or folder") from None
    except (OSError, ValueError) as error:
        name = str(path)
        reason = getattr(error, "strerror", None) or str(error)
        raise FilmError(f"{name[:200]}{'...' if len(name) > 200 else ''}: cannot be opened ({reason})") from None
    if stat.S_ISDIR(mode):
        return "folder"
    if not stat.S_ISREG(mode):
        raise FilmError(f"{path}: is a pipe or a device, not a file")
    if path.suffix.lower() == ".cst":
        raise FilmError(
            f"{path}: the instrument's own container cannot be read; export the examination there as a film "
            "(.avi, .mp4) or as images and name that"
        )
    return "file"


def natural(name: str) -> list:
    """Key that sorts names with their numbers by value."""
    return [int(part) if part.isdecimal() else part.lower() for part in re.split(r"([0-9]+)", name)]


def _folder(path: Path, shape: Shape) -> Pictures:
    try:
        found = [Path(entry.path) for entry in os.scandir(path) if Path(entry.name).suffix.lower() in IMAGES]
    except OSError as error:
        raise FilmError(f"{path}: cannot be read ({error.strerror})") from None
    files = sorted((file for file in found if not file.name.startswith(".")), key=lambda file: natural(file.name))
    notes = [f"{len(found) - len(files)} hidden files skipped"] if len(files) < len(found) else []
    if not files:
        raise FilmError(f"{path}: the folder holds no images ({', '.join(IMAGES)})")
    _count(path, len(files))
    for file in files:
        if not file.is_file():
            raise FilmError(f"{file}: is a pipe, a device or a folder, not an image")
    sizes = [_header(file) for file in files]
    kinds = sorted(set(sizes), key=sizes.count)
    usual = kinds[-1]
    if sizes.count(usual) < ALIKE_MIN * len(sizes):
        raise FilmError(
            f"{path}: images of many sizes, such as {usual[0]} x {usual[1]} and {kinds[-2][0]} x {kinds[-2][1]}"
        )
    kept = [file for file, size in zip(files, sizes) if size == usual]
    if len(kept) < len(files):
        odd = next(file for file, size in zip(files, sizes) if size != usual)
        notes.append(f"{len(files) - len(kept)} images of another size left out, such as {odd.name}")
    _count(path, len(kept))

    def pictures():
        for file in kept:
            with _opened(file) as image:
                yield file, image

    return _gathered(path, pictures, len(kept), usual, shape, tuple(file.stem for file in kept), notes)


def _pages(path: Path, shape: Shape) -> Pictures:
    size = _header(path)
    with _opened(path) as image:
        count = _guarded(path, lambda: getattr(image, "n_frames", 1))
    if count == 1:
        raise FilmError(f"{path}: one image is no film; name the folder that holds them all")
    _count(path, count, "pages")

    def pictures():
        with _opened(path) as image:
            for page in range(count):
                _guarded(path, lambda: image.seek(page))
                if image.size != size:
                    raise FilmError(f"{path}: page {page + 1} has another size than the first")
                yield path, image

    return _gathered(path, pictures, count, size, shape, (), [])


def _count(path: Path, count: int, what: str = "images") -> None:
    if count < FRAMES_MIN:
        raise FilmError(f"{path}: {count} {what}; at least {FRAMES_MIN} are needed")
    if count > FRAMES_MAX:
        raise FilmError(f"{path}: {count} {what}; at most {FRAMES_MAX} are read")


def _guarded(file: Path, do: Callable):
    """What `do` returns; whatever the image library raises on a damaged file, as a FilmError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return do()
    except MemoryError:
        raise FilmError(f"{file}: asks for more memory than there is") from None
    except Exception as error:  # the library's readers raise whatever a damaged file leads them to
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise FilmError(f"{file}: not an image that can be read ({said})") from None


def _opened(file: Path) -> Image.Image:
    return _guarded(file, lambda: Image.open(file))


def _header(file: Path) -> tuple[int, int]:
    """Columns and rows as the file's metadata turn them."""
    with _opened(file) as image:
        columns, rows = image.size
        if columns * rows > PIXELS_MAX:
            raise FilmError(f"{file}: {columns} x {rows} px; at most {PIXELS_MAX / 1e6:g} million are read")
        turned = _guarded(file, lambda: image.getexif().get(0x0112, 1))
    return (rows, columns) if turned in (5, 6, 7, 8) else (columns, rows)


def _gathered(path, pictures: Callable[[], Iterator], count, size, shape: Shape, names, notes) -> Pictures:
    _refuse_vast(path, count, size)
    wanted = shape(*size)
    white = _white(pictures)
    frames = np.empty((count, wanted.size[1], wanted.size[0]), np.uint8)
    for k, (file, image) in enumerate(pictures()):
        level = _guarded(file, lambda: _upright(image, white))
        if k == 0 and level.ndim == 3 and not wanted.coloured and in_colours(level):
            raise FilmError(f"{path}: {COMPOSITE}")
        frames[k] = wanted.of(flattened(level) if level.ndim == 3 else level)
    return Pictures(frames, names, tuple(notes))


def _refuse_vast(path, count: int, size: tuple[int, int]) -> None:
    if count * size[0] * size[1] > ALL_PIXELS_MAX:
        raise FilmError(
            f"{path}: {count} frames of {size[0]} x {size[1]} px; at most {ALL_PIXELS_MAX / 1e9:g} thousand million "
            "pixels in all are read"
        )


def _white(pictures: Callable[[], Iterator]) -> float:
    """The level that white has in the images of more than eight bits; 0 where there are none."""
    top = 0.0
    for file, image in pictures():
        if image.mode not in ("I", "F") and not image.mode.startswith("I;16"):
            return 0.0
        level = np.asarray(_guarded(file, lambda: np.asarray(image)), dtype=float)
        if not np.isfinite(level).all() or level.min() < 0.0:
            raise FilmError(f"{file}: has grey levels that are negative or no numbers")
        top = max(top, float(level.max()))
        fine = image.mode == "F" and top <= 1.0
    if fine:
        return 1.0
    for bits in TALL_BITS:
        if top < 2.0**bits:
            return 2.0**bits - 1.0
    raise FilmError(f"{file}: grey levels reach {top:g}; at most {2**16 - 1} are read")


def _upright(image: Image.Image, white: float) -> np.ndarray:
    """An image as its metadata turn it, uint8: RGB [rows, columns, 3], or grey where its white is given."""
    if not white:
        return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    level = np.asarray(ImageOps.exif_transpose(image), dtype=np.float32)
    return np.rint(np.clip(level * np.float32(255.0 / white), 0.0, 255.0)).astype(np.uint8)


def flattened(image: np.ndarray) -> np.ndarray:
    """RGB [rows, columns, 3] to grey, rounded."""
    return ((image.astype(np.uint16).sum(axis=2) + 1) // 3).astype(np.uint8)


def in_colours(image: np.ndarray) -> bool:
    """Whether a picture, RGB [rows, columns, 3], holds more than one colour; a slit frame may be tinted by one."""
    image = image.astype(np.int16)
    vivid = image.max(axis=2) - image.min(axis=2) > COLOURED
    share = np.bincount(image.argmax(axis=2)[vivid], minlength=3) / vivid.size
    return bool((share > HUE_SHARE).sum() > 1)


def _film(path: Path, shape: Shape) -> Pictures:
    """Frames of a film by ffmpeg: the size from its header, then one portable pixmap after the other."""
    program = _ffmpeg(path)
    source = ["-nostdin", "-hide_banner", "-protocol_whitelist", "file", "-i", f"file:{os.path.abspath(path)}"]
    try:
        told = subprocess.run([program, *source], capture_output=True, timeout=DECODE_SECONDS).stderr
    except (OSError, subprocess.TimeoutExpired):
        raise FilmError(f"{path}: not a film that can be decoded (its header cannot be read)") from None
    told = told.decode(errors="replace")
    match = re.search(r"Stream #.*Video:.*?[ ,](\d{1,6})x(\d{1,6})[ ,\[]", told)
    if not match:
        raise FilmError(f"{path}: not a film that can be decoded ({_said(told)})")
    if int(match[1]) * int(match[2]) > PIXELS_MAX:
        raise FilmError(f"{path}: frames of {match[1]} x {match[2]} px; at most {PIXELS_MAX / 1e6:g} million are read")
    command = [program, "-loglevel", "error", *source, "-map", "0:v:0", "-an", "-sn", "-fps_mode", "passthrough"]
    command += ["-frames:v", str(FRAMES_MAX + 1), "-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log)
        late = threading.Timer(DECODE_SECONDS, process.kill)
        late.start()
        try:
            frames = _pixmaps(path, process.stdout, shape)
        finally:
            in_time = late.is_alive()
            late.cancel()
            process.kill()
            process.stdout.close()
            process.wait()
        log.seek(0)
        told = log.read(1 << 16).decode(errors="replace").splitlines()
        errors = [line for line in told if line.strip() and "Last message repeated" not in line]
    if not in_time:
        raise FilmError(f"{path}: takes more than {DECODE_SECONDS:g} s to decode")
    if len(frames) < FRAMES_MIN:
        said = f" ({_said(errors)})" if errors else ""
        raise FilmError(f"{path}: {len(frames)} frames could be decoded{said}; at least {FRAMES_MIN} are needed")
    notes = [f"the decoder met {len(errors)} errors, such as: {_said(errors)}"] if errors else []
    return Pictures(np.stack(frames), (), tuple(notes))


def _ffmpeg(path: Path) -> str:
    try:
        return imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        raise FilmError(f"{path}: there is no ffmpeg to decode it with; name a folder of images") from None


def _said(lines: str | list[str]) -> str:
    """The last thing that ffmpeg said, without addresses of its memory."""
    lines = lines.splitlines() if isinstance(lines, str) else lines
    last = next(
        (line for line in reversed(lines) if line.strip() and "At least one output file" not in line), "no frames"
    )
    return re.sub(r"\[?[\w:#/]* ?@ 0x[0-9a-f]+\]?|file:\S*/", "", last).strip()[:160]


def _pixmaps(path: Path, stream, shape: Shape) -> list[np.ndarray]:
    """Grey frames of a stream of portable pixmaps."""
    frames: list[np.ndarray] = []
    size = wanted = None
    while True:
        header = [stream.readline(64) for _ in range(3)]
        if header[0] != b"P6\n":
            return frames
        here = tuple(int(word) for word in header[1].split())
        raw = stream.read(3 * here[0] * here[1])
        if len(raw) < 3 * here[0] * here[1]:
            return frames
        image = np.frombuffer(raw, np.uint8).reshape(here[1], here[0], 3)
        if size is None:
            size, wanted = here, shape(*here)
            if not wanted.coloured and in_colours(image):
                raise FilmError(f"{path}: {COMPOSITE}")
        elif here != size:
            raise FilmError(
                f"{path}: the size changes within the film, from {size[0]} x {size[1]} to {here[0]} x {here[1]}"
            )
        if len(frames) == FRAMES_MAX:
            raise FilmError(f"{path}: more than {FRAMES_MAX} frames")
        _refuse_vast(path, len(frames) + 1, size)
        frames.append(wanted.of(flattened(image)))
