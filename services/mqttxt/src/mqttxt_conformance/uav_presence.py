"""Rules of a UAV client about its presence, session and end; most need an implementation that the kit starts."""

from __future__ import annotations

import asyncio
import secrets
from functools import partial

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import Presence

from . import shapes
from .autopilot import ARM, Manner
from .registry import expect, rule
from .tap import Heard
from .uav_kit import PATIENCE_S, QUIET_S, UavKit


def _presences(kit: UavKit, mark: int, without: bytes = b"") -> list[dict[str, object]]:
    topic = kit.topics.reachable(kit.drone)
    said = [heard.payload for heard in kit.tap.since(mark, topic) if heard.payload not in (b"", without)]
    return [shapes.read("presence", payload) for payload in said]


@rule("uav", "R9.1")
async def birth_carries_the_session(kit: UavKit) -> str:
    """The birth on droneY/reachable is retained and carries the session that the beacons name."""
    birth: Heard = kit.births[-1]
    expect(birth.retain, f"{birth.topic} {shapes.shown(birth.payload)} is not retained")
    expect(birth.qos == 1, f"{birth.topic} came at QoS {birth.qos}, expected 1")
    sessions = {beacon["session"] for at_ms, beacon in kit.beacons if at_ms >= birth.at_ms}
    expect(sessions == {kit.session}, f"birth of session {kit.session}, beacons of {sessions}")
    return f"{shapes.shown(birth.payload)}, retained; beacons of the same session"


@rule("uav", "R4.2")
async def echoes_the_nonce(kit: UavKit) -> str:
    """A lease for its session is answered with a beacon that has the nonce and how long it waited."""
    beacon = await kit.echo()
    expect(beacon is not None, f"no beacon with the lease's nonce within {PATIENCE_S:g} s")
    assert beacon is not None
    expect("held_ms" in beacon, f"beacon {beacon}: held_ms is missing")
    return f"beacon {beacon}"


@rule("uav", "R9.5")
async def leaves_other_sessions_leases_alone(kit: UavKit) -> str:
    """A lease for another session of its number is not answered."""
    nonce = kit.lease(drone_session=kit.session % (2**32 - 1) + 1)
    await asyncio.sleep(QUIET_S)
    echoed = [beacon for _, beacon in kit.beacons if beacon.get("nonce") == nonce]
    expect(not echoed, f"the nonce of another session's lease came back: {echoed}")
    return f"nonce {nonce} did not come back within {QUIET_S:g} s"


@rule("uav", "R9.1")
async def watches_its_retained_topic(kit: UavKit) -> str:
    """When its topic shows another session, or `down`, it publishes its birth again."""
    topic = kit.topics.reachable(kit.drone)
    said = []
    for what, presence in (
        ("another session's down", Presence(session=secrets.randbelow(2**32 - 1) + 1, up=False)),
        ("its own down", Presence(session=kit.session, up=False)),
    ):
        mark = len(kit.tap.heard)
        shown = encode(presence)
        if kit.secured is not None:
            kit.secured.speech.own.add(shown)
        kit.twin.publish(topic, shown, retain=True)
        put_right = await kit.tap.until(partial(_presences, kit, mark, shown), PATIENCE_S)
        expect(put_right, f"{topic} showed {what} for {PATIENCE_S:g} s")
        own = put_right[-1]["session"] == kit.session and put_right[-1]["up"] is True
        expect(own, f"after {what} came {put_right[-1]}")
        said.append(what)
    return f"birth again after {' and after '.join(said)}"


@rule("uav", "R9.1")
async def will_carries_the_session(kit: UavKit) -> str:
    """Killed, its will says `down` with its session."""
    kit.subject.need()
    await kit.calm()
    kit.autopilot.manners[ARM] = Manner(effect=False)
    kit.open_command = kit.command(Arm(), ttl_ms=2500, limit_s=60.0)
    kit.publish(kit.open_command)
    await kit.word(kit.open_command, "accepted")
    mark = len(kit.tap.heard)
    await kit.subject.kill()
    wills = await kit.tap.until(lambda: _presences(kit, mark), PATIENCE_S)
    expect(wills, f"no will within {PATIENCE_S:g} s of SIGKILL")
    is_own = wills[0]["session"] == kit.session and wills[0]["up"] is False
    expect(is_own, f"will {wills[0]}, expected session {kit.session}, down")
    return f"will {wills[0]}"


@rule("uav", "R5.5", "R4.1")
async def closes_what_a_crash_left_open(kit: UavKit) -> str:
    """Restarted, it has a new session; what was open is `unconfirmed`, and never executed again."""
    kit.subject.need()
    await kit.subject.kill()
    await kit.calm()
    before = kit.session
    mark = len(kit.autopilot.written)
    heard = len(kit.tap.heard)
    await kit.subject.start()
    await kit.meet(heard)
    expect(kit.session != before, f"session {before} again after a restart")
    left = kit.open_command
    if left is None:
        return f"sessions {before}, then {kit.session}; no command was open"
    kit.publish(left)
    words = await kit.outcome(left, mark=heard)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "a command of the session before was written")
    expect(words.names[-1:] == ["unconfirmed"], f"arm was accepted before the crash; after it came {words}")
    return f"sessions {before}, then {kit.session}; of the open arm came {words}"


@rule("uav", "R9.3")
async def a_clean_stop_says_down(kit: UavKit) -> str:
    """At a clean stop it publishes `down` itself, with its session."""
    kit.subject.need()
    mark = len(kit.tap.heard)
    kit.subject.terminate()
    code = await kit.subject.ended()
    said = await kit.tap.until(lambda: _presences(kit, mark), PATIENCE_S)
    expect(code == 0, f"SIGTERM: exit code {code}, expected 0")
    is_down = bool(said) and said[-1]["session"] == kit.session and said[-1]["up"] is False
    expect(is_down, f"SIGTERM: came {said or 'nothing'} on droneY/reachable")
    return f"SIGTERM: {said[-1]}, exit code {code}"


@rule("uav", "R9.5")
async def stops_when_refused(kit: UavKit) -> str:
    """After `bound: false` it stops."""
    kit.subject.need()
    await kit.calm()
    await kit.subject.kill()
    mark = len(kit.tap.heard)
    await kit.subject.start()
    await kit.meet(mark)
    kit.lease(bound=False)
    code = await kit.subject.ended(PATIENCE_S)
    expect(code is not None, f"goes on {PATIENCE_S:g} s after it was told that it is refused")
    return f"ended with {kit.subject.ending}"


@rule("uav", "R5.7")
async def does_not_start_at_another_system(kit: UavKit) -> str:
    """It does not start when its autopilot's system id is not Y."""
    kit.subject.need()
    await kit.subject.kill()
    mark, written = len(kit.tap.heard), len(kit.autopilot.written)
    kit.autopilot.system = kit.drone % 250 + 1
    await kit.subject.start()
    code = await kit.subject.ended()
    births = [presence for presence in _presences(kit, mark) if presence["up"]]
    expect(not births, f"the autopilot's system id is {kit.autopilot.system}: born all the same, {births}")
    flown = kit.autopilot.flights(written)
    expect(not flown, "it wrote commands to another system")
    how = f"ended with {kit.subject.ending}" if code is not None else "not born within 10 s"
    return f"autopilot with system id {kit.autopilot.system}: {how}"
