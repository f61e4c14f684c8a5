"""Who is answered: own pages from own addresses, bodies of bounded size; everybody else is refused."""

import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from taichi_eye.errors import SceneError
from taichi_eye.page.guard import BODY_BYTES, Guard
from taichi_eye.page.server import Address, names

HERE = "127.0.0.1:8123"
OWN = {"origin": f"http://{HERE}"}


async def taken(request):
    return PlainTextResponse(str(len(await request.body())))


async def hello(socket):
    await socket.accept()
    await socket.send_text("hello")
    await socket.close()


@pytest.fixture(scope="module")
def client():
    routes = [Route("/", taken, methods=["GET", "POST"]), WebSocketRoute("/socket", hello)]
    return TestClient(Guard(Starlette(routes=routes), {HERE}), base_url=f"http://{HERE}")


def test_own_pages_are_answered_and_every_answer_carries_its_fence(client):
    for answer in (client.get("/"), client.post("/", content=b"12345", headers=OWN), client.get("/nothing")):
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy and "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in answer.headers
    assert client.post("/", content=b"12345", headers=OWN).text == "5"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1:8124", "127.0.0.1", "localhost.evil.example:8123", ""])
def test_a_foreign_name_that_points_here_is_refused(client, host):
    answer = client.get("/", headers={"host": host})
    assert answer.status_code == 421 and "127.0.0.1:8123" in answer.text


def test_the_port_that_browsers_leave_out_is_left_out_of_the_name():
    assert names("127.0.0.1", "127.0.0.1", 80) == {"127.0.0.1:80", "localhost:80", "127.0.0.1", "localhost"}
    assert names("Eye.Example", "192.0.2.7", 8000) == {"eye.example:8000", "192.0.2.7:8000"}
    client = TestClient(
        Guard(Starlette(routes=[Route("/", taken, methods=["POST"])]), names("a.example", "192.0.2.7", 80))
    )
    for own in ("a.example", "192.0.2.7"):
        assert client.post("/", headers={"host": own, "origin": f"http://{own}"}).status_code == 200
    assert client.post("/", headers={"host": "b.example", "origin": "http://b.example"}).status_code == 421


@pytest.mark.parametrize(
    "host, said",
    [
        ("0.0.0.0", "the one address"),
        ("0", "the one address"),
        ("0.0", "the one address"),
        ("::1", "an IPv4 address"),
        ("::", "an IPv4"),
    ],
)
def test_a_host_that_is_every_one_or_none_is_refused(host, said):
    with pytest.raises(SceneError, match=said):
        Address(host)


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://127.0.0.1:8123"},
        {"origin": "http://127.0.0.1:8124"},
        {},
        {**OWN, "sec-fetch-site": "cross-site"},
    ],
)
def test_what_another_origin_sends_is_refused(client, headers):
    assert client.post("/", content=b"x", headers=headers).status_code == 403
    with pytest.raises(WebSocketDisconnect):
        with client.websocket_connect(f"ws://{HERE}/socket", headers=headers):
            pass


def test_another_site_may_link_here_and_load_nothing_from_here(client):
    told = {"sec-fetch-site": "cross-site"}
    assert client.get("/", headers=told | {"sec-fetch-mode": "navigate"}).status_code == 200
    for mode in ("no-cors", "cors", "same-origin"):
        assert client.get("/", headers=told | {"sec-fetch-mode": mode}).status_code == 403
    assert client.get("/", headers={"origin": "http://evil.example"}).status_code == 403


def test_own_sockets_open(client):
    with client.websocket_connect(f"ws://{HERE}/socket", headers=OWN) as socket:
        assert socket.receive_text() == "hello"


def test_a_large_body_is_refused_by_what_it_says(client):
    answer = client.post("/", content=b"x", headers=OWN | {"content-length": str(100_000_000)})
    assert answer.status_code == 413 and "4 MB" in answer.text
    assert client.post("/", content=b"x", headers=OWN | {"content-length": "many"}).status_code == 413


def test_a_large_body_that_says_nothing_is_refused_while_it_streams_in(client):
    sent = []

    def stream():
        for _ in range(100):
            sent.append(1)
            yield b"0" * (BODY_BYTES // 10)

    assert client.post("/", content=stream(), headers=OWN).status_code == 413
    exact = (b"0" * (BODY_BYTES // 10) for _ in range(10))
    assert client.post("/", content=exact, headers=OWN).text == str(BODY_BYTES)
