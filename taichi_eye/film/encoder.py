"""Frames to files: an H.264 film written while the simulation runs, PNG sequences, small GIFs."""

import os
import queue
import subprocess
import tempfile
import threading
from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

QUALITY = 20  # constant rate factor: sensor noise stays visible
PRESET = "ultrafast"  # noise makes every frame costly: half the time of "veryfast" for a file twice the size
QUEUED_FRAMES = 16  # that may wait for the encoder while the simulation goes on


class EncoderError(Exception):
    """ffmpeg could not be started or gave up; carries the end of its log."""


class FilmWriter:
    """Streams frames to an MP4 (H.264, yuv420p, index in front) that browsers play.

    Frames are uint8, [H, W] grey or [H, W, 3] RGB, all of the first one's shape; an odd size is padded by
    one pixel, nothing is rescaled. The film grows under a temporary name beside `path` and moves there in
    `close`, so what stands at `path` is whole, also where the run stopped early: use it as a context
    manager. A film without frames leaves no file.

    Raises EncoderError where ffmpeg fails, ValueError where a frame's shape or type changes.
    """

    def __init__(self, path: str | Path, fps: float, png_dir: str | Path | None = None):
        self.path = Path(path)
        self.fps = fps
        self.png_dir = None if png_dir is None else Path(png_dir)
        self.frame_count = 0
        self._partial = self.path.with_name(f".{self.path.stem}.{os.getpid()}.part{self.path.suffix}")
        self._process = None
        self._log = None
        self._shape = None
        self._queue: queue.Queue = queue.Queue(QUEUED_FRAMES)
        self._feeder = None
        self._broken = None
        if self.png_dir is not None:
            self.png_dir.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> "FilmWriter":
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close()

    def write(self, frame: np.ndarray, time_ms: float) -> None:
        """Append one frame; with `png_dir` also as frame_040_09.26ms.png there (number from 0, its time).

        The frame is not copied: from here on it must not change.
        """
        if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
            raise ValueError(f"a frame is uint8 [H, W] or [H, W, 3], not {frame.dtype} {frame.shape}")
        if self._process is None:
            self._start(frame)
        if frame.shape != self._shape:
            raise ValueError(f"frame {self.frame_count} has shape {frame.shape}, the film {self._shape}")
        if self.png_dir is not None:
            Image.fromarray(frame).save(self.png_dir / frame_name(self.frame_count, time_ms))
        if self._broken is not None:
            self._process.wait()
            reason = f"the film encoder stopped at frame {self.frame_count}: {self._log_end()}"
            raise EncoderError(reason) from self._broken
        if frame.shape[0] % 2 or frame.shape[1] % 2:
            pad = [(0, frame.shape[0] % 2), (0, frame.shape[1] % 2)] + [(0, 0)] * (frame.ndim - 2)
            frame = np.pad(frame, pad, mode="edge")
        self._queue.put(np.ascontiguousarray(frame))
        self.frame_count += 1

    def _feed(self) -> None:
        """Hand queued frames to ffmpeg until None comes; after a failure the queue is only emptied."""
        while (frame := self._queue.get()) is not None:
            if self._broken is None:
                try:
                    self._process.stdin.write(frame.data)
                except OSError as error:
                    self._broken = error

    def close(self) -> None:
        """Finish the film and move it to `path`; harmless when called again."""
        if self._process is None:
            return
        self._queue.put(None)
        self._feeder.join()
        process, self._process = self._process, None
        try:
            process.stdin.close()
        except OSError:
            pass  # ffmpeg went first; its exit status says why
        failed = process.wait() != 0
        reason = self._log_end()
        self._log.close()
        if self._partial.exists() and self.frame_count and not failed:
            os.replace(self._partial, self.path)
        else:
            self._partial.unlink(missing_ok=True)
        if failed:
            raise EncoderError(f"the film encoder failed: {reason}")

    def _start(self, frame: np.ndarray) -> None:
        self._shape = frame.shape
        size = f"{frame.shape[1] + frame.shape[1] % 2}x{frame.shape[0] + frame.shape[0] % 2}"
        source = [
            "-f",
            "rawvideo",
            "-pix_fmt",
            "gray" if frame.ndim == 2 else "rgb24",
            "-s",
            size,
            "-r",
            f"{self.fps:g}",
            "-i",
            "-",
        ]
        # without accurate rounding grey comes back two levels too dark and tinted
        colour = [
            "-vf",
            "scale=out_color_matrix=bt709:out_range=tv:"
            "flags=bicubic+accurate_rnd+full_chroma_int,"
            "setparams=range=tv:color_primaries=bt709:color_trc=bt709:colorspace=bt709",
        ]
        target = [
            "-an",
            "-c:v",
            "libx264",
            "-preset",
            PRESET,
            "-crf",
            str(QUALITY),
            "-pix_fmt",
            "yuv420p",
            "-movflags",
            "+faststart",
            str(self._partial),
        ]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, *colour, *target]
        self._log = tempfile.TemporaryFile()
        # a session of its own: Ctrl-C stops the run, which then closes the film in order
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._log, start_new_session=True
        )
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()

    def _log_end(self) -> str:
        self._log.seek(0)
        return self._log.read().decode(errors="replace").strip()[-400:] or "no message"


def frame_name(number: int, time_ms: float) -> str:
    """File name of one frame: "frame_040_09.26ms.png"; sorts by number."""
    return f"frame_{number:03d}_{time_ms:05.2f}ms.png"


def write_gif(
    frames: Iterable[np.ndarray], path: str | Path, *, fps: float = 25.0, width_px: int | None = None, colours: int = 64
) -> None:
    """A looping GIF of uint8 frames ([H, W] or [H, W, 3]), of one palette taken from a spread of them.

    `width_px` shrinks by area averaging, which also quietens noise, the enemy of a small file; GIF players
    round the frame time to 10 ms. Raises ValueError where there is no frame.
    """
    images = [Image.fromarray(frame).convert("RGB") for frame in frames]
    if not images:
        raise ValueError("a GIF needs at least one frame")
    if width_px is not None and width_px < images[0].width:
        size = (width_px, max(1, round(images[0].height * width_px / images[0].width)))
        images = [image.resize(size, Image.Resampling.BOX) for image in images]
    sample = images[:: max(1, len(images) // 6)]
    strip = Image.new("RGB", (images[0].width, images[0].height * len(sample)))
    for k, image in enumerate(sample):
        strip.paste(image, (0, k * image.height))
    palette = strip.quantize(colours, dither=Image.Dither.NONE)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    images[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=images[1:],
        loop=0,
        duration=max(20, round(1000.0 / fps)),
        optimize=True,
    )
