"""The MQTT connection against a broker's side on loopback: what it sends, in which segments, and what ends it."""

from __future__ import annotations

import asyncio
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from ssl import PROTOCOL_TLS_SERVER, SSLContext, create_default_context
from types import SimpleNamespace
from typing import Any

import pytest

from mqttxt import GroundStation
from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Inbound, Subscribe
from mqttxt.core.mqtt import client as client_module
from mqttxt.core.mqtt import connection as connection_module
from mqttxt.core.mqtt import link as mqtt_module
from mqttxt.core.mqtt import outgoing
from mqttxt.core.mqtt.client import KEEPALIVE_S
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.errors import BrokerRefused, ConfigurationError, FogUnreachable
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from tests.rigs.linked import RECEIVE_MAXIMUM_2, WITH_WILL, Heard, linked, state
from tests.rigs.mqtt_server import (
    CONNECT,
    DISCONNECT,
    PUBACK,
    PUBLISH,
    SILENCE,
    SUBSCRIBE,
    Server,
    Session,
    numbers,
    publish,
)
from tests.rigs.processes import eventually

ALIASES_10 = b"\x22\x00\x0a"
PACKETS_OF_200 = b"\x27\x00\x00\x00\xc8"
STATES = ("battery", "location", "heading", "groundspeed", "flight_mode")


async def test_what_is_published_in_one_turn_of_the_event_loop_leaves_in_one_segment() -> None:
    async with Server(ALIASES_10) as server, linked(server) as (link, _):
        (session,) = server.sessions
        for turn in range(1, 4):
            before = session.segments()
            for name in STATES:
                link.publish(state(name))
            link.publish(state("armed", qos=1))
            await eventually(lambda turn=turn: len(session.of(PUBLISH)) == 6 * turn, "six messages")  # type: ignore[misc]
            assert session.segments() == before + 1


async def test_turns_of_the_event_loop_do_not_wait_for_each_other() -> None:
    async with Server() as server, linked(server) as (link, _):
        (session,) = server.sessions
        before = session.segments()
        for count, name in enumerate(STATES, 1):
            link.publish(state(name))
            await eventually(lambda count=count: len(session.of(PUBLISH)) == count, "its message")  # type: ignore[misc]
        assert session.segments() == before + len(STATES)


async def test_aliases_replace_the_topics_of_qos_0_from_the_second_time_on() -> None:
    async with Server(ALIASES_10) as server, linked(server) as (link, _):
        for _ in range(2):
            link.publish(state("battery"))
            link.publish(state("heading"))
            link.publish(state("battery", qos=1))
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PUBLISH)) == 6, "six messages")
        sent = [packet.publish()[:2] for packet in session.of(PUBLISH)]
        battery, heading = "drone1/state/battery", "drone1/state/heading"
        first = [(battery, {0x23: 1}), (heading, {0x23: 2}), (battery, {})]
        assert sent == [*first, ("", {0x23: 1}), ("", {0x23: 2}), (battery, {})]


async def test_aliases_begin_anew_with_each_connection() -> None:
    async with Server(ALIASES_10) as server, linked(server) as (link, heard):
        link.publish(state("battery"))
        await eventually(lambda: len(server.sessions[0].of(PUBLISH)) == 1, "the message")
        server.sessions[0].end()
        await eventually(lambda: heard.connections == 2, "connected again")
        link.publish(state("heading"))
        await eventually(lambda: len(server.sessions[1].of(PUBLISH)) == 1, "the message")
        assert server.sessions[1].of(PUBLISH)[0].publish()[:2] == ("drone1/state/heading", {0x23: 1})
        assert heard.losses == 1


async def test_a_broker_without_aliases_gets_none() -> None:
    async with Server() as server, linked(server) as (link, _):
        for _ in range(2):
            link.publish(state("battery"))
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PUBLISH)) == 2, "two messages")
        assert [packet.publish()[:2] for packet in session.of(PUBLISH)] == [("drone1/state/battery", {})] * 2


