"""Python processes of the package's own, in an environment and with streams that a test chooses."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE_S = 300


def environment(**changed):
    """The environment of this process with variables changed, or left out where None."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    wanted = os.environ | {"PYTHONPATH": path} | changed
    return {name: value for name, value in wanted.items() if value is not None}


def python(*words, cwd=None, env=None, **streams):
    """Run Python with words; the finished process, its output as text where it is captured."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    return subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env=environment(**(env or {})),
        text=True,
        encoding="utf-8",
        errors="surrogateescape",
        timeout=PATIENCE_S,
        **streams,
    )
