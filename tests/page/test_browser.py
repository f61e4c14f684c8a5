"""The page in a real browser: sliders dragged, film and parameters changed, two tabs, a foreign page, a large file."""

import http.server
import threading

import pytest

from taichi_eye.bench import browser as browsers
from taichi_eye.bench.browser import drag, picture, settled
from taichi_eye.page import hand
from taichi_eye.scene import load_scene

pytestmark = pytest.mark.skipif(bool(browsers.missing()), reason=browsers.missing())
FOREIGN = """<!doctype html><body>a page from elsewhere<script>
const said = [], here = "URL";
const shut = new WebSocket(here.replace("http", "ws") + "hand");
shut.onopen = () => said.push("socket"); shut.onerror = () => {};
Promise.all([
  fetch(here + "scene", {method: "POST", body: "{}"}).then(() => said.push("post"), () => {}),
  fetch(here + "eyes").then(() => said.push("get"), () => {}),
  fetch(here + "scene", {method: "POST", mode: "no-cors", body: "{}"}).then(() => {}, () => {}),
  new Promise((done) => { shut.onclose = done; }),
]).then(() => { document.body.dataset.said = said.join() || "nothing"; });
</script>"""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with browsers.served("play", "corvis_healthy", cwd=tmp_path_factory.mktemp("play")) as (url, process):
        yield url
    assert process.returncode == 0


@pytest.fixture(scope="module")
def one():
    with browsers.browser() as one:
        yield one


def parameter(tab, name, which=0):
    return float(tab.page.locator(f"tr[data-name={name}] td").nth(1 + which).inner_text())


def test_a_slider_is_dragged_and_film_history_and_parameters_follow(server, one, tmp_path):
    tab, other = browsers.Tab(one, server), browsers.Tab(one, server)
    first, there = settled(tab), settled(other)
    assert parameter(tab, "deformation_amplitude_mm") == pytest.approx(1.055, abs=0.02)
    names = tab.page.evaluate("[...document.querySelectorAll('.eye:first-child input')].map((s) => s.dataset.name)")
    assert names == list(hand.SLIDERS)
    before = picture(tab), picture(tab, 1), parameter(tab, "a1_time_ms"), picture(other)
    plot = tab.page.evaluate("document.getElementById('plot').toDataURL()")
    shown = drag(tab, "iop", 0.2)
    assert len(set(shown)) == 6 and before[0] not in shown
    first = settled(tab, first)
    assert parameter(tab, "a1_time_ms") > before[2] + 0.5 and picture(tab, 1) == before[1]
    assert tab.page.evaluate("document.getElementById('plot').toDataURL()") != plot
    # the other tab has seen nothing of it, and moves its own eyes
    assert picture(other) == before[3]
    drag(other, "puff", -0.2, which=1)
    settled(other, there)
    assert picture(other) == before[3] and picture(other, 1) != before[1]
    # time is dragged without asking anybody
    asked = tab.page.evaluate("timings.film.length + timings.frame.length")
    tab.page.locator("#now").fill("5")
    assert picture(tab) not in shown and tab.page.locator("#shown").inner_text() == "5.00 ms"
    assert tab.page.evaluate("timings.film.length + timings.frame.length") == asked
    # a frame of the hand does not stay once time has moved, also while its film is on its way
    tab.page.evaluate("""(() => { moved(eyes[1], offer.sliders.find((one) => one.name === "iop"), 5, false); })()""")
    while tab.page.evaluate("eyes[1].preview === null"):
        tab.page.wait_for_timeout(5)
    assert tab.page.locator("tr[data-name=a1_time_ms] td").nth(2).inner_text() == "-"
    tab.page.evaluate(
        """(() => { ask("film"); const now = at("now"); now.value = 20; now.dispatchEvent(new Event("input")); })()"""
    )
    first = settled(tab, first)
    assert tab.page.evaluate("[eyes[1].preview, eyes[1].frames.length, eyes[1].due]") == [None, 139, False]
    # what is saved is what is shown
    with tab.page.expect_download() as kept:
        tab.page.locator(".keep").first.click()
    kept.value.save_as(tmp_path / "my_eye.toml")
    command = tab.page.locator(".foot code").first.inner_text()
    iop = load_scene(tmp_path / "my_eye.toml").eye.iop_mmhg
    assert iop > 20 and command == f"taichi-eye run corvis_healthy --set eye.iop_mmhg={iop}"
    # a measured history is laid over, one that is too large is refused, and the page lives on
    rows = "\n".join(f"{t},{0.1 * t}" for t in range(10))
    (tmp_path / "mine.csv").write_text(f"time_ms,deflection_mm\n{rows}\n")
    tab.page.locator("#measured").set_input_files(tmp_path / "mine.csv")
    tab.page.wait_for_selector("#said:has-text('mine.csv')")
    # its dots stand beside their own quantity
    dots = tab.page.evaluate("document.getElementById('plot').toDataURL()")
    tab.page.locator("#what").select_option("deformation_mm")
    assert "(apex deflection, shown while" in tab.page.locator("#said").inner_text()
    tab.page.locator("#what").select_option("deflection_mm")
    assert tab.page.evaluate("document.getElementById('plot').toDataURL()") == dots
    assert tab.page.locator("#said").inner_text() == "laid over, in green: mine.csv (apex deflection)"
    with open(tmp_path / "large.csv", "wb") as large:
        large.truncate(100_000_000)
    wrong = list(tab.wrong)
    tab.page.locator("#measured").set_input_files(tmp_path / "large.csv")
    tab.page.wait_for_selector("#said.refused")
    assert "4 MB" in tab.page.locator("#said").inner_text() or "too large" in tab.page.locator("#said").inner_text()
    # values beyond the limits are refused in words
    tab.page.evaluate("""(() => { eyes[0].values.iop = 1000; eyes[0].due = true; ask("film"); })()""")
    tab.page.wait_for_selector(".eye:first-child .refused:has-text('>= 1 and <= 100')")
    # and the table tells of the other eye alone
    assert (
        tab.page.locator("tr[data-name=a1_time_ms] td").nth(1).inner_text() == "-"
        and parameter(tab, "a1_time_ms", 1) > 0
    )
    assert wrong == other.wrong == []
    for each in (tab, other):
        each.page.close()


def test_a_page_of_another_origin_gets_nothing(server, one):
    class Foreign(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            body = FOREIGN.replace("URL", server).encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Foreign) as foreign:
        threading.Thread(target=foreign.serve_forever, daemon=True).start()
        tab = browsers.Tab(one, f"http://localhost:{foreign.server_address[1]}/")
        tab.page.wait_for_selector("body[data-said]")
        assert tab.page.evaluate("document.body.dataset.said") == "nothing"
        tab.page.close()
        foreign.shutdown()
