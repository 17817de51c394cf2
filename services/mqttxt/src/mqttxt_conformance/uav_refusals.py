"""Rules of a UAV client about commands that it must not execute, and its answers to them."""

from __future__ import annotations

import asyncio
import json

import cbor2

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Disarm, Hold, Mavlink
from mqttxt.protocol.values import Encoding

from . import shapes
from .autopilot import ARM
from .registry import NotTested, expect, rule
from .uav_kit import QUIET_S, UavKit

_FAR_MS = 61_000
_VTOL_TAKEOFF, _TERMINATE, _REBOOT = 84, 185, 246
_NO_MAV_CMD = 65_000


@rule("uav", "R4.6", "R5.5")
async def executes_only_its_own_session(kit: UavKit) -> str:
    """A command that names another session is not written."""
    await kit.calm()
    mark = len(kit.autopilot.written)
    message = kit.send(Arm(), executor_session=kit.session % (2**32 - 1) + 1)
    words = await kit.outcome(message)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, f"session {message.executor_session} was named, not {kit.session}; written")
    told = ["denied", "unconfirmed"] if kit.secured is None else ["expired", "unconfirmed"]  # R12.9: a query
    expect(words.names in ([one] for one in told), f"expected {' or '.join(told)}, came {words}")
    return f"named {message.executor_session} in place of {kit.session}: came {words}; nothing was written"


@rule("uav", "R4.7")
async def denies_without_a_deadline(kit: UavKit) -> str:
    """Without a deadline a command is `denied(no_deadline)`, and a beacon comes in the answer."""
    await kit.calm()
    if kit.secured is not None:
        raise NotTested("section 12 says nothing of a signed command without a deadline")
    message = kit.command(Arm(), deadline_ms=None)
    words, evidence = await kit.refused(message, "denied", "no_deadline")
    beacon = shapes.nested("beacon", (words.last or {}).get("beacon", []))
    expect(beacon.get("session") == kit.session, f"came {words} with the beacon {beacon or 'missing'}")
    return f"{evidence}; beacon {beacon}"


@rule("uav", "R4.7")
async def denies_a_deadline_too_far(kit: UavKit) -> str:
    """A deadline more than 60 s ahead is `denied(deadline_too_far)`."""
    await kit.calm()
    message = kit.command(Arm(), ttl_ms=_FAR_MS + 1000)
    return (await kit.refused(message, "denied", "deadline_too_far"))[1]


@rule("uav", "R4.6")
async def does_not_start_late(kit: UavKit) -> str:
    """A command whose deadline has passed is `expired`, and not written."""
    await kit.calm()
    message = kit.command(Arm(), deadline_ms=max(1, kit.deadline(0) - 300))
    return f"0.3 s past its deadline: {(await kit.refused(message, 'expired'))[1]}"


@rule("uav", "R5.10")
async def answers_a_query(kit: UavKit) -> str:
    """An id that it never saw, asked for after its deadline, is closed, and never executed afterwards."""
    await kit.calm()
    mark = len(kit.autopilot.written)
    question = kit.send(Arm(), deadline_ms=0)
    first = await kit.outcome(question)
    expect(first.names in (["expired"], ["unconfirmed"]), f"to the question came {first}")
    before = len(kit.tap.heard)
    kit.publish(kit.command(Arm(), gs_session=question.gs_session))
    again = await kit.outcome(question, mark=before)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "written although the id was closed")
    expect(again.names[:1] == first.names, f"to the question came {first}, to the command itself {again}")
    return f"to the question came {first}; to the same id in time {again}; nothing was written"


@rule("uav", "R5.2")
async def refuses_what_is_retained(kit: UavKit) -> str:
    """A command with RETAIN is `denied(retained)`."""
    await kit.calm()
    try:
        return (await kit.refused(kit.command(Arm()), "denied", "retained", retain=True))[1]
    finally:
        kit.publish_raw(b"", retain=True)


@rule("uav", "R5.3")
async def answers_a_duplicate(kit: UavKit) -> str:
    """The same bytes again are answered with the newest word, and not written again."""
    await kit.calm()
    message = kit.send(Arm())
    await kit.outcome(message)
    kit.autopilot.armed = False
    mark, before = len(kit.autopilot.written), len(kit.tap.heard)
    kit.publish(message)
    words = await kit.outcome(message, mark=before)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "a duplicate was written")
    expect(words.names == ["completed"], f"to the same bytes again came {words}")
    return f"to the same bytes again came {words}; nothing was written"


