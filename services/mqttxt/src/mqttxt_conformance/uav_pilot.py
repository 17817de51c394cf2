"""Rules of a UAV client about pilots, restarts and stalls: what it does not write, and what it does not believe."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.commands import Arm, Command, Land, Takeoff

from .autopilot import (
    ARM,
    HOLD_MODE,
    LAND,
    LAND_MODE,
    POSITION_MODE,
    REPOSITION,
    SET_MODE,
    TAKEOFF_MODE,
    Manner,
    Written,
)
from .registry import NotTested, expect, rule
from .uav_halting import NEAR, STALE_S
from .uav_kit import QUIET_S, SLACK_MS, TOLD_S, UavKit

_STALL_S = 1.3
_START_S = 0.6
"""How long the autopilot's start takes."""
_HEIGHT_M = 50
_MISSION_MODE = (4, 4)


def _after(written: list[Written]) -> str:
    return ", ".join(f"{one.command} after {one.at_ms - written[0].at_ms} ms" for one in written)


def _since(kit: UavKit, mark: int, shown_ms: int) -> list[Written]:
    """The flight commands written since `mark` that cannot have been under way when something was shown."""
    return [one for one in kit.autopilot.flights(mark) if one.at_ms > shown_ms + SLACK_MS]


@rule("uav", "R5.6", "R5.22")
async def does_not_repeat_behind_a_pilot(kit: UavKit) -> str:
    """What is not acknowledged is not written again once a heartbeat shows that somebody changed the mode."""
    await kit.fly()
    message, mark = await kit.unanswered(Land(), LAND)
    await kit.show(POSITION_MODE)
    shown_ms = kit.clock.now_ms()
    words = await kit.outcome(message)
    again = _since(kit, mark, shown_ms)
    expect(not again, f"land, not acknowledged, then POSITION: written {_after(kit.autopilot.flights(mark))}")
    expect(words.names == ["unconfirmed"], f"land, not acknowledged, then POSITION: came {words}")
    return f"land, not acknowledged, then POSITION: came {words}; not written again"


@rule("uav", "R5.6")
async def does_not_arm_again_what_showed(kit: UavKit) -> str:
    """An `arm` that a heartbeat has shown is not written again, because a pilot may have undone it."""
    await kit.calm()
    message, mark = await kit.unanswered(Arm(), ARM)
    await asyncio.sleep(0.25)
    kit.autopilot.armed = True
    await kit.show()
    shown_ms = kit.clock.now_ms()
    kit.autopilot.armed = False
    await kit.show()
    words = await kit.outcome(message)
    again = _since(kit, mark, shown_ms)
    expect(not again, f"arm, shown, then disarmed by a pilot: written {_after(kit.autopilot.flights(mark))}")
    expect(words.names == ["unconfirmed"], f"arm, shown, then disarmed by a pilot: came {words}")
    return f"arm, not acknowledged, shown, then disarmed by a pilot: came {words}; not written again"


@rule("uav", "R5.22")
async def denies_what_waits_behind_a_pilot(kit: UavKit) -> str:
    """A command that waits for its first write is `denied(mode_changed)` once a heartbeat shows a pilot's mode."""
    await kit.fly()
    kit.autopilot.manners[REPOSITION] = Manner(result=None)
    first = kit.send(NEAR, ttl_ms=700)
    await kit.outcome(first)
    kit.autopilot.manners.clear()
    mark = len(kit.autopilot.written)
    second = kit.send(NEAR, gs_session=first.gs_session, seq=2, ttl_ms=10_000)
    await asyncio.sleep(2 * TOLD_S)
    kit.expect_unwritten(mark, "a goto whose number rests was written")
    await kit.show(POSITION_MODE)
    words = await kit.outcome(second)
    await asyncio.sleep(QUIET_S)
    kit.expect_unwritten(mark, "goto waited, then POSITION: written")
    expect(words.names == ["denied"] and words.reason == "mode_changed", f"goto waited, then POSITION: came {words}")
    return f"goto waited, then POSITION: came {words}; nothing was written"


