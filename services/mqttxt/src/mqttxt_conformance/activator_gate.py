"""Rules of an activator about presence, registration, the gate, and the states and readings that it passes on."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import replace
from functools import partial
from typing import Any

from mqttxt.core.clock import STAMP_MODULUS, STAMP_TICK_MS
from mqttxt.protocol.codec import encode
from mqttxt.protocol.control import Control
from mqttxt.protocol.messages import Word
from mqttxt.protocol.readings import ReadingMessage
from mqttxt.protocol.states import Armed, Battery, Heading

from . import shapes
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit, Station
from .registry import expect, rule

_STAMPS_MS = STAMP_MODULUS * STAMP_TICK_MS


@rule("activator", "R9.1", "R3.4")
async def birth_carries_the_session(kit: ActivatorKit) -> str:
    """The birth on fogX/reachable is retained and carries the session that the beacons name."""
    birth = kit.birth
    assert birth is not None
    expect(birth.retain and birth.qos == 1, f"{birth.topic}: RETAIN {birth.retain}, QoS {birth.qos}; expected True, 1")
    named = {beacon["session"] for at_ms, beacon in kit.beacons if at_ms >= birth.at_ms}
    expect(named == {kit.session}, f"birth of session {kit.session}, beacons of {named}")
    return f"{shapes.shown(birth.payload)}, retained; beacons of the same session"


@rule("activator", "R9.5", "R4.2")
async def hands_a_nonce_down(kit: ActivatorKit) -> str:
    """A drone's birth is answered on droneY/init_connect, not retained, with its session and a nonce."""
    await kit.fog.until(lambda: all(drone.leases for drone in kit.drones.values()), PATIENCE_S)
    for drone in kit.drones.values():
        came = kit.fog.since(0, kit.fog_side.init_connect(drone.number))
        expect(came, f"nothing on {kit.fog_side.init_connect(drone.number)} after the birth of drone {drone.number}")
        lease = shapes.read("drone-lease", came[0].payload)
        named = (lease["activator_session"], lease["drone_session"], lease["bound"])
        expect(named == (kit.session, drone.session, True), f"lease {lease} for session {drone.session}")
        expect(not came[0].retain, f"{came[0].topic} is retained")
    nonces = [lease["nonce"] for drone in kit.drones.values() for _, lease in drone.leases]
    expect(len(set(nonces)) == len(nonces), f"nonces {nonces} are not fresh")
    return f"{len(nonces)} leases for {len(kit.drones)} drones, each with a nonce of its own"


@rule("activator", "R9.2")
async def says_who_is_reachable(kit: ActivatorKit) -> str:
    """A drone that was born and echoed has a retained record as reachable, in the activator's and its own session."""
    for number, drone in kit.drones.items():
        record = kit.record(number)
        expect(record, f"no record of drone {number} on {kit.topics.drone_reachable(number)}")
        expect(kit.records[number][-1][0].retain, f"the record of drone {number} is not retained")
        named = (record["activator_session"], record["up"], record.get("drone_session"))
        expect(named == (kit.session, True, drone.session), f"drone {number}, session {drone.session}: {record}")
    return f"records {[kit.record(number) for number in kit.drones]}"


@rule("activator", "R6.3")
async def holds_states_back(kit: ActivatorKit) -> str:
    """While no station is registered no state goes to the cloud."""
    mark = len(kit.cloud.heard)
    for percent in (80, 79):
        kit.one.state(Battery(percent))
        await asyncio.sleep(QUIET_S)
    came = kit.states(mark) + [(heard, "") for heard in kit.cloud.since(mark, kit.topics.states)]
    expect(not came, f"nobody is registered: {came[0][0].topic if came else ''} came {len(came)} times")
    return "two states of drone 1, nobody registered: none came"


@rule("activator", "R6.3")
async def lets_words_through(kit: ActivatorKit) -> str:
    """Words of a drone and records pass whether or not a station is registered."""
    mark = len(kit.cloud.heard)
    message = kit.command()
    kit.one.say(message.gs_session, message.seq, "arm", Word.EXPIRED)
    words = await kit.outcome(message, mark=mark)
    expect(words.names == ["expired"], f"nobody is registered; a drone said expired: came {words}")
    return f"nobody is registered; a drone's word came: {words}"


