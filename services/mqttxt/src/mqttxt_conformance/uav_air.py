"""Rules of a UAV client over datagrams (section 20): the kit is the gateway and the activator."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Disarm
from mqttxt.protocol.topics import FogSide

from . import shapes
from .autopilot import ARM, Autopilot
from .datagrams import (
    CLEAN,
    CONNECT,
    DISCONNECT,
    DUP,
    GRACE_MS,
    HEADERS,
    LARGEST,
    PINGREQ,
    PREDEFINED,
    PUBACK,
    PUBLISH,
    QOS_1,
    RETAIN,
    SUBSCRIBE,
    TOGETHER,
    UNSUBSCRIBE,
    WILL,
    WILLMSG,
    WILLTOPIC,
    Packet,
    ids_of,
    together,
)
from .registry import RULES, Finding, NotTested, check_met, expect, rule
from .subject import Subject
from .uav_air_kit import AirKit, Gateway
from .uav_kit import PATIENCE_S, UavTarget

ROLE = "uav over datagrams"
FIRST_MS = 500
"""The pause before the first repetition of a packet (R20.5)."""
QUIET_MS, LOST_S = 5000, 15.0
"""The silence after which the client sends PINGREQ, and connects anew (R20.9)."""
CONFIRM_MS = 1500
MOST_BYTES = 69
"""The most for a state, with headers of IPv4 and UDP (R20.4)."""


@rule(ROLE, "R20.2", "R20.7", "R9.1")
async def greets_with_its_will(kit: AirKit) -> str:
    """It connects with a clean session, its will on droneY/reachable, retained, and a keep-alive of at most 15 s."""
    connect, *_ = kit.connects()
    wills = [packet for packet in kit.air.came if packet.kind in (WILLTOPIC, WILLMSG)]
    expect(connect.flags & (CLEAN | WILL) == CLEAN | WILL, f"CONNECT with flags 0x{connect.flags:02x}")
    expect(connect.protocol == 1, f"CONNECT with protocol {connect.protocol}")
    expect(0 < connect.duration <= LOST_S, f"CONNECT with a keep-alive of {connect.duration} s")
    topic, message = wills[:2]
    where, own = topic.rest.decode(), kit.topics.reachable(kit.drone)
    expect(where == own and topic.flags == QOS_1 | RETAIN, f"will on {where} with flags 0x{topic.flags:02x}")
    will = shapes.read("presence", message.rest)
    expect(will["session"] == kit.session and will["up"] is False, f"will {will}, expected session {kit.session}, down")
    return f"client id {connect.rest.decode()}, keep-alive {connect.duration} s, will {will} on {where}"


@rule(ROLE, "R20.3", "R20.6", "R20.7")
async def subscribes_by_ids(kit: AirKit) -> str:
    """It asks for messages together first, then subscribes to its own topics by their ids, to commands live."""
    asked = [packet for packet in kit.air.came if packet.kind in (SUBSCRIBE, UNSUBSCRIBE)]
    expect(asked, "no SUBSCRIBE")
    for packet in asked:
        is_id = packet.flags & 3 == PREDEFINED and len(packet.rest) == 2
        expect(is_id, f"SUBSCRIBE to {packet.rest!r}, expected a predefined id")
    topics = [int.from_bytes(packet.rest, "big") for packet in asked]
    expect(topics[0] == TOGETHER, f"first SUBSCRIBE to {topics[0]}, expected {TOGETHER}")
    others = sorted({number for number in topics if number != TOGETHER and number not in kit.air.ids})
    expect(not others, f"SUBSCRIBE to {others}, expected ids of drone {kit.drone}")
    live = [one for one, topic in zip(asked, topics, strict=True) if kit.air.ids.get(topic) == kit.commands_topic]
    expect(live and all(one.flags & RETAIN for one in live), "commands: not subscribed to live")
    return f"{len(set(topics))} subscriptions, commands live"


@rule(ROLE, "R20.5")
async def repeats_what_is_not_answered(kit: AirKit) -> str:
    """A PUBLISH without PUBACK comes again with DUP and its id, at growing pauses; meanwhile nothing else is sure."""
    await kit.calm()
    kit.leaves_unanswered(lambda packet: packet.is_sure)
    message, mark, written = kit.command(Arm()), len(kit.air.came), len(kit.autopilot.written)
    kit.publish(message)
    copies, pauses = await kit.air.repeated(mark, PATIENCE_S)
    are_growing = all(later > earlier - GRACE_MS / 2 for earlier, later in pairwise(pauses))
    expect(are_growing, f"pauses of {pauses} ms")
    kit.air.answers = lambda packet: True
    evidence = await kit.flown(message, written)
    left = len(kit.air.came)
    await asyncio.sleep(3 * FIRST_MS / 1000)
    late = [one for one in kit.air.packets(PUBLISH, left) if one.msg_id == copies[0].msg_id]
    expect(not late, f"message id {copies[0].msg_id} came again behind its PUBACK")
    return f"{len(copies)} copies, {pauses} ms apart; {evidence}"


@rule(ROLE, "R20.5", "R5.3")
async def takes_a_repetition_once(kit: AirKit) -> str:
    """A PUBLISH that comes again is acknowledged again and not taken; one with an older id is dropped."""
    await kit.calm()
    message, mark, written = kit.command(Disarm()), len(kit.air.came), len(kit.autopilot.written)
    topic_id, first, last = kit.id_of(kit.commands_topic), kit.air.next_id, kit.air.next_id
    payload, older = encode(message), encode(kit.command(Arm()))
    kit.lead(message.gs_session)
    kit.air.send(PUBLISH, QOS_1 | PREDEFINED, topic_id, last, rest=payload)
    await kit.outcome(message)
    for _ in range(2):
        kit.air.send(PUBLISH, QOS_1 | PREDEFINED | DUP, topic_id, last, rest=payload)
    kit.air.send(PUBLISH, QOS_1 | PREDEFINED, topic_id, first, rest=older)
    evidence = await kit.flown(message, written)
    answers = [one.msg_id for one in kit.air.packets(PUBACK, mark)]
    expect(answers.count(last) == 3, f"{answers.count(last)} PUBACKs of three copies")
    expect(first not in answers, f"PUBACK of message id {first}, which came behind {last}")
    return f"three copies: {evidence}, three PUBACKs; an older id: nothing"


@rule(ROLE, "R20.6")
async def takes_messages_together(kit: AirKit) -> str:
    """Messages in one PUBLISH, and one in two pieces, are taken whole, once, and acknowledged."""
    await kit.calm()
    written = len(kit.autopilot.written)
    session = kit.command(Arm()).gs_session
    messages = [kit.command(Arm(), gs_session=session), kit.command(Disarm(), gs_session=session, seq=2)]
    kit.lead(session)
    stream = together(kit.air.ids, *((kit.commands_topic, encode(message)) for message in messages))
    cut = len(stream) * 3 // 4
    codes = [kit.air.surely(PREDEFINED, TOGETHER, piece) for piece in (stream[:cut], stream[cut:])]
    await kit.air.until(lambda: all(code.done() for code in codes), PATIENCE_S)
    found = [code.result() if code.done() else None for code in codes]
    said = [str(await kit.outcome(message)) for message in messages]
    expect(found == [0, 0], f"PUBACKs with codes {found}")
    flown = [one.message.param1 for one in kit.autopilot.flights(written, ARM)]
    expect(flown == [1.0, 0.0], f"written: {flown}, expected arm, then disarm; came {said}")
    lasts = [kit.words(session, message.seq).last for message in messages]
    expect(all(lasts), f"two commands in two pieces: {said}")
    return f"two pieces of {cut} and {len(stream) - cut} bytes: {'; '.join(said)}"


@rule(ROLE, "R20.8", "R5.5")
async def says_again_what_was_not_taken(kit: AirKit) -> str:
    """A last word whose PUBACK has a return code of MQTT-SN's own comes again."""
    await kit.calm()
    kit.air.codes[PUBLISH] = 2
    message, mark = kit.command(Arm()), len(kit.air.came)
    kit.publish(message)

    def sure() -> list[Packet]:
        return [one for one in kit.air.packets(PUBLISH, mark) if one.is_sure]

    await kit.air.until(lambda: len({one.msg_id for one in sure()}) >= 2, PATIENCE_S)
    kit.air.codes.clear()
    words = await kit.outcome(message, 2 * PATIENCE_S)
    expect(words.last is not None, f"refused with return code 2, the last word did not come again: {words}")
    return f"refused with return code 2, then taken: {words}"


