"""The page's server: what a tab asks for is what it gets, its newest request alone, and no tab gets another's."""

import asyncio
import contextlib
import io
import json
import socket
import struct
import threading
import time

import httpx
import numpy as np
import pytest
from starlette.testclient import TestClient
from websockets.asyncio.client import connect

from taichi_eye.analysis.report import FAR
from taichi_eye.film.display import gain_of
from taichi_eye.page import hand, play
from taichi_eye.page.files import STATIC
from taichi_eye.page.guard import Guard
from taichi_eye.page.server import CONNECTIONS, Address
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


def request(number=0, iop=15, time_ms=5.0, which=0, scene="seed"):
    eyes = [{"which": which, "scene": scene, "values": {"iop": iop}}]
    return json.dumps({"number": number, "time_ms": time_ms, "eyes": eyes})


def unpacked(data):
    length = struct.unpack("<I", data[:4])[0]
    return json.loads(data[4 : 4 + length]), np.frombuffer(data[4 + length :], np.uint8)


def messages(stream):
    """The messages of a whole stream."""
    found = []
    while stream:
        length = struct.unpack("<I", stream[:4])[0]
        found.append(unpacked(stream[4 : 4 + length]))
        stream = stream[4 + length :]
    return found


def test_a_film_is_its_run_its_frames_in_order_and_its_parameters(client):
    answer = client.post("/film", content=request(iop=21, which=1), headers=OWN)
    found = messages(answer.content)
    kinds = [head["kind"] for head, _ in found]
    assert kinds == ["run", "frames", "frames", "frames", "parameters", "done"]
    assert {head["which"] for head, _ in found[:-1]} == {1}
    assert found[0][0]["command"] == "taichi-eye run seed --set eye.iop_mmhg=21.0"
    assert [head["first"] for head, _ in found[1:4]] == [0, 12, 24]
    pixels = np.concatenate([pixels for _, pixels in found[1:4]])
    assert len(pixels) == 30 * 24 and (pixels == 21).all()


def test_two_eyes_are_two_films_one_after_the_other(client):
    eyes = [{"which": k, "scene": name, "values": {"iop": 12 + k}} for k, name in enumerate(("seed", "corvis_healthy"))]
    found = messages(client.post("/film", json={"eyes": eyes}, headers=OWN).content)
    for which in (0, 1):
        pixels = np.concatenate([pixels for head, pixels in found if head.get("which") == which])
        assert (pixels == 12 + which).all() and len(pixels) == 30 * 24
    assert [head["kind"] for head, _ in found].count("done") == 1


def test_a_frame_while_dragging_comes_with_the_history_so_far(client):
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as tab:
        tab.send_text(request(3, iop=9))
        head, pixels = unpacked(tab.receive_bytes())
    assert head["kind"] == "frame" and head["number"] == 3 and len(head["time_ms"]) == 30
    assert head["command"] == "taichi-eye run seed --set eye.iop_mmhg=9.0"
    assert (pixels == 9).all() and len(pixels) == 24


def test_of_a_tab_the_newest_request_alone_is_computed(page, client):
    page.hand.held = threading.Event()
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as tab:
        for number in range(1, 41):
            tab.send_text(request(number, iop=5 + number))
        while not page.hand.ran:
            time.sleep(0.001)
        time.sleep(0.2)  # all of them have come in by now
        page.hand.held.set()
        numbers = []
        while not numbers or numbers[-1] != 40:
            numbers.append(unpacked(tab.receive_bytes())[0]["number"])
    assert numbers == sorted(numbers) and page.hand.ran[-1] == 45 and len(page.hand.ran) <= 3


NO_REQUEST = [
    ("{", "JSON"),
    ("[" * 5000, "JSON"),
    ("[]", "eyes: 1 to 2"),
    (request(which=2), "which"),
    (json.dumps({"number": 1, "time_ms": 1, "eyes": [{}, {}, {}]}), "eyes: 1 to 2"),
    (json.dumps({"number": 1, "time_ms": 1, "eyes": [3]}), "which"),
]
NO_EYE = [
    (request(iop=101, which=1), "eye.iop_mmhg = 101.0: must be a number in mmHg, >= 1 and <= 100"),
    (request(scene="/etc/passwd", which=1), "there are seed, corvis_healthy"),
]
OF_FRAMES = [(request(1, time_ms=-1), "time_ms"), (request(1, time_ms=1e9), "time_ms"), (request(-1), "number")]


