"""A run that is watched: the page sees its newest frame and traces, comes, goes and ends it, and changes nothing."""

import asyncio
import io
import json
import signal
import struct
import threading
import time
import urllib.request

import numpy as np
import pytest
from PIL import Image
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

import taichi_eye
from taichi_eye.bench import browser as browsers
from taichi_eye.cli import main
from taichi_eye.errors import Interrupted
from taichi_eye.page import needs
from taichi_eye.page.watch import POINTS, Watch, _plotted
from taichi_eye.report.traces import read_traces

WORDS = {
    "numerics.fidelity": "cavity",
    "numerics.spacing_mm": 0.4,
    "numerics.duration_ms": 7,
    "camera.view": "scheimpflug",
    "camera.frame_interval_ms": 0.25,
    "output.gif": "false",
}


class Slow(Watch):
    """As slow as a run that is worth watching."""

    def frame(self, moment):
        super().frame(moment)
        time.sleep(0.03)


class Pressed(Watch):
    """Its stop button is pressed at the fifth frame."""

    def frame(self, moment):
        super().frame(moment)
        if moment.frame == 5:
            press(self.url)


def press(url):
    post = urllib.request.Request(f"{url}stop", b"", {"Origin": url.rstrip("/")})
    assert urllib.request.urlopen(post, timeout=30).status == 200


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
    return taichi_eye.load_scene("seed", [f"{key}={value}" for key, value in WORDS.items()])


@pytest.fixture(scope="module")
def alone(scene, tmp_path_factory):
    return taichi_eye.run(scene, tmp_path_factory.mktemp("runs") / "alone")


def test_pages_see_the_run_and_change_nothing(scene, alone, tmp_path):
    stays, goes = [], []
    with Slow() as watch:
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


def test_the_stop_button_ends_the_run_as_ctrl_c_does(scene, alone, tmp_path):
    with pytest.raises(Interrupted) as stopped, Pressed() as watch:
        taichi_eye.run(scene, tmp_path / "run", watch=watch)
    folder = tmp_path / "run"
    assert stopped.value.number == signal.SIGINT and stopped.value.folder == folder
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "stopped" and 0 < summary["simulated_ms"] < scene.numerics.duration_ms
    assert {"film.mp4", "report.html", "traces.csv", ".run"} <= {path.name for path in folder.iterdir()}
    # before its first sample, too, and again once it goes on
    with Watch() as watch:
        press(watch.url)
        with pytest.raises(Interrupted):
            taichi_eye.resume(folder, watch=watch)
        # and the same page has forgotten of it when the next run begins
        assert taichi_eye.resume(folder, watch=watch).summary["status"] == "complete"
    for column, values in read_traces(folder / "traces.csv").items():
        np.testing.assert_array_equal(values, alone.traces[column])


@pytest.mark.parametrize("count", [1, 2, POINTS, POINTS + 1, 3 * POINTS - 1])
def test_what_is_plotted_ends_at_the_last_sample_and_its_figures_are_of_all(count):
    draw = np.random.default_rng()
    columns = "apex_displacement_mm", "puff_apex_kpa", "fluid_pressure_apex_kpa"
    traces = {"time_ms": np.arange(count) * 0.025} | {column: draw.normal(size=count) for column in columns}
    told = _plotted(traces)
    for name, column in zip(("apex_mm", "puff_kpa", "pressure_kpa"), columns, strict=True):
        last, most = traces[column][-1], traces[column].max()
        assert (told[name][-1], told["now"][name], told["most"][name]) == pytest.approx((last, last, most), abs=1e-5)
    assert told["time_ms"][-1] == pytest.approx(traces["time_ms"][-1]) and len(told["time_ms"]) <= 2 * POINTS
    assert (np.diff(told["time_ms"]) > 0).all()


def test_an_address_without_a_page_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "quick", "--port", "8123"]) == 2
    assert "--watch" in capsys.readouterr().err
    assert main(["run", "quick", "--watch", "--host", "no.such.host.invalid"]) == 2
    said = capsys.readouterr().err
    assert main(["run", "quick", "--watch", "--host", "0.0.0.0"]) == 2
    assert "one address" in capsys.readouterr().err
    assert "no.such.host.invalid" in said and len(said.splitlines()) == 1 and not list(tmp_path.iterdir())


@pytest.mark.skipif(bool(browsers.missing()), reason=browsers.missing())
def test_the_page_shows_the_run_and_its_button_ends_it(tmp_path):
    # ten thousands of small frames: a run that no browser, however busy the machine, is too late for
    small = {"width_px": 128, "height_px": 64, "apex_column_px": 64, "pixel_x_mm": 0.08, "frame_interval_ms": 0.01}
    keys = {**WORDS, "numerics.duration_ms": 320, **{f"camera.{name}": value for name, value in small.items()}}
    words = [word for key, value in keys.items() for word in ("--set", f"{key}={value}")]
    with browsers.served("run", "seed", *words, "--watch", "--quiet", "--out", "run", cwd=tmp_path) as (url, process):
        with browsers.browser() as one:
            tab, closed = browsers.Tab(one, url), browsers.Tab(one, url)
            closed.page.close()
            tab.page.wait_for_selector("body[data-frame]")
            first = int(tab.page.evaluate("document.body.dataset.frame"))
            picture = tab.page.evaluate("document.getElementById('film').toDataURL()")
            while int(tab.page.evaluate("document.body.dataset.frame")) < first + 100:
                tab.page.wait_for_timeout(20)
            assert tab.page.evaluate("document.getElementById('film').toDataURL()") != picture
            tab.page.locator("#stop").click()
            tab.page.wait_for_selector("body[data-state=ended]")
            assert "interrupted" in tab.page.locator("#state").inner_text() and tab.wrong == []
        process.communicate(timeout=120)
    assert process.returncode == 130
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["status"] == "stopped"


def test_a_page_without_its_packages_is_refused_in_a_line(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(needs, "find_spec", lambda name: None if name == "uvicorn" else True)
    for words in (["play"], ["run", "quick", "--watch"]):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said == "taichi-eye: uvicorn is not installed, which live pages need: pip install 'taichi-eye[page]'\n"
    assert not list(tmp_path.iterdir())
