"""The page's files: no markup of texts, no other machine, and libraries with their licences (docs/page.md)."""

from __future__ import annotations

import re
from pathlib import Path

import mqttxt.page
from tests.tools.page_libraries import LIBRARIES

ASSETS = Path(mqttxt.page.__file__).parent / "assets"


def test_no_file_makes_markup_of_texts_or_names_another_machine() -> None:
    for path in ASSETS.iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        address = "(?!)" if path.name in LIBRARIES else "https?:"  # what they name stands in comments
        wrong = rf"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|{address}|style="
        assert not re.search(wrong, text), path


def test_the_libraries_ask_for_nothing_and_each_has_its_licence() -> None:
    licences = (ASSETS / "licences.txt").read_text()
    for name, (package, _) in LIBRARIES.items():
        assert not re.search(
            r"\bfetch\b|XMLHttpRequest|WebSocket|importScripts|new Function", (ASSETS / name).read_text()
        )
        assert f"{name} is index.js of {package.name} {package.version}." in licences