async def test_a_brokers_aliases_stand_for_its_topics_on_a_link_that_allows_them() -> None:
    expires, subscription, user = b"\x02\0\0\0\x05", b"\x0b\x81\x01", b"\x26\0\x01a\0\x02bc"
    said = [
        ("fog1/drone1/state/battery", b"\x23\0\x01"),
        ("fog1/drone2/state/battery", user + expires + b"\x23\0\x02"),
        ("", b"\x23\0\x01" + expires),
        ("", subscription + b"\x23\0\x02"),
        ("fog1/drone3/state/battery", b"\x23\0\x01"),
        ("fog1/drone4/state/battery", b""),
        ("", b"\x23\0\x01"),
    ]
    async with Server() as server, linked(server, aliases=10) as (_, heard):
        (session,) = server.sessions
        (connect,) = session.of(CONNECT)
        assert numbers(connect.body[11 : 11 + connect.body[10]])[0x22] == 10
        session.send(
            b"".join(publish(topic, b"x", properties=more, qos=n % 2, mid=n) for n, (topic, more) in enumerate(said, 1))
        )
        await eventually(lambda: len(heard.messages) == len(said), "all")
        drones = [int(message.topic.split("/")[1].removeprefix("drone")) for message in heard.messages]
        assert drones == [1, 2, 1, 2, 3, 4, 3]


async def test_connect_asks_for_a_clean_start_and_small_packets() -> None:
    async with Server() as server, linked(server):
        (connect,) = server.sessions[0].of(CONNECT)
        assert connect.body[:7] == b"\0\4MQTT\5"
        assert connect.body[7] & 2  # clean start
        assert int.from_bytes(connect.body[8:10], "big") == KEEPALIVE_S
        properties = numbers(connect.body[11 : 11 + connect.body[10]])
        assert properties == {0x11: 0, 0x27: 65_536, 0x21: 1000}


async def test_no_more_is_in_flight_than_the_broker_takes_whatever_else_it_acknowledges() -> None:
    async with Server(RECEIVE_MAXIMUM_2, acknowledges=False) as server, linked(server) as (link, heard):
        for number in range(5):
            link.publish(state("armed", bytes([number]), qos=1, ref=number))
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PUBLISH)) == 2, "as many as the broker takes")
        for mid in range(1, 20):
            session.acknowledge(mid)
        for number in range(5):
            await eventually(lambda n=number: len(session.of(PUBLISH)) == min(n + 2, 5), "two more")  # type: ignore[misc]
            session.acknowledge(session.of(PUBLISH)[number].publish()[3], code=0x10)
        await eventually(lambda: len(heard.acknowledged) == 5, "all acknowledged")
        assert heard.acknowledged == [(number, 0x10) for number in range(5)]
        assert [packet.publish()[2] for packet in session.of(PUBLISH)] == [bytes([n]) for n in range(5)]


async def test_a_packet_id_is_not_used_again_before_its_acknowledgement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outgoing, "_OWN_MIDS", range(40_000, 40_003))
    async with Server(acknowledges=False) as server, linked(server) as (link, heard):
        (session,) = server.sessions
        link.publish(state("armed", b"first", qos=1, ref="first"))
        for number in range(4):
            link.publish(state("armed", qos=1, ref=number))
            await eventually(lambda n=number: len(session.of(PUBLISH)) == n + 2, "sent")  # type: ignore[misc]
            session.acknowledge(session.of(PUBLISH)[-1].publish()[3])
            await eventually(lambda n=number: heard.acknowledged[-1:] == [(n, 0)], "acknowledged")  # type: ignore[misc]
        assert [packet.publish()[3] for packet in session.of(PUBLISH)] == [40_000, 40_001, 40_002, 40_001, 40_002]


async def test_a_broker_that_acknowledges_nothing_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outgoing, "MOST_HELD", 10)
    async with Server(RECEIVE_MAXIMUM_2, acknowledges=False) as server, linked(server) as (link, heard):
        for number in range(15):
            link.publish(state("armed", bytes([number]), qos=1, ref=number))
        assert heard.counted == ["held_up"] * 3
        (session,) = server.sessions
        for number in range(12):
            await eventually(lambda n=number: len(session.of(PUBLISH)) > n, "the next one")  # type: ignore[misc]
            session.acknowledge(session.of(PUBLISH)[number].publish()[3])
        await eventually(lambda: heard.acknowledged == [(number, 0) for number in range(12)], "all that waited")


async def test_what_the_broker_would_refuse_for_its_length_is_not_sent() -> None:
    async with Server(PACKETS_OF_200) as server, linked(server) as (link, heard):
        link.publish(state("battery", bytes(300)))
        link.publish(state("heading"))
        (session,) = server.sessions
        await eventually(lambda: len(session.of(PUBLISH)) == 1, "the shorter one")
        assert heard.counted == ["too_long_for_broker"]


