"""Rules of a UAV client about control: epochs and the activator's lease."""

from __future__ import annotations

import asyncio

from mqttxt.protocol.commands import Arm

from .autopilot import ARM, GCS
from .registry import expect, rule
from .uav_kit import LEASE_MS, UavKit

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


@rule("uav", "R6.8")
async def obeys_only_the_holder(kit: UavKit) -> str:
    """While the newest lease names a station, another's command of that epoch is `denied(not_in_control)`."""
    await kit.calm()
    own, others = kit.command(Arm()), kit.command(Arm())
    await kit.echo(holder_session=own.gs_session, deadline_ms=kit.deadline(LEASE_MS))
    kit.leads = False
    try:
        words, _ = await kit.refused(others, "denied", "not_in_control")
    finally:
        kit.leads = True
    kit.publish(own)
    then = await kit.outcome(own)
    expect(then.names[-1:] == ["completed"], f"a command of the holder: came {then}")
    return f"another's arm: {words}; the holder's: {then}"


@rule("uav", "R5.4")
async def writes_nothing_for_a_former_holder(kit: UavKit) -> str:
    """A command that is not acknowledged is not written again once another station has the drone."""
    await kit.calm()
    message, mark = await kit.unanswered(Arm(), ARM)
    expect(kit.autopilot.flights(mark, ARM), "the arm was not written")
    kit.epoch += 1
    await kit.echo(holder_session=_HOLDER, deadline_ms=kit.deadline(LEASE_MS))
    taken = len(kit.autopilot.written)
    words = await kit.outcome(message, 10)
    again = kit.autopilot.flights(taken, ARM)
    expect(not again, f"after another station's takeover the arm was written {len(again)} times; came {words}")
    expect(words.names == ["unconfirmed"], f"written once and not acknowledged: came {words}")
    return f"not acknowledged, and another station took the drone: written no more; came {words}"
