"""A run that is watched: the page sees its newest frame and traces, comes, goes and ends it, and changes nothing."""

import asyncio
import io
import json
import struct
import threading
import urllib.request

import numpy as np
import pytest
from PIL import Image
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

import taichi_eye
from taichi_eye.bench import browser as browsers
from taichi_eye.cli import main
from taichi_eye.page.watch import Watch
from taichi_eye.report.traces import read_traces

WORDS = [
    "numerics.fidelity=cavity",
    "numerics.spacing_mm=0.4",
    "camera.view=scheimpflug",
    "camera.frame_interval_ms=0.1",
]


def look(url, found, leave_after=None):
    """A page in a thread of its own: every message; it goes without a word after so many."""

    async def looking():
        origin = url.rstrip("/")
        async with connect(f"{origin.replace('http', 'ws')}/frames", origin=origin, max_size=None) as socket:
            try:
                while True:
                    data = await socket.recv()
                    length = struct.unpack("<I", data[:4])[0]
                    found.append((json.loads(data[4 : 4 + length]), data[4 + length :]))
                    if leave_after == len(found):
                        socket.transport.abort()
                        return
            except ConnectionClosed:
                pass

    thread = threading.Thread(target=lambda: asyncio.run(looking()), daemon=True)
    thread.start()
    return thread


@pytest.fixture(scope="module")
def scene():
    return taichi_eye.load_scene("seed", [*WORDS, "output.gif=false"])


@pytest.fixture(scope="module")
def alone(scene, tmp_path_factory):
    return taichi_eye.run(scene, tmp_path_factory.mktemp("runs") / "alone")


def test_pages_see_the_run_and_change_nothing(scene, alone, tmp_path):
    stays, goes = [], []
    with Watch() as watch:
        threads = [look(watch.url, stays), look(watch.url, goes, leave_after=2)]
        while not stays:
            threads[0].join(0.01)
        result = taichi_eye.run(scene, tmp_path / "run", watch=watch)
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()
    for column, values in alone.traces.items():
        np.testing.assert_array_equal(result.traces[column], values)
    assert (tmp_path / "run" / "film.mp4").read_bytes() == (alone.folder / "film.mp4").read_bytes()
    heads = [head for head, _ in stays]
    assert heads[0]["state"] == "begun" and heads[-1]["state"] == "complete" and len(goes) == 2
    numbers = [head["frame"] for head in heads if "frame" in head]
    assert numbers == sorted(numbers) and len(set(numbers)) > 2 and heads[-1]["folder"] == str(result.folder)
    head, jpeg = next((head, jpeg) for head, jpeg in stays if head.get("frame", 0) > 3)
    shown = np.asarray(Image.open(io.BytesIO(jpeg)), float)
    film = result.film.frames()[head["frame"], :, :, 1].astype(float)
    assert np.abs(shown - film).mean() < 4 < np.abs(shown - np.roll(film, 12, 0)).mean()
    at = np.searchsorted(result.traces["time_ms"], np.array(head["time_ms"]) - 1e-4)
    np.testing.assert_allclose(head["apex_mm"], result.traces["apex_displacement_mm"][at], atol=1e-5)


def test_the_stop_button_ends_the_run_as_ctrl_c_does(alone, tmp_path):
    words = [word for key in WORDS for word in ("--set", key)]
    with browsers.served("run", "seed", *words, "--watch", "--quiet", "--out", "run", cwd=tmp_path) as (url, process):
        post = urllib.request.Request(f"{url}stop", b"", {"Origin": url.rstrip("/")})
        assert urllib.request.urlopen(post, timeout=30).status == 200
        said = process.communicate(timeout=120)[1]
    assert process.returncode == 130 and "interrupted" in said and "--resume run" in said
    folder = tmp_path / "run"
    assert json.loads((folder / "summary.json").read_text())["status"] == "stopped"
    assert {"film.mp4", "report.html", "traces.csv", ".run"} <= {path.name for path in folder.iterdir()}
    result = taichi_eye.resume(folder)
    assert result.summary["status"] == "complete"
    for column, values in read_traces(folder / "traces.csv").items():
        np.testing.assert_array_equal(values, alone.traces[column])


def test_an_address_without_a_page_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "quick", "--port", "8123"]) == 2
    assert "--watch" in capsys.readouterr().err
    assert main(["run", "quick", "--watch", "--host", "no.such.host.invalid"]) == 2
    said = capsys.readouterr().err
    assert "no.such.host.invalid" in said and len(said.splitlines()) == 1 and not list(tmp_path.iterdir())


@pytest.mark.skipif(bool(browsers.missing()), reason=browsers.missing())
def test_the_page_shows_the_run_and_its_button_ends_it(tmp_path):
    words = [
        "--set",
        "numerics.fidelity=cavity",
        "--set",
        "camera.frame_interval_ms=0.01",
        "--set",
        "camera.view=scheimpflug",
    ]
    with browsers.served("run", "seed", *words, "--watch", "--quiet", "--out", "run", cwd=tmp_path) as (url, process):
        with browsers.browser() as one:
            tab, closed = browsers.Tab(one, url), browsers.Tab(one, url)
            closed.page.close()
            tab.page.wait_for_selector("body[data-frame]")
            first = int(tab.page.evaluate("document.body.dataset.frame"))
            picture = tab.page.evaluate("document.getElementById('film').toDataURL()")
            while int(tab.page.evaluate("document.body.dataset.frame")) < first + 300:
                tab.page.wait_for_timeout(20)
            assert tab.page.evaluate("document.getElementById('film').toDataURL()") != picture
            tab.page.locator("#stop").click()
            tab.page.wait_for_selector("body[data-state=ended]")
            assert "interrupted" in tab.page.locator("#state").inner_text() and tab.wrong == []
        process.communicate(timeout=120)
    assert process.returncode == 130
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["status"] == "stopped"
