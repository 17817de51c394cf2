"""The sockets of MAVLink clients: UDP ports on which they listen, and TCP connections that they open."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.address import address_of, host_port
from ..drone.mavlink.frame_parser import MAGIC, Malformed, StreamFrames, in_datagram
from ..drone.mavlink.plans import AUTOPILOT_COMPONENT
from ..errors import ConfigurationError

logger = logging.getLogger("mqttxt.gateway")

MOST_CONNECTIONS = 32
SILENT_S = 30.0
"""How long a TCP client may be connected without a message before it makes room for another one."""
MOST_UNSENT = 256 * 1024
"""The unsent bytes above which the connection of a client that does not read is closed."""
_READ_BYTES = 4096
"""How much of one connection is handled at a time, so that a client that floods keeps nobody waiting."""


@dataclass(frozen=True)
class ClientAddress:
    """`udp:HOST:PORT`, on which a client listens, or `tcp:HOST:PORT`, on which the gateway does; `[::1]` for IPv6."""

    kind: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str, kind: str, option: str, insecure: bool) -> ClientAddress:
        """Raises ConfigurationError if it is no address of this kind, or another machine's without `insecure`."""
        found, _, rest = text.partition(":")
        wrong = ConfigurationError(f"{option} {text!r}: expected {kind}:HOST:PORT")
        if found != kind:
            raise wrong
        try:
            host, port = address_of(rest, option)
        except ConfigurationError:
            raise wrong from None
        if not insecure and not _is_loopback(host):
            raise ConfigurationError(
                f"{option} {text!r}: expected this machine, as {kind}:127.0.0.1:{port}, or --insecure-mavlink: nothing "
                "protects MAVLink, and whoever is there commands the drones"
            )
        return cls(kind, host, port)

    def __str__(self) -> str:
        return f"{self.kind}:{host_port(self.host, self.port)}"


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Peer:
    """One socket with a client, or several, behind it."""

    def __init__(self, name: str, write: Callable[[bytes], None]) -> None:
        self.name = name
        self._write = write
        self._encoders: dict[int, Any] = {}

    def send(self, drone: int, message: Any) -> None:
        """Send a message in the name of a drone's autopilot."""
        encoder = self._encoders.get(drone)
        if encoder is None:
            encoder = mavlink.MAVLink(None, srcSystem=drone, srcComponent=AUTOPILOT_COMPONENT)
            self._encoders[drone] = encoder
        packet = message.pack(encoder)
        encoder.seq = (encoder.seq + 1) % 256
        self._write(packet)


OnMessage = Callable[[Peer, Any], None]


class Endpoints:
    """The sockets of one gateway; `peers` are those at which vehicles are shown."""

    def __init__(self, on_message: OnMessage, on_gone: Callable[[Peer], None]) -> None:
        self.peers: list[Peer] = []
        self._on_message = on_message
        self._on_gone = on_gone
        self._transports: list[asyncio.DatagramTransport] = []
        self._servers: list[asyncio.Server] = []
        self._serving: set[asyncio.Task[None]] = set()
        self._silent_since_s: dict[asyncio.Task[None], float] = {}
        """When the TCP clients connected that have sent no message yet, the oldest first."""

    async def open(self, to: list[ClientAddress], listen: list[ClientAddress]) -> None:
        """Raises ConfigurationError where an address cannot be used."""
        for address in to:
            await self._open_udp(address)
        for address in listen:
            try:
                self._servers.append(await asyncio.start_server(self._serve, address.host, address.port))
            except OSError as error:
                raise ConfigurationError(f"--listen {address}: cannot listen: {error.strerror or error}") from error
            logger.info("listening on %s", address)

    async def close(self) -> None:
        for transport in self._transports:
            transport.close()
        for server in self._servers:
            server.close()
        for task in self._serving:
            task.cancel()
        await asyncio.gather(*self._serving, return_exceptions=True)

    async def _open_udp(self, address: ClientAddress) -> None:
        loop = asyncio.get_running_loop()
        try:
            transport, protocol = await loop.create_datagram_endpoint(
                lambda: _Datagrams(self._on_message), remote_addr=(address.host, address.port)
            )
        except OSError as error:
            raise ConfigurationError(f"--to {address}: {error.strerror or error}") from error
        client = transport.get_extra_info("peername")
        if client in [other.get_extra_info("peername") for other in self._transports]:
            transport.close()
            raise ConfigurationError(
                f"--to {address}: expected once, got twice: its client's commands would count twice"
            )
        protocol.peer = Peer(str(address), transport.sendto)
        self._transports.append(transport)
        self.peers.append(protocol.peer)

    def _makes_room(self, now_s: float) -> bool:
        """Close the connection that has been silent for longest; False if none has been for `SILENT_S`."""
        task, since_s = next(iter(self._silent_since_s.items()), (None, now_s))
        if task is None or now_s - since_s < SILENT_S:
            return False
        del self._silent_since_s[task]
        task.cancel()
        return True

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        peer = Peer(f"tcp:{host_port(*writer.get_extra_info('peername')[:2])}", lambda packet: _write(writer, packet))
        try:
            clock = asyncio.get_running_loop()
            if len(self._serving) > MOST_CONNECTIONS and not self._makes_room(clock.time()):
                logger.warning("%s: refused; %d clients are connected", peer.name, MOST_CONNECTIONS)
                return
            logger.info("%s: connected", peer.name)
            self.peers.append(peer)
            self._silent_since_s[task] = clock.time()
            frames, is_first = StreamFrames(), True
            while data := await reader.read(_READ_BYTES):
                if is_first and data[0] not in MAGIC:  # a web page can make its browser send anything here
                    logger.warning("%s: refused; it does not begin with a MAVLink frame", peer.name)
                    return
                is_first = False
                for found in frames.feed(data, clock.time()):
                    if not isinstance(found, Malformed):
                        self._silent_since_s.pop(task, None)
                        self._on_message(peer, found)
                await asyncio.sleep(0)  # `read` returns at once while there is more
        except (ConnectionError, asyncio.CancelledError):
            pass  # the client has gone, or the gateway stops
        finally:
            writer.transport.abort()
            self._serving.discard(task)
            self._silent_since_s.pop(task, None)
            if peer in self.peers:
                self.peers.remove(peer)
                self._on_gone(peer)
                logger.info("%s: gone", peer.name)


def _write(writer: asyncio.StreamWriter, packet: bytes) -> None:
    if writer.transport.get_write_buffer_size() > MOST_UNSENT:
        writer.transport.abort()
    elif not writer.transport.is_closing():
        writer.write(packet)


class _Datagrams(asyncio.DatagramProtocol):
    """A socket connected to one address: it receives from no other. While nothing listens there, packets are lost."""

    peer: Peer

    def __init__(self, on_message: OnMessage) -> None:
        self._on_message = on_message

    def datagram_received(self, data: bytes, addr: Any) -> None:
        for found in in_datagram(data):
            if not isinstance(found, Malformed):
                self._on_message(self.peer, found)
