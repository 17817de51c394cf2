"""MQTT 5 by hand, cheap enough to load others, with which the benchmarks send and count."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable

from tests.rigs.mqtt_server import publish, variable_length

_PUBLISH = 0x30


def with_alias(topic: str, payload: bytes, alias: int) -> bytes:
    """A PUBLISH; an empty topic is a second or later use of the alias."""
    return publish(topic, payload, properties=b"\x23" + alias.to_bytes(2, "big"))


class RawClient(asyncio.Protocol):
    """A client at QoS 0 and 1. `heard(topic, payload)` is called for each message; all are counted."""

    def __init__(self, heard: Callable[[str, bytes], None] | None = None) -> None:
        self.received = 0
        self._heard = heard
        self._buffer = b""
        self._transport: asyncio.Transport | None = None
        self._ready = asyncio.get_running_loop().create_future()
        self._subscribed = asyncio.get_running_loop().create_future()

    @classmethod
    async def connect(cls, port: int, name: str, heard: Callable[[str, bytes], None] | None = None) -> RawClient:
        _, client = await asyncio.get_running_loop().create_connection(lambda: cls(heard), "127.0.0.1", port)
        body = b"\0\4MQTT\5\2\0\0\x05\x11\0\0\0\0" + struct.pack("!H", len(name)) + name.encode()
        client.send(b"\x10" + variable_length(len(body)) + body)
        await client._ready
        return client

    async def subscribe(self, *filters: str, qos: int = 0) -> None:
        body = b"\0\1\0" + b"".join(struct.pack("!H", len(f)) + f.encode() + bytes([qos]) for f in filters)
        self.send(b"\x82" + variable_length(len(body)) + body)
        await self._subscribed

    def send(self, data: bytes) -> None:
        assert self._transport is not None
        self._transport.write(data)

    def publish(self, topic: str, payload: bytes, qos: int = 0) -> None:
        self.send(publish(topic, payload, qos, mid=1))

    def close(self) -> None:
        assert self._transport is not None
        self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        data = self._buffer + data
        at = 0
        while len(data) - at >= 2:
            length, start = data[at + 1], at + 2
            if length > 127:
                if len(data) - at < 3:
                    break
                length, start = length - 128 + 128 * data[at + 2], at + 3
            if len(data) < start + length:
                break
            self._take(data[at], data, start, start + length)
            at = start + length
        self._buffer = data[at:]

    def _take(self, first: int, data: bytes, start: int, end: int) -> None:
        kind = first & 0xF0
        if kind == _PUBLISH:
            self.received += 1
            if self._heard is None:
                return
            behind = start + 2 + int.from_bytes(data[start : start + 2], "big")
            topic = data[start + 2 : behind].decode()
            if first & 6:
                self.send(b"\x40\x02" + data[behind : behind + 2])
                behind += 2
            self._heard(topic, data[behind + 1 + data[behind] : end])
        elif kind == 0x20:
            self._ready.set_result(None)
        elif kind == 0x90 and not self._subscribed.done():
            self._subscribed.set_result(None)
