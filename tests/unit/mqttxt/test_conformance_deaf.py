"""The conformance kit's link that delivers nothing: PUBLISH is withheld, everything else passes."""

from __future__ import annotations

import asyncio

from mqttxt.core.address import BrokerAddress
from mqttxt_conformance.deaf import Deaf
from mqttxt_conformance.relay import DOWN, UP

PUBACK, PINGRESP = b"\x40\x02\x00\x01", b"\xd0\x00"
PUBLISH = b"\x30\xc8\x01" + bytes(200)
LEAVES = b"\xe0\x02\x04\x00"


class Sink:
    """Keeps what is written."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += data

    async def drain(self) -> None: ...


async def carried(deaf: Deaf, way: str, data: bytes) -> bytes:
    source, sink = asyncio.StreamReader(), Sink()
    source.feed_data(data)
    source.feed_eof()
    try:
        await deaf.carry(way, source, sink)  # type: ignore[arg-type]
    except ConnectionResetError:
        return sink.data
    raise AssertionError("the end of a connection was not told")


async def test_while_deaf_no_publish_is_delivered_and_answers_are() -> None:
    deaf = Deaf(BrokerAddress("192.0.2.1", 1883))
    assert deaf.address.host == "127.0.0.1"
    assert await carried(deaf, DOWN, PUBLISH + PUBACK) == PUBLISH + PUBACK
    deaf.is_deaf = True
    assert await carried(deaf, DOWN, PUBLISH + PUBACK + PUBLISH + PINGRESP) == PUBACK + PINGRESP
    assert await carried(deaf, UP, PUBLISH) == PUBLISH
    assert deaf.connections == 2


async def test_the_reason_code_with_which_a_client_leaves_is_kept() -> None:
    deaf = Deaf(BrokerAddress("192.0.2.1", 1883))
    assert await carried(deaf, UP, LEAVES) == LEAVES
    assert await carried(deaf, UP, b"\xe0\x00") == b"\xe0\x00"
    assert deaf.farewells == [4, 0]
