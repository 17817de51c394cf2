"""A broker, or somebody whose messages it passes on, that sends what no client should have to bear."""

from __future__ import annotations

import asyncio
import ssl

import pytest

from mqttxt.core.effects import Inbound
from mqttxt.core.mqtt import aliases as aliases_module
from mqttxt.core.mqtt import client as client_module
from mqttxt.core.mqtt import connection as connection_module
from mqttxt.core.mqtt import outgoing
from mqttxt.core.mqtt.buffered import Buffered
from mqttxt.core.mqtt.properties import LARGEST_PACKET
from tests.examples import first_quick
from tests.rigs.linked import linked, state
from tests.rigs.mqtt_server import PUBACK, Packet, Server, encoded, publish
from tests.rigs.processes import eventually
from tests.unit.mqttxt.test_mqtt_packets import PING, published

LAST = publish("t", b"last")


@pytest.mark.parametrize("aliases", [0, 10])
@pytest.mark.parametrize("qos", [0, 1])
@pytest.mark.parametrize(
    "properties",
    [b"\x26\0\0\0\0" * 12_000, b"\xff" * 60_000, b"\x23\0\x07", b"\x0b\xff\xff", b"\x26\0\x09"],
    ids=["many", "unknown", "alias", "half a number", "half a string"],
)
async def test_what_a_publisher_adds_to_its_message_counts_for_nothing(
    properties: bytes, qos: int, aliases: int
) -> None:
    """paho takes 0.4 s for 64 KiB of user properties; three such messages a second stopped whoever heard them."""
    async with Server() as server, linked(server, aliases=aliases) as (_, heard):
        server.sessions[0].send(published(b"t", properties, qos=qos) + LAST)
        await eventually(lambda: heard.connections == 2 or len(heard.messages) == 2, "both")
        assert heard.messages == [Inbound("t", b"x", qos), Inbound("t", b"last")]
        await eventually(lambda: len(server.sessions[0].of(PUBACK)) == qos, "its acknowledgement")


@pytest.mark.parametrize(
    "packet",
    [
        pytest.param(published(b"t", b"", qos=2), id="QoS 2"),
        pytest.param(published(b"t", b"", qos=3), id="QoS 3"),
        pytest.param(published(b"", b"\x23\0\x01"), id="an alias that nobody gave"),
        pytest.param(b"\x30\x02\0\x09" + LAST, id="a topic beyond the packet's end"),
        pytest.param(b"\x32\x04\0\x01t\0" + LAST, id="half a packet id"),
        pytest.param(b"\x30\x05\0\x01t\x7fx" + LAST, id="properties beyond the packet's end"),
        pytest.param(b"\x30\xff\xff\xff\x7f", id="256 MB announced"),
        pytest.param(b"\x30\xff\xff\xff\xff\x7f", id="a length of five bytes"),
        pytest.param(
            encoded(Packet(PUBACK, 0, b"\0\x01\0" + b"\x88\x27" + b"\x26\0\0\0\0" * 1000)), id="5 kB of PUBACK"
        ),
        pytest.param(encoded(Packet(PUBACK, 0, b"\0")), id="half a PUBACK"),
        pytest.param(encoded(Packet(15, 0, b"\0\0")), id="AUTH"),
        pytest.param(b"\x00\x00", id="no packet type"),
    ],
)
async def test_what_breaks_the_rules_ends_the_connection(packet: bytes) -> None:
    async with Server() as server, linked(server) as (_, heard):
        server.sessions[0].send(packet + LAST)
        await eventually(lambda: heard.connections == 2, "connected again")
        assert heard.messages == []


