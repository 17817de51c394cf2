"""Both ends of the air leg alone: the test sets the time and decides which datagrams pass."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from mqttxt.core.effects import Inbound, Publish, Subscribe, Will
from mqttxt.core.mqtt.sn import codec
from mqttxt.core.mqtt.sn.air_client import AirClient
from mqttxt.core.mqtt.sn.client import SnClient
from mqttxt.core.mqtt.sn.gateway import AirGateway
from mqttxt.core.mqtt.sn.packets import Packet
from mqttxt.core.mqtt.sn.together import AirMessage
from mqttxt.core.mqtt.sn.topic_ids import TopicIds

GATEWAY = ("gateway", 1883)
STEP_S = 0.05
WILL = Will("drone1/reachable", b"down")
COMMANDS, RESULT, STATE = "drone1/commands", "drone1/commands_result/arm", "drone1/state/location"

Port = tuple[str, int]


def id_of(topic: str) -> int:
    found = TopicIds().id_of(topic)
    assert found is not None
    return found


@dataclass
class BrokerSide:
    """The broker's side of a client; it grants and acknowledges at once, unless a test changes that."""

    client: Callable[[], AirClient]
    bench: AirBench
    will: Will | None = None
    published: list[AirMessage] = field(default_factory=list)
    subscribed: list[tuple[str, bool]] = field(default_factory=list)
    closed: list[bool] = field(default_factory=list)
    """For each closing, whether it was with the will."""
    client_id: str = ""

    def open(self, client_id: str, will: Will | None) -> None:
        self.client_id, self.will = client_id, will
        if self.bench.broker_answers:
            self.client().on_opened(self.bench.broker_code, self.bench.now_s)

    def publish(self, told: AirMessage, ref: Hashable) -> None:
        self.published.append(told)
        if ref is not None and self.bench.broker_answers:
            self.client().on_published(ref, self.bench.puback_code)

    def subscribe(self, topic: str, live_only: bool, ref: Hashable) -> None:
        self.subscribed.append((topic, live_only))
        if self.bench.broker_answers:
            self.client().on_subscribed(ref)

    def unsubscribe(self, topic: str) -> None:
        self.subscribed = [each for each in self.subscribed if each[0] != topic]

    def close(self, *, with_will: bool) -> None:
        self.closed.append(with_will)


class AirBench:
    """A gateway, and clients at their ports. `lose` decides by receiver and packet whether a datagram is lost."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.sides: list[BrokerSide] = []
        self.counted: list[str] = []
        self.sent: list[tuple[Port, Packet]] = []
        """Each datagram with its receiver, lost ones too."""
        self.lose: Callable[[Port, Packet], bool] = lambda port, packet: False
        self._carried: deque[Callable[[], None]] = deque()
        self._is_carrying = False
        self.broker_answers, self.broker_code, self.puback_code = True, 0, 0
        self.clients: dict[Port, BenchClient] = {}
        self.lists_read = 0
        self.newer_list: bytes | None = None
        """A revocation list that the activator does not have."""
        self.gateway = AirGateway(
            *(TopicIds(), self._to_client, self._side, lambda kind, detail: self.counted.append(kind)),
            self._is_newer_list,
        )

    def client(self, port: int = 1, client_id: str = "drone1-a", will: Will | None = WILL) -> BenchClient:
        """Make a UAV client that begins to connect."""
        made = BenchClient(self, ("drone", port), client_id, will)
        self.clients[made.port] = made
        made.machine.connect(self.now_s)
        return made

    def up(self, port: int = 1, client_id: str = "drone1-a") -> BenchClient:
        """Make a UAV client that is connected and accepts messages together."""
        client = self.client(port, client_id)
        assert client.codes == [0]
        assert client.machine.is_settled
        return client

    def pass_time(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-9:
            self.now_s = min(until_s, self.now_s + STEP_S)
            if self.gateway.due_s() <= self.now_s:
                self.gateway.tick(self.now_s)
            for client in list(self.clients.values()):
                if client.machine.due_s() <= self.now_s:
                    client.machine.tick(self.now_s)

    def says(self, packet: Packet, port: Port = ("stranger", 9)) -> list[Packet]:
        """The gateway's answers to a packet from `port`."""
        before = len(self.sent)
        self.gateway.received(codec.encode(packet), port, self.now_s)
        return [sent for to, sent in self.sent[before:] if to == port]

    def to_gateway(self, kind: type[Packet]) -> list[Packet]:
        return [packet for to, packet in self.sent if to == GATEWAY and isinstance(packet, kind)]

    def to_clients(self, kind: type[Packet]) -> list[Packet]:
        return [packet for to, packet in self.sent if to != GATEWAY and isinstance(packet, kind)]

    def from_client(self, datagram: bytes, port: Port) -> None:
        packet = codec.decode(datagram)
        self.sent.append((GATEWAY, packet))
        if not self.lose(GATEWAY, packet):
            self._carry(lambda: self.gateway.received(datagram, port, self.now_s))

    def _to_client(self, datagram: bytes, address: Port) -> None:
        packet = codec.decode(datagram)
        self.sent.append((address, packet))
        if address in self.clients and not self.lose(address, packet):
            self._carry(lambda: self.clients[address].machine.received(datagram, self.now_s))

    def _carry(self, arrive: Callable[[], None]) -> None:
        """Deliver a datagram after its sender has finished its present call."""
        self._carried.append(arrive)
        if self._is_carrying:
            return
        self._is_carrying = True
        while self._carried:
            self._carried.popleft()()
        self._is_carrying = False

    def _is_newer_list(self, payload: bytes) -> bool:
        self.lists_read += 1
        return payload == self.newer_list

    def _side(self, client: Callable[[], AirClient]) -> BrokerSide:
        self.sides.append(BrokerSide(client, self))
        return self.sides[-1]


class BenchClient:
    """A UAV client's end, and what it received."""

    def __init__(self, bench: AirBench, port: Port, client_id: str, will: Will | None) -> None:
        self.bench, self.port = bench, port
        self.codes: list[int] = []
        self.heard: list[Inbound] = []
        self.ended = 0
        self.counted: list[str] = []
        self.acknowledged: list[tuple[str, int]] = []
        self.machine = SnClient(client_id, will, TopicIds(), lambda data: bench.from_client(data, port), self)

    def publish(self, topic: str, payload: bytes = b"\0", qos: int = 1, retain: bool = False) -> None:
        def done(code: int) -> None:
            self.acknowledged.append((topic, code))

        self.machine.publish(Publish("fog", topic, payload, qos, retain), self.bench.now_s, done)

    def subscribe(self, *topics: str, live_only: bool = False) -> list[list[int]]:
        """Subscribe; the returned list gets the codes once they have arrived."""
        found: list[list[int]] = []
        self.machine.subscribe(Subscribe("fog", topics, live_only), self.bench.now_s, found.append)
        return found

    def on_connack(self, code: int) -> None:
        self.codes.append(code)

    def on_message(self, message: Inbound) -> None:
        self.heard.append(message)

    def on_ended(self) -> None:
        self.ended += 1

    def count(self, kind: str, detail: str) -> None:
        self.counted.append(kind)


class Losing:
    """Loses the first packets of a kind to one side."""

    def __init__(self, kind: type[Packet], times: int, to_gateway: bool = True) -> None:
        self.kind, self.left, self.to_gateway = kind, times, to_gateway

    def __call__(self, port: Port, packet: Packet) -> bool:
        if self.left and isinstance(packet, self.kind) and (port == GATEWAY) == self.to_gateway:
            self.left -= 1
            return True
        return False
