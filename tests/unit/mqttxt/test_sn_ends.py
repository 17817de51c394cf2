"""What both ends of the air leg do about loss, repetition, silence, strangers and floods (section 20)."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mqttxt.core.effects import Inbound, Will
from mqttxt.core.mqtt.sn import packets
from mqttxt.core.mqtt.sn.gateway import MOST_CLIENTS, STRANGERS_AT_ONCE
from mqttxt.core.mqtt.sn.packets import CONGESTION, INVALID_TOPIC, NORMAL, Message, Packet
from mqttxt.core.mqtt.sn.sender import LARGEST_DATAGRAM, MOST_WAITING
from tests.simulation.air_bench import (
    COMMANDS,
    GATEWAY,
    RESULT,
    STATE,
    WILL,
    AirBench,
    BenchClient,
    Losing,
    Port,
    id_of,
)

STRANGER = ("stranger", 9)


@pytest.fixture
def bench() -> AirBench:
    return AirBench()


@pytest.fixture
def client(bench: AirBench) -> BenchClient:
    """A UAV client that is connected."""
    return bench.up()


def told(bench: AirBench, side: int = -1) -> list[tuple[str, bytes]]:
    return [(each.topic, each.payload) for each in bench.sides[side].published]


@pytest.mark.parametrize(
    ("kind", "to_gateway"),
    [
        (packets.Connect, True),
        (packets.WillTopicReq, False),
        (packets.WillTopic, True),
        (packets.WillMsgReq, False),
        (packets.WillMsg, True),
        (packets.Connack, False),
        (packets.Subscribe, True),
        (packets.Suback, False),
    ],
)
def test_a_connection_comes_about_whatever_is_lost_once(bench: AirBench, kind: type[Packet], to_gateway: bool) -> None:
    bench.lose = Losing(kind, 1, to_gateway)
    client = bench.client()
    bench.pass_time(2)
    assert client.codes == [0]
    assert client.subscribe(COMMANDS, live_only=True) == [[0]]
    assert len(bench.sides) == 1
    assert bench.sides[0].will == WILL
    assert bench.sides[0].client_id == "drone1-a"
    assert bench.sides[0].subscribed == [(COMMANDS, True)]


@pytest.mark.parametrize(("kind", "to_gateway"), [(Message, True), (packets.Puback, False)])
def test_a_word_that_is_lost_or_unanswered_is_repeated_and_published_once(kind: type[Packet], to_gateway: bool) -> None:
    bench = AirBench()
    client = bench.up()
    bench.lose = Losing(kind, 3, to_gateway)
    client.publish(RESULT, b"word")
    assert client.acknowledged == []
    bench.pass_time(5)
    assert client.acknowledged == [(RESULT, 0)]
    assert told(bench) == [(RESULT, b"word")]
    assert [packet.dup for packet in bench.to_gateway(Message) if isinstance(packet, Message)] == [False, *[True] * 3]


def test_repetitions_come_at_growing_pauses_and_end_with_the_connection(bench: AirBench, client: BenchClient) -> None:
    times: list[float] = []

    def lose(port: Port, packet: Packet) -> bool:
        if port == GATEWAY and isinstance(packet, Message):
            times.append(bench.now_s)
        return port == GATEWAY

    bench.lose = lose
    client.publish(RESULT)
    bench.pass_time(16)
    pauses = [later - earlier for earlier, later in pairwise(times)]
    assert pauses[0] < 0.2
    assert pauses[-1] == pytest.approx(2.0, abs=0.06)
    assert all(second >= first - 0.06 for first, second in pairwise(pauses))
    assert client.ended == 1
    assert len(times) < 20
    bench.pass_time(60)
    assert len(times) < 20


def test_a_message_that_comes_again_much_later_is_not_published_again(bench: AirBench, client: BenchClient) -> None:
    for number in range(3):
        client.publish(RESULT, bytes((number,)))
    first, *_, last = [packet for packet in bench.to_gateway(Message) if isinstance(packet, Message)]
    assert bench.says(first, client.port) == []
    assert bench.says(last, client.port) == [packets.Puback(id_of(RESULT), last.msg_id)]
    assert told(bench) == [(RESULT, b"\0"), (RESULT, b"\1"), (RESULT, b"\2")]


def test_what_the_broker_has_is_heard_once_and_in_order_whatever_is_lost(bench: AirBench, client: BenchClient) -> None:
    bench.sent.clear()
    bench.lose = Losing(packets.Puback, 2)
    for number in range(50):
        bench.sides[0].client().on_message(Inbound(COMMANDS, bytes((number,)), 1), bench.now_s)
    bench.pass_time(3)
    assert [heard.payload for heard in client.heard] == [bytes((number,)) for number in range(50)]
    sent = [packet for packet in bench.to_clients(Message) if isinstance(packet, Message)]
    assert len({packet.msg_id for packet in sent}) == 2, "what waits leaves together"


def test_message_ids_go_round(bench: AirBench, client: BenchClient) -> None:
    client.machine._sender._msg_id = bench.sides[0].client()._receiver._last = 65_533
    for number in range(5):
        client.publish(RESULT, bytes((number,)))
    assert [packet.msg_id for packet in bench.to_gateway(Message) if isinstance(packet, Message)] == [
        *(65_534, 65_535, 1, 2, 3)
    ]
    assert len(told(bench)) == 5


def test_a_state_is_sent_once_where_a_newer_one_follows_and_confirmed_where_none_does(bench: AirBench) -> None:
    client = bench.up()
    bench.lose = lambda port, packet: isinstance(packet, Message) and packet.qos == 0
    for number in range(5):
        client.publish(STATE, bytes((number,)), qos=0)
        bench.pass_time(1)
    assert told(bench) == []
    assert len(bench.to_gateway(Message)) == 5
    bench.pass_time(2)
    assert told(bench) == [(STATE, b"\4")]
    bench.pass_time(20)
    assert len(bench.to_gateway(Message)) == 6


@pytest.mark.parametrize("length", [LARGEST_DATAGRAM - 9, LARGEST_DATAGRAM, 5000, 61_440])
def test_a_message_of_any_length_arrives_whole_both_ways(bench: AirBench, length: int) -> None:
    client, payload = bench.up(), bytes(range(256)) * 240
    bench.newer_list = payload[:length]
    counted = iter(range(10**6))
    bench.lose = lambda port, packet: next(counted) % 5 == 4
    client.publish("fleet/revoked", payload[:length], retain=True)
    bench.sides[0].client().on_message(Inbound("fleet/revoked", payload[:length], 1, True), bench.now_s)
    bench.pass_time(60)
    (published,) = bench.sides[0].published
    assert (published.topic, published.payload, published.retain) == ("fleet/revoked", payload[:length], True)
    assert [(heard.payload, heard.retain) for heard in client.heard] == [(payload[:length], True)]
    largest = max(len(packets.encode(packet)) for _, packet in bench.sent)
    assert largest <= LARGEST_DATAGRAM


def test_a_topic_without_an_id_travels_by_its_name(bench: AirBench) -> None:
    bench.up().publish("drone1/sensor3/light", b"reading")
    assert told(bench) == [("drone1/sensor3/light", b"reading")]


def test_the_broker_s_reason_code_comes_back(bench: AirBench, client: BenchClient) -> None:
    """A word that nobody was there to hear is said again (R5.5)."""
    bench.puback_code = 0x10
    client.publish(RESULT)
    assert client.acknowledged == [(RESULT, 0x10)]


def test_no_puback_before_the_broker_s(bench: AirBench, client: BenchClient) -> None:
    bench.broker_answers = False
    client.publish(RESULT)
    bench.pass_time(3)
    assert client.acknowledged == []
    assert len(told(bench)) == 1
    message = bench.to_gateway(Message)[0]
    assert isinstance(message, Message)
    bench.sides[0].client().on_published(message.msg_id, 0)
    assert client.acknowledged == [(RESULT, 0)]


def test_a_silent_client_s_will_is_published_and_a_silent_gateway_is_left(bench: AirBench, client: BenchClient) -> None:
    bench.lose = lambda port, packet: True
    bench.pass_time(14.8)
    assert client.ended == 0
    assert len(bench.to_gateway(packets.Pingreq)) > 3
    bench.pass_time(0.3)
    assert client.ended == 1
    assert bench.sides[0].closed == []
    bench.pass_time(7.5)
    assert bench.sides[0].closed == [True]


def test_a_client_that_has_nothing_to_say_stays_by_its_pings(bench: AirBench, client: BenchClient) -> None:
    bench.pass_time(120)
    assert client.ended == 0
    assert bench.sides[0].closed == []


def test_a_clean_leave_has_no_will_and_is_repeated_until_it_is_answered(bench: AirBench, client: BenchClient) -> None:
    bench.lose = Losing(packets.Disconnect, 1, to_gateway=False)
    client.machine.disconnect(bench.now_s, with_will=False)
    bench.pass_time(1)
    assert client.ended == 1
    assert bench.sides[0].closed == [False]


def test_a_leave_that_left_something_behind_has_the_will(bench: AirBench, client: BenchClient) -> None:
    client.machine.disconnect(bench.now_s, with_will=True)
    assert client.ended == 1
    assert bench.sides[0].closed == [True]


def test_a_client_whose_broker_ends_connects_anew(bench: AirBench, client: BenchClient) -> None:
    bench.sides[0].client().on_ended(bench.now_s)
    assert client.ended == 1
    assert bench.up(2).codes == [0]


def test_a_broker_that_does_not_answer_is_no_connection(bench: AirBench) -> None:
    bench.broker_code = CONGESTION
    assert bench.client().codes == [CONGESTION]


def test_a_broker_that_never_answers_is_waited_for_no_longer_than_for_a_connection(bench: AirBench) -> None:
    bench.broker_answers = False
    bench.client()
    bench.pass_time(19)
    assert bench.sides[0].closed == []
    bench.pass_time(2)
    assert bench.sides[0].closed == [True]


# Who is who.


def test_a_connect_that_somebody_repeats_takes_nothing_over(bench: AirBench, client: BenchClient) -> None:
    for _ in range(5):
        assert bench.says(packets.Connect("drone1-a", 15, has_will=True), STRANGER) == []
        bench.pass_time(2)
    assert client.ended == 0
    client.publish(RESULT)
    assert told(bench) == [(RESULT, b"\0")]
    assert len(bench.sides) == 1


def test_a_client_that_comes_from_another_port_replaces_the_one_that_is_gone(bench: AirBench) -> None:
    """As after a NAT has forgotten it: what comes from the new port is answered with DISCONNECT, and it connects."""
    old = bench.up()
    assert bench.says(Message(id_of(STATE), b"\0"), ("drone", 2)) == [packets.Disconnect()]
    del bench.clients[old.port]
    again = bench.client(2)
    bench.pass_time(7)
    assert again.codes == [0]
    assert [side.closed for side in bench.sides] == [[True], []]


def test_a_client_at_a_port_that_another_had_before_is_served(bench: AirBench) -> None:
    bench.up()
    again = bench.client(1, "drone1-b")
    bench.pass_time(7)
    assert again.codes == [0]
    assert bench.sides[0].closed == [True]


def test_two_greetings_of_one_id_make_one_client(bench: AirBench) -> None:
    ports: list[Port] = [("one", 1), ("two", 2)]
    for port in ports:
        assert bench.says(packets.Connect("same", 15, has_will=True), port) == [packets.WillTopicReq()]
        assert bench.says(packets.WillTopic("drone1/reachable"), port) == [packets.WillMsgReq()]
    assert bench.says(packets.WillMsg(b"down"), ports[0]) == [packets.Connack()]
    assert bench.says(packets.WillMsg(b"down"), ports[1]) == [packets.Connack(CONGESTION)]


def test_a_stranger_is_answered_with_a_disconnect_and_its_disconnect_with_nothing(bench: AirBench) -> None:
    assert bench.says(packets.Pingreq()) == [packets.Disconnect()]
    assert bench.says(packets.Disconnect()) == []
    bench.gateway.received(b"\x05nothing", STRANGER, bench.now_s)
    assert bench.counted == ["air_datagram"]


def test_no_answer_to_a_stranger_is_longer_than_its_datagram(bench: AirBench) -> None:
    """A sender's address may be somebody else's, who gets the answer."""
    for packet in (
        *(packets.Connect("a", 15), packets.Connect("b", 15, has_will=True), packets.Pingreq(), packets.Disconnect()),
        *(Message(1, b""), packets.Register(0, 1, "a"), packets.Subscribe(1, "a"), packets.WillMsg(b"")),
    ):
        answers = bench.says(packet, ("new", len(bench.sent)))
        assert sum(len(packets.encode(answer)) for answer in answers) <= len(packets.encode(packet)), packet


def test_a_client_speaks_of_its_own_drone_alone(bench: AirBench, client: BenchClient) -> None:
    client.publish("drone1/commands")
    assert client.acknowledged == [("drone1/commands", 0x80)]
    for topic in ("+/commands", "#", "drone1/state/battery"):
        assert client.subscribe(topic) == [[INVALID_TOPIC]], topic
    assert told(bench) == []
    assert bench.sides[0].subscribed == []
    assert set(bench.counted) == {"air_topic"}
    assert client.ended == 0
    client.publish("drone2/commands_result/arm")
    assert told(bench) == []
    assert client.ended == 1


def test_a_will_of_no_drone_is_refused(bench: AirBench) -> None:
    assert bench.client(will=Will("fog1/reachable", b"down")).codes == [packets.NOT_SUPPORTED]
    assert bench.sides[0].will is None


def test_a_plain_client_of_mqtt_sn_is_served(bench: AirBench) -> None:
    """It registers and subscribes by names, and hears nothing together."""
    port: Port = ("plain", 1)
    assert bench.says(packets.Connect("plain", 60), port) == [packets.Connack()]
    assert bench.says(packets.Register(0, 1, STATE), port) == [packets.Regack(1, 1)]
    assert bench.says(Message(1, b"\5", NORMAL), port) == []
    assert told(bench) == [(STATE, b"\5")]
    assert bench.says(packets.Subscribe(2, COMMANDS), port) == [packets.Suback(2, 2)]
    for number in range(3):
        bench.sides[0].client().on_message(Inbound(COMMANDS, bytes((number,)), 1), bench.now_s)
        (heard,) = [packet for to, packet in bench.sent if to == port and isinstance(packet, Message)][number:]
        assert heard == Message(2, bytes((number,)), NORMAL, 1, heard.msg_id)
        bench.says(packets.Puback(2, heard.msg_id), port)
    bench.sides[0].client().on_message(Inbound(COMMANDS, bytes(2000), 1), bench.now_s)
    assert bench.counted == ["air_held_up"]


# Floods.


@pytest.mark.long
def test_greetings_without_end_fill_the_gateway_and_no_more(bench: AirBench, client: BenchClient) -> None:
    for number in range(MOST_CLIENTS + 50):
        bench.says(packets.Connect(f"fake{number}", 15, has_will=True), ("fake", number))
        bench.pass_time(0.05)
    assert "air_full" not in bench.counted, "greetings that do not go on are forgotten"
    codes: set[int] = set()
    for number in range(MOST_CLIENTS):
        answers = bench.says(packets.Connect(f"more{number}", 15), ("more", number))
        bench.says(packets.Pingreq(), ("more", number))
        codes |= {answer.code for answer in answers if isinstance(answer, packets.Connack)}
        bench.pass_time(0.05)
    assert "air_full" in bench.counted
    assert codes == {0, CONGESTION}
    client.publish(RESULT)
    assert client.acknowledged == [(RESULT, 0)]


def test_strangers_cost_clients_nothing(bench: AirBench, client: BenchClient) -> None:
    for _ in range(5 * STRANGERS_AT_ONCE):
        bench.says(packets.Pingreq())
    assert len(bench.to_clients(packets.Disconnect)) <= STRANGERS_AT_ONCE
    assert "air_flood" in bench.counted
    client.publish(RESULT)
    assert client.acknowledged == [(RESULT, 0)]


def test_what_waits_for_a_client_that_acknowledges_nothing_is_bounded(bench: AirBench) -> None:
    bench.up()
    bench.lose = lambda port, packet: port != GATEWAY
    for _ in range(MOST_WAITING + 100):
        bench.sides[0].client().on_message(Inbound(COMMANDS, b"\0" * 60, 1), bench.now_s)
    assert 0 < bench.counted.count("air_held_up") <= 100
    assert bench.sides[0].closed == []
