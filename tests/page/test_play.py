"""The page's server: what a tab asks for is what it gets, its newest request alone, and no tab gets another's."""

import asyncio
import contextlib
import json
import struct
import threading
import time

import numpy as np
import pytest
from starlette.testclient import TestClient
from websockets.asyncio.client import connect

from taichi_eye.page import hand, play
from taichi_eye.page.files import STATIC
from taichi_eye.page.guard import Guard
from taichi_eye.page.server import Address
from taichi_eye.page.thread import Kernels
from taichi_eye.scene import load_scene

HERE = "127.0.0.1:8123"
OWN = {"origin": f"http://{HERE}"}
TABS = 20


class Drawn(hand.Hand):
    """A hand without the kernel language: every frame shows the pressure of its eye, in every pixel.

    held: runs wait for it where it is set up so; ran: the pressures of the eyes that were run.
    """

    def __init__(self):
        super().__init__()
        self.ran, self.threads, self.held = [], set(), None

    def run(self, scene, elements, until_ms=None):
        self.threads.add(threading.get_ident())
        self.ran.append(scene.eye.iop_mmhg)
        if self.held is not None:
            assert self.held.wait(10)
        time_ms = np.arange(30) * scene.camera.frame_interval_ms
        still = np.zeros(30)
        wall = np.zeros((30, 12, 2))
        wall[:, :, 0] = np.linspace(0.0, 5.8e-3, 12)
        return hand.Shown(scene, time_ms, wall, still, still + scene.eye.iop_mmhg, still)

    def frames(self, shown, numbers):
        self.threads.add(threading.get_ident())
        return np.full((len(numbers), 4, 6), round(shown.scene.eye.iop_mmhg), np.uint8)


@pytest.fixture
def page():
    kernels = Kernels(lambda: None)
    page = play.Play(hand.load("seed", [], ("corvis_healthy",)), kernels)
    page.hand = Drawn()
    yield page
    kernels.close()


@pytest.fixture
def client(page):
    return TestClient(Guard(page.app, {HERE}), base_url=f"http://{HERE}")


def request(number, kind="film", iop=15, time_ms=5.0, which=0, scene="seed"):
    eyes = [{"which": which, "scene": scene, "values": {"iop": iop}}]
    return json.dumps({"number": number, "kind": kind, "time_ms": time_ms, "eyes": eyes})


def unpacked(data):
    length = struct.unpack("<I", data[:4])[0]
    return json.loads(data[4 : 4 + length]), np.frombuffer(data[4 + length :], np.uint8)


def answer(socket):
    """All messages up to the end of a request."""
    found = []
    while not found or found[-1][0]["kind"] not in ("done", "refused"):
        found.append(unpacked(socket.receive_bytes()))
    return found


def test_a_film_is_its_run_its_frames_in_order_and_its_parameters(client):
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as socket:
        socket.send_text(request(7, iop=21))
        messages = answer(socket)
    kinds = [head["kind"] for head, _ in messages]
    assert kinds == ["run", "frames", "frames", "frames", "parameters", "done"]
    assert {head["number"] for head, _ in messages} == {7}
    assert messages[0][0]["command"] == "taichi-eye run seed --set eye.iop_mmhg=21.0"
    assert [head["first"] for head, _ in messages[1:4]] == [0, 12, 24]
    pixels = np.concatenate([pixels for _, pixels in messages[1:4]])
    assert len(pixels) == 30 * 24 and (pixels == 21).all()


def test_a_frame_while_dragging_comes_with_the_history_so_far(client):
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as socket:
        socket.send_text(request(1, "frame", iop=9))
        (head, pixels), _ = answer(socket)
    assert head["kind"] == "frame" and (pixels == 9).all() and len(pixels) == 24 and len(head["time_ms"]) == 30


def test_of_a_tab_the_newest_request_alone_is_computed(page, client):
    page.hand.held = threading.Event()
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as socket:
        for number in range(1, 41):
            socket.send_text(request(number, iop=5 + number))
        while not page.hand.ran:
            time.sleep(0.001)
        time.sleep(0.2)  # all of them have come in by now
        page.hand.held.set()
        messages = answer(socket)
    assert messages[-1][0] == {"number": 40, "kind": "done"}
    assert page.hand.ran[-1] == 45 and len(page.hand.ran) <= 3
    # nothing of a request that was overtaken comes after the newest has begun
    numbers = [head["number"] for head, _ in messages]
    assert numbers == sorted(numbers)


@pytest.mark.parametrize(
    "text, said",
    [
        ("{", "JSON"),
        ("[" * 5000, "JSON"),
        ("[]", "frame or a film"),
        (request(1, "stop"), "frame or a film"),
        (request(1, time_ms=-1), "time_ms"),
        (request(1, time_ms=1e9), "time_ms"),
        (request(1, which=2), "which"),
        (request(1, iop=101), "eye.iop_mmhg = 101.0: must be a number in mmHg, >= 1 and <= 100"),
        (request(-1), "number"),
        (json.dumps({"number": 1, "kind": "film", "time_ms": 1, "eyes": [{}, {}, {}]}), "eyes: 1 to 2"),
        (json.dumps({"number": 1, "kind": "film", "time_ms": 1, "eyes": [3]}), "which"),
    ],
)
def test_a_request_that_is_none_is_refused_and_the_tab_lives_on(client, text, said):
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as socket:
        socket.send_text(text)
        (head, _) = answer(socket)[-1]
        assert head["kind"] == "refused" and said in head["reason"]
        socket.send_text(request(2, "frame"))
        assert answer(socket)[-1][0] == {"number": 2, "kind": "done"}


