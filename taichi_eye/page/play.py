"""The page of `taichi-eye play`: one or two eyes under the hand, and what their sliders ask for.

    /                the page            /eyes     scenes, sliders and parameters that it offers
    /hand            a socket of a tab: {"number", "time_ms", "eyes": [{"which", "scene", "values"}]} in, for each eye
                     a `packed` frame out
    /film            POST of {"eyes": [...]}: whole films, a stream of messages, each `packed` after its length
    /scene           POST of an eye: its scene file, to keep
    /measured        POST of a file: a measured history, or the curves of a film, to lay over

Of a tab only the newest request is worked on. A newer frame overtakes an older one in the socket; whole films, too much
for a socket, are streams that the tab breaks off before it asks for more, and that end at their next piece. A tab that
is closed takes its requests along.
"""

from __future__ import annotations

import asyncio
import json
import math
import traceback
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from taichi_eye.analysis.names import NAMES, unit_of
from taichi_eye.analysis.norms import POPULATIONS, judged_by
from taichi_eye.analysis.report import FAR
from taichi_eye.errors import SceneError
from taichi_eye.film.display import gain_of
from taichi_eye.page import hand, laid
from taichi_eye.page.files import STATIC, page
from taichi_eye.page.message import packed, sized
from taichi_eye.page.thread import Kernels
from taichi_eye.scene import dump_scene

PRESETS = "corvis_healthy", "keratoconus", "seed"
SIDES = 2  # eyes side by side


