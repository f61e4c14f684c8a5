"""What computed a result, where, when and by which command: one record for summaries and pages."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone

import taichi_eye
from taichi_eye import backend
from taichi_eye.lang import NAME, ti

_command: str | None = None


@contextmanager
def command(arguments: Sequence[str]) -> Iterator[None]:
    """While this command line is run."""
    global _command
    before, _command = _command, shlex.join(["taichi-eye", *arguments])
    try:
        yield
    finally:
        _command = before


def language() -> str:
    """The kernel language and its version."""
    return f"{NAME} {'.'.join(map(str, ti.__version__))}"


def versions() -> str:
    """One line: this package, the kernel language, Python."""
    return f"taichi-eye {taichi_eye.__version__} ({language()}, Python {platform.python_version()})"


def png_metadata() -> dict[str, str]:
    """Of a picture, as PNG files carry it; the same on every run, so that pictures stay equal to the bit."""
    return {"Software": versions()}


def provenance() -> dict[str, str | int | None]:
    """The record. command: None where a script called, not the command line; date in UTC; the backend as it runs."""
    begun = backend.settings()
    return {
        "taichi_eye": taichi_eye.__version__,
        "language": language(),
        "python": platform.python_version(),
        "arch": begun.get("arch"),
        "precision": begun.get("precision"),
        "threads": backend.threads(),
        "system": f"{platform.system()} {platform.machine()}",
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": _command,
    }
