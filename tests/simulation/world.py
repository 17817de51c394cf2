"""The roles connected without any I/O: messages are delivered in order, at times that the test sets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Self

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.activator.role import Activator
from mqttxt.core.effects import Audit, Inbound, Log, Publish, Reconnect, Stop, Subscribe, Unsubscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.log_work import LogWork
from mqttxt.drone.logs.files import LogFiles
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import CommandMessage, ResultMessage
from mqttxt.protocol.values import Encoding
from mqttxt.security.seal import Seal
from mqttxt.station.role import StationRole
from tests.simulation.kept import Kept
from tests.simulation.signing import seal

GS_SESSION, FOG_SESSION, UAV_SESSION = 0x11, 0x22, 0x33
HOME = (473_977_420, 85_455_940, 488_000)
"""Degrees in 1e-7 and millimetres above mean sea level."""


def from_autopilot(message: Any, system: int = 1, component: int = 1) -> Any:
    """A message as the parser returns it, with its sender."""
    codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    (parsed,) = mavlink.MAVLink(None).parse_buffer(message.pack(codec))
    return parsed


def heartbeat(armed: bool = False, main: int = 4, sub: int = 3, system: int = 1, kind: int = 12) -> Any:
    base = 1 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return from_autopilot(mavlink.MAVLink_heartbeat_message(2, kind, base, main << 16 | sub << 24, 4, 3), system)


def ack(command: int, result: int = 0, progress: int = 0, source: Source = Source.COMPANION) -> Any:
    return from_autopilot(mavlink.MAVLink_command_ack_message(command, result, progress, 0, 1, source.component))


def position(altitude_m: float = 0.0, north_1e7: int = 0) -> Any:
    latitude, longitude, amsl_mm = HOME
    up_mm = round(altitude_m * 1000)
    return from_autopilot(
        mavlink.MAVLink_global_position_int_message(
            0, latitude + north_1e7, longitude, amsl_mm + up_mm, up_mm, 0, 0, 0, 9000
        )
    )


def landed(state: int) -> Any:
    return from_autopilot(mavlink.MAVLink_extended_sys_state_message(0, state))


def home() -> Any:
    return from_autopilot(mavlink.MAVLink_home_position_message(*HOME, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0))


def on_the_ground(kind: int = mavlink.MAV_AUTOPILOT_PX4) -> tuple[Any, ...]:
    """What an autopilot reports that is ready and disarmed."""
    return heartbeat(kind=kind), home(), position(), landed(1)


def connect(client: UavClient, now_ms: int) -> list[Any]:
    """Connect at the fog broker, which grants every subscription: what the client does then."""
    subscribes = [effect for effect in client.on_connected(FOG, now_ms) if isinstance(effect, Subscribe)]
    return [effect for subscribe in subscribes for effect in client.on_subscribed(subscribe, now_ms)]


def ready(client: UavClient, now_ms: int = 0) -> None:
    """Feed what the autopilot reports, and connect."""
    for message in on_the_ground():
        client.on_mavlink(message, now_ms)
    connect(client, now_ms)


def command_payload(command: Any, **changed: Any) -> CommandMessage:
    fields = {
        "gs_session": GS_SESSION,
        "seq": 1,
        "executor_session": UAV_SESSION,
        "deadline_ms": 5000,
        "limit_s": 60.0,
        "command": command,
    }
    return CommandMessage(**{**fields, **changed})


def results(effects: Iterable[Any]) -> list[ResultMessage]:
    """The results among the effects."""
    return [
        decode(ResultMessage, e.payload) for e in effects if isinstance(e, Publish) and "/commands_result/" in e.topic
    ]


def on_disk(client: UavClient, effects: Iterable[Any], now_ms: int) -> list[Any]:
    """The effects, each opening journal record followed by the effects of its being on disk."""
    out: list[Any] = []
    for effect in effects:
        out.append(effect)
        if isinstance(effect, Journal) and effect.is_opening:
            out += on_disk(client, client.desk.on_journalled(effect.id, now_ms), now_ms)
    return out


def transmitted(effects: Iterable[Any]) -> list[Any]:
    """The flight commands among the effects, without heartbeats and requests."""
    return [e for e in effects if isinstance(e, Transmit) and e.ref is not None]


@dataclass
class World:
    """A ground station, an activator and one drone, and everything that happened between them."""

    qos: int = 1
    encoding: Encoding = Encoding.CBOR
    bundles: bool = False
    signed: bool = False
    seal: Callable[[str], Seal | None] = seal
    """Makes a node's seal, where messages are signed."""
    now_ms: int = 0
    heard: list[Any] = field(default_factory=list)
    sent: list[tuple[str, Publish]] = field(default_factory=list)
    wrote: list[Transmit] = field(default_factory=list)
    journal: list[Journal] = field(default_factory=list)
    disk: Kept = field(default_factory=Kept)
    logs: list[Log] = field(default_factory=list)
    audited: list[tuple[str, Audit]] = field(default_factory=list)
    stops: list[Stop] = field(default_factory=list)
    reconnects: list[tuple[str, Reconnect]] = field(default_factory=list)
    retained: dict[tuple[str, str], Publish] = field(default_factory=dict)
    logs_folder: LogFiles | None = None
    """Where the UAV client keeps flight logs, if it does."""
    carries_sensors: bool = False
    drone: int = 1
    kind: int = mavlink.MAV_AUTOPILOT_PX4
    """MAV_AUTOPILOT in the heartbeats that a restarted UAV client receives."""
    shows: str = "all"
    """Retained messages that new subscribers get at the cloud broker: `all`, those `named` in full, or `nothing`."""
    drop: set[str] = field(default_factory=set)
    """Kinds of topics (their last or next to last level) that are lost on the way."""

    def __post_init__(self) -> None:
        self.settings = Settings(qos=self.qos, encoding=self.encoding, bundles=self.bundles)
        self.gs = StationRole("g", GS_SESSION, self.settings, seal=self._seal("gs-g"))
        self.activator = self._activator(FOG_SESSION)
        self.uav = self._uav(UAV_SESSION)
        self.subscribed: list[tuple[str, str, str, bool]] = []

    def _seal(self, name: str) -> Seal | None:
        return self.seal(name) if self.signed else None

    def _activator(self, session: int) -> Activator:
        return Activator(1, session, self.settings, drones=(1,), seal=self._seal("fog1"))

    def _uav(self, session: int, **left: Any) -> UavClient:
        keeps_logs = self.logs_folder is not None
        left.setdefault("options", UavOptions(keeps_logs=keeps_logs, carries_sensors=self.carries_sensors))
        return UavClient(self.drone, session, self.settings, seal=self._seal(f"drone{self.drone}"), fog=1, **left)

    def start(self, for_ms: int = 0) -> Self:
        """Connect everything, and let time pass: the drone becomes reachable, the ground station registers."""
        self.gs.add_fogs([1])
        self._connect_activator()
        self._connect_uav()
        self.run("gs", self.gs.on_connected(CLOUD, self.now_ms))
        self.pass_time(for_ms)
        return self

    def _connect_activator(self) -> None:
        for link in (FOG, CLOUD):
            self.run("activator", self.activator.on_connected(link, self.now_ms))

    def _connect_uav(self) -> None:
        for message in on_the_ground(self.kind):
            self.uav.on_mavlink(message, self.now_ms)
        self.run("uav", self.uav.on_connected(FOG, self.now_ms))

    def deafen(self, name: str) -> None:
        """End a role's subscriptions: it hears no more."""
        self.subscribed = [entry for entry in self.subscribed if entry[0] != name]

    def kill(self, name: str, link: str) -> None:
        """End a role, whose broker publishes its will."""
        self.deafen(name)
        will = getattr(self, name).will()
        self.route(name, Publish(link, will.topic, will.payload, 1, retain=True))

    def restart_activator(self, session: int) -> None:
        """Kill the activator, and start another one in its place."""
        self.kill("activator", CLOUD)
        self.activator = self._activator(session)
        self._connect_activator()

    def restart_uav(self, session: int, unfinished: list[Unfinished], remembers: bool = True) -> None:
        """Kill the UAV client, and start another one with the contents of the journal."""
        self.kill("uav", FOG)
        self.uav = self._uav(session, unfinished=unfinished, remembers=remembers)
        self._connect_uav()

    def hears(self, name: str, topic: str, payload: bytes, retain: bool = False) -> list[Any]:
        """What a role does with a message that its broker delivers, without carrying it out."""
        link = FOG if topic.startswith("drone") else CLOUD
        return list(getattr(self, name).on_message(link, Inbound(topic, payload, 1, retain), self.now_ms))

    def autopilot(self, *messages: Any) -> None:
        for message in messages:
            self.run("uav", self.uav.on_mavlink(message, self.now_ms))

    def send(self, command: Any, drone: int | None = 1, **options: Any) -> Any:
        command_id, outputs = self.gs.commands.send(self.gs.fog(1), drone, command, self.now_ms, **options)
        self.run("gs", outputs)
        return command_id

    def pass_time(self, milliseconds: int, step_ms: int = 100) -> None:
        """Let time pass; the autopilot keeps its heartbeat."""
        until = self.now_ms + milliseconds
        while self.now_ms < until:
            self.now_ms = min(until, self.now_ms + step_ms)
            self.uav.vehicle.heartbeat_ms = self.uav.vehicle.heard_ms = self.now_ms
            for name in ("uav", "activator", "gs"):
                self.run(name, getattr(self, name).tick(self.now_ms))

    def run(self, name: str, outputs: Iterable[Any]) -> None:
        """Carry out a role's outputs."""
        for output in outputs:
            if isinstance(output, Publish):
                self.sent.append((name, output))
                self.route(name, output)
            elif isinstance(output, Subscribe):
                self._subscribe(name, output)
            elif isinstance(output, Unsubscribe):
                self._unsubscribe(name, output)
            elif isinstance(output, Reconnect):
                self.reconnects.append((name, output))
                self._reconnect(name, output)
            elif isinstance(output, Transmit):
                self._write(output)
            elif isinstance(output, Journal):
                self.journal.append(output)
                taken = self.disk.takes(output)
                if output.is_opening:
                    desk = self.uav.desk
                    answer = desk.on_journalled if taken else desk.on_not_journalled
                    self.run("uav", answer(output.id, self.now_ms))
            elif isinstance(output, LogWork):
                assert self.logs_folder is not None
                done = self.logs_folder.carry_out(output)
                self.run("uav", self.uav.on_log(done, self.now_ms) if done is not None else [])
            elif isinstance(output, Log):
                self.logs.append(output)
            elif isinstance(output, Audit):
                self.audited.append((name, output))
            elif isinstance(output, Stop):
                self.stops.append(output)
            else:
                self.heard.append(output)

    def route(self, name: str, publish: Publish) -> None:
        """Act as the broker: keep retained messages, and deliver to subscribers."""
        if publish.retain:
            self.retained[publish.link, publish.topic] = publish
        levels = publish.topic.split("/")
        if self.drop & set(levels[-2:]):
            return
        found = [s for s in self.subscribed if s[1] == publish.link and matches(s[2], publish.topic)]
        receivers = list({entry[0]: entry for entry in found}.values())
        for receiver, _, _, live_only in receivers:
            self._deliver(receiver, publish, publish.retain and live_only)
        if publish.ref is not None and publish.qos > 0:
            code = 0 if receivers else 0x10
            role = getattr(self, name)
            self.run(name, role.on_published(publish.link, publish.ref, code, self.now_ms))

    def _unsubscribe(self, name: str, effect: Unsubscribe) -> None:
        gone = {(name, effect.link, topic) for topic in effect.filters}
        self.subscribed = [entry for entry in self.subscribed if entry[:3] not in gone]

    def _subscribe(self, name: str, effect: Subscribe) -> None:
        self.subscribed += [(name, effect.link, topic, effect.live_only) for topic in effect.filters]
        outputs = list(getattr(self, name).on_subscribed(effect, self.now_ms))
        if not effect.live_only:
            for link, topic in list(self.retained):
                if link == effect.link and any(self._shows(link, wanted, topic) for wanted in effect.filters):
                    self._deliver(name, self.retained[link, topic], True)
        self.run(name, outputs)

    def lose_subscriptions(self, name: str, link: str) -> None:
        """Act as a broker that keeps a connection but delivers nothing more over it."""
        self.subscribed = [entry for entry in self.subscribed if entry[:2] != (name, link)]

    def _reconnect(self, name: str, effect: Reconnect) -> None:
        self.lose_subscriptions(name, effect.link)
        role = getattr(self, name)
        will = role.will()
        self.route(name, Publish(effect.link, will.topic, will.payload, 1, retain=True))
        self.run(name, role.on_disconnected(effect.link, self.now_ms))
        self.run(name, role.on_connected(effect.link, self.now_ms))

    def _shows(self, link: str, wanted: str, topic: str) -> bool:
        """Whether a new subscriber to a filter gets the message that the broker retains on a topic."""
        if link == FOG or self.shows == "all":
            return matches(wanted, topic)
        return self.shows == "named" and wanted == topic

    def _deliver(self, name: str, publish: Publish, retained: bool) -> None:
        message = Inbound(publish.topic, publish.payload, publish.qos, retained)
        role = getattr(self, name)
        self.run(name, role.on_message(publish.link, message, self.now_ms))

    def _write(self, effect: Transmit) -> None:
        if effect.ref is None:
            return
        if effect.not_after_ms is not None and self.now_ms > effect.not_after_ms:
            self.run("uav", self.uav.on_refused(effect.ref, True, self.now_ms))
        else:
            self.wrote.append(effect)
            self.run("uav", self.uav.on_transmitted(effect.ref, self.now_ms))


def matches(wanted: str, topic: str) -> bool:
    """MQTT's topic filters (MQTT 5.0, 4.7)."""
    filters, levels = wanted.split("/"), topic.split("/")
    for index, one in enumerate(filters):
        if one == "#":
            return True
        if index >= len(levels) or one not in ("+", levels[index]):
            return False
    return len(filters) == len(levels)
