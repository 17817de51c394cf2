"""The pages about links say what the profiles, their schema and their plans are, and what the simulation says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import SCHEMA_FILE, profile_names, read_profile
from testbed.plan.profiles.resolve import resolve
from tests.bench import thesis

TOPOLOGY = standard_fleet().topology()

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "links.md").read_text()


def test_every_profile_has_its_row() -> None:
    rows = dict(re.findall(r"^\| `([a-z0-9-]+)` \| (.*) \|$", PAGE.partition("## Which link")[0], re.MULTILINE))
    assert rows == {name: read_profile(name).description for name in profile_names()}


def test_every_field_of_the_schema_is_told() -> None:
    schema = json.loads(SCHEMA_FILE.read_text())
    told = set(re.findall(r"`([a-z]+)[`:]", PAGE)) | set(re.findall(r"^ *([a-z]+):", PAGE, re.MULTILINE))
    fields = {name for part in ("link", "figures", "change", "event") for name in schema["$defs"][part]["properties"]}
    assert fields | set(schema["properties"]) <= told | {"up", "down"}


def test_the_profile_of_ones_own_resolves(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    path = tmp_path / "valley.yaml"
    path.write_text(block)
    plan = resolve(read_profile(str(path)), TOPOLOGY, "scenario-1", 1)
    assert (plan.links["air:uav3:up"].loss, plan.links["air:uav2:up"].loss) == (0.04, 0.005)
    assert [event.link for event in plan.events] == ["air:uav3:up", "air:uav3:down"]


@pytest.mark.long
def test_what_the_thesis_profile_loses_is_what_the_simulation_says() -> None:
    page = DOCS / "links-measured.md"
    told = page.read_text().partition(thesis.BEGIN)[2].partition(thesis.END)[0]
    assert told == thesis.sentence(), f"type: .venv/bin/python -m tests.bench.thesis docs/{page.name}"


def test_the_plan_in_the_page_is_the_one_that_is_made() -> None:
    (block,) = re.findall(r"```json\n(.*?)```", (DOCS / "links-design.md").read_text(), re.DOTALL)
    told = json.loads(block)
    made = resolve(read_profile(told["profile"]), TOPOLOGY, "scenario-1", 1).to_data()
    assert told["links"].items() <= made["links"].items()
    assert told["events"] == made["events"][:1]
    assert {key: told[key] for key in ("version", "seed")} == {key: made[key] for key in ("version", "seed")}
    assert set(told) == set(made)
