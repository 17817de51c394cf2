"""The environment of a ground station under test: the kit is its activator and its drone, and follows a script.

The kit plays the whole script before it judges, because a ground station acts on its own: it registers, renews, sends
commands for its user, and ends.
"""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cbor2

from mqttxt.core.clock import SessionClock, stamp
from mqttxt.protocol.codec import encode
from mqttxt.protocol.control import DroneRecord
from mqttxt.protocol.messages import (
    BeaconMessage,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
    RosterEntry,
    Word,
    WordTogether,
)
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery
from mqttxt.protocol.topics import CloudSide
from mqttxt.protocol.values import Encoding

from . import shapes
from .deaf import SILENT_S
from .readings import Sensor
from .registry import Broken
from .sealed import Folder
from .secured import SecuredFog
from .subject import Subject
from .tap import NOBODY_SUBSCRIBED, Heard, Tap, clear_retained

APPEAR_S = 60.0
"""How long a ground station may take to register, and then to send its first command."""
NEXT_S = 4.0
"""How long to wait for a further command after the answers to the previous ones."""
BEACON_HELD_S = 0.4
"""A simulated delay of each beacon: deadlines made from it must be earlier by that."""
RATE = 0.002
"""2 rho of R4.4."""
EPOCH = 3
LONGEST_LEASE_S = 60


@dataclass(frozen=True)
class Timed:
    """A received command or registration, the latest deadline that R4.4 allows it, and the session that it is for."""

    heard: Heard
    fields: dict[str, Any]
    latest_ms: float
    session: int
    """Of the kit's activator or, for a command where messages are signed, of its drone."""


