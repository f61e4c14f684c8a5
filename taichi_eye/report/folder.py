"""The run folder, and files that are whole or absent."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taichi_eye.errors import SceneError


def refuse_taken(out: str | Path | None) -> None:
    """SceneError where `--out` names a folder that holds something."""
    if out is None:
        return
    try:
        taken = Path(out).is_dir() and any(Path(out).iterdir())
    except (OSError, ValueError):
        return  # said by `create_run_folder`, with the reason
    if taken:
        raise SceneError(f"--out {out}: is not empty; a run never overwrites, name a new or an empty folder")


def create_run_folder(out: str | Path | None, stem: str, parent: str | Path = "renders") -> Path:
    """Create the folder of a run and return it; call it once the scene has been validated.

    out: the folder that `--out` names, which must be new or empty; None for the next `<parent>/<stem>-001`, -002, ...
    after the highest number there. Missing parents are made. Raises SceneError where nothing can be written there.
    """
    try:
        if out is not None:
            refuse_taken(out)
            folder = Path(out)
            folder.mkdir(parents=True, exist_ok=True)
            return folder
        parent = Path(parent)
        parent.mkdir(parents=True, exist_ok=True)
        numbered = re.compile(re.escape(stem) + r"-(\d+)")
        taken = [int(m[1]) for entry in parent.iterdir() if (m := numbered.fullmatch(entry.name))]
        number = max(taken, default=0) + 1
        while True:
            folder = parent / f"{stem}-{number:03d}"
            try:
                folder.mkdir()
                return folder
            except FileExistsError:  # another run took this number meanwhile
                number += 1
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        where = f"--out {out}" if out is not None else str(parent)
        raise SceneError(f"{where}: a run folder cannot be made there ({reason}); name a folder with --out") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder, with the same suffix, that becomes `path` when the block ends.

    Whoever reads `path` sees the old file or the new one, never a part. The temporary file is removed on failure.
    """
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
