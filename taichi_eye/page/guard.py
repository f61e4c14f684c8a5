"""Who is answered: requests for this address from its own pages, with bodies of bounded size.

A page is served to whoever may reach the address, by default the programs of this machine. What a browser brings along
from elsewhere is refused: a name other than this address in Host (a foreign name that was made to point here), an
Origin other than our own on anything, none on what changes something or opens a socket, and whatever the browser itself
says comes from another site, unless that is only a link that was followed. Bodies over BODY_BYTES are refused by what
they say they hold, and while they stream in where they say nothing or less.
"""

from __future__ import annotations

from collections.abc import Collection

from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse

BODY_BYTES = 4_000_000
SAFE = "GET", "HEAD"


def headers(hosts: Collection[str]) -> dict[str, str]:
    """What every answer carries: scripts, styles and sockets from here alone, no frame around it, nothing kept."""
    sockets = " ".join(f"ws://{host}" for host in sorted(hosts))
    return {
        "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }


class Guard:
    """An ASGI application in front of one of Starlette; hosts: its own names and ports, as in "127.0.0.1:8000"."""

    def __init__(self, app, hosts: Collection[str]):
        self.app, self.hosts = app, frozenset(hosts)
        self.origins = frozenset(f"http://{host}" for host in hosts)
        self.added = [(name.lower().encode(), value.encode()) for name, value in headers(hosts).items()]

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        told = {name: value.decode("latin-1") for name, value in scope["headers"]}
        refused = self.refusal(scope, told)
        if scope["type"] == "websocket":
            if refused:
                await send({"type": "websocket.close", "code": 1008, "reason": refused[1]})
            else:
                await self.app(scope, receive, send)
            return
        answering = self._answering(send)
        if refused:
            status, reason = refused
            await PlainTextResponse(f"{reason}\n", status)(scope, receive, answering)
            return
        await self.app(scope, _bounded(receive), answering)

    def refusal(self, scope, told: dict[bytes, str]) -> tuple[int, str] | None:
        """Status and reason where a request is not answered."""
        if told.get(b"host", "").lower() not in self.hosts:
            return 421, f"this is {' or '.join(sorted(self.hosts))} and no other host"
        origin = told.get(b"origin")
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE
        if (origin is None and changes) or (origin is not None and origin not in self.origins):
            return 403, "requests are taken from the pages of this address only"
        site, mode = told.get(b"sec-fetch-site", "none"), told.get(b"sec-fetch-mode", "navigate")
        if site not in ("none", "same-origin") and (changes or mode != "navigate"):
            return 403, "requests are taken from the pages of this address only"
        length = told.get(b"content-length")
        if length is not None and (not length.isdecimal() or int(length) > BODY_BYTES):
            return 413, _too_large()
        return None

    def _answering(self, send):
        async def answer(message):
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *self.added]}
            await send(message)

        return answer


def _too_large() -> str:
    return f"at most {BODY_BYTES / 1e6:g} MB can be sent"


def _bounded(receive):
    """`receive` that ends in a refusal, which Starlette turns into an answer, once a body goes on beyond its bound."""
    taken = 0

    async def bounded():
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        if taken > BODY_BYTES:
            raise HTTPException(413, _too_large())
        return message

    return bounded
