"""PUBLISH as it passes paho by: written so that a broker reads it, read as paho reads it, however it comes."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mqttxt.core.effects import Publish
from mqttxt.core.mqtt import packets
from mqttxt.core.mqtt.aliases import BrokersAliases
from mqttxt.core.mqtt.packets import PINGREQ, end_of, message_of
from mqttxt.core.mqtt.properties import LARGEST_PACKET
from tests.examples import examples
from tests.rigs import mqtt_server
from tests.rigs.linked import RECEIVE_MAXIMUM_2, linked, state
from tests.rigs.mqtt_server import DISCONNECT, PUBLISH, Packet, Server, encoded, variable_length
from tests.rigs.processes import eventually

PING = 12
TOPICS = st.text("abcé/1", min_size=1, max_size=200)
PAYLOADS = st.binary(max_size=300)


def taken(data: bytes) -> tuple[list[tuple[str, bytes]], int]:
    """Topics and payloads of the whole packets in some bytes, each of them taken for a PUBLISH; where the last ends."""
    found, start = [], 0
    while True:
        body, end = end_of(data, start)
        if end == 0 or end > len(data):
            return found, start
        topic, payload, _, _ = message_of(data, start, body, end, BrokersAliases(0))
        found.append((topic.decode(), payload))
        start = end


NUMBERS = st.none() | st.integers(1, 65_535)


@given(TOPICS, PAYLOADS, st.booleans(), NUMBERS, st.none() | st.integers(1, 2**32 - 1), NUMBERS)
def test_a_broker_reads_what_was_published(
    topic: str, payload: bytes, retain: bool, alias: int | None, expiry_s: int | None, mid: int | None
) -> None:
    data = packets.publish(Publish("cloud", topic, payload, 0, retain, expiry_s), topic, alias, mid)
    body, end = end_of(data, 0)
    assert end == len(data)
    packet = Packet(data[0] >> 4, data[0] & 15, data[body:])
    properties = {identifier: value for identifier, value in ((2, expiry_s), (35, alias)) if value is not None}
    assert (packet.kind, packet.flags) == (PUBLISH, retain | (2 if mid is not None else 0))
    assert packet.publish() == (topic, properties, payload, mid or 0)


@examples(100)
@given(st.lists(st.tuples(TOPICS, PAYLOADS), max_size=5), st.integers(0, 2000))
def test_messages_are_taken_once_they_are_whole(said: list[tuple[str, bytes]], cut: int) -> None:
    data = b"".join(published(topic.encode(), payload=payload) for topic, payload in said)
    first, end = taken(data[:cut])
    second, rest = taken(data[end:])
    assert first + second == said
    assert end + rest == len(data)


def published(
    topic: bytes, properties: bytes = b"", payload: bytes = b"x", *, qos: int = 0, retain: bool = False
) -> bytes:
    """A PUBLISH with any topic and properties."""
    name = len(topic).to_bytes(2, "big") + topic
    mid = b"\0\x03" if qos else b""
    length = variable_length(len(properties))
    return encoded(Packet(PUBLISH, qos << 1 | retain, name + mid + length + properties + payload))


@given(st.binary(max_size=60))
@example(b"\x30\x00")
@example(b"\x30\x01\x00\x00")
@example(b"\x30\x02\x00\x00")
@example(b"\x30\x05\x00\x01t\x7f\x00")
@example(b"\x32\x06\x00\x01t\x00\x01\x00")
@example(b"\x32\x05\x00\x01t\x00\x01\x00")
@example(b"\x30\x04\x00\x02t\x00")
@example(b"\x30\x06\x00\x01t\x80\x80\x01")
def test_bytes_that_are_no_publish_are_refused(data: bytes) -> None:
    try:
        found, end = taken(data)
    except ValueError:
        return
    assert end <= len(data)
    assert all(topic for topic, _ in found)


async def test_messages_come_in_order_whoever_reads_them_and_in_whatever_pieces() -> None:
    """QoS 0 with and without properties, QoS 1, and many at once: more than are taken in one turn."""
    with_properties = b"\x26\x00\x01a\x00\x01b"
    said = [
        mqtt_server.publish("t", b"plain"),
        published(b"t", with_properties, b"properties"),
        mqtt_server.publish("t", b"acknowledged", qos=1, mid=3),
        published(b"t", payload=b"retained", retain=True),
        published(b"t", with_properties, b"retained, acknowledged", qos=1, retain=True),
        mqtt_server.publish("t", bytes(40_000)),
        *(mqtt_server.publish("t", str(number).encode()) for number in range(1000)),
        mqtt_server.publish("t", b"last", qos=1, mid=4),
    ]
    early = [b"plain", b"properties", b"acknowledged", b"retained", b"retained, acknowledged"]
    expected = [*early, bytes(40_000), *(str(n).encode() for n in range(1000))]
    async with Server() as server, linked(server) as (_, heard):
        data, (session,) = b"".join(said), server.sessions
        places = [*range(60), *range(60, len(data), 997)]
        for start, end in zip(places, [*places[1:], len(data)], strict=True):
            session.send(data[start:end])
            await asyncio.sleep(0)
        await eventually(lambda: len(heard.messages) == len(said), "all of them")
        assert [message.payload for message in heard.messages] == [*expected, b"last"]
        assert [message.payload for message in heard.messages if message.retain] == early[3:]


async def test_a_packet_that_is_longer_than_was_announced_ends_the_connection() -> None:
    async with Server() as server, linked(server) as (_, heard):
        server.sessions[0].send(mqtt_server.publish("t", bytes(LARGEST_PACKET))[:100])
        await eventually(lambda: heard.connections == 2, "connected again")
        assert heard.messages == []


@pytest.mark.long
@pytest.mark.parametrize("answers", [True, False])
async def test_a_broker_that_says_nothing_is_asked_and_given_up_where_it_does_not_answer(answers: bool) -> None:
    keepalive_1 = b"\x13\x00\x01"
    async with Server(keepalive_1) as server, linked(server) as (_, heard):
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PING)) == 1, "a question")
        for count in range(2, 4 if answers else 2):
            session.send(b"\xd0\x00")
            await eventually(lambda count=count: len(session.of(PING)) == count, "the next")  # type: ignore[misc]
        if answers:
            assert heard.losses == 0
            return
        await eventually(lambda: heard.connections == 2, "connected again")
        assert [packet.kind for packet in session.packets[1:]] == [PING, DISCONNECT]


@pytest.mark.long
async def test_who_speaks_and_is_spoken_to_asks_nothing() -> None:
    keepalive_1 = b"\x13\x00\x01"
    async with Server(keepalive_1) as server, linked(server) as (link, heard):
        (session,) = server.sessions
        for _ in range(30):
            link.publish(state("battery"))
            session.send(mqtt_server.publish("t", b"x"))
            await asyncio.sleep(0.1)
        assert len(heard.messages) == 30
        assert PINGREQ not in [encoded(packet) for packet in session.packets]


async def test_a_message_that_cannot_be_encoded_takes_no_packet_id() -> None:
    async with Server(RECEIVE_MAXIMUM_2) as server, linked(server) as (link, heard):
        for number in range(2):
            with pytest.raises(OverflowError):
                link.publish(replace(state("armed", qos=1, ref=number), expiry_s=2**32))
        link.publish(state("armed", qos=1, ref="next"))
        await eventually(lambda: heard.acknowledged == [("next", 0)], "the next one")
