"""The activator as a process: its embedded broker, its two connections, and the role between them."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from ..core.address import BrokerAddress
from ..core.audit_log import AuditLog
from ..core.bond import Bond, connections
from ..core.clock import SessionClock
from ..core.embedded_broker import EmbeddedBroker
from ..core.mqtt.events import LinkEvents
from ..core.mqtt.link import MqttLink
from ..core.mqtt.sn.air import Air
from ..core.runner import Runner
from ..core.settings import Settings
from ..errors import ConfigurationError
from ..protocol.topics import CloudSide, FogSide
from ..security.identity import Identity
from ..security.revocation import RevocationList
from ..security.seal import Seal
from .drones import CLOUD, FOG
from .role import Activator


class ActivatorRunner(Runner):
    """Runs one fog's activator. `embedded` is its own broker, None if `fog_broker` runs elsewhere.

    `second` is another broker of the fog, for drones with two connections. `advertised` is the fog broker's address
    for others, if it differs from `fog_broker`. `identity` is the fog's, for `mqtts://` to both brokers; with a `seal`
    messages are signed. `audit` is the audit log. `air` is the host and port where UAV clients reach the activator by
    MQTT-SN. Raises ConfigurationError if both sides would use the same root at one broker.
    """

    def __init__(
        self,
        fog: int,
        cloud_broker: BrokerAddress,
        fog_broker: BrokerAddress,
        settings: Settings,
        *,
        drones: tuple[int, ...] = (),
        embedded: EmbeddedBroker | None = None,
        advertised: BrokerAddress | None = None,
        second: BrokerAddress | None = None,
        fog_root: str | None = None,
        prefix: str = "",
        ready_file: Path | None = None,
        identity: Identity | None = None,
        seal: Seal | None = None,
        audit: AuditLog | None = None,
        air: tuple[str, int] | None = None,
    ) -> None:
        cloud = CloudSide(fog, prefix)
        shared = (cloud_broker.host, cloud_broker.port) == (fog_broker.host, fog_broker.port)
        root = fog_root if fog_root is not None else cloud.local_root() if shared else ""
        if shared and root in ("", cloud.prefix, cloud.root):
            raise ConfigurationError(
                f"fog root {root!r}: expected another root than the cloud side's, because both sides use {cloud_broker}"
            )
        clock, fog_side = SessionClock(), FogSide(root)
        self.activator = Activator(
            fog,
            clock.session,
            settings,
            drones=drones,
            broker=str(advertised or fog_broker),
            cloud=cloud,
            fog_side=fog_side,
            seal=seal,
            has_paths=second is not None,
            is_audited=audit.takes if audit is not None and audit.required else None,
        )
        brokers = connections(FOG, fog_broker, second)
        lists = {CLOUD: cloud.revoked} | dict.fromkeys(brokers, fog_side.revoked)
        super().__init__(self.activator, clock, ready_file, identity, lists, audit=audit)
        self._embedded = embedded
        self._air: Air | None = None
        if air is not None:
            air_host, air_port = air
            self._air = Air(air_host, air_port, fog_broker, root, self.count, identity)
        self._waking: asyncio.TimerHandle | None = None
        client_id = f"mqttxt-fog{fog}-{clock.session:08x}"
        self.links[CLOUD] = MqttLink(
            CLOUD,
            cloud_broker,
            client_id,
            self.activator.will,
            self,
            identity=identity,
            may_be_ended=seal is None,
        )
        events: LinkEvents = self
        if second is not None:
            events = self.bonds[FOG] = Bond(
                FOG, self, lambda lost: self.activator.on_path(lost, clock.now_ms()), self.activator.path_of
            )
        for name, broker in brokers.items():
            own_id = f"{client_id}-{name.replace(' ', '')}"
            may_be_ended = seal is None and second is None
            self.links[name] = link = MqttLink(
                name, broker, own_id, None, events, identity=identity, may_be_ended=may_be_ended, link=FOG
            )
            if second is not None:
                self.bonds[FOG].add(name, link)

    def jobs(self) -> list[Coroutine[Any, Any, None]]:
        own = [each.run() for each in (self._embedded, self._air) if each is not None]
        return [*own, *super().jobs()]

    def carried_out(self) -> None:
        """Set a timer, so that words that wait for others are sent on time, not at the next tick."""
        due_ms = self.activator.together_due_ms
        if due_ms is not None and self._waking is None:
            pause_s = max(0, due_ms - self.clock.now_ms()) / 1000
            self._waking = asyncio.get_running_loop().call_later(pause_s, self._say_together)

    def _say_together(self) -> None:
        self._waking = None
        self.carry_out(self.activator.say_together(self.clock.now_ms()))

    def tell_own_broker(self, newest: RevocationList) -> None:
        if self._embedded is not None:
            self._embedded.reload(newest)
