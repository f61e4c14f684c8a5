"""An address, and a server on it: in front, until Ctrl-C, or in a thread behind the work."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import uvicorn

from taichi_eye.errors import SceneError
from taichi_eye.page.guard import Guard

LOOPBACK = "127.0.0.1"
MESSAGE_BYTES = 65536  # of a socket, from the browser
PARTING_S = 1  # that open sockets may take to close


class Address:
    """A bound port. hosts: its names; url: what a browser opens.

    host: of the network interface, the loopback one unless told otherwise; port: 0 for a free one.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 0):
        try:
            self.socket = socket.create_server((host, port))
        except OSError as error:
            raise SceneError(
                f"--host {host} --port {port}: cannot be taken ({error.strerror or error}); leave --port out for a "
                "free one"
            ) from None
        self.port = self.socket.getsockname()[1]
        self.hosts = {f"{host}:{self.port}"}
        if host == LOOPBACK:
            self.hosts.add(f"localhost:{self.port}")
        self.url = f"http://{host}:{self.port}/"

    def serve(self, app) -> None:
        """Serve until Ctrl-C."""
        self._server(app).run([self.socket])

    def behind(self, app, begin: Callable[[], None] = lambda: None) -> Behind:
        """Serve in a thread of its own, which calls `begin` first."""
        return Behind(self._server(app), self.socket, begin)

    def _server(self, app) -> uvicorn.Server:
        return uvicorn.Server(
            uvicorn.Config(
                Guard(app, self.hosts),
                lifespan="off",
                log_level="error",
                access_log=False,
                server_header=False,
                ws_max_size=MESSAGE_BYTES,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=PARTING_S,
            )
        )


class Behind:
    """A server in a thread; `stop` ends it, and so does the end of the process."""

    def __init__(self, server: uvicorn.Server, bound: socket.socket, begin: Callable[[], None]):
        self._server, self._socket = server, bound

        def serve():
            begin()
            server.run([bound])

        self._thread = threading.Thread(target=serve, name="page", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; open sockets get PARTING_S."""
        self._server.should_exit = True
        self._thread.join(PARTING_S + 2)
        self._socket.close()