@pytest.mark.parametrize(
    "packet",
    [
        pytest.param(published(b"", b"\x23\0\x01"), id="an alias that nobody gave"),
        pytest.param(published(b"t", b"\x23\0\0"), id="alias 0"),
        pytest.param(published(b"t", b"\x23\0\x0b"), id="an alias above the maximum"),
        pytest.param(published(b"t", b"\x23"), id="half an alias"),
        pytest.param(published(b"", b""), id="neither topic nor alias"),
        pytest.param(published(b"", b"\x26\0\0\0\0"), id="properties without an alias"),
        pytest.param(
            b"".join(published(bytes([n]) * 60_000, b"\x23\0" + bytes([n % 10 + 1])) for n in range(65, 85)),
            id="a megabyte of topics",
        ),
    ],
)
async def test_aliases_that_break_the_rules_end_the_connection(packet: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aliases_module, "MOST_BYTES", 500_000)
    async with Server() as server, linked(server, aliases=10) as (_, heard):
        server.sessions[0].send(packet + LAST)
        await eventually(lambda: heard.connections == 2, "connected again")
        assert Inbound("t", b"last") not in heard.messages


async def test_a_topic_that_is_none_is_counted_and_acknowledged_and_the_next_one_heard() -> None:
    async with Server() as server, linked(server, manual_ack=True, session_expiry_s=60) as (_, heard):
        server.sessions[0].send(published(b"\xff\xfe", b"", qos=1) + LAST)
        await eventually(lambda: heard.messages == [Inbound("t", b"last")], "the next one")
        await eventually(lambda: len(server.sessions[0].of(PUBACK)) == 1, "its acknowledgement")
        assert (heard.counted, heard.losses) == (["topic"], 0)


@pytest.mark.parametrize(
    "packet",
    [publish("t", b"x", qos=1, mid=3), b"\xc0\x00", b"\x62\x02\0\x03", b"\x40\x02\x80\0"],
    ids=["QoS 1", "PINGREQ", "PUBREL", "PUBACK"],
)
async def test_a_broker_that_does_not_read_the_answers_that_it_asks_for_is_given_up(
    packet: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would fill the memory, and so would the messages that its acknowledgements make room for."""
    monkeypatch.setattr(outgoing, "MOST_HELD", 10)
    for module in (client_module, connection_module):  # no missing answer to a ping ends it
        monkeypatch.setattr(module, "KEEPALIVE_S", 600)
    async with Server() as server, linked(server) as (link, heard):
        (session,) = server.sessions
        session.reads.clear()
        async with asyncio.timeout(20):
            while "held_up" not in heard.counted:
                link.publish(state("location", bytes(15_000)))
                await asyncio.sleep(0)
        session.send(packet * 4000)
        await eventually(lambda: heard.connections == 2, "connected again")
        assert len(heard.messages) < 4000


@pytest.mark.long
@pytest.mark.parametrize("says", first_quick([b"\x13\0\0", b"\x13\xff\xff"]), ids=["never", "18 hours"])
async def test_no_broker_says_how_long_its_silence_may_be(says: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_module, "KEEPALIVE_S", 2, raising=False)
    async with Server(says) as server, linked(server) as (_, heard):
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PING)) == 1, "a question")
        session.send(b"\xd0\0")
        await eventually(lambda: len(session.of(PING)) == 2, "the next")
        await eventually(lambda: heard.connections == 2, "connected again")


async def test_a_packet_of_the_largest_length_passes_in_whatever_pieces() -> None:
    packet = publish("t", bytes(LARGEST_PACKET - 8))
    async with Server() as server, linked(server) as (_, heard):
        server.sessions[0].send(packet + packet[:5])
        await eventually(lambda: len(heard.messages) == 1, "the first")
        server.sessions[0].send(packet[5:])
        await eventually(lambda: len(heard.messages) == 2, "the second")
        assert heard.losses == 0


class Dribbling(ssl.SSLSocket):
    """A TLS connection whose other side makes a record of each byte."""

    records = 0

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        self.records += 1
        return b"x"


def test_records_of_a_byte_do_not_hold_up_the_event_loop() -> None:
    sock = Dribbling.__new__(Dribbling)
    buffered = Buffered(sock)
    assert buffered.fetch() == sock.records == 64
    assert buffered.fetch() == 64
    assert buffered.came == b"x" * 128
