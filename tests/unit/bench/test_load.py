"""How a load of many drones is divided among fleets, and what a run of it has shown; nothing of it runs here."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.bench.load import Fogs, Load, judged

ARM = 400
"""MAV_CMD_COMPONENT_ARM_DISARM."""


def of_one_drone(folder: Path, commands: Sequence[tuple[float, str, str | None]], times: list[float]) -> Load:
    """The judgement on commands (when, last word, reason) and on when the autopilot was told to arm or disarm."""
    said = {"commands": {"fleet1/1/1": commands}, "silent": [], "ages_s": [0.2, 1.1]}
    (folder / "station.json").write_text(json.dumps(said))
    report = {"commanded": {"air/fleet1/fog1/1": [(ARM, at_s) for at_s in times]}, "failed": []}
    (folder / "drones-fleet1.json").write_text(json.dumps(report))
    return judged(folder, Fogs(1, 1).plan(), 30.0, 2.0, {}, {})


def test_drones_beyond_the_ids_of_a_fleet_are_several_fleets() -> None:
    plan = Fogs(10, 100).plan()
    assert [fog for _, fog, _, _ in plan] == list(range(1, 11))
    assert [(prefix, first, last) for prefix, _, first, last in plan[:3]] == [
        ("fleet1/", 1, 100),
        ("fleet1/", 101, 200),
        ("fleet2/", 1, 100),
    ]
    assert plan[-1][0] == "fleet5/"


def test_few_drones_are_as_many_fleets_as_asked_for() -> None:
    fleets = [prefix for prefix, *_ in Fogs(10, 8, fleets=4).plan()]
    assert sorted(set(fleets)) == ["fleet1/", "fleet2/", "fleet3/", "fleet4/"]
    assert max(map(fleets.count, fleets)) == 3


def test_each_command_is_carried_out_once_and_its_delay_counts(tmp_path: Path) -> None:
    done = [(10.0, "completed", None), (20.0, "completed", None), (30.0, "completed", None)]
    found = of_one_drone(tmp_path, done, [10.1, 20.2, 30.9])
    assert (found.commands, found.lost, found.late, found.doubled) == (3, 0, 0, 0)
    assert (found.median_s, found.slowest_s) == pytest.approx((0.2, 0.9))
    assert (found.start_s, found.oldest_s) == (2.0, 1.1)


def test_what_was_lost_late_or_doubled_is_counted(tmp_path: Path) -> None:
    said = [(10.0, "completed", None), (20.0, "unconfirmed", "no_ack"), (30.0, "expired", None)]
    found = of_one_drone(tmp_path, said, [9.0, 20.1, 20.3, 35.5])
    assert found.words == {"completed": 1, "unconfirmed(no_ack)": 1, "expired": 1}
    assert found.lost == 2  # the first was not carried out, the second has no certain word
    assert found.doubled == 2  # once before any command, once more for the second
    assert found.late == 1


def test_a_drone_without_a_command_is_judged_too(tmp_path: Path) -> None:
    assert of_one_drone(tmp_path, [], [5.0]).doubled == 1
