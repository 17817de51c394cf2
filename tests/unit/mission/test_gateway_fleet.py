"""MAVSDK through the gateway: the process that runs beside the mission, and what becomes of it."""

from __future__ import annotations

import asyncio
import sys
from io import StringIO
from pathlib import Path

import pytest

from mission.events import EventLog
from mission.fleet import MissionError
from mission.gateway_fleet import GatewayFleet, gateway_command
from mission.options import Options
from tests.rigs.processes import free_port


def _options(**changed: object) -> Options:
    fixed = ("scenario-1", "mqttxt", {1: (1, 2), 2: (4,)}, "mqtt://127.0.0.1:1", "1", "on-change", ())
    return Options(*fixed, "px4-gcs", "concurrent", gateway=True, **changed)  # type: ignore[arg-type]


def test_the_gateway_has_the_missions_fogs_broker_and_identity() -> None:
    begin = [sys.executable, "-m", "mqttxt", "gs", "mavlink", "--cloud", "mqtt://127.0.0.1:1", "--qos", "1"]
    fogs, to = ["--fog", "1", "--fog", "2"], ["--to", "udp:127.0.0.1:14550"]
    assert gateway_command(_options(), 14550) == [*begin, *fogs, "--insecure", *to]
    identity = Path("/run/fleet/gs-ops")
    assert gateway_command(_options(identity=identity), 14550) == [*begin, *fogs, "--identity", str(identity), *to]
    signed = ["--identity", str(identity), "--signed"]
    assert gateway_command(_options(identity=identity, signed=True), 14550) == [*begin, *fogs, *signed, *to]


@pytest.mark.long
async def test_a_gateway_that_ends_fails_the_mission_with_its_last_line(tmp_path: Path) -> None:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    fleet = GatewayFleet(_options(identity=tmp_path / "none"), log, free_port())
    try:
        with pytest.raises(MissionError, match=r"the gateway has ended: mqttxt: .*none"):
            await fleet.connect(60)
    finally:
        await fleet.close()
    assert fleet._gateway is not None
    assert fleet._gateway.returncode == 2
    assert not [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