async def test_messages_acknowledged_by_hand_stay_unacknowledged_until_then() -> None:
    async with Server() as server, linked(server, manual_ack=True, session_expiry_s=60) as (link, heard):
        (session,) = server.sessions
        assert not session.of(CONNECT)[0].body[7] & 2  # the broker keeps the session
        for mid in (7, 8):
            session.send(publish("sensor/1", b"x", qos=1, mid=mid))
        await eventually(lambda: len(heard.messages) == 2, "both messages")
        link.publish(state("battery"))
        await eventually(lambda: len(session.of(PUBLISH)) == 1, "something behind them")
        assert session.of(PUBACK) == []
        first = heard.messages[0].receipt
        assert first is not None
        link.acknowledge(first)
        await eventually(lambda: [p.body[:2] for p in session.of(PUBACK)] == [b"\0\7"], "its PUBACK")
        session.end()
        await eventually(lambda: heard.connections == 2, "connected again")
        second = heard.messages[1].receipt
        assert second is not None
        link.acknowledge(second)
        link.publish(state("battery"))
        await eventually(lambda: len(server.sessions[1].of(PUBLISH)) == 1, "something behind it")
        assert server.sessions[1].of(PUBACK) == []


async def test_what_a_role_does_by_a_message_comes_before_the_puback_that_its_link_sends_by_itself() -> None:
    async with Server() as server, linked(server) as (link, heard):
        heard.on_received = lambda message: link.publish(state("armed", qos=1))
        server.sessions[0].send(publish("drone1/commands", b"x", qos=1, mid=7))
        await eventually(lambda: len(server.sessions[0].of(PUBACK)) == 1, "PUBACK")
        kinds = [packet.kind for packet in server.sessions[0].packets if packet.kind in (PUBLISH, PUBACK)]
        assert kinds == [PUBLISH, PUBACK]
        assert heard.messages == [Inbound("drone1/commands", b"x", 1)]


async def test_a_role_that_fails_on_a_message_hears_the_next_ones() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))
    async with Server() as server, linked(server) as (_, heard):
        heard.fails_at = b"2"
        server.sessions[0].send(b"".join(publish("drone1/commands", payload) for payload in (b"1", b"2", b"3")))
        await eventually(lambda: len(heard.messages) == 2, "the others")
        assert [message.payload for message in heard.messages] == [b"1", b"3"]
        assert (heard.losses, len(reported)) == (0, 1)


@pytest.mark.parametrize(
    "garbage",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(84),
        b"\0\0\0\0",
        b"\x30\x01\x00",
        b"\x30\x05\x00\x01t\x7f\x00",
        b"\x30\xff\xff\xff\xff\x7f",
        b"\x40\x03\x00\x01\xee",
        b"\x31\x02\xff\xff",
        b"\xe0\x01\xee",
    ],
)
async def test_bytes_that_are_not_mqtt_end_the_connection_and_nothing_else(
    garbage: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (client_module, connection_module):  # nor does a broker that answers no ping
        monkeypatch.setattr(module, "KEEPALIVE_S", 600)
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))
    async with Server() as server, linked(server) as (_, heard):
        server.sessions[0].send(garbage)
        await eventually(lambda: heard.connections == 2, "connected again")
        assert (heard.losses, heard.messages, reported) == (1, [], [])


@pytest.mark.long
async def test_a_broker_that_never_answers_does_not_hold_up_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_module, "CONNECT_TIMEOUT_S", 60)
    silent = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    port = silent.sockets[0].getsockname()[1]
    heard = Heard()
    link = MqttLink("cloud", BrokerAddress("127.0.0.1", port), "client-1", None, heard)
    running = asyncio.create_task(link.run())
    turns = 0
    async with asyncio.timeout(30):  # half of what a call that blocks would take
        while turns < 50:
            turns += 1
            await asyncio.sleep(0.01)
    assert not running.done()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    silent.close()


