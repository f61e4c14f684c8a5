"""An address, and a server on it: in front, until Ctrl-C, or in a thread behind the work.

The web framework is loaded where it serves: behind the work in that thread, while the work goes on.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from typing import Any

from taichi_eye.errors import SceneError

LOOPBACK = "127.0.0.1"
EVERYWHERE = "0.0.0.0"  # no name by which a request could be told from a foreign one
HTTP_PORT = 80  # that browsers leave out
CONNECTIONS = 64  # at a time; what comes on top is told that the server is busy
MESSAGE_BYTES = 65536  # of a socket, from the browser
PARTING_S = 1  # that open sockets may take to close


class Address:
    """A bound port. hosts: its names; url: what a browser opens.

    host: of the network interface, the loopback one unless told otherwise; port: 0 for a free one.
    """

    def __init__(self, host: str | None = None, port: int | None = None):
        host, port = host or LOOPBACK, port or 0
        if ":" in host:
            raise SceneError(f"--host {host}: must be an IPv4 address or a name")
        try:
            self.socket = socket.create_server((host, port))
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SceneError(
                f"--host {host} --port {port or 'of any number'}: cannot be taken ({reason}); leave --port out for a "
                "free one, --host for this machine alone"
            ) from None
        bound, self.port = self.socket.getsockname()
        if bound == EVERYWHERE:  # which has many spellings
            self.socket.close()
            raise SceneError(f"--host {host}: name the one address by which browsers reach this machine")
        self.hosts = names(host, bound, self.port)
        self.url = f"http://{host}:{self.port}/"

    def serve(self, app) -> None:
        """Serve until Ctrl-C."""
        _server(app, self.hosts).run([self.socket])

    def behind(self, make: Callable[[], Any]) -> Behind:
        """Serve what `make` makes in a thread of its own, where it is made, too."""
        return Behind(make, self)


def names(host: str, bound: str, port: int) -> set[str]:
    """What browsers may call an address in Host: the host as it was named, and the number that was bound for it."""
    hosts = {host.lower(), bound} | ({"localhost"} if bound == LOOPBACK else set())
    return {f"{each}:{port}" for each in hosts} | (hosts if port == HTTP_PORT else set())


def _server(app, hosts):
    import uvicorn

    from taichi_eye.page.guard import Guard

    return uvicorn.Server(
        uvicorn.Config(
            Guard(app, hosts),
            lifespan="off",
            log_level="error",
            access_log=False,
            server_header=False,
            ws="websockets-sansio" if _sansio() else "auto",
            ws_max_size=MESSAGE_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=PARTING_S,
            limit_concurrency=CONNECTIONS,
        )
    )


def _sansio() -> bool:
    """Whether this uvicorn has the implementation that the newer websockets no longer warn of."""
    from importlib.util import find_spec

    return find_spec("uvicorn.protocols.websockets.websockets_sansio_impl") is not None


class Behind:
    """A server in a thread; `stop` ends it, and so does the end of the process."""

    def __init__(self, make: Callable[[], Any], address: Address):
        self._server, self._address, self._ended = None, address, False

        def serve():
            server = _server(make(), address.hosts)
            self._server = server
            if not self._ended:
                server.run([address.socket])

        self._thread = threading.Thread(target=serve, name="page", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; open sockets get PARTING_S."""
        self._ended = True
        if self._server is not None:
            self._server.should_exit = True
        self._thread.join(PARTING_S + 2)
        self._address.socket.close()
