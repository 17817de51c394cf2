"""What a witness of another autopilot's heartbeats writes down."""

from __future__ import annotations

import json
import socket
import threading
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.errors import SitlError
from sitl.watch import Witness, watch

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def heartbeat(armed: bool, system: int = 3, component: int = 1) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(2, 12, ARMED if armed else 1, 0, 4, 3)
    return bytes(message.pack(mavlink.MAVLink(None, system, component)))


def test_each_change_is_told_once() -> None:
    witness = Witness(3)
    said = [witness.take(heartbeat(armed)) for armed in (False, True, True, False, False)]
    assert said == [[], ["armed"], [], ["disarmed"], []]


def test_other_systems_and_components_are_not_its_autopilot() -> None:
    witness = Witness(3)
    assert witness.take(heartbeat(True, system=4)) == []
    assert witness.take(heartbeat(True, component=191)) == []


def test_bytes_that_are_no_mavlink_are_passed_over() -> None:
    witness = Witness(3)
    assert witness.take(b"\xfd\xff garbage") == []
    assert witness.take(heartbeat(True)) == ["armed"]


def test_events_are_lines_as_the_stand_ins(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = tmp_path / "uav3.jsonl"
    threading.Thread(target=watch, args=(3, ("127.0.0.1", port), log), daemon=True).start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        while not (log.exists() and log.read_text()):
            autopilot.sendto(heartbeat(True), ("127.0.0.1", port))
    event = json.loads(log.read_text().splitlines()[0])
    assert event["event"] == "armed"
    assert isinstance(event["t_ns"], int)


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(SitlError, match=f"127.0.0.1:{port}.*Address already in use"):
            watch(3, ("127.0.0.1", port), tmp_path / "events.jsonl")
