"""The page about UAV clients: what it says of PX4's parameters is what the stand-in has, and the client guards."""

from __future__ import annotations

import re
from pathlib import Path

from mqttxt.drone.mavlink.guarded_parameters import is_guarded
from sitl.px4.parameters import SPECS

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "uav-client.md").read_text()


def test_a_lost_ground_station_is_nothing_to_px4_unless_set() -> None:
    said = re.search(
        r"`(\w+)` is PX4's reaction .* In PX4 1\.15 it is (\d+), nothing; set it to (\d+) \(return\)", PAGE
    )
    assert said is not None
    name, default, wanted = said.groups()
    spec = SPECS[name]
    assert spec.default == int(default)
    assert spec.low <= int(wanted) <= spec.high
    assert is_guarded(name)
    assert f"`--allow-parameter {name}`" in PAGE