@rule(ROLE, "R20.8", "R20.9", "R20.7")
async def connects_anew(kit: AirKit) -> str:
    """After DISCONNECT, and after any return code in CONNACK, it connects anew, from another port."""
    await kit.calm()
    mark = len(kit.air.came)
    kit.air.codes[CONNECT] = kit.air.codes[WILLMSG] = 0x87
    kit.air.send(DISCONNECT)
    await kit.air.until(lambda: len({one.sender for one in kit.connects(mark)}) >= 2, PATIENCE_S + LOST_S)
    tried = len({one.sender for one in kit.connects(mark)})
    expect(tried >= 2, f"after DISCONNECT, and CONNACK with 0x87: {tried} connections")
    expect(kit.subject.exit_code is None, f"after CONNACK with 0x87 it ended with {kit.subject.ending}")
    await kit.calm()
    await kit.greeted(len(kit.air.came), PATIENCE_S + LOST_S)
    return f"refused {tried} times with 0x87, then served, in session {kit.session}"


@rule(ROLE, "R20.9")
async def asks_a_silent_gateway_and_leaves_it(kit: AirKit) -> str:
    """It sends PINGREQ where nothing has come for 5 s, and connects anew after 15 s of silence."""
    await kit.calm()
    mark, began_ms = len(kit.air.came), kit.clock.now_ms()
    kit.leaves_unanswered(lambda packet: True)
    await kit.air.until(lambda: kit.connects(mark), LOST_S + PATIENCE_S)
    pings, connects = kit.air.packets(PINGREQ, mark), kit.connects(mark)
    heard = len(kit.tap.heard)
    await kit.calm()
    await kit.meet(heard)
    expect(len(pings) > 1, f"{len(pings)} PINGREQs in {LOST_S:g} s of silence")
    first_ms = pings[0].at_ms - began_ms
    expect(first_ms <= QUIET_MS + GRACE_MS, f"PINGREQ after {first_ms} ms of silence")
    expect(connects, f"no CONNECT after {LOST_S + PATIENCE_S:g} s of silence")
    after_s = (connects[0].at_ms - began_ms) / 1000
    expect(after_s >= LOST_S - 6, f"CONNECT after {after_s:.1f} s of silence")
    return f"PINGREQ after {first_ms / 1000:.1f} s, {len(pings)} in all; CONNECT after {after_s:.1f} s"


