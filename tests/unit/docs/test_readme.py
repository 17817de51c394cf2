"""The README: its figures are those of the page of what was found, and what it names is there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_its_figures_are_those_of_the_results_page() -> None:
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    in_short = page.split("## In short", 1)[1].split("\n## ", 1)[0]
    found = README.split("](docs/results.md)", 1)[1].split("\n## ", 1)[0]
    figures = re.findall(r"(?<!\w)\d[\d.,]* (?:times|ms|s|%)(?!\w)", found)
    assert len(figures) == 12
    assert [figure for figure in figures if figure not in in_short] == []


def test_every_file_that_it_links_to_is_there() -> None:
    linked = re.findall(r"\]\(((?!https:)[^)#]+)", README)
    assert len(linked) > 15
    assert [name for name in linked if not (ROOT / name).is_file()] == []
