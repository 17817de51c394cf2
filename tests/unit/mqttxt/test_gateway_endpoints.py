"""The sockets that MAVLink clients are behind (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.errors import ConfigurationError
from mqttxt.gateway import endpoints
from mqttxt.gateway.endpoints import MOST_CONNECTIONS, ClientAddress, Endpoints, Peer
from mqttxt.gateway.texts import send_text
from mqttxt.protocol.states import Severity
from tests.rigs.loopback import eventually, free_port

HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 255, 190))


class Heard:
    def __init__(self) -> None:
        self.messages: list[tuple[str, Any]] = []
        self.gone: list[str] = []
        self.endpoints = Endpoints(
            lambda peer, message: self.messages.append((peer.name, message)), lambda peer: self.gone.append(peer.name)
        )


@pytest.fixture
async def heard() -> AsyncIterator[Heard]:
    made = Heard()
    yield made
    await made.endpoints.close()


@pytest.fixture
async def port(heard: Heard) -> int:
    """A TCP port that clients connect to."""
    made = free_port()
    await heard.endpoints.open([], [ClientAddress("tcp", "127.0.0.1", made)])
    return made


@pytest.mark.parametrize(
    "text",
    [
        "", "udp:", "udp:127.0.0.1", "udp:127.0.0.1:0", "udp:127.0.0.1:65536", "tcp:127.0.0.1:5760", "udp::14550",
        "udp:::1:14550",
    ],
)  # fmt: skip
def test_what_is_no_address_is_one_line(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"^--to '.*': expected udp:HOST:PORT$"):
        ClientAddress.parse(text, "udp", "--to", insecure=True)


def test_another_machine_has_to_be_allowed() -> None:
    with pytest.raises(ConfigurationError, match="--insecure-mavlink"):
        ClientAddress.parse("tcp:0.0.0.0:5760", "tcp", "--listen", insecure=False)
    assert str(ClientAddress.parse("tcp:0.0.0.0:5760", "tcp", "--listen", insecure=True)) == "tcp:0.0.0.0:5760"
    for own in ("udp:localhost:14550", "udp:127.0.0.1:14550", "udp:[::1]:14550"):
        assert str(ClientAddress.parse(own, "udp", "--to", insecure=False)) == own


async def test_a_udp_client_that_listens_is_shown_and_heard_and_nobody_else_is(heard: Heard) -> None:
    port = free_port(socket.SOCK_DGRAM)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        await heard.endpoints.open([ClientAddress("udp", "127.0.0.1", port)], [])
        (peer,) = heard.endpoints.peers
        send_text(peer, 1, Severity.INFO, "before anybody listens")
        client.bind(("127.0.0.1", port))
        client.setblocking(False)
        for _ in range(2):  # the refusal of the one before is the error of the next
            send_text(peer, 3, Severity.INFO, "hello")
        async with asyncio.timeout(10):
            packet, gateway = await asyncio.get_running_loop().sock_recvfrom(client, 2048)
        message = mavlink.MAVLink(None).decode(bytearray(packet))
        assert (message.get_srcSystem(), message.get_srcComponent(), message.text) == (3, 1, "hello")
        stranger.sendto(HEARTBEAT, gateway)
        client.sendto(b"noise" + HEARTBEAT, gateway)
        await eventually(lambda: heard.messages, "a message")
        assert [(name, message.get_type()) for name, message in heard.messages] == [(peer.name, "HEARTBEAT")]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
async def test_a_client_that_is_named_twice_is_one_line(heard: Heard, host: str) -> None:
    """It would be taken for two, and each of its commands be heard twice."""
    port = free_port(socket.SOCK_DGRAM)
    first = ClientAddress("udp", socket.gethostbyname("localhost"), port)
    with pytest.raises(ConfigurationError, match=f"^--to udp:{host}:{port}: expected once, got twice"):
        await heard.endpoints.open([first, ClientAddress("udp", host, port)], [])
    assert len(heard.endpoints.peers) == 1


async def test_tcp_clients_come_and_go(heard: Heard, port: int) -> None:
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(HEARTBEAT[:5])
    await writer.drain()
    writer.write(HEARTBEAT[5:] + b"noise" + HEARTBEAT)
    await eventually(lambda: heard.messages, "a message")
    (peer,) = heard.endpoints.peers
    writer.close()
    await eventually(lambda: heard.gone, "it is gone")
    assert heard.gone == [peer.name]
    assert heard.endpoints.peers == []


async def test_a_browser_that_a_page_sends_here_is_not_heard(heard: Heard, port: int) -> None:
    """A page of any site may make its browser post bytes to this machine, and nobody asks the gateway first."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 21\r\n\r\n" + HEARTBEAT)
    await eventually(lambda: heard.gone, "it is gone")
    assert (heard.messages, heard.endpoints.peers) == ([], [])
    with contextlib.suppress(ConnectionError):
        assert await reader.read(1) == b""
    writer.transport.abort()


