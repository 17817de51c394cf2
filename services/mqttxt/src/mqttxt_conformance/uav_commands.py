"""Rules of a UAV client about commands: what it writes to the autopilot, and which words it publishes."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Hold, Land, Stream
from mqttxt.protocol.values import Encoding

from . import shapes
from .autopilot import ARM, LAND, LAND_MODE, POSITION_MODE, SET_MODE, Manner
from .registry import expect, rule
from .uav_kit import QUIET_S, UavKit


@rule("uav", "R5.8", "R3.4")
async def executes_a_command(kit: UavKit) -> str:
    """A command in time is written once, to system Y, component 1; the first word is accepted, the last completed."""
    await kit.calm()
    mark = len(kit.autopilot.written)
    message = kit.send(Arm())
    words = await kit.outcome(message)
    written = kit.autopilot.flights(mark)
    expect(len(written) == 1, f"{len(written)} writes; words: {words}")
    sent = written[0].message
    target = (sent.target_system, sent.target_component)
    expect(target == (kit.drone, 1), f"written to system and component {target}, expected {(kit.drone, 1)}")
    params = (sent.param1, sent.param2)
    expect(written[0].command == ARM and params == (1, 0), f"arm was written as {sent}")
    expect(words.names == ["accepted", "completed"], f"expected accepted, completed; came {words}")
    expect(all(word["session"] == kit.session for word in words.words), f"a word of another session: {words.words}")
    topics = {word["topic"] for word in words.words}
    expect(topics == {"arm"}, f"words on commands_result/{', '.join(topics)}, expected commands_result/arm")
    return f"{sent.get_type()} {ARM} once to {target}; came {words}"


@rule("uav", "R3.1")
async def takes_json(kit: UavKit) -> str:
    """A command in JSON does what it does in CBOR."""
    await kit.calm()
    message = kit.command(Arm())
    kit.publish(message, encoding=Encoding.JSON)
    words = await kit.outcome(message)
    expect(words.names[-1:] == ["completed"], f"{shapes.shown(encode(message, Encoding.JSON))}: came {words}")
    return f"{shapes.shown(encode(message, Encoding.JSON))}: came {words}"


@rule("uav", "R5.8")
async def completes_by_the_effect(kit: UavKit) -> str:
    """`completed` comes with the effect, not with the acknowledgement."""
    await kit.calm()
    kit.autopilot.manners[ARM] = Manner(effect=False)
    message = await kit.accepted(Arm())
    await asyncio.sleep(QUIET_S)
    words = kit.words(message.gs_session)
    expect(words.names == ["accepted"], f"before the effect came {words}")
    kit.autopilot.armed = True
    kit.autopilot.tell()
    words = await kit.outcome(message)
    expect(words.names == ["accepted", "completed"], f"after the effect came {words}")
    return f"accepted; {QUIET_S:g} s without effect: silence; then {words.names[-1]}"


@rule("uav", "R4.6", "R5.6")
async def does_not_repeat_late(kit: UavKit) -> str:
    """Nothing is written after the deadline, repetitions included."""
    await kit.calm()
    kit.autopilot.manners[ARM] = Manner(result=None)
    mark = len(kit.autopilot.written)
    message = kit.send(Arm(), ttl_ms=700)
    words = await kit.outcome(message, 8)
    written = kit.autopilot.flights(mark)
    assert message.deadline_ms is not None
    late = [one for one in written if kit.read_late(one.at_ms, message.deadline_ms)]
    expect(written, f"ttl 0.7 s, not acknowledged: nothing was written; came {words}")
    times = [one.at_ms - written[0].at_ms for one in written]
    expect(not late, f"ttl 0.7 s, not acknowledged: written after {times} ms")
    expect(words.last, "no last word")
    return f"ttl 0.7 s, not acknowledged: written after {times} ms; came {words}"


@rule("uav", "R5.6")
async def repeats_in_measure(kit: UavKit) -> str:
    """What is not acknowledged is written up to 4 times, 0.5 s apart; then the MAV_CMD rests for 3 s."""
    await kit.calm()
    kit.autopilot.manners[ARM] = Manner(result=None)
    mark = len(kit.autopilot.written)
    message = kit.send(Arm(), ttl_ms=20_000)
    words = await kit.outcome(message, 10)
    closed_ms = words.at_ms[-1] if words.at_ms else kit.clock.now_ms()
    written = kit.autopilot.flights(mark, ARM)
    after = [one.at_ms - written[0].at_ms for one in written]
    expect(1 <= len(written) <= 4, f"written {len(written)} times, after {after} ms")
    expect(all(ms > 500 * n - 150 for n, ms in enumerate(after)), f"written after {after} ms, expected every 500")
    expect(words.names == ["unconfirmed"], f"never acknowledged: came {words}")
    kit.autopilot.manners.clear()
    second = kit.send(Arm(), gs_session=message.gs_session, seq=2, ttl_ms=10_000)
    again = await kit.written(len(kit.autopilot.written), ARM, 6)
    expect(again, f"a second arm, after the first one's time-out: not written; came {await kit.outcome(second)}")
    rested = again[0].at_ms - closed_ms
    expect(rested > 2500, f"after the time-out the number rested for {rested} ms, expected 3000")
    await kit.outcome(second)
    return f"written {len(written)} times, after {after} ms; came {words}; the number rested for {rested} ms"


@rule("uav", "R5.6")
async def counts_only_its_own_acknowledgement(kit: UavKit) -> str:
    """An acknowledgement for somebody else, or of another component, is not this command's."""
    await kit.calm()
    message, _ = await kit.unanswered(Arm(), ARM)
    kit.autopilot.acknowledge(ARM, 2, to=(255, 190))
    kit.autopilot.acknowledge(ARM, 2, component=154)
    kit.autopilot.acknowledge(SET_MODE, 2)
    await asyncio.sleep(QUIET_S)
    words = kit.words(message.gs_session)
    expect(not words.words, f"after refusals of others' commands came {words}")
    kit.autopilot.manners.clear()
    words = await kit.outcome(message)
    expect(words.names[-1:] == ["completed"], f"then, with its own acknowledgement, came {words}")
    return f"refusals to 255/190, of component 154 and of MAV_CMD {SET_MODE} were ignored; then {words}"


