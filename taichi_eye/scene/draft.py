"""A scene in the making: values with their origin, and the problems found so far."""

from __future__ import annotations

import json
from typing import Any

from taichi_eye.errors import SceneError
from taichi_eye.scene.schema import AUTO


class Draft:
    """The values of a scene in the making, where each came from, and the problems found so far."""

    def __init__(self, file: str | None):
        self.file = file
        self.values: dict[str, Any] = {}
        self.origin: dict[str, str] = {}  # "file" or "--set"; absent: the default
        self.problems: list[str] = []

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    def given(self, name: str) -> bool:
        """Whether a value was written for this key, other than "auto"."""
        return name in self.origin and self.values[name] != AUTO

    def refuse(self, message: str, *names: str) -> None:
        """Record a problem with these keys: the message follows their source and values."""
        origins = {self.origin.get(name) for name in names}
        sources = [self.file] if "file" in origins else []
        sources += ["--set"] if "--set" in origins else []
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