@rule("uav", "R5.22")
async def gives_the_mode_its_time(kit: UavKit) -> str:
    """The mode in which the autopilot accepted may still show for 3 s; then the command is `failed(mode_changed)`."""
    await kit.fly()
    await kit.show(POSITION_MODE)
    kit.autopilot.manners[LAND] = Manner(effect=False)
    message = await kit.accepted(Land())
    words = await kit.outcome(message)
    expect(words.names == ["accepted", "failed"] and words.reason == "mode_changed", f"LAND never showed: came {words}")
    took = words.at_ms[-1] - words.at_ms[0]
    expect(2500 < took < 4500, f"LAND never showed: failed {took} ms after accepted, expected 3000")
    return f"landing accepted, LAND never showed: came {words}, {took} ms after accepted"


@rule("uav", "R5.22")
async def tells_a_pilots_hold_from_a_climbs_end(kit: UavKit) -> str:
    """While a `takeoff` runs, a hold far below its height is a pilot's; one at its height is the autopilot's own."""
    said = []
    for height_m, names in ((20, ["accepted", "failed"]), (46, ["accepted"])):
        await kit.calm()
        kit.autopilot.armed = True
        await kit.show()
        message = await kit.accepted(Takeoff(_HEIGHT_M))
        kit.autopilot.landed, kit.autopilot.altitude_mm = 2, 1000 * height_m
        await kit.show(TAKEOFF_MODE)
        await asyncio.sleep(QUIET_S)
        await kit.show(HOLD_MODE)
        await asyncio.sleep(1.0)
        words = kit.words(message.gs_session)
        case = f"takeoff to {_HEIGHT_M} m, HOLD at {height_m} m"
        expect(words.names == names, f"{case}: came {words}, expected {', '.join(names)}")
        reason = (words.last or {}).get("reason", "mode_changed")
        expect(reason == "mode_changed", f"{case}: came {words}")
        said.append(f"{case}: {words}")
    kit.autopilot.altitude_mm = 1000 * _HEIGHT_M
    await kit.show()
    words = await kit.outcome(message)
    expect(words.names[-1:] == ["completed"], f"{case}, then at {_HEIGHT_M} m: came {words}")
    return f"{'; '.join(said)}, then at {_HEIGHT_M} m: {words}"


@rule("uav", "R5.22")
async def gives_the_landed_state_its_time(kit: UavKit) -> str:
    """While a `land` runs, a hold together with disarmed is the end of a landing; the landed state has 3 s."""
    await kit.fly()
    message = await kit.accepted(Land())
    await kit.show(LAND_MODE)
    await asyncio.sleep(QUIET_S)
    kit.autopilot.armed, kit.autopilot.altitude_mm = False, 0
    await kit.show(HOLD_MODE)
    await asyncio.sleep(1.0)
    words = kit.words(message.gs_session)
    expect(words.names == ["accepted"], f"disarmed in HOLD, landed state not yet there: came {words}")
    kit.autopilot.landed = 1
    await kit.show()
    words = await kit.outcome(message)
    expect(words.names == ["accepted", "completed"], f"disarmed in HOLD, on the ground 1 s later: came {words}")
    return f"disarmed in HOLD, on the ground 1 s later: came {words}"


@rule("uav", "R5.19")
async def denies_what_would_be_flown_later(kit: UavKit) -> str:
    """`takeoff` and `goto` are denied disarmed, and `goto` on the ground or without a landed state."""
    said = []
    cases: tuple[tuple[Command, bool, int, tuple[str, ...], str], ...] = (
        (Takeoff(_HEIGHT_M), False, 1, (), "disarmed"),
        (NEAR, False, 2, (), "disarmed"),
        (NEAR, True, 1, (), "on_ground"),
        (NEAR, True, 2, ("EXTENDED_SYS_STATE",), "landed_state_unknown"),
    )
    for command, armed, landed, withheld, reason in cases:
        await kit.calm()
        kit.autopilot.armed, kit.autopilot.landed = armed, landed
        kit.autopilot.withheld = frozenset(withheld)
        await kit.show()
        await asyncio.sleep(STALE_S if withheld else 0)
        await kit.refused(kit.command(command), "denied", reason)
        said.append(f"{command.name}: denied({reason})")
    return f"{'; '.join(said)}; nothing was written"


