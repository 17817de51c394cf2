"""Rules of an activator with a gateway for datagrams (section 20): the kit is drone 1 and its other clients."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from functools import partial

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.commands import Arm, Disarm
from mqttxt.protocol.messages import Presence, Word
from mqttxt.protocol.states import Heading
from mqttxt.protocol.topics import CloudSide, FogSide

from . import datagrams as wire
from .activator_air_kit import KEEPALIVE_S, AirKit
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorTarget
from .datagrams import CLEAN, DUP, GRACE_MS, NORMAL, PREDEFINED, QOS_1, RETAIN, WILL, Address, Packet
from .registry import RULES, Finding, check_met, expect, rule
from .subject import Subject
from .tap import Tap, clear_retained

ROLE = "activator over datagrams"
INVALID = 2
ASKED_S = 5.0
"""How long a client has to answer PINGREQ after another one connects with its id (R20.10)."""
REFLECTED = 3


@rule(ROLE, "R20.2", "R20.3", "R6.10", "R9.2")
async def serves_a_drone(kit: AirKit) -> str:
    """A drone that comes by datagrams has a lease, is reachable, and is commanded, as any other."""
    expect(kit.record(1).get("up"), f"drone 1's record is {kit.record(1)}")
    own = [lease for _, lease in kit.one.leases if lease["drone_session"] == kit.one.session]
    expect(own, "no lease came over the air leg")
    said = []
    for command in (Arm(), Disarm()):
        message = kit.send(command)
        await kit.comes_down(message)
        words = await kit.outcome(message)
        expect(words.names[-1:] == ["completed"], f"{command.name}: drone 1 said `completed`; came {words}")
        expect(len(kit.forwarded(message)) == 1, f"{command.name} came down {len(kit.forwarded(message))} times")
        said.append(f"{command.name}: {words}")
    return f"{len(own)} leases; {'; '.join(said)}"


@rule(ROLE, "R20.5")
async def repeats_what_is_not_answered(kit: AirKit) -> str:
    """A PUBLISH without PUBACK comes again with DUP and its id, at growing pauses; meanwhile nothing else is sure."""
    air, message, mark = kit.air, kit.command(Arm()), len(kit.air.came)
    air.answers = lambda packet: not packet.is_sure
    try:
        kit.publish(message)
        copies, pauses = await air.repeated(mark, PATIENCE_S)
    finally:
        air.answers = lambda packet: True
    words = await kit.outcome(message)
    expect(len(kit.forwarded(message)) == 1, f"the command was told {len(kit.forwarded(message))} times")
    return f"{len(copies)} copies, {pauses} ms apart; then {words}"


@rule(ROLE, "R20.5")
async def takes_a_repetition_once(kit: AirKit) -> str:
    """A PUBLISH that comes again is acknowledged again, and is at the broker once; one with an older id is dropped."""
    air, topic = kit.air, kit.fog_side.commands_result(1, "arm")
    mark, heard = len(air.came), len(kit.fog.heard)
    first, last = air.next_id, air.next_id

    def say(msg_id: int, dup: int) -> None:
        air.send(wire.PUBLISH, QOS_1 | PREDEFINED | dup, air.id_of(topic), msg_id, rest=b"word")

    def pubacks() -> list[int]:
        return [one.msg_id for one in air.packets(wire.PUBACK, mark)]

    say(last, 0)
    await air.until(pubacks, PATIENCE_S)
    say(last, DUP)
    say(first, 0)
    await air.until(lambda: pubacks().count(last) == 2, PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    expect(pubacks() == [last, last], f"PUBACKs of {pubacks()}; sent were {last} twice, then {first}")
    came = [one for one in kit.at_broker(topic, heard) if one.payload == b"word"]
    expect(len(came) == 1, f"at the broker it came {len(came)} times")
    return "two copies: two PUBACKs, one message; an older id: nothing"


@rule(ROLE, "R20.1", "R20.2", "R20.6")
async def serves_by_names(kit: AirKit) -> str:
    """A client that registers and subscribes by names is served, and hears each message by itself."""
    topic, state = kit.fog_side.commands(2), kit.fog_side.state(2, Heading.name)
    async with kit.client() as client:
        expect(await client.connect() == 0, "CONNACK with another return code than 0")
        regack = await client.ask(wire.REGISTER, wire.REGACK, 0, client.next_id, rest=state.encode())
        expect(regack.code == 0 and regack.topic, f"REGACK with return code {regack.code}, topic id {regack.topic}")
        suback = await client.subscribe(topic)
        expect(suback.code == 0 and suback.topic, f"SUBACK with return code {suback.code}, topic id {suback.topic}")
        heard = len(kit.fog.heard)
        client.send(wire.PUBLISH, NORMAL, regack.topic, 0, rest=b"\0")
        came = await kit.fog.until(lambda: kit.at_broker(state, heard), PATIENCE_S)
        expect(came, "a PUBLISH on the registered id did not come to the broker")
        for _ in range(2):
            kit.fog.publish(topic, b"\0")
        found: list[Packet] = await client.until(
            lambda: [p for p in client.packets(wire.PUBLISH) if p.topic == suback.topic][1:], PATIENCE_S
        )
        expect(found, "two messages for what was subscribed to by name: not told one by one")
        client.send(wire.DISCONNECT)
        await client.until(lambda: client.packets(wire.DISCONNECT), PATIENCE_S)
    return f"REGISTER: id {regack.topic}; SUBSCRIBE: id {suback.topic}, two messages one by one"


@rule(ROLE, "R20.2", "R20.8")
async def serves_a_drone_alone(kit: AirKit) -> str:
    """What a UAV client neither says nor hears has return code 2; who names another drone is disconnected."""
    async with kit.client() as client:
        await client.connect()
        for topic in (f"{kit.fog_side.root}+/commands", kit.fog_side.state(2, Heading.name)):
            code = (await client.subscribe(topic)).code
            expect(code == INVALID, f"SUBSCRIBE to {topic}: return code {code}, expected {INVALID}")
        code = await client.surely(PREDEFINED, client.id_of(kit.fog_side.commands(2)), b"\0")
        expect(code == INVALID, f"PUBLISH on droneY/commands: return code {code}, expected {INVALID}")
        mark, other = len(client.came), kit.fog_side.state(1, Heading.name).encode()
        client.send(wire.REGISTER, 0, client.next_id, rest=other)
        left = await client.until(lambda: client.packets(wire.DISCONNECT, mark), PATIENCE_S)
        expect(left, f"it named {other.decode()}, and is still there")
    return f"return code {INVALID}; DISCONNECT for another drone's topic"


@rule(ROLE, "R20.2", "R11.13")
async def lets_nobody_speak_to_all(kit: AirKit) -> str:
    """Nobody hears what is no list of the fleet on `fleet/revoked`, which every node hears; no will is taken for it."""
    sent, topic = 3, kit.fog_side.revoked
    async with kit.client() as client, kit.client() as other:
        for one in (client, other):
            await one.connect()
        await other.subscribe(other.id_of(topic))
        codes = {await client.surely(PREDEFINED, client.id_of(topic), b"no list") for _ in range(sent)}
        await asyncio.sleep(QUIET_S)
        came = other.packets(wire.PUBLISH)
        expect(not came, f"another client hears {topic} from who has no list of the fleet")
        expect(codes == {0}, f"PUBLISH on {topic}: return codes {sorted(codes)}, expected 0")
    async with kit.client() as client:
        await client.ask(wire.CONNECT, wire.WILLTOPICREQ, CLEAN | WILL, 1, KEEPALIVE_S, rest=client.name.encode())
        found = await client.ask(wire.WILLTOPIC, wire.CONNACK, QOS_1 | RETAIN, rest=topic.encode())
        expect(found.code != 0, f"a will on {topic}: CONNACK with return code 0")
    return f"{sent} payloads that are no list: return code 0, and nobody hears them; a will: refused"


@rule(ROLE, "R20.9", "R20.7")
async def publishes_the_will(kit: AirKit) -> str:
    """The will of who is silent for one and a half times its keep-alive, and of who leaves with a duration."""
    said, topic = [], kit.fog_side.reachable(2)
    for how, rest, keepalive_s, expected in (
        ("silence", b"", 2, 1),
        ("a duration", b"\0\1", 15, 1),
        ("none", b"", 15, 0),
    ):
        async with kit.client() as client:
            code = await client.connect(Presence(session=1, up=False), keepalive_s)
            expect(code == 0, f"CONNACK with return code {code}")
            heard, client.answers = len(kit.fog.heard), lambda packet: False
            client.send(wire.PINGREQ)
            began_ms = kit.clock.now_ms()
            if how != "silence":
                client.send(wire.DISCONNECT, rest=rest)
            came = partial(kit.at_broker, topic, heard)
            wills = await kit.fog.until(came, PATIENCE_S if expected else 1 + QUIET_S)
            expect(len(wills) == expected, f"{how}: {len(wills)} wills, expected {expected}")
            if how == "silence":
                after_ms = wills[0].at_ms - began_ms
                expect(after_ms >= 1500 * keepalive_s - GRACE_MS, f"will after {after_ms} ms of silence")
                said.append(f"after {after_ms / 1000:.1f} s of silence with a keep-alive of {keepalive_s} s")
    return f"{said[0]}; with a duration; without one none"


@rule(ROLE, "R20.9", "R20.11")
async def tells_strangers_to_come_anew(kit: AirKit) -> str:
    """A packet of somebody that it does not know is answered with DISCONNECT, a DISCONNECT with nothing."""
    async with kit.client() as client:
        await client.ask(wire.PINGREQ, wire.DISCONNECT)
        mark = len(client.came)
        client.send(wire.DISCONNECT)
        await asyncio.sleep(QUIET_S)
        expect(len(client.came) == mark, "a stranger's DISCONNECT was answered")
    return "DISCONNECT, and nothing to a DISCONNECT"


@rule(ROLE, "R20.13")
async def is_no_amplifier(kit: AirKit) -> str:
    """To an address that answers nothing go no more than three times the bytes that came from there."""
    topic = kit.fog_side.commands(2)
    async with kit.client() as client:
        client.answers = lambda packet: False
        await client.connect()
        await client.subscribe(client.id_of(topic))
        for _ in range(10):
            kit.fog.publish(topic, bytes(1000))
        await asyncio.sleep(ASKED_S)
        times = client.came_bytes / client.sent_bytes
        expect(times <= REFLECTED, f"{client.came_bytes} bytes for {client.sent_bytes}, and no PUBACK")
    return f"{client.came_bytes} bytes for {client.sent_bytes}"


@rule(ROLE, "R20.1", "R20.6")
async def its_packets_are_as_specified(kit: AirKit) -> str:
    """Every datagram is one packet of section 20 of at most 1,200 bytes; what waits leaves together."""
    air = kit.air
    expect(not air.faults, f"{air.faults[:1]}")
    mark, before = len(air.came), len(kit.one.commands)
    air.answers = lambda packet: not packet.is_sure
    messages = [kit.command(command) for command in (Arm(), Disarm(), Arm())]
    words, kit.one.words = kit.one.words, (Word.COMPLETED,)
    try:
        for message in messages:
            kit.publish(message)
        await air.until(lambda: air.packets(wire.PUBLISH, mark), PATIENCE_S)
        await asyncio.sleep(QUIET_S)
        air.answers = lambda packet: True
        for message in messages:
            await kit.comes_down(message)
    finally:
        air.answers, kit.one.words = (lambda packet: True), words
    sure = {one.msg_id for one in air.packets(wire.PUBLISH, mark) if one.is_sure}
    expect(len(sure) == 2, f"three commands, two of which waited, left in {len(sure)} PUBLISHes")
    longest = max(packet.size for packet in air.came)
    expect(longest <= wire.LARGEST, f"a datagram of {longest} bytes")
    return f"{len(kit.one.commands) - before} commands in 2 PUBLISHes; no datagram longer than {longest} bytes"


@rule(ROLE, "R20.10")
async def keeps_who_is_there(kit: AirKit) -> str:
    """Who greets with the id of a client that is there gets no connection: that one is asked, and stays."""
    mark = len(kit.air.came)
    async with kit.client(1) as thief:
        thief.name = kit.air.name
        for _ in range(3):
            thief.send(wire.CONNECT, CLEAN, 1, KEEPALIVE_S, rest=thief.name.encode())
            await asyncio.sleep(ASKED_S / 2)
        asked = kit.air.packets(wire.PINGREQ, mark)
        expect(asked, "the client that is there was not asked")
        served = [one for one in thief.packets(wire.CONNACK) if one.code == 0]
        expect(not served, "a second client with the same id was connected")
        expect(not kit.air.packets(wire.DISCONNECT, mark), "the client that is there was disconnected")
        words = await kit.outcome(kit.send(Arm()))
        expect(words.last is not None, f"afterwards the client that is there said `completed`; came {words}")
    return f"asked {len(asked)} times; then {words}"


async def check_activator_air(
    cloud_broker: BrokerAddress,
    fog_broker: BrokerAddress,
    gateway: Address,
    target: ActivatorTarget,
    on_finding: Callable[[Finding], None],
) -> list[Finding]:
    """Check an activator's gateway; raises ConfigurationError for a missing broker or a bad `run`."""
    topics, fog_side, clock = CloudSide(target.fog, target.prefix), FogSide(target.fog_root), SessionClock()
    values = {"broker": str(cloud_broker), "fog_broker": str(fog_broker), "fog": str(target.fog), "drones": "1,2"}
    values |= {"fog_root": target.fog_root, "air_sn": f"{gateway[0]}:{gateway[1]}"}
    subject, own = Subject(target.run, values, target.log), f"conformance-{secrets.token_hex(4)}"
    cloud, fog = Tap(cloud_broker, own, clock), Tap(fog_broker, f"{own}-fog", clock)
    await cloud.connect("--broker")
    await fog.connect("--fog-broker")
    kit, checked = AirKit(topics, fog_side, cloud, fog, subject, clock), RULES[ROLE]
    kit.gateway = gateway
    try:
        await clear_retained(fog, [fog_side.reachable(number) for number in (1, 2)])
        if subject.is_ours:
            await clear_retained(cloud, [topics.reachable, *(topics.drone_reachable(number) for number in (1, 2))])
        cloud.on_heard = kit.on_cloud
        await cloud.subscribe(f"{topics.root}#")
        await fog.subscribe(*(f"{fog_side.root}drone{number}/#" for number in (1, 2)))
        if subject.is_ours:
            await subject.start()
        return await check_met(kit.meet_all(), checked[0].name, checked, kit, on_finding)
    finally:
        await kit.close()