@pytest.mark.long
async def test_a_client_that_does_not_read_is_left_and_the_others_go_on(heard: Heard, port: int) -> None:
    _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
    writer.transport.pause_reading()
    await eventually(lambda: heard.endpoints.peers, "connected")
    (peer,) = heard.endpoints.peers
    async with asyncio.timeout(30):
        while not heard.gone:
            for _ in range(1000):
                send_text(peer, 1, Severity.INFO, "x" * 50)
            await asyncio.sleep(0)
    writer.transport.abort()


async def test_a_client_that_floods_does_not_keep_the_others_waiting(heard: Heard, port: int) -> None:
    """Reading one connection for long would be a stall of the gateway, which executes no client's commands then."""
    (_, flooder), (_, other) = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
    await eventually(lambda: len(heard.endpoints.peers) == 2, "both connected")
    flooder.write(HEARTBEAT * 2500)
    other.write(HEARTBEAT)
    name = f"tcp:127.0.0.1:{other.get_extra_info('sockname')[1]}"
    await eventually(lambda: name in [peer for peer, _ in heard.messages], "the other one")
    assert [peer for peer, _ in heard.messages].index(name) < 500
    for writer in (flooder, other):
        writer.transport.abort()


async def test_too_many_connections_are_refused(heard: Heard, port: int) -> None:
    opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(MOST_CONNECTIONS)]
    await eventually(lambda: len(heard.endpoints.peers) == MOST_CONNECTIONS, "all connected")
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    with contextlib.suppress(ConnectionError):
        assert await reader.read(1) == b""
    assert len(heard.endpoints.peers) == MOST_CONNECTIONS
    for _, one in (*opened, (reader, writer)):
        one.transport.abort()
    await eventually(lambda: not heard.endpoints.peers, "all gone")


@pytest.mark.parametrize("speaks", [False, True])
async def test_who_says_nothing_makes_room_for_who_comes(
    heard: Heard, port: int, monkeypatch: pytest.MonkeyPatch, speaks: bool
) -> None:
    opened = []
    for number in range(MOST_CONNECTIONS):
        opened.append(await asyncio.open_connection("127.0.0.1", port))
        await eventually(lambda so_far=number: len(heard.endpoints.peers) > so_far, "connected")
    names = [peer.name for peer in heard.endpoints.peers]
    for _, writer in opened if speaks else opened[:2]:
        writer.write(HEARTBEAT)
    await eventually(lambda: len(heard.messages) == (MOST_CONNECTIONS if speaks else 2), "who speaks")
    monkeypatch.setattr(endpoints, "SILENT_S", 0.0)
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    if speaks:
        with contextlib.suppress(ConnectionError):
            assert await reader.read(1) == b""
    else:
        writer.write(HEARTBEAT)
        await eventually(lambda: len(heard.messages) == 3, "the new one")
    assert heard.gone == ([] if speaks else [names[2]])
    for _, one in (*opened, (reader, writer)):
        one.transport.abort()


async def test_an_address_that_is_taken_is_one_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = ClientAddress("tcp", "127.0.0.1", taken.getsockname()[1])
        with pytest.raises(ConfigurationError, match=f"^--listen {address}: cannot listen: "):
            await Heard().endpoints.open([], [address])


@pytest.mark.parametrize("length", [0, 50, 51, 100, 200])
def test_a_long_text_comes_in_parts_that_belong_together(length: int) -> None:
    packets: list[bytes] = []
    send_text(Peer("x", packets.append), 1, Severity.ERROR, "é" + "x" * length)
    parts = [mavlink.MAVLink(None).decode(bytearray(packet)) for packet in packets]
    assert "".join(part.text for part in parts) == "?" + "x" * length
    assert [part.chunk_seq for part in parts] == list(range(len(parts)))
    assert len({part.id for part in parts}) == 1
    assert (parts[0].id == 0) == (length < 50)
    assert len(parts[-1].text) < 50 or length < 50


def test_each_socket_counts_its_own_messages_of_each_drone() -> None:
    packets: dict[str, list[bytes]] = {"a": [], "b": []}
    peers = {name: Peer(name, packets[name].append) for name in packets}
    for name, drone in (("a", 1), ("b", 1), ("a", 2), ("a", 1)):
        send_text(peers[name], drone, Severity.INFO, "x")
    assert [(packet[5], packet[4]) for packet in packets["a"]] == [(1, 0), (2, 0), (1, 1)]
    assert [(packet[5], packet[4]) for packet in packets["b"]] == [(1, 0)]
