"""Rules of an activator about floods: what it lets through to a drone at a time (docs/protocol.md, section 15)."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import CommandMessage, Word

from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit
from .registry import expect, rule

_MOST = 8


@rule("activator", "R15.8")
async def asks_a_drone_in_turn(kit: ActivatorKit) -> str:
    """Of a station's questions at most eight are under way to a drone; the others follow its answers."""
    messages = [kit.command(Arm(), executor_session=kit.session % (2**32 - 1) + 1) for _ in range(2 * _MOST)]

    def came() -> list[CommandMessage]:
        return [message for message in messages if kit.forwarded(message)]

    usual, kit.one.words = kit.one.words, ()
    try:
        for message in messages:
            kit.publish(message)
        await kit.fog.until(lambda: len(came()) >= _MOST, PATIENCE_S)
        await asyncio.sleep(QUIET_S)
        first = came()
        kit.one.words = (Word.EXPIRED,)
        for message in first:
            kit.one.say(message.gs_session, message.seq, message.command.name, Word.EXPIRED)
        await kit.fog.until(lambda: len(came()) == len(messages), PATIENCE_S)
    finally:
        kit.one.words = usual
    at_once, text = len(first), f"{len(messages)} questions: {len(first)} came, the drone said nothing"
    expect(0 < at_once <= _MOST, f"{text}; expected {_MOST} at the most")
    expect(len(came()) == len(messages), f"{text}; {len(came())} had come {PATIENCE_S:g} s after its answers")
    return f"{text}; the others came behind its answers"
