"""The one place where the kernel language is initialised.

Double precision and the CPU are the default: literals and local accumulators of a kernel take `default_fp`, so f64 has
to be set here to be meant anywhere. `fast_math` stays off: it changes bits and gained nothing measurable.

Every start of the language takes all fields of the one before with it; whoever reads them afterwards reads freed
memory or ends the process. A start is counted as a generation. Who holds fields remembers theirs and asks `refuse_lost`
before touching them; a start that somebody else made with `ti.init` is noticed, and so is a forked process, which
has the fields but not the threads.
"""

import contextlib
import io
import os
import weakref

import numpy as np

from taichi_eye.lang import CACHE, CACHE_NOTE, NAME, cache_options, program, ti

if NAME == "taichi":
    # quadrants has a shorter front end of its own
    from taichi_eye import frontend

    frontend.shorten()

ARCHES = ("cpu", "cuda", "vulkan", "metal")
PRECISIONS = ("f64", "f32")

_active: dict = {}
_program = None  # weak reference to what `init` started
_generation = 0
_forked = False


class BackendError(Exception):
    """The requested backend or precision cannot be had on this machine, or what is asked for needs a start of the
    kernel language that is gone."""


def init(arch: str = "cpu", precision: str = "f64", threads: int | None = None, debug: bool = False) -> None:
    """Start the kernel language; a second call with the same arguments keeps what is there, another one starts afresh.

    Every field made before a fresh start is lost. `threads` is the number of CPU threads (default: all).
    Raises BackendError where the backend is not there (the language itself would fall back to the CPU in silence).
    """
    wanted = {"arch": arch, "precision": precision, "threads": threads, "debug": debug}
    global _generation, _program
    _refuse_forked()
    if _active == wanted and _there():
        return
    if arch not in ARCHES or precision not in PRECISIONS:
        raise BackendError(
            f"arch {arch!r}, precision {precision!r}: allowed are {', '.join(ARCHES)} and {', '.join(PRECISIONS)}"
        )
    if arch in ("vulkan", "metal") and precision == "f64":
        raise BackendError(f"--arch {arch} computes in f32 only; add --precision f32")
    refuse_homeless()
    options = cache_options()
    if threads is not None:
        options["cpu_max_num_threads"] = threads
    _active.clear()
    _program = None
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=getattr(ti, arch),
            default_fp=ti.f64 if precision == "f64" else ti.f32,
            default_ip=ti.i32,
            fast_math=False,
            debug=debug,
            **options,
        )
    got = ti.lang.impl.current_cfg().arch
    if (arch == "cpu") != (got in (ti.x64, ti.arm64)) or (arch != "cpu" and got != getattr(ti, arch)):
        ti.reset()
        raise BackendError(f"--arch {arch} is not available on this machine ({NAME} offers {got.name})")
    _active.update(wanted)
    _program = weakref.ref(program())
    _generation += 1


def refuse_homeless() -> None:
    """BackendError where no folder can be had for compiled kernels: the language would end the process without one."""
    if CACHE is None:
        raise BackendError(CACHE_NOTE)


def _there() -> bool:
    """Whether the start that `init` made is there still."""
    return _program is not None and program() is not None and _program() is program()


def _started() -> dict:
    """The arguments of the start that is there; starts, as last time or with the defaults, where none is."""
    _refuse_forked()
    if program() is None:
        init(**_active)
    if not _there():
        raise BackendError(
            f"{NAME} was started by somebody else (ti.init), not with the settings of this package, and what "
            "was made since would be lost in a start of its own: call taichi_eye.init() where that may be"
        )
    return _active


def _refuse_forked() -> None:
    if _forked:
        raise BackendError(
            f"this process was forked from one in which {NAME} runs, whose threads it does not have: start "
            'workers with multiprocessing.get_context("spawn")'
        )


def _mark_forked() -> None:
    global _forked
    _forked = _forked or program() is not None


if hasattr(os, "register_at_fork"):  # where processes can fork: not on Windows
    os.register_at_fork(after_in_child=_mark_forked)


def real():
    """The floating-point type that `init` chose: ti.f64 or ti.f32."""
    return ti.f64 if _started()["precision"] == "f64" else ti.f32


def rounding() -> float:
    """The relative spacing of the numbers in force: of f64 before the first `init`."""
    single = _active.get("precision") == "f32"
    return float(np.finfo(np.float32 if single else np.float64).eps)


def settings() -> dict:
    """The arguments of the `init` in force: arch, precision, threads, debug; empty before the first one."""
    return dict(_active)


def generation() -> int:
    """How often the language was started afresh: fields of an earlier generation are lost."""
    _started()
    return _generation


def refuse_lost(made_in: int) -> None:
    """BackendError where the fields made in a generation are not there any more."""
    _refuse_forked()
    if made_in != _generation or not _there():
        raise BackendError(
            f"{NAME} was started afresh (taichi_eye.init or ti.init) after this simulation was made, and its state "
            "went with the old start: make it anew"
        )


def launcher(kernel):
    """A kernel that returns nothing, launched by the shortest way that the language in force offers: for kernels that
    are launched at every sample. Arguments are Python's integers and NumPy arrays."""
    return frontend.launcher(kernel) if NAME == "taichi" else kernel


def on_cpu() -> bool:
    """Whether kernels run on the CPU."""
    return _started()["arch"] == "cpu"


def threads() -> int:
    """The number of CPU threads that parallel loops use."""
    return _active.get("threads") or os.cpu_count() or 1
