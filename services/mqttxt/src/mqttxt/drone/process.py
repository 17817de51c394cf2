"""The UAV client as a process: an autopilot's link, a broker's, and the role between them."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.clock import SessionClock
from ..core.mqtt.link import BrokerAddress, MqttLink
from ..core.runner import Runner
from ..core.settings import Settings
from ..errors import ConfigurationError
from ..protocol.policies import Policy
from ..protocol.topics import FogSide
from ..security.identity import Identity
from ..security.seal import Seal
from .commands import LINK
from .effects import Journal, Transmit
from .journal import JournalFile
from .mavlink.autopilots import AUTOPILOTS, kind_of
from .mavlink.link import AutopilotAddress, AutopilotLink
from .mavlink.plans import AUTOPILOT_COMPONENT
from .options import UavOptions
from .recognition import Recognition
from .role import UavClient
from .sensors.carrier import SENSORS
from .sensors.port import SensorOptions, SensorPort

logger = logging.getLogger("mqttxt")


class UavRunner(Runner):
    """Runs a UAV client: first the autopilot's heartbeat with the right system id, then the broker.

    With a `seal` messages are signed, and `fog` is the one whose activator's leases the drone takes.
    """

    def __init__(
        self,
        drone: int,
        broker: BrokerAddress,
        autopilot: AutopilotAddress,
        journal: JournalFile,
        settings: Settings,
        *,
        topics: FogSide | None = None,
        ready_file: Path | None = None,
        options: UavOptions | None = None,
        sensors: SensorOptions | None = None,
        policies: dict[str, Policy] | None = None,
        identity: Identity | None = None,
        seal: Seal | None = None,
        fog: int = 0,
    ) -> None:
        clock = SessionClock()
        remembers = not journal.is_new
        left = journal.unfinished
        self.client = UavClient(
            drone, clock.session, settings, topics, policies, left, remembers, options, seal=seal, fog=fog
        )
        super().__init__(self.client, clock, ready_file, identity)
        self._journal = journal
        self._autopilot = AutopilotLink(autopilot, drone, self._on_mavlink, self._on_malformed)
        self._heard: asyncio.Event = asyncio.Event()
        self._recognition = Recognition(drone)
        self._wrong_id: int | None = None
        self._unknown_kind: Any = None
        client_id = f"mqttxt-drone{drone}-{clock.session:08x}"
        self.links[LINK] = MqttLink(LINK, broker, client_id, self.client.will(), self, identity=identity)
        self._sensors: SensorPort | None = None
        if sensors is not None and self.client.carrier is not None:
            self._sensors = SensorPort(
                sensors, self.client.carrier, drone, self, self.carry_out, clock.now_ms, identity
            )
            self.links[SENSORS] = self._sensors.link

    def jobs(self) -> list[Any]:
        sensors = self._sensors.jobs() if self._sensors is not None else []
        return [self._autopilot.run(), self._connect_when_heard(), self._tick(), *sensors]

    def read_again(self) -> None:
        super().read_again()
        if self._sensors is not None:
            self._sensors.reload()

    def special(self, output: Any) -> None:
        if isinstance(output, Journal):
            self._record(output)
        elif isinstance(output, Transmit):
            self._transmit(output)
        elif self._sensors is None or not self._sensors.take(output):
            super().special(output)

    def _record(self, effect: Journal) -> None:
        """Nothing is started that the journal does not have; a last word is true without it too."""
        try:
            self._journal.record(effect)
        except OSError as error:
            self.count("journal", str(error.strerror or error))
            if effect.is_opening:
                self.carry_out(self.client.on_not_journalled(effect.id, self.clock.now_ms()))
        else:
            if effect.is_opening:
                self.carry_out(self.client.on_journalled(effect.id, self.clock.now_ms()))

    def _transmit(self, effect: Transmit) -> None:
        """The last look at the clock is here, immediately before the write."""
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
        await self.links[LINK].run()

    def _on_mavlink(self, message: Any) -> None:
        if not self._heard.is_set():
            self._recognise(message)
        self.carry_out(self.client.on_mavlink(message, self.clock.now_ms()))

    def _recognise(self, message: Any) -> None:
        if message.get_srcSystem() == self.client.drone:
            self._recognition.on_own()
        if not _is_autopilot(message):
            return
        system_id = self._recognition.on_heartbeat(message.get_srcSystem(), self.clock.now_ms())
        if system_id is None:
            self.count("other_system", f"a heartbeat of MAVLink system id {message.get_srcSystem()}")
            return
        if system_id != self.client.drone:
            self._wrong_id = system_id
        elif kind_of(message) is None:
            self._unknown_kind = message
        self._heard.set()

    def _on_malformed(self, reason: str) -> None:
        self.count("mavlink_malformed", reason)


def _is_autopilot(message: Any) -> bool:
    """Whether a message is the heartbeat of a flight controller."""
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() != AUTOPILOT_COMPONENT:
        return False
    return bool(message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)
