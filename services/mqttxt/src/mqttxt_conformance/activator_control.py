"""Rules of an activator about control, takeovers, PSMI, QoDS and bundles."""

from __future__ import annotations

import asyncio
from typing import Any

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Goto, Hold
from mqttxt.protocol.control import Control
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.rankings import SelectMessage, SelectMode
from mqttxt.protocol.states import Armed, Battery, Landed, LandedState

from . import shapes
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit, Station
from .registry import Broken, expect, rule

_RATE = 0.002
_UNKNOWN_EPOCH = 1_000_000
_TARGET = Goto(0.0, 8.0, 20.0)


@rule("activator", "R6.5", "R6.6")
async def lets_one_station_command(kit: ActivatorKit) -> str:
    """Only the station in control is obeyed; another's command is `denied(not_in_control, HOLDER)`."""
    for number in kit.drones:
        record = kit.record(number)
        held = (record.get("holder"), record.get("holder_session")) == (kit.station.name, kit.station.session)
        expect(held, f"{kit.station.name} wanted control first; the record of drone {number} says {record}")
    other = Station(kit.cloud, kit.topics, kit.clock)
    kit.stations.append(other)
    await kit.echoed(other.register())
    message = kit.command(Arm(), gs_session=other.session, seq=1)
    try:
        words, evidence = await kit.refused(message, "denied", "not_in_control")
    finally:
        other.register(lease_s=0)
    reason = str(words.reason)
    expect(kit.station.name in reason, f"came {words}, expected the holder's name {kit.station.name}")
    return f"records name {kit.station.name}; another's arm: {evidence}"


@rule("activator", "R6.7", "R6.8", "R6.9")
async def raises_the_epoch_at_a_takeover(kit: ActivatorKit) -> str:
    """A takeover is announced in the record and raises the epoch; commands of a lower one are denied."""
    other = Station(kit.cloud, kit.topics, kit.clock)
    kit.stations.append(other)
    try:
        return await _take_over(kit, other)
    finally:
        newest = kit.record(1).get("epoch", 0)
        await kit.echoed(kit.station.register(control=Control.TAKE, epoch=newest))
        other.register(lease_s=0)
        await kit.cloud.until(lambda: kit.record(1).get("holder_session") == kit.station.session, PATIENCE_S)


async def _take_over(kit: ActivatorKit, other: Station) -> str:
    before = kit.record(1).get("epoch", 0)
    await kit.echoed(other.register(control=Control.TAKE, epoch=before))
    await kit.cloud.until(lambda: kit.record(1).get("holder_session") == other.session, PATIENCE_S)
    taken = kit.record(1)
    expect(taken.get("holder_session") == other.session, f"{other.name} took control: the record says {taken}")
    expect(taken.get("epoch", 0) > before, f"epoch {before} before, {taken.get('epoch')} after a takeover")
    lease = await kit.fog.until(lambda: [x for _, x in kit.one.leases if x.get("epoch") == taken["epoch"]], PATIENCE_S)
    told = lease[-1] if lease else {}
    expect(told.get("holder_session") == other.session, f"{other.name} took control: the drone was told {told}")
    words, _ = await kit.refused(kit.command(Arm()), "denied", "not_in_control")
    stale = kit.command(Arm(), gs_session=other.session, seq=1, epoch=before)
    again, _ = await kit.refused(stale, "denied", "not_in_control")
    return f"epoch {before}, then {taken['epoch']}; of who held it before: {words}; of epoch {before}: {again}"


@rule("activator", "R6.8")
async def counts_the_epochs_that_go_down(kit: ActivatorKit) -> str:
    """An epoch of a session that the activator does not know does not go down: it is above any newer holder's."""
    message = kit.send(Arm(), epoch=_UNKNOWN_EPOCH)
    came = await kit.comes_down(message)
    await kit.outcome(message)
    newest, epoch = max(kit.record(number).get("epoch", 0) for number in kit.drones), came.fields.get("epoch", 0)
    expect(epoch <= newest, f"epoch {_UNKNOWN_EPOCH} came; {epoch} went down, where no record has more than {newest}")
    return f"epoch {_UNKNOWN_EPOCH} came, {epoch} went down"


