"""Rules of an activator whose fog has two brokers: the kit's drone 1 is connected to both."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command, Hold
from mqttxt.protocol.messages import Presence

from . import shapes
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit
from .registry import expect, rule
from .tap import Heard, Tap

ASKED_S = 1.5
"""How long a drone has to answer a lease after the will of one of its connections, before it counts as gone."""
AGAIN_S = 0.5
"""How long a command over one connection may remain without a word before it is sent over both."""
ROLE = "activator with two brokers"


def _say(kit: ActivatorKit, tap: Tap, up: bool) -> None:
    """Publish drone 1's birth, or the will of one of its connections, at one broker."""
    presence = Presence(session=kit.one.session, up=up, several=None if up else True)
    tap.publish(kit.fog_side.reachable(1), encode(presence), retain=True)


async def _is_there_at_both(kit: ActivatorKit) -> None:
    kit.one.answers_leases = True
    for tap in kit.fogs:
        _say(kit, tap, up=True)
    kit.one.beacon()
    found = await kit.cloud.until(lambda: kit.record(1).get("up"), PATIENCE_S)
    expect(found, f"drone 1 was born at both brokers: its record is {kit.record(1)}")
    await asyncio.sleep(QUIET_S)


def _copies(kit: ActivatorKit, marks: list[int], command: Command) -> list[list[Heard]]:
    """A command's copies at each broker since its mark."""
    topic = kit.fog_side.commands(1)
    came = [tap.since(mark, topic) for tap, mark in zip(kit.fogs, marks, strict=True)]
    name = command.name
    return [[one for one in each if shapes.read("command", one.payload)["command"] == name] for each in came]


async def _sent(kit: ActivatorKit, command: Command) -> tuple[list[int], str]:
    """Send drone 1 a command and wait for it; returns each broker's mark before, and the command's name."""
    marks = [len(tap.heard) for tap in kit.fogs]
    message = kit.send(command)
    await kit.comes_down(message)
    return marks, command.name


@rule(ROLE, "R19.1")
async def is_there_while_one_broker_says_so(kit: ActivatorKit) -> str:
    """A drone that is born at both brokers is there until the wills at both, and what is said of it does not change."""
    await _is_there_at_both(kit)
    before = len(kit.records[1])
    for tap in kit.fogs:
        _say(kit, tap, up=False)
        await asyncio.sleep(ASKED_S + QUIET_S)
        expect(len(kit.records[1]) == before, f"a will at one broker: {kit.record(1)}")
        _say(kit, tap, up=True)
        await asyncio.sleep(QUIET_S)
    return f"a will at either broker alone: no word of it; {kit.record(1)}"


@rule(ROLE, "R19.1")
async def asks_before_a_will_of_several_is_the_end(kit: ActivatorKit) -> str:
    """After wills at both, which say `several`, a drone that echoes a lease is there; one that does not is gone."""
    await _is_there_at_both(kit)
    before = len(kit.records[1])
    for tap in kit.fogs:
        _say(kit, tap, up=False)
    await asyncio.sleep(ASKED_S + QUIET_S)
    expect(len(kit.records[1]) == before, f"it echoed a lease after the wills: {kit.record(1)}")
    await _is_there_at_both(kit)
    kit.one.answers_leases = False
    for tap in kit.fogs:
        _say(kit, tap, up=False)
    gone = await kit.cloud.until(lambda: kit.record(1).get("up") is False, ASKED_S + PATIENCE_S)
    expect(gone, f"it echoed nothing after the wills: {kit.record(1)} after {ASKED_S + PATIENCE_S:g} s")
    await _is_there_at_both(kit)
    return "with an echo it stayed, without one it was gone"


@rule(ROLE, "R19.4")
async def sends_safety_commands_over_both(kit: ActivatorKit) -> str:
    """A safety command goes to both brokers at once, the same bytes; another one, answered at once, to one of them."""
    await _is_there_at_both(kit)
    marks, name = await _sent(kit, Hold())
    await kit.cloud.until(lambda: all(_copies(kit, marks, Hold())), PATIENCE_S)
    copies = _copies(kit, marks, Hold())
    expect(all(copies), f"{name}: {[len(each) for each in copies]} copies at the brokers")
    expect(len({one.payload for each in copies for one in each}) == 1, f"{name}: copies with other bytes")
    marks, other = await _sent(kit, Arm())
    await asyncio.sleep(2 * AGAIN_S)
    numbers = [len(each) for each in _copies(kit, marks, Arm())]
    expect(sorted(numbers) == [0, 1], f"{other}: {numbers} copies at the brokers")
    return f"{name}: at both, the same bytes; {other}: at one"


@rule(ROLE, "R19.5")
async def sends_again_over_both(kit: ActivatorKit) -> str:
    """A command without a word for 0.5 s goes to both brokers, as the same bytes, and has one last word."""
    await _is_there_at_both(kit)
    words, kit.one.words = kit.one.words, ()
    try:
        marks, name = await _sent(kit, Arm())
        await kit.cloud.until(lambda: all(_copies(kit, marks, Arm())), AGAIN_S + PATIENCE_S)
    finally:
        kit.one.words = words
    copies = _copies(kit, marks, Arm())
    expect(all(copies), f"{name}: {[len(each) for each in copies]} copies at the brokers")
    payloads = {one.payload for each in copies for one in each}
    expect(len(payloads) == 1, f"{name}: copies with other bytes")
    fields = shapes.read("command", payloads.pop())
    for word in words:
        kit.one.say(fields["gs_session"], fields["seq"], name, word)
    return f"{name}: at both after {AGAIN_S:g} s without a word, the same bytes"
