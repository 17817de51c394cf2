"""The UAV client as a process: the links to autopilot and broker, and the role between them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from ..core.address import BrokerAddress
from ..core.audit_log import AuditLog
from ..core.bond import Bond, connections
from ..core.clock import SessionClock
from ..core.hearing import STALL_MS
from ..core.mqtt.events import LinkEvents
from ..core.mqtt.link import MqttLink
from ..core.runner import Runner
from ..core.settings import Settings
from ..errors import ConfigurationError
from ..protocol.messages import CommandId
from ..protocol.policies import Policy
from ..protocol.topics import REVOKED, FogSide
from ..security.identity import Identity
from ..security.revocation import RevocationList
from ..security.seal import Seal
from .commands import LINK
from .effects import Journal, Led, Transmit
from .journal import JournalFile
from .journal_keeper import JournalKeeper
from .log_work import LogDone
from .logs.files import LogFiles
from .logs.port import LogPort
from .mavlink.autopilots import AUTOPILOTS, is_autopilots, kind_of
from .mavlink.frame_parser import Malformed
from .mavlink.link import AutopilotLink
from .mavlink.signing import Signing
from .mavlink.stamps import KEEP_EVERY_S, Stamps
from .mavlink.transports import AutopilotAddress
from .options import UavOptions
from .parameter_file import KEEP_EVERY_S as KEEP_PARAMETERS_S
from .parameter_file import ParameterFile
from .paths import Paths
from .recognition import Recognition
from .role import UavClient
from .sensors.carrier import SENSORS
from .sensors.port import SensorOptions, SensorPort

logger = logging.getLogger("mqttxt")

LIST_PATIENCE_MS = 3000
"""How long the activator has to publish the revocation list first: otherwise all drones of a fog would at once."""


class UavRunner(Runner):
    """Runs a UAV client: connects to the broker after the autopilot's heartbeat with the right system id.

    With a `seal` messages are signed, and only the activator of `fog` may give leases; with a `signing` MAVLink is
    signed. `second` is another broker of the same fog: both connections stay up. `audit` is the audit log,
    `parameters` keeps the parameter set that a station was given last, `logs` the autopilot's flight logs.
    """

    def __init__(
        self,
        drone: int,
        broker: BrokerAddress,
        autopilot: AutopilotAddress,
        journal: JournalFile,
        settings: Settings,
        *,
        second: BrokerAddress | None = None,
        topics: FogSide | None = None,
        ready_file: Path | None = None,
        options: UavOptions | None = None,
        sensors: SensorOptions | None = None,
        policies: dict[str, Policy] | None = None,
        identity: Identity | None = None,
        seal: Seal | None = None,
        fog: int = 0,
        signing: Signing | None = None,
        audit: AuditLog | None = None,
        parameters: ParameterFile | None = None,
        logs: LogFiles | None = None,
    ) -> None:
        clock = SessionClock()
        brokers = connections(LINK, broker, second)
        self.client = UavClient(
            drone,
            clock.session,
            settings,
            topics=topics,
            policies=policies,
            unfinished=journal.unfinished,
            forgotten=journal.forgotten,
            remembers=not journal.has_gap,
            options=options,
            seal=seal,
            fog=fog,
            kept_parameters=parameters.kept if parameters is not None else None,
            paths=Paths(next(iter(brokers)), settings.beacon_interval_ms) if second is not None else None,
            is_audited=audit.takes if audit is not None and audit.required else None,
        )
        self._parameters = parameters
        self._logs = LogPort(logs, self._on_log) if logs is not None else None
        lists = dict.fromkeys(brokers, self.client.topics.revoked)
        told = {SENSORS: REVOKED} if sensors is not None else None
        super().__init__(self.client, clock, ready_file, identity, lists, LIST_PATIENCE_MS, audit, told)
        self._keeper = JournalKeeper(journal, self._on_disk, self._on_journal_error)
        self._signing = signing
        self.does |= {Journal: self._journal, Transmit: self._transmit}
        if self._logs is not None:
            self.does |= self._logs.does
        self._autopilot = AutopilotLink(autopilot, drone, self._on_readable, self._on_malformed, signing)
        self._heard: asyncio.Event = asyncio.Event()
        self._recognition = Recognition(drone)
        self._wrong_id: int | None = None
        self._unknown_kind: Any = None
        client_id = f"mqttxt-drone{drone}-{clock.session:08x}"
        events: LinkEvents = self
        if second is not None:
            bond = events = self.bonds[LINK] = Bond(
                LINK, self, lambda lost: self.client.on_path(lost, clock.now_ms()), is_led=True
            )
            self.does[Led] = lambda led: bond.led(led.path, led.proof)
        self._to_fog: list[MqttLink] = []
        for name, each in brokers.items():
            own_id = client_id if second is None else f"{client_id}-{name.replace(' ', '')}"
            may_be_ended = seal is None and second is None
            link = MqttLink(
                name,
                each,
                own_id,
                self.client.will,
                events,
                identity=identity,
                may_be_ended=may_be_ended,
                root=self.client.topics.root,
                link=LINK,
            )
            self.links[name] = link
            self._to_fog.append(link)
            if second is not None:
                self.bonds[LINK].add(name, link)
        self._sensors: SensorPort | None = None
        if sensors is not None and self.client.carrier is not None:
            self._sensors = SensorPort(
                sensors, self.client.carrier, drone, self, self.carry_out, clock.now_ms, identity
            )
            self.links[SENSORS] = self._sensors.link
            self.does |= self._sensors.does

    async def run(self) -> None:
        try:
            await super().run()
        finally:
            await self._keeper.close()

    def jobs(self) -> list[Coroutine[Any, Any, None]]:
        sensors = self._sensors.jobs() if self._sensors is not None else []
        stamps = [self._keep_stamps(self._signing.stamps)] if self._signing is not None else []
        kept = [self._keep_parameters(self._parameters)] if self._parameters is not None else []
        logs = [self._logs.run()] if self._logs is not None else []
        return [self._autopilot.run(), self._connect_when_heard(), self._tick(), *stamps, *kept, *logs, *sensors]

    def tell_own_broker(self, newest: RevocationList) -> None:
        if self._sensors is not None:
            self._sensors.reload(newest)

    def _journal(self, effect: Journal) -> None:
        """Record an effect; an opened command starts at once if the journal's front has it, else once the disk has."""
        if self._keeper.record(effect):
            self.carry_out(self.client.desk.on_journalled(effect.id, self.clock.now_ms()))

    def _on_disk(self, command_id: CommandId, is_journalled: bool) -> None:
        desk = self.client.desk
        opened = desk.on_journalled if is_journalled else desk.on_not_journalled
        self.carry_out(opened(command_id, self.clock.now_ms()))

    def _on_log(self, done: LogDone) -> None:
        self.carry_out(self.client.on_log(done, self.clock.now_ms()))

    def _on_journal_error(self, error: OSError) -> None:
        self.count("journal", str(error.strerror or error))

    def _transmit(self, effect: Transmit) -> None:
        """Check the clock for the last time, immediately before the write."""
        before_ms = self.clock.now_ms()
        late = effect.not_after_ms is not None and before_ms > effect.not_after_ms
        written = not late and self._autopilot.write(effect.message, effect.source)
        if effect.ref is None:
            return
        after_ms = self.clock.now_ms()
        if written:
            self.carry_out(self.client.on_transmitted(effect.ref, after_ms))
        else:
            self.carry_out(self.client.on_refused(effect.ref, late, after_ms))

    async def _connect_when_heard(self) -> None:
        logger.info("waiting for the heartbeat of an autopilot at %s", self._autopilot.address)
        await self._heard.wait()
        if self._wrong_id is not None:
            raise ConfigurationError(
                f"--drone {self.client.drone}: the autopilot at {self._autopilot.address} has MAVLink system id "
                f"{self._wrong_id}; expected {self.client.drone}"
            )
        if self._unknown_kind is not None:
            known = ", ".join(f"{kind.name} ({number})" for number, kind in AUTOPILOTS.items())
            found = f"HEARTBEAT.autopilot is {self._unknown_kind.autopilot}, its type {self._unknown_kind.type}"
            raise ConfigurationError(f"--autopilot {self._autopilot.address}: {found}; expected {known}")
        logger.info("drone %d: heard its autopilot", self.client.drone)
        bonds = [bond.run() for bond in self.bonds.values()]
        await asyncio.gather(*(link.run() for link in self._to_fog), *bonds)

    def stood_still(self) -> None:
        self._autopilot.discard()
        self.client.desk.executor.stood_still()

    def _on_readable(self) -> None:
        if self.clock.now_ms() - self.ticked_ms > STALL_MS:  # this may be called before the tick that is overdue
            self.stood_still()
            return
        for message in self._autopilot.messages():
            if not self._heard.is_set():
                self._recognise(message)
            self.carry_out(self.client.on_mavlink(message, self.clock.now_ms()))

    def _recognise(self, message: Any) -> None:
        if message.get_srcSystem() == self.client.drone:
            self._recognition.on_own()
        if not is_autopilots(message):
            return
        sender, is_known = message.get_srcSystem(), kind_of(message) is not None
        system_id = self._recognition.on_heartbeat(sender, self.clock.now_ms(), is_known)
        if system_id is None:
            kind, which = ("other_system", f"MAVLink system id {sender}")
            if sender == self.client.drone:
                kind, which = ("other_kind", f"autopilot {message.autopilot}, type {message.type}")
            self.count(kind, f"a heartbeat of {which}")
            return
        if system_id != self.client.drone:
            self._wrong_id = system_id
        elif not is_known:
            self._unknown_kind = message
        self._heard.set()

    def _on_malformed(self, found: Malformed) -> None:
        self.count(found.kind, found.reason)

    async def _keep_stamps(self, stamps: Stamps) -> None:
        """Keep the file of MAVLink's time stamps ahead of the used ones; a write error is only counted."""
        while True:
            if stamps.is_due:
                try:
                    await asyncio.to_thread(stamps.keep)
                except ConfigurationError as error:
                    self.count("mavlink_time", str(error))
            await asyncio.sleep(KEEP_EVERY_S)

    async def _keep_parameters(self, file: ParameterFile) -> None:
        """Keep the newest parameter set that a station was given; a write error is only counted."""
        while True:
            given = self.client.parameters.newest_given
            if given is not None and given is not file.kept:
                try:
                    await asyncio.to_thread(file.keep, given)
                except ConfigurationError as error:
                    self.count("parameters", str(error))
            await asyncio.sleep(KEEP_PARAMETERS_S)
