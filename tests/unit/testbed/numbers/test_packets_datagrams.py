"""MQTT-SN in captures: its messages are MQTT-XT's, its frames UDP's."""

from __future__ import annotations

from mqttxt.core.mqtt.sn import codec, packets
from mqttxt.core.mqtt.sn.packets import Message
from mqttxt.core.mqtt.sn.together import AirMessage, pack
from mqttxt.core.mqtt.sn.topic_ids import TOGETHER, TopicIds
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery
from mqttxt.protocol.values import Encoding
from testbed.fly.results import Series
from testbed.numbers.metrics.timeline import retransmissions
from testbed.numbers.metrics.traffic import count_links
from testbed.numbers.metrics.window import Window
from testbed.numbers.packets import load
from testbed.numbers.packets.mqttsn import Datagram, read_datagrams
from tests.handmade.attempts import NODES, SECOND, T0, make_attempt, write_pcap
from tests.handmade.mavlink_attempts import udp_frame

IDS = TopicIds()
PORTS = (50_000, 1883)
STATE, WORD, COMMANDS = "drone1/state/battery", "drone1/commands_result/arm", "drone1/commands"


def datagram(row: int, packet: packets.Packet, left_ns: int | None = 1) -> Datagram:
    return Datagram(row, left_ns, codec.encode(packet))


def message(topic: str, payload: bytes, msg_id: int = 0, dup: bool = False) -> Message:
    return Message(IDS.id_of(topic) or 0, payload, qos=int(msg_id > 0), msg_id=msg_id, dup=dup)


def test_each_packet_is_of_its_kind_and_a_publish_of_its_topic() -> None:
    sent = [packets.Connect("d", 15), message(STATE, b"\1"), message(WORD, b"\2\3", 7), packets.Puback(1, 9)]
    found = read_datagrams([[datagram(row, packet) for row, packet in enumerate(sent)]])
    told = [(packet.row, packet.kind, packet.topic, packet.payload, packet.size) for packet in found.packets]
    assert told == [
        (0, "connect", None, None, 7),
        (1, "publish", STATE, b"\1", 8),
        (2, "publish", WORD, b"\2\3", 9),
        (3, "puback", None, None, 7),
    ]
    assert found.payload_bytes == {1: 1, 2: 2}


def test_a_repetition_is_a_copy_that_may_be_the_one_that_arrives() -> None:
    first, again = message(WORD, b"w", 7), message(WORD, b"w", 7, dup=True)
    sent = [
        datagram(0, first, None),
        datagram(1, again, 50),
        datagram(2, again, 60),
        datagram(3, message(WORD, b"x", 8)),
    ]
    found = read_datagrams([sent])
    assert [(packet.row, packet.left_ns, packet.copies) for packet in found.packets] == [(0, 50, 3), (3, 1, 1)]
    assert set(found.carried) == {1, 2}
    assert found.repeated == {1: False, 2: True}


def test_a_repetition_is_a_retransmission_as_of_tcp(series: Series) -> None:
    attempt = make_attempt(series)
    frames = [
        udp_frame(NODES["uav1"], NODES["fog1"], codec.encode(message(WORD, b"w", 7, dup=number > 0)), number, PORTS)
        for number in range(3)
    ]
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(T0 + number, frame) for number, frame in enumerate(frames)])
    write_pcap(attempt.path / "pcap" / "fog1.pcap", [(T0 + 1000 + number, frames[number]) for number in (1, 2)])
    found = retransmissions(load(attempt), Window(T0, T0 + SECOND, T0))
    size = len(frames[1])
    assert found == {"packets": 2, "bytes": 2 * size, "needless": 1, "links": {"air:uav1:up": 2}}


def test_messages_together_are_told_apart_and_one_in_pieces_ends_in_the_last() -> None:
    short, long = AirMessage(COMMANDS, b"c"), AirMessage("fleet/revoked", bytes(1500))
    stream = pack(short, IDS) + pack(long, IDS)
    cuts = [stream[:1000], stream[1000:]]
    sent = [Message(TOGETHER, piece, qos=1, msg_id=number) for number, piece in enumerate(cuts, start=1)]
    found = read_datagrams([[datagram(row, packet) for row, packet in enumerate(sent)]])
    assert [(packet.row, packet.topic) for packet in found.packets] == [(0, COMMANDS), (1, "fleet/revoked")]
    assert sum(packet.size or 0 for packet in found.packets) == sum(len(codec.encode(packet)) for packet in sent)


def test_what_is_no_packet_is_none() -> None:
    found = read_datagrams([[Datagram(0, 1, b"\5nothing")]])
    assert [(packet.kind, packet.topic) for packet in found.packets] == [("reserved", None)]


def test_a_state_by_air_counts_as_udp_s_and_mqtt_s(series: Series) -> None:
    attempt = make_attempt(series)
    payload = encode_state(StampedState(Battery(80), 99), Encoding.CBOR)
    body = codec.encode(message(STATE, payload))
    sent = udp_frame(NODES["uav1"], NODES["fog1"], body, 77, (50_000, 1883))
    at = T0 + 3 * SECOND
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(at, sent)])
    write_pcap(attempt.path / "pcap" / "fog1.pcap", [(at + 1000, sent)])
    table = load(attempt)
    (row,) = table.frames.filter(table.frames["t_ns"] == at).to_dicts()
    assert (row["protocol"], row["kind"], row["purpose"]) == ("mqttsn", "publish", "state")
    assert (row["transport"], row["payload"], row["protocol_bytes"]) == (8, len(payload), len(body) - len(payload))
    layers = count_links(table, Window(at - 1, at + SECOND, at))["air:uav1:up"].layers
    assert layers["udp"] == 8
    assert layers["mqtt"] == len(body) - len(payload)
    assert "mqttsn" not in layers
