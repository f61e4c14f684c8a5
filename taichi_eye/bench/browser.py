"""A real browser to drive, where there is one, and commands that serve pages to it."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import taichi_eye

NAMES = "chromium", "chromium-browser", "google-chrome", "google-chrome-stable"
PATIENCE_MS = 120_000
PARTING_S = 120
VERSION_S = 60


@functools.cache
def program() -> str | None:
    """The browser's program; None where there is none: what bears its name may be a stub that tells to install it."""
    return next((path for path in map(shutil.which, NAMES) if path and _starts(path)), None)


def _starts(path: str) -> bool:
    try:
        return subprocess.run([path, "--version"], capture_output=True, timeout=VERSION_S).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def missing() -> str:
    """Why no page can be tested here; empty where it can."""
    packages = [name for name in ("playwright", "starlette", "uvicorn", "websockets") if find_spec(name) is None]
    if packages:
        return f"{', '.join(packages)} not installed (pip install 'taichi-eye[test]')"
    return "" if program() else f"no browser: none of {', '.join(NAMES)} is installed"


@contextlib.contextmanager
def browser():
    """The browser, without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        # a browser has no sandbox for the superuser
        sandbox = [] if getattr(os, "geteuid", lambda: 1)() else ["--no-sandbox"]
        one = driver.chromium.launch(executable_path=program(), args=sandbox)
        try:
            yield one
        finally:
            one.close()


class Tab:
    """A page of the browser; wrong: what its console and its scripts complained of."""

    def __init__(self, one, url: str):
        self.wrong: list[str] = []
        self.page = one.new_page(viewport={"width": 1400, "height": 1250})
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("console", lambda said: said.type in ("error", "warning") and self.wrong.append(said.text))
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.goto(url)


@contextlib.contextmanager
def served(*words: str, cwd: str | Path):
    """A command that prints the address of its page first: the address and the process, ended as by Ctrl-C."""
    path = os.pathsep.join(filter(None, [str(Path(taichi_eye.__file__).parents[1]), os.environ.get("PYTHONPATH")]))
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "taichi_eye", *words],
        text=True,
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": path},
        preexec_fn=_heeding,
    )
    try:
        line = process.stdout.readline()
        if not line:
            raise RuntimeError(process.communicate(timeout=PARTING_S)[1])
        yield line.split()[0], process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=PARTING_S)


def _heeding() -> None:
    """Take Ctrl-C as a shell's foreground does, also where this runs in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def settled(tab: Tab, after: int = -1) -> int:
    """Wait for a film that was asked for after another; the number of its request."""
    tab.page.wait_for_selector("body[data-settled]")
    while (number := int(tab.page.evaluate("document.body.dataset.settled"))) <= after:
        tab.page.wait_for_timeout(10)
    return number


def drag(tab: Tab, slider: str, share: float, which: int = 0, steps: int = 6) -> list[str]:
    """Drag a slider by a share of its length; the pictures that were shown on the way, one a step."""
    page, shown = tab.page, []
    box = page.locator(".eye").nth(which).locator(f"input[data-name={slider}]").bounding_box()
    low = page.evaluate(f"""(() => {{ const s = document.querySelectorAll('.eye')[{which}]
        .querySelector('input[data-name={slider}]'); return (s.value - s.min) / (s.max - s.min); }})()""")
    x, y = box["x"] + 8 + low * (box["width"] - 16), box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, steps + 1):
        before = page.evaluate("timings.frame.length")
        page.mouse.move(x + share * box["width"] * k / steps, y)
        while page.evaluate("timings.frame.length") == before:
            page.wait_for_timeout(5)
        shown.append(picture(tab, which))
    page.mouse.up()
    return shown


def picture(tab: Tab, which: int = 0) -> str:
    """What the film of an eye shows, as a data URL."""
    return tab.page.evaluate(f"document.querySelectorAll('.eye canvas')[{which}].toDataURL()")
