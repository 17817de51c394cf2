"""Rules of a UAV client about control: epochs, the activator's lease, offboard."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.commands import Arm, Offboard, Velocity

from .autopilot import GCS, HOLD_MODE, OFFBOARD_MODE, SET_MODE
from .registry import expect, rule
from .uav_kit import QUIET_S, UavKit

_SET_POINT = "SET_POSITION_TARGET_LOCAL_NED"
_HOLDER = 77


def _gcs_beats(kit: UavKit, mark: int) -> list[int]:
    return [one.at_ms for one in kit.autopilot.of_type(mark, "HEARTBEAT") if one.message.type == GCS]


@rule("uav", "R6.12")
async def is_a_ground_station_only_inside_the_lease(kit: UavKit) -> str:
    """It sends a ground station's HEARTBEAT while a control lease lives, and none before or after it."""
    await kit.echo()
    await asyncio.sleep(0.2)
    mark = len(kit.autopilot.written)
    await asyncio.sleep(1.3)
    before = _gcs_beats(kit, mark)
    expect(not before, f"{len(before)} heartbeats of a ground station without a lease")
    deadline_ms = kit.deadline(2500)
    mark = len(kit.autopilot.written)
    await kit.echo(holder_session=_HOLDER, deadline_ms=deadline_ms)
    await asyncio.sleep(4.2)
    beats = _gcs_beats(kit, mark)
    late = [at_ms for at_ms in beats if kit.read_late(at_ms, deadline_ms)]
    expect(beats, "no heartbeat of a ground station inside a lease of 2.5 s")
    expect(not late, f"{len(late)} heartbeats of a ground station after the lease's end")
    return f"none without a lease; {len(beats)} inside 2.5 s of one; none in the 1.7 s after it"


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
    message = kit.command(Offboard(1.0, Velocity(1, 0, 0)), gs_session=_HOLDER, seq=1)
    kit.publish(message)
    words = await kit.outcome(message, 8)
    modes = kit.autopilot.flights(mark, SET_MODE)
    asked = [(int(one.message.param2), int(one.message.param3)) for one in modes]
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
    message = kit.command(Offboard(60.0, Velocity(1, 0, 0)), limit_s=90.0, gs_session=_HOLDER, seq=2)
    kit.publish(message)
    words = await kit.outcome(message, 10)
    modes = [(int(one.message.param2), int(one.message.param3)) for one in kit.autopilot.flights(mark, SET_MODE)]
    reason = (words.last or {}).get("reason")
    expect(reason == "lease_lost", f"60 s of offboard with a lease of 2.5 s: came {words}")
    expect(modes[-1:] == [HOLD_MODE], f"modes commanded: {modes}, expected {HOLD_MODE} last")
    await asyncio.sleep(QUIET_S)
    mark = len(kit.autopilot.written)
    await asyncio.sleep(QUIET_S)
    points = kit.autopilot.of_type(mark, _SET_POINT)
    expect(not points, f"{len(points)} set-points after the last word")
    return f"60 s of offboard with a lease of 2.5 s: came {words}; HOLD; no set-point afterwards"


@rule("uav", "R6.8", "R6.10")
async def refuses_a_lower_epoch(kit: UavKit) -> str:
    """A command of a lower epoch than the lease's is `denied(not_in_control)`; an older lease changes nothing."""
    await kit.calm()
    kit.epoch += 5
    await kit.echo(holder_session=_HOLDER, deadline_ms=kit.deadline(20_000))
    words, _ = await kit.refused(kit.command(Arm(), epoch=kit.epoch - 1), "denied", "not_in_control")
    old = {} if kit.secured is None else {"counter": 1}
    await kit.echo(epoch=kit.epoch - 2, **old)
    again, _ = await kit.refused(kit.command(Arm(), epoch=kit.epoch - 2), "denied", "not_in_control")
    message = kit.command(Arm())
    kit.publish(message)
    then = await kit.outcome(message)
    expect(then.names[-1:] == ["completed"], f"a command of the newest epoch: came {then}")
    return f"epoch {kit.epoch - 1} under {kit.epoch}: {words}; after an older lease: {again}; epoch {kit.epoch}: {then}"
