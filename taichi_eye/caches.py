"""Where compiled kernels and font lists are kept between runs, also where a home folder is missing or read-only.

The rule is that of the XDG base directories: `XDG_CACHE_HOME` where it is an absolute path, else `~/.cache`, `~` being
HOME or, without it, the home of the account. Where nothing can be written there, a folder of one's own among the
temporary ones: it belongs to this user and is closed to others, since what is kept in it is run.
"""

import os
import stat
import tempfile
from pathlib import Path

SHARED_MEMORY = "/dev/shm"  # can be written where all disks are read-only


def kept_at() -> Path | None:
    """The folder in which caches belong by the rule; None where nothing says where."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):
        return Path(named)
    try:
        home = Path.home()
    except RuntimeError:  # neither HOME nor an account
        return None
    return home / ".cache" if home.is_absolute() else None


def writable(folder: Path) -> bool:
    """Whether files can be written into a folder, which is made where it is missing; tried, not asked."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def temporary() -> Path | None:
    """This user's own folder among the temporary ones, the same from run to run; None where none can be had."""
    if not hasattr(os, "getuid"):  # Windows, where every account has a temporary folder to itself
        folder = Path(tempfile.gettempdir()) / "taichi_eye"
        return folder if writable(folder) else None
    for parent in (tempfile.gettempdir, lambda: SHARED_MEMORY):
        try:
            folder = Path(parent()) / f"taichi_eye-{os.getuid()}"
            folder.mkdir(mode=0o700, exist_ok=True)
            held = folder.lstat()
            own = stat.S_ISDIR(held.st_mode) and held.st_uid == os.getuid() and not held.st_mode & 0o022
            return folder if own and writable(folder) else Path(tempfile.mkdtemp(prefix="taichi_eye-"))
        except OSError:
            continue
    return None
