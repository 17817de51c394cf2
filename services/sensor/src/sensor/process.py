"""A sensor node as a process: its connection, and the record of what it measured."""

from __future__ import annotations

import json
import time
from pathlib import Path

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.runner import Runner
from mqttxt.core.settings import Settings
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.readings import Reading
from mqttxt.protocol.topics import REVOKED
from mqttxt.security.identity import Identity
from mqttxt.security.seal import Seal

from .node import LINK, Dropped, Finished, Measured, SensorNode, SensorOptions

LONGEST_PAUSE_S = 1.0
"""The longest pause between connection attempts: a drone may be within reach for a short time only."""


class EventFile:
    """JSON lines of every reading measured or dropped, to check arrivals elsewhere; raises ConfigurationError."""

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(exist_ok=True)
            self._file = path.open("a", encoding="ascii", buffering=1)
        except OSError as error:
            raise ConfigurationError(f"--events {path}: cannot be written: {error.strerror}") from error

    def write(self, event: str, reading: Reading) -> None:
        message = reading.message
        line = {
            "event": event,
            "sensor": reading.sensor,
            "boot": message.boot,
            "seq": message.seq,
            "kind": reading.kind,
            "value": message.value,
            "unit": reading.unit,
            "time_ms": message.time_ms,
        }
        self._file.write(json.dumps(line) + "\n")


class SensorRunner(Runner):
    """Runs a sensor node until it is finished; `events` records its readings."""

    def __init__(
        self,
        broker: BrokerAddress,
        options: SensorOptions,
        settings: Settings,
        *,
        events: Path | None = None,
        ready_file: Path | None = None,
        identity: Identity | None = None,
        seal: Seal | None = None,
    ) -> None:
        clock = SessionClock()
        node = SensorNode(clock.session, options, settings, lambda: time.time_ns() // 1_000_000, seal)
        super().__init__(node, clock, ready_file, identity, {LINK: REVOKED}, patience_ms=None)
        self._events = EventFile(events) if events is not None else None
        client_id = f"mqttxt-sensor{options.number}-{clock.session:08x}"
        self.links[LINK] = MqttLink(
            LINK, broker, client_id, None, self, longest_pause_s=LONGEST_PAUSE_S, identity=identity
        )

        self.does |= {
            Measured: lambda event: self._write("reading", event.reading),
            Dropped: lambda event: self._write("dropped", event.reading),
            Finished: lambda _: self.finish(),
        }

    def _write(self, event: str, reading: Reading) -> None:
        if self._events is not None:
            self._events.write(event, reading)
