"""The one thread in which the kernel language runs: its fields belong to the thread that made them.

Work is taken in the order in which it is handed over, a piece at a time; who has much to do hands it over in pieces, so
that no tab waits for more than one piece of every other.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

_END = object()


class Kernels:
    """A thread that starts the kernel language with `begin` before anything else; close it at the end."""

    def __init__(self, begin: Callable[[], None]):
        self._pool = ThreadPoolExecutor(1, "kernels", initializer=begin)

    def begin(self, work: Callable[[], Any]) -> None:
        """Let the thread do some work first, whose outcome nobody waits for."""
        self._pool.submit(work)

    async def call(self, work: Callable[..., Any], *arguments: Any) -> Any:
        """What work returns, computed in the thread."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, work, *arguments)

    async def pieces(self, parts: Iterator[Any]):
        """The parts of an iterator, each computed in the thread when it is asked for."""
        while (part := await self.call(next, parts, _END)) is not _END:
            yield part

    def close(self) -> None:
        """Let the piece under way end and take no more."""
        self._pool.shutdown(cancel_futures=True)
