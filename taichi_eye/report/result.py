"""report.html: a run or an analysis on one self-contained page, and what a notebook shows for it.

The page is one element, <main class="taichi-eye">, with its own style, film, pictures and tables; a notebook shows that
element alone. Nothing is loaded from anywhere. Whatever a user named (files, scenes, notes) is text and never HTML.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from taichi_eye.report.folder import write_text
from taichi_eye.report.page import footer, plain, table

NAME = "report.html"
BEGIN, END = '<main class="taichi-eye">', "</main>"
STYLE = """.taichi-eye{font:15px/1.5 system-ui,sans-serif;color:#22262b;background:#fff;max-width:75rem;margin:0 auto;
padding:0 1rem}
.taichi-eye h1{font-size:1.6rem}.taichi-eye h2{font-size:1.15rem;margin:1.8rem 0 .4rem}
.taichi-eye table{border-collapse:collapse;font-size:13px;margin:.5rem 0}
.taichi-eye td,.taichi-eye th{padding:.2rem .7rem;border-bottom:1px solid #d8dce0;text-align:left;vertical-align:top}
.taichi-eye td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}.taichi-eye .no{background:
#fbe3e0}
.taichi-eye video{width:100%;max-width:72rem}
.taichi-eye video,.taichi-eye img{max-width:100%;margin:.5rem 0;border-radius:4px}
.taichi-eye figure{margin:.5rem 0}.taichi-eye figcaption{color:#6b737c;font-size:13px}
.taichi-eye .warning{border-left:4px solid #c9641a;background:#fdf3ec;padding:.4rem .8rem;margin:.4rem 0}
.taichi-eye footer{color:#6b737c;font-size:12px;margin:2rem 0 1rem}"""


def fragment(title: str, parts: Iterable[str]) -> str:
    """The page's one element; parts: HTML."""
    return f"{BEGIN}<style>{STYLE}</style><h1>{plain(title)}</h1>{''.join(parts)}{footer()}{END}"


def write(path: Path, title: str, body: str) -> None:
    """Write the page around what `fragment` made; of a name that is no text, escapes stand there."""
    text = (
        f"<!doctype html>\n<html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>{html.escape(title)}</title>\n{body}\n</html>\n"
    )
    write_text(path, text.encode(errors="backslashreplace").decode())


def read(folder: Path) -> str | None:
    """The element of a folder's page; None where there is no whole page."""
    try:
        text = (folder / NAME).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    begin, end = text.find(BEGIN), text.rfind(END)
    return text[begin : end + len(END)] if 0 <= begin < end else None


def section(heading: str, *parts: str) -> str:
    """A heading over parts; nothing where there are none."""
    body = "".join(parts)
    return f"<h2>{plain(heading)}</h2>{body}" if body else ""


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{plain(text)}</p>"


def warnings(texts: Sequence[str]) -> str:
    """What is to be doubted, a box each."""
    return "".join(f"<div class=warning>{plain(text)}</div>" for text in texts)


def video(mp4: bytes, gain: float = 1.0) -> str:
    """A film that plays by itself, over and over; gain: how much brighter it is shown than it is."""
    data = base64.b64encode(mp4).decode()
    shown = f" style='filter:brightness({gain:g})'" if gain != 1.0 else ""
    return f'<video controls autoplay loop muted playsinline{shown} src="data:video/mp4;base64,{data}"></video>'


def image(png: bytes, caption: str) -> str:
    """A picture with its caption, which is its alternative text, too."""
    data = base64.b64encode(png).decode()
    return (
        f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{plain(caption)}</figcaption></figure>"
    )


def rows(head: Sequence[str], body: Sequence[Sequence[object]], words: Sequence[int] = ()) -> str:
    """A table; nothing where it has no rows. words: of columns that hold text."""
    return table(head, body, words=words) if body else ""


def shown(value: object) -> str:
    """A figure as a table has it."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
