"""Profile -> resolved plan -> commands, compared with what was looked at and kept in `golden/`.

`UPDATE_GOLDEN=1` writes them anew; then look at what changed.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from testbed.cli.profiles import script_of
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.kernel import commands_of
from testbed.plan.profiles.reading import profile_names, read_profile
from testbed.plan.profiles.resolve import resolve

TOPOLOGY = standard_fleet().topology()

GOLDEN = Path(__file__).parent / "golden"
NAMES = [*profile_names(), "everything"]
LENGTH_S = 30


def _as_text(data: dict[str, Any]) -> str:
    """JSON with a line for each link and each event."""
    links = ",\n".join(f"  {json.dumps(name)}: {json.dumps(link)}" for name, link in data["links"].items())
    events = ",\n".join(f"  {json.dumps(event)}" for event in data["events"])
    head = json.dumps({key: data[key] for key in ("version", "profile", "seed")})[1:-1]
    return f'{{{head},\n "links": {{\n{links}\n }},\n "events": [\n{events}\n ]}}\n'


@pytest.mark.parametrize("name", NAMES)
def test_a_profile_gives_its_plan_and_the_plan_its_commands(name: str) -> None:
    given = name if name in profile_names() else str(GOLDEN / f"{name}.yaml")
    plan = resolve(read_profile(given), TOPOLOGY, "scenario-1", 1, LENGTH_S)
    found = {
        f"{name}.plan.json": _as_text(plan.to_data()),
        f"{name}.commands.txt": "".join(f"{line}\n" for line in script_of(commands_of(plan, TOPOLOGY))),
    }
    assert json.loads(found[f"{name}.plan.json"]) == plan.to_data()
    for file, text in found.items():
        if os.environ.get("UPDATE_GOLDEN"):
            (GOLDEN / file).write_text(text)
        assert (GOLDEN / file).read_text() == text, "see the module's docstring"


def test_nothing_is_kept_for_profiles_that_are_gone() -> None:
    assert {path.name.partition(".")[0] for path in GOLDEN.iterdir()} == set(NAMES)
