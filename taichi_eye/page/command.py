"""`taichi-eye play [SCENE]`, and the page of `taichi-eye run --watch`."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import Any

from taichi_eye import backend
from taichi_eye.options import count, take


def add(commands) -> None:
    """The parser of `play`."""
    parser = commands.add_parser(
        "play",
        help="an eye under the hand: sliders, film and parameters in the browser",
        description="Serve a page with sliders for pressure, thickness, radius, stiffness, puff and globe; film, apex "
        "history and parameters follow. Ends with Ctrl-C.",
        epilog="Who may reach the page, and what it can do: taichi-eye docs play",
        examples=("taichi-eye play", "taichi-eye play corvis_healthy --port 8000"),
    )
    take(parser, "scene?", "set")
    add_address(parser)
    take(parser, "threads")
    parser.set_defaults(do=run)


def add_address(parser: argparse.ArgumentParser, where: str = "") -> None:
    """`--host` and `--port` of a page; where: what their help ends with."""
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help=f"network interface of the page (default: 127.0.0.1, this machine alone){where}",
    )
    parser.add_argument(
        "--port", type=count("a port", 65535), metavar="N", help=f"port of the page (default: a free one){where}"
    )


@contextlib.contextmanager
def watching(given: argparse.Namespace) -> Iterator[Any]:
    """The observer of a run that is watched, whose address is printed; None where it is not."""
    if not given.watch:
        yield None
        return
    from taichi_eye.page.server import Address
    from taichi_eye.page.watch import Watch

    with Watch(Address(given.host, given.port)) as watch:
        print(f"{watch.url}  the run as it goes", flush=True)
        yield watch


def run(given: argparse.Namespace) -> int:
    """`taichi-eye play`; the exit status."""
    from taichi_eye.page.needs import refuse_missing

    refuse_missing()
    from taichi_eye.page import hand, play, server
    from taichi_eye.page.thread import Kernels

    eyes = hand.load(given.scene or play.PRESETS[0], given.overrides, play.PRESETS)
    address = server.Address(given.host, given.port)
    kernels = Kernels(lambda: backend.init("cpu", "f64", given.threads))
    page = play.Play(eyes, kernels)
    print(f"{address.url}  an eye under the hand; end it with Ctrl-C", flush=True)
    try:
        kernels.begin(page.warm)
        address.serve(page.app)
    except KeyboardInterrupt:
        pass  # the way in which it is meant to end
    finally:
        kernels.close()
    return 0
