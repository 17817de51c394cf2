"""The message set in its smallest form over both: one of each kind, by one drone, and nothing of the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.e2e.flying import FEW, Run, attempt_over, few_drones

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(600),
    pytest.mark.soak(
        *("compose.yaml", "testbed/fly/flights.py", "testbed/numbers/kinds.py"),
        *(f"services/mission/src/mission/{name}.py" for name in ("mavsdk_messages", "message_set", "mqttxt_messages")),
    ),
]

COMMANDS = ["arm", "takeoff", "land", "offboard", "goto"]
KINDS = [*COMMANDS, "battery", "location", "groundspeed", "flight_mode", "heading"]
SERVICES = {
    "mqttxt": {"broker", "activator1", "client1"},
    "mavlink": {"router-gs", "router-cloud", "router-fog1", "router-uav1"},
}


def test_one_message_of_each_kind_is_counted_over_both(tmp_path: Path) -> None:
    run = Run(tmp_path / "results", "--count", "1", experiment="messages", environment=few_drones(tmp_path))
    assert run.wait() == 0, run.output
    for protocol, services in SERVICES.items():
        (measured,) = run.metrics()["protocols"][protocol]["attempts"]
        assert measured["status"] == "completed"
        kinds = measured["message_set"]
        assert list(kinds) == KINDS
        assert all((kind["asked"], kind["received"]) == (1, 1) for kind in kinds.values()), kinds
        ages = [kind["delay_app_ms"] for kind in kinds.values() if kind["form"] == "state"]
        assert all(len(told) == (protocol == "mqttxt") for told in ages), "MAVSDK tells none"
        flight = attempt_over(run, protocol)
        manifest = flight.manifest()
        assert manifest["configuration"]["count"] == 1
        nodes = {node["name"] for node in manifest["topology"]["nodes"]}
        assert set(manifest["cpu_s"]) - nodes - {"net"} == {"sitl1", *services}
        assert list((flight.path / "sitl").glob("*.sock")) == []
        events = [json.loads(line) for line in (flight.path / "events.jsonl").read_text().splitlines()]
        assert [event["command"] for event in events if event["event"] == "command"] == COMMANDS
        silent = [f"air:uav{drone}:{way}" for drone in range(2, FEW + 1) for way in ("up", "down")]
        assert all(measured["links"].get(link, {}).get("packets", 0) == 0 for link in silent)
