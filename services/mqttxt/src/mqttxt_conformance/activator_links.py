"""Rules of an activator about a drone that has two links: when it is there, and what goes over both."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Hold
from mqttxt.protocol.messages import CommandMessage, Presence

from . import shapes
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit
from .registry import expect, rule


def _second(kit: ActivatorKit, up: bool) -> None:
    """Drone 2's second link comes or goes."""
    presence = encode(Presence(session=kit.two.session, up=up))
    kit.fog.publish(kit.fog_side.second_reachable(2), presence, retain=True)


async def _until_reachable(kit: ActivatorKit, is_reachable: bool) -> None:
    await kit.cloud.until(lambda: kit.record(2).get("up") is is_reachable, PATIENCE_S)


@contextlib.asynccontextmanager
async def _with_two_links(kit: ActivatorKit) -> AsyncIterator[None]:
    """Drone 2 has two, and the kit's station controls it; afterwards it is another session, with one."""
    await kit.echoed(kit.station.register())
    words = kit.two.words
    _second(kit, up=True)
    mark = len(kit.two.leases)
    await kit.fog.until(lambda: len(kit.two.leases) > mark, PATIENCE_S)
    try:
        yield
    finally:
        kit.two.words = words
        kit.two.born(up=False)
        _second(kit, up=False)
        await _until_reachable(kit, False)
        kit.two.session = secrets.randbelow(2**32 - 1) + 1
        kit.two.born()
        await _until_reachable(kit, True)


def _topics(kit: ActivatorKit, message: CommandMessage) -> list[str]:
    """Where a command went down, in its order."""
    return [one.heard.topic for one in kit.forwarded(message, 2)]


@rule("activator", "R19.3")
async def a_drone_is_there_while_one_link_is(kit: ActivatorKit) -> str:
    """Of two links the will of one changes nothing, that of the last one makes the drone unreachable."""
    async with _with_two_links(kit):
        kit.two.born(up=False)
        await asyncio.sleep(QUIET_S)
        record = kit.record(2)
        expect(record.get("up") is True, f"the first link is gone, the second one is not; the record says {record}")
        _second(kit, up=False)
        await _until_reachable(kit, False)
        record = kit.record(2)
        expect(record.get("up") is False, f"both links are gone; the record says {record}")
    return f"first link gone: reachable; both gone: {record}"


@rule("activator", "R19.5")
async def sends_a_halt_over_both_links(kit: ActivatorKit) -> str:
    """A hold for a drone with two links goes to `droneY/both_links` alone."""
    async with _with_two_links(kit):
        message = kit.command(Hold())
        kit.publish(message, 2)
        await kit.comes_down(message, 2)
        await kit.outcome(message, 2)
        topics = _topics(kit, message)
        expect(topics == [kit.fog_side.both_links(2)], f"it went down on {topics}")
    return f"it went down on {topics}"


@rule("activator", "R19.5")
async def tries_both_links_where_no_word_comes(kit: ActivatorKit) -> str:
    """Another command goes to `droneY/commands`, and without a word to `droneY/both_links` too, once."""
    async with _with_two_links(kit):
        answered = kit.command(Arm())
        kit.publish(answered, 2)
        await kit.outcome(answered, 2)
        kit.two.words = ()
        message = kit.command(Arm(), limit_s=1.0)
        kit.publish(message, 2)
        await kit.fog.until(lambda: len(_topics(kit, message)) > 1, PATIENCE_S)
        await asyncio.sleep(QUIET_S)
        topics, alone = _topics(kit, message), _topics(kit, answered)
        both = [kit.fog_side.commands(2), kit.fog_side.both_links(2)]
        expect(alone == both[:1], f"with a word at once it went down on {alone}")
        expect(topics == both, f"without a word it went down on {topics}")
        payloads = {one.heard.payload for one in kit.forwarded(message, 2)}
        expect(len(payloads) == 1, f"with other bytes: {', '.join(map(shapes.shown, payloads))}")
    return f"with a word at once: {alone}; without: {topics}, the same bytes"
