"""Bytes on the wire of each state and command: captured frames, Ethernet to payload, without and with their ACKs."""

from __future__ import annotations

import asyncio
import socket
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Publish
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.protocol.bundles import drone_bundle
from mqttxt.protocol.codec import encode
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.topics import CloudSide, FogSide
from mqttxt.protocol.values import Encoding
from tests.bench.brokers import BenchBroker
from tests.bench.capture import Capture, Frame
from tests.bench.fleet import FIVE
from tests.bench.raw_mqtt import RawClient
from tests.bench.vital import COMMANDS, STAMP, command_payload, mavlink_commands, mavlink_states
from tests.rigs.linked import Heard
from tests.rigs.processes import eventually, free_port

APART_S = 0.15
"""The pause between two messages: longer than TCP may delay an ACK."""


@dataclass(frozen=True)
class Size:
    """Bytes of the frames that carry a message, alone and with those that acknowledge it."""

    alone: float
    with_acks: float

    def __str__(self) -> str:
        return f"{self.alone:.0f} ({self.with_acks:.0f})"


def measure() -> list[str]:
    """A table; takes about 15 s."""
    sizes = asyncio.run(_measure())
    return [*_state_lines(sizes), *_command_lines(sizes)]


Turn = tuple[str, list[Publish]]


def turns() -> list[Turn]:
    """The messages to publish, by the name of their column and row; those of a turn are sent at once."""
    found: list[Turn] = []
    fog, cloud = FogSide(), CloudSide(1)
    for encoding in Encoding:
        payloads = {state.name: encode_state(StampedState(state, STAMP), encoding) for state in FIVE}
        publishes = [Publish("fog", fog.state(1, name), payload) for name, payload in payloads.items()]
        bundle = Publish("fog", fog.states(1), encode(drone_bundle(FIVE, STAMP), encoding))
        for use in ("first", "again"):
            found += [(f"{use} {encoding.value} {p.topic.rpartition('/')[2]}", [p]) for p in publishes]
            found.append((f"{use} {encoding.value} bundle", [bundle]))
        found.append((f"together {encoding.value}", publishes))
        # After a QoS 1 exchange TCP lets its ACK ride on the PUBACK; after a series of QoS 0 messages not yet.
        found.append((f"exchange {encoding.value}", [Publish("fog", cloud.broadcast, b"x", qos=1)]))
        for command in COMMANDS:
            payload = command_payload(command, encoding)
            for side, topic in (("cloud", cloud.drone_commands(1)), ("fog", fog.commands(1))):
                effect = Publish("fog", topic, payload, qos=1, expiry_s=5)
                found.append((f"{side} {encoding.value} {command.name}", [effect]))
    return found


async def _measure() -> dict[str, Size]:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        broker, plain = BenchBroker(folder, "fog"), BenchBroker(folder, "plain", "max_topic_alias 0\n")
        for each in (broker, plain):
            stack.callback(each.start().kill)
        udp = free_port(socket.SOCK_DGRAM)
        found: dict[str, Size] = {}
        marks: list[tuple[str, float, float]] = []
        capture = Capture(folder, [broker.port, plain.port, udp])
        with capture:
            for prefix, port in (("", broker.port), ("plain ", plain.port)):
                listener = await RawClient.connect(port, "listener")
                stack.callback(listener.close)
                await listener.subscribe("#")
                marks += [(prefix + key, start, end) for key, start, end in await _publish(port, turns())]
            marks += await _datagrams(udp)
        for key, start, end in marks:
            frames = capture.between(start, end)
            carrying = _carrying(frames, {broker.port, plain.port, udp})
            assert len(carrying) == 1, (key, frames)
            connection = [f for f in frames if carrying[0].source in (f.source, f.target)]
            found[key] = Size(carrying[0].size, sum(f.size for f in connection))
        return found


def _carrying(frames: list[Frame], towards: set[int]) -> list[Frame]:
    return [frame for frame in frames if frame.target in towards and frame.carried > 0]


async def _publish(port: int, planned: list[Turn]) -> list[tuple[str, float, float]]:
    events = Heard()
    link = MqttLink("fog", BrokerAddress("127.0.0.1", port), "bench", None, events)
    running = asyncio.create_task(link.run())
    await eventually(lambda: events.connections, "connected")
    marks = []
    await asyncio.sleep(APART_S)
    for key, effects in planned:
        start = time.time()
        for effect in effects:
            link.publish(effect)
        await asyncio.sleep(APART_S)
        marks.append((key, start, time.time()))
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert events.counted == []
    return marks


async def _datagrams(port: int) -> list[tuple[str, float, float]]:
    marks = []
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("127.0.0.1", port))
        for name, packet in {**mavlink_states(), **mavlink_commands()}.items():
            start = time.time()
            sender.sendto(packet, ("127.0.0.1", port))
            await asyncio.sleep(0.02)
            marks.append((f"mavlink {name}", start, time.time()))
    return marks


def _state_lines(sizes: dict[str, Size]) -> list[str]:
    ways = {
        "CBOR, topic": "plain again cbor {}",
        "CBOR, alias": "again cbor {}",
        "JSON, topic": "plain again json {}",
        "JSON, alias": "again json {}",
        "MAVLink 2": "mavlink {}",
    }
    lines = ["bytes of a state: frame (and with its ACK)", f"  {'':12}" + "".join(f"{way:>15}" for way in ways)]
    for state in FIVE:
        row = "".join(f"{sizes[key.format(state.name)]!s:>15}" for key in ways.values())
        lines.append(f"  {state.name:12}{row}")
    count = len(FIVE)
    for what, encoding in (("CBOR", "cbor"), ("JSON", "json")):
        for how, key in (("in one segment", f"together {encoding}"), ("in a bundle", f"again {encoding} bundle")):
            size = sizes[key]
            lines.append(
                f"  five {how}, {what}, alias: {size}; a state's share {size.alone / count:.0f} "
                f"({size.with_acks / count:.0f})"
            )
    return lines


def _command_lines(sizes: dict[str, Size]) -> list[str]:
    ways = {
        "CBOR, cloud": "cloud cbor {}",
        "CBOR, fog": "fog cbor {}",
        "JSON, cloud": "cloud json {}",
        "JSON, fog": "fog json {}",
        "MAVLink 2": "mavlink {}",
    }
    head = (
        "bytes of a command at QoS 1: frame (with PUBACK and ACKs); CBOR to MAVLink on the cloud's and the fog's side"
    )
    lines = [head, f"  {'':12}" + "".join(f"{way:>15}" for way in ways)]
    for command in COMMANDS:
        row = "".join(f"{sizes[key.format(command.name)]!s:>15}" for key in ways.values())
        reference = sizes[f"mavlink {command.name}"].alone
        ratios = [sizes[f"{side} cbor {command.name}"].alone / reference for side in ("cloud", "fog")]
        lines.append(f"  {command.name:12}{row}   {ratios[0]:.2f} and {ratios[1]:.2f} times")
    return lines
