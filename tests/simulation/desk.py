"""The gateway's desk and its missions with one drone whose words a test supplies, without any I/O."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, cast

from pymavlink.dialects.v20 import common as mavlink

from mqttxt import (
    Airframe,
    Armed,
    Command,
    CommandId,
    Drone,
    GroundStation,
    Home,
    KnownState,
    Outcome,
    Parameters,
    Plan,
    SentCommand,
    SetParameter,
    State,
    Word,
)
from mqttxt.errors import TransferFailed
from mqttxt.gateway.clients import Client, Clients
from mqttxt.gateway.control import ClientControl
from mqttxt.gateway.desk import Desk
from mqttxt.gateway.downloads import Downloads
from mqttxt.gateway.endpoints import Peer
from mqttxt.gateway.missions import Missions
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.parameter_copies import ParameterCopies
from mqttxt.gateway.parameters import MESSAGES as PARAMETER_MESSAGES
from mqttxt.gateway.parameters import ClientParameters
from mqttxt.gateway.plan_copies import PlanCopies
from mqttxt.gateway.settings import ClientSettings
from mqttxt.gateway.telemetry import View
from mqttxt.gateway.translation import Request
from mqttxt.gateway.uploads import Uploads
from mqttxt.gateway.work import Work
from mqttxt.protocol.parameters import ParameterSet
from mqttxt.station.heard import Record
from mqttxt.station.outcomes import last_word


class FakeDrone:
    """A drone whose words the test supplies; with `grants`, a claim gets control at once."""

    number = 1

    def __init__(self) -> None:
        self.sent: list[tuple[Command, Record[Outcome]]] = []
        self.is_controlled = False
        self.is_reachable = True
        self.holder: str | None = None
        self.grants = True
        self.error: Exception | None = None
        self.wanted = False
        self.plan: Plan | None = None
        self.downloads = 0
        self.uploads: list[tuple[Plan, asyncio.Future[Outcome]]] = []
        self.sets = [ParameterSet()]
        self.gate = asyncio.Event()
        self.gate.set()
        self.known: list[Parameters | None] = []

    def claim(self) -> None:
        self.wanted = True
        self.is_controlled = self.is_controlled or (self.grants and self.holder is None)

    def release(self) -> None:
        self.wanted = self.is_controlled = False

    async def take_over(self, timeout_s: float) -> None:
        self.is_controlled, self.holder = True, "gateway"

    def send(self, command: Command, *, ttl_s: float) -> SentCommand[Outcome, Outcome]:
        if self.error is not None:
            raise self.error
        record = Record[Outcome]()
        self.sent.append((command, record))
        return SentCommand(record, last_word)

    async def upload(self, plan: Plan, *, timeout_s: float) -> Outcome:
        if self.error is not None:
            raise self.error
        self.uploads.append((plan, asyncio.get_running_loop().create_future()))
        return await self.uploads[-1][1]

    async def download(self, *, timeout_s: float) -> Plan:
        await asyncio.sleep(0)
        if self.plan is None:
            raise TransferFailed("drone 1: plan: no_autopilot")
        self.downloads += 1
        return self.plan

    async def parameters(self, known: Parameters | None, *, timeout_s: float) -> Parameters:
        await self.gate.wait()
        if self.error is not None:
            raise self.error
        self.known.append(known)
        return Parameters(self.sets[0] if len(self.sets) == 1 else self.sets.pop(0))

    def set_parameter(self, name: str, value: float, *, ttl_s: float) -> SentCommand[Outcome, Outcome]:
        return self.send(SetParameter(name, value), ttl_s=ttl_s)

    @property
    def commands(self) -> list[Command]:
        return [command for command, _ in self.sent]


class FakeStation:
    name = "gateway"

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        async with asyncio.timeout(0.05):
            while not condition():
                await asyncio.sleep(0.001)


class Bench:
    """A desk with one drone; `heard` has the messages sent to each client."""

    def __init__(self, group: asyncio.TaskGroup, take_over: bool = False) -> None:
        self.now_ms = 100_000
        self.age_ms: int | None = 0
        self.drone = FakeDrone()
        self.states: tuple[State, ...] = (Airframe(PX4, 2), Armed(True), Home(47.0, 8.0, 488.0))
        self.clients = Clients()
        self.heard: dict[str, list[Any]] = {}
        self.peers: dict[str, Peer] = {}
        self.control = ClientControl(cast(GroundStation, FakeStation()), self.clients, lambda: self.now_ms, take_over)
        self.copies = PlanCopies()
        work = Work(self.control, self.view, lambda: self.now_ms, group, 5.0)
        self.uploads = Uploads(work, self.copies)
        self.missions = Missions(self.uploads, Downloads(work, self.copies, self.uploads))
        self.parameter_copies = ParameterCopies()
        settings = ClientSettings(work, self.parameter_copies, self._send_to_all)
        self.parameters = ClientParameters(work, self.parameter_copies, settings)
        self.desk = Desk(work, self.uploads)

    def view(self, drone: Any) -> View:
        known = {state.name: KnownState(state, self.age_ms) for state in self.states}
        return View(1, known, self.now_ms)

    def client(self, name: str = "qgc", system: int = 255) -> Client:
        heard = self.heard.setdefault(name, [])
        peer = Peer(name, lambda packet: heard.append(mavlink.MAVLink(None).decode(bytearray(packet))))
        self.peers[name] = peer
        client = Client(peer, system, 190)
        self.clients.on_heartbeat(client, self.now_ms)
        return client

    async def ask(self, client: Client, request: Request, confirmation: int = 0, *, is_late: bool = False) -> None:
        self.desk.on_request(client, cast(Drone, self.drone), request, confirmation, 10.0, is_late=is_late)
        await self.settle()

    async def say(self, word: Word, number: int = -1, **more: Any) -> None:
        """Supply the drone's word about the command sent last, or as number `number`."""
        command, record = self.drone.sent[number]
        outcome = Outcome(CommandId(1, 1), 1, 1, command.name, word, **more)
        record.hear(outcome)
        if outcome.is_last:
            record.end()
        await self.settle()

    async def send(self, client: Client, *messages: Any) -> None:
        """Send messages of the mission and the parameter protocol as a client."""
        for message in messages:
            decoded = mavlink.MAVLink(None).decode(bytearray(message.pack(mavlink.MAVLink(None, client.system, 190))))
            is_parameters = decoded.get_type() in PARAMETER_MESSAGES
            asked = self.parameters if is_parameters else self.missions
            asked.on_message(client, cast(Drone, self.drone), decoded)
            await self.settle()

    async def taken(self) -> None:
        """Let another station take the drone."""
        self.drone.holder, self.drone.is_controlled = "gs-ops", False
        self.desk.on_taken(1)
        self.control.on_taken(cast(Drone, self.drone), "gs-ops")
        await self.settle()

    async def carry(self, word: Word, number: int = -1, **more: Any) -> None:
        """Supply the drone's last word about the plan uploaded last, or as number `number`."""
        self.drone.uploads[number][1].set_result(Outcome(CommandId(1, 1), 1, 1, "upload_plan", word, **more))
        await self.settle()

    def of(self, kind: str, name: str = "qgc") -> list[Any]:
        """The messages of a kind that were sent to a client."""
        return [message for message in self.heard[name] if message.get_type() == kind]

    def _send_to_all(self, drone: int, messages: list[Any]) -> None:
        for peer in self.peers.values():
            for message in messages:
                peer.send(drone, message)

    async def settle(self) -> None:
        for _ in range(10):
            await asyncio.sleep(0)

    def pass_time(self, milliseconds: int) -> None:
        for _ in range(0, milliseconds, 50):
            self.now_ms += 50
            self.desk.tick(self.now_ms)
            self.missions.tick(self.now_ms)
            self.parameters.tick(self.now_ms)

    def acks(self, name: str = "qgc") -> list[tuple[int, int]]:
        found = [message for message in self.heard[name] if message.get_type() == "COMMAND_ACK"]
        assert all((ack.target_system, ack.target_component) == (255, 190) for ack in found if name == "qgc")
        return [(ack.command, ack.result) for ack in found]

    def texts(self, name: str = "qgc") -> list[str]:
        parts: dict[Any, str] = {}
        for number, message in enumerate(self.heard[name]):
            if message.get_type() == "STATUSTEXT":
                key = message.id or -number - 1
                parts[key] = parts.get(key, "") + message.text
        return list(parts.values())
