"""The documents' pictures: made by the command, shown by a page, and true of the fleet and of the results folder."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from spec import pictures
from testbed.plan.fleets import standard_fleet

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "docs" / "pictures"


def texts(name: str) -> list[str]:
    tree = ElementTree.fromstring((FOLDER / f"{name}.svg").read_text(encoding="utf-8"))
    return [element.text or "" for element in tree.iter("{http://www.w3.org/2000/svg}text")]


def test_every_picture_is_what_the_command_writes(tmp_path: Path) -> None:
    pictures.main(str(tmp_path))
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert made == {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}, "run make docs"


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_every_picture_is_shown_by_a_page(name: str) -> None:
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md")]
    assert any(f"](pictures/{name}.svg)" in page for page in pages)


def test_the_topology_has_every_node_with_its_address_and_every_link() -> None:
    shown, fleet = texts("topology"), standard_fleet().topology()
    assert {text for node in fleet.nodes for text in (node.name, node.address)} <= set(shown)
    assert sum(text in ("wan", "backhaul", "air") for text in shown) == len(fleet.links)


def test_the_programs_on_the_nodes_are_those_of_the_compose_file() -> None:
    assert pictures.programs("cloud", "mqttxt") == ["Mosquitto"]
    assert pictures.programs("fog", "mqttxt") == ["mqttxt activator"]
    assert pictures.programs("uav", "mavlink") == ["sitl (autopilot)", "mavp2p"]


def test_every_file_in_the_data_flow_is_told_in_the_page_about_results() -> None:
    page = (ROOT / "docs" / "results-folder.md").read_text(encoding="utf-8")
    files = re.findall(r"[\w-]+(?:\.(?:json|jsonl|parquet|html)|/(?=\s|$))", "  ".join(texts("data-flow")))
    assert len(files) > 10
    assert [name for name in files if name not in page] == []