@rule("activator", "R6.10", "R4.5")
async def hands_the_lease_down(kit: ActivatorKit) -> str:
    """The drone's lease names who is in control, and until when in its own clock: not after the station's lease."""
    await asyncio.sleep(QUIET_S)
    mark = len(kit.one.leases)
    sent_ms = kit.one.now_ms()
    await kit.echoed(kit.station.register(lease_s=6))
    kit.one.born()
    await kit.fog.until(lambda: [x for _, x in kit.one.leases[mark:] if "deadline_ms" in x], PATIENCE_S)
    told = [lease for _, lease in kit.one.leases[mark:] if "deadline_ms" in lease]
    received_ms = kit.one.now_ms()
    kit.station.register()
    expect(told, "no lease with a deadline came down while a station was in control")
    expect(told[0].get("holder_session") == kit.station.session, f"{kit.station.session} controls: {told[0]}")
    latest_ms = received_ms + 6000
    deadline_ms = told[0]["deadline_ms"]
    expect(deadline_ms <= latest_ms, f"a lease of 6 s at {sent_ms} goes down as {deadline_ms}, after {latest_ms}")
    return f"a lease of 6 s, registered at {sent_ms} ms of the drone's clock, goes down until {deadline_ms} ms"


async def _rank(kit: ActivatorKit) -> None:
    kit.tell_all({1: 0.02, 2: 0.01})
    await asyncio.sleep(QUIET_S)


@rule("activator", "R8.1", "R8.2")
async def ranks_by_qods(kit: ActivatorKit) -> str:
    """QoDS lists the available drones by battery decile, then by speed, and comes anew when that changes."""
    await _rank(kit)
    mark = len(kit.cloud.heard)
    kit.one.state(Battery(35))

    def rankings() -> list[list[int]]:
        found = [shapes.read("qods", heard.payload) for heard in kit.cloud.since(mark, kit.topics.qods)]
        return [[_number(ranked) for ranked in one["ranking"]] for one in found]

    await kit.cloud.until(lambda: rankings()[-1:] == [[2, 1]], PATIENCE_S)
    expect(rankings()[-1:] == [[2, 1]], f"drone 1 at 35 %, drone 2 at 90 %: came {rankings()}")
    kit.one.state(Battery(90))
    await kit.cloud.until(lambda: rankings()[-1:] == [[1, 2]], PATIENCE_S)
    expect(rankings()[-1:] == [[1, 2]], f"both at 90 %: came {rankings()}")
    return f"35 % and 90 %, then both 90 %: {rankings()}"


@rule("activator", "R7.2", "R7.5")
async def chooses_by_psmi(kit: ActivatorKit) -> str:
    """A goto on fogX/commands/goto goes to who arrives first; the list says each figure, on fogX/PSMI."""
    await _rank(kit)
    base, said = await _select(kit)
    listed = [_number(one) for one in said["listed"]]
    expect(listed == [2, 1], f"drone 2 is nearer: listed {listed}, left out {said['left_out']}")
    expect(said.get("chosen") == 2, f"listed {listed}, chosen {said.get('chosen')}")
    await kit.comes_down(base, 2)
    words = await kit.outcome(base, 2)
    kit.expect_kept(base, "drone 2 was chosen")
    expect(words.names[-1:] == ["completed"], f"drone 2 said completed: came {words}")
    return f"drone 2 is nearer: listed {listed}; it got the goto: {words}"


@rule("activator", "R7.3")
async def leaves_out_who_cannot_go(kit: ActivatorKit) -> str:
    """A drone that is disarmed, or on the ground, is left out of PSMI's list however near it is."""
    said = []
    for state in (Armed(armed=False), LandedState(Landed.ON_GROUND)):
        await _rank(kit)
        kit.two.state(state)
        await asyncio.sleep(QUIET_S)
        base, answer = await _select(kit)
        listed = [_number(one) for one in answer["listed"]]
        expect(listed == [1], f"drone 2 is nearer and {state}: listed {listed}, left out {answer['left_out']}")
        await kit.outcome(base, 1)
        gone = kit.forwarded(base, 2)
        expect(not gone, f"drone 1 was chosen; drone 2 got the goto too, {len(gone)} times")
        said.append(f"{state}: listed {listed}")
    await _rank(kit)
    return "; ".join(said)