@pytest.mark.parametrize("text, said", NO_REQUEST + NO_EYE + OF_FRAMES)
def test_a_request_that_is_none_is_refused_and_the_tab_lives_on(client, text, said):
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as tab:
        tab.send_text(text)
        head, _ = unpacked(tab.receive_bytes())
        assert head["kind"] == "refused" and said in head["reason"]
        assert head.get("which") == (1 if (text, said) in NO_EYE else None)
        tab.send_text(request(2))
        assert unpacked(tab.receive_bytes())[0]["kind"] == "frame"
    if (text, said) in NO_REQUEST:
        answer = client.post("/film", content=text, headers=OWN)
        assert answer.status_code == 400 and said in answer.text


@pytest.mark.parametrize("bad", [0, 1])
def test_an_eye_that_is_refused_leaves_the_other_its_film(client, bad):
    eyes = [{"which": which, "scene": "seed", "values": {"iop": 500 if which == bad else 30}} for which in (0, 1)]
    heads = [head for head, _ in messages(client.post("/film", json={"eyes": eyes}, headers=OWN).content)]
    of = {which: [head["kind"] for head in heads if head.get("which") == which] for which in (0, 1)}
    assert of == {bad: ["refused"], 1 - bad: ["run", "frames", "frames", "frames", "parameters"]}
    assert heads[-1]["kind"] == "done" and "eye.iop_mmhg" in next(h["reason"] for h in heads if h["kind"] == "refused")
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as tab:
        tab.send_text(json.dumps({"number": 1, "time_ms": 1, "eyes": eyes}))
        found = [unpacked(tab.receive_bytes())[0] for _ in eyes]
    assert [head["kind"] for head in found] == [("refused" if which == bad else "frame") for which in (0, 1)]


def test_a_tab_that_went_away_while_its_answer_was_computed_is_left(page):
    class Gone:
        async def send_bytes(self, data):
            raise RuntimeError('Cannot call "send" once a close message has been sent.')

    async def answered(text):
        asked = asyncio.Event()
        asked.set()
        await asyncio.wait_for(page._answer(Gone(), [text], asked), 10)

    for text in ("{", request(), request(iop=500)):
        asyncio.run(answered(text))


def test_what_nobody_foresaw_is_said_in_the_page_and_on_the_terminal(page, client, capfd):
    whole, page.hand.run = page.hand.run, lambda *_: 1 / 0
    with client.websocket_connect(f"ws://{HERE}/hand", headers=OWN) as tab:
        tab.send_text(request(1))
        assert "ZeroDivisionError" in unpacked(tab.receive_bytes())[0]["reason"]
        found = messages(client.post("/film", content=request(), headers=OWN).content)
        assert [head["kind"] for head, _ in found] == ["refused", "done"] and "Traceback" in capfd.readouterr().err
        page.hand.run = whole
        tab.send_text(request(2))
        assert unpacked(tab.receive_bytes())[0]["kind"] == "frame"


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
    for name in (
        "../../etc/passwd",
        "<img src=x onerror=alert(1)>",
        "",
        "a" * 500,
        "\U00020000" * 80,
        "/dev/null",
        "..",
    ):
        refused = client.post("/measured", params={"name": name}, content=b"what,ever\n1,2\n", headers=OWN)
        assert refused.status_code == 400 and "time_ms" in refused.text and "/" not in refused.text.split(":")[0]
    assert client.post("/measured", content=b"0" * 100_000_000, headers=OWN).status_code == 413


def npz(**arrays):
    held = io.BytesIO()
    np.savez_compressed(held, **arrays)
    return held.getvalue()


