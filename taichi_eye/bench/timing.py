"""Clocks for a machine that others use too: what is compared runs in turn, and the best of several turns counts."""

import time
from collections.abc import Callable


def best_of(jobs: dict[str, Callable[[], object]], turns: int = 5) -> dict[str, float]:
    """Shortest time [s] of each job; each turn runs every job once, in the order given.

    A first call of each, for compiling and warming up, is left to the caller. A job whose kernels run on a GPU ends
    with `taichi.sync`.
    """
    best = dict.fromkeys(jobs, float("inf"))
    for _ in range(turns):
        for name, job in jobs.items():
            started = time.perf_counter()
            job()
            best[name] = min(best[name], time.perf_counter() - started)
    return best
