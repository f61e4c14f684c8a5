"""The hidden folder of a run that is under way, and the checkpoint in it.

    .run/run.json      what was begun: the scene, how, by which program; from it on, the run can be resumed
    .run/checkpoint    the state of the simulation, and what the observers held at that moment
    .run/...           logs and film segments that the checkpoint counts on; what goes beyond it is dropped

What an observer held may name such files under "files": each with the length and the SHA-256 of what counts. A
checkpoint replaces the one before it once everything it counts on is on the disk. Its first line names its kind, its
second is the SHA-256 of the rest: arrays as NumPy's .npz, without pickles, among them a header in JSON. Whoever resumes
has to be the same program with the same scene: bits could differ otherwise, and half a run of each would be neither.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import weakref
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import taichi_eye
from taichi_eye.errors import SceneError
from taichi_eye.lang import NAME, ti
from taichi_eye.report.folder import MANIFEST, WORK, replacing, settle, write_text
from taichi_eye.scene import Scene, dump_scene

KIND = b"taichi_eye checkpoint 1\n"
CHECKPOINT = "checkpoint"
ANEW = "start the scene anew in another folder"


@cache
def program() -> str:
    """What computes: version and sources of this package, and the kernel language's version."""
    digest = hashlib.sha256()
    root = Path(taichi_eye.__file__).parent
    for source in sorted(root.rglob("*.py")):
        digest.update(f"{source.relative_to(root).as_posix()}\0".encode())
        digest.update(source.read_bytes())
    return f"taichi_eye {taichi_eye.__version__} ({digest.hexdigest()[:16]}), {NAME} {ti.__version__}"


def fingerprint(scene: Scene) -> str:
    """Digest of a scene, its puff's file included."""
    digest = hashlib.sha256(dump_scene(scene).encode())
    if scene.puff.time_course == "file":
        try:
            digest.update(Path(scene.puff.file).read_bytes())
        except OSError as error:
            raise SceneError(f"{scene.puff.file}: cannot be read ({error.strerror})") from None
    return digest.hexdigest()


class WorkRoom:
    """The hidden work folder of the run in `folder`."""

    def __init__(self, folder: Path):
        self.folder, self.path, self._gone = folder, folder / WORK, folder / f"{WORK}-gone"

    def begin(self, manifest: Mapping[str, Any]) -> None:
        """Make the folder; from the end of this on, the run can be resumed."""
        self.path.mkdir()
        text = json.dumps(manifest)
        write_text(self.path / MANIFEST, f"{text}\n{_sha256(text.encode())}\n", durable=True)
        settle(self.folder)

    def manifest(self) -> dict[str, Any]:
        """What `begin` was given; SceneError where that cannot be read, or was begun by another program."""
        path = self.path / MANIFEST
        try:
            text, _, checksum = path.read_bytes().partition(b"\n")
        except FileNotFoundError:
            raise SceneError(f"{self.folder}: holds no run that could be resumed ({path} is missing)") from None
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
        if checksum != f"{_sha256(text)}\n".encode():
            raise SceneError(f"{path}: is damaged (its checksum does not match); {ANEW}")
        manifest = json.loads(text)
        by = manifest["program"]
        if by != program():
            raise SceneError(f"{self.folder}: was begun by {by}, this is {program()}; resume it with that, or {ANEW}")
        return manifest

    def save(self, header: Mapping[str, Any], state: Mapping[str, np.ndarray]) -> None:
        """Write a checkpoint over the last one; it is on the disk when this returns, or the last one still is."""
        held = io.BytesIO()
        arrays = {f"state.{name}": np.asarray(values) for name, values in state.items()}
        text = json.dumps(dict(header)).encode()
        np.savez(held, header=np.frombuffer(text, np.uint8), **arrays)
        data = held.getbuffer()
        with replacing(self.path / CHECKPOINT, durable=True) as temporary, open(temporary, "wb") as file:
            file.write(KIND + _sha256(data).encode() + b"\n")
            file.write(data)

    def load(self, scene: Scene) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """Header and state of the checkpoint, None where none was taken yet.

        SceneError where it is damaged, or of another scene or program: nothing of it is used then.
        """
        path = self.path / CHECKPOINT
        try:
            kind, _, rest = path.read_bytes().partition(b"\n")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
        if kind + b"\n" != KIND:
            raise SceneError(f"{path}: is no checkpoint of this version; {ANEW}")
        checksum, _, data = rest.partition(b"\n")
        if _sha256(data).encode() != checksum:
            raise SceneError(f"{path}: is damaged (its checksum does not match); {ANEW}")
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            header = json.loads(held["header"].tobytes())
            state = {name.removeprefix("state."): held[name] for name in held.files if name != "header"}
        if (header["scene"], header["program"]) != (fingerprint(scene), program()):
            raise SceneError(f"{path}: is of another scene or program; {ANEW}")
        for held in header["held"].values():
            for name, (length, digest) in (held or {}).get("files", {}).items():
                if _checksum(self.path / name, length) != digest:
                    raise SceneError(f"{self.path / name}: is damaged (its checksum does not match); {ANEW}")
        return header, state

    def finish(self) -> None:
        """Remove the folder, once everything else in the run's folder is on the disk."""
        for path in self.folder.rglob("*"):
            if self.path not in path.parents and path != self.path:
                settle(path)
        settle(self.folder)
        # at once for whoever looks: what was begun is gone, and not half of it
        os.replace(self.path, self._gone)
        self.tidy()

    def tidy(self) -> None:
        """Remove what a process left that was killed while it removed the folder."""
        shutil.rmtree(self._gone, ignore_errors=True)


def _sha256(data) -> str:
    return hashlib.sha256(data).hexdigest()


def _checksum(path: Path, length: int) -> str:
    """SHA-256 of the start of a file; that of nothing where it is missing."""
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while length > 0 and (block := file.read(min(length, 2**20))):
                digest.update(block)
                length -= len(block)
    except FileNotFoundError:
        pass
    return digest.hexdigest()


class Log:
    """Rows of one structured NumPy type in a file that only grows; rows: how many it holds.

    A run that goes on opens it with what it had `held`: later rows are cut off.
    """

    def __init__(self, path: Path, dtype: np.dtype, held: Mapping[str, Any] | None = None):
        self.path, self.dtype, self.rows = path, np.dtype(dtype), 0
        self._digest = hashlib.sha256()
        if held is not None:
            self.rows = held["rows"]
            with open(path, "rb") as file:
                self._digest.update(file.read(self.rows * self.dtype.itemsize))
        self._file = open(path, "r+b" if self.rows else "w+b", buffering=0)
        self._file.truncate(self.rows * self.dtype.itemsize)
        self._file.seek(0, os.SEEK_END)
        weakref.finalize(self, self._file.close).atexit = False  # read until nobody asks for it any more

    def append(self, *values) -> None:
        """Add a row, a value to each of its fields."""
        row = np.array(values, self.dtype).tobytes()
        data = memoryview(row)
        while data:
            try:
                data = data[self._file.write(data) :]
            except OSError as error:
                error.filename = str(self.path)
                raise
        self._digest.update(row)
        self.rows += 1

    def held(self) -> dict[str, Any]:
        """How many rows, once they are on the disk, and the file as `WorkRoom.load` checks it."""
        os.fsync(self._file.fileno())
        length = self.rows * self.dtype.itemsize
        return {"rows": self.rows, "files": {self.path.name: [length, self._digest.hexdigest()]}}

    def read(self) -> np.ndarray:
        """All rows."""
        return np.fromfile(self.path, self.dtype, self.rows)
