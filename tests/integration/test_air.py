"""A drone that comes by MQTT-SN over datagrams that get lost: real activator, Mosquitto, UAV client and stand-in."""

from __future__ import annotations

import asyncio
import socket
import subprocess
from functools import partial
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Drone
from mqttxt.core.mqtt.sn import codec
from mqttxt.core.mqtt.sn.packets import Message
from mqttxt.core.mqtt.sn.topic_ids import TopicIds
from tests.rigs.air import AirSystem
from tests.rigs.lossy_air import HEADERS, UP
from tests.rigs.processes import eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]
AIR = pytest.mark.soak(
    "services/mqttxt/src/mqttxt/core/mqtt/sn", "services/mqttxt/src/mqttxt/activator", "tests/rigs/air.py"
)
"""One flight over a lossy air and one cut stand for all, unless the air or its activator has changed."""

MAVLINK_FRAME = 69
"""Bytes that a frame of MAVLink has: no state is to be longer with IPv4's and UDP's headers."""
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


async def up_and_down(system: AirSystem, drone: Drone) -> None:
    """Arm and disarm: the autopilot is told each once."""
    before = system.commanded(ARM)
    assert (await drone.arm()).completed
    assert (await drone.disarm()).completed
    assert system.commanded(ARM) == before + 2


@pytest.mark.parametrize("signed", [pytest.param(False, marks=AIR), True])
async def test_a_flight_over_an_air_that_loses_repeats_and_reorders(tmp_path: Path, signed: bool) -> None:
    system = AirSystem(tmp_path, signed=signed)
    async with system.flying() as (_, drone):
        system.air.be_bad()
        for _ in range(3):
            await up_and_down(system, drone)
        assert (await drone.arm()).completed
        assert (await drone.takeoff(5.0)).completed
        assert (await drone.hold()).completed
        assert (await drone.land()).completed
        assert system.connections() == 1


async def test_a_state_is_smaller_than_a_frame_of_mavlink_and_wireshark_reads_every_packet(tmp_path: Path) -> None:
    system = AirSystem(tmp_path)
    async with system.flying() as (_, drone):
        await up_and_down(system, drone)
        seen = [data for _, data in system.air.seen]
        states = {
            topic: len(data) + HEADERS
            for way, data in system.air.seen
            if way == UP and isinstance(packet := codec.decode(data), Message)
            if (topic := TopicIds().topic_of(packet.topic_id)) and "/state/" in topic
        }
        assert {"drone1/state/location", "drone1/state/battery", "drone1/state/heading"} <= states.keys()
        assert max(states.values()) <= MAVLINK_FRAME
    assert shown(tmp_path, seen) == [codec.decode(data).KIND for data in seen]


def shown(folder: Path, datagrams: list[bytes]) -> list[int]:
    """The kinds of packets that Wireshark's dissector finds, -1 where it finds none or something wrong."""
    text = "".join(f"0000 {data.hex(' ')}\n" for data in datagrams)
    capture = folder / "air.pcap"
    subprocess.run(
        ["text2pcap", "-q", "-u", "1883,1883", "-", str(capture)], input=text.encode(), check=True, capture_output=True
    )
    names = ("mqttsn.msg.type", "_ws.malformed", "mqttsn.msg.len", "udp.length")
    fields = ["-T", "fields", *(option for name in names for option in ("-e", name))]
    command = ["tshark", "-r", str(capture), "-d", "udp.port==1883,mqttsn", *fields]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    found = []
    for line in lines:
        kind, malformed, length, udp = line.split("\t")
        is_right = kind and not malformed and int(length, 0) == int(udp) - 8
        found.append(int(kind, 0) if is_right else -1)
    return found


@AIR
async def test_a_drone_whose_nat_forgets_it_is_back_and_executes_once(tmp_path: Path) -> None:
    system = AirSystem(tmp_path)
    async with system.flying() as (_, drone):
        for times in (2, 3):
            system.air.rebind()
            await eventually(partial(system.has_connected, times), "it is connected again")
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is there again")
            await up_and_down(system, drone)


@AIR
async def test_a_drone_or_an_activator_that_is_killed_is_back(tmp_path: Path) -> None:
    system = AirSystem(tmp_path)
    async with system.flying() as (_, drone):
        await up_and_down(system, drone)
        for process in (system.uav, system.activator):
            process.kill()
            await eventually(lambda: not drone.is_reachable, "it is gone")
            process.start()
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is there again")
            await up_and_down(system, drone)


async def test_a_cut_ends_no_command_wrongly_and_a_stop_says_down(tmp_path: Path) -> None:
    system = AirSystem(tmp_path)
    async with system.flying() as (_, drone):
        system.air.cut()
        meanwhile = await drone.arm(ttl_s=1)
        assert meanwhile.word.is_last
        assert not meanwhile.completed
        assert system.commanded(ARM) == 0
        system.air.go_on()
        await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is there again")
        await up_and_down(system, drone)
        assert await asyncio.to_thread(system.uav.stop) == 0
        await eventually(lambda: not drone.is_reachable, "down was said", limit_s=10)
        system.uav.start()
        await eventually(lambda: drone.is_reachable, "drone 1 is there again")


async def test_the_second_way_may_be_by_tcp(tmp_path: Path) -> None:
    system = AirSystem(tmp_path, and_tcp=True)
    async with system.flying() as (_, drone):
        await up_and_down(system, drone)
        system.air.cut()
        await up_and_down(system, drone)


async def test_nothing_of_a_stranger_changes_what_a_drone_hears(tmp_path: Path) -> None:
    """What was seen is said again from another port, and garbage from a third."""
    system = AirSystem(tmp_path)
    async with system.flying() as (_, drone):
        await up_and_down(system, drone)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.connect(("127.0.0.1", system.air_port))
            for way, data in list(system.air.seen):
                if way == UP:
                    stranger.send(data)
            for length in range(1, 256):
                stranger.send(bytes((length,)) * length)
        await up_and_down(system, drone)
        assert system.connections() == 1


async def test_a_taken_udp_port_is_one_line(tmp_path: Path) -> None:
    system = AirSystem(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", system.air_port))
        system.cloud.start()
        system.fog.start()
        try:
            system.activator.start()
            assert await asyncio.to_thread(system.activator.wait) == 2
        finally:
            await system.end()
    (line,) = [line for line in system.activator.said().splitlines() if line.startswith("mqttxt: ")]
    assert line.startswith(f"mqttxt: --air-sn 127.0.0.1:{system.air_port}: ")
    assert "expected a free UDP port of this machine" in line
