"""One self-contained HTML page per command: tables, figures as PNG inside it, and plain words."""

from __future__ import annotations

import base64
import html
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_eye.provenance import provenance, versions
from taichi_eye.report.folder import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#14539a", "#c9641a", "#3d8b57", "#8c3a8c", "#a88a1a", "#4c5560", "#b03a48", "#2a9d9d")
STYLE = """body{font:15px/1.5 system-ui,sans-serif;color:#22262b;max-width:75rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;font-size:13px;margin:1rem 0}td,th{padding:.2rem .7rem;border-bottom:1px solid
#d8dce0;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}.no{background:#fbe3e0}.ok{color:#26713f}
footer{color:#6b737c;font-size:12px;margin-top:2rem}
img{max-width:100%;margin:.5rem 0}figure{display:inline-block;margin:.5rem}"""


def draw(figure: dict) -> Figure:
    """A line plot: title, x, y, lines [(label, x, y)]; log (both axes), slope (a guide), points (even lines are
    points)."""
    from matplotlib.figure import Figure  # slow to load

    canvas = Figure(figsize=(6.4, 4.3), dpi=110, layout="constrained")
    axes = canvas.subplots()
    for k, (label, x, y) in enumerate(figure["lines"]):
        pair = figure.get("points")
        colour = COLOURS[(k // 2 if pair else k) % len(COLOURS)]
        style = "o" if pair and k % 2 else "-" if pair or not figure["log"] else "o-"
        axes.plot(x, y, style, color=colour, label=label, markersize=4, linewidth=1.5)
    if figure["log"]:
        axes.set_xscale("log")
        axes.set_yscale("log")
        ticks = sorted({float(v) for _, x, _ in figure["lines"] for v in x})
        axes.set_xticks(ticks, [f"{v:g}" for v in ticks], rotation=45)
        axes.minorticks_off()
        if "slope" in figure:
            x = np.array([ticks[0], ticks[-1]])
            top = max(float(np.nanmax(y)) for _, _, y in figure["lines"])
            start = x[0] if figure["slope"] < 0 else x[-1]
            axes.plot(
                x,
                1.5 * top * (x / start) ** figure["slope"],
                color="#8a9199",
                linestyle="--",
                linewidth=1,
                label=f"order {abs(figure['slope'])}",
            )
    axes.set(title=figure["title"], xlabel=figure["x"], ylabel=figure["y"])
    axes.grid(color="#e4e7ea", linewidth=0.6)
    axes.legend(fontsize=8, frameon=False)
    return canvas


def picture(canvas: Figure) -> str:
    """The figure as an HTML element."""
    data = io.BytesIO()
    canvas.savefig(data, format="png")
    return embedded(data.getvalue())


def embedded(png: bytes) -> str:
    """A picture that is drawn already, as an HTML element."""
    return f'<figure><img alt="" src="data:image/png;base64,{base64.b64encode(png).decode()}"></figure>'


class Table(str):
    """An HTML table that knows what stands in it: head and body, the words of its cells."""

    def __new__(cls, text: str, head, body):
        made = super().__new__(cls, text)
        made.head, made.body = [str(cell) for cell in head], [[str(cell) for cell in row] for row in body]
        return made

    def markdown(self) -> str:
        """The same as lines of Markdown."""
        rows = [self.head, ["---"] * len(self.head), *self.body]
        return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n" for row in rows)


def table(head, body, failed=(), words=()) -> Table:
    """An HTML table; `failed`: indices of rows to mark; words: of columns that hold text, even where it begins with a
    digit."""
    body = [list(row) for row in body]
    lines = ["<tr>" + "".join(f"<th>{html.escape(str(cell))}</th>" for cell in head) + "</tr>"]
    for index, row in enumerate(body):
        cells = "".join(
            f"<td{'' if k in words else _numeric(cell)}>{html.escape(str(cell))}</td>" for k, cell in enumerate(row)
        )
        lines.append(f"<tr{' class=no' if index in failed else ''}>{cells}</tr>")
    return Table("<table>" + "".join(lines) + "</table>", head, body)


def plain(text: str) -> str:
    """Text as HTML shows it literally."""
    return html.escape(text, quote=False)


def _numeric(cell) -> str:
    return " class=n" if str(cell)[:1].isdigit() or str(cell)[:1] == "-" else ""


def footer() -> str:
    """The last line of a page: what computed it, when, and by which command."""
    return f"<footer>{plain(_origin())}</footer>"


def _origin() -> str:
    told = provenance()
    by = f" by {told['command']}" if told["command"] else ""
    return f"{versions()}, {told['system']}, {told['threads']} threads, {told['date']}{by}"


def write_page(path: Path, title: str, parts: list[str], markdown: bool = False) -> None:
    """Write the page; `parts`: HTML. markdown: its tables beside it, too, as a file of Markdown with its origin."""
    write_text(
        path,
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style><h1>{html.escape(title)}</h1>{''.join(parts)}{footer()}</html>\n",
    )
    if markdown:
        write_text(path.with_suffix(".md"), _as_markdown(title, parts))


def _as_markdown(title: str, parts: list[str]) -> str:
    """The tables of a page, each under the last heading before it."""
    out, heading = [f"# {title}\n"], ""
    for part in parts:
        found = re.findall(r"<h2>(.*?)</h2>", part)
        heading = html.unescape(found[-1]) if found else heading
        if isinstance(part, Table):
            out += ([f"## {heading}\n"] if heading else []) + [part.markdown()]
            heading = ""
    return "\n".join([*out, _origin() + "\n"])
