"""A series' report as people see it: its parsed page, and its summary on a terminal."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from testbed.fly.results import Series
from testbed.present.report.figures import files
from testbed.present.report.html import write_report
from testbed.present.report.terminal import print_summary


@contextmanager
def sketched_papers() -> Iterator[None]:
    """Reduce figures for papers to their titles: drawing one takes a third of a second. `test_figures.py` tests one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "pdf", lambda drawing, title: f"%PDF {title}".encode())
        yield


class Page(HTMLParser):
    """Sections by their id with the text in them, every row of every table, and whether tags are closed as opened."""

    VOID = frozenset({"meta", "link", "br", "path", "polyline"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sections: dict[str, str] = {}
        self.rows: list[list[str]] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self._section = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if found.get("id"):
            self.ids.add(str(found["id"]))
        if tag == "section":
            self._section = found.get("id") or ""
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
        if tag == "a" and found.get("href"):
            self.links.append(str(found["href"]))

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.sections[self._section] = self.sections.get(self._section, "") + data
        if self.rows and self.rows[-1] and ("td" in self.open or "th" in self.open):
            self.rows[-1][-1] += data


def page_of(series: Series, metrics: dict[str, Any]) -> Page:
    return Page(write_report(series, metrics).read_text())


def terminal_of(series: Series, metrics: dict[str, Any], width: int = 140) -> str:
    console = Console(file=StringIO(), width=width)
    print_summary(series, metrics, console)
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


def cells_of(shown: str) -> list[list[str]]:
    """The cells of each line of a terminal, which are two blanks apart at least."""
    return [re.split(r" {2,}", line.strip()) for line in shown.splitlines()]