@rule(ROLE, "R20.4", "R3.6")
async def says_a_state_once(kit: AirKit) -> str:
    """A state leaves at QoS 0, and once more at QoS 1, with its stamp, where no newer one followed for 1.5 s."""
    topics = {number: topic for number, topic in kit.air.ids.items() if "/state/" in topic and "/text" not in topic}
    newest: dict[tuple[Any, int], Packet] = {}
    counts, said = [0, 0], set[tuple[Any, int]]()
    for packet in [one for one in kit.air.packets(PUBLISH) if one.topic in topics]:
        if (packet.sender, packet.msg_id) in said:
            continue
        if packet.is_sure:
            said.add((packet.sender, packet.msg_id))
        name, before = topics[packet.topic], newest.get((packet.sender, packet.topic))
        is_again = before is not None and packet.rest == before.rest
        if not packet.is_sure:
            expect(not is_again, f"{name}: the same state twice at QoS 0")
            newest[packet.sender, packet.topic] = packet
        else:
            expect(is_again and before is not None, f"{name}: at QoS 1, and not the newest one's repetition")
            assert before is not None
            after_ms = packet.at_ms - before.at_ms
            expect(after_ms >= CONFIRM_MS - 100, f"{name}: repeated after {after_ms} ms")
            newest[packet.sender, packet.topic] = Packet(PUBLISH)
        counts[packet.is_sure] += 1
    expect(counts[0], "no state at QoS 0")
    if not counts[1]:
        raise NotTested(f"{counts[0]} states at QoS 0, each with a newer one within {CONFIRM_MS} ms")
    return f"{counts[0]} states at QoS 0, {counts[1]} of them once more at QoS 1"


