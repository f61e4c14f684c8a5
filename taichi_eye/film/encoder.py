"""Frames to files: an H.264 film written while the simulation runs, names of PNG frames, small GIFs.

A film is written in segments of raw H.264 (Annex B), which are joined and wrapped at the end without coding them again.
Every GROUP-th frame is coded for itself and at a constant quantiser, so what a frame looks like depends on the frames
since the last of these alone: a film that was stopped there and continued by another process has the frames of one
that was not. (A constant rate factor carries the history of the whole film into every frame.)
"""

import hashlib
import os
import queue
import secrets
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

from taichi_eye.errors import OutputError
from taichi_eye.report.folder import PART, replacing, settle

QUANTISER = 21  # sensor noise stays visible
PRESET = "ultrafast"  # noise makes every frame costly: half the time of "veryfast" for a file twice the size
GROUP = 10  # frames; groups of one would double the size of the file
THREADS = 2  # what a coded frame looks like depends on their number
QUEUED_FRAMES = 16  # that may wait for the encoder while the simulation goes on
PARAMETERS = 7  # NAL unit that opens each group
CHROMA = 40  # levels between the channels of a pixel that is coloured, in a GIF's palette
SMALL_BYTES = 1_000_000  # a film so small goes into a page as it is
SLIM_QUALITY, SLIM_DENOISE = 30, "hqdn3d=4:4:3:3"  # of a film within a page: without the sensor's grain, a fiftieth


class EncoderError(OutputError):
    """ffmpeg is missing, could not be started or gave up; carries the end of its log."""


def ffmpeg() -> str:
    """The program that writes films; EncoderError where there is none."""
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise EncoderError(f"ffmpeg, which writes the films, was not found ({error})") from None
    if shutil.which(program) is None:
        raise EncoderError(f"{program}: ffmpeg, which writes the films, cannot be run from there")
    return program


class FilmWriter:
    """Streams frames to an MP4 (H.264, yuv420p, index in front) that browsers play.

    Frames are uint8, [H, W] grey or [H, W, 3] RGB, all of the first one's shape; an odd size is padded by
    one pixel, nothing is rescaled. The film grows in segments and stands at `path`, whole, after `close`, also where
    the run stopped early: use it as a context manager. A film without frames leaves no file.

    work: a folder of the caller's in which the segments stay; without it they are hidden beside `path` and go with
    `close`. held: what `hold` returned to a film of the same work folder, which is to go on from there.

    Raises EncoderError where ffmpeg fails, ValueError where a frame's shape or type changes.
    """

    def __init__(self, path: str | Path, fps: float, work: Path | None = None, held: dict | None = None):
        self.path, self.fps, self.work = Path(path), fps, work
        self.frame_count = 0
        self._parts: list[Path] = []  # closed segments
        self._files: dict[str, list] = {}  # length and SHA-256 of what is held, by name
        self._segment: _Segment | None = None
        self._began = 0  # first frame of the last segment, one that begins a group
        self._shape: tuple[int, ...] | None = None
        self._group: list[np.ndarray] = []  # the last group's frames so far
        self._closed = False
        kept = {} if held is None else held["files"]
        if work is not None:
            for part in work.glob(f"{self.path.stem}-*"):  # written after that
                if part.name not in kept:
                    part.unlink()
        if held is not None:
            self._parts = [work / name for name in held["segments"]]
            self._files = dict(kept)
            self.frame_count = held["frames"]
            if held["group"] is not None:
                frames = np.load(work / held["group"], allow_pickle=False)
                self.frame_count -= len(frames)
                for frame in frames:
                    self.write(frame)

    def __enter__(self) -> "FilmWriter":
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close()

    @property
    def between_groups(self) -> bool:
        """Whether the next frame begins a group: `hold` then costs least."""
        return self.frame_count % GROUP == 0

    def write(self, frame: np.ndarray) -> None:
        """Append one frame. It is not copied: from here on it must not change."""
        if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
            raise ValueError(f"a frame is uint8 [H, W] or [H, W, 3], not {frame.dtype} {frame.shape}")
        if self._shape is not None and frame.shape != self._shape:
            raise ValueError(f"frame {self.frame_count} has shape {frame.shape}, the film {self._shape}")
        if self._segment is None:
            self._shape, self._began = frame.shape, self.frame_count
            self._segment = _Segment(self._new_part(".h264"), frame.shape, self.fps)
        if self.between_groups:
            self._group.clear()
        self._segment.write(frame)
        self._group.append(frame)
        self.frame_count += 1

    def hold(self) -> dict:
        """Close the segment and put on the disk what a film needs to go on from here; names and numbers for JSON.

        Under "files": length and SHA-256 of each that is needed.

        Within a group, whose frames depend on each other, its frames so far are kept as they are, for the film that
        goes on to code them anew; this one is then at its end.
        """
        self._end_segment()
        whole, group = list(self._parts), None
        if not self.between_groups:
            last, groups = whole.pop(), (self.frame_count - self._began) // GROUP
            if groups:
                whole.append(self._new_part(".h264"))
                with replacing(whole[-1]) as temporary:
                    temporary.write_bytes(first_groups(last.read_bytes(), groups))
            group = self._new_part(".npy")
            with replacing(group) as temporary:
                np.save(temporary, np.array(self._group))
        for part in [*whole, group] if group is not None else whole:
            if part.name not in self._files:
                settle(part)
                content = part.read_bytes()
                self._files[part.name] = [len(content), hashlib.sha256(content).hexdigest()]
        segments, group = [part.name for part in whole], None if group is None else group.name
        files = {name: self._files[name] for name in (*segments, group) if name is not None}
        return {"frames": self.frame_count, "segments": segments, "group": group, "files": files}

    def close(self) -> None:
        """Finish the film and put it at `path`; harmless when called again."""
        if self._closed:
            return
        self._closed = True
        try:
            self._end_segment()
            if self._parts:
                _join(self._parts, self.path, self.fps)
        finally:
            if self.work is None:
                for part in self._parts:
                    part.unlink(missing_ok=True)

    def _end_segment(self) -> None:
        segment, self._segment = self._segment, None
        if segment is not None:
            segment.end()
            self._parts.append(segment.path)

    def _new_part(self, suffix: str) -> Path:
        """A name that no other segment has, nor that of an encoder which a killed run left behind."""
        name = f"{self.path.stem}-{self.frame_count:06d}-{secrets.token_hex(4)}{suffix}"
        return self.path.with_name(PART + name) if self.work is None else self.work / name


