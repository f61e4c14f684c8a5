"""Runs in processes of their own that are cut off and resumed, and what they must leave in the end."""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import imageio_ffmpeg
import numpy as np

ROOT = Path(__file__).parents[2]
SMALL = {
    "numerics.spacing_mm": 0.4,
    "numerics.sound_speed_m_s": 20,
    "numerics.duration_ms": 8,
    "camera.width_px": 192,
    "camera.height_px": 96,
    "camera.apex_column_px": 96,
    "camera.pixel_x_mm": 0.05,
    "camera.pixel_y_mm": 0.04,
    "output.checkpoint_s": 0,
}
# every rung, view and sink once; the slow ones, of meshio and of large pictures, where the solver is quick
CASES = {
    "cavity": {"numerics.fidelity": "cavity", "camera.view": "both", "output.gif": "true"},
    "mfpm": {
        "numerics.fidelity": "mfpm",
        "camera.view": "scheimpflug",
        "output.png_frames": "true",
        "numerics.error_bar": "true",
    },
    "added_mass": {"numerics.fidelity": "added_mass", "camera.view": "particles", "output.gif": "true"},
    "membrane": {
        "numerics.fidelity": "membrane",
        "camera.view": "scheimpflug",
        "output.node_fields": "true",
        "output.png_frames": "true",
    },
    "auto": {"numerics.fidelity": "auto", "numerics.tolerance_percent": 10, "camera.view": "scheimpflug"},
}
PATIENCE_S = 300


def started(*words) -> subprocess.Popen:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "taichi_eye", "run", *map(str, words), "--quiet", "--threads", "1"],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": path},
        preexec_fn=heeding,
    )


def heeding() -> None:
    """Take signals as a shell's foreground does, also where these tests run in the background (`nohup`, `&`)."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def begun(case: str, folder: Path) -> subprocess.Popen:
    """A run of a case into a folder, from the moment on that it can be resumed."""
    words = [word for key, value in (SMALL | CASES[case]).items() for word in ("--set", f"{key}={value}")]
    process, sign = started(*words, "--out", folder), folder / ".run" / "run.json"
    until = time.monotonic() + PATIENCE_S
    while not sign.exists() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.002)
    return process


def resumed(folder: Path) -> subprocess.Popen:
    return started("--resume", folder)


def ended(process, status: int = 0) -> str:
    """What a run said, once it has ended as it should."""
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status, f"status {process.returncode}, not {status}: {out}{err}"
    assert "Traceback" not in err, err
    return out + err


def files(folder: Path) -> list[Path]:
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


class Reference:
    """A run of a case that was never cut off; seconds: from the moment that it could be resumed to its end."""

    def __init__(self, case: str, folder: Path):
        self.case, self.folder = case, folder
        process = begun(case, folder)
        before = time.monotonic()
        ended(process)
        self.seconds = time.monotonic() - before
        assert not (folder / ".run").exists()

    def whole_so_far(self, folder: Path) -> None:
        """Whatever stands under its final name in a run that was killed is whole, and what it will be in the end."""
        for path in folder.rglob("*"):
            inside = path.relative_to(folder)
            if path.is_dir() or any(part.startswith(".") for part in inside.parts):
                continue
            if path.name == "summary.json":
                assert json.loads(path.read_text())["status"] == "complete"
            elif path.name == "report.html":  # tells of the day and the time that it took
                assert path.read_text().endswith("</html>\n")
            elif path.name == "film.mp4":
                np.testing.assert_array_equal(film(path), self.film)
            elif path.name == "fields.pvd":
                assert all(
                    (path.parent / name).exists() for name in path.read_text().split('"') if name.endswith(".vtu")
                )
            else:
                assert path.read_bytes() == (self.folder / inside).read_bytes(), inside

    def same(self, folder: Path) -> None:
        """A run that was cut off and resumed left what this one left."""
        assert files(folder) == files(self.folder)
        assert not (folder / ".run").exists()
        self.whole_so_far(folder)
        for name in ("fields/fields.pvd", "scene.toml"):
            if (self.folder / name).exists():
                assert (folder / name).read_bytes() == (self.folder / name).read_bytes()

    @property
    def film(self) -> np.ndarray:
        return film(self.folder / "film.mp4")


@cache
def _film(path: Path, changed: int) -> np.ndarray:
    frames = imageio_ffmpeg.read_frames(str(path))
    next(frames)
    return np.stack([np.frombuffer(frame, np.uint8) for frame in frames])


def film(path: Path) -> np.ndarray:
    """Decoded frames [frames, bytes]."""
    return _film(path, path.stat().st_mtime_ns)


def kill_and_resume(reference: Reference, folder: Path, draw: random.Random) -> int:
    """Kill a run at random moments, itself and some of its resumptions, until one ends; how often it was killed."""
    kills, process = 0, begun(reference.case, folder)
    while True:
        since = time.monotonic()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(draw.uniform(0.0, 1.1 * reference.seconds))
        if kills and draw.random() < 0.7:
            ended(process)
            break
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=PATIENCE_S)
        if process.returncode == 0:
            # it was through before: what it was timed by compiled its kernels, or ran on a busier machine
            if kills:
                break
            reference.seconds = min(reference.seconds, time.monotonic() - since)
            shutil.rmtree(folder)
            process = begun(reference.case, folder)
            continue
        kills += 1
        reference.whole_so_far(folder)
        process = resumed(folder)
    reference.same(folder)
    return kills
