"""The environment of an activator in a fleet that signs: the kit is its station `ops` and its drones 1 and 2."""

from __future__ import annotations

import contextlib
import secrets
from dataclasses import replace
from typing import Any

from mqttxt.core.clock import Beacon, RemoteClock, SessionClock, stamp
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.control import Control, Registration
from mqttxt.protocol.messages import BeaconMessage, CommandMessage, Presence, ResultMessage, Word
from mqttxt.protocol.topics import CloudSide, FogSide, station_reachable
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal

from . import shapes
from .registry import Broken
from .sealed import STATION, Folder, Speech, together
from .subject import Subject
from .tap import Heard, Tap, clear_retained

PATIENCE_S = 6.0
BIRTH_S = 30.0
QUIET_S = 0.4
"""How long to listen for a message that must not arrive."""
LEASE_S = 60
QUESTIONS, QUESTION_S = 5, 2.0
"""How many registrations ask for a beacon, and how long each waits for it (R12.13)."""


class Drone:
    """One drone, which answers leases with a beacon; `commands` has the received commands as they are."""

    def __init__(self, number: int, seal: Seal, tap: Tap, topics: FogSide, clock_topic: str) -> None:
        self._said_on = clock_topic
        self.number = number
        self.seal = seal
        self.tap = tap
        self.clock = SessionClock()
        self.commands: list[Heard] = []
        self._topics = topics

    def sealed(self, topic: str, payload: bytes, with_certificate: bool = False) -> bytes:
        return self.seal.sign(topic.removeprefix(self._topics.root), payload, with_certificate).encode()

    def born(self) -> bytes:
        """Publish birth and first beacon; returns the birth's bytes."""
        topic = self._topics.reachable(self.number)
        birth = self.sealed(topic, encode(Presence(session=self.clock.session, up=True)), with_certificate=True)
        self.tap.publish(topic, birth, retain=True)
        self.beacon()
        return birth

    def beacon(self, nonce: int | None = None) -> bytes:
        """Publish a beacon; returns its bytes."""
        held_ms = 0 if nonce is not None else None
        message = BeaconMessage(session=self.clock.session, now_ms=self.clock.now_ms(), nonce=nonce, held_ms=held_ms)
        payload = self.seal.sign(self._said_on, encode(message)).encode()
        self.tap.publish(self._topics.clock(self.number), payload, qos=0)
        return payload

    def word(self, message: CommandMessage, word: Word) -> bytes:
        """A word about a command, unsigned."""
        own = stamp(self.clock.now_ms())
        ids = (message.gs_session, message.seq, self.clock.session)
        return encode(ResultMessage(gs_session=ids[0], seq=ids[1], session=ids[2], stamp=own, word=word))

    def say(self, message: CommandMessage, payload: bytes) -> None:
        self.tap.publish(self._topics.commands_result(self.number, message.command.name), payload)

    def on_heard(self, heard: Heard) -> None:
        if heard.topic == self._topics.commands(self.number) and heard.payload:
            self.commands.append(heard)
        elif heard.topic == self._topics.init_connect(self.number) and heard.payload:
            with contextlib.suppress(Broken):  # the rule about signatures reports it
                lease = shapes.read("drone-lease", heard.payload)
                if lease["drone_session"] == self.clock.session:
                    self.beacon(lease["nonce"])