async def test_where_messages_are_signed_a_broker_that_says_so_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server(granted=[0x87]) as server, linked(server, may_be_ended=False) as (link, heard):
        server.sessions[0].send(b"\xe0\x02\x8e\x00")
        await eventually(lambda: heard.connections == 2, "connected again")
        link.subscribe(Subscribe("fog", ("drone1/commands",)))
        await eventually(lambda: heard.connections == 3, "connected again")
    async with Server(code=0x87) as server:
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, Heard(), may_be_ended=False)
        running = asyncio.create_task(link.run())
        await eventually(lambda: len(server.sessions) == 2, "asked again")
        assert link.failure == "refused with reason code 0x87"
        await link.close()
        await running


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses of links, which take no time."""
    found: list[float] = []

    async def pause(seconds: float) -> None:
        found.append(seconds)
        await asyncio.sleep(0)

    monkeypatch.setattr(mqtt_module, "asyncio", SimpleNamespace(sleep=pause, get_running_loop=asyncio.get_running_loop))
    monkeypatch.setattr(mqtt_module, "random", SimpleNamespace(uniform=lambda least, most: most))
    return found


async def end_each(server: Server, count: int, serves: Callable[[Session], object] = lambda session: None) -> None:
    """End the next connections, each behind its CONNACK, or behind what it is served with."""
    for number in range(len(server.sessions), len(server.sessions) + count):
        await eventually(lambda number=number: len(server.sessions) > number, "connected again")  # type: ignore[misc]
        serves(server.sessions[number])
        server.sessions[number].end()


async def test_a_broker_that_accepts_and_ends_connections_is_tried_at_growing_pauses(pauses: list[float]) -> None:
    async with Server() as server, linked(server) as (link, _):
        server.sessions[0].end()
        await end_each(server, 6)
        await eventually(lambda: len(pauses) == 7, "the seventh pause")
        assert pauses == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
        assert link.failure == "accepted, and ended before any message"


@pytest.mark.parametrize("served", [publish("drone1/commands", b"x"), b"\xd0\x00"], ids=["a message", "PINGRESP"])
async def test_a_link_that_worked_is_tried_again_at_once(served: bytes, pauses: list[float]) -> None:
    async with Server() as server, linked(server):
        server.sessions[0].end()
        await end_each(server, 3)
        await end_each(server, 3, lambda session: session.send(served))
        await eventually(lambda: len(pauses) == 7, "the seventh pause")
        assert pauses == [0.2, 0.4, 0.8, 1.6, 0.2, 0.2, 0.2]


async def test_an_acknowledged_message_is_enough(pauses: list[float]) -> None:
    async with Server() as server, linked(server) as (link, heard):
        server.sessions[0].end()
        await end_each(server, 1)
        await eventually(lambda: heard.connections == 3, "connected again")
        link.publish(state("armed", qos=1, ref=1))
        await eventually(lambda: heard.acknowledged == [(1, 0)], "acknowledged")
        server.sessions[2].end()
        await eventually(lambda: len(pauses) == 3, "the third pause")
        assert pauses == [0.2, 0.4, 0.2]


def test_a_client_id_is_a_secret_where_nodes_have_identities(tmp_path: Path) -> None:
    """Another member of the fleet cannot take it over; only a session that outlives its client keeps its id."""
    identity = Identity.load(Authority.create(tmp_path / "acme", "acme").issue("drone1"))
    broker = BrokerAddress("localhost", 1, tls=True)
    ids = [MqttLink("fog", broker, "drone1", None, Heard(), identity=identity)._client_id for _ in range(2)]
    assert all(re.fullmatch("drone1-[0-9a-f]{16}", each) for each in ids)
    assert len(set(ids)) == 2
    kept = MqttLink("sensors", broker, "drone1", None, Heard(), identity=identity, session_expiry_s=3600)
    plain = MqttLink("fog", BrokerAddress("localhost", 1), "drone1", None, Heard())
    assert kept._client_id == plain._client_id == "drone1"


def served_with(chain: Path, key: Path) -> SSLContext:
    context = SSLContext(PROTOCOL_TLS_SERVER)
    context.load_cert_chain(chain, key)
    return context


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """The file that vouches for a server."""
    return tmp_path / "chain.pem"


@pytest.fixture
def tls(tmp_path: Path, chain: Path) -> SSLContext:
    """A server's TLS context for localhost."""
    key = tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "2"]
    subprocess.run([*command, *names, "-keyout", key, "-out", chain], check=True, capture_output=True)
    return served_with(chain, key)


@pytest.fixture
def trusted(tls: SSLContext, chain: Path, monkeypatch: pytest.MonkeyPatch) -> SSLContext:
    """The same, which this process trusts."""
    monkeypatch.setenv("SSL_CERT_FILE", str(chain))
    return tls


async def test_tls_carries_bursts_in_both_directions(trusted: SSLContext) -> None:
    async with Server(tls=trusted) as server, linked(server, "mqtts") as (link, heard):
        (session,) = server.sessions
        session.send(b"".join(publish("drone1/commands", bytes([n])) for n in range(250)))
        await eventually(lambda: len(heard.messages) == 250, "all of one record")
        for name in STATES:
            link.publish(state(name))
        await eventually(lambda: len(session.of(PUBLISH)) == len(STATES), "all states")


