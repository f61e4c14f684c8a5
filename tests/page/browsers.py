"""A browser to drive, where there is one: Debian's chromium, or another of its family."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NAMES = "chromium", "chromium-browser", "google-chrome", "google-chrome-stable"
PATIENCE_MS = 120_000


def program():
    """The browser's program; None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


needed = pytest.mark.skipif(program() is None, reason=f"no browser: none of {', '.join(NAMES)} is installed")


@contextlib.contextmanager
def browser():
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

    def __init__(self, one, url):
        self.wrong = []
        self.page = one.new_page(viewport={"width": 1400, "height": 1250})
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("console", lambda said: said.type in ("error", "warning") and self.wrong.append(said.text))
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.goto(url)


@contextlib.contextmanager
def served(*words, cwd):
    """A command that prints the address of its page first: the address and the process, ended as by Ctrl-C."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "taichi_eye", *words],
        text=True,
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": path},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        url = process.stdout.readline().split()[0]
        yield url, process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
