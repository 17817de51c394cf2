"""Rules of an activator in a fleet that signs: what it accepts, what it passes on as signed, and what it signs."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import Word

from . import shapes
from .activator_signed_kit import PATIENCE_S, QUIET_S, Drone, SignedActivatorKit
from .readings import KIND, OTHER_KIND, SENSOR, Sensor
from .registry import RULES, Rule, expect, rule
from .sealed import STATION, parts
from .tap import Heard, Tap

ROLE = "signed activator"
_ROUTE = -65537


def rules() -> list[Rule]:
    """Every rule of an activator that signs, in the order in which it is checked."""
    return RULES[ROLE]


@rule(ROLE, "R12.6")
async def birth_carries_its_certificate(kit: SignedActivatorKit) -> str:
    """The birth has the activator's certificate, which the fleet's authority issued for fogX."""
    expect(kit.name in kit.speech.certificates, f"no certificate of {kit.name}: {'; '.join(kit.speech.wrong[:2])}")
    return f"the certificate of {kit.name}, of the fleet's authority"


@rule(ROLE, "R12.6", "R12.12")
async def passes_on_what_nodes_sign(kit: SignedActivatorKit) -> str:
    """Births and beacons of drones go to stations, and a station's birth to its drones, as they were signed."""
    for number, drone in kit.drones.items():
        topic = kit.topics.drone_birth(number)
        came = [heard for heard in kit.cloud.since(0, topic) if heard.payload]
        is_own = came and _same(came[-1].payload, kit.births[number])
        expect(is_own, f"{topic}: not the birth that drone {number} signed")
        expect(came[-1].retain, f"{topic} is not retained")
        await _comes(kit.cloud, kit.topics.drone_clock(number), drone.beacon(), f"the beacon of drone {number}")
        await _comes(drone.tap, kit.fog_side.stations(number), kit.births[0], "the birth of the station")
    return "births and beacons of 2 drones, and the station's birth at both"


@rule(ROLE, "R12.7", "R12.9", "R12.13")
async def registers_only_in_order(kit: SignedActivatorKit) -> str:
    """A registration that is not signed, not its owner's, not for this session, or not newer, is not answered."""
    said = []
    for what, changed in (
        ("unsigned", {"sign": False}),
        (f"signed by {kit.folder.guest().name}", {"seal": kit.folder.guest()}),
        ("another session's", {"activator_session": kit.session % (2**32 - 1) + 1}),
        ("without a counter", {"counter": None}),
        ("with a counter that was there", {"counter": 1}),
        ("without until_ms", {"until_ms": None}),
    ):
        expect(not await kit.registered(**changed), f"a registration {what}: its nonce came back")
        said.append(what)
    expect(await kit.registered(), f"a registration in order: no beacon with its nonce within {PATIENCE_S:g} s")
    return f"not answered: {', '.join(said)}; one in order was"


@rule(ROLE, "R12.8")
async def hands_each_drone_its_own(kit: SignedActivatorKit) -> str:
    """Of a broadcast each drone gets its own envelope as it was signed, at most with an earlier deadline beside it."""
    marks = {number: len(drone.commands) for number, drone in kit.drones.items()}
    first = kit.command(1)
    messages = {number: kit.command(number, seq=first.seq) for number in kit.drones}
    entries = {number: kit.envelope(number, message) for number, message in messages.items()}
    kit.cloud.publish(kit.topics.broadcast, kit.addressed(entries))
    for number, drone in kit.drones.items():
        came = await _comes_down(drone, marks[number])
        header, payload, signature = parts(came[0].payload)
        is_own = (payload, signature) == (entries[number].payload, entries[number].signature)
        expect(is_own, f"drone {number}: {came[0].payload[:24].hex(' ')} … is not what was signed for it")
        route, signed_ms = header.get(_ROUTE), messages[number].deadline_ms or 0
        expect(route is None or 0 <= route < signed_ms, f"drone {number}: route {route}, signed until {signed_ms}")
    return "each drone its own, as it was signed"


@rule(ROLE, "R12.8")
async def makes_a_deadline_earlier(kit: SignedActivatorKit) -> str:
    """Where its own deadline is earlier than the signed one, the drone is told."""
    mark, drone = len(kit.drones[1].commands), kit.drones[1]
    message = kit.command(1, ttl_ms=50_000)
    until_ms = drone.clock.now_ms() + 3000
    kit.cloud.publish(kit.topics.drone_commands(1), kit.addressed({1: kit.envelope(1, message)}, ttl_ms=3000))
    came = await _comes_down(drone, mark)
    route = parts(came[0].payload)[0].get(_ROUTE, message.deadline_ms or 0)
    expect(route <= until_ms + 250, f"signed for 50 s, due in 3 s: route {route}, no later than {until_ms} is allowed")
    return f"signed for 50 s, due in 3 s at the activator: route {until_ms - route} ms before that"


