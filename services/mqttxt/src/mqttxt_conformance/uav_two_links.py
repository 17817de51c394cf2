"""Rules of a UAV client with two connections: the kit is its activator at two brokers."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command, Disarm
from mqttxt.protocol.messages import CommandMessage

from . import shapes
from .autopilot import ARM
from .fields import FIRST_WORDS
from .registry import expect, rule
from .tap import Line
from .uav_kit import PATIENCE_S, QUIET_S, UavKit
from .words import Words, words_of

BACK_S = 15.0
"""How long a client may take to reconnect."""


def _presences(kit: UavKit, tap: Line, mark: int) -> list[dict[str, Any]]:
    said = [heard for heard in tap.since(mark, kit.topics.reachable(kit.drone)) if heard.payload]
    return [shapes.read("presence", heard.payload) for heard in said]


def _births(kit: UavKit, tap: Line, mark: int) -> list[dict[str, Any]]:
    return [said for said in _presences(kit, tap, mark) if said["up"]]


def _words(kit: UavKit, tap: Line, message: CommandMessage, mark: int = 0) -> Words:
    below = f"{kit.topics.root}drone{kit.drone}/commands_result/"
    return words_of(tap.since(mark, below=below), below, message.gs_session, message.seq)


async def _once(kit: UavKit, message: CommandMessage, taps: tuple[Line, ...]) -> str:
    """Send the same bytes over `taps`; expect one write, and one last word that arrives at both brokers."""
    second, mark = kit.two.tap, len(kit.autopilot.written)
    kit.lead(message.gs_session)
    for tap in taps:
        tap.publish(kit.topics.commands(kit.drone), encode(message))
    both = (kit.tap, second)
    await kit.tap.until(lambda: all(_words(kit, tap, message).last for tap in both), PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    written = kit.autopilot.flights(mark, ARM)
    name = message.command.name
    expect(len(written) == 1, f"{name} over {len(taps)} connections was written {len(written)} times")
    lasts = [_words(kit, tap, message).last for tap in both]
    expect(all(lasts), f"{name}: last words over the two connections: {lasts}")
    said = {payload for tap in both for payload in _lasts(kit, tap, message)}
    expect(len(said) == 1, f"{name}: last words that differ: {sorted(map(shapes.shown, said))}")
    return f"{name}: written once; {_words(kit, second, message)} over both"


def _lasts(kit: UavKit, tap: Line, message: CommandMessage) -> set[bytes]:
    """The payloads of a command's last words."""
    below = f"{kit.topics.root}drone{kit.drone}/commands_result/"
    said = [(heard, shapes.read("result", heard.payload)) for heard in tap.since(0, below=below)]
    own = [one for one in said if (one[1]["gs_session"], one[1]["seq"]) == (message.gs_session, message.seq)]
    return {heard.payload for heard, word in own if word["word"] not in FIRST_WORDS}


@rule("uav with two connections", "R19.1", "R19.3")
async def is_born_at_both_brokers(kit: UavKit) -> str:
    """Its birth stands at both brokers, with one session."""
    second = kit.two.tap
    births = await kit.tap.until(lambda: _births(kit, second, 0), PATIENCE_S)
    expect(births, f"no birth at the second broker within {PATIENCE_S:g} s")
    sessions = {kit.session, *(birth["session"] for birth in births)}
    expect(len(sessions) == 1, f"births of sessions {sorted(sessions)}")
    return f"session {kit.session} at both"


@rule("uav with two connections", "R19.4", "R5.3")
async def executes_once_what_comes_over_both(kit: UavKit) -> str:
    """A safety command over both connections, the same bytes, is written once, and has one last word, over both."""
    await kit.calm()
    armed = await _once(kit, kit.command(Arm()), (kit.tap,))
    disarmed = await _once(kit, kit.command(Disarm()), (kit.tap, kit.two.tap))
    return f"{armed}; {disarmed}"


@rule("uav with two connections", "R19.5", "R5.3")
async def answers_what_comes_over_the_other_afterwards(kit: UavKit) -> str:
    """A command that has its last word is not written again where the other connection brings it, and is answered."""
    await kit.calm()
    message, second = kit.command(Arm()), kit.two.tap
    evidence = await _once(kit, message, (kit.tap,))
    mark, heard = len(kit.autopilot.written), len(second.heard)
    second.publish(kit.topics.commands(kit.drone), encode(message))
    await kit.tap.until(lambda: _words(kit, second, message, heard).last, PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "what had come over one connection was written again")
    words = _words(kit, second, message, heard)
    expect(words.last is not None, f"the second copy was answered with {words}")
    await kit.calm()
    return f"{evidence}; the copy: {words}"


@rule("uav with two connections", "R19.1")
async def the_end_of_one_connection_is_not_the_end(kit: UavKit) -> str:
    """The will of a connection that is cut says `several`; commands go on over the other, and it comes back."""
    kit.subject.need()
    await kit.calm()
    said = []
    for relay, cut, other, command in (
        (kit.two.relays[0], kit.tap, kit.two.tap, Arm()),
        (kit.two.relays[1], kit.two.tap, kit.tap, Disarm()),
    ):
        mark = len(cut.heard)
        relay.cut()
        try:
            said.append(await _flies_on(kit, cut, other, mark, command))
        finally:
            relay.go_on()
        back = await cut.until(partial(_births, kit, cut, mark), BACK_S)
        expect(back, f"no birth within {BACK_S:g} s after the link was back")
        expect(back[-1]["session"] == kit.session, f"session {back[-1]['session']} after a cut of one connection")
    return "; ".join(said)


async def _flies_on(kit: UavKit, cut: Line, other: Line, mark: int, command: Command) -> str:
    """After a cut: check the will of that connection, and fly a command over the other one."""
    wills = await cut.until(lambda: _presences(kit, cut, mark), PATIENCE_S)
    expect(wills, f"no will within {PATIENCE_S:g} s of the cut")
    is_its = wills[0]["up"] is False and wills[0]["session"] == kit.session and wills[0].get("several") is True
    expect(is_its, f"will {wills[0]}, expected session {kit.session}, down, several")
    message, written = kit.command(command), len(kit.autopilot.written)
    kit.lead(message.gs_session)
    other.publish(kit.topics.commands(kit.drone), encode(message))
    await other.until(lambda: _words(kit, other, message).last, PATIENCE_S)
    words = _words(kit, other, message)
    expect(words.names[-1:] == ["completed"], f"over the other connection came {words}")
    expect(len(kit.autopilot.flights(written, ARM)) == 1, f"{command.name} was not written once")
    return f"{wills[0]}, then {words}"
