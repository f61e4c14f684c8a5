"""What ships with the package and is found by name: scenes, studies and a measured history.

They are the files of `configs/` at the top of the repository, `taichi_eye/configs/` once installed. A bare name, as in
`taichi-eye run quick`, is looked for there where no file of that name lies in the current folder.
"""

from __future__ import annotations

import re
from pathlib import Path

from taichi_eye.errors import SceneError

SCENES, STUDIES, HISTORIES = "*.toml", "studies/*.toml", "*.csv"  # kinds, as they lie in the folder


def folder() -> Path:
    """The folder of what ships."""
    here = Path(__file__).parent
    installed = here / "configs"
    return installed if installed.is_dir() else here.parent / "configs"


def named(kind: str = SCENES) -> dict[str, Path]:
    """The files of a kind by name."""
    return {path.stem: path for path in sorted(folder().glob(kind))}


def find(given: str | Path, kind: str = SCENES) -> Path:
    """The file that is meant: a path is itself, a bare name that is no file here is one of those that ship.

    A bare name has neither folder nor suffix; SceneError where one is neither.
    """
    path = Path(given)
    if not re.fullmatch(r"[\w-]{1,100}", str(given)) or path.exists():
        return path
    known = named(kind)
    if path.name not in known:
        raise SceneError(
            f"{given}: no such file, and none of those that come by name: {', '.join(known) or 'none here'}"
        )
    return known[path.name]
