"""What a flight needs of `net` is read off the series that are kept, and what it could not carry is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.bench.net_limit import _against, most_needed


def _series(folder: Path, arm: str, **sides: list[dict[str, Any]]) -> None:
    path = folder / arm / "20260101T000000Z"
    path.mkdir(parents=True)
    protocols = {protocol: {"attempts": attempts} for protocol, attempts in sides.items()}
    (path / "metrics.json").write_text(json.dumps({"protocols": protocols}))


def _attempt(packets: int, mission_s: float | None, drones: int) -> dict[str, Any]:
    return {"packets": packets, "mission_s": mission_s, "outcomes": {str(drone): [] for drone in range(drones)}}


def test_the_busiest_series_says_what_a_drone_needs(tmp_path: Path) -> None:
    _series(tmp_path, "quiet", mqttxt=[_attempt(600, 20.0, 3)], mavlink=[_attempt(99_999, None, 3)])
    _series(tmp_path, "busy", mqttxt=[_attempt(600, 20.0, 2), _attempt(300, 20.0, 2)])
    assert most_needed(tmp_path, "mqttxt") == (15.0, "busy")


@pytest.mark.parametrize(
    ("arrived", "void", "dropped", "said"),
    [
        (8, None, [0, 0], None),
        (7, None, [0, 0], "1 of 8 packets lost"),
        (8, "the emulator did not keep up", [0, 0], "the emulator did not keep up"),
        (8, None, [0, 3], "captures dropped 3"),
    ],
)
def test_what_was_not_carried_is_named(arrived: int, void: str | None, dropped: list[int], said: str | None) -> None:
    assert _against(8, arrived, {"void": void}, [{"dropped": count} for count in dropped]) == said