@rule("activator", "R7.6")
async def chooses_nobody_behind_a_later_hold(kit: ActivatorKit) -> str:
    """A select that comes only after a later hold of its station, to whichever drone, is `denied(cancelled)`."""
    await _rank(kit)
    base = kit.command(_TARGET, ttl_ms=20_000)
    await kit.outcome(kit.send(Hold()))
    _publish_select(kit, base)
    await kit.cloud.until(lambda: kit.fog_results(base), PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    gone = [number for number in kit.drones if kit.forwarded(base, number)]
    expect(not gone, f"seq {base.seq + 1} was a hold to drone 1; seq {base.seq}, a select behind it, went to {gone}")
    reasons = [result.get("denied") for _, result in kit.fog_results(base)]
    expect(reasons == ["cancelled"], f"a select behind a later hold: expected denied(cancelled), came {reasons}")
    return f"a hold, then a select of a lower seq: denied({reasons[0]}); it went to nobody"


async def _select(kit: ActivatorKit) -> tuple[CommandMessage, dict[str, Any]]:
    """Send a PSMI goto; return it with the list that the activator publishes. Raises Broken if there is none."""
    mark = len(kit.cloud.heard)
    base = kit.command(_TARGET)
    _publish_select(kit, base)
    found = await kit.cloud.until(lambda: kit.cloud.since(mark, kit.topics.psmi), PATIENCE_S)
    if not found:
        raise Broken(f"no list on {kit.topics.psmi}; came {[result for _, result in kit.fog_results(base, mark)]}")
    return base, shapes.read("psmi", found[0].payload)


def _publish_select(kit: ActivatorKit, base: CommandMessage) -> None:
    fields = {name: value for name, value in vars(base).items() if name != "version"}
    kit.cloud.publish(kit.topics.select("goto"), encode(SelectMessage(**fields, mode=SelectMode.SELECT)))


@rule("activator", "R10.3")
async def bundles_on_request(kit: ActivatorKit) -> str:
    """A station that asks for bundles gets fogX/states, with both stamps of each state."""
    await kit.echoed(kit.station.register(bundles=True))
    await asyncio.sleep(QUIET_S)
    mark = len(kit.cloud.heard)
    own = kit.one.state(Battery(50))
    found = await kit.cloud.until(lambda: kit.cloud.since(mark, kit.topics.states), PATIENCE_S)
    expect(found, f"nothing on {kit.topics.states} within {PATIENCE_S:g} s of a new battery")
    entries = [entry for heard in found for entry in _entries(heard.payload)]
    forms = ([1, 50], {"state": "battery", "remaining_pct": 50})
    mine = [one for one in entries if one[0] == 1 and one[2] == own and any(form in one[3] for form in forms)]
    expect(mine, f"battery 50 of drone 1, stamp {own}: came {entries}")
    alone = kit.states(mark)
    await kit.echoed(kit.station.register())
    expect(not alone, f"nobody asked for topics: {alone[0][0].topic if alone else ''} came too")
    return f"battery 50, stamp {own}: {mine[0]}"


def _number(entry: object) -> int:
    return int(entry["drone"] if isinstance(entry, dict) else entry[0])  # type: ignore[index]


def _entries(payload: bytes) -> list[list[Any]]:
    """A fog bundle's entries as [drone, relay stamp, stamp, states]; raises Broken."""
    raw = shapes.plain(payload)
    if isinstance(raw, dict):
        raw = [[[one.get(name) for name in ("drone", "relay_stamp", "stamp", "states")] for one in raw["drones"]]]
    for row in raw[0]:
        expect(isinstance(row, list) and len(row) == 4, f"{shapes.shown(payload)}: expected four fields a drone")
    return list(raw[0])
