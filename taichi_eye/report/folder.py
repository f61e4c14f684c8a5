"""The run folder, and files that are whole or absent.

A folder belongs to one process at a time: whoever makes or resumes it holds an advisory lock on it, which the system
takes back however the process ends. So two processes that are given one `--out` cannot both find it empty.
"""

from __future__ import annotations

import csv
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from taichi_eye.errors import SceneError

try:
    import fcntl
except ImportError:  # Windows cannot lock a folder: there, only new folders are safe from a second process
    fcntl = None

WORK = ".run"  # hidden folder of a run that is under way; `taichi_eye.recording.workroom`
MANIFEST = "run.json"  # what makes it one that can be resumed
PART = ".part-"  # start of the names of files that are being written


class Lock:
    """Keeps a folder to this process until `release`, or its end; SceneError where another one has it."""

    def __init__(self, folder: Path):
        self._handle = None
        if fcntl is None:
            return
        self._handle = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise SceneError(f"{folder}: is in use by another run") from None
        except OSError:
            pass  # a file system without locks

    def release(self) -> None:
        """Let others have the folder; harmless when called again."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def _taken(folder: Path) -> bool:
    """Whether a folder holds something; the work of a run that died before it could be resumed is nothing."""
    entries = list(folder.iterdir())
    return bool(entries) and (entries != [folder / WORK] or (folder / WORK / MANIFEST).exists())


def refuse_taken(out: str | Path | None) -> None:
    """SceneError where `--out` names a folder that holds something."""
    if out is None:
        return
    try:
        taken = Path(out).is_dir() and _taken(Path(out))
    except (OSError, ValueError):
        return  # said by `claim_folder`, with the reason
    if taken:
        raise SceneError(f"--out {out}: is not empty; a run never overwrites, name a new or an empty folder")


def claim_folder(out: str | Path | None, stem: str, parent: str | Path = "renders") -> tuple[Path, Lock]:
    """Create the folder of a run and return it with its lock; call it once the scene has been validated.

    out: the folder that `--out` names, which must be new or empty; None for the next `<parent>/<stem>-001`, -002, ...
    after the highest number there. Missing parents are made. Raises SceneError where nothing can be written there.
    """
    try:
        if out is not None:
            folder = Path(out)
            folder.mkdir(parents=True, exist_ok=True)
            lock = Lock(folder)
            try:
                refuse_taken(out)
                if (folder / WORK).exists():
                    shutil.rmtree(folder / WORK)
            except BaseException:
                lock.release()
                raise
            return folder, lock
        parent = Path(parent)
        parent.mkdir(parents=True, exist_ok=True)
        numbered = re.compile(re.escape(stem) + r"-(\d+)")
        taken = [int(m[1]) for entry in parent.iterdir() if (m := numbered.fullmatch(entry.name))]
        number = max(taken, default=0) + 1
        while True:
            folder = parent / f"{stem}-{number:03d}"
            try:
                folder.mkdir()
                return folder, Lock(folder)
            except FileExistsError:  # another run took this number meanwhile
                number += 1
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        where = f"--out {out}" if out is not None else str(parent)
        raise SceneError(f"{where}: a run folder cannot be made there ({reason}); name a folder with --out") from None


_held: list[tuple[Path, Lock]] = []


def create_run_folder(out: str | Path | None, stem: str, parent: str | Path = "renders") -> Path:
    """`claim_folder` for those who write their files at the end: the lock lasts until the folder holds something,
    which protects it from then on."""
    for entry in [entry for entry in _held if not entry[0].is_dir() or _taken(entry[0])]:
        entry[1].release()
        _held.remove(entry)
    folder, lock = claim_folder(out, stem, parent)
    _held.append((folder, lock))
    return folder


@contextmanager
def replacing(path: Path, durable: bool = False) -> Iterator[Path]:
    """A temporary path in the same folder, with the same suffix, that becomes `path` when the block ends.

    Whoever reads `path` sees the old file or the new one, never a part. The temporary file is removed on failure;
    what a killed process leaves, `sweep` removes. durable: `path` survives a loss of power. An OSError without a file
    name, such as that of a full disk, is given that of `path`.
    """
    temporary = path.with_name(f"{PART}{os.getpid()}-{path.name}")
    try:
        yield temporary
        if durable:
            settle(temporary)
        os.replace(temporary, path)
        if durable:
            settle(path.parent)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):
            error.filename, error.filename2 = str(path), None
        raise


def write_text(path: Path, text: str, durable: bool = False) -> None:
    """Write UTF-8 text to `path`, whole or not at all."""
    with replacing(path, durable) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def sweep(folder: Path) -> None:
    """Remove what killed processes left unfinished in a folder and below it."""
    for left in folder.rglob(f"{PART}*"):
        left.unlink(missing_ok=True)


def settle(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except PermissionError:
        return  # a folder, where folders cannot be opened
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a small CSV file, head and rows under it, whole or not at all."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(head)
        lines.writerows(rows)
