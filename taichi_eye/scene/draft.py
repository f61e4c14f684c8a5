"""A scene in the making: values with their origin, each checked on its own, and the problems found so far.

A value comes from a scene (FILE: a scene file, or the resolved scene that is changed) or from a change on top of it
(CHANGE: `--set`, or `Scene.but`); what neither says is the default. Messages name the origin, key, value and what is
allowed.
"""

from __future__ import annotations

import difflib
import json
import math
import numbers
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from taichi_eye.errors import SceneError
from taichi_eye.scene.schema import AUTO, SECTIONS, Key, keys_of

FILE, CHANGE = "file", "change"
_KIND_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a string"}


class Draft:
    """The values of a scene in the making, where each came from, and the problems found so far.

    file, change: what messages call the two origins; within_limits: whether values must lie within the limits of their
    keys, and the spacing within those of the chamber.
    """

    def __init__(self, file: str | None, change: str = "--set", within_limits: bool = True):
        self.file, self.change, self.within_limits = file, change, within_limits
        self.values: dict[str, Any] = {}
        self.origin: dict[str, str] = {}  # FILE or CHANGE; absent: the default
        self.problems: list[str] = []

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    def given(self, name: str) -> bool:
        """Whether a value was written for this key, other than "auto"."""
        return name in self.origin and self.values[name] != AUTO

    def put(self, full: str, value: Any, origin: str) -> None:
        """Check one value on its own and take it over, or record what is wrong with it; full: "section.key"."""
        section, _, name = full.partition(".")
        wrong = f"{f'{self.change} ' if origin == CHANGE else f'{self.file}: '}{full} = {written(value)}: "
        if section not in SECTIONS:
            self.problems.append(f"{wrong}unknown section [{section}]{hint_section(section, name)}")
            return
        if name not in keys_of(section):
            self.problems.append(f"{wrong}unknown key{_hint_key(section, name)}")
            return
        kind, spec = keys_of(section)[name]
        converted = self._convert(kind, spec, value)
        if converted is None:
            self.problems.append(f"{wrong}must be {_allowed(kind, spec)}")
            return
        if full == "puff.file" and converted:
            base = Path() if origin == CHANGE or self.file is None else Path(self.file).parent
            converted = str((base / converted).absolute())
        self.values[full] = converted
        self.origin[full] = origin

    def _convert(self, kind: type, spec: Key, value: Any) -> Any:
        """The value as the key's type, or None where it has another type or lies outside the limits."""
        if spec.computed and isinstance(value, str) and value == AUTO:
            return AUTO
        if isinstance(value, bool) != (kind is bool):
            return None
        if isinstance(value, {float: numbers.Real, int: numbers.Integral}.get(kind, kind)):
            try:
                value = kind(value)
            except OverflowError:
                return None
        if not isinstance(value, kind) or isinstance(value, float) and not math.isfinite(value):
            return None
        if isinstance(value, float) and abs(value) < sys.float_info.min:
            # the kernel language's start makes the processor take such numbers for zero: they are, before and after it
            value = 0.0
        if isinstance(value, str) and not _encodable(value):
            return None
        return value if not (self.within_limits or spec.choices) or spec.holds(value) else None

    def refuse(self, message: str, *names: str) -> None:
        """Record a problem with these keys: the message follows their source and values."""
        origins = {self.origin.get(name) for name in names}
        sources = [self.file] if FILE in origins else []
        sources += [self.change] if CHANGE in origins else []
        said = ", ".join(
            f"{name} = {written(self.values[name])}" + ("" if name in self.origin else " (default)") for name in names
        )
        self.problems.append(f"{' with '.join(sources) or self.file or 'scene'}: {said}: {message}")

    def stop_if_refused(self) -> None:
        if self.problems:
            raise SceneError("\n".join(self.problems))


def written(value: Any) -> str:
    """A value as TOML writes it (floats to full precision); other objects, as they occur in messages, by kind."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value) if abs(value) < 10**30 else f"a number of {value.bit_length()} bits"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "an array"
    return str(value)


def _encodable(text: str) -> bool:
    """Whether a string can stand in a UTF-8 file (a path of the command line may not) and name a file."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def _allowed(kind: type, spec: Key) -> str:
    words = (
        f"one of {spec.bounds()}"
        if spec.choices
        else " ".join(
            part for part in (_KIND_WORDS[kind], spec.unit and f"in {spec.unit},", spec.bounds()) if part
        ).rstrip(",")
    )
    return words + (' or "auto"' if spec.computed else "")


def hint_section(section: str, name: str) -> str:
    """Where an unknown section, or a key that stands outside any section, may belong."""
    owners = [s for s in SECTIONS if name in keys_of(s)]
    if owners:
        return f"; {name} is a key of {' and '.join(f'[{s}]' for s in owners)}"
    return f"{nearest(section, list(SECTIONS))} (sections: {', '.join(SECTIONS)})"


def _hint_key(section: str, name: str) -> str:
    owners = [s for s in SECTIONS if name in keys_of(s)]
    if owners:
        return f"; it is a key of {' and '.join(f'[{s}]' for s in owners)}"
    return f"{nearest(name, list(keys_of(section)))} (keys of [{section}]: {', '.join(keys_of(section))})"


def nearest(name: str, names: Sequence[str]) -> str:
    """A hint at which of the names may have been meant, or nothing."""
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""