@rule("activator", "R4.2", "R6.1")
async def answers_a_registration(kit: ActivatorKit) -> str:
    """A registration is answered with a beacon that has its nonce and how long it waited."""
    nonce = kit.station.register()
    beacon = await kit.echoed(nonce)
    expect(beacon is not None, f"no beacon with the nonce within {PATIENCE_S:g} s")
    assert beacon is not None
    expect("held_ms" in beacon, f"beacon {beacon}: held_ms is missing")
    return f"beacon {beacon}"


@rule("activator", "R6.13")
async def answers_what_is_not_shown(kit: ActivatorKit) -> str:
    """Who registers with `anew` is told each drone's record before the beacon, who names no session the birth."""
    mark, other = len(kit.cloud.heard), Station(kit.cloud, kit.topics, kit.clock)
    other.register(lease_s=0, control=Control.NONE, anew=True)
    birth = kit.topics.reachable
    expect(await kit.cloud.until(lambda: kit.cloud.since(mark, birth), PATIENCE_S), "no birth for who names no session")
    mark = len(kit.cloud.heard)
    nonce = other.register(control=Control.NONE, anew=True, activator_session=kit.session)
    expect(await kit.echoed(nonce) is not None, f"no beacon with the nonce within {PATIENCE_S:g} s")
    topics = [heard.topic for heard in kit.cloud.since(mark)]
    before = topics[: topics.index(kit.topics.clock)]
    missing = [drone for drone in (1, 2) if kit.topics.drone_reachable(drone) not in before]
    other.register(lease_s=0, control=Control.NONE)
    expect(not missing, f"before the beacon came no record of drone {', '.join(map(str, missing))}")
    return "the birth came for who named no session; the records came before the beacon"


@rule("activator", "R6.3")
async def tells_the_last_known_states(kit: ActivatorKit) -> str:
    """A station that registers receives the last known states."""
    found = await kit.cloud.until(lambda: [h for h, name in kit.states(0) if name == "battery"], PATIENCE_S)
    expect(found, "the battery that drone 1 told before the registration did not come")
    state = shapes.read_state("battery", found[-1].payload, relayed=True)
    expect(state["remaining_pct"] == 79, f"the newest battery was 79, told was {state}")
    return f"after the registration came {state}"


@rule("activator", "R3.6", "R3.2")
async def passes_states_on(kit: ActivatorKit) -> str:
    """A state goes to the cloud as it is, behind the drone's stamp and the activator's; an older one does not."""
    mark = len(kit.cloud.heard)
    before_ms = kit.one.now_ms() - 1000

    def headings() -> list[Any]:
        return [heard for heard, name in kit.states(mark) if name == "heading"]

    own = kit.one.state(Heading(90.0))
    await kit.cloud.until(headings, PATIENCE_S)
    kit.one.state(Heading(180.0), stamped_ms=before_ms)
    await asyncio.sleep(QUIET_S)
    came = [shapes.read_state("heading", heard.payload, relayed=True) for heard in headings()]
    expect(came, "heading 90 did not come")
    expect(came[0]["stamp"] == own and came[0]["heading_deg"] in (9000, 90.0), f"heading 90, stamp {own}: came {came}")
    expect(len(came) == 1, f"a heading that was stamped a second before came too: {came}")
    return f"heading 90, stamp {own}: {came[0]}; an older one was dropped"


@rule("activator", "R3.7", "R4.3")
async def stamps_states_conservatively(kit: ActivatorKit) -> str:
    """The age that follows from the activator's stamp is never smaller than the true one."""
    said = []
    for number, drone in kit.drones.items():
        mark = len(kit.cloud.heard)
        latest_ms = kit.remote.latest_now_ms(kit.clock.now_ms())
        if latest_ms is None:
            kit.station.register()
            await asyncio.sleep(QUIET_S)
            latest_ms = kit.remote.latest_now_ms(kit.clock.now_ms()) or 0
        taken_ms = drone.now_ms()
        await asyncio.sleep(0.5)
        drone.state(Armed(number == 1), stamped_ms=taken_ms)
        await kit.cloud.until(partial(kit.states, mark, number), PATIENCE_S)
        came = [shapes.read_state(name, heard.payload, relayed=True) for heard, name in kit.states(mark, number)]
        expect(came, f"a state of drone {number} that was 0.5 s under way did not come")
        young_ms = (came[0]["relay_stamp"] * STAMP_TICK_MS - latest_ms) % _STAMPS_MS
        is_young = STAMP_TICK_MS < young_ms < _STAMPS_MS // 2
        expect(not is_young, f"taken at {latest_ms} ms of the activator's clock at most, stamped {young_ms} ms later")
        old_ms = (latest_ms - came[0]["relay_stamp"] * STAMP_TICK_MS) % _STAMPS_MS
        expect(old_ms < 5000, f"stamped {old_ms} ms before it was taken")
        said.append(f"drone {number}: {old_ms} ms")
    return f"0.5 s under way; stamped before it was taken by {', '.join(said)}"