class GsKit:
    """One ground station, seen from the cloud broker. Times are milliseconds of the kit's clock."""

    def __init__(
        self,
        fog: int,
        drone: int,
        prefix: str,
        tap: Tap,
        subject: Subject,
        clock: SessionClock,
        ttl_s: float,
        secured: SecuredFog | None = None,
    ) -> None:
        self.secured = secured
        self.twin = tap
        """A connection that may publish on the station's own topics."""
        self.topics = CloudSide(fog, prefix)
        self.drone = drone
        self.prefix = prefix
        self.tap = tap
        self.subject = subject
        self.clock = clock
        self.ttl_ms = round(ttl_s * 1000)
        self.activator = SessionClock()
        self.sessions: list[int] = []
        self.enrolments: list[Timed] = []
        self.commands: list[Timed] = []
        self.malformed: list[str] = []
        self.grants: list[tuple[Heard, dict[str, Any], float]] = []
        self.forged_ms: int | None = None
        self.sensor: Sensor | None = None
        self.measured: list[int] = []
        """`seq` of the readings that the sensor signed; `acknowledged` has the station's acknowledgements."""
        self.acknowledged: list[Heard] = []
        self.unheard: list[str] | None = None
        self.presence_topic: str | None = None
        self.anew_ms = 0
        self.answered: dict[bytes, int] = {}
        self.together: list[Timed] = []
        """Broadcasts that the kit answered with words together."""
        self.upset_ms: int | None = None
        self.is_mute = False
        """Whether it publishes nothing that the station hears."""
        self.hushed: tuple[int, int] | None = None
        """How many messages had come, and the time, when the kit fell silent."""
        self.killed_mark: int | None = None
        self.stopped_mark: int | None = None
        self.exit_code: int | None = None
        self._beacons: list[tuple[int, int]] = []
        self._tasks: set[asyncio.Task[Any]] = set()

    # Messages that the kit publishes as an activator.

    async def appear(self) -> None:
        """Publish the birth of a new activator session with one drone."""
        self.activator = SessionClock()
        self._beacons.clear()
        self.sessions.append(self.activator.session)
        drones = (RosterEntry(drone=self.drone, session=self.drone_session),)
        birth = FogPresence(session=self.activator.session, up=True, authenticated=False, drones=drones)
        await self.tap.publish(self.topics.reachable, encode(birth), retain=True)
        if self.secured is not None:
            own = encode(Presence(session=self.drone_session, up=True))
            self.tap.publish(self.topics.drone_birth(self.drone), own, retain=True)
        self._tell_record()
        self._beacon(None)

    @property
    def drone_session(self) -> int:
        return self.activator.session % (2**32 - 1) + 1

    def _tell_record(self) -> None:
        if self.is_mute:
            return
        newest = self.enrolments[-1].fields if self.enrolments else None
        record = DroneRecord(
            activator_session=self.activator.session,
            up=True,
            drone_session=self.drone_session,
            holder=newest["name"] if newest else None,
            holder_session=newest["session"] if newest else None,
            epoch=EPOCH,
        )
        self.tap.publish(self.topics.drone_reachable(self.drone), encode(record), retain=True)

    def _beacon(self, nonce: int | None) -> None:
        """Publish a beacon after a delay of BEACON_HELD_S."""
        if self.is_mute:
            return
        held_ms = 0 if nonce is not None else None
        now_ms = self.activator.now_ms()
        message = BeaconMessage(session=self.activator.session, now_ms=now_ms, nonce=nonce, held_ms=held_ms)
        self._later(self._publish_beacon(message))

    async def _publish_beacon(self, message: BeaconMessage) -> None:
        await asyncio.sleep(BEACON_HELD_S)
        if message.session == self.activator.session:
            self._beacons.append((self.clock.now_ms(), message.now_ms))
            self.tap.publish(self.topics.clock, encode(message), qos=0)
            if self.secured is not None:  # the drone's clock is the activator's
                own = BeaconMessage(session=self.drone_session, now_ms=message.now_ms)
                self.tap.publish(self.topics.drone_clock(self.drone), encode(own), qos=0)

    def _later(self, job: Any) -> None:
        task = asyncio.create_task(job)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def answer(self, command: Timed, *words: Word) -> None:
        """Publish the drone's words about a command."""
        self.answered[command.heard.payload] = self.clock.now_ms()
        if command.heard.topic == self.topics.broadcast:
            message = FogResultMessage(
                gs_session=command.fields["gs_session"],
                seq=command.fields["seq"],
                session=self.activator.session,
                stamp=stamp(self.activator.now_ms()),
                roster=(RosterEntry(drone=self.drone, session=self.drone_session),),
            )
            if self.enrolments[-1].fields.get("bundles"):
                self._say_together(command, message, words)
                return
            self.tap.publish(self.topics.fog_result(command.fields["command"]), encode(message))
        for word in words:
            self.tap.publish(*self.word(command, word))

    def _say_together(self, command: Timed, about: FogResultMessage, words: tuple[Word, ...]) -> None:
        """Publish the drone's words about a broadcast with the roster in one message; signed ones follow the roster."""
        self.together.append(command)
        topic, results = self.topics.fog_result(command.fields["command"]), [self._result(command, w) for w in words]
        if self.secured is None:
            said = tuple(WordTogether.of(self.drone, result) for result in results)
            self.tap.publish(topic, encode(replace(about, words=said)))
            return
        self.tap.publish(topic, encode(about))
        own = self.topics.drone_result(self.drone, command.fields["command"])
        signed = [cbor2.loads(self.secured.sealed(own, encode(result))) for result in results]
        payload = cbor2.dumps([1, [[self.drone, envelope] for envelope in signed]], canonical=True)
        self.tap.publish(topic, payload, as_it_is=True)

    def word(self, command: Timed, word: Word) -> tuple[str, bytes]:
        return self.topics.drone_result(self.drone, command.fields["command"]), encode(self._result(command, word))

    def _result(self, command: Timed, word: Word) -> ResultMessage:
        now = stamp(self.activator.now_ms())
        return ResultMessage(
            gs_session=command.fields["gs_session"],
            seq=command.fields["seq"],
            session=self.drone_session,
            relay_stamp=now if self.secured is None else None,
            stamp=now,
            word=word,
        )

    # Messages that the kit receives.

    def on_heard(self, heard: Heard) -> None:
        try:
            if self.secured is not None and heard.topic == self.topics.drone_control(self.drone):
                self.grants.append((heard, shapes.read("grant", heard.payload), self.latest(heard.at_ms, 0)))
            elif heard.topic == self.topics.drone_sensor_ack(self.drone):
                self.acknowledged.append(heard)
            elif heard.topic == self.topics.init_connect:
                self._on_registration(heard, shapes.read("registration", heard.payload))
            elif heard.topic.endswith("/commands") and heard.payload:
                self._on_command(heard, shapes.read("command", heard.payload))
        except Broken as broken:
            self.malformed.append(f"{heard.topic}: {broken}")

    def latest(self, at_ms: int, length_ms: int) -> float:
        """The latest deadline that R4.4 allows, `length_ms` ahead, for a message that arrived at `at_ms`."""
        bounds = [told_ms + (at_ms - sent_ms) * (1 - RATE) for sent_ms, told_ms in self._beacons]
        return max(bounds, default=0.0) + length_ms * (1 - RATE)

    def _on_registration(self, heard: Heard, fields: dict[str, Any]) -> None:
        if fields["lease_s"] == 0 and fields.get("anew") and "activator_session" not in fields:
            return  # R6.13: it asks for the birth, which is retained
        if self.secured is not None and fields["lease_s"] == 0 and "until_ms" not in fields:
            self._beacon(fields["nonce"])  # R12.13: a station without a beacon asks for one
            return
        is_first = not self.enrolments
        latest_ms = self.latest(heard.at_ms, fields["lease_s"] * 1000)
        self.enrolments.append(Timed(heard, fields, latest_ms, self.activator.session))
        if is_first:
            self.presence_topic = f"{self.prefix}gs/{fields['name']}/reachable"
            self._later(self._probe())
        if fields["lease_s"] > 0:
            self._beacon(fields["nonce"])
            self._tell_record()

    def _on_command(self, heard: Heard, fields: dict[str, Any]) -> None:
        latest_ms = self.latest(heard.at_ms, self.ttl_ms)
        named = self.activator.session if self.secured is None else self.drone_session
        self.commands.append(Timed(heard, fields, latest_ms, named))

    async def _probe(self) -> None:
        """Find topics without a subscriber right after the first registration, if the broker reports that (0x10)."""
        stranger = secrets.randbelow(2**32 - 1) + 1
        beacon = BeaconMessage(session=stranger, now_ms=1)
        result = ResultMessage(gs_session=stranger, seq=1, session=stranger, stamp=1, word=Word.EXPIRED)
        state = encode_state(StampedState(Battery(50), 1, 1), Encoding.CBOR)
        probes = {
            self.topics.clock: encode(beacon),
            self.topics.drone_result(self.drone, "arm"): encode(result),
            self.topics.drone_state(self.drone, "battery"): state,
        }
        nowhere = f"{self.prefix}conformance/{secrets.token_hex(4)}"
        said = {nowhere: b"", **probes}
        futures = {topic: self.tap.publish(topic, payload, as_it_is=True) for topic, payload in said.items()}
        found = {topic: await future for topic, future in futures.items()}
        if found.pop(nowhere) == NOBODY_SUBSCRIBED:
            self.unheard = [topic for topic, code in found.items() if code == NOBODY_SUBSCRIBED]

    def last_words(self) -> list[dict[str, Any]]:
        """The presences of its last session since the kill; the will of the session before may arrive that late."""
        session = self.enrolments[-1].fields["session"]
        said = [presence for _, presence in self.presences(self.killed_mark or 0)]
        return [presence for presence in said if presence["session"] == session]

    def presences(self, mark: int = 0, end: int | None = None) -> list[tuple[Heard, dict[str, Any]]]:
        """The presences on any station's retained topic, without the kit's own."""
        below = f"{self.prefix}gs/"
        own = self.secured.speech.own if self.secured is not None else set()
        found = [
            heard
            for heard in self.tap.heard[mark:end]
            if heard.topic.startswith(below) and heard.payload and heard.payload not in own
        ]
        return [(heard, shapes.read("presence", heard.payload)) for heard in found]

    def births_in_silence(self) -> list[Heard]:
        """Its births so long after the kit fell silent that they answer nothing that it heard before (R9.1)."""
        mark, hushed_ms = self.hushed or (len(self.tap.heard), 0)
        session, from_ms = self.enrolments[-1].fields["session"], hushed_ms + (SILENT_S - 2) * 1000
        said = self.presences(mark, self.killed_mark)
        own = [heard for heard, presence in said if (presence["session"], presence["up"]) == (session, True)]
        return [heard for heard in own if heard.at_ms > from_ms]

    async def close(self) -> None:
        await self.subject.kill()
        for task in list(self._tasks):
            task.cancel()
        topics = [self.topics.reachable, self.topics.drone_reachable(self.drone)]
        topics += [self.topics.drone_birth(self.drone)] if self.secured is not None else []
        theirs = [command.heard.topic for command in self.commands if command.heard.retain]
        theirs += [f"{self.prefix}gs/{one.fields['name']}/reachable" for one in self.enrolments]
        await clear_retained(self.tap, set(topics))
        await clear_retained(self.twin, set(theirs))
        await self.tap.close()
        if self.twin is not self.tap:
            await self.twin.close()


@dataclass(frozen=True)
class GsTarget:
    """The ground station under test: the fog and drone that it commands, `ttl_s` of its commands, its command line."""

    fog: int
    drone: int
    prefix: str = ""
    ttl_s: float = 5.0
    run: str | None = None
    log: Path | None = None
    folder: Folder | None = None