@rule("uav", "R5.6", "R5.9")
async def passes_on_the_result(kit: UavKit) -> str:
    """What the autopilot refuses is `denied`, `unsupported` or `failed`; IN_PROGRESS is `in_progress(percent)`."""
    await kit.calm()
    said = []
    for result, expected in ((1, "denied"), (2, "denied"), (3, "unsupported"), (4, "failed")):
        kit.autopilot.manners[ARM] = Manner(result=result)
        message = kit.send(Arm())
        words = await kit.outcome(message)
        expect(words.names == [expected], f"MAV_RESULT {result}: expected {expected}, came {words}")
        said.append(f"{result}: {words}")
    kit.autopilot.manners[ARM] = Manner(progress=40)
    message = kit.send(Arm())
    words = await kit.outcome(message)
    percent = words.words[0].get("percent") if words.words else None
    expect(words.names[:1] == ["in_progress"] and percent == 40, f"IN_PROGRESS 40: came {words}, percent {percent}")
    return f"MAV_RESULT {'; '.join(said)}; 5 with 40: {words}"


@rule("uav", "R5.6")
async def takes_no_refusal_of_one_copy(kit: UavKit) -> str:
    """A refusal of one copy is no definite no while another one is unanswered: `unconfirmed(refused_once)`."""
    await kit.fly()
    message, mark = await kit.unanswered(Land(), LAND)
    kit.autopilot.manners[LAND] = Manner(result=2)
    words = await kit.outcome(message)
    copies = len(kit.autopilot.flights(mark, LAND))
    expect(copies == 2, f"land, the first copy unanswered, the second refused: written {copies} times; came {words}")
    is_so = words.names == ["unconfirmed"] and words.reason == "refused_once"
    expect(is_so, f"land, the first copy unanswered, the second refused: came {words}")
    return f"land, the first copy unanswered, the second refused: came {words}; not written again"