async def test_what_comes_in_tls_records_of_a_byte_is_heard_to_the_end(trusted: SSLContext) -> None:
    async with Server(tls=trusted) as server, linked(server, "mqtts") as (_, heard):
        (session,) = server.sessions
        for byte in publish("drone1/commands", bytes(500)) + publish("drone1/commands", b"last"):
            session.send(bytes([byte]))
        session.end()
        await eventually(lambda: heard.losses == 1, "ended")
        assert [message.payload for message in heard.messages] == [bytes(500), b"last"]


async def test_what_came_before_the_end_is_taken_where_both_are_read_at_once(trusted: SSLContext) -> None:
    """By TLS the end comes with what was said before: acknowledgements, a message, why the connection ends."""
    taken_over = b"\xe0\x01\x8e"
    async with Server(acknowledges=False, tls=trusted) as server, linked(server, "mqtts") as (link, heard):
        (session,) = server.sessions
        for number in range(3):
            link.publish(state("armed", qos=1, ref=number))
        await eventually(lambda: len(session.of(PUBLISH)) == 3, "three in flight")
        mids = [packet.publish()[3] for packet in session.of(PUBLISH)]
        acknowledged = b"".join(b"\x40\x02" + mid.to_bytes(2, "big") for mid in mids)
        session.send(acknowledged + publish("drone1/commands", b"last", qos=1, mid=1) + taken_over)
        session.end()
        await eventually(lambda: heard.losses == 1, "ended")
        assert heard.acknowledged == [(0, 0), (1, 0), (2, 0)]
        assert [message.payload for message in heard.messages] == [b"last"]


async def test_a_station_trusts_whom_its_own_context_trusts(tls: SSLContext, chain: Path) -> None:
    own = create_default_context(cafile=str(chain))
    async with Server(tls=tls) as server, GroundStation(f"mqtts://localhost:{server.port}", ssl_context=own):
        await eventually(lambda: len(server.sessions) == 1, "connected")


def test_a_context_without_tls_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"ssl_context for mqtt://localhost:1883: expected .* mqtts://"):
        GroundStation("mqtt://localhost", ssl_context=create_default_context())


