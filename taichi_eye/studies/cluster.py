"""Workers on a Dask cluster that is there already: `--scheduler tcp://host:8786`.

A parcel is one task: text in, text out. Each thread of a Dask worker keeps a process of its own that computes
(`taichi_eye.studies.crew`), so that a worker of several threads computes on all of them. A few parcels for each thread
are on their way at a time, so neither this process nor the scheduler holds a study of any size. When a worker dies
Dask gives its parcels to others, and what was gathered stays; a parcel that outlives no worker is a row for each of its
eyes that says so.

Trust. Whoever reaches a Dask scheduler may run any program on its workers, and Dask's own messages between scheduler,
workers and this process are pickles: use a cluster whose machines and network are your own, or TLS (`tls://`, with
Dask's own settings). What this package adds is not: scenes and puff files go out as text, rows come back as text, and
no file of the user's is unpickled here or there.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from taichi_eye.errors import OutputError, SceneError
from taichi_eye.studies.crew import Job, Rows, Worker, answered

PATIENCE_S = 10.0  # to reach the scheduler, and for a first worker
AHEAD = 3  # parcels on their way for each thread of the cluster
COUNTED_S = 5.0  # seconds between two counts of its threads, which may come and go
_here = threading.local()
_workers: list[Worker] = []


def program_here() -> str:
    """What computes where this is called."""
    from taichi_eye.recording.workroom import program

    return program()


def task(text: str) -> str:
    """The rows of a parcel, on a thread of a Dask worker; both as JSON."""
    asked = json.loads(text)
    if asked["program"] != program_here():
        return json.dumps({"program": program_here()})
    worker = getattr(_here, "worker", None)
    if worker is None or worker.closed or worker.compute != asked["compute"]:
        worker = _here.worker = Worker(asked["compute"], 1)
        _workers.append(worker)
    return json.dumps({"rows": answered(worker, asked["common"], asked["items"])})


def dismiss() -> None:
    """End the processes of a Dask worker."""
    while _workers:
        _workers.pop().close()


class Cluster:
    """A Dask cluster as workers; raises SceneError where it cannot be used, before anything is sent."""

    def __init__(self, scheduler: str, compute: str):
        from distributed import Client

        self.scheduler, self.compute = scheduler, compute
        # what it would log of a scheduler that is lost is said in one message
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self.client = Client.__new__(Client)
        try:
            self.client.__init__(scheduler, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as problem:
            self.client.status = "closed"  # else it would wait for the scheduler once more when it is thrown away
            raise SceneError(
                f"--scheduler {scheduler}: no Dask scheduler answers there ({_first(problem)}); start one with "
                "`dask scheduler`, and name it as tcp://host:8786"
            ) from None
        try:
            self._refuse_others()
        except BaseException:
            self.close()
            raise

    def _refuse_others(self) -> None:
        """SceneError where the cluster has no worker, or one without this program."""
        from taichi_eye.recording.workroom import program

        try:
            self.client.wait_for_workers(1, timeout=PATIENCE_S)
        except Exception:
            raise SceneError(
                f"--scheduler {self.scheduler}: has no workers; start some with `dask worker {self.scheduler}`"
            ) from None
        own = program()
        for address, found in self.client.run(program_here, on_error="return").items():
            if isinstance(found, BaseException):
                raise SceneError(
                    f"--scheduler {self.scheduler}: the worker {address} cannot load this package ({_first(found)}): "
                    "install the same taichi-eye there"
                )
            if found != own:
                raise SceneError(_other(self.scheduler, f"the worker {address}", found, own))

    @property
    def threads(self) -> int:
        """Threads of all workers."""
        return max(1, sum(self.client.nthreads().values()))

    def run(
        self, common: Mapping[str, Any], jobs: Iterable[Job], look: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[int, Rows]]:
        """The rows of every job as they come; look() is called some times a second meanwhile, and may raise.

        OutputError where the scheduler is lost.
        """
        from taichi_eye.recording.workroom import program

        own, waiting, sent, done = program(), iter(jobs), {}, queue.Queue()
        told = {"program": own, "compute": self.compute, "common": common}
        more, room, asked = True, 0, -math.inf
        while more or sent:
            if time.monotonic() - asked > COUNTED_S:
                room, asked = AHEAD * self.threads, time.monotonic()
            while more and len(sent) < room:
                job = next(waiting, None)
                more = job is not None
                if more:
                    text = json.dumps({**told, "items": list(job[1])})
                    future = self.client.submit(task, text, pure=False)
                    sent[future.key] = future, job
                    future.add_done_callback(done.put)
            look()
            if self.client.status not in ("running", "connecting"):
                raise self._lost(f"its client is {self.client.status}")
            try:
                key = done.get(timeout=0.2).key
            except queue.Empty:
                continue
            if key in sent:
                future, job = sent.pop(key)
                yield job[0], self._rows(future, job, own)

    def _rows(self, future, job: Job, own: str) -> Rows:
        if future.status == "cancelled":
            raise self._lost("its tasks were cancelled")
        if future.status == "error":
            reason = _first(future.exception())
            return [{"status": "failed", "reason": f"on the cluster: {reason}"} for _ in job[1]]
        answer = json.loads(future.result())
        if "rows" not in answer:
            raise SceneError(_other(self.scheduler, "a worker that came later", answer["program"], own))
        return answer["rows"]

    def _lost(self, problem: Any) -> OutputError:
        return OutputError(f"--scheduler {self.scheduler}: was lost ({_first(problem)})")

    def close(self) -> None:
        """Leave the cluster as it was found; what is under way there is dropped."""
        try:
            if self.client.status == "running":
                self.client.run(dismiss, on_error="ignore")
        except Exception:
            pass  # a cluster that has gone has nothing to be dismissed
        self.client.close(timeout=2.0)


def _other(scheduler: str, who: str, found: str, own: str) -> str:
    return (
        f"--scheduler {scheduler}: {who} has {found}, this is {own}; rows of two programs would not belong together: "
        "install the same taichi-eye on both"
    )


def _first(problem: Any) -> str:
    return (str(problem).splitlines() or [type(problem).__name__])[0][:160] or type(problem).__name__
