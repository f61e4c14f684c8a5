"""From a TOML file and overrides to a validated, resolved `Scene`, and back to TOML."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import taichi_eye
from taichi_eye import shipped
from taichi_eye.errors import SceneError
from taichi_eye.scene.draft import CHANGE, FILE, Draft, hint_section, written
from taichi_eye.scene.scene import Scene
from taichi_eye.scene.schema import AUTO, SECTIONS, keys_of
from taichi_eye.scene.table import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def load_scene(path: str | Path | None = None, overrides: Sequence[str] = ()) -> Scene:
    """Read, validate and resolve a scene.

    path: a TOML file, or the name of a scene that ships; None or an empty file is the default eye. overrides:
    "section.key=value" strings, as after `--set`, applied in order on top of the file; a value that is not TOML is
    taken as a string, so quotes may be left out. A relative `puff.file` is looked for beside the scene file, or, given
    as an override, in the current directory. Keys with a computed default also take the value "auto". Raises SceneError
    with every problem found.
    """
    path = None if path is None else shipped.find(path)
    draft = Draft(None if path is None else str(path))
    if path is not None:
        _read_file(draft, path)
    for override in overrides:
        _read_override(draft, override)
    return Scene.of(draft)


def dump_scene(scene: Scene) -> str:
    """TOML text of a scene, every key spelled out with its explanation; `load_scene` on it gives an equal Scene.

    A key that was computed stands there as "auto", its value in the comment: whoever edits what it depends on gets it
    computed anew.
    """
    lines = [
        f"# A scene of taichi_eye {taichi_eye.__version__}, every key spelled out; what is computed is computed again "
        "where it says auto."
    ]
    for section in SECTIONS:
        lines += ["", f"[{section}]" + f"{'':{34 - len(section)}}# {SECTIONS[section].__doc__}"]
        for name, (_, spec) in keys_of(section).items():
            allowed = ", ".join(part for part in (spec.unit, spec.bounds()) if part)
            value = written(getattr(getattr(scene, section), name))
            doc = spec.doc + (f" [{allowed}]" if allowed else "")
            if spec.computed and f"{section}.{name}" not in scene.given:
                value, doc = written(AUTO), f"here {value}; {doc}"
            lines.append(f"{f'{name} = {value}':35} # {doc}")
    return "\n".join(lines) + "\n"


def _parse(text: str) -> dict[str, Any]:
    """TOML to a dictionary; ValueError says what is malformed, with the line."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def read_toml(path: Path) -> dict[str, Any]:
    """What a user's TOML file holds; SceneError where it cannot be read or is malformed."""
    text = read_text(path)
    try:
        return _parse(text)
    except ValueError as error:
        raise SceneError(f"{path}: malformed TOML: {error}") from None


def _read_file(draft: Draft, path: Path) -> None:
    for section, table in read_toml(path).items():
        if not isinstance(table, dict):
            wanted = (
                f"must be a table, [{section}]"
                if section in SECTIONS
                else f"a key must stand in a section{hint_section(section, section)}"
            )
            draft.problems.append(f"{path}: {section} = {written(table)}: {wanted}")
            continue
        if section not in SECTIONS:
            draft.problems.append(f"{path}: [{section}]: unknown section{hint_section(section, '')}")
            continue
        for name, value in table.items():
            draft.put(f"{section}.{name}", value, FILE)


def _read_override(draft: Draft, override: str) -> None:
    target, equals, text = override.partition("=")
    parts = [part.strip() for part in target.split(".")]
    if not equals or len(parts) != 2 or not all(parts):
        draft.problems.append(f"--set {override}: must read section.key=value, for example cornea.radius_mm=7.2")
        return
    try:
        parsed = _parse(f"value = {text}")
        value = parsed["value"] if len(parsed) == 1 else text
    except ValueError:
        value = _bare(text.strip())
    draft.put(".".join(parts), value, CHANGE)


def _bare(text: str) -> float | str:
    """What was typed without being TOML: a number such as .5, else a string without its quotes."""
    try:
        return float(text)
    except ValueError:
        return text
