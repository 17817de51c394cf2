"""Rules of a UAV client in a fleet that signs: what it accepts, how long commands and control last, what it signs."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from mqttxt.protocol.bulk import BulkAsk, Get
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Hold
from mqttxt.protocol.control import DroneLease
from mqttxt.protocol.messages import CommandMessage

from . import shapes
from .autopilot import GCS
from .registry import expect, rule
from .secured import SecuredUav
from .uav_kit import PATIENCE_S, QUIET_S, UavKit

_HOLDER = 78
_UNHEARD = ("unsigned", "another key's signature", "a payload that was changed", "signed for another drone")
_FAR_MS = 50_000
_NONCES = (7, 2**32 - 1)


async def _unheard(kit: UavKit, message: CommandMessage, payload: bytes, what: str) -> None:
    """Publish bytes that must be ignored, then the command itself, which must be executed as if new."""
    mark, said = len(kit.autopilot.written), len(kit.tap.heard)
    kit.tap.publish(kit.topics.commands(kit.drone), payload, as_it_is=True)
    await asyncio.sleep(QUIET_S)
    words = kit.words(message.gs_session, message.seq, said)
    kit.expect_unwritten(mark, f"{what}: written")
    expect(not words.words, f"{what}: came {words}, expected no word")
    kit.publish(message)
    then = await kit.outcome(message)
    expect(then.names[-1:] == ["completed"], f"after {what} the command itself: came {then}, expected completed")
    await kit.calm()


@rule("uav", "R12.2", "R12.9")
async def hears_only_what_is_signed(kit: UavKit) -> str:
    """What is not signed, or not by that station for this drone, is not answered, entered or executed."""
    secured = kit.signing
    await kit.calm()
    for what in _UNHEARD:
        message = kit.command(Arm())
        await _unheard(kit, message, _spoiled(kit, secured, message, what), what)
    return f"{', '.join(_UNHEARD)}: no word, nothing written; the command itself was then completed each time"


def _spoiled(kit: UavKit, secured: SecuredUav, message: CommandMessage, what: str) -> bytes:
    """A command's bytes, spoiled as `what` describes."""
    payload = encode(message)
    good = secured.envelope(kit.topics.commands(kit.drone), payload)
    if what == "another key's signature":
        return replace(good, signature=Ed25519PrivateKey.generate().sign(payload)).encode()
    if what == "a payload that was changed":
        return replace(good, payload=encode(replace(message, limit_s=message.limit_s + 1))).encode()
    if what == "signed for another drone":
        return secured.envelope(kit.topics.commands(kit.drone % 250 + 1), payload, secured.station).encode()
    return payload


@rule("uav", "R12.7", "R12.9", "R12.17")
async def leaves_a_session_to_its_owner(kit: UavKit) -> str:
    """A session is its first station's, or whose the lease says: another's birth does not take it, nor its command."""
    secured = kit.signing
    await kit.calm()
    guest, station = secured.folder.guest(), secured.station.name
    first = kit.command(Arm())
    kit.introduce(first.gs_session, guest)
    session = kit.command().gs_session + 1
    kit.introduce(session, guest)
    kit.lead(session)
    cases = ((f"in a session of {station}", first), ("which a lease gives to it", kit.command(gs_session=session)))
    for what, message in cases:
        stolen = secured.envelope(kit.topics.commands(kit.drone), encode(message), guest)
        await _unheard(kit, message, stolen.encode(), f"signed by {guest.name} {what}")
    return f"{guest.name} in sessions of {station}, one of which it named first: no word, nothing written"


@rule("uav", "R12.9")
async def looks_at_the_right(kit: UavKit) -> str:
    """A command of a station whose certificate has no right to it is `denied(not_allowed, RIGHT)`."""
    secured = kit.signing
    await kit.calm()
    guest = secured.folder.guest()
    mark = len(kit.autopilot.written)
    message = replace(kit.command(Arm()), gs_session=kit.command().gs_session + 1)
    kit.introduce(message.gs_session, guest)
    envelope = secured.envelope(kit.topics.commands(kit.drone), encode(message), guest)
    kit.tap.publish(kit.topics.commands(kit.drone), envelope.encode(), as_it_is=True)
    words = await kit.outcome(message)
    kit.expect_unwritten(mark, f"written for {guest.name}, which may only observe")
    reason = str(words.reason)
    right = f"mqttxt:may/command/{kit.drone}"
    is_denied = words.names == ["denied"] and reason.startswith("not_allowed")
    expect(is_denied, f"{guest.name} may only observe: came {words}, expected denied(not_allowed, {right})")
    return f"{guest.name} may only observe: came {words}; nothing was written"