@rule(ROLE, "R12.9")
async def hears_only_what_is_signed(kit: SignedActivatorKit) -> str:
    """A command without its station's signature does not come down, and is not answered."""
    mark, said = len(kit.drones[1].commands), len(kit.cloud.heard)
    message = kit.command(1)
    forged = kit.drones[2].seal.sign("drone1/commands", encode(message))
    for payload in (encode(message), kit.addressed({1: forged}), kit.addressed({1: kit.envelope(2, message)})):
        kit.cloud.publish(kit.topics.drone_commands(1), payload)
        await asyncio.sleep(QUIET_S)
        expect(not kit.drones[1].commands[mark:], "a command that its station had not signed came down")
        expect(not kit.words(1, said), "a command that its station had not signed was answered")
    return "unsigned, signed by a drone, and signed for another drone: no word, nothing came down"


@rule(ROLE, "R12.10")
async def denies_whom_nothing_is_signed_for(kit: SignedActivatorKit) -> str:
    """A drone of a broadcast's roster for which nothing is signed is `denied(not_signed)`, by the activator."""
    said = len(kit.cloud.heard)
    kit.cloud.publish(kit.topics.broadcast, kit.addressed({1: kit.envelope(1, kit.command(1))}))
    came = await kit.cloud.until(lambda: kit.words(2, said), PATIENCE_S)
    expect(came, "a broadcast without an envelope for drone 2: no word about it")
    topic = kit.topics.drone_result(2, "arm").removeprefix(kit.topics.prefix)
    payload = kit.speech.checked(topic, came[0].payload, kit.name)
    expect(payload is not None, f"the word about drone 2 is not {kit.name}'s: {kit.speech.wrong[-1:]}")
    word = shapes.read("result", payload or b"")
    is_right = word["word"] == "denied" and word.get("reason", "").startswith("not_signed")
    expect(is_right, f"of drone 2 came {word['word']}({word.get('reason')}), expected denied(not_signed)")
    return f"drone 2: denied({word['reason']}), signed by {kit.name}"


@rule(ROLE, "R12.9", "R12.11")
async def passes_on_a_drones_words_alone(kit: SignedActivatorKit) -> str:
    """A drone's word comes up as it was signed, with when it came beside it; what no drone signed does not."""
    drone, said = kit.drones[1], len(kit.cloud.heard)
    mark = len(drone.commands)
    message = kit.command(1)
    kit.cloud.publish(kit.topics.drone_commands(1), kit.addressed({1: kit.envelope(1, message)}))
    await _comes_down(drone, mark)
    word = drone.word(message, Word.COMPLETED)
    drone.say(message, word)
    drone.say(message, kit.drones[2].seal.sign("drone1/commands_result/arm", word).encode())
    await asyncio.sleep(QUIET_S)
    expect(not kit.words(1, said), "a word that the drone had not signed came up")
    signed = drone.seal.sign("drone1/commands_result/arm", word)
    drone.say(message, signed.encode())
    came = await kit.cloud.until(lambda: kit.words(1, said), PATIENCE_S)
    expect(came and _same(came[0].payload, signed.encode()), "the drone's word did not come up as it was signed")
    route = parts(came[0].payload)[0].get(_ROUTE)
    is_route = isinstance(route, list) and len(route) == 2 and type(route[0]) is int and route[1] is False
    expect(is_route, f"route {route}, expected [relay_stamp, false]")
    return f"unsigned and of another drone: nothing; its own as it was signed, with the route {route}"