class _Segment:
    """One run of the encoder: frames of one shape to a file of raw H.264."""

    def __init__(self, path: Path, shape: tuple[int, ...], fps: float):
        self.path, self._shape = path, shape
        self._queue: queue.Queue = queue.Queue(QUEUED_FRAMES)
        self._broken: OSError | None = None
        source = ["-f", "rawvideo", "-pix_fmt", "gray" if len(shape) == 2 else "rgb24"]
        source += ["-s", f"{shape[1] + shape[1] % 2}x{shape[0] + shape[0] % 2}", "-r", f"{fps:g}", "-i", "-"]
        # without accurate rounding grey comes back two levels too dark and tinted
        colour = [
            "-vf",
            "scale=out_color_matrix=bt709:out_range=tv:"
            "flags=bicubic+accurate_rnd+full_chroma_int,"
            "setparams=range=tv:color_primaries=bt709:color_trc=bt709:colorspace=bt709",
        ]
        coding = ["-an", "-c:v", "libx264", "-preset", PRESET, "-qp", f"{QUANTISER}", "-g", f"{GROUP}"]
        coding += ["-bf", "0", "-threads", f"{THREADS}", "-pix_fmt", "yuv420p", "-f", "h264"]
        self._log = tempfile.TemporaryFile()
        self._process = _started([*source, *colour, *coding, os.path.abspath(path)], self._log)
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()

    def write(self, frame: np.ndarray) -> None:
        """Hand over one frame; an odd size is padded."""
        if self._broken is not None:
            self._process.wait()
            raise EncoderError(f"the film encoder stopped: {_end_of(self._log)}") from self._broken
        odd = self._shape[0] % 2, self._shape[1] % 2
        if any(odd):
            frame = np.pad(frame, [(0, odd[0]), (0, odd[1])] + [(0, 0)] * (frame.ndim - 2), mode="edge")
        self._queue.put(np.ascontiguousarray(frame))

    def end(self) -> None:
        """Wait until the file holds every frame; a file that would not is removed."""
        self._queue.put(None)
        self._feeder.join()
        try:
            self._process.stdin.close()
        except OSError:
            pass  # ffmpeg went first; its exit status says why
        failed = self._process.wait() != 0 or self._broken is not None
        said = _end_of(self._log)
        self._log.close()
        if failed:
            self.path.unlink(missing_ok=True)
            raise EncoderError(f"the film encoder failed: {said}")

    def _feed(self) -> None:
        """Hand queued frames to ffmpeg until None comes; after a failure the queue is only emptied."""
        while (frame := self._queue.get()) is not None:
            if self._broken is None:
                try:
                    self._process.stdin.write(frame.data)
                except OSError as error:
                    self._broken = error


def first_groups(stream: bytes, groups: int) -> bytes:
    """The first so many groups of raw H.264, each of which begins with its parameters.

    A start code is 00 00 01, which stands nowhere else in the stream; the low five bits after it are the unit's type.
    """
    at = -1
    while (at := stream.find(b"\0\0\1", at + 1)) >= 0:
        if stream[at + 3] & 31 == PARAMETERS:
            if groups == 0:
                return stream[: at - (stream[at - 1] == 0)]
            groups -= 1
    return stream