class SignedActivatorKit:
    """One activator, seen from both brokers. Times are milliseconds of the kit's clock."""

    def __init__(
        self,
        folder: Folder,
        topics: CloudSide,
        fog_side: FogSide,
        cloud: Tap,
        fog: dict[int, Tap],
        subject: Subject,
        clock: SessionClock,
    ) -> None:
        self.folder = folder
        self.topics = topics
        self.fog_side = fog_side
        self.cloud = cloud
        self.subject = subject
        self.clock = clock
        self.name = f"fog{topics.fog}"
        self.station = folder.seal(f"gs-{STATION}")
        self.gs_session = secrets.randbelow(2**32 - 1) + 1
        self.seq = self.counter = 0
        self.session = 0
        self.remote = RemoteClock(1)
        self.asked: dict[int, int] = {}
        self.echoed: set[int] = set()
        self.births: dict[int, bytes] = {}
        self.drones = {
            number: Drone(number, folder.seal(f"drone{number}"), tap, fog_side, f"{self.name}/drone{number}/clock")
            for number, tap in fog.items()
        }
        own = {topics.reachable, topics.clock, *map(topics.drone_reachable, fog)}
        self.speech = Speech(self.station.identity, lambda topic: self.name if topic in own else None, topics.prefix)
        leases = {fog_side.init_connect(number) for number in fog}
        self.below = Speech(self.station.identity, lambda topic: self.name if topic in leases else None, fog_side.root)
        cloud.read, cloud.on_heard = self.speech.read, self.on_cloud
        for number, tap in fog.items():
            tap.read, tap.on_heard = self.below.read, self.drones[number].on_heard

    def on_cloud(self, heard: Heard) -> None:
        """Take beacons."""
        if heard.topic != self.topics.clock:
            return
        with contextlib.suppress(Broken):  # the rule about signatures reports it
            beacon = shapes.read("beacon", heard.payload)
            nonce = beacon.get("nonce", -1)
            self.echoed.add(nonce)
            if beacon["session"] == self.remote.session:
                told = Beacon(beacon["session"], beacon["now_ms"], beacon.get("nonce"), beacon.get("held_ms"))
                self.remote.observe(told, heard.at_ms, self.asked.get(nonce))

    async def meet(self) -> None:
        """Wait for its birth, ask for a beacon, publish both drones' births, register; raises Broken."""
        topic = self.topics.reachable
        await self.cloud.until(lambda: self.cloud.since(0, topic) or self.subject.exit_code is not None, BIRTH_S)
        births = self.cloud.since(0, topic)
        if not births:
            raise Broken(f"no birth on {topic}: {self.subject.why_silent(f'{BIRTH_S:g} s')}")
        self.session = shapes.read("fog-presence", births[-1].payload)["session"]
        self.remote = RemoteClock(self.session)
        born = Presence(session=self.gs_session, up=True)
        on = station_reachable(STATION)
        self.births[0] = self.station.sign(on, encode(born), with_certificate=True).encode()
        self.cloud.publish(station_reachable(STATION, self.topics.prefix), self.births[0], retain=True)
        for _ in range(QUESTIONS):
            await self.registered(lease_s=0, until_ms=None)
            if await self.cloud.until(lambda: self.remote.last_beacon_ms is not None, QUESTION_S):
                break
        else:
            raise Broken(f"no beacon on {self.topics.clock} to {QUESTIONS} questions for it")
        self.births |= {number: drone.born() for number, drone in self.drones.items()}
        await self.registered()
        await self.cloud.until(lambda: all(self.is_up(number) for number in self.drones), PATIENCE_S)

    def is_up(self, drone: int) -> bool:
        records = self.cloud.since(0, self.topics.drone_reachable(drone))
        with contextlib.suppress(Broken):
            return bool(records) and bool(shapes.read("drone-record", records[-1].payload)["up"])
        return False

    def registration(self, **changed: Any) -> Registration:
        """A valid registration, but for the `changed` fields."""
        self.counter += 1
        valid = Registration(
            name=STATION,
            session=self.gs_session,
            nonce=secrets.randbelow(2**32),
            lease_s=LEASE_S,
            control=Control.WANT,
            activator_session=self.session,
            counter=self.counter,
            until_ms=self.remote.deadline_ms(self.clock.now_ms(), LEASE_S * 1000),
        )
        return replace(valid, **changed)

    async def registered(self, seal: Seal | None = None, sign: bool = True, **changed: Any) -> bool:
        """Register; returns whether a beacon echoes the nonce."""
        message = self.registration(**changed)
        self.asked[message.nonce] = self.clock.now_ms()
        topic = self.topics.init_connect
        said_on = topic.removeprefix(self.topics.prefix)
        payload = encode(message)
        signed = (seal or self.station).sign(said_on, payload, with_certificate=True).encode()
        self.cloud.publish(topic, signed if sign else payload)
        limit_s = PATIENCE_S if not changed and seal is None and sign else 2 * QUIET_S
        return bool(await self.cloud.until(lambda: message.nonce in self.echoed, limit_s))

    def command(self, drone: int, ttl_ms: int = 5000, seq: int | None = None) -> CommandMessage:
        """A command in a drone's own session and clock."""
        self.seq += seq is None
        own = self.drones[drone].clock
        return CommandMessage(
            gs_session=self.gs_session,
            seq=self.seq if seq is None else seq,
            executor_session=own.session,
            deadline_ms=own.now_ms() + ttl_ms,
            limit_s=10.0,
            epoch=0,
            command=Arm(),
        )

    def envelope(self, drone: int, message: CommandMessage) -> Envelope:
        return self.station.sign(f"drone{drone}/commands", encode(message))

    def addressed(self, entries: dict[int, Envelope], ttl_ms: int = 5000) -> bytes:
        """Signed commands: envelopes by drone, with the activator's session and a deadline in its clock."""
        deadline_ms = self.remote.deadline_ms(self.clock.now_ms(), ttl_ms)
        assert deadline_ms is not None
        return Addressed(self.session, max(0, deadline_ms), entries).encode()

    def words(self, drone: int, mark: int) -> list[Heard]:
        """The results of `arm` at a drone since `mark`, as received."""
        return self.cloud.since(mark, self.topics.drone_result(drone, "arm"))

    def words_apart(self, mark: int) -> list[tuple[int, bytes]]:
        """The signed words about `arm` since `mark`, alone or together, with their drones."""
        alone = {self.topics.drone_result(number, "arm"): number for number in self.drones}
        found: list[tuple[int, bytes]] = []
        for heard in self.cloud.heard[mark:]:
            if heard.topic in alone:
                found.append((alone[heard.topic], heard.payload))
            elif heard.topic == self.topics.fog_result("arm"):
                found += together(heard.payload)
        return found

    async def close(self) -> None:
        await self.subject.kill()
        await clear_retained(self.cloud, [station_reachable(STATION, self.topics.prefix)])
        await self.cloud.close()
        for drone in self.drones.values():
            await clear_retained(drone.tap, [self.fog_side.reachable(drone.number)])
            await drone.tap.close()
