"""Rules of a UAV client about what brings a drone to a halt: it never waits, and needs no heartbeat."""

from __future__ import annotations

import asyncio
from functools import partial

from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold, Land

from .autopilot import ARM, HOME, LAND, REPOSITION, SET_MODE, Manner, Written
from .registry import expect, rule
from .uav_kit import UavKit

NEAR = Goto(HOME[0] / 1e7 + 0.001, HOME[1] / 1e7, 30.0)
STALE_S = 3.4
"""After this time without it, a heartbeat or a landed state does not count any longer."""
_HALTING = (192, 193, 194)
"""The components in whose name a hold is written."""
_AT_ONCE_MS = 400


@rule("uav", "R5.6")
async def lets_no_hold_wait(kit: UavKit) -> str:
    """A `hold` is written at once, in the name of a component of its own, behind a goto and behind another hold."""
    await kit.fly()
    kit.autopilot.manners[SET_MODE] = Manner(result=None)
    goto, mark = await kit.unanswered(NEAR, REPOSITION)
    expect(kit.autopilot.flights(mark, REPOSITION), "goto was not written")
    used: list[int] = []
    for seq in (2, 3):
        mark, asked_ms = len(kit.autopilot.written), kit.clock.now_ms()
        hold = kit.send(Hold(), gs_session=goto.gs_session, seq=seq)
        await kit.tap.until(partial(_holds, kit, mark, tuple(used)), 3.0)
        found = _holds(kit, mark, tuple(used))
        expect(found, f"hold number {seq - 1}: not written in the name of one of {_HALTING} that waits for nothing")
        took = found[0].at_ms - asked_ms
        expect(took <= _AT_ONCE_MS, f"hold number {seq - 1}, behind what is not acknowledged: written after {took} ms")
        used.append(found[0].message.get_srcComponent())
    kit.autopilot.manners.clear()
    words = await kit.outcome(hold)
    expect(words.names[-1:] == ["completed"], f"the second hold: came {words}")
    return f"behind a goto, and behind that: written at once by components {used}; came {words}"


def _holds(kit: UavKit, mark: int, used: tuple[int, ...]) -> list[Written]:
    """The holds that were written since `mark` by other components than `used`."""
    return [one for one in kit.autopilot.flights(mark) if one.message.get_srcComponent() in set(_HALTING) - set(used)]


@rule("uav", "R5.6")
async def lets_no_disarm_wait(kit: UavKit) -> str:
    """A `disarm` is written at once behind an `arm` without acknowledgement, in the name of another component."""
    await kit.calm()
    arm, mark = await kit.unanswered(Arm(), ARM)
    armed_by = {one.message.get_srcComponent() for one in kit.autopilot.flights(mark, ARM)}
    expect(armed_by, "arm was not written")
    mark, asked_ms = len(kit.autopilot.written), kit.clock.now_ms()
    disarm = kit.send(Disarm(), gs_session=arm.gs_session, seq=2)
    await kit.tap.until(partial(_disarms, kit, mark), 3.0)
    found = _disarms(kit, mark)
    expect(found, "disarm, behind an arm without acknowledgement: not written within 3 s")
    took, component = found[0].at_ms - asked_ms, found[0].message.get_srcComponent()
    expect(took <= _AT_ONCE_MS, f"disarm, behind an arm without acknowledgement: written after {took} ms")
    expect(component not in armed_by, f"arm and disarm were both written in the name of component {component}")
    kit.autopilot.manners.clear()
    words = await kit.outcome(disarm)
    return f"behind an arm of component {armed_by.pop()}: written by {component} after {took} ms; came {words}"


def _disarms(kit: UavKit, mark: int) -> list[Written]:
    return [one for one in kit.autopilot.flights(mark, ARM) if one.message.param1 == 0]


@rule("uav", "R5.8")
async def holds_by_where_it_is(kit: UavKit) -> str:
    """`hold` is DO_SET_MODE disarmed and on the ground, DO_REPOSITION in the air, or where no landed state came."""
    said = []
    for what, armed, landed, withheld, expected in (
        ("disarmed", False, 1, (), SET_MODE),
        ("armed on the ground", True, 1, (), SET_MODE),
        ("in the air", True, 2, (), REPOSITION),
        ("armed, no landed state for 3 s", True, 1, ("EXTENDED_SYS_STATE",), REPOSITION),
    ):
        await kit.calm()
        kit.autopilot.armed, kit.autopilot.landed = armed, landed
        kit.autopilot.withheld = frozenset(withheld)
        await kit.show()
        await asyncio.sleep(STALE_S if withheld else 0)
        mark = len(kit.autopilot.written)
        message = kit.send(Hold())
        await kit.tap.until(partial(kit.autopilot.flights, mark), 3.0)
        numbers = [one.command for one in kit.autopilot.flights(mark)]
        await kit.outcome(message)
        expect(numbers[:1] == [expected], f"{what}: hold was written as MAV_CMD {numbers}, expected {expected}")
        said.append(f"{what}: {expected}")
    return "; ".join(said)


@rule("uav", "R5.8")
async def halts_without_a_heartbeat(kit: UavKit) -> str:
    """Without a heartbeat for 3 s, but other messages, `land` is written, and what does not halt is denied."""
    await kit.fly()
    kit.autopilot.withheld = frozenset({"HEARTBEAT"})
    await asyncio.sleep(STALE_S)
    refused = await kit.refused(kit.command(Disarm()), "denied", "no_autopilot")
    mark = len(kit.autopilot.written)
    message = kit.send(Land())
    written = await kit.written(mark, LAND)
    said = kit.words(message.gs_session)
    await kit.calm()
    await kit.outcome(message)
    expect(written, f"land was not written; came {said}")
    return f"disarm: {refused[1]}; land: written"
