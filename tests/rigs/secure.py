"""A fleet with identities, and real Mosquittos with the configurations that `mqttxt broker` writes."""

from __future__ import annotations

import signal
from typing import Protocol, Self

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from mqttxt.core.address import BrokerAddress
from mqttxt.core.mqtt.tls import client_context
from mqttxt.security.authority import Authority
from mqttxt.security.broker import ACCESS_FILE, BrokerFiles
from mqttxt.security.identity import Identity
from tests.rigs.processes import Program, free_port, listens, wait_until
from tests.tools.node_programs import MOSQUITTO

WITNESS = "gs-witness"
"""A node without rights; a test lets it publish and receive everything, to see what is delivered."""


class SecureBroker(Program):
    """Mosquitto with the configuration of a broker's identity, which a test may change before the start."""

    def __init__(
        self,
        authority: Authority,
        name: str,
        prefix: str = "",
        host: str = "127.0.0.1",
        fogs: frozenset[int] = frozenset(),
        called: str | None = None,
        air: bool = False,
    ) -> None:
        self.host = host
        self.port = free_port()
        self.files = BrokerFiles(authority.folder / name, prefix, fogs=fogs, air=air)
        self.out = authority.folder.parent / f"files-{called or name}"
        self.configuration = self.files.write(self.out, host, self.port)
        super().__init__(self.out, called or name, str(MOSQUITTO), "-c", str(self.configuration))

    @property
    def address(self) -> BrokerAddress:
        return BrokerAddress(self.host, self.port, tls=True)

    def let_witness(self) -> None:
        """Append an entry for the witness to the access list."""
        path = self.out / ACCESS_FILE
        path.write_text(f"{path.read_text()}\nuser {WITNESS}\ntopic readwrite #\ntopic read $SYS/#\n")

    def start(self) -> Self:
        super().start()
        wait_until(lambda: listens(self.port, self.host) or self.exit_code is not None, f"broker on port {self.port}")
        assert self.exit_code is None, self.said()
        return self

    def reload(self) -> None:
        self.signal(signal.SIGHUP)


class Addressed(Protocol):
    """Where a node connects to."""

    @property
    def address(self) -> BrokerAddress: ...


class Node:
    """A plain MQTT client with a node's identity. Raises ConnectionError if the broker does not accept it.

    `topic` is what it subscribes to first: RabbitMQ disconnects who may not hear that.
    """

    def __init__(self, identity: Identity, broker: Addressed, topic: str = "#") -> None:
        self.name = identity.name
        self.heard: set[tuple[str, bytes]] = set()
        self._granted: set[int] = set()
        self._acknowledged: set[int] = set()
        self._is_ended = False
        self._client = Client(
            CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5, reconnect_on_failure=False
        )
        self._client.max_inflight_messages = 0
        self._client.on_message = self._on_message
        self._client.on_subscribe = lambda _c, _u, mid, _r, _p: self._granted.add(mid)
        self._client.on_publish = lambda _c, _u, mid, _r, _p: self._acknowledged.add(mid)
        self._client.on_disconnect = self._on_disconnect
        self._client.tls_set_context(client_context(identity))
        self._client.connect(broker.address.host, broker.address.port)
        self._client.loop_start()
        wait_until(lambda: self._client.is_connected() or not self._client.socket(), f"{self.name}: CONNACK")
        if not self._client.is_connected():
            self.close()
            raise ConnectionError(f"{self.name}: not accepted")
        self.subscribe(topic)

    def subscribe(self, topic: str) -> None:
        """Subscribe, and return when that is granted; everything due before has been delivered by then."""
        _, mid = self._client.subscribe(topic, qos=1)
        assert mid is not None
        wait_until(lambda: mid in self._granted, f"{self.name}: SUBACK")

    def catch_up(self) -> None:
        """Wait for a SUBACK, which follows everything that the broker had for this client."""
        self.subscribe("nothing/that/anybody/publishes")

    def publish(self, topics: list[str], payload: bytes) -> None:
        """Publish at QoS 1; returns when all are acknowledged or refused, or the broker has disconnected."""
        mids = [self._client.publish(topic, payload, qos=1).mid for topic in topics]
        wait_until(lambda: self._is_ended or self._acknowledged.issuperset(mids), f"{self.name}: PUBACKs")

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _on_disconnect(self, *_: object) -> None:
        self._is_ended = True

    def _on_message(self, _client: Client, _userdata: object, message: MQTTMessage) -> None:
        self.heard.add((message.topic, bytes(message.payload)))
