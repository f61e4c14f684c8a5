"""A run as it is computed, in the browser: `taichi-eye run --watch`.

    with Watch() as watch:
        taichi_eye.run(scene, watch=watch)

looks on at every frame, and keeps nothing but the newest. A server in a thread behind the run hands that to every page
that is open, as a JPEG with the traces so far: at once where nothing came before, and not more often than PACE_S, or
than costs SHARE of the time. Pages come and go as they like. The stop button is a Ctrl-C: the run ends in order at its
next sample.

    /  the page      /frames  a socket: messages out, nothing in      /stop  POST: end the run
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import signal
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from taichi_eye.page.message import packed
from taichi_eye.page.needs import refuse_missing
from taichi_eye.page.server import Address
from taichi_eye.recording.observer import Watcher

PACE_S, POLL_S, SHARE = 0.15, 0.05, 0.015
QUALITY = 85  # of the JPEG
POINTS = 400  # of a trace
PLOTTED = {
    "time_ms": "time_ms",
    "apex_mm": "apex_displacement_mm",
    "puff_kpa": "puff_apex_kpa",
    "pressure_kpa": "fluid_pressure_apex_kpa",
}
OVER = "complete", "ended"  # states after which nothing comes
LAST_S = 0.5  # that pages have for the last message


class Watch(Watcher):
    """Looks on and serves; a context that ends with the run. url: of the page; address: None for this machine alone."""

    def __init__(self, address: Address | None = None):
        refuse_missing()
        address = address or Address()
        self.url = address.url
        self._newest: tuple[int, dict, tuple | None] = (0, {"state": "begun"}, None)
        self._packed: tuple[int, bytes] = (-1, b"")
        self._cost, self._pressed = 0.0, False
        self._served = address.behind(self._app)

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, kind, error, trace) -> None:
        told = {"state": "complete"} if error is None else {"state": "ended", "reason": str(error) or "interrupted"}
        self._tell(told)
        time.sleep(LAST_S if self._open else 0.0)
        self._served.stop()

    # what the run tells

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        if self._pressed:  # before there was anything to end
            self._pressed = False
            self.signals.ask(signal.SIGINT)
        self._tell({"state": "running"})

    def frame(self, moment) -> None:
        # the arrays as they are: what a page needs of them is made once one asks
        told = {"state": "running", "frame": moment.frame, "now_ms": moment.time_ms}
        self._tell(told, (moment.image, moment.traces))

    def closed(self, ending) -> None:
        self._tell({"state": "writing"})

    def _tell(self, told: dict, seen: tuple | None = None) -> None:
        version, before, kept = self._newest
        if (recording := getattr(self, "recording", None)) is not None:
            told |= {
                "folder": str(recording.folder),
                "end_ms": recording.scene.numerics.duration_ms,
                "frames": recording.scene.camera.frame_count,
            }
        told["at"] = time.time()
        self._newest = version + 1, before | told, kept if seen is None else seen

    # what the pages get, in the server's thread

    _open = 0  # pages

    def _app(self):
        from starlette.applications import Starlette
        from starlette.routing import Mount, Route, WebSocketRoute
        from starlette.staticfiles import StaticFiles

        from taichi_eye.page.files import STATIC, page

        return Starlette(
            routes=[
                Route("/", page("watch.html")),
                Route("/stop", self._stop, methods=["POST"]),
                WebSocketRoute("/frames", self._tab),
                Mount("/static", StaticFiles(directory=STATIC)),
            ]
        )

    async def _stop(self, request):
        from starlette.responses import PlainTextResponse

        if self.signals is None:
            self._pressed = True
        else:
            self.signals.ask(signal.SIGINT)
        return PlainTextResponse("the run ends at its next sample\n")

    async def _tab(self, socket) -> None:
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        heard = asyncio.ensure_future(socket.receive())  # nothing but that it is closed
        self._open += 1
        sent = -1
        try:
            while not heard.done():
                version, told, _ = self._newest
                if version == sent:
                    await asyncio.sleep(POLL_S)
                    continue
                sent = version
                await socket.send_bytes(self._message())
                if told["state"] in OVER:
                    await socket.close()
                    return
                until = time.monotonic() + max(PACE_S, self._cost / SHARE)
                while time.monotonic() < until and not heard.done() and self._newest[1]["state"] not in OVER:
                    await asyncio.sleep(POLL_S)
        except WebSocketDisconnect:
            pass
        finally:
            self._open -= 1
            heard.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await heard

    def _message(self) -> bytes:
        """The newest, packed once for all pages."""
        version, told, seen = self._newest
        if self._packed[0] != version:
            began = time.perf_counter()
            told, data = (told, b"") if seen is None else (told | _plotted(seen[1]), _jpeg(seen[0]))
            self._packed = version, packed(told, data)
            self._cost = time.perf_counter() - began
        return self._packed[1]


def _plotted(traces: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The traces thinned, their last sample kept, and what is said of them all: where they stand and their most."""
    count = len(traces["time_ms"])
    kept = np.arange(0, count, max(1, count // POINTS))
    kept = np.append(kept, count - 1) if kept[-1] != count - 1 else kept
    rounded = {name: np.round(traces[column], 5) for name, column in PLOTTED.items()}
    return {name: values[kept].tolist() for name, values in rounded.items()} | {
        "now": {name: float(values[-1]) for name, values in rounded.items()},
        "most": {name: float(values.max()) for name, values in rounded.items()},
    }


def _jpeg(image: np.ndarray) -> bytes:
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=QUALITY)
    return data.getvalue()
