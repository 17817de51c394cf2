"""The script that the kit plays to a ground station, from its registration to its end."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from functools import partial

from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import Presence, Word

from .deaf import SILENT_S
from .gs_kit import APPEAR_S, BEACON_HELD_S, LONGEST_LEASE_S, NEXT_S, GsKit
from .readings import KIND, SENSOR, Sensor
from .registry import Broken, NotTested
from .sealed import STATION

_LATE_S = 6.0


async def play(kit: GsKit) -> None:
    """Play the script; raises Broken if no station registers."""
    await kit.appear()
    if kit.subject.is_ours:
        await kit.subject.start()
    await kit.tap.until(lambda: kit.enrolments or kit.subject.exit_code is not None, APPEAR_S)
    if not kit.enrolments:
        raise Broken(f"no registration on {kit.topics.init_connect}: {kit.subject.why_silent(f'{APPEAR_S:g} s')}")
    await kit.tap.until(lambda: kit.commands, APPEAR_S)
    _say_nonsense(kit)
    _forge(kit)
    _measure(kit)
    _upset(kit)
    await _wait_for_renewal(kit)
    before = len(kit.enrolments)
    kit.anew_ms = kit.clock.now_ms()
    await kit.appear()
    await kit.tap.until(lambda: len(kit.enrolments) > before, 5)
    if kit.enrolments[before:]:
        await asyncio.sleep(2 * BEACON_HELD_S)
    await _answer_all(kit)
    await _end(kit)


def _say_nonsense(kit: GsKit) -> None:
    for topic in (kit.topics.clock, kit.topics.drone_result(kit.drone, "arm"), kit.topics.drone_state(kit.drone, "x")):
        for payload in (b"{", b"\xff\xff", b"\x81\x01", b""):
            kit.tap.publish(topic, payload, as_it_is=True)


def _forge(kit: GsKit) -> None:
    """Publish last words about the first command that its drone has not signed."""
    if kit.secured is None or not kit.commands:
        return
    kit.forged_ms = kit.clock.now_ms()
    topic, word = kit.word(kit.commands[0], Word.COMPLETED)
    kit.tap.publish(topic, word, as_it_is=True)
    by_activator = kit.secured.activator.sign(topic.removeprefix(kit.prefix), word).encode()
    by_station = kit.secured.word(topic, word, kit.secured.folder.seal(f"gs-{STATION}"))
    for payload in (by_activator, by_station):
        kit.tap.publish(topic, payload, as_it_is=True)


def _measure(kit: GsKit) -> None:
    """Publish readings, two of which their sensor has signed."""
    if kit.secured is None or not kit.commands:
        return
    with contextlib.suppress(NotTested):  # the rule says why
        kit.sensor = sensor = Sensor(kit.secured.folder)
        kit.measured = [3, 4]
        readings = (sensor.measured(1), sensor.said(2, by=kit.secured.activator), sensor.said(3), sensor.said(4))
        for payload in readings:
            topic = kit.topics.drone_sensor(kit.drone, SENSOR, KIND)
            kit.tap.publish(topic, payload, as_it_is=True)


def _upset(kit: GsKit) -> None:
    """Publish another session's `down` on the station's retained topic."""
    if kit.presence_topic is not None:
        kit.upset_ms = kit.clock.now_ms()
        other = Presence(session=secrets.randbelow(2**32 - 1) + 1, up=False)
        if kit.secured is not None:
            kit.secured.speech.own.add(encode(other))
        kit.twin.publish(kit.presence_topic, encode(other), retain=True)


async def _wait_for_renewal(kit: GsKit) -> None:
    """Wait, at most until both are due, for a renewal at a third of the lease and a repetition of the first command."""
    first = kit.enrolments[0]
    lease_ms = min(first.fields["lease_s"], LONGEST_LEASE_S) * 1000
    due_ms = first.heard.at_ms + lease_ms / 3 * 1.25 + 1000
    payloads = [command.heard.payload for command in kit.commands]
    if payloads:
        due_ms = max(due_ms, kit.commands[0].heard.at_ms + kit.ttl_ms + 2500)

    def seen() -> bool:
        again = not payloads or sum(c.heard.payload == payloads[0] for c in kit.commands) > 1
        return len(kit.enrolments) > 1 and again

    while not seen() and kit.clock.now_ms() < due_ms:
        await kit.tap.until(seen, (due_ms - kit.clock.now_ms()) / 1000)


async def _answer_all(kit: GsKit) -> None:
    """Answer every command with `completed`, until no more arrive."""
    while True:
        known = len(kit.commands)
        for command in kit.commands:
            if command.heard.payload not in kit.answered:
                kit.answer(command, Word.ACCEPTED, Word.COMPLETED)
        repeated_s = kit.ttl_ms / 1000 + 1.5 if kit.together else 0  # by then a broadcast with unread words is repeated
        await kit.tap.until(partial(_has_more, kit, known), max(NEXT_S, repeated_s))
        if len(kit.commands) == known:
            return


def _has_more(kit: GsKit, known: int) -> bool:
    """Whether a further command has arrived or the implementation has ended."""
    return len(kit.commands) > known or kit.subject.exit_code is not None


async def _end(kit: GsKit) -> None:
    """Stop an implementation that the kit starts cleanly; then start it again and kill it."""
    if not kit.subject.is_ours:
        return
    kit.subject.terminate()
    kit.exit_code = await kit.subject.ended()
    await asyncio.sleep(0.3)
    kit.stopped_mark = len(kit.tap.heard)
    await kit.subject.kill()
    count = len(kit.enrolments)
    await kit.subject.start()
    await kit.tap.until(lambda: len(kit.enrolments) > count or kit.subject.exit_code is not None, APPEAR_S)
    if len(kit.enrolments) > count:
        name = kit.enrolments[-1].fields["name"]
        kit.presence_topic = f"{kit.prefix}gs/{name}/reachable"
        await _be_silent(kit)
        kit.killed_mark = len(kit.tap.heard)
        await kit.subject.kill()
        await kit.tap.until(kit.last_words, 5)


async def _be_silent(kit: GsKit) -> None:
    """Publish nothing any more, until the station asks whether it is heard."""
    await asyncio.sleep(2 * BEACON_HELD_S)
    kit.is_mute, kit.hushed = True, (len(kit.tap.heard), kit.clock.now_ms())
    await kit.tap.until(kit.births_in_silence, SILENT_S + _LATE_S)
