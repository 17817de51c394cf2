"""Readings from a plain broker that refuses: who waits for them is told at once."""

from __future__ import annotations

import asyncio
from typing import Any, Self

import pytest

from mission import plain_readings
from mission.fleet import MissionError
from mission.plain_readings import PlainReadings
from mqttxt import BrokerRefused
from mqttxt.core.effects import Subscribe

REFUSED = "readings: the broker refused the connection with reason code 0x87"


class Link:
    """What stands in for mqttxt's MqttLink: subscribes at once, if it may, and is refused when told so."""

    def __init__(self, subscribes: bool) -> None:
        self.refused = asyncio.Event()
        self._subscribes = subscribes

    def __call__(self, name: str, address: Any, client_id: str, will: None, events: PlainReadings) -> Self:
        self._events = events
        return self

    async def run(self) -> None:
        if self._subscribes:
            self._events.subscribed(Subscribe("readings", ()))
            await self.refused.wait()
        raise BrokerRefused(REFUSED)

    async def close(self) -> None: ...


def _readings(monkeypatch: pytest.MonkeyPatch, link: Link, lost: asyncio.Event) -> PlainReadings:
    monkeypatch.setattr(plain_readings, "MqttLink", link)
    return PlainReadings("mqtt://cloud", (1,), lambda fog, reading: None, lost.set)


async def test_a_refusal_in_flight_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    link, lost = Link(subscribes=True), asyncio.Event()
    readings = _readings(monkeypatch, link, lost)
    await readings.connect()
    assert readings.lost is None
    link.refused.set()
    async with asyncio.timeout(10):
        await lost.wait()
    assert str(readings.lost) == REFUSED
    await readings.close()


async def test_a_refusal_at_the_start_ends_the_connecting(monkeypatch: pytest.MonkeyPatch) -> None:
    readings = _readings(monkeypatch, Link(subscribes=False), asyncio.Event())
    with pytest.raises(MissionError, match="connect: readings: the broker refused"):
        await readings.connect()
    await readings.close()


async def test_an_end_that_was_asked_for_is_no_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = asyncio.Event()
    readings = _readings(monkeypatch, Link(subscribes=True), lost)
    await readings.connect()
    await readings.close()
    assert readings.lost is None
    assert not lost.is_set()
