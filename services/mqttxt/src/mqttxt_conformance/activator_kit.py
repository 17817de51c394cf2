"""The environment of an activator under test: the kit is its ground stations and UAV clients, on both brokers."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import Beacon, RemoteClock, SessionClock
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command
from mqttxt.protocol.control import Control, Registration
from mqttxt.protocol.messages import BeaconMessage, CommandMessage, Presence
from mqttxt.protocol.states import Armed, Battery, Endurance, Landed, LandedState, Location, MaxGroundspeed
from mqttxt.protocol.topics import CloudSide, FogSide, station_reachable

from . import shapes
from .fake_drone import FakeDrone, Forwarded
from .registry import Broken, expect
from .sealed import Folder
from .subject import Subject
from .tap import Heard, Tap, clear_retained
from .words import Words, words_of

PATIENCE_S = 5.0
BIRTH_S = 30.0
QUIET_S = 0.4
"""How long to listen for messages that must not arrive."""
LEASE_S = 600
HOUR_MS = 3_600_000


class Station:
    """One ground station of the kit."""

    def __init__(self, tap: Tap, topics: CloudSide, clock: SessionClock) -> None:
        self.name = f"conformance-{secrets.token_hex(3)}"
        self.session = secrets.randbelow(2**32 - 1) + 1
        self.seq = 0
        self.asked: dict[int, int] = {}
        self._tap = tap
        self._topics = topics
        self._clock = clock

    def register(self, lease_s: int = LEASE_S, control: Control = Control.WANT, **more: Any) -> int:
        """Publish a registration; returns its nonce."""
        nonce = secrets.randbelow(2**32)
        self.asked[nonce] = self._clock.now_ms()
        message = Registration(
            name=self.name, session=self.session, nonce=nonce, lease_s=lease_s, control=control, **more
        )
        self._tap.publish(self._topics.init_connect, encode(message))
        return nonce

    def gone(self) -> None:
        """Publish the station's will."""
        topic = station_reachable(self.name, self._topics.prefix)
        self._tap.publish(topic, encode(Presence(session=self.session, up=False)))


