"""The environment of a UAV client under test: the kit is its activator and its autopilot."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import Beacon, RemoteClock, SessionClock
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command
from mqttxt.protocol.control import DroneLease, Grant
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.topics import FogSide
from mqttxt.protocol.values import Encoding
from mqttxt.security.seal import Seal

from . import shapes
from .autopilot import Autopilot, Manner, Written
from .registry import Broken, NotTested, expect
from .relay import Two
from .sealed import STATION, Folder
from .secured import SecuredUav
from .subject import Subject
from .tap import Heard, Line, clear_retained
from .words import Words, words_of

PATIENCE_S = 6.0
"""How long an answer may take for which no rule gives a time."""
BIRTH_S = 30.0
LEASE_MS = 60_000
QUIET_S = 0.4
"""How long to listen for a message that must not arrive."""
TOLD_S = 0.05
"""How long what the autopilot tells may be under way."""
FLIGHT_MM = 20_000
"""The height above home of a drone that flies."""
SLACK_MS = 250
"""The longest time assumed between the write of a datagram and its arrival at the kit."""


class UavKit:
    """One UAV client with its broker and its autopilot. Times are milliseconds of the kit's clock."""

    def __init__(
        self,
        drone: int,
        topics: FogSide,
        autopilot: Autopilot,
        tap: Line,
        subject: Subject,
        clock: SessionClock,
        secured: SecuredUav | None = None,
    ) -> None:
        self.secured = secured
        self.leads = True
        """Whether `publish` first gives the command's station the control that it needs (R6.8, R12.17)."""
        self._holder: int | None = None
        self._newest_ms = 0
        self.drone = drone
        self.topics = topics
        self.autopilot = autopilot
        self.tap = tap
        self.twin = tap
        """A connection that may publish on the drone's own topics."""
        self.broker: BrokerAddress | None = None
        """The broker of `tap`; None over datagrams."""
        self.audit: Path | None = None
        """The file of the client's audit log; None unless the kit has named it."""
        self._two: Two | None = None
        self.subject = subject
        self.clock = clock
        self.activator_session = self.clock.session
        self.session = 0
        self.remote = RemoteClock(1)
        self.epoch = 0
        self.open_command: CommandMessage | None = None
        self.states: list[tuple[Heard, int | None]] = []
        self.births: list[Heard] = []
        self.beacons: list[tuple[int, dict[str, Any]]] = []
        self.nonces: dict[int, int] = {}

    @property
    def two(self) -> Two:
        """The second broker of a client with two connections; raises NotTested without one."""
        if self._two is None:
            raise NotTested("needs --second-broker")
        return self._two

    def also_at(self, two: Two) -> None:
        """Act as the activator at a second broker too."""
        self._two = two

    async def meet(self, mark: int = 0) -> None:
        """Wait for a birth since `mark` and for a lease's echo; raises Broken without a birth or beacon."""
        topic = self.topics.reachable(self.drone)

        def born() -> Heard | None:
            found = [heard for heard in self.tap.since(mark, topic) if heard.payload]
            alive = [heard for heard in found if shapes.read("presence", heard.payload)["up"]]
            return alive[-1] if alive else None

        await self.tap.until(lambda: born() or self.subject.exit_code is not None, BIRTH_S)
        birth = born()
        if birth is None:
            raise Broken(f"no birth on {topic}: {self.subject.why_silent(f'{BIRTH_S:g} s of heartbeats')}")
        self.births.append(birth)
        self.session = shapes.read("presence", birth.payload)["session"]
        self.remote = RemoteClock(self.session)
        self._holder, self._newest_ms = None, 0
        for at_ms, beacon in self.beacons:
            if beacon["session"] == self.session:
                self.observe(at_ms, beacon)
        await self.echo()
        if self.remote.last_beacon_ms is None:
            raise Broken(f"no beacon on {self.topics.clock(self.drone)}: no deadline can be made")

    def on_heard(self, heard: Heard) -> None:
        """Take beacons; keep each state with the latest time that the drone's clock can have read at its arrival."""
        latest_ms = self.remote.latest_now_ms(heard.at_ms)
        if heard.topic.startswith(self.topics.state(self.drone, "")):
            self.states.append((heard, latest_ms))
        elif heard.topic == self.topics.states(self.drone):
            with contextlib.suppress(Broken):  # the rule about states checks the same message
                for name, payload in shapes.unbundled(heard.payload):
                    topic = self.topics.state(self.drone, name)
                    self.states.append((replace(heard, topic=topic, payload=payload), latest_ms))
        if heard.topic != self.topics.clock(self.drone):
            return
        try:
            beacon = shapes.read("beacon", heard.payload)
        except Broken:
            return
        self.beacons.append((heard.at_ms, beacon))
        if beacon["session"] == self.remote.session:
            self.observe(heard.at_ms, beacon)

    def observe(self, at_ms: int, beacon: dict[str, Any]) -> None:
        self._newest_ms = max(self._newest_ms, beacon["now_ms"])
        told = Beacon(beacon["session"], beacon["now_ms"], beacon.get("nonce"), beacon.get("held_ms"))
        self.remote.observe(told, at_ms, self.nonces.get(beacon.get("nonce", -1)))

    async def echo(self, **changed: Any) -> dict[str, Any] | None:
        """Publish a lease; returns the beacon that echoes its nonce, None without one."""
        nonce = self.lease(**changed)
        found = await self.tap.until(lambda: [b for _, b in self.beacons if b.get("nonce") == nonce], PATIENCE_S)
        return found[0] if found else None

    def lease(self, *, granted: bool = True, **changed: Any) -> int:
        """Publish a lease for the session under test and, if `granted`, its station's grant; returns the nonce."""
        nonce = secrets.randbelow(2**32)
        self.nonces[nonce] = self.clock.now_ms()
        fields: dict[str, Any] = {
            "activator_session": self.activator_session,
            "drone_session": self.session,
            "nonce": nonce,
            "bound": True,
            "epoch": self.epoch,
        }
        if self.secured is not None:
            self.secured.counter += 1
            fields |= {"counter": self.secured.counter, "heard_ms": self._newest_ms}
            if changed.get("holder_session") is not None:
                fields["holder"] = STATION
        lease = DroneLease(**(fields | changed))
        self._holder = lease.holder_session
        if lease.holder_session is not None and granted:
            self.introduce(lease.holder_session)
            self.grant(lease.holder_session, lease.deadline_ms, lease.offboard_until_ms)
        for tap in (self.tap, *((self._two.tap,) if self._two is not None else ())):
            tap.publish(self.topics.init_connect(self.drone), encode(lease))
        return nonce

    def introduce(self, gs_session: int, seal: Seal | None = None) -> None:
        """Where messages are signed, pass on a station's birth once per session; with `seal`, that station's always."""
        if self.secured is not None and (seal is not None or gs_session not in self.secured.introduced):
            self.secured.introduced.add(gs_session)
            payload = self.secured.birth(gs_session, seal)
            self.tap.publish(self.topics.stations(self.drone), payload, as_it_is=True)

    def grant(self, gs_session: int, until_ms: int | None, offboard_until_ms: int | None) -> None:
        """Where messages are signed, publish the station's grant: how long it has control."""
        if self.secured is None or until_ms is None:
            return
        grant = Grant(
            gs_session=gs_session,
            drone_session=self.session,
            until_ms=until_ms,
            offboard_until_ms=offboard_until_ms,
        )
        self.tap.publish(self.topics.control(self.drone), encode(grant))

    @property
    def signing(self) -> SecuredUav:
        """`secured`, for rules checked only where messages are signed."""
        assert self.secured is not None
        return self.secured

    def deadline(self, ttl_ms: int) -> int:
        """`ttl_ms` from now, in the clock of the session under test."""
        deadline_ms = self.remote.deadline_ms(self.clock.now_ms(), ttl_ms)
        assert deadline_ms is not None
        return max(0, deadline_ms)

    def command(self, command: Command | None = None, **changed: Any) -> CommandMessage:
        """A valid command of a new station, but for the `changed` fields; `ttl_ms` sets the deadline."""
        ttl_ms = changed.pop("ttl_ms", 5000)
        valid = CommandMessage(
            gs_session=secrets.randbelow(2**32 - 1) + 1,
            seq=1,
            executor_session=self.session,
            deadline_ms=self.deadline(ttl_ms),
            limit_s=10.0,
            epoch=self.epoch,
            command=command or Arm(),
        )
        message = replace(valid, **changed)
        self.introduce(message.gs_session)
        return message

    def lead(self, gs_session: int) -> None:
        """Give a station's session control for LEASE_MS, unless it has it. Unsigned it is enough that no other has."""
        if not self.leads or self._holder == gs_session:
            return
        if self.secured is not None:
            self.lease(holder_session=gs_session, deadline_ms=self.deadline(LEASE_MS))
        elif self._holder is not None:
            self.lease()

    def publish(self, message: CommandMessage, retain: bool = False, encoding: Encoding = Encoding.CBOR) -> None:
        self.lead(message.gs_session)
        self.publish_raw(encode(message, encoding), retain)

    def send(self, command: Command | None = None, **changed: Any) -> CommandMessage:
        """Publish a command as `command` makes it."""
        message = self.command(command, **changed)
        self.publish(message)
        return message

    async def accepted(self, command: Command) -> CommandMessage:
        """Publish a command, and wait until it is accepted."""
        message = self.send(command)
        await self.word(message, "accepted")
        return message

    def publish_raw(self, payload: bytes, retain: bool = False) -> None:
        self.tap.publish(self.topics.commands(self.drone), payload, retain=retain)

    def words(self, gs_session: int, seq: int = 1, mark: int = 0) -> Words:
        """The words so far about a command; raises Broken if one of its results is malformed."""
        below = f"{self.topics.root}drone{self.drone}/commands_result/"
        return words_of(self.tap.since(mark, below=below), below, gs_session, seq)

    async def outcome(self, message: CommandMessage, limit_s: float = PATIENCE_S, mark: int = 0) -> Words:
        """Wait for a command's last word; returns its words."""
        return await self.said(message.gs_session, limit_s, message.seq, mark)

    async def said(self, gs_session: int, limit_s: float, seq: int = 1, mark: int = 0) -> Words:
        """Wait for a command id's last word; returns its words."""
        await self.tap.until(lambda: self.words(gs_session, seq, mark).last, limit_s)
        return self.words(gs_session, seq, mark)

    async def word(self, message: CommandMessage, name: str, limit_s: float = PATIENCE_S) -> Words:
        """Wait until a command has the word `name`; returns its words."""
        await self.tap.until(lambda: name in self.words(message.gs_session, message.seq).names, limit_s)
        return self.words(message.gs_session, message.seq)

    async def refused(
        self, message: CommandMessage, word: str, reason: str | None = None, *, retain: bool = False
    ) -> tuple[Words, str]:
        """Send a command that must end with `word`, unwritten; returns words and evidence, raises Broken."""
        mark = len(self.autopilot.written)
        self.publish(message, retain)
        words = await self.outcome(message)
        await asyncio.sleep(QUIET_S)
        self.expect_unwritten(mark, f"{message.command.name} was written to the autopilot")
        wanted = word + (f"({reason})" if reason else "")
        last = words.last or {}
        expect(last.get("word") == word, f"expected {wanted}, came {words}")
        expect(reason is None or str(last.get("reason", "")).startswith(reason), f"expected {wanted}, came {words}")
        return words, f"came {words}; nothing was written"

    def expect_unwritten(self, mark: int, otherwise: str) -> None:
        written = self.autopilot.flights(mark)
        expect(not written, f"{otherwise}: {_written(written)}")

    async def written(self, mark: int, command: int, limit_s: float = PATIENCE_S) -> list[Written]:
        """Wait until a MAV_CMD has been written since `mark`; returns those messages."""
        found: list[Written] = await self.tap.until(lambda: self.autopilot.flights(mark, command), limit_s)
        return found

    async def unanswered(self, command: Command, number: int) -> tuple[CommandMessage, int]:
        """Send a command whose MAV_CMD `number` gets no COMMAND_ACK, and let it be written once.

        Returns the message, and the mark before its first write.
        """
        self.autopilot.manners[number] = Manner(result=None)
        message, mark = self.command(command), len(self.autopilot.written)
        self.publish(message)
        await self.written(mark, number)
        return message, mark

    def read_late(self, at_ms: int, deadline_ms: int) -> bool:
        """Whether a message that arrived at `at_ms` was surely written past a deadline of the drone's clock."""
        earliest = self.remote.deadline_ms(at_ms - SLACK_MS, 0)
        return earliest is not None and earliest > deadline_ms

    async def calm(self) -> None:
        """Reset the autopilot: disarmed, in hold, executing every command."""
        self.autopilot.reset()
        await self.show()

    async def fly(self) -> None:
        """Reset the autopilot as `calm` does, but armed and in the air."""
        await self.calm()
        self.autopilot.armed, self.autopilot.landed, self.autopilot.altitude_mm = True, 2, FLIGHT_MM
        await self.show()

    async def show(self, mode: tuple[int, int] | None = None) -> None:
        """Have the autopilot tell its state, in another mode if one is given, and let that arrive."""
        self.autopilot.mode = mode or self.autopilot.mode
        self.autopilot.tell()
        await asyncio.sleep(TOLD_S)

    async def close(self) -> None:
        await self.subject.kill()
        await clear_retained(self.twin, [self.topics.reachable(self.drone)])
        await clear_retained(self.tap, [self.topics.commands(self.drone)])
        if self._two is not None:
            await self._two.close(self.topics.reachable(self.drone))
        await self.autopilot.close()
        if self.twin is not self.tap:
            await self.twin.close()
        await self.tap.close()


def _written(written: list[Written]) -> str:
    return ", ".join(f"{one.message.get_type()} {one.command} at {one.at_ms} ms" for one in written)


@dataclass(frozen=True)
class UavTarget:
    """The UAV client under test: number, addresses, command line, and its fleet and fog if it has an identity.

    `second` is another broker of the same fog, for a client with two connections.
    """

    drone: int
    autopilot_host: str
    autopilot_port: int
    fog_root: str = ""
    run: str | None = None
    log: Path | None = None
    folder: Folder | None = None
    fog: int = 1
    second: BrokerAddress | None = None