@rule("uav", "R4.8")
async def ends_at_the_limit(kit: UavKit) -> str:
    """A command that has not had its effect within its limit is `failed(timeout)`."""
    await kit.calm()
    kit.autopilot.manners[ARM] = Manner(effect=False)
    words = await kit.outcome(kit.send(Arm(), limit_s=1.0))
    expect(words.names == ["accepted", "failed"] and words.reason == "timeout", f"limit 1 s: came {words}")
    took = words.at_ms[-1] - words.at_ms[0]
    expect(took > 600, f"limit 1 s: failed after {took} ms")
    return f"limit 1 s: came {words}, {took} ms after accepted"


@rule("uav", "R5.9")
async def lets_a_pilot_win(kit: UavKit) -> str:
    """A mode that nobody here commanded ends a running command as `failed(mode_changed)`."""
    await kit.calm()
    kit.autopilot.armed, kit.autopilot.landed = True, 2
    mark = len(kit.autopilot.written)
    message = await kit.accepted(Land())
    kit.autopilot.mode = LAND_MODE
    kit.autopilot.tell()
    await asyncio.sleep(QUIET_S)
    kit.autopilot.mode = POSITION_MODE
    kit.autopilot.tell()
    words = await kit.outcome(message)
    expect(
        words.names == ["accepted", "failed"] and words.reason == "mode_changed",
        f"landing, then POSITION: came {words}",
    )
    await asyncio.sleep(QUIET_S)
    others = [one.command for one in kit.autopilot.flights(mark) if one.command != LAND]
    expect(not others, f"after the pilot's change were written MAV_CMDs {others}")
    return f"landing, then POSITION: came {words}; nothing more was written"


@rule("uav", "R5.9")
async def lets_the_newer_command_win(kit: UavKit) -> str:
    """A newer command of the same kind takes the place of a running one: `superseded(by)`."""
    await kit.calm()
    kit.autopilot.armed, kit.autopilot.landed = True, 2
    older = await kit.accepted(Land())
    newer = kit.send(Hold(), gs_session=older.gs_session, seq=2)
    said, then = await kit.outcome(older), await kit.outcome(newer)
    by = shapes.nested("result", (said.last or {}).get("by", []))
    expect(said.names[-1:] == ["superseded"], f"land, then hold: of land came {said}")
    named = [*by.values()] == [older.gs_session, 2]
    expect(named, f"superseded by {by}, expected [{older.gs_session}, 2]")
    expect(then.names[-1:] == ["completed"], f"land, then hold: of hold came {then}")
    return f"land, then hold: {said}; {then}"


@rule("uav", "R5.16")
async def streams_at_a_rate(kit: UavKit) -> str:
    """`stream` publishes a state at a fixed rate although it does not change, and rate 0 ends that."""
    await kit.calm()
    topic = kit.topics.state(kit.drone, "location")

    def positions() -> int:
        return sum(heard.topic == topic for heard, _ in kit.states)

    message = kit.command(Stream("location", 2.0))
    before = positions()
    kit.publish(message)
    words = await kit.outcome(message)
    await asyncio.sleep(2.0)
    came = positions() - before
    ended = await kit.outcome(kit.send(Stream("location", 0.0), gs_session=message.gs_session, seq=2))
    await asyncio.sleep(QUIET_S)
    before = positions()
    await asyncio.sleep(1.2)
    after = positions() - before
    expect(words.names[-1:] == ["completed"], f"stream(location, 2 Hz): came {words}")
    expect(3 <= came <= 7, f"2 Hz for about 2 s, standing still: {came} positions")
    expect(ended.names[-1:] == ["completed"] and after == 0, f"rate 0: came {ended}, then {after} positions in 1.2 s")
    return f"2 Hz for about 2 s: {came} positions; rate 0: none in 1.2 s"
