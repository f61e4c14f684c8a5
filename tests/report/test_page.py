"""Pages: the tables stand beside them as Markdown, with what computed them."""

import pytest

import taichi_eye
from taichi_eye.report.page import plain, table, write_page


@pytest.mark.parametrize("markdown", [True, False])
def test_tables_stand_beside_the_page_as_markdown(markdown, tmp_path):
    head, body = ("quantity", "a|b"), [["<x>", 1.5], ["of < 3", "-"]]
    parts = [
        f"<h2>{plain('R & D')}</h2><pre>|</pre>",
        table(head, iter(body), [1]),
        "<p>word</p>",
        table(("c",), [[2]]),
    ]
    write_page(tmp_path / "page.html", "a page", parts, markdown=markdown)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == ({"page.html", "page.md"} if markdown else {"page.html"})
    if markdown:
        lines = (tmp_path / "page.md").read_text().splitlines()
        assert lines[:1] == ["# a page"] and lines[2] == "## R & D"
        assert lines[4:8] == ["| quantity | a\\|b |", "| --- | --- |", "| <x> | 1.5 |", "| of < 3 | - |"]
        assert lines[9:12] == ["| c |", "| --- |", "| 2 |"] and taichi_eye.__version__ in lines[-1]