@rule("uav", "R5.3")
async def denies_an_id_conflict(kit: UavKit) -> str:
    """The same id with other contents is `denied(id_conflict)`."""
    await kit.calm()
    message = kit.send(Arm())
    await kit.outcome(message)
    mark, before = len(kit.autopilot.written), len(kit.tap.heard)
    kit.publish(kit.command(Disarm(), gs_session=message.gs_session))
    words = await kit.outcome(message, mark=before)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "written under an id that was another command's")
    reason = str(words.reason)
    expect(words.names == ["denied"] and reason.startswith("id_conflict"), f"arm, then disarm: came {words}")
    return f"arm, then disarm under the same id: came {words}; nothing was written"


@rule("uav", "R5.4")
async def keeps_the_order(kit: UavKit) -> str:
    """After it has started seq n of a station, or was sent a hold of that number, lower ones are `overtaken`."""
    await kit.calm()
    message = kit.send(Arm(), seq=5)
    await kit.outcome(message)
    await kit.calm()
    started = (await kit.refused(kit.command(gs_session=message.gs_session, seq=4), "overtaken"))[1]
    hold = kit.command(Hold(), seq=5, ttl_ms=90_000)
    await kit.refused(hold, "denied", "deadline_too_far")
    held = (await kit.refused(kit.command(gs_session=hold.gs_session, seq=4), "overtaken"))[1]
    return f"seq 4 after 5: {started}; after a hold that was denied: {held}"


@rule("uav", "R3.3")
async def refuses_what_is_malformed(kit: UavKit) -> str:
    """Unknown version, field, command or type, a missing field, a number out of range, NaN: denied, with a reason."""
    await kit.calm()
    mark = len(kit.autopilot.written)
    base = cbor2.loads(encode(kit.command(Arm())))
    broken = {
        "version 2": [2, *base[1:]],
        "an unknown command": [*base[:7], 99],
        "a field too many": [*base, 1],
        "a field too few": base[:7],
        "a text for the limit": [*base[:5], "soon", *base[6:]],
        "a limit of 0": [*base[:5], 0, *base[6:]],
        "takeoff to 20,000 m": [*base[:7], 3, 20_000_000],
        "a float for the deadline": [*base[:4], float(base[4] or 0), *base[5:]],
    }
    payloads = {name: cbor2.dumps([row[0], kit.command().gs_session, *row[2:]]) for name, row in broken.items()}
    with_nan = json.loads(encode(kit.command(Arm()), Encoding.JSON)) | {"command": "takeoff", "altitude_m": 1}
    payloads["NaN in JSON"] = json.dumps(with_nan).replace('"altitude_m": 1', '"altitude_m": NaN').encode()
    payloads["bytes behind the end"] = encode(kit.command(Arm())) + b"\x00"
    for name, payload in payloads.items():
        row = cbor2.loads(payload) if payload[:1] != b"{" else None
        gs_session = row[1] if row else with_nan["gs_session"]
        kit.publish_raw(payload)
        words = await kit.said(gs_session, 2)
        is_denied = words.names == ["denied"] and words.reason
        expect(is_denied, f"{name}: {shapes.shown(payload)}: came {words}, expected denied with a reason")
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "a malformed command was written")
    return f"denied with reasons: {', '.join(payloads)}"


@rule("uav", "R5.8")
async def denies_without_an_autopilot(kit: UavKit) -> str:
    """Without a heartbeat for 3 s a command is `denied(no_autopilot)`."""
    await kit.calm()
    kit.autopilot.silent = True
    await asyncio.sleep(3.4)
    try:
        return (await kit.refused(kit.command(Arm()), "denied", "no_autopilot"))[1]
    finally:
        await kit.calm()
        await asyncio.sleep(0.1)


@rule("uav", "R5.17")
async def limits_what_mavlink_may_do(kit: UavKit) -> str:
    """`mavlink` is denied for what has a command of its own, for termination, reboot, and unknown MAV_CMDs."""
    await kit.calm()
    said = []
    for mav_cmd, first in ((ARM, 1.0), (_VTOL_TAKEOFF, 0.0), (_TERMINATE, 1.0), (_REBOOT, 1.0), (_NO_MAV_CMD, 0.0)):
        before = len(kit.autopilot.written)
        words = await kit.outcome(kit.send(Mavlink(mav_cmd, (first, *[0.0] * 6))))
        written = [one for one in kit.autopilot.written[before:] if one.command == mav_cmd]
        expect(not written, f"mavlink({mav_cmd}) was written; came {words}")
        expect(words.names == ["denied"], f"mavlink({mav_cmd}): came {words}")
        said.append(f"{mav_cmd}: {words}")
    return "; ".join(said)