class Play:
    """The application; kernels: the thread in which eyes are run and drawn."""

    def __init__(self, eyes: hand.Eyes, kernels: Kernels):
        self.eyes, self.kernels, self.hand = eyes, kernels, hand.Hand()
        self.app = Starlette(
            routes=[
                Route("/", page("play.html")),
                Route("/eyes", self.offer),
                Route("/film", self.film, methods=["POST"]),
                Route("/scene", self.scene, methods=["POST"]),
                Route("/measured", measured, methods=["POST"]),
                WebSocketRoute("/hand", self.tab),
                Mount("/static", StaticFiles(directory=STATIC)),
            ]
        )

    def warm(self) -> None:
        """Compile and load what an eye takes; in the thread."""
        for scene, _ in self.eyes.scenes.values():
            hand.frame_of(self.hand, hand.Eye(scene, (), {}), 1.0)

    async def offer(self, request: Request) -> Response:
        """What the page has to choose from."""
        scenes = []
        for name, (scene, _) in self.eyes.scenes.items():
            values = {slider: hand.SLIDERS[slider].of(scene) for slider in hand.of_scene(scene)}
            scenes.append(
                {
                    "name": name,
                    "values": {slider: value for slider, value in values.items() if math.isfinite(value)},
                    "duration_ms": scene.numerics.duration_ms,
                    "width": scene.camera.width_px,
                    "height": scene.camera.height_px,
                    "interval_ms": scene.camera.frame_interval_ms,
                    "pixel_mm": [scene.camera.pixel_x_mm, scene.camera.pixel_y_mm],
                    "apex_px": [scene.camera.apex_column_px, scene.camera.apex_row_px],
                    "gain": gain_of(scene),
                }
            )
        norms = {name: judged_by(name) for name in NAMES}
        parameters = [
            {
                "name": name,
                "said": said,
                "unit": unit_of(name),
                "norm": norms[name] and [*norms[name][1:], POPULATIONS[norms[name][0]].name],
            }
            for name, said in NAMES.items()
        ]
        told = {"scenes": scenes, "sliders": [slider.told for slider in hand.SLIDERS.values()]}
        return JSONResponse(told | {"parameters": parameters, "far": FAR})

    async def scene(self, request: Request) -> Response:
        """The scene file of an eye."""
        try:
            eye = self.eyes.eye(_parsed(await request.body()))
        except hand.Refused as refused:
            return PlainTextResponse(f"{refused}\n", 400)
        return Response(
            dump_scene(eye.scene),
            media_type="application/toml",
            headers={"Content-Disposition": 'attachment; filename="my_eye.toml"'},
        )

    async def tab(self, socket: WebSocket) -> None:
        """A tab: the frames of its newest request, until it is closed."""
        await socket.accept()
        newest: list[str] = []
        asked = asyncio.Event()
        worker = asyncio.create_task(self._answer(socket, newest, asked))
        try:
            while not worker.done():
                newest[:] = [await socket.receive_text()]
                asked.set()
        except (WebSocketDisconnect, KeyError):
            pass  # closed; or bytes, which are no request
        finally:
            worker.cancel()

    async def _answer(self, socket: WebSocket, newest: list[str], asked: asyncio.Event) -> None:
        while True:
            await asked.wait()
            asked.clear()
            try:
                number, time_ms, eyes = self._read(_parsed(newest[0]))
            except Exception as problem:
                if not await _sent(socket, _refusal(problem)):
                    return
                continue
            for which, one in eyes:
                try:
                    eye = self.eyes.eye(one)
                    told, pixels = await self.kernels.call(hand.frame_of, self.hand, eye, time_ms)
                    head = {"number": number, "which": which, "kind": "frame", "command": eye.command}
                    message = packed(head | told, pixels.data)
                except Exception as problem:
                    message = _refusal(problem, number=number, which=which)
                if not await _sent(socket, message):
                    return
                if asked.is_set():
                    break

    def _read(self, request: Any) -> tuple[int, float, list[tuple[int, dict[str, Any]]]]:
        """The number of a request for frames, the time that is looked at, and its eyes."""
        eyes = self._eyes(request)
        time_ms, number = request.get("time_ms"), request.get("number")
        if isinstance(time_ms, bool) or not isinstance(time_ms, int | float) or not 0.0 <= time_ms <= 1e4:
            raise hand.Refused("time_ms: must be a number from 0 to 10000")
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**53:
            raise hand.Refused("number: must be a whole number")
        return number, float(time_ms), eyes

    def _eyes(self, request: Any) -> list[tuple[int, dict[str, Any]]]:
        """The sides of a request and what is asked for on each, yet to be resolved: one may be refused alone."""
        eyes = request.get("eyes") if isinstance(request, dict) else None
        if not isinstance(eyes, list) or not 1 <= len(eyes) <= SIDES:
            raise hand.Refused(f"eyes: 1 to {SIDES} of them")
        if not all(isinstance(one, dict) and one.get("which") in range(SIDES) for one in eyes):
            raise hand.Refused(f"which: 0 to {SIDES - 1}")
        return [(int(one["which"]), one) for one in eyes]

    async def film(self, request: Request) -> Response:
        """Whole films."""
        try:
            eyes = self._eyes(_parsed(await request.body()))
        except hand.Refused as refused:
            return PlainTextResponse(f"{refused}\n", 400)
        return StreamingResponse(self._films(eyes), media_type="application/octet-stream")

    async def _films(self, eyes: list[tuple[int, dict[str, Any]]]):
        runs = []
        for which, one in eyes:
            try:
                eye, run = self.eyes.eye(one), None
                async for message, begun in self._film(which, eye):
                    run = begun or run
                    yield sized(message)
                runs.append((which, eye, run))
            except Exception as problem:
                yield sized(_refusal(problem, which=which))
        yield sized(packed({"kind": "done"}))
        for which, eye, run in runs:
            try:
                fold = await self.kernels.call(hand.fold_of, self.hand, eye, run)
            except Exception as problem:
                fold = _said(problem)  # of the finer run alone: the film stands
            if fold:
                yield sized(packed({"kind": "fold", "which": which, "reason": fold}))

    async def _film(self, which: int, eye: hand.Eye):
        """The messages of one eye, and with the first of them its run."""
        reading = None
        try:
            async for part in self.kernels.pieces(hand.film_of(self.hand, eye)):
                if isinstance(part, hand.Shown):
                    # NumPy alone, so beside the drawing
                    reading = asyncio.ensure_future(run_in_threadpool(hand.parameters_of, part))
                    yield packed({"kind": "run", "which": which, "command": eye.command} | part.told()), part
                else:
                    first, pixels = part
                    yield packed({"kind": "frames", "which": which, "first": first}, pixels.data), None
            yield packed({"kind": "parameters", "which": which, "values": await reading}), None
        finally:
            if reading is not None:
                reading.cancel()


async def _sent(socket: WebSocket, message: bytes) -> bool:
    """Whether a message went out: a tab may have closed its socket, which servers say in ways of their own."""
    try:
        await socket.send_bytes(message)
    except Exception:
        return False
    return True


def _refusal(problem: Exception, **about: int) -> bytes:
    """The message that there is no picture, and why; about: the number of the request and the side of the eye."""
    return packed(about | {"kind": "refused", "reason": _said(problem)})


def _said(problem: Exception) -> str:
    """Why there is no picture; what nobody foresaw goes to the terminal, too."""
    if isinstance(problem, hand.Refused | SceneError):
        return str(problem)
    traceback.print_exception(problem)
    return f"{type(problem).__name__}: {problem}"


def _parsed(text: str | bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise hand.Refused("a request is JSON") from None


async def measured(request: Request) -> Response:
    """A measured history, or the curves of a measured film, from the file that is sent."""
    data, name = await request.body(), request.query_params.get("name", "")
    try:
        return JSONResponse(await run_in_threadpool(laid.read, data, name))
    except SceneError as refused:
        return PlainTextResponse(f"{refused}\n", 400)
