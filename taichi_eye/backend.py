"""The one place where Taichi is initialised.

Double precision and the CPU are the default: literals and local accumulators of a kernel take `default_fp`, so f64 has
to be set here to be meant anywhere. `fast_math` stays off: it changes bits and gained nothing measurable.
"""

import contextlib
import io
import os

from taichi_eye.lang import NAME, ti

if NAME == "taichi":
    # quadrants has a shorter front end of its own
    from taichi_eye import frontend

    frontend.shorten()

ARCHES = ("cpu", "cuda", "vulkan", "opengl", "metal")
PRECISIONS = ("f64", "f32")

_active: dict = {}
_generation = 0


class BackendError(Exception):
    """The requested Taichi backend or precision cannot be had on this machine."""


def init(arch: str = "cpu", precision: str = "f64", threads: int | None = None, debug: bool = False) -> None:
    """Initialise Taichi; a second call with the same arguments keeps what is there, another one starts afresh.

    Every field made before a fresh start is lost. `threads` is the number of CPU threads (default: all).
    Raises BackendError where the backend is not there (Taichi itself would fall back to the CPU in silence).
    """
    wanted = {"arch": arch, "precision": precision, "threads": threads, "debug": debug}
    global _generation
    if _active == wanted:
        return
    if arch not in ARCHES or precision not in PRECISIONS:
        raise BackendError(
            f"arch {arch!r}, precision {precision!r}: allowed are {', '.join(ARCHES)} and {', '.join(PRECISIONS)}"
        )
    if arch in ("vulkan", "opengl", "metal") and precision == "f64":
        raise BackendError(f"--arch {arch} computes in f32 only; add --precision f32")
    options = {} if threads is None else {"cpu_max_num_threads": threads}
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=getattr(ti, arch),
            default_fp=ti.f64 if precision == "f64" else ti.f32,
            default_ip=ti.i32,
            fast_math=False,
            offline_cache=True,
            debug=debug,
            **options,
        )
    _active.clear()
    got = ti.lang.impl.current_cfg().arch
    if (arch == "cpu") != (got in (ti.x64, ti.arm64)) or (arch != "cpu" and got != getattr(ti, arch)):
        raise BackendError(f"--arch {arch} is not available on this machine (Taichi offers {got.name})")
    _active.update(wanted)
    _generation += 1


def real():
    """The floating-point type that `init` chose: ti.f64 or ti.f32."""
    if not _active:
        init()
    return ti.f64 if _active["precision"] == "f64" else ti.f32


def settings() -> dict:
    """The arguments of the `init` in force: arch, precision, threads, debug; empty before the first one."""
    return dict(_active)


def generation() -> int:
    """How often Taichi was started afresh: fields of an earlier generation are lost."""
    if not _active:
        init()
    return _generation


def on_cpu() -> bool:
    """Whether kernels run on the CPU."""
    if not _active:
        init()
    return _active["arch"] == "cpu"


def threads() -> int:
    """The number of CPU threads that parallel loops use."""
    return _active.get("threads") or os.cpu_count() or 1
