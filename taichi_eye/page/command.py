"""`taichi-eye play [SCENE]`."""

from __future__ import annotations

import argparse

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


def add_address(parser: argparse.ArgumentParser) -> None:
    """`--host` and `--port` of a page."""
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="of the network interface that answers (default: 127.0.0.1, this machine alone)",
    )
    parser.add_argument("--port", type=count("a port", 65535), metavar="N", help="of the page (default: a free one)")


def run(given: argparse.Namespace) -> int:
    """`taichi-eye play`; the exit status."""
    from taichi_eye.page.needs import refuse_missing

    refuse_missing()
    from taichi_eye.page import hand, play, server
    from taichi_eye.page.thread import Kernels

    eyes = hand.load(given.scene or play.PRESETS[0], given.overrides, play.PRESETS)
    address = server.Address(given.host or server.LOOPBACK, given.port or 0)
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
