"""The link to an autopilot: what waits is all read at once, and what a line does not take holds nobody up."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from typing import Any

from mqtt_server import eventually
from pymavlink.dialects.v20 import common as mavlink
from world import ack, heartbeat

from mqttxt.io.mavlink import AutopilotAddress, AutopilotLink, _Serial


async def test_an_acknowledgement_behind_other_messages_is_heard_in_the_same_turn() -> None:
    """A tick in between would find it missing, and say the command again."""
    heard: list[str] = []
    held: list[list[str]] = []

    def on_message(message: Any) -> None:
        if not heard:
            asyncio.get_running_loop().call_soon(lambda: held.append(list(heard)))
        heard.append(message.get_type())

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    link = AutopilotLink(AutopilotAddress("udp", "127.0.0.1", port), 1, on_message, heard.append)
    running = asyncio.create_task(link.run())
    await eventually(lambda: link._transport is not None, "it listens")
    autopilot = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for message in [*[heartbeat() for _ in range(100)], ack(400)]:
            sender.sendto(message.pack(autopilot), ("127.0.0.1", port))
    await eventually(lambda: held != [], "heard")
    assert held == [["HEARTBEAT"] * 100 + ["COMMAND_ACK"]]
    running.cancel()
    await asyncio.wait({running})


def test_a_device_that_takes_nothing_holds_nobody_up() -> None:
    theirs, ours = os.openpty()
    tty.setraw(ours)
    line = _Serial(AutopilotAddress("serial", os.ttyname(ours), 57600))
    try:
        assert line.write(b"heartbeat")
        assert os.read(theirs, 100) == b"heartbeat"
        taken = 0
        while line.write(bytes(100)):  # nobody reads: the system's buffer fills
            taken += 100
        assert not line.write(b"heartbeat")
        while taken > 0:
            taken -= len(os.read(theirs, 4096))
        assert line.write(b"heartbeat")
    finally:
        line.close()
        os.close(ours)
        os.close(theirs)