class ActivatorKit:
    """One activator, seen from both brokers. Times are milliseconds of the kit's clock."""

    def __init__(
        self,
        topics: CloudSide,
        fog_side: FogSide,
        cloud: Tap,
        fog: Tap,
        subject: Subject,
        clock: SessionClock,
        second: Tap | None = None,
    ) -> None:
        self.fogs = (fog,) if second is None else (fog, second)
        """The kit's connection to the fog's broker, or to each of two."""
        self.topics = topics
        self.fog_side = fog_side
        self.cloud = cloud
        self.fog = fog
        self.subject = subject
        self.clock = clock
        self.audit: Path | None = None
        """The file of the activator's audit log; None unless the kit has named it."""
        self.session = 0
        self.remote = RemoteClock(1)
        self.birth: Heard | None = None
        self.beacons: list[tuple[int, dict[str, Any]]] = []
        self.drones: dict[int, FakeDrone] = {}
        self.station = Station(cloud, topics, clock)
        self.stations = [self.station]
        self.rival: int | None = None
        self.records: dict[int, list[tuple[Heard, dict[str, Any]]]] = {}

    @property
    def one(self) -> FakeDrone:
        return self.drones[1]

    @property
    def two(self) -> FakeDrone:
        return self.drones[2]

    async def meet(self, mark: int = 0) -> None:
        """Wait for a birth and a beacon; raises Broken."""

        def born() -> Heard | None:
            found = [heard for heard in self.cloud.since(mark, self.topics.reachable) if heard.payload]
            alive = [heard for heard in found if shapes.read("fog-presence", heard.payload)["up"]]
            return alive[-1] if alive else None

        await self.cloud.until(lambda: born() or self.subject.exit_code is not None, BIRTH_S)
        self.birth = born()
        if self.birth is None:
            raise Broken(f"no birth on {self.topics.reachable}: {self.subject.why_silent(f'{BIRTH_S:g} s')}")
        self.session = shapes.read("fog-presence", self.birth.payload)["session"]
        self.remote = RemoteClock(self.session)
        for at_ms, beacon in self.beacons:
            if beacon["session"] == self.session:
                self._observe(at_ms, beacon)
        await self.cloud.until(lambda: self.remote.last_beacon_ms, 11)
        expect(self.remote.last_beacon_ms, f"no beacon on {self.topics.clock} within 11 s of the birth")

    async def add_drones(self) -> None:
        """Add drone 1, whose clock has just started, and drone 2, whose clock is an hour ahead of that."""
        await asyncio.sleep(1.0)
        self.drones = {
            1: FakeDrone(1, self.fog_side, self.fog),
            2: FakeDrone(2, self.fog_side, self.fog, ahead_ms=HOUR_MS),
        }
        for drone in self.drones.values():
            drone.born()
        await self.cloud.until(lambda: all(self.record(number).get("up") for number in self.drones), PATIENCE_S)

    def record(self, number: int) -> dict[str, Any]:
        """A drone's newest record, empty before the first."""
        found = self.records.get(number)
        return found[-1][1] if found else {}

    def on_cloud(self, heard: Heard) -> None:
        """Take beacons and records."""
        try:
            if self.rival is not None and heard.topic == self.topics.init_connect:
                self._answer_as_rival(self.rival, shapes.read("registration", heard.payload)["nonce"])
            if heard.topic == self.topics.clock:
                beacon = shapes.read("beacon", heard.payload)
                self.beacons.append((heard.at_ms, beacon))
                if beacon["session"] == self.remote.session:
                    self._observe(heard.at_ms, beacon)
            for number in (1, 2):
                if heard.topic == self.topics.drone_reachable(number) and heard.payload:
                    record = shapes.read("drone-record", heard.payload)
                    self.records.setdefault(number, []).append((heard, record))
        except Broken:
            return  # the rules about these messages check them again

    def _answer_as_rival(self, session: int, nonce: int) -> None:
        beacon = BeaconMessage(session=session, now_ms=self.clock.now_ms(), nonce=nonce, held_ms=0)
        self.cloud.publish(self.topics.clock, encode(beacon), qos=0)

    def on_fog(self, heard: Heard) -> None:
        for drone in self.drones.values():
            drone.on_heard(heard)

    def _observe(self, at_ms: int, beacon: dict[str, Any]) -> None:
        asked = {nonce: at for station in self.stations for nonce, at in station.asked.items()}
        told = Beacon(beacon["session"], beacon["now_ms"], beacon.get("nonce"), beacon.get("held_ms"))
        self.remote.observe(told, at_ms, asked.get(beacon.get("nonce", -1)))

    async def echoed(self, nonce: int) -> dict[str, Any] | None:
        """Wait for the beacon that echoes a nonce."""
        found = await self.cloud.until(lambda: [b for _, b in self.beacons if b.get("nonce") == nonce], PATIENCE_S)
        return found[0] if found else None

    def deadline(self, ttl_ms: int) -> int:
        deadline_ms = self.remote.deadline_ms(self.clock.now_ms(), ttl_ms)
        assert deadline_ms is not None
        return max(0, deadline_ms)

    def command(self, command: Command | None = None, **changed: Any) -> CommandMessage:
        """A valid command of the kit's station, but for the `changed` fields."""
        self.station.seq += 1
        ttl_ms = changed.pop("ttl_ms", 3000)
        valid = CommandMessage(
            gs_session=self.station.session,
            seq=self.station.seq,
            executor_session=self.session,
            deadline_ms=self.deadline(ttl_ms),
            limit_s=10.0,
            epoch=max((self.record(number).get("epoch", 0) for number in (1, 2)), default=0),
            command=command or Arm(),
        )
        return replace(valid, **changed)

    def publish(self, message: CommandMessage, drone: int | None = 1, **options: Any) -> None:
        topic = self.topics.broadcast if drone is None else self.topics.drone_commands(drone)
        self.cloud.publish(topic, encode(message), **options)

    def send(self, command: Command | None = None, *, to: int | None = 1, **changed: Any) -> CommandMessage:
        """Publish a command as `command` makes it, to a drone or, with None, to all."""
        message = self.command(command, **changed)
        self.publish(message, to)
        return message

    def words(self, message: CommandMessage, drone: int = 1, mark: int = 0) -> Words:
        """The words so far about a command and a drone, alone or together; raises Broken if a result is malformed."""
        below, of_fog = f"{self.topics.root}drone{drone}/commands_result/", f"{self.topics.root}commands_result/"
        found: list[Heard] = []
        for heard in self.cloud.since(mark, below=self.topics.root):
            if heard.topic.startswith(below):
                found.append(heard)
            elif heard.topic.startswith(of_fog):
                topic = below + heard.topic.removeprefix(of_fog)
                words = [payload for number, payload in shapes.apart(heard.payload) if number == drone]
                found += [replace(heard, topic=topic, payload=payload) for payload in words]
        return words_of(found, below, message.gs_session, message.seq)

    async def outcome(
        self, message: CommandMessage, drone: int = 1, limit_s: float = PATIENCE_S, mark: int = 0
    ) -> Words:
        """Wait for a command's last word; returns its words."""
        await self.cloud.until(lambda: self.words(message, drone, mark).last, limit_s)
        return self.words(message, drone, mark)

    def fog_results(self, message: CommandMessage, mark: int = 0) -> list[tuple[int, dict[str, Any]]]:
        """The fog-results of a command, each with its index among the received messages."""
        below = f"{self.topics.root}commands_result/"
        found = []
        for index, heard in enumerate(self.cloud.heard):
            if index >= mark and heard.topic.startswith(below):
                result = shapes.read("fog-result", heard.payload)
                if (result["gs_session"], result["seq"]) == (message.gs_session, message.seq):
                    found.append((index, result))
        return found

    async def refused(
        self, message: CommandMessage, word: str, reason: str | None = None, **options: Any
    ) -> tuple[Words, str]:
        """Send drone 1 a command that the activator must close itself; returns words and evidence, raises Broken."""
        self.publish(message, **options)
        words = await self.outcome(message)
        await asyncio.sleep(QUIET_S)
        self.expect_kept(message, f"came {words}")
        wanted = word + (f"({reason})" if reason else "")
        last = words.last or {}
        is_right = last.get("word") == word and (reason is None or str(last.get("reason", "")).startswith(reason))
        expect(is_right, f"expected {wanted}, came {words}")
        expect(last.get("session") == self.session, f"{words} in session {last.get('session')}, not the activator's")
        return words, f"came {words}; nothing went down"

    def expect_kept(self, message: CommandMessage, otherwise: str) -> None:
        gone = self.forwarded(message)
        expect(not gone, f"went down as {shapes.shown(gone[0].heard.payload) if gone else ''}; {otherwise}")

    def forwarded(self, message: CommandMessage, drone: int = 1) -> list[Forwarded]:
        """The copies of a command that reached a drone."""
        mine = (message.gs_session, message.seq)
        return [one for one in self.drones[drone].commands if (one.fields["gs_session"], one.fields["seq"]) == mine]

    async def comes_down(self, message: CommandMessage, drone: int = 1) -> Forwarded:
        """Wait for the first copy of a command at its drone; raises Broken."""
        found = await self.fog.until(lambda: self.forwarded(message, drone), PATIENCE_S)
        if not found:
            raise Broken(f"{message.command.name} did not come down; came {self.words(message, drone)}")
        first: Forwarded = found[0]
        return first

    def tell_all(self, distances: dict[int, float]) -> None:
        """Publish every state that the rankings use; `distances` has each drone's latitude in degrees."""
        for number, latitude_deg in distances.items():
            place, figures = Location(latitude_deg, 8.0, 500.0, 10.0), (Battery(90), MaxGroundspeed(10.0))
            for state in (place, *figures, Endurance(1800, 8.0), Armed(armed=True), LandedState(Landed.IN_AIR)):
                self.drones[number].state(state)

    def states(self, mark: int, drone: int = 1) -> list[tuple[Heard, str]]:
        below = f"{self.topics.root}drone{drone}/state/"
        return [(heard, heard.topic.removeprefix(below)) for heard in self.cloud.since(mark, below=below)]

    async def close(self) -> None:
        await self.subject.kill()
        drones = [self.topics.drone_reachable(number) for number in self.drones]
        await clear_retained(self.cloud, [self.topics.reachable, *drones])
        for fog in self.fogs:
            await clear_retained(fog, [self.fog_side.reachable(number) for number in self.drones])
            await fog.close()
        await self.cloud.close()


@dataclass(frozen=True)
class ActivatorTarget:
    """The activator under test: its fog and topic roots, its command line, and its fleet if that signs.

    `second` is another broker of its fog.
    """

    fog: int
    prefix: str = ""
    fog_root: str = ""
    run: str | None = None
    log: Path | None = None
    folder: Folder | None = None
    second: BrokerAddress | None = None
