"""Rules of a UAV client about control: epochs and the activator's lease."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.commands import Arm

from .autopilot import GCS
from .registry import expect, rule
from .uav_kit import UavKit

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
    then = await kit.outcome(kit.send(Arm()))
    expect(then.names[-1:] == ["completed"], f"a command of the newest epoch: came {then}")
    return f"epoch {kit.epoch - 1} under {kit.epoch}: {words}; after an older lease: {again}; epoch {kit.epoch}: {then}"