@rule("uav", "R12.8", "R12.9")
async def is_due_at_the_earlier_deadline(kit: UavKit) -> str:
    """A command is due at the earlier of what its station signed and what the activator routes."""
    secured = kit.signing
    await kit.calm()
    topic, said = kit.topics.commands(kit.drone), []
    for what, signed_ms, route_ms in (
        ("signed for 5 s, routed as past", 5000, -500),
        ("signed as past, routed for 50 s", -500, _FAR_MS),
    ):
        mark = len(kit.autopilot.written)
        message = kit.command(Arm(), deadline_ms=max(1, kit.deadline(signed_ms)))
        kit.lead(message.gs_session)
        envelope = secured.envelope(topic, encode(message)).routed(max(1, kit.deadline(route_ms)))
        kit.tap.publish(topic, envelope.encode(), as_it_is=True)
        words = await kit.outcome(message)
        await asyncio.sleep(QUIET_S)
        kit.expect_unwritten(mark, f"{what}: written")
        expect(words.names == ["expired"], f"{what}: came {words}, expected expired")
        said.append(f"{what}: {words}")
    return f"{'; '.join(said)}; nothing was written"


@rule("uav", "R12.14")
async def takes_leases_of_its_fog_alone(kit: UavKit) -> str:
    """A lease that its fog's activator has not signed is not echoed."""
    secured = kit.signing
    topic, said = kit.topics.init_connect(kit.drone), []
    for number, (what, seal) in enumerate((("unsigned", None), (secured.station.name, secured.station)), start=1):
        nonce = 1_000_000_000 + number
        lease = encode(
            DroneLease(
                activator_session=kit.activator_session,
                drone_session=kit.session,
                nonce=nonce,
                bound=True,
                epoch=kit.epoch,
            )
        )
        payload = lease if seal is None else secured.envelope(topic, lease, seal).encode()
        kit.tap.publish(topic, payload, as_it_is=True)
        await asyncio.sleep(QUIET_S)
        echoed = [beacon for _, beacon in kit.beacons if beacon.get("nonce") == nonce]
        expect(not echoed, f"a lease that is {what}: echoed, {echoed}")
        said.append(what)
    expect(await kit.echo() is not None, f"its activator's own lease: no echo within {PATIENCE_S:g} s")
    return f"not echoed: {', '.join(said)}; its activator's own was"


@rule("uav", "R12.14")
async def control_ends_with_the_grant(kit: UavKit) -> str:
    """What lasts by itself ends where its station's grant does; within the lease a `hold` is still completed."""
    await kit.calm()
    granted_ms = kit.deadline(2500)
    kit.introduce(_HOLDER)
    kit.grant(_HOLDER, granted_ms, None)
    mark = len(kit.autopilot.written)
    await kit.echo(holder_session=_HOLDER, deadline_ms=kit.deadline(30_000), granted=False)
    await asyncio.sleep(4.2)
    beats = [one.at_ms for one in kit.autopilot.of_type(mark, "HEARTBEAT") if one.message.type == GCS]
    late = [at_ms for at_ms in beats if kit.read_late(at_ms, granted_ms)]
    expect(beats, "no heartbeat of a ground station inside a grant of 2.5 s")
    expect(not late, f"{len(late)} heartbeats of a ground station after the grant's end, under a lease of 30 s")
    hold = kit.send(Hold(), gs_session=_HOLDER)
    words = await kit.outcome(hold)
    expect(words.names[-1:] == ["completed"], f"hold after the grant's end, within the lease: came {words}")
    return (
        f"{len(beats)} heartbeats inside a grant of 2.5 s under a lease of 30 s; none in 1.7 s after it; hold: {words}"
    )


@rule("uav", "R12.22", "R16.6")
async def names_what_it_answers(kit: UavKit) -> str:
    """What it answers about an object has, signed, the nonce of the question."""
    await kit.calm()
    session, answers = kit.command().gs_session, kit.topics.bulk_answer(kit.drone)
    kit.lead(session)
    for nonce in _NONCES:
        mark = len(kit.tap.heard)
        ask = BulkAsk(gs_session=session, kind="conformance", nonce=nonce, ask=Get(0, 0))
        kit.tap.publish(kit.topics.bulk(kit.drone), encode(ask), qos=0)
        came = await kit.tap.until(partial(kit.tap.since, mark, answers), PATIENCE_S)
        expect(came, f"a question for an object of a kind that nobody has: no answer within {PATIENCE_S:g} s")
        found = shapes.read("bulk-answer", came[0].payload)
        is_own = (found["gs_session"], found["nonce"]) == (session, nonce)
        expect(is_own, f"the question's nonce was {nonce}, of session {session}: came {shapes.shown(came[0].payload)}")
    return f"nonces {', '.join(map(str, _NONCES))}, each in the answer to its question"


@rule("uav", "R12.6")
async def birth_carries_its_certificate(kit: UavKit) -> str:
    """The birth has the drone's certificate, which the fleet's authority issued for droneY."""
    secured = kit.signing
    certificate = secured.speech.certificates.get(secured.name)
    expect(
        certificate is not None, f"no certificate of {secured.name} in its births: {'; '.join(secured.speech.wrong)}"
    )
    return f"the certificate of {secured.name}, of the fleet's authority"


@rule("uav", "R12.1", "R12.2", "R12.4", "R12.5")
async def signs_what_it_says(kit: UavKit) -> str:
    """Births, beacons and words are COSE_Sign1 as R12.1 has it, and verify for their topics."""
    speech = kit.signing.speech
    expect(not speech.wrong, "; ".join(speech.wrong[:3]))
    expect(speech.verified, "nothing that is to be signed came")
    return f"{speech.verified} births, beacons and words were verified"
