"""What both ends of the air leg do about loss, repetition, silence, strangers and floods (section 20)."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mqttxt.core.effects import Inbound, Will
from mqttxt.core.mqtt.sn import codec, packets
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


def told(air: AirBench, side: int = -1) -> list[tuple[str, bytes]]:
    return [(each.topic, each.payload) for each in air.sides[side].published]


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
def test_a_connection_comes_about_whatever_is_lost_once(air: AirBench, kind: type[Packet], to_gateway: bool) -> None:
    air.lose = Losing(kind, 1, to_gateway)
    uav = air.client()
    air.pass_time(2)
    assert uav.codes == [0]
    assert uav.subscribe(COMMANDS, live_only=True) == [[0]]
    assert len(air.sides) == 1
    assert air.sides[0].will == WILL
    assert air.sides[0].client_id == "drone1-a"
    assert air.sides[0].subscribed == [(COMMANDS, True)]


@pytest.mark.parametrize(("kind", "to_gateway"), [(Message, True), (packets.Puback, False)])
def test_a_word_that_is_lost_or_unanswered_is_repeated_and_published_once(kind: type[Packet], to_gateway: bool) -> None:
    air = AirBench()
    uav = air.up()
    air.lose = Losing(kind, 3, to_gateway)
    uav.publish(RESULT, b"word")
    assert uav.acknowledged == []
    air.pass_time(5)
    assert uav.acknowledged == [(RESULT, 0)]
    assert told(air) == [(RESULT, b"word")]
    assert [packet.dup for packet in air.to_gateway(Message) if isinstance(packet, Message)] == [False, *[True] * 3]


def test_repetitions_come_at_growing_pauses_and_end_with_the_connection(air: AirBench, uav: BenchClient) -> None:
    times: list[float] = []

    def lose(port: Port, packet: Packet) -> bool:
        if port == GATEWAY and isinstance(packet, Message):
            times.append(air.now_s)
        return port == GATEWAY

    air.lose = lose
    uav.publish(RESULT)
    air.pass_time(16)
    pauses = [later - earlier for earlier, later in pairwise(times)]
    assert pauses[0] < 0.2
    assert pauses[-1] == pytest.approx(2.0, abs=0.06)
    assert all(second >= first - 0.06 for first, second in pairwise(pauses))
    assert uav.ended == 1
    assert len(times) < 20
    air.pass_time(60)
    assert len(times) < 20


def test_a_message_that_comes_again_much_later_is_not_published_again(air: AirBench, uav: BenchClient) -> None:
    for number in range(3):
        uav.publish(RESULT, bytes((number,)))
    first, *_, last = [packet for packet in air.to_gateway(Message) if isinstance(packet, Message)]
    assert air.says(first, uav.port) == []
    assert air.says(last, uav.port) == [packets.Puback(id_of(RESULT), last.msg_id)]
    assert told(air) == [(RESULT, b"\0"), (RESULT, b"\1"), (RESULT, b"\2")]


def test_what_the_broker_has_is_heard_once_and_in_order_whatever_is_lost(air: AirBench, uav: BenchClient) -> None:
    air.sent.clear()
    air.lose = Losing(packets.Puback, 2)
    for number in range(50):
        air.sides[0].client().on_message(Inbound(COMMANDS, bytes((number,)), 1), air.now_s)
    air.pass_time(3)
    assert [heard.payload for heard in uav.heard] == [bytes((number,)) for number in range(50)]
    sent = [packet for packet in air.to_clients(Message) if isinstance(packet, Message)]
    assert len({packet.msg_id for packet in sent}) == 2, "what waits leaves together"


def test_message_ids_go_round(air: AirBench, uav: BenchClient) -> None:
    uav.machine._sender._msg_id = air.sides[0].client()._receiver._last = 65_533
    for number in range(5):
        uav.publish(RESULT, bytes((number,)))
    assert [packet.msg_id for packet in air.to_gateway(Message) if isinstance(packet, Message)] == [
        *(65_534, 65_535, 1, 2, 3)
    ]
    assert len(told(air)) == 5


def test_a_state_is_sent_once_where_a_newer_one_follows_and_confirmed_where_none_does(air: AirBench) -> None:
    uav = air.up()
    air.lose = lambda port, packet: isinstance(packet, Message) and packet.qos == 0
    for number in range(5):
        uav.publish(STATE, bytes((number,)), qos=0)
        air.pass_time(1)
    assert told(air) == []
    assert len(air.to_gateway(Message)) == 5
    air.pass_time(2)
    assert told(air) == [(STATE, b"\4")]
    air.pass_time(20)
    assert len(air.to_gateway(Message)) == 6


@pytest.mark.parametrize("length", [LARGEST_DATAGRAM - 9, LARGEST_DATAGRAM, 5000, 61_440])
def test_a_message_of_any_length_arrives_whole_both_ways(air: AirBench, length: int) -> None:
    uav, payload = air.up(), bytes(range(256)) * 240
    air.newer_list = payload[:length]
    counted = iter(range(10**6))
    air.lose = lambda port, packet: next(counted) % 5 == 4
    uav.publish("fleet/revoked", payload[:length], retain=True)
    air.sides[0].client().on_message(Inbound("fleet/revoked", payload[:length], 1, True), air.now_s)
    air.pass_time(60)
    (published,) = air.sides[0].published
    assert (published.topic, published.payload, published.retain) == ("fleet/revoked", payload[:length], True)
    assert [(heard.payload, heard.retain) for heard in uav.heard] == [(payload[:length], True)]
    largest = max(len(codec.encode(packet)) for _, packet in air.sent)
    assert largest <= LARGEST_DATAGRAM


def test_a_topic_without_an_id_travels_by_its_name(air: AirBench) -> None:
    air.up().publish("drone1/sensor3/light", b"reading")
    assert told(air) == [("drone1/sensor3/light", b"reading")]


def test_the_broker_s_reason_code_comes_back(air: AirBench, uav: BenchClient) -> None:
    """A word that nobody was there to hear is said again (R5.5)."""
    air.puback_code = 0x10
    uav.publish(RESULT)
    assert uav.acknowledged == [(RESULT, 0x10)]


def test_no_puback_before_the_broker_s(air: AirBench, uav: BenchClient) -> None:
    air.broker_answers = False
    uav.publish(RESULT)
    air.pass_time(3)
    assert uav.acknowledged == []
    assert len(told(air)) == 1
    message = air.to_gateway(Message)[0]
    assert isinstance(message, Message)
    air.sides[0].client().on_published(message.msg_id, 0)
    assert uav.acknowledged == [(RESULT, 0)]


def test_a_silent_client_s_will_is_published_and_a_silent_gateway_is_left(air: AirBench, uav: BenchClient) -> None:
    air.lose = lambda port, packet: True
    air.pass_time(14.8)
    assert uav.ended == 0
    assert len(air.to_gateway(packets.Pingreq)) > 3
    air.pass_time(0.3)
    assert uav.ended == 1
    assert air.sides[0].closed == []
    air.pass_time(7.5)
    assert air.sides[0].closed == [True]


def test_a_client_that_has_nothing_to_say_stays_by_its_pings(air: AirBench, uav: BenchClient) -> None:
    air.pass_time(120)
    assert uav.ended == 0
    assert air.sides[0].closed == []


def test_a_clean_leave_has_no_will_and_is_repeated_until_it_is_answered(air: AirBench, uav: BenchClient) -> None:
    air.lose = Losing(packets.Disconnect, 1, to_gateway=False)
    uav.machine.disconnect(air.now_s, with_will=False)
    air.pass_time(1)
    assert uav.ended == 1
    assert air.sides[0].closed == [False]


def test_a_leave_that_left_something_behind_has_the_will(air: AirBench, uav: BenchClient) -> None:
    uav.machine.disconnect(air.now_s, with_will=True)
    assert uav.ended == 1
    assert air.sides[0].closed == [True]


def test_a_client_whose_broker_ends_connects_anew(air: AirBench, uav: BenchClient) -> None:
    air.sides[0].client().on_ended(air.now_s)
    assert uav.ended == 1
    assert air.up(2).codes == [0]


def test_a_broker_that_does_not_answer_is_no_connection(air: AirBench) -> None:
    air.broker_code = CONGESTION
    assert air.client().codes == [CONGESTION]


def test_a_broker_that_never_answers_is_waited_for_no_longer_than_for_a_connection(air: AirBench) -> None:
    air.broker_answers = False
    air.client()
    air.pass_time(19)
    assert air.sides[0].closed == []
    air.pass_time(2)
    assert air.sides[0].closed == [True]


# Who is who.


def test_a_connect_that_somebody_repeats_takes_nothing_over(air: AirBench, uav: BenchClient) -> None:
    for _ in range(5):
        assert air.says(packets.Connect("drone1-a", 15, has_will=True), STRANGER) == []
        air.pass_time(2)
    assert uav.ended == 0
    uav.publish(RESULT)
    assert told(air) == [(RESULT, b"\0")]
    assert len(air.sides) == 1


def test_a_client_that_comes_from_another_port_replaces_the_one_that_is_gone(air: AirBench) -> None:
    """As after a NAT has forgotten it: what comes from the new port is answered with DISCONNECT, and it connects."""
    old = air.up()
    assert air.says(Message(id_of(STATE), b"\0"), ("drone", 2)) == [packets.Disconnect()]
    del air.clients[old.port]
    again = air.client(2)
    air.pass_time(7)
    assert again.codes == [0]
    assert [side.closed for side in air.sides] == [[True], []]


def test_a_client_at_a_port_that_another_had_before_is_served(air: AirBench) -> None:
    air.up()
    again = air.client(1, "drone1-b")
    air.pass_time(7)
    assert again.codes == [0]
    assert air.sides[0].closed == [True]


def test_two_greetings_of_one_id_make_one_client(air: AirBench) -> None:
    ports: list[Port] = [("one", 1), ("two", 2)]
    for port in ports:
        assert air.says(packets.Connect("same", 15, has_will=True), port) == [packets.WillTopicReq()]
        assert air.says(packets.WillTopic("drone1/reachable"), port) == [packets.WillMsgReq()]
    assert air.says(packets.WillMsg(b"down"), ports[0]) == [packets.Connack()]
    assert air.says(packets.WillMsg(b"down"), ports[1]) == [packets.Connack(CONGESTION)]


def test_a_stranger_is_answered_with_a_disconnect_and_its_disconnect_with_nothing(air: AirBench) -> None:
    assert air.says(packets.Pingreq()) == [packets.Disconnect()]
    assert air.says(packets.Disconnect()) == []
    air.gateway.received(b"\x05nothing", STRANGER, air.now_s)
    assert air.counted == ["air_datagram"]


def test_no_answer_to_a_stranger_is_longer_than_its_datagram(air: AirBench) -> None:
    """A sender's address may be somebody else's, who gets the answer."""
    for packet in (
        *(packets.Connect("a", 15), packets.Connect("b", 15, has_will=True), packets.Pingreq(), packets.Disconnect()),
        *(Message(1, b""), packets.Register(0, 1, "a"), packets.Subscribe(1, "a"), packets.WillMsg(b"")),
    ):
        answers = air.says(packet, ("new", len(air.sent)))
        assert sum(len(codec.encode(answer)) for answer in answers) <= len(codec.encode(packet)), packet


def test_a_client_speaks_of_its_own_drone_alone(air: AirBench, uav: BenchClient) -> None:
    uav.publish("drone1/commands")
    assert uav.acknowledged == [("drone1/commands", 0x80)]
    for topic in ("+/commands", "#", "drone1/state/battery"):
        assert uav.subscribe(topic) == [[INVALID_TOPIC]], topic
    assert told(air) == []
    assert air.sides[0].subscribed == []
    assert set(air.counted) == {"air_topic"}
    assert uav.ended == 0
    uav.publish("drone2/commands_result/arm")
    assert told(air) == []
    assert uav.ended == 1


def test_a_will_of_no_drone_is_refused(air: AirBench) -> None:
    assert air.client(will=Will("fog1/reachable", b"down")).codes == [packets.NOT_SUPPORTED]
    assert air.sides[0].will is None


def test_a_plain_client_of_mqtt_sn_is_served(air: AirBench) -> None:
    """It registers and subscribes by names, and hears nothing together."""
    port: Port = ("plain", 1)
    assert air.says(packets.Connect("plain", 60), port) == [packets.Connack()]
    assert air.says(packets.Register(0, 1, STATE), port) == [packets.Regack(1, 1)]
    assert air.says(Message(1, b"\5", NORMAL), port) == []
    assert told(air) == [(STATE, b"\5")]
    assert air.says(packets.Subscribe(2, COMMANDS), port) == [packets.Suback(2, 2)]
    for number in range(3):
        air.sides[0].client().on_message(Inbound(COMMANDS, bytes((number,)), 1), air.now_s)
        (heard,) = [packet for to, packet in air.sent if to == port and isinstance(packet, Message)][number:]
        assert heard == Message(2, bytes((number,)), NORMAL, 1, heard.msg_id)
        air.says(packets.Puback(2, heard.msg_id), port)
    air.sides[0].client().on_message(Inbound(COMMANDS, bytes(2000), 1), air.now_s)
    assert air.counted == ["air_held_up"]


# Floods.


@pytest.mark.long
def test_greetings_without_end_fill_the_gateway_and_no_more(air: AirBench, uav: BenchClient) -> None:
    for number in range(MOST_CLIENTS + 50):
        air.says(packets.Connect(f"fake{number}", 15, has_will=True), ("fake", number))
        air.pass_time(0.05)
    assert "air_full" not in air.counted, "greetings that do not go on are forgotten"
    codes: set[int] = set()
    for number in range(MOST_CLIENTS):
        answers = air.says(packets.Connect(f"more{number}", 15), ("more", number))
        air.says(packets.Pingreq(), ("more", number))
        codes |= {answer.code for answer in answers if isinstance(answer, packets.Connack)}
        air.pass_time(0.05)
    assert "air_full" in air.counted
    assert codes == {0, CONGESTION}
    uav.publish(RESULT)
    assert uav.acknowledged == [(RESULT, 0)]


def test_strangers_cost_clients_nothing(air: AirBench, uav: BenchClient) -> None:
    for _ in range(5 * STRANGERS_AT_ONCE):
        air.says(packets.Pingreq())
    assert len(air.to_clients(packets.Disconnect)) <= STRANGERS_AT_ONCE
    assert "air_flood" in air.counted
    uav.publish(RESULT)
    assert uav.acknowledged == [(RESULT, 0)]


def test_what_waits_for_a_client_that_acknowledges_nothing_is_bounded(air: AirBench) -> None:
    air.up()
    air.lose = lambda port, packet: port != GATEWAY
    for _ in range(MOST_WAITING + 100):
        air.sides[0].client().on_message(Inbound(COMMANDS, b"\0" * 60, 1), air.now_s)
    assert 0 < air.counted.count("air_held_up") <= 100
    assert air.sides[0].closed == []
