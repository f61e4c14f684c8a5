"""report.html and what a notebook shows: nothing is loaded from elsewhere, names are text, figures are the run's."""

import html
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import taichi_eye
from taichi_eye.analysis import analyze
from taichi_eye.analysis.names import NAMES
from taichi_eye.analysis.norms import judged_by
from taichi_eye.analysis.response import Response
from taichi_eye.analysis.simulated import response_of
from taichi_eye.recording.marks import Marks
from taichi_eye.report import result as page

EVIL = "<img src=x onerror=alert(1)>&amp;"
WORDS = [
    "numerics.fidelity=cavity",
    "numerics.spacing_mm=0.4",
    "numerics.duration_ms=24",
    "camera.frame_interval_ms=0.4",
    "camera.view=scheimpflug",
]


class Read(HTMLParser):
    """Tags, addresses and cells of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses, self.cells, self._open = [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [value for name, value in attributes if name in ("src", "href")]
        assert not [name for name, _ in attributes if name.startswith("on")]
        self._open = tag in ("td", "th")
        if self._open:
            self.cells.append("")

    def handle_endtag(self, tag):
        self._open = False

    def handle_data(self, data):
        if self._open:
            self.cells[-1] += data


@pytest.fixture(scope="module")
def scene():
    iop = 12.0 + 8.0 * np.random.default_rng().random()
    return taichi_eye.load_scene("corvis_healthy", [*WORDS, f"eye.iop_mmhg={iop:.4g}"])


@pytest.fixture(scope="module")
def result(scene, tmp_path_factory):
    return taichi_eye.run(scene, tmp_path_factory.mktemp("runs") / EVIL)


def test_the_page_of_a_run_loads_nothing_and_takes_names_as_text(result):
    text = (result.folder / "report.html").read_text(encoding="utf-8")
    read = Read(text)
    assert read.tags.count("img") == read.tags.count("video") == 1 and "script" not in read.tags
    assert all(address.startswith("data:") for address in read.addresses)
    assert html.escape(EVIL, quote=False) in text and EVIL not in text


def test_the_page_of_a_run_shows_the_response_of_its_wall(result, scene):
    cells = Read((result.folder / "report.html").read_text()).cells
    response = response_of(scene).response
    assert response.a1_time_ms is not None
    for name, said in NAMES.items():
        value = getattr(response, name)
        if value is None:
            assert said not in cells
            continue
        row = cells[cells.index(said) :][:6]
        assert float(row[1]) == pytest.approx(value, rel=1e-3)
        if judged_by(name):
            _, mean, deviation = judged_by(name)
            assert float(row[4]) == pytest.approx((value - mean) / deviation, abs=0.051)
            assert row[3].startswith(f"{mean:g} ")


def test_the_page_of_a_run_names_every_key_that_was_given_and_no_other(result, scene):
    cells = Read((result.folder / "report.html").read_text()).cells
    default = taichi_eye.load_scene().values()
    here = cells[cells.index("default") :]
    listed = {cell for cell in here if cell in default}
    own = scene.values()
    assert {"eye.iop_mmhg", "puff.time_course", "numerics.fidelity"} <= listed
    assert all(own[name] != default[name] for name in listed)
    assert "cornea.prestrain" not in listed and own["cornea.prestrain"] != default["cornea.prestrain"]


def test_python_shows_the_page_the_film_and_the_columns(result):
    shown = result._repr_html_()
    assert shown == page.read(result.folder) and shown.startswith("<main") and shown.endswith("</main>")
    table = result.to_dataframe()
    assert list(table) == list(result.traces)
    np.testing.assert_array_equal(table["apex_displacement_mm"], result.traces["apex_displacement_mm"])
    axes = result.plot().axes
    drawn = [line.get_xydata() for each in axes for line in each.lines]
    assert any(len(line) == len(table) and line[:, 1].max() == table["apex_displacement_mm"].max() for line in drawn)
    frames = result.film.frames()
    assert frames.shape == (61, 200, 576, 3) and frames.dtype == np.uint8
    assert "data:video/mp4;base64," in result.film._repr_html_()


def test_the_page_of_an_analysis_is_the_same_kind_of_page(result, tmp_path):
    found = analyze(result.folder, tmp_path / "an")
    text = (found.folder / "report.html").read_text()
    read = Read(text)
    assert all(address.startswith("data:") for address in read.addresses) and "video" in read.tags
    row = read.cells[read.cells.index(NAMES["deformation_amplitude_mm"]) :]
    assert float(row[1]) == pytest.approx(found.response.deformation_amplitude_mm, rel=1e-3)
    assert float(row[2]) == pytest.approx(found.true_response.deformation_amplitude_mm, rel=1e-3)
    assert found._repr_html_() == page.read(found.folder)
    table = found.to_dataframe()
    assert list(table) == (found.folder / "histories.csv").read_text().splitlines()[0].split(",")
    assert re.search(r"deformation amplitude \d", found.plot().get_suptitle())


def test_every_parameter_has_a_full_name():
    assert list(NAMES) == list(Response.__dataclass_fields__)


def test_marks_of_a_film_stand_where_the_reading_of_the_whole_has_them(result, scene):
    marks, said = Marks(), []
    with np.load(result.folder / "wall.npz") as wall:  # the retreat is in it
        for time_ms, r, z in zip(wall["time_ms"], wall["r_mm"], wall["z_mm"]):
            said.append((time_ms, marks.see(float(time_ms), 1e-3 * np.column_stack([r, z]), 0.0)))
    response, interval = response_of(scene).response, scene.camera.frame_interval_ms
    for name, time in (("A1", response.a1_time_ms), ("A2", response.a2_time_ms), ("HC", response.hc_time_ms)):
        assert marks.times_ms[name] == pytest.approx(time, abs=interval)
        first = next(when for when, text in said if name in text)  # once it is passed, and not before
        assert time - interval < first < time + 3 * interval
    assert said[-1][1].split()[::2] == ["A1", "HC", "A2"]
