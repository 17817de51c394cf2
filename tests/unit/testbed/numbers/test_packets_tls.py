"""MQTT in TLS 1.3: read out of the records of a real session with the keys that its client wrote down."""

from __future__ import annotations

import contextlib
import ssl
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core.mqtt.tls import client_context
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from testbed.numbers.packets.mqtt import Direction, randoms_of, read_tls_direction
from testbed.numbers.packets.streams import Segment
from testbed.numbers.packets.tls import Secrets, read_key_log
from tests.handmade.attempts import publish
from tests.handmade.packets_tables import stream

FIRST, SECOND = publish("a/b", b"12345", qos=1), publish("c", b"6")
RECORD = 22
"""Bytes of TLS around what a record carries: header, inner type, tag."""


@dataclass(frozen=True)
class Session:
    """What a client and its broker sent: the handshake of each, and then each write as one record."""

    secrets: Secrets
    client: list[bytes]
    broker: list[bytes]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session between a drone and its fog's broker; SSLKEYLOGFILE has its keys."""
    folder = tmp_path_factory.mktemp("session")
    authority = Authority.create(folder / "acme", "acme")
    drone, broker = authority.issue("drone1"), authority.issue("broker-fog1")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("SSLKEYLOGFILE", str(folder / "keys.log"))
        context = client_context(Identity.load(drone))
    context.sslsocket_class = ssl.SSLSocket
    serving = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    serving.load_cert_chain(broker / "certificate.pem", broker / "identity.pem")
    wires = [ssl.MemoryBIO() for _ in range(2)]
    said: tuple[list[bytes], list[bytes]] = ([], [])
    copies = [ssl.MemoryBIO() for _ in range(2)]
    client = context.wrap_bio(copies[1], wires[0], server_hostname="localhost")
    server = serving.wrap_bio(copies[0], wires[1], server_side=True)

    def carry() -> None:
        for number in range(2):
            data = wires[number].read()
            copies[number].write(data)
            said[number].extend([data] if data else [])

    for _ in range(4):
        for end in (client, server):
            with contextlib.suppress(ssl.SSLWantReadError):
                end.do_handshake()
            carry()
    for data in (FIRST, SECOND):
        client.write(data)
        carry()
        server.write(data)
        carry()
    (secrets,) = read_key_log(folder / "keys.log").values()
    return Session(secrets, *said)


def said(found: Direction) -> list[tuple[str | None, bytes | None]]:
    return [(packet.topic, packet.payload) for packet in found.packets]


BOTH = [("a/b", b"12345"), ("c", b"6")]


def test_both_directions_are_read_with_the_keys_of_the_client(session: Session) -> None:
    for bodies in (session.client, session.broker):
        found = read_tls_direction(stream(*bodies), [session.secrets])
        assert (said(found), found.is_unread) == (BOTH, False)
    assert list(map(len, randoms_of(stream(*session.client)))) == [32]
    assert randoms_of(stream(*session.broker)) == []


def test_of_a_frame_mqtt_tls_and_payload_are_counted_apart(session: Session) -> None:
    found = read_tls_direction(stream(*session.client), [session.secrets])
    first, second = len(session.client) - 2, len(session.client) - 1
    assert [found.packets[0].row, found.packets[1].row] == [first, second]
    assert (found.packets[0].size, found.packets[1].size) == (len(FIRST), len(SECOND))
    assert (found.tls_bytes[first], found.tls_bytes[second]) == (RECORD, RECORD)
    assert (found.payload_bytes[first], found.payload_bytes[second]) == (5, 1)
    assert all(found.tls_bytes[row] == len(body) for row, body in enumerate(session.client[:first]))
    assert set(found.carried) == {first, second}


def test_a_message_has_left_with_the_last_byte_of_its_record(session: Session) -> None:
    *handshake, first, second = session.client
    cut = len(first) - 3  # within the tag: all of the message is there, and cannot be read
    bodies = [*handshake, first[:3], first[3:cut], first[cut:] + second[:7], second[7:]]
    found = read_tls_direction(stream(*bodies), [session.secrets])
    header, body, tag, rest = range(len(handshake), len(handshake) + 4)
    assert said(found) == BOTH
    assert [(p.row, p.left_ns) for p in found.packets] == [(body, tag), (tag, rest)]
    assert {row: packet.topic for row, packet in found.carried.items()} == {
        **{header: "a/b", body: "a/b", tag: "a/b", rest: "c"}
    }
    lost = [
        segment if segment.row != tag else Segment(tag, None, segment.sequence, False, segment.body)
        for segment in stream(*bodies)
    ]
    assert [p.left_ns for p in read_tls_direction(lost, [session.secrets]).packets] == [None, None]


def test_what_no_key_opens_is_unread_and_never_nothing(session: Session) -> None:
    for wrong in ([], [{}], [{label: bytes(48) for label in session.secrets}]):
        found = read_tls_direction(stream(*session.client), wrong)
        assert (found.packets, found.is_unread) == ([], True)
    early = {label: secret for label, secret in session.secrets.items() if "HANDSHAKE" in label}
    assert read_tls_direction(stream(*session.client), [early]).is_unread


def test_behind_a_gap_nothing_is_read_and_that_is_said(session: Session) -> None:
    segments = stream(*session.client)
    found = read_tls_direction([*segments[:-2], segments[-1]], [session.secrets])
    assert (found.packets, found.is_unread) == ([], True)
    assert read_tls_direction(segments[-1:], [session.secrets]).is_unread


def test_a_connection_that_ends_within_a_record_is_read_up_to_it(session: Session) -> None:
    bodies = [*session.client[:-1], session.client[-1][:-1]]
    found = read_tls_direction(stream(*bodies), [session.secrets])
    assert (said(found), found.is_unread) == (BOTH[:1], False)


def test_lines_of_a_key_log_that_are_none_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "keys.log"
    assert read_key_log(path) == {}
    path.write_bytes(b"# comment\nCLIENT_TRAFFIC_SECRET_0 0a 0b\nCLIENT_RANDOM zz 00\n\xff\nSERVER_TRAFFIC_SECRET_0 0a")
    assert read_key_log(path) == {b"\n": {"CLIENT_TRAFFIC_SECRET_0": b"\x0b"}}


@given(st.data())
def test_no_bytes_in_no_order_raise(session: Session, data: st.DataObject) -> None:
    bodies = data.draw(st.lists(st.sampled_from(session.client + session.broker) | st.binary(max_size=40), max_size=6))
    starts = data.draw(st.lists(st.integers(0, 3000), min_size=len(bodies), max_size=len(bodies)))
    segments = [
        Segment(row, row, at, row % 5 == 0, body) for row, (at, body) in enumerate(zip(starts, bodies, strict=True))
    ]
    found = read_tls_direction(segments, [session.secrets])
    assert all(count >= 0 for count in (*found.tls_bytes.values(), *found.payload_bytes.values()))