@rule(ROLE, "R10.6", "R12.11")
async def passes_on_words_together(kit: SignedActivatorKit) -> str:
    """Where words of a broadcast come together, each is as its drone signed it; first words may be left out."""
    expect(await kit.registered(bundles=True), "a registration that asks for bundles: its nonce did not come back")
    marks, said = {number: len(drone.commands) for number, drone in kit.drones.items()}, len(kit.cloud.heard)
    first = kit.command(1)
    messages = {number: kit.command(number, seq=first.seq) for number in kit.drones}
    entries = {number: kit.envelope(number, message) for number, message in messages.items()}
    kit.cloud.publish(kit.topics.broadcast, kit.addressed(entries))
    signed: list[tuple[int, bytes]] = []
    for number, drone in kit.drones.items():
        await _comes_down(drone, marks[number])
        for word in (Word.ACCEPTED, Word.COMPLETED):
            payload = drone.word(messages[number], word)
            signed.append((number, drone.seal.sign(f"drone{number}/commands_result/arm", payload).encode()))
    for number, payload in signed:
        kit.drones[number].say(messages[number], payload)
    await kit.cloud.until(lambda: {of for of, _ in kit.words_apart(said)} == {*kit.drones}, PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    came = kit.words_apart(said)
    for number in kit.drones:
        own = [parts(payload)[1:] for of, payload in signed if of == number]
        heard = [parts(payload)[1:] for of, payload in came if of == number]
        told = f"drone {number} signed {len(own)} words; came {len(heard)}, or others, or in another order"
        expect(heard in (own, own[-1:]), told)
    await kit.registered(bundles=None)
    return f"{len(came)} words of {len(kit.drones)} drones, each as it was signed"


@rule(ROLE, "R12.19", "R12.21")
async def passes_on_readings_that_are_signed(kit: SignedActivatorKit) -> str:
    """A reading goes up as its sensor signed it, and a station's word on it down; what they did not sign does not."""
    sensor, drone, up = Sensor(kit.folder), kit.drones[1], kit.topics.drone_sensor(1, SENSOR, KIND)
    below, mark = kit.fog_side.sensor(1, SENSOR, KIND), len(kit.cloud.heard)
    for payload in (sensor.measured(1), sensor.said(2, by=drone.seal), sensor.said(3, kind=OTHER_KIND)):
        drone.tap.publish(below, payload)
    await asyncio.sleep(QUIET_S)
    expect(not kit.cloud.since(mark, up), "a reading that its sensor had not signed, or not for this kind, came up")
    said = sensor.said(5)
    drone.tap.publish(below, said)
    came = await kit.cloud.until(lambda: kit.cloud.since(mark, up), PATIENCE_S)
    expect(came and came[0].payload == said, f"{up}: not the reading as its sensor signed it")
    heard, ack = len(drone.tap.heard), sensor.named(5)
    for payload in (ack, drone.seal.sign("drone1/sensor_ack", ack).encode()):
        kit.cloud.publish(kit.topics.drone_sensor_ack(1), payload)
    down = kit.fog_side.sensor_ack(1)
    await asyncio.sleep(QUIET_S)
    expect(not drone.tap.since(heard, down), f"what no station had signed came on {down}")
    signed = kit.station.sign("drone1/sensor_ack", ack).encode()
    kit.cloud.publish(kit.topics.drone_sensor_ack(1), signed)
    await _comes(drone.tap, down, signed, "the station's acknowledgement")
    return "unsigned, of a drone, of another kind: nothing; its own, and the station's word on it"


@rule(ROLE, "R12.17")
async def orders_its_leases_and_names_the_holder(kit: SignedActivatorKit) -> str:
    """Each lease has a higher counter than the one before, what the drone's clock read, and who is in control."""
    topic = kit.fog_side.init_connect(1)

    def leases() -> list[dict[str, Any]]:
        return [shapes.read("drone-lease", heard.payload) for heard in kit.drones[1].tap.since(0, topic)]

    def is_whole(lease: dict[str, Any]) -> bool:
        return (lease.get("holder"), lease.get("holder_session")) == (STATION, kit.gs_session) and "heard_ms" in lease

    found = await kit.drones[1].tap.until(lambda: any(is_whole(lease) for lease in leases()), PATIENCE_S)
    expect(found, f"no lease with heard_ms that names {STATION}; the last one is {leases()[-1:]}")
    counters = [lease.get("counter") or 0 for lease in leases()]
    expect(all(before < after for before, after in pairwise([0, *counters])), f"counters {counters}")
    return f"counters {counters}; {STATION} is named"


@rule(ROLE, "R12.1", "R12.2", "R12.4", "R12.5")
async def signs_what_it_says(kit: SignedActivatorKit) -> str:
    """Births, beacons, records and leases are COSE_Sign1 as R12.1 has it, and verify for their topics."""
    wrong = [*kit.speech.wrong, *kit.below.wrong]
    expect(not wrong, "; ".join(wrong[:3]))
    expect(kit.speech.verified and kit.below.verified, "nothing that is to be signed came on one of the brokers")
    return f"{kit.speech.verified} messages to stations and {kit.below.verified} leases were verified"


async def _comes(tap: Tap, topic: str, signed: bytes, what: str) -> None:
    """Wait until a message arrives as it was signed; raises Broken."""
    found = await tap.until(lambda: any(_same(heard.payload, signed) for heard in tap.since(0, topic)), PATIENCE_S)
    expect(found, f"{topic}: not {what} as it was signed, within {PATIENCE_S:g} s")


async def _comes_down(drone: Drone, mark: int) -> list[Heard]:
    """The commands that reached a drone since `mark`; raises Broken without one."""
    found: list[Heard] = await drone.tap.until(lambda: drone.commands[mark:], PATIENCE_S)
    expect(found, f"drone {drone.number}: the command did not come down within {PATIENCE_S:g} s")
    return found


def _same(payload: bytes, signed: bytes) -> bool:
    """Whether two envelopes have the same payload and signature; their unprotected headers may differ."""
    return bool(payload) and parts(payload)[1:] == parts(signed)[1:]
