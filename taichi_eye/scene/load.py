"""From a TOML file and overrides to a validated, resolved `Scene`, and back to TOML."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from taichi_eye.errors import SceneError
from taichi_eye.scene.draft import Draft, written
from taichi_eye.scene.resolve import resolve
from taichi_eye.scene.schema import AUTO, SECTIONS, Key, Scene, all_keys, keys_of
from taichi_eye.scene.table import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_KIND_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a string"}


def load_scene(path: str | Path | None = None, overrides: Sequence[str] = ()) -> Scene:
    """Read, validate and resolve a scene.

    path: a TOML file; None or an empty file is the default eye. overrides: "section.key=value" strings, as after
    `--set`, applied in order on top of the file; a value that is not TOML is taken as a string, so quotes may be left
    out. A relative `puff.file` is looked for beside the scene file, or, given as an override, in the current directory.
    Keys with a computed default also take the value "auto". Raises SceneError with every problem found.
    """
    draft = Draft(None if path is None else str(path))
    if path is not None:
        _read_file(draft, Path(path))
    for override in overrides:
        _read_override(draft, override)
    draft.stop_if_refused()
    for name, _, spec in all_keys():
        draft.values.setdefault(name, spec.default)
    resolve(draft)
    return Scene(
        **{
            section: build(**{name: draft[f"{section}.{name}"] for name in keys_of(section)})
            for section, build in SECTIONS.items()
        }
    )


def dump_scene(scene: Scene) -> str:
    """TOML text of a scene, every key spelled out with its explanation; `load_scene` on it gives an equal Scene."""
    lines = ["# A taichi_eye scene, every key spelled out."]
    for section in SECTIONS:
        lines += ["", f"[{section}]" + f"{'':{34 - len(section)}}# {SECTIONS[section].__doc__}"]
        for name, (_, spec) in keys_of(section).items():
            allowed = ", ".join(part for part in (spec.unit, spec.bounds()) if part)
            doc = spec.doc + (f" [{allowed}]" if allowed else "")
            lines.append(f"{f'{name} = {written(getattr(getattr(scene, section), name))}':35} # {doc}")
    return "\n".join(lines) + "\n"


def _parse(text: str) -> dict[str, Any]:
    """TOML to a dictionary; ValueError says what is malformed, with the line."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _read_file(draft: Draft, path: Path) -> None:
    text = read_text(path)
    try:
        content = _parse(text)
    except ValueError as error:
        raise SceneError(f"{path}: malformed TOML: {error}") from None
    for section, table in content.items():
        if not isinstance(table, dict):
            wanted = (
                f"must be a table, [{section}]"
                if section in SECTIONS
                else f"a key must stand in a section{_hint_section(section, section)}"
            )
            draft.problems.append(f"{path}: {section} = {written(table)}: {wanted}")
            continue
        if section not in SECTIONS:
            draft.problems.append(f"{path}: [{section}]: unknown section{_hint_section(section, '')}")
            continue
        for name, value in table.items():
            _put(draft, f"{path}: ", section, name, value, "file")


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
    _put(draft, "--set ", *parts, value, "--set")


def _bare(text: str) -> float | str:
    """What was typed without being TOML: a number such as .5, else a string without its quotes."""
    try:
        return float(text)
    except ValueError:
        return text


def _put(draft: Draft, source: str, section: str, name: str, value: Any, origin: str) -> None:
    """Check one value on its own and take it over, or record what is wrong with it."""
    full = f"{section}.{name}"
    if section not in SECTIONS:
        draft.problems.append(
            f"{source}{full} = {written(value)}: unknown section [{section}]{_hint_section(section, name)}"
        )
        return
    if name not in keys_of(section):
        draft.problems.append(f"{source}{full} = {written(value)}: unknown key{_hint_key(section, name)}")
        return
    kind, spec = keys_of(section)[name]
    converted = _convert(kind, spec, value)
    if converted is None:
        draft.problems.append(f"{source}{full} = {written(value)}: must be {_allowed(kind, spec)}")
        return
    if full == "puff.file" and converted:
        base = Path() if origin == "--set" or draft.file is None else Path(draft.file).parent
        converted = str((base / converted).absolute())
    draft.values[full] = converted
    draft.origin[full] = origin


def _convert(kind: type, spec: Key, value: Any) -> Any:
    """The value as the key's type, or None where it has another type or lies outside the limits."""
    if spec.computed and value == AUTO:
        return AUTO
    if isinstance(value, bool) != (kind is bool):
        return None
    if kind is float and isinstance(value, int):
        try:
            value = float(value)
        except OverflowError:
            return None
    if not isinstance(value, kind) or isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str) and not _encodable(value):
        return None
    return value if spec.holds(value) else None


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


def _hint_section(section: str, name: str) -> str:
    """Where an unknown section, or a key that stands outside any section, may belong."""
    owners = [s for s in SECTIONS if name in keys_of(s)]
    if owners:
        return f"; {name} is a key of {' and '.join(f'[{s}]' for s in owners)}"
    return f"{_nearest(section, list(SECTIONS))} (sections: {', '.join(SECTIONS)})"


def _hint_key(section: str, name: str) -> str:
    owners = [s for s in SECTIONS if name in keys_of(s)]
    if owners:
        return f"; it is a key of {' and '.join(f'[{s}]' for s in owners)}"
    return f"{_nearest(name, list(keys_of(section)))} (keys of [{section}]: {', '.join(keys_of(section))})"


def _nearest(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""
