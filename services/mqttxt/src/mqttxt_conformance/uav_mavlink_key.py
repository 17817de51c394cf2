"""Rules of a UAV client about signing between autopilot and UAV client (section 13)."""

from __future__ import annotations

import asyncio
import secrets

from mqttxt.protocol.commands import Arm

from .autopilot import ARM
from .mavlink_signing import Signer, signature
from .registry import expect, rule
from .uav_halting import STALE_S
from .uav_kit import QUIET_S, UavKit

_LINK_ID = 191


def _own(kit: UavKit) -> Signer:
    """The signer of the autopilot that the kit has a key for."""
    assert kit.autopilot.signer is not None
    return kit.autopilot.signer


def _acknowledge(kit: UavKit, signer: Signer | None) -> None:
    """Acknowledge ARM once as somebody else signs."""
    own, kit.autopilot.signer = kit.autopilot.signer, signer
    try:
        kit.autopilot.acknowledge(ARM, 2)
    finally:
        kit.autopilot.signer = own


@rule("uav", "R13.2", "R13.3")
async def signs_what_it_writes(kit: UavKit) -> str:
    """With a key it signs everything that it writes, with link id 191 and time stamps that rise."""
    key, newest = _own(kit).key, 0
    for one in kit.autopilot.written:
        found, kind = signature(one.message, key), one.message.get_type()
        expect(found is not None, f"{kind}: not signed with the key")
        assert found is not None
        link_id, stamp = found
        expect(link_id == _LINK_ID, f"{kind}: link id {link_id}, expected {_LINK_ID}")
        expect(stamp > newest, f"{kind}: time stamp {stamp} behind {newest}")
        newest = stamp
    return f"{len(kit.autopilot.written)} messages, each signed with link id {_LINK_ID}, time stamps rising"


@rule("uav", "R13.4", "R13.5")
async def hears_only_what_the_key_signs(kit: UavKit) -> str:
    """With a key it does not hear what is unsigned, signed by another key, old, or signed for another link."""
    await kit.calm()
    key = _own(kit).key
    strange = {
        "unsigned": None,
        "another key's": Signer(secrets.token_bytes(32)),
        "5 s old": Signer(key, late_s=5),
        "of another link": Signer(key, link_id=2),
    }
    message, _ = await kit.unanswered(Arm(), ARM)
    for signer in strange.values():
        _acknowledge(kit, signer)
    await asyncio.sleep(QUIET_S)
    words = kit.words(message.gs_session)
    expect(not words.words, f"refusals {', '.join(strange)}: came {words}")
    kit.autopilot.manners.clear()
    words = await kit.outcome(message)
    expect(words.names[-1:] == ["completed"], f"then, with its own acknowledgement, came {words}")
    return f"refusals {', '.join(strange)} were ignored; then {words}"


@rule("uav", "R13.7", "R13.4")
async def is_without_an_autopilot_that_does_not_sign(kit: UavKit) -> str:
    """With a key, an autopilot that does not sign is none: `denied(no_autopilot)`."""
    await kit.calm()
    own, kit.autopilot.signer = kit.autopilot.signer, None
    try:
        await asyncio.sleep(STALE_S)
        evidence = (await kit.refused(kit.command(Arm()), "denied", "no_autopilot"))[1]
    finally:
        kit.autopilot.signer = own
        await kit.calm()
    return f"{STALE_S:g} s without signatures: {evidence}"


@rule("uav", "R13.7")
async def takes_signed_messages_without_a_key(kit: UavKit) -> str:
    """Without a key it takes signed messages as if they were not."""
    await kit.calm()
    kit.autopilot.signer = Signer(secrets.token_bytes(32))
    try:
        await asyncio.sleep(STALE_S)
        words = await kit.outcome(kit.send(Arm()))
    finally:
        kit.autopilot.signer = None
    expect(words.names[-1:] == ["completed"], f"an autopilot that signs: came {words}")
    return f"{STALE_S:g} s with signatures alone: arm {words}"


WITH_KEY = (signs_what_it_writes, hears_only_what_the_key_signs, is_without_an_autopilot_that_does_not_sign)
WITHOUT_KEY = (takes_signed_messages_without_a_key,)
