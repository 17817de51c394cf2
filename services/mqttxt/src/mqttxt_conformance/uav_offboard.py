"""Rules of a UAV client about offboard: whom it flies for, how it ends, and that a pilot wins."""

from __future__ import annotations

import asyncio
from itertools import pairwise

from mqttxt.protocol.commands import Offboard, Velocity
from mqttxt.protocol.messages import CommandMessage

from .autopilot import HOLD_MODE, OFFBOARD_MODE, POSITION_MODE, SET_MODE, Manner
from .registry import expect, rule
from .uav_kit import PATIENCE_S, QUIET_S, SLACK_MS, UavKit

_SET_POINT = "SET_POSITION_TARGET_LOCAL_NED"
_HOLDER = 77
_LEASE_MS = 20_000
_HOLD_AGAIN_MS = 500


@rule("uav", "R5.13")
async def denies_offboard_without_control(kit: UavKit) -> str:
    """Offboard without a control lease is `denied(no_lease)`, and no set-point is written."""
    await kit.calm()
    await kit.echo()
    mark = len(kit.autopilot.written)
    message = kit.command(Offboard(1.0, Velocity(1, 0, 0)))
    kit.leads = False
    evidence = (await kit.refused(message, "denied", "no_lease" if kit.secured is None else "not_in_control"))[1]
    kit.leads = True
    points = kit.autopilot.of_type(mark, _SET_POINT)
    expect(not points, f"{len(points)} set-points were written")
    return evidence


@rule("uav", "R5.13", "R5.14")
async def offboard_streams_and_ends_in_hold(kit: UavKit) -> str:
    """Offboard streams set-points before the mode, goes on for its duration, commands hold, and is completed."""
    await kit.calm()
    kit.autopilot.armed, kit.autopilot.landed = True, 2
    kit.autopilot.tell()
    until_ms = kit.deadline(9000)
    await kit.echo(holder_session=_HOLDER, deadline_ms=until_ms, offboard_until_ms=kit.deadline(3000))
    mark = len(kit.autopilot.written)
    words = await kit.outcome(kit.send(Offboard(1.0, Velocity(1, 0, 0)), gs_session=_HOLDER, seq=1), 8)
    modes = kit.autopilot.flights(mark, SET_MODE)
    asked = [one.mode for one in modes]
    points = kit.autopilot.of_type(mark, _SET_POINT)
    first = sum(one.at_ms <= modes[0].at_ms for one in points) if modes else 0
    expect(words.names[-1:] == ["completed"], f"duration 1 s: came {words}")
    expect(first >= 10, f"{first} set-points before the mode, expected 10")
    ended = asked[:1] == [OFFBOARD_MODE] and asked[-1] == HOLD_MODE
    expect(ended, f"modes commanded: {asked}, expected {OFFBOARD_MODE} first and {HOLD_MODE} last")
    during = len(points) - first
    expect(during >= 10, f"{during} set-points in 1 s after the mode, expected about 20")
    return f"{first} set-points, OFFBOARD, {during} set-points, HOLD; came {words}"


@rule("uav", "R5.14")
async def offboard_ends_with_the_lease(kit: UavKit) -> str:
    """When the lease ends, an offboard command ends in hold as `failed(lease_lost)`."""
    await kit.calm()
    kit.autopilot.armed, kit.autopilot.landed = True, 2
    kit.autopilot.tell()
    lease_ms = kit.deadline(2500)
    await kit.echo(holder_session=_HOLDER, deadline_ms=lease_ms, offboard_until_ms=lease_ms)
    mark = len(kit.autopilot.written)
    words = await kit.outcome(kit.send(Offboard(60.0, Velocity(1, 0, 0)), limit_s=90.0, gs_session=_HOLDER, seq=2), 10)
    modes = [one.mode for one in kit.autopilot.flights(mark, SET_MODE)]
    expect(words.reason == "lease_lost", f"60 s of offboard with a lease of 2.5 s: came {words}")
    expect(modes[-1:] == [HOLD_MODE], f"modes commanded: {modes}, expected {HOLD_MODE} last")
    await asyncio.sleep(QUIET_S)
    mark = len(kit.autopilot.written)
    await asyncio.sleep(QUIET_S)
    points = kit.autopilot.of_type(mark, _SET_POINT)
    expect(not points, f"{len(points)} set-points after the last word")
    return f"60 s of offboard with a lease of 2.5 s: came {words}; HOLD; no set-point afterwards"


async def _begin(kit: UavKit, duration_s: float, manner: Manner | None = None) -> tuple[CommandMessage, int]:
    """Give a new station control of a drone in the air, and send its offboard; returns that, and the mark before it.

    `manner` is how the autopilot reacts to the mode.
    """
    await kit.fly()
    kit.autopilot.manners[SET_MODE] = manner or Manner()
    message = kit.command(Offboard(duration_s, Velocity(1, 0, 0)), limit_s=duration_s + 30)
    until_ms = kit.deadline(_LEASE_MS)
    await kit.echo(holder_session=message.gs_session, deadline_ms=until_ms, offboard_until_ms=until_ms)
    mark = len(kit.autopilot.written)
    kit.publish(message)
    return message, mark


