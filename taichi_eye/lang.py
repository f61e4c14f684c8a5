"""The kernel language: the one door through which it comes, as `from taichi_eye.lang import ti`.

Taichi is the default. Where Python has no wheel of it (3.14 on), quadrants is installed instead, a maintained twin that
runs the same kernels; the environment variable TAICHI_EYE_LANG ("taichi" or "quadrants") asks for one of the two. NAME
says which one it is.

Both abort on import where the environment names no folder for compiled kernels, and at the end of the process where
that folder cannot be written. So a folder is chosen before the import (see `taichi_eye.caches`), CACHE, and named to
`ti.init`; CACHE_NOTE is what the user is told where it is not the usual one.
"""

import contextlib
import importlib.util
import os
import sys
import time
from pathlib import Path

from taichi_eye import caches

NAMES = ("taichi", "quadrants")
PREFIXES = {"taichi": "TI", "quadrants": "QD"}  # of their environment variables
CACHE_FOLDERS = {"taichi": "ticache", "quadrants": "qdcache"}


def _chosen() -> str:
    asked = os.environ.get("TAICHI_EYE_LANG", "")
    if asked:
        if asked not in NAMES or importlib.util.find_spec(asked) is None:
            raise ImportError(
                f'TAICHI_EYE_LANG = "{asked}": must name an installed kernel language, one of {", ".join(NAMES)}'
            )
        return asked
    for name in NAMES:
        if importlib.util.find_spec(name) is not None:
            return name
    raise ImportError(f"no kernel language is installed; one of {', '.join(NAMES)} is needed")


def _cache(name: str) -> tuple[Path | None, str]:
    """The folder for compiled kernels (None: there is none to be had), and what to tell the user of it."""
    named = os.environ.get(f"{PREFIXES[name]}_OFFLINE_CACHE_FILE_PATH")
    usual = caches.kept_at()
    if not os.path.isabs(os.environ.get("XDG_CACHE_HOME", os.environ.get("HOME", ""))):
        # the language asks for one of the two on import, and takes a relative path at its word
        os.environ["XDG_CACHE_HOME"] = str(usual or os.devnull)
    folder = Path(named) if named else usual and usual / name / CACHE_FOLDERS[name]
    if folder is not None and caches.writable(folder):
        return folder, ""
    spare = caches.temporary()
    told = f"compiled kernels cannot be kept in {folder}" if folder else "no home folder for compiled kernels"
    if spare is None:
        return None, f"{told}, nor in a temporary folder; name a folder that can be written with XDG_CACHE_HOME"
    if not named:
        os.environ.setdefault("MPLCONFIGDIR", str(spare / "matplotlib"))  # it would warn that it finds no folder either
    return spare / name / CACHE_FOLDERS[name], f"{told}; they are kept in {spare}"


NAME = _chosen()
PREFIX = PREFIXES[NAME]
CACHE_VARIABLE = f"{PREFIX}_OFFLINE_CACHE_FILE_PATH"
CACHE, CACHE_NOTE = _cache(NAME)

# a banner and notes are printed on import unless told not to beforehand
os.environ.setdefault(f"ENABLE_{NAME.upper()}_HEADER_PRINT", "0")
os.environ.setdefault(f"{PREFIX}_LOG_LEVEL", "error")
# the version is pinned: nobody needs to be asked over the net whether there is a newer one
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")

if NAME == "taichi":
    import taichi as ti
else:
    import quadrants as ti


STALE_LOCK_S = 60.0


def drop_stale_locks(folder: Path) -> None:
    """Remove the cache's lock where a process that was killed while it saved kernels has left it.

    The language takes the lock for a second at most and waits for no other: where one is left, nothing is saved any
    more and every later process compiles anew, in silence.
    """
    for lock in folder.glob("*.lock"):
        with contextlib.suppress(OSError):
            if time.time() - lock.stat().st_mtime > STALE_LOCK_S:
                lock.unlink()


def program():
    """What the last `ti.init` of this process started; None before the first."""
    runtime = ti.lang.impl.get_runtime()
    return runtime.prog if NAME == "taichi" else runtime._prog


def cache_options() -> dict:
    """What `ti.init` is to be told about the cache; where it is not the usual one, stderr says so, once."""
    global CACHE_NOTE
    if CACHE_NOTE and sys.stderr is not None:
        print(f"taichi-eye: {CACHE_NOTE}", file=sys.stderr)
    CACHE_NOTE = ""
    drop_stale_locks(CACHE)
    if os.environ.get(CACHE_VARIABLE) == str(CACHE):
        return {"offline_cache": True}  # read from there
    return {"offline_cache": True, "offline_cache_file_path": str(CACHE)}


ONE_TASK = 1
"""`for _ in range(ONE_TASK):` at the top of a kernel runs its body once, on one thread, as one task.

Every loop at a kernel's top level becomes a task of its own, and each task costs compile time and a launch; loops
inside this one do not.
"""

__all__ = ["CACHE", "CACHE_VARIABLE", "NAME", "NAMES", "ONE_TASK", "PREFIX", "cache_options", "program", "ti"]
