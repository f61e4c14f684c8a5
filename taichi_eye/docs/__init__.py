"""The pages of the guide, Markdown files of this folder, as `taichi-eye docs NAME` prints them.

A page begins with "# ", a title of one line, which the list of pages shows. For a line <!-- NAME --> the table
FILLED[NAME] is put: what the program knows already is written down nowhere else.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from taichi_eye.errors import SceneError

HERE = Path(__file__).parent


def names() -> list[str]:
    """The pages, in alphabetical order."""
    return sorted(path.stem for path in HERE.glob("*.md"))


def title(name: str) -> str:
    """The title of a page."""
    with open(HERE / f"{name}.md", encoding="utf-8") as file:
        return file.readline().removeprefix("# ").strip()


def text(name: str) -> str:
    """A page with its tables filled in; SceneError where there is none of that name."""
    if name not in names():
        close = difflib.get_close_matches(name, names(), n=1, cutoff=0.5)
        hint = f"did you mean {close[0]}? " if close else ""
        raise SceneError(f"docs {name}: no such page; {hint}there are {', '.join(names())}")
    lines = (HERE / f"{name}.md").read_text(encoding="utf-8").split("\n")
    return "\n".join(FILLED[line[5:-4]]() if line.startswith("<!-- ") else line for line in lines)


def keys_table() -> str:
    """Every key of a scene, a table for each section."""
    from taichi_eye.scene.draft import written
    from taichi_eye.scene.schema import SECTIONS, keys_of

    parts = []
    for section, kind in SECTIONS.items():
        parts += [
            f"## [{section}]",
            "",
            f"{kind.__doc__}.",
            "",
            "| key | default | allowed | meaning |",
            "|---|---|---|---|",
        ]
        for name, (_, spec) in keys_of(section).items():
            allowed = " ".join(part for part in (spec.bounds(), spec.unit) if part)
            cells = f"`{name}`", written(spec.default), allowed, spec.doc
            parts.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        parts.append("")
    return "\n".join(parts).rstrip("\n")


def norms_table() -> str:
    """Mean and SD of every parameter that has a norm, by population, and who these are."""
    from taichi_eye.analysis.norms import NORMS, POPULATIONS

    listed = dict.fromkeys(name for norms in NORMS.values() for name in norms)
    rows = [
        "| parameter | " + " | ".join(POPULATIONS[population].name for population in NORMS) + " |",
        "|---|" + "---|" * len(NORMS),
    ]
    for name in listed:
        cells = ("{:g} +- {:g}".format(*norms[name]) if name in norms else "" for norms in NORMS.values())
        rows.append(f"| `{name}` | " + " | ".join(cells) + " |")
    who = [f"- {POPULATIONS[population].name}: {POPULATIONS[population].source}." for population in NORMS]
    return "\n".join([*rows, "", *who])


def parameters_table() -> str:
    """Every parameter by its column, full name and unit."""
    from taichi_eye.analysis.names import NAMES, unit_of

    rows = [f"| `{name}` | {said} | {unit_of(name)} |" for name, said in NAMES.items()]
    return "\n".join(["| column | full name | unit |", "|---|---|---|", *rows])


FILLED = {"keys": keys_table, "norms": norms_table, "parameters": parameters_table}