def test_the_curves_of_a_measured_film_are_laid_over(client):
    time_ms, x = np.linspace(0, 30, 50), np.linspace(-4, 4, 81)
    height = -(x**2) / 16 - time_ms[:, None] / 100
    height[3, 5] = np.nan
    told = client.post(
        "/measured?name=edges.npz", content=npz(curve_time_ms=time_ms, x_mm=x, height_mm=height), headers=OWN
    ).json()
    np.testing.assert_allclose(told["x_mm"], x, atol=1e-4)
    assert told["height_mm"][3][5] is None and told["height_mm"][3][6] == pytest.approx(height[3, 6], abs=1e-4)
    for bad in (
        b"PK\3\4 no archive",
        npz(x_mm=x),
        npz(curve_time_ms=time_ms, x_mm=x, height_mm=height.T),
        npz(curve_time_ms=time_ms, x_mm=x, height_mm=height * 1e6),
        npz(curve_time_ms=np.array([object()] * 50), x_mm=x, height_mm=height),
        npz(curve_time_ms=time_ms, x_mm=x, height_mm=np.zeros((3000, 3000))),
    ):
        refused = client.post("/measured?name=edges.npz", content=bad, headers=OWN)
        assert refused.status_code == 400 and refused.text.startswith("edges.npz: ")


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
    assert offer["far"] == FAR and [one["gain"] for one in offer["scenes"]] == [
        gain_of(load_scene(one["name"])) for one in offer["scenes"]
    ]


def test_many_tabs_get_each_its_own_and_those_that_vanish_harm_nobody(page):
    address = Address()
    behind = address.behind(lambda: page.app)
    origin = f"http://127.0.0.1:{address.port}"
    url = f"ws://127.0.0.1:{address.port}/hand"

    async def tab(number, web):
        async with connect(url, origin=origin, max_size=None, compression=None) as socket:
            for turn in range(4):
                iop = 5 + number + 20 * turn
                await socket.send(request(turn, iop=iop))
                head, pixels = unpacked(await socket.recv())
                assert head["number"] == turn and (pixels == iop).all()
                asked = web.stream("POST", f"{origin}/film", content=request(iop=iop), headers={"Origin": origin})
                async with asked as answer:
                    if number % 2 and turn == 2:  # the tab is closed in the midst of a film
                        await anext(answer.aiter_raw())
                        socket.transport.abort()
                        return None
                    found = messages(b"".join([part async for part in answer.aiter_raw()]))
                pixels = np.concatenate([pixels for head, pixels in found if head["kind"] == "frames"])
                assert len(pixels) == 30 * 24 and (pixels == iop).all() and found[-1][0]["kind"] == "done"
            return number

    async def all_tabs():
        async with httpx.AsyncClient(timeout=60, limits=httpx.Limits(max_connections=None)) as web:
            return await asyncio.wait_for(asyncio.gather(*(tab(number, web) for number in range(TABS))), 60)

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


def test_a_film_that_is_broken_off_is_not_drawn_to_its_end(page):
    drawn, going = [], threading.Event()

    def frames(shown, numbers):
        drawn.append(numbers)
        assert going.wait(10)
        return np.zeros((len(numbers), 200, 576), np.uint8)

    page.hand.frames = frames
    address = Address()
    behind = address.behind(lambda: page.app)
    origin = f"http://127.0.0.1:{address.port}"
    try:
        with httpx.stream("POST", f"{origin}/film", content=request(), headers={"Origin": origin}) as answer:
            assert answer.status_code == 200
            while not drawn:
                time.sleep(0.001)
        time.sleep(0.3)  # the server has heard of it by now
        going.set()
        time.sleep(0.3)
        assert len(drawn) == 1
        with httpx.stream("POST", f"{origin}/film", content=request(), headers={"Origin": origin}) as answer:
            assert messages(answer.read())[-1][0]["kind"] == "done" and len(drawn) == 4
    finally:
        behind.stop()


def test_more_connections_than_are_served_are_told_so(page):
    address = Address()
    behind = address.behind(lambda: page.app)
    held = []
    try:
        assert httpx.get(address.url).status_code == 200
        held += [socket.create_connection(("127.0.0.1", address.port)) for _ in range(CONNECTIONS)]
        assert httpx.get(address.url).status_code == 503
    finally:
        for one in held:
            one.close()
        behind.stop()


async def _open(url, origin):
    async with connect(url, origin=origin) as socket:
        await socket.recv()
