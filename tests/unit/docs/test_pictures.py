"""The documents' pictures: made by the command, shown by a page, and true of the fleet and of the results folder."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from xml.etree import ElementTree

import pytest

from spec import load_picture, pictures
from spec.scale import read_runs
from testbed.plan.fleets import standard_fleet
from tests.tools import screenshot

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "docs" / "pictures"


def texts(name: str) -> list[str]:
    tree = ElementTree.fromstring((FOLDER / f"{name}.svg").read_text(encoding="utf-8"))
    return [element.text or "" for element in tree.iter("{http://www.w3.org/2000/svg}text")]


def test_every_picture_is_what_the_command_writes(tmp_path: Path) -> None:
    pictures.main(str(tmp_path))
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    kept = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.svg")}
    assert made == kept, "run make docs"


def test_the_reports_picture_is_as_large_as_the_command_makes_it() -> None:
    head = (FOLDER / "report.png").read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">2I", head[16:]) == (screenshot.WIDTH, screenshot.HEIGHT)


def test_the_terminals_figures_are_those_of_the_kept_series_and_nothing_is_loaded() -> None:
    (path,) = (ROOT / "docs" / "findings" / "scenario-1" / pictures.SHOWN).glob("*/metrics.json")
    metrics = json.loads(path.read_text(encoding="utf-8"))
    shown = " ".join(texts("terminal")).replace("\xa0", " ")
    assert f"{sorted(one['packets'] for one in metrics['protocols']['mavlink']['attempts'])[1]:,} packets" in shown
    assert not re.search(r"@font-face|url\(http|<image", (FOLDER / "terminal.svg").read_text(encoding="utf-8"))


def test_the_load_has_the_delays_of_every_run_and_the_medians_of_those_that_have_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = [run | {"median_s": median_s} for run, median_s in zip(read_runs()[:2], (0.02, 0.05), strict=True)]
    others = read_runs()[2:]
    monkeypatch.setattr(load_picture, "read_runs", lambda: [*runs, *others])
    tree = ElementTree.fromstring(load_picture.draw().svg())
    right = [one for one in tree.iter("{http://www.w3.org/2000/svg}text") if float(one.get("x", "0")) > 650]
    dots = [one.get("class", "").strip() for one in right if one.text == "●"]
    assert dots.count("mqttxt small") == 2 + len(others)
    assert dots.count("small") == 2 + sum("median_s" in run for run in others)


@pytest.mark.parametrize("file", sorted(path.name for path in FOLDER.iterdir()))
def test_every_picture_is_shown_by_a_page(file: str) -> None:
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md")]
    assert any(f"](pictures/{file})" in page for page in pages)


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