@rule(ROLE, "R20.4")
async def its_states_are_short(kit: AirKit) -> str:
    """A state's datagram has at most 69 bytes with IPv4's and UDP's headers."""
    sizes: dict[str, int] = {}
    for packet in kit.air.packets(PUBLISH):
        topic = kit.air.ids.get(packet.topic, "")
        if "/state/" in topic and not topic.endswith("/text"):
            sizes[topic] = max(sizes.get(topic, 0), packet.size + HEADERS)
    longest = max(sizes, key=lambda topic: sizes[topic], default="")
    expect(sizes, "no state")
    expect(sizes[longest] <= MOST_BYTES, f"{longest}: {sizes[longest]} bytes")
    return f"{len(sizes)} states, the longest {longest.rsplit('/', 1)[1]}: {sizes[longest]} bytes"


@rule(ROLE, "R20.1", "R20.3", "R20.5")
async def its_packets_are_as_specified(kit: AirKit) -> str:
    """Every datagram is one packet of section 20, of at most 1,200 bytes, on its own ids; message ids rise by one."""
    expect(not kit.air.faults, f"{kit.air.faults[:1]}")
    longest = max(packet.size for packet in kit.air.came if packet.kind != WILLMSG)
    expect(longest <= LARGEST, f"a datagram of {longest} bytes")
    known = {TOGETHER, *kit.air.ids}
    foreign = [one for one in kit.air.packets(PUBLISH) if one.flags & 3 != PREDEFINED or one.topic not in known]
    expect(not foreign, f"PUBLISH on topic id {foreign[0].topic if foreign else 0}")
    asking = [one for one in kit.air.came if one.is_sure or one.kind in (SUBSCRIBE, UNSUBSCRIBE)]
    for sender in {one.sender for one in asking}:
        ids = [one.msg_id for one in asking if one.sender == sender]
        steps = {(later - earlier) % 65_535 for earlier, later in pairwise(ids)}
        expect(steps <= {0, 1}, f"message ids {ids[:20]}")
    return f"{len(kit.air.came)} packets of at most {longest} bytes"


@rule(ROLE, "R20.7", "R9.3")
async def takes_leave(kit: AirKit) -> str:
    """At a clean stop it says `down`, then DISCONNECT without a duration, again until that is answered."""
    kit.subject.need()
    await kit.calm()
    mark, heard = len(kit.air.came), len(kit.tap.heard)
    kit.leaves_unanswered(lambda packet: packet.kind == DISCONNECT and len(kit.air.packets(DISCONNECT, mark)) < 2)
    kit.subject.terminate()
    code = await kit.subject.ended()
    leaves = kit.air.packets(DISCONNECT, mark)
    said = [one for one in kit.tap.since(heard, kit.topics.reachable(kit.drone)) if one.payload]
    is_down = bool(said) and shapes.read("presence", said[-1].payload)["up"] is False
    expect(is_down, "SIGTERM: no `down`")
    expect(
        len(leaves) >= 2 and not any(one.rest for one in leaves), f"SIGTERM: {len(leaves)} DISCONNECTs, or durations"
    )
    expect(code == 0, f"SIGTERM: exit code {code}, expected 0")
    return f"down, then {len(leaves)} DISCONNECTs, the first unanswered; exit code 0"


async def check_uav_air(
    gateway: BrokerAddress, target: UavTarget, on_finding: Callable[[Finding], None]
) -> list[Finding]:
    """Check a UAV client over datagrams; raises ConfigurationError for a gateway's port in use or a bad `run`."""
    topics, clock = FogSide(target.fog_root), SessionClock()
    host, port = target.autopilot_host, target.autopilot_port
    values = {"broker": str(gateway), "drone": str(target.drone), "autopilot": f"udp:{host}:{port}"}
    subject = Subject(target.run, values, target.log)
    air = Gateway(ids_of(topics.root, target.drone), clock)
    kit = AirKit(air, target.drone, topics, Autopilot(host, port, target.drone, clock), subject, clock)
    checked = RULES[ROLE]
    await air.open("--broker", local=(gateway.host, gateway.port))
    try:
        air.on_heard = kit.on_heard
        await kit.autopilot.start()
        if subject.is_ours:
            await subject.start()
        return await check_met(kit.meet(), checked[0].name, checked, kit, on_finding)
    finally:
        await kit.close()