def test_the_scene_that_is_saved_is_the_one_that_is_shown(client, tmp_path):
    asked = {"scene": "corvis_healthy", "values": {"iop": 22.5, "thickness": 0.6, "stiffness": 0.8}}
    saved = client.post("/scene", json=asked, headers=OWN)
    assert saved.status_code == 200 and "attachment" in saved.headers["content-disposition"]
    (tmp_path / "my_eye.toml").write_bytes(saved.content)
    assert load_scene(tmp_path / "my_eye.toml") == hand.load("corvis_healthy", [], ()).eye(asked).scene
    assert load_scene(tmp_path / "my_eye.toml").numerics.fidelity == "mfpm"
    refused = client.post("/scene", json=asked | {"values": {"iop": 0}}, headers=OWN)
    assert refused.status_code == 400 and "eye.iop_mmhg" in refused.text
    assert client.post("/scene", content=b"\xff", headers=OWN).status_code == 400


def test_a_measured_history_is_read_as_compare_reads_it(client):
    draw = np.random.default_rng()
    time_ms, depth = np.linspace(0, 30, 40), 0.5 + draw.random()
    table = "time_ms,deflection_mm\n" + "".join(
        f"{t},{depth * np.exp(-(((t - 16) / 5) ** 2))}\n" for t in time_ms.tolist()
    )
    told = client.post("/measured?name=eye%201.csv", content=table.encode(), headers=OWN).json()
    assert told["name"] == "eye 1.csv" and told["column"] == "deflection_mm"
    assert max(told["displacement_mm"]) == pytest.approx(depth, rel=0.01) and len(told["time_ms"]) == 40
    for name in ("../../etc/passwd", "<img src=x onerror=alert(1)>", "", "a" * 500, "/dev/null", ".."):
        refused = client.post("/measured", params={"name": name}, content=b"what,ever\n1,2\n", headers=OWN)
        assert refused.status_code == 400 and "time_ms" in refused.text and "/" not in refused.text.split(":")[0]
    assert client.post("/measured", content=b"0" * 100_000_000, headers=OWN).status_code == 413


@pytest.mark.parametrize(
    "path", ["/static/../hand.py", "/static/%2e%2e/hand.py", "/../../etc/passwd", "/hand.py", "/docs"]
)
def test_nothing_but_its_own_pages_is_served(client, path):
    answer = client.get(path)
    assert answer.status_code == 404 and "import" not in answer.text


def test_the_page_and_all_that_it_names_are_served_by_itself(client):
    for name in ("play", "watch"):
        text = (STATIC / f"{name}.html").read_text()
        assert "//" not in text.replace("<!doctype", "") and "style=" not in text and " onclick" not in text
    assert client.get("/").status_code == 200
    for path in STATIC.iterdir():
        assert client.get(f"/static/{path.name}").status_code == 200
    offer = client.get("/eyes").json()
    assert [scene["name"] for scene in offer["scenes"]] == ["seed", "corvis_healthy"]
    assert {slider["name"] for slider in offer["sliders"]} == set(hand.SLIDERS)


def test_many_tabs_get_each_its_own_and_those_that_vanish_harm_nobody(page):
    address = Address()
    behind = address.behind(lambda: page.app)
    url = f"ws://127.0.0.1:{address.port}/hand"

    async def tab(number):
        async with connect(url, origin=f"http://127.0.0.1:{address.port}", max_size=None, compression=None) as socket:
            for turn in range(4):
                iop = 5 + number + 20 * turn
                await socket.send(request(turn, iop=iop))
                if number % 2 and turn == 2:
                    socket.transport.abort()
                    return None
                kinds, pixels = [], []
                while "done" not in kinds:
                    head, frame = unpacked(await socket.recv())
                    kinds.append(head["kind"])
                    pixels.append(frame)
                pixels = np.concatenate(pixels)
                assert len(pixels) == 30 * 24 and (pixels == iop).all()
            return number

    async def all_tabs():
        return await asyncio.wait_for(asyncio.gather(*(tab(number) for number in range(TABS))), 60)

    try:
        found = asyncio.run(all_tabs())
        assert [number for number in found if number is not None] == list(range(0, TABS, 2))
        assert len(page.hand.threads) == 1
        # a tab of another origin is not even let in
        with contextlib.suppress(Exception):
            asyncio.run(_open(url, "http://evil.example"))
            pytest.fail("another origin was let in")
    finally:
        behind.stop()


async def _open(url, origin):
    async with connect(url, origin=origin) as socket:
        await socket.recv()
