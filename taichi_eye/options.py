"""Arguments of the command line that several commands share, each written once, and the parser that they stand on.

`take(command, "scene?", "set", threads="...")` adds them by name; a keyword gives an argument another help text where
it means something of its own there. `Command` is a parser whose help ends with examples, and with the names that
`--only` takes, looked up when the help is printed: the modules that know them are slow to load.
"""

from __future__ import annotations

import argparse
import os
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from taichi_eye import backend
from taichi_eye.errors import SceneError


def positive(text: str) -> float:
    """A number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def count(what: str, most: int) -> Callable[[str], int]:
    """The type of an argument that is a number of `what`, from 1 to `most`."""

    def read(text: str) -> int:
        if not text.isdecimal() or not 1 <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number of {what} from 1 to {most}")
        return int(text)

    return read


threads = count("threads", 1024)

_SCENE = {"help": "scene file (TOML), or the name of a scene that ships"}
SHARED: dict[str, tuple[str, dict]] = {
    "scene": ("scene", _SCENE),
    "scene?": ("scene", {"nargs": "?", "help": _SCENE["help"] + "; without one, the default eye"}),
    "set": (
        "--set",
        {
            "dest": "overrides",
            "metavar": "SECTION.KEY=VALUE",
            "action": "append",
            "default": [],
            "help": "override a key of the scene; may be repeated",
        },
    ),
    "out": ("--out", {"metavar": "DIR", "help": "folder of the results, new or empty (default: under renders/)"}),
    "resume": ("--resume", {"metavar": "DIR"}),
    "only": (
        "--only",
        {"metavar": "NAME", "action": "append", "default": [], "help": "one part of it; may be repeated"},
    ),
    "json": ("--json", {"metavar": "FILE", "help": "the figures as JSON"}),
    "arch": ("--arch", {"choices": backend.ARCHES, "help": "backend of the kernel language (default: cpu)"}),
    "precision": ("--precision", {"choices": backend.PRECISIONS, "help": "default: f64"}),
    "threads": ("--threads", {"type": threads, "metavar": "N", "help": "CPU threads (default: all)"}),
    "quiet": ("--quiet", {"action": "store_true", "help": "no progress bar"}),
}


def take(command: argparse.ArgumentParser, *names: str, **helps: str) -> None:
    """Add shared arguments by their names in SHARED; helps: another help text for some, by name."""
    for name in names:
        flag, settings = SHARED[name]
        command.add_argument(flag, **settings | ({"help": helps[name]} if name in helps else {}))


class Lines(argparse.HelpFormatter):
    """Wraps what is one line and keeps the lines of what has several."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


class Command(argparse.ArgumentParser):
    """A parser with examples, command lines that its help ends with.

    parts: the names that `--only` takes, as a function.
    """

    def __init__(
        self, *given, examples: Sequence[str] = (), parts: Callable[[], Iterable[str]] | None = None, **settings
    ):
        super().__init__(*given, **{"formatter_class": Lines} | settings)
        self.examples, self.parts = tuple(examples), parts

    def format_help(self) -> str:
        """The help, the names of parts and the examples at its end."""
        said = super().format_help()
        if self.parts is not None:
            named = f"parts, for --only: {', '.join(self.parts())}"
            said += "\n" + textwrap.fill(named, width=78, break_on_hyphens=False) + "\n"
        if self.examples:
            said += "\nexamples:\n" + "".join(f"  {line}\n" for line in self.examples)
        return said


def refuse_unwritable(file: str | None, flag: str = "--json") -> None:
    """SceneError where the file of a flag cannot be written, said before the minutes of work it would hold."""
    if file is None:
        return
    path = Path(file)
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise SceneError(f"{flag} {file}: cannot be written; name a file in an existing folder that may be written")
