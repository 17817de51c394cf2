"""The conformance kit's own connection, where its broker stops to answer."""

from __future__ import annotations

import asyncio

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt_conformance import tap as tap_module
from mqttxt_conformance.tap import NO_PUBACK, Tap, clear_retained
from tests.rigs.mqtt_server import PUBLISH, Server
from tests.rigs.processes import eventually


async def test_a_broker_that_acknowledges_nothing_holds_up_no_kit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tap_module, "PUBACK_S", 0.05)
    async with Server(acknowledges=False) as server:
        tap = Tap(BrokerAddress("127.0.0.1", server.port), "kit", SessionClock())
        await tap.connect("--broker")
        assert await tap.publish("drone1/reachable", b"up", retain=True) == NO_PUBACK
        await clear_retained(tap, ["drone1/reachable", "drone2/reachable"])
        await eventually(lambda: len(server.sessions[0].of(PUBLISH)) == 3, "all three")
        await tap.close()


async def test_an_unspecified_error_is_no_missing_puback() -> None:
    async with Server(acknowledges=False) as server:
        tap = Tap(BrokerAddress("127.0.0.1", server.port), "kit", SessionClock())
        await tap.connect("--broker")
        publishing = asyncio.ensure_future(tap.publish("drone1/reachable", b"up"))
        await eventually(lambda: server.sessions[0].of(PUBLISH), "it is published")
        (packet,) = server.sessions[0].of(PUBLISH)
        server.sessions[0].acknowledge(packet.publish()[3], code=0x80)
        assert await publishing == 0x80
        await tap.close()