@rule("activator", "R9.14", "R6.3")
async def passes_readings_on(kit: ActivatorKit) -> str:
    """A reading goes to the cloud as it is, and is named on droneY/sensor_ack so that the drone may forget it."""
    reading = ReadingMessage(boot=secrets.randbelow(2**32 - 1) + 1, seq=1, time_ms=1_700_000_000_000, value=21.5)
    mark, below = len(kit.cloud.heard), len(kit.fog.heard)
    kit.fog.publish(kit.fog_side.sensor(1, 4, "temperature"), encode(reading))
    topic = kit.topics.drone_sensor(1, 4, "temperature")
    await kit.cloud.until(lambda: kit.cloud.since(mark, topic), PATIENCE_S)
    came = kit.cloud.since(mark, topic)
    expect(came, f"nothing on {topic}")
    sent, told = shapes.plain(encode(reading)), shapes.plain(came[0].payload)
    expect(came[0].qos == 1 and not came[0].retain, f"{topic}: QoS {came[0].qos}, RETAIN {came[0].retain}")
    expect(told == sent or isinstance(told, dict), f"{sent} became {told}")
    ack = kit.fog_side.sensor_ack(1)
    await kit.fog.until(lambda: kit.fog.since(below, ack), PATIENCE_S)
    named = [shapes.shown(heard.payload) for heard in kit.fog.since(below, ack)]
    expect(named and str(reading.boot) in named[0], f"boot {reading.boot} passed on; on {ack} came {named}")
    return f"{told} on {topic}; then {named[0]} on {ack}; {await _keeps_for_stations(kit, reading)}"


async def _keeps_for_stations(kit: ActivatorKit, reading: ReadingMessage) -> str:
    """While no station is registered a reading passes, but it is not acknowledged to its drone."""
    try:
        kit.station.register(lease_s=0)
        await asyncio.sleep(QUIET_S)
        unheard = replace(reading, seq=reading.seq + 1)
        mark, below = len(kit.cloud.heard), len(kit.fog.heard)
        kit.fog.publish(kit.fog_side.sensor(1, 4, "temperature"), encode(unheard))
        topic, ack = kit.topics.drone_sensor(1, 4, "temperature"), kit.fog_side.sensor_ack(1)
        await kit.cloud.until(lambda: kit.cloud.since(mark, topic), PATIENCE_S)
        expect(kit.cloud.since(mark, topic), f"nothing on {topic} while no station was registered")
        await asyncio.sleep(QUIET_S)
        named = [shapes.shown(heard.payload) for heard in kit.fog.since(below, ack)]
        expect(not named, f"no station was registered; on {ack} came {named}")
    finally:
        await kit.echoed(kit.station.register())
    return f"without a station nothing on {ack}"


@rule("activator", "R6.2", "R6.3")
async def closes_the_gate(kit: ActivatorKit) -> str:
    """The gate closes when the last lease ends, lapses, or the station's will comes."""
    try:
        return await _open_and_close(kit)
    finally:
        await kit.echoed(kit.station.register())


async def _open_and_close(kit: ActivatorKit) -> str:
    kit.station.register(lease_s=0)
    await asyncio.sleep(QUIET_S)
    said = []
    for what in ("its end", "a lapse", "a will"):
        station = Station(kit.cloud, kit.topics, kit.clock)
        kit.stations.append(station)
        await kit.echoed(station.register(lease_s=1 if what == "a lapse" else 600, control=Control.NONE))
        mark = len(kit.cloud.heard)
        kit.one.state(Battery(60))
        await kit.cloud.until(partial(kit.states, mark), PATIENCE_S)
        expect(kit.states(mark), "no state although a station was registered")
        if what == "its end":
            station.register(lease_s=0)
        elif what == "a will":
            station.gone()
        await asyncio.sleep(1.5 if what == "a lapse" else QUIET_S)
        mark = len(kit.cloud.heard)
        kit.one.state(Battery(59))
        await asyncio.sleep(QUIET_S)
        came = kit.states(mark)
        expect(not came, f"after {what} came {came[0][0].topic if came else ''}")
        said.append(what)
    return f"no state after {', after '.join(said)}"
