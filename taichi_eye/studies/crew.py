"""Workers on one machine: processes of the package's own, one for each share of the threads.

A worker is `python -m taichi_eye.studies.worker`. It is handed parcels one at a time and gives rows back, as JSON over
its pipes, so that nothing is unpickled and nothing of the caller's program is run again, as processes of
`multiprocessing` would. It ends when its pipe closes, so also when the process that started it was killed.

A worker that dies takes its parcel with it: the parcel's eyes are then tried one by one, each in a fresh worker, and an
eye whose worker dies twice is a row that says so.
"""

from __future__ import annotations

import json
import os
import queue
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import taichi_eye

LENGTH = struct.Struct(">Q")  # before every message: the number of its bytes
PATIENCE_S = 20.0  # for a worker to end by itself
TRIES = 2  # of an eye whose worker dies
Rows = list[dict[str, Any]]
Job = tuple[int, Sequence[Mapping[str, Any]]]  # a parcel's number and what its eyes change


class Died(Exception):
    """A worker ended without an answer; the message says how."""


class Closed(Exception):
    """A worker was closed by its owner."""


class Worker:
    """One process. threads: of the kernel language and of linear algebra; compute: "module:function" that takes what
    all parcels share and a parcel's items, and returns their rows."""

    def __init__(self, compute: str, threads: int):
        self.compute, self.threads, self.closed = compute, threads, False
        self._busy = False
        self._process: subprocess.Popen | None = None
        self._said: Any = None
        self._common: Any = None
        self._door = threading.Lock()  # between a start and a close

    def ask(self, common: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> Rows:
        """The rows of items; raises Died where the process ends instead, Closed once the worker is closed."""
        if self._process is None:
            with self._door:
                if self.closed:
                    raise Closed
                self._start()
        self._busy = True
        try:
            if self._common is not common:
                write(self._process.stdin, {"compute": self.compute, "common": common})
                self._common = common
            write(self._process.stdin, {"items": list(items)})
            answer = read(self._process.stdout)
        except (OSError, EOFError):
            answer = None
        if answer is None:
            with self._door:
                if self.closed:
                    raise Closed
                raise Died(self._ended())
        self._busy = False
        return answer["rows"]

    def _start(self) -> None:
        root = str(Path(taichi_eye.__file__).parents[1])
        paths = os.pathsep.join(
            filter(None, [root, *(path for path in sys.path if path), os.environ.get("PYTHONPATH")])
        )
        few = {f"{library}_NUM_THREADS": str(self.threads) for library in ("OMP", "OPENBLAS", "MKL")}
        self._said = tempfile.TemporaryFile()
        self._common = None
        self._process = subprocess.Popen(
            [sys.executable, "-m", "taichi_eye.studies.worker", str(self.threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=os.environ | few | {"PYTHONPATH": paths},
            start_new_session=True,  # Ctrl-C is for the one who started it
        )

    def _ended(self) -> str:
        code = self._process.wait()
        self._said.seek(0)
        last = self._said.read().decode(errors="replace").strip().splitlines()
        self._leave()
        how = f"was ended by signal {-code}" if code < 0 else f"ended with status {code}"
        return f"the process that computed it {how}" + (f" ({last[-1][:200]})" if last else "")

    def _leave(self) -> None:
        for stream in (self._process.stdin, self._process.stdout, self._said):
            try:
                stream.close()
            except OSError:
                pass  # what was under way to it
        self._process = None

    def close(self) -> None:
        """End the process for good; what it has under way is dropped."""
        with self._door:
            self.closed = True
            if self._process is None:
                return
            if not self._busy:
                # at the end of its input it keeps the kernels that it has compiled
                self._process.stdin.close()
                try:
                    self._process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    pass
            self._process.kill()
            self._process.wait()


def answered(worker: Worker, common: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> Rows:
    """The rows of items whatever befalls the worker."""
    try:
        return worker.ask(common, items)
    except Died:
        return [_alone(worker, common, item) for item in items]


def _alone(worker: Worker, common: Mapping[str, Any], item: Mapping[str, Any]) -> dict[str, Any]:
    for _ in range(TRIES):
        try:
            return worker.ask(common, [item])[0]
        except Died as end:
            reason = str(end)
    return {"status": "failed", "reason": reason}


class Crew:
    """Some workers side by side."""

    def __init__(self, compute: str, workers: int, threads: int):
        self.workers = [Worker(compute, threads) for _ in range(workers)]

    def run(
        self, common: Mapping[str, Any], jobs: Iterable[Job], look: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[int, Rows]]:
        """The rows of every job as they come; look() is called some times a second meanwhile, and may raise."""
        waiting: Iterator[Job] = iter(jobs)
        lock, results, stopped = threading.Lock(), queue.Queue(), threading.Event()

        def work(worker: Worker) -> None:
            try:
                while not stopped.is_set():
                    with lock:
                        job = next(waiting, None)
                    if job is None:
                        break
                    results.put((job[0], answered(worker, common, job[1])))
                results.put(None)
            except BaseException as problem:
                results.put(problem)

        threads = [threading.Thread(target=work, args=(worker,), daemon=True) for worker in self.workers]
        for thread in threads:
            thread.start()
        going = len(threads)
        try:
            while going:
                look()
                try:
                    result = results.get(timeout=0.2)
                except queue.Empty:
                    continue
                if isinstance(result, BaseException):
                    raise result
                if result is None:
                    going -= 1
                else:
                    yield result
        finally:
            stopped.set()

    def close(self) -> None:
        """End all workers; what they have under way is dropped."""
        for worker in self.workers:
            worker.close()


def write(stream, message: Any) -> None:
    """Send a message."""
    data = json.dumps(message).encode()
    stream.write(LENGTH.pack(len(data)) + data)
    stream.flush()


def read(stream) -> Any:
    """Receive a message; EOFError at the end of the stream."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    size = LENGTH.unpack(head)[0]
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return json.loads(data)