def _join(parts: Sequence[Path], path: Path, fps: float) -> None:
    """Wrap segments, one after the other, into an MP4 at `path`, whole or not at all."""
    log = tempfile.TemporaryFile()
    with log, replacing(path) as temporary:
        source = ["-fflags", "+genpts", "-f", "h264", "-framerate", f"{fps:g}", "-i", "-"]
        target = ["-c", "copy", "-movflags", "+faststart", "-f", "mp4", os.path.abspath(temporary)]
        process = _started([*source, *target], log)
        try:
            for part in parts:
                with open(part, "rb") as stream:
                    shutil.copyfileobj(stream, process.stdin, 2**20)
            process.stdin.close()
        except BrokenPipeError:
            pass  # its exit status says why
        if process.wait() != 0:
            raise EncoderError(f"{path}: the film could not be put together: {_end_of(log)}")


def _started(arguments: list[str], log) -> subprocess.Popen:
    """ffmpeg, reading from a pipe.

    In a session of its own: a signal to the terminal's processes stops the run, which then closes the film in order.
    """
    return subprocess.Popen(
        [ffmpeg(), "-y", "-loglevel", "error", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=log,
        start_new_session=True,
    )


def _end_of(log) -> str:
    log.seek(0)
    return log.read().decode(errors="replace").strip()[-400:] or "no message"


def slim(path: Path) -> bytes:
    """A film's MP4 as a page carries it: as it is where it is small, else coded anew without the grain.

    Raises EncoderError where ffmpeg fails, OSError where the film cannot be read.
    """
    if path.stat().st_size <= SMALL_BYTES:
        return path.read_bytes()
    with tempfile.TemporaryDirectory(prefix="taichi_eye-film-") as folder, tempfile.TemporaryFile() as log:
        small = Path(folder) / "film.mp4"
        coding = ["-an", "-vf", SLIM_DENOISE, "-c:v", "libx264", "-preset", PRESET, "-crf", f"{SLIM_QUALITY}"]
        coding += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(small)]
        process = _started(["-i", os.path.abspath(path), *coding], log)
        process.stdin.close()
        if process.wait() != 0:
            raise EncoderError(f"{path}: could not be coded for the page ({_end_of(log)})")
        return small.read_bytes()


def frame_name(number: int, time_ms: float) -> str:
    """File name of one frame: "frame_040_09.26ms.png"; sorts by number."""
    return f"frame_{number:03d}_{time_ms:05.2f}ms.png"


def shrunk(frame: np.ndarray, width_px: int) -> np.ndarray:
    """A frame at most so wide, shrunk by area averaging, which also quietens noise, the enemy of a small file."""
    if width_px >= frame.shape[1]:
        return frame
    size = width_px, max(1, round(frame.shape[0] * width_px / frame.shape[1]))
    return np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.BOX))


def _palette(sample: np.ndarray, colours: int) -> Image.Image:
    """So many colours of a picture: an even ramp for pixels that are grey, and as many each for what is nearly grey and
    for what is coloured, of which there are few: the grain of the slit image would take all."""
    pixels = sample.reshape(-1, 3)
    chroma = np.ptp(pixels.astype(np.int16), axis=1)
    grey, coloured = pixels[chroma == 0], [pixels[chroma > CHROMA], pixels[(chroma > 0) & (chroma <= CHROMA)]]
    parts = [part for part in coloured if len(part)]
    share = colours // (len(parts) + (len(grey) > 0))
    table: list[int] = []
    if len(grey):
        table += np.repeat(np.linspace(0, int(grey.max()), share).round().astype(int), 3).tolist()
    for part in parts:
        table += Image.fromarray(part[None]).quantize(share, Image.Quantize.MEDIANCUT).getpalette()[: 3 * share]
    palette = Image.new("P", (1, 1))
    palette.putpalette(table)
    return palette


def write_gif(frames: Iterable[np.ndarray], path: str | Path, *, fps: float = 25.0, colours: int = 64) -> None:
    """A looping GIF of uint8 frames ([H, W] or [H, W, 3]), of one palette taken from a spread of them; whole or absent.

    GIF players round the frame time to 10 ms. Raises ValueError where there is no frame.
    """
    images = [Image.fromarray(frame).convert("RGB") for frame in frames]
    if not images:
        raise ValueError("a GIF needs at least one frame")
    palette = _palette(np.concatenate([np.asarray(image) for image in images[:: max(1, len(images) // 6)]]), colours)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    with replacing(Path(path)) as temporary:
        images[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            loop=0,
            duration=max(20, round(1000.0 / fps)),
            optimize=True,
        )