@rule("uav", "R5.19")
async def arms_in_hold(kit: UavKit) -> str:
    """`arm` in a mode in which a drone would fly off comes after hold; a pilot who changes the mode wins."""
    await kit.calm()
    await kit.show(_MISSION_MODE)
    mark = len(kit.autopilot.written)
    words = await kit.outcome(kit.send(Arm()))
    written = kit.autopilot.flights(mark)
    modes = [one.mode for one in written if one.command == SET_MODE]
    in_order = [one.command for one in written][-2:] == [SET_MODE, ARM] and modes[-1:] == [HOLD_MODE]
    expect(in_order, f"arm in MISSION: written {_after(written)}, modes {modes}, expected hold, then arm")
    expect(words.names == ["accepted", "completed"], f"arm in MISSION: came {words}")
    await kit.calm()
    kit.autopilot.manners[SET_MODE] = Manner(effect=False)
    await kit.show(_MISSION_MODE)
    mark = len(kit.autopilot.written)
    second = kit.send(Arm())
    await kit.written(mark, SET_MODE)
    await kit.show(POSITION_MODE)
    then = await kit.outcome(second)
    armed = kit.autopilot.flights(mark, ARM)
    expect(not armed, f"arm in MISSION, then POSITION: arm was written; came {then}")
    expect(then.names == ["failed"], f"arm in MISSION, then POSITION: came {then}")
    return f"arm in MISSION: hold, then arm, {words}; with POSITION in between: {then}, arm was not written"


@rule("uav", "R5.26")
async def believes_no_effect_of_a_restart(kit: UavKit) -> str:
    """An autopilot that starts anew in the air says that it has landed: the word is not `completed`."""
    await kit.fly()
    message = await kit.accepted(Land())
    await kit.show(LAND_MODE)
    await asyncio.sleep(QUIET_S)
    kit.autopilot.silent = True
    await asyncio.sleep(_START_S)
    kit.autopilot.boot()
    await kit.show()
    words = await kit.outcome(message)
    is_so = words.names == ["accepted", "unconfirmed"] and words.reason == "autopilot_restarted"
    expect(is_so, f"landing, then the autopilot's start, disarmed on the ground: came {words}")
    return f"landing, then the autopilot's start, disarmed on the ground: came {words}"


@rule("uav", "R5.15")
async def repeats_nothing_after_a_stall(kit: UavKit) -> str:
    """After its process stood still, what waited in its socket is not used, and nothing is written again."""
    kit.subject.need()
    await kit.calm()
    message, mark = await kit.unanswered(Arm(), ARM)
    with kit.subject.stopped():
        kit.autopilot.acknowledge(ARM, 0)
        await asyncio.sleep(QUIET_S)
        before = len(kit.autopilot.written)
        await asyncio.sleep(_STALL_S - QUIET_S)
        since = len(kit.autopilot.written)
        if since > before:
            raise NotTested("SIGSTOP does not stop it; --run has to start it itself, without a program around it")
    words = await kit.outcome(message)
    again = kit.autopilot.flights(since)
    expect(not again, f"after {_STALL_S:g} s of standstill: written {_after(kit.autopilot.flights(mark))}")
    expect(words.names == ["unconfirmed"], f"its acknowledgement came in {_STALL_S:g} s of standstill: came {words}")
    return f"{_STALL_S:g} s of standstill, in which the acknowledgement came: came {words}; not written again"