async def test_a_certificate_that_nobody_vouches_for_is_not_talked_to(
    tls: SSLContext, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "mqttxt.mqtt")
    async with Server(tls=tls) as server:
        heard = Heard()
        link = MqttLink("fog", BrokerAddress("localhost", server.port, tls=True), "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: "certificate" in caplog.text, "a reason in the log")
        assert (heard.connections, server.sessions, running.done()) == (0, [], False)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_a_connection_to_a_broker_that_is_revoked_by_now_is_given_up(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    broker, identity = acme.issue("broker-cloud"), Identity.load(acme.issue("drone1"))
    context = served_with(broker / "certificate.pem", broker / "identity.pem")
    async with Server(tls=context) as server, linked(server, "mqtts", identity=identity) as (link, heard):
        link.check_broker()
        assert heard.losses == 0
        acme.revoke("broker-cloud")
        assert identity.fleet.take(acme.fleet.revoked)
        link.check_broker()
        await eventually(lambda: heard.losses == 1, "given up")
        await eventually(lambda: link.failure == "its certificate (broker-cloud) is revoked", "and not connected again")
        assert heard.connections == 1


@pytest.mark.long
async def test_a_broker_that_does_not_show_the_list_is_named(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    broker, own = acme.issue("broker-cloud"), acme.issue("gs-ops", Rights(observe=True))
    context = served_with(broker / "certificate.pem", broker / "identity.pem")
    async with Server(tls=context) as server:
        async with GroundStation(f"mqtts://localhost:{server.port}", identity=own) as station:
            with pytest.raises(FogUnreachable, match=r"does not show the revocation list.*`mqttxt broker`.*waited 2 s"):
                await station.share_list(2)
        topics = [session.of(PUBLISH) for session in server.sessions]
        assert any(b"fleet/revoked" in packet.body for packet in topics[0])
    async with GroundStation("mqtts://localhost:1", identity=own) as station:
        with pytest.raises(FogUnreachable, match="no connection"):
            await station.share_list(0.1)
    async with GroundStation("mqtt://localhost:1") as plain:
        with pytest.raises(ConfigurationError, match="share_list: expected a station with an identity"):
            await plain.share_list()


@pytest.mark.parametrize("code", [0x80, 0x83, 0x91, 0x97])
async def test_a_subscription_that_is_refused_this_time_is_asked_for_on_a_new_connection(
    code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server(granted=[code]) as server, linked(server) as (link, heard):
        link.subscribe(Subscribe("fog", ("drone1/commands",)))
        await eventually(lambda: heard.connections == 2, "connected again")
        link.subscribe(Subscribe("fog", ("drone1/commands",)))
        await eventually(lambda: len(heard.subscribes) == 1, "subscribed")
        (left,) = server.sessions[0].of(DISCONNECT)
        assert left.body[:1] == WITH_WILL


async def test_a_connection_that_is_given_up_ends_with_its_will_and_another_one_begins(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server() as server, linked(server) as (link, heard):
        link.give_up("it delivers nothing")
        await eventually(lambda: heard.connections == 2, "connected again")
        assert heard.losses == 1
        (left,) = server.sessions[0].of(DISCONNECT)
        assert left.body[:1] == WITH_WILL
        assert [
            record.getMessage().split(": ")[-1] for record in caplog.records if "nothing" in record.getMessage()
        ] == ["it delivers nothing; trying again"]


async def test_a_broker_that_goes_on_refusing_is_asked_at_growing_pauses(pauses: list[float]) -> None:
    async with Server(granted=[0x91] * 100) as server, linked(server) as (link, heard):
        for count in range(1, 5):
            await eventually(lambda count=count: heard.connections >= count, "connected")  # type: ignore[misc]
            link.subscribe(Subscribe("fog", ("drone1/commands",)))
            await eventually(lambda count=count: len(pauses) >= count, "a pause")  # type: ignore[misc]
    assert pauses[:4] == [0.2, 0.4, 0.8, 1.6]


async def test_a_connection_that_delivered_before_it_was_given_up_is_begun_anew_at_once(pauses: list[float]) -> None:
    async with Server() as server, linked(server) as (link, heard):
        for count in range(1, 5):
            await eventually(lambda count=count: heard.connections == count, "connected")  # type: ignore[misc]
            server.sessions[-1].send(publish("drone1/commands", b"x"))
            await eventually(lambda count=count: len(heard.messages) == count, "it delivers")  # type: ignore[misc]
            link.give_up("it delivers nothing any more")
        await eventually(lambda: heard.connections == 5, "connected")
    assert pauses[:4] == [0.2] * 4


async def test_an_identity_that_cannot_be_read_behind_that_is_tried_at_growing_pauses(
    pauses: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with Server() as server, linked(server) as (link, heard):
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[-1].send(publish("drone1/commands", b"x"))
        await eventually(lambda: len(heard.messages) == 1, "it delivers")

        async def unreadable() -> str:
            return "the identity cannot be used"

        monkeypatch.setattr(link, "_one_connection_without_identity", unreadable)
        link.give_up("it delivers nothing any more")
        await eventually(lambda: len(pauses) >= 4, "pauses")
    assert pauses[:4] == [0.2, 0.4, 0.8, 1.6]


@pytest.mark.parametrize("code", [0x87, 0x8F, 0x9E, 0xA1, 0xA2])
async def test_a_subscription_that_is_never_granted_ends_the_role(code: int) -> None:
    async with Server(granted=[code]) as server:
        address = BrokerAddress.parse(f"mqtt://localhost:{server.port}")
        heard = Heard()
        link = MqttLink("fog", address, "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: heard.connections == 1, "connected")
        link.subscribe(Subscribe("fog", ("drone1/commands",)))
        with pytest.raises(BrokerRefused, match="refused the subscription to drone1/commands"):
            await running


async def test_one_subscribe_is_under_way_at_a_time() -> None:
    async with Server(granted=[SILENCE]) as server, linked(server) as (link, heard):
        (session,) = server.sessions
        for topic in ("a", "b", "c"):
            link.subscribe(Subscribe("fog", (topic,)))
        await eventually(lambda: len(session.of(SUBSCRIBE)) == 1, "the first")
        link.publish(state("battery", qos=1, ref=1))
        await eventually(lambda: heard.acknowledged == [(1, 0)], "what came behind it")
        assert len(session.of(SUBSCRIBE)) == 1
        session.send(b"\x90\x04" + session.of(SUBSCRIBE)[0].body[:2] + b"\0\x01")
        await eventually(lambda: [one.filters for one in heard.subscribes] == [("a",), ("b",), ("c",)], "all in order")
