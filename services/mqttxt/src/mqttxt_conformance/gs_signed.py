"""Rules of a ground station in a fleet that signs, judged by what the kit received while its script ran."""

from __future__ import annotations

from . import shapes
from .gs_kit import RATE, GsKit
from .readings import SENSOR, Sensor
from .registry import NotTested, expect, rule
from .secured import SecuredFog

_OFFBOARD_MS = 3000


def _secured(kit: GsKit) -> SecuredFog:
    assert kit.secured is not None, "these rules are checked where messages are signed"
    return kit.secured


@rule("gs", "R12.1", "R12.2", "R12.4", "R12.5")
async def signs_what_it_says(kit: GsKit) -> str:
    """Births, registrations, commands and grants are COSE_Sign1 as R12.1 has it, and verify for their topics."""
    speech = _secured(kit).speech
    expect(not speech.wrong, "; ".join(speech.wrong[:3]))
    expect(speech.verified, "nothing that is to be signed came")
    return f"{speech.verified} births, registrations, commands and grants were verified"


@rule("gs", "R12.8")
async def addresses_its_drone(kit: GsKit) -> str:
    """Around what is signed for the drone stand the activator's session and a deadline in its clock."""
    secured = _secured(kit)
    if not secured.outside:
        raise NotTested("no command came")
    named = {session for session, _ in secured.outside}
    expect(named <= set(kit.sessions), f"sessions {named}, the activator's are {kit.sessions}")
    return f"{len(secured.outside)} commands, in the activator's sessions"


@rule("gs", "R12.13")
async def registers_for_a_session_and_counts(kit: GsKit) -> str:
    """A registration names the activator's session and until when it is meant, and its counter rises."""
    session = kit.enrolments[0].fields["session"]
    found = [one for one in kit.enrolments if one.fields["session"] == session]
    for one in found:
        shown = shapes.shown(one.heard.payload)
        expect(one.fields.get("activator_session") == one.session, f"{shown}: the activator's session is {one.session}")
        expect("until_ms" in one.fields, f"{shown}: no until_ms")
    counters = [one.fields.get("counter", -1) for one in found]
    expect(counters == sorted(set(counters)) and counters[0] >= 0, f"counters {counters}")
    return f"{len(found)} registrations, counters {counters}"


@rule("gs", "R12.11")
async def believes_its_drone_alone(kit: GsKit) -> str:
    """A `completed` that is unsigned, or signed by another node than the drone, ends no command."""
    if kit.forged_ms is None:
        raise NotTested("no command came")
    first = kit.commands[0]
    answered_ms = kit.answered[first.heard.payload]
    other = [
        command
        for command in kit.commands
        if command.fields["seq"] != first.fields["seq"] and kit.forged_ms <= command.heard.at_ms < answered_ms
    ]
    expect(not other, f"after words that the drone had not signed it went on with {len(other)} more commands")
    return "unsigned, and signed by the activator and by a station: the command stayed open until the drone's own word"


@rule("gs", "R12.19", "R12.21")
async def acknowledges_readings_that_are_signed(kit: GsKit) -> str:
    """Of a sensor's readings it acknowledges, signed, those that the sensor signed, and no others."""
    if kit.sensor is None:
        Sensor(_secured(kit).folder)
        raise NotTested("no command came")
    shown = [shapes.shown(heard.payload) for heard in kit.acknowledged]
    acks = [shapes.read("reading-ack", heard.payload)["readings"] for heard in kit.acknowledged]
    named = {shapes.reading_key(key) for ack in acks for key in ack}
    expect(named == {(SENSOR, kit.sensor.boot, seq) for seq in kit.measured}, f"readings {kit.measured}; came {shown}")
    return f"readings {kit.measured} of 4, the others being unsigned and an activator's: {shown[0]}"


@rule("gs", "R12.14")
async def grants_its_control(kit: GsKit) -> str:
    """It grants itself control at the drone, for that one's session, no longer than its lease."""
    lease_ms = next(one.fields["lease_s"] for one in kit.enrolments if one.fields["lease_s"] > 0) * 1000
    bad = [text for text in kit.malformed if "control" in text]
    expect(kit.grants, f"no grant on {kit.topics.drone_control(kit.drone)} for a drone that it controls; {bad[:2]}")
    sessions = {session % (2**32 - 1) + 1 for session in kit.sessions}
    for heard, grant, now_ms in kit.grants:
        shown = shapes.shown(heard.payload)
        expect(grant["drone_session"] in sessions, f"{shown}: the drone's sessions are {sorted(sessions)}")
        latest_ms = now_ms + lease_ms * (1 - RATE) + 1
        expect(grant["until_ms"] <= latest_ms, f"{shown}: no later than {latest_ms:.0f} is allowed")
        offboard_ms = grant.get("offboard_until_ms", 0)
        expect(offboard_ms <= now_ms + _OFFBOARD_MS + 1, f"{shown}: offboard for more than 3 s")
    return f"{len(kit.grants)} grants, the last {shapes.shown(kit.grants[-1][0].payload)}"