@rule("uav", "R5.14", "R5.15")
async def offboard_gives_way_to_a_pilot(kit: UavKit) -> str:
    """When a pilot leaves offboard, the set-points stop at once, and hold is not commanded: `failed(mode_changed)`."""
    message, mark = await _begin(kit, 30)
    await kit.word(message, "accepted")
    await asyncio.sleep(QUIET_S)
    await kit.show(POSITION_MODE)
    words = await kit.outcome(message)
    ended = len(kit.autopilot.written)
    await asyncio.sleep(2 * _HOLD_AGAIN_MS / 1000)
    modes, points = (
        [one.mode for one in kit.autopilot.flights(mark, SET_MODE)],
        kit.autopilot.of_type(ended, _SET_POINT),
    )
    expect(
        words.names == ["accepted", "failed"] and words.reason == "mode_changed", f"OFFBOARD, POSITION: came {words}"
    )
    expect(modes == [OFFBOARD_MODE], f"OFFBOARD, then POSITION by a pilot: modes commanded: {modes}")
    expect(len(points) <= 1, f"{len(points)} set-points after the last word")
    return f"OFFBOARD, then POSITION by a pilot: came {words}; hold was not commanded, no set-point afterwards"


@rule("uav", "R5.14")
async def offboard_takes_nothing_from_a_pilot(kit: UavKit) -> str:
    """Where a pilot's mode shows before the acknowledgement, the mode is not commanded again, and hold is not."""
    message, mark = await _begin(kit, 30, Manner(result=None))
    await kit.written(mark, SET_MODE)
    await kit.show(POSITION_MODE)
    words = await kit.outcome(message)
    await asyncio.sleep(2 * _HOLD_AGAIN_MS / 1000)
    modes = [one.mode for one in kit.autopilot.flights(mark, SET_MODE)]
    expect(modes == [OFFBOARD_MODE], f"not acknowledged, then POSITION by a pilot: modes commanded: {modes}")
    expect(words.names == ["unconfirmed"], f"not acknowledged, then POSITION by a pilot: came {words}")
    return f"not acknowledged, then POSITION by a pilot: came {words}; neither offboard again nor hold was commanded"


@rule("uav", "R5.14")
async def offboard_commands_hold_until_it_shows(kit: UavKit) -> str:
    """At its end hold is commanded every 0.5 s, with set-points at a standstill, for 3 s; then `failed(no_hold)`."""
    message, mark = await _begin(kit, 1)
    await kit.word(message, "accepted")
    kit.autopilot.manners[SET_MODE] = Manner(effect=False)
    words = await kit.outcome(message, 2 * PATIENCE_S)
    ended = len(kit.autopilot.written)
    holds = [one for one in kit.autopilot.flights(mark, SET_MODE) if one.mode == HOLD_MODE]
    expect(words.names == ["accepted", "failed"] and words.reason == "no_hold", f"hold never showed: came {words}")
    gaps = [later.at_ms - earlier.at_ms for earlier, later in pairwise(holds)]
    expect(4 <= len(holds) <= 8, f"hold never showed: commanded {len(holds)} times, {gaps} ms apart")
    braking = [one for one in kit.autopilot.of_type(mark, _SET_POINT) if one.at_ms > holds[0].at_ms + SLACK_MS]
    moving = [one for one in braking if (one.message.vx, one.message.vy, one.message.vz) != (0, 0, 0)]
    expect(braking and not moving, f"{len(moving)} of {len(braking)} set-points behind the end with a velocity")
    await asyncio.sleep(QUIET_S)
    points = kit.autopilot.of_type(ended, _SET_POINT)
    expect(len(points) <= 1, f"{len(points)} set-points after the last word")
    return f"hold never showed: commanded {len(holds)} times, {gaps} ms apart, {len(braking)} set-points; came {words}"


@rule("uav", "R5.14")
async def a_clean_stop_ends_offboard(kit: UavKit) -> str:
    """A clean stop during offboard commands hold before the process ends, and no set-point comes after it."""
    kit.subject.need()
    message, mark = await _begin(kit, 30)
    words = await kit.word(message, "accepted")
    kit.subject.terminate()
    code = await kit.subject.ended()
    left = len(kit.autopilot.written)
    await asyncio.sleep(QUIET_S)
    modes, points = [one.mode for one in kit.autopilot.flights(mark, SET_MODE)], kit.autopilot.of_type(left, _SET_POINT)
    await kit.calm()
    heard = len(kit.tap.heard)
    await kit.subject.start()
    await kit.meet(heard)
    expect(words.names == ["accepted"], f"offboard: came {words}")
    expect(modes[-1:] == [HOLD_MODE], f"SIGTERM during offboard: modes commanded: {modes}, expected {HOLD_MODE} last")
    expect(code == 0 and len(points) <= 1, f"exit code {code}, then {len(points)} set-points")
    return f"SIGTERM during offboard: HOLD was commanded; exit code {code}"
