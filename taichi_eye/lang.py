"""The kernel language: the one door through which it comes, as `from taichi_eye.lang import ti`.

Taichi is the default. Where Python has no wheel of it (3.14 on), quadrants is installed instead, a maintained twin
that runs the same kernels; the environment variable TAICHI_EYE_LANG ("taichi" or "quadrants")
asks for one of the two. NAME says which one it is.
"""

import importlib.util
import os

NAMES = ("taichi", "quadrants")

# a banner and notes are printed on import unless told not to beforehand
for variable in ("ENABLE_TAICHI_HEADER_PRINT", "ENABLE_QUADRANTS_HEADER_PRINT"):
    os.environ.setdefault(variable, "0")
for variable in ("TI_LOG_LEVEL", "QD_LOG_LEVEL"):
    os.environ.setdefault(variable, "error")


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


NAME = _chosen()
if NAME == "taichi":
    import taichi as ti
else:
    import quadrants as ti

ONE_TASK = 1
"""`for _ in range(ONE_TASK):` at the top of a kernel runs its body once, on one thread, as one task.

Every loop at a kernel's top level becomes a task of its own, and each task costs compile time and a launch; loops
inside this one do not.
"""

__all__ = ["NAME", "NAMES", "ONE_TASK", "ti"]
