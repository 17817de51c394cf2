"""What a stranger, a network that reorders, or a broker that refuses must not bring about on the air leg."""

from __future__ import annotations

import asyncio
import socket
from unittest.mock import create_autospec

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Inbound, Will
from mqttxt.core.mqtt.events import LinkEvents
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.mqtt.sn import codec, packets
from mqttxt.core.mqtt.sn.address_proof import REFLECTED
from mqttxt.core.mqtt.sn.air import Air
from mqttxt.core.mqtt.sn.gateway import BIRTHS_AT_ONCE, BIRTHS_PER_S, OPENED_AT_ONCE, Address, AirGateway
from mqttxt.core.mqtt.sn.packets import CONGESTION, NORMAL, PREDEFINED, Connect, Message
from mqttxt.core.mqtt.sn.sender import LARGEST_DATAGRAM
from mqttxt.core.mqtt.sn.together import AirMessage, pack
from mqttxt.core.mqtt.sn.topic_ids import TOGETHER, TopicIds, _parsed
from mqttxt.core.shared_lists import LISTS_AT_ONCE
from tests.rigs.processes import eventually, free_port
from tests.simulation.air_bench import (
    COMMANDS,
    GATEWAY,
    RESULT,
    STATE,
    AirBench,
    BenchClient,
    BrokerSide,
    Losing,
    Port,
    id_of,
)

LIST = "fleet/revoked"
EVIL: Port = ("evil", 1)
JUNK = bytes((0, 0, 0, 0, 1, 255, 255))
"""A head of a message that can never be one."""


def stranger(air: AirBench) -> None:
    assert air.says(Connect("evil", 15), EVIL) == [packets.Connack()]


def test_what_is_no_stream_is_not_kept(air: AirBench) -> None:
    stranger(air)
    for number in range(1, 21):
        air.says(Message(TOGETHER, JUNK + bytes(1000), PREDEFINED, 1, number), EVIL)
    at = air.gateway._at.get(EVIL)
    assert at is None or len(at._unpacker._came) <= LARGEST_DATAGRAM


def test_a_datagram_that_is_too_long_is_not_read(air: AirBench) -> None:
    """7,000 messages of another drone in one datagram cost ten seconds of the activator's time."""
    stranger(air)
    own = id_of("drone1/reachable").to_bytes(2, "big")
    air.says(Message(TOGETHER, (b"\x20" + own + bytes(4)) * 1000, PREDEFINED, 1, 1), EVIL)
    assert air.sides[0].published == []


def test_what_a_broker_never_acknowledges_is_not_kept(air: AirBench) -> None:
    stranger(air)
    air.broker_answers = False
    for number in range(1, 51):
        air.says(Message(id_of(RESULT), bytes(1000), PREDEFINED, 1, number), EVIL)
    assert len(air.sides[0].published) == 1


def test_names_that_are_no_topics_are_not_kept(air: AirBench) -> None:
    stranger(air)
    _parsed.cache_clear()
    for number in range(1, 21):
        air.says(packets.Subscribe(number, f"{number}" + "x" * 1000), EVIL)
    assert _parsed.cache_info().currsize == 0


def test_a_client_whom_the_broker_refused_is_forgotten(air: AirBench) -> None:
    air.broker_answers = False
    for number in range(10):
        air.says(Connect(f"x{number}", 15), EVIL)
        air.sides[-1].client().on_opened(CONGESTION, air.now_s)
        air.now_s += 0.01
    air.pass_time(30)
    assert air.gateway._at == {}


def test_a_second_client_does_not_speak_for_a_drone_that_is_there(air: AirBench, uav: BenchClient) -> None:
    uav.subscribe(COMMANDS, live_only=True)
    air.says(Connect("evil", 15), EVIL)
    air.says(Message(id_of("drone1/reachable"), b"down", PREDEFINED, 1, 1, retain=True), EVIL)
    air.says(Message(id_of(RESULT), b"made up", PREDEFINED, 1, 2), EVIL)
    air.says(packets.Subscribe(3, id_of(COMMANDS), live_only=True), EVIL)
    others = air.sides[1:]
    assert [told.topic for side in others for told in side.published] == []
    assert [topic for side in others for topic, _ in side.subscribed] == []


def test_a_second_client_s_will_does_not_say_that_a_drone_is_down_which_is_there(air: AirBench) -> None:
    air.up()
    air.says(Connect("evil", 15, has_will=True), EVIL)
    air.says(packets.WillTopic("drone1/reachable"), EVIL)
    air.says(packets.WillMsg(b"down"), EVIL)
    air.says(packets.Disconnect(1), EVIL)
    assert [side.will for side in air.sides[1:] if side.closed == [True]] == []


@pytest.mark.parametrize("topic_id", [id_of(LIST), TOGETHER])
def test_a_stranger_says_nothing_to_all_nodes(air: AirBench, topic_id: int) -> None:
    """Every node hears `fleet/revoked`: what floods it fills what waits for each drone, commands among it."""
    stranger(air)
    junk = AirMessage(LIST, b"no list", retain=True)
    payload = pack(junk, TopicIds()) if topic_id == TOGETHER else junk.payload
    answers = []
    for number in range(1, 201):
        answers += air.says(Message(topic_id, payload, PREDEFINED, 1, number, retain=True), EVIL)
    assert answers == [packets.Puback(topic_id, number) for number in range(1, 201)]
    assert air.sides[0].published == []
    assert air.lists_read <= LISTS_AT_ONCE


def test_a_list_that_the_activator_lacks_is_passed_on(air: AirBench, uav: BenchClient) -> None:
    air.newer_list = b"newer"
    uav.publish(LIST, b"newer", retain=True)
    uav.publish(RESULT)
    uav.publish(LIST, b"older", retain=True)
    assert [(told.topic, told.payload) for told in air.sides[0].published] == [(LIST, b"newer"), (RESULT, b"\0")]
    assert uav.acknowledged == [(LIST, 0), (RESULT, 0), (LIST, 0)]


@pytest.mark.parametrize("way", ["by name", "by id", "together"])
def test_a_stranger_leaves_nothing_at_the_broker_that_stays(air: AirBench, way: str) -> None:
    """No restart and no other node takes retained messages back, and there are topics without end."""
    stranger(air)
    for number in range(1, 11):
        topic = f"drone1/sensor{number}/temperature"
        if way == "together":
            payload = pack(AirMessage(topic, b"junk", retain=True), TopicIds())
            air.says(Message(TOGETHER, payload, PREDEFINED, 1, number, retain=True), EVIL)
        elif way == "by id":
            answers = air.says(Message(id_of(STATE), b"junk", PREDEFINED, 1, number, retain=True), EVIL)
            assert answers == [packets.Puback(id_of(STATE), number, packets.INVALID_TOPIC)]
        else:
            (registered,) = air.says(packets.Register(0, 2 * number - 1, topic), EVIL)
            assert isinstance(registered, packets.Regack)
            air.says(Message(registered.topic_id, b"junk", NORMAL, 1, 2 * number, retain=True), EVIL)
    assert [told for told in air.sides[0].published if told.retain] == []


def test_a_birth_is_retained(air: AirBench, uav: BenchClient) -> None:
    uav.publish("drone1/reachable", b"up", retain=True)
    uav.publish(RESULT)
    assert [(told.topic, told.retain) for told in air.sides[0].published] == [
        ("drone1/reachable", True),
        (RESULT, False),
    ]


def test_a_will_says_nothing_to_all_nodes(air: AirBench) -> None:
    air.says(Connect("evil", 15, has_will=True), EVIL)
    assert air.says(packets.WillTopic(LIST), EVIL) == [packets.Connack(packets.NOT_SUPPORTED)]
    air.says(packets.WillMsg(b"no list"), EVIL)
    assert air.sides[0].client_id == ""


def test_a_stranger_does_not_flood_a_drone_with_its_own_births(air: AirBench) -> None:
    """A drone that is connected over TCP hears its own topic; the gateway does not know that the drone is there."""
    stranger(air)
    birth = id_of("drone7/reachable")
    codes = []
    for number in range(1, 1001):
        (answer,) = air.says(Message(birth, bytes(1000), PREDEFINED, 1, number, retain=True), EVIL)
        assert isinstance(answer, packets.Puback)
        codes.append(answer.code)
        air.now_s += 0.01
    assert len(air.sides[0].published) == codes.count(0) <= BIRTHS_AT_ONCE + 10 * BIRTHS_PER_S
    assert set(codes) == {0, 0x97}
    air.now_s += 1
    assert air.says(Message(id_of("drone7/clock"), b"\0", PREDEFINED, 1, 1001), EVIL) == [
        packets.Puback(id_of("drone7/clock"), 1001)
    ]


def test_nor_with_its_own_wills(air: AirBench) -> None:
    for number in range(400):
        port = ("evil", number)
        air.says(Connect(f"evil{number}", 15, has_will=True), port)
        air.says(packets.WillTopic("drone7/reachable"), port)
        air.says(packets.WillMsg(bytes(61_000)), port)
        air.says(packets.Disconnect(1), port)
        air.pass_time(0.05)
    assert 1 <= sum(side.will is not None for side in air.sides) <= 4


def test_a_late_copy_of_a_subscribe_costs_no_connection_and_subscribes_nothing(air: AirBench) -> None:
    uav = air.up()
    uav.subscribe(COMMANDS, live_only=True)
    late = next(packet for packet in air.to_gateway(packets.Subscribe) if packet != packets.Subscribe(1, TOGETHER))
    air.lose = Losing(packets.Puback, 1, to_gateway=False)
    uav.publish(RESULT)
    air.says(late, uav.port)
    air.pass_time(16)
    assert air.sides[0].subscribed == [(COMMANDS, True)]
    assert uav.acknowledged == [(RESULT, 0)]
    assert uav.ended == 0


def test_drones_that_a_nat_takes_for_each_other_connect_anew_and_no_word_is_taken_for_said(air: AirBench) -> None:
    """The ledger takes each code below 0x80 but 0x10 for delivery (`Answers.on_published`)."""
    one = air.up(1, "drone1-a")
    two = air.client(2, "drone2-a", Will("drone2/reachable", b"down"))
    for uav, drone in ((one, 1), (two, 2)):
        uav.subscribe(f"drone{drone}/commands", live_only=True)
        uav.publish(f"drone{drone}/commands_result/hold")
    one.acknowledged.clear()
    ports = one.port, two.port
    one.machine._send_datagram = lambda data: air.from_client(data, ports[1])
    two.machine._send_datagram = lambda data: air.from_client(data, ports[0])
    air.clients[ports[0]], air.clients[ports[1]] = two, one
    one.publish(RESULT, b"done")
    air.pass_time(20)
    assert not any(code < 0x80 for _, code in one.acknowledged)
    assert one.ended == 1


def test_two_gateways_do_not_take_leave_of_each_other_for_ever() -> None:
    ports: list[Address] = [("a", 1), ("b", 1)]
    on_the_way: list[tuple[float, Address, Address, bytes]] = []
    now_s, heard = 100.0, 0

    def made(own: Address) -> AirGateway:
        air = AirBench()
        return AirGateway(
            TopicIds(),
            lambda data, to: on_the_way.append((now_s + 0.005, own, to, data)),
            lambda client: BrokerSide(client, air),
            lambda kind, detail: None,
        )

    gateways = {port: made(port) for port in ports}
    one, other = ports
    gateways[one].received(codec.encode(Connect("x", 15)), other, now_s)
    gateways[other].received(codec.encode(Connect("y", 15)), one, now_s)
    gateways[one].received(codec.encode(packets.Disconnect()), other, now_s)
    while on_the_way and now_s < 160:
        now_s, sender, to, data = on_the_way.pop(0)
        heard += 1
        for gateway in gateways.values():
            if gateway.due_s() <= now_s:
                gateway.tick(now_s)
        gateways[to].received(data, sender, now_s)
    assert heard < 20, f"{heard} datagrams, {now_s - 100:.0f} s"


def test_a_connect_and_one_lost_datagram_do_not_end_a_client_that_is_there(air: AirBench) -> None:
    air.up()
    air.pass_time(1)
    air.lose = Losing(packets.Pingreq, 1, to_gateway=False)
    air.says(Connect("drone1-a", 15), EVIL)
    air.pass_time(3)
    assert air.sides[0].closed == []


def test_a_state_that_is_confirmed_does_not_replace_a_newer_one(air: AirBench, uav: BenchClient) -> None:
    air.lose = lambda port, packet: port != GATEWAY and isinstance(packet, packets.Puback)
    uav.publish(RESULT)
    uav.publish(STATE, b"old", 0)
    air.pass_time(1.6)
    uav.publish(STATE, b"new", 0)
    air.lose = lambda port, packet: False
    air.pass_time(1.2)
    states = [told.payload for told in air.sides[0].published if told.topic == STATE]
    assert states[-1] == b"new", states


def test_one_address_does_not_open_connections_to_the_broker_without_end(air: AirBench) -> None:
    for _ in range(200):
        air.says(Connect("x", 15), EVIL)
        air.says(packets.Disconnect(), EVIL)
        air.now_s += 0.005
    assert len(air.sides) <= 20, f"{len(air.sides)} in a second"


def test_three_hundred_datagrams_do_not_keep_drones_out_for_minutes(air: AirBench) -> None:
    for number in range(300):
        air.says(Connect(f"fake{number}", 65_535), ("fake", number))
        air.now_s += 0.01
    air.pass_time(30)
    assert air.client().codes == [0]


def test_so_many_addresses_do_not_open_so_many_connections_to_the_broker(air: AirBench) -> None:
    for number in range(200):
        air.says(Connect(f"x{number}", 15), ("evil", number))
    assert sum(side.client_id != "" for side in air.sides) == OPENED_AT_ONCE
    assert air.counted.count("air_full") == 200 - OPENED_AT_ONCE


class Victim:
    """An address that never asked for anything; an attacker, who sees no answer, sends in its name."""

    def __init__(self, air: AirBench) -> None:
        self.bench, self.received, self.sent = air, 0, 0

    def is_named_in(self, packet: packets.Packet) -> None:
        self.sent += len(codec.encode(packet))
        self.bench.says(packet, EVIL)
        self.look()

    def waits(self, seconds: float) -> None:
        for _ in range(int(seconds * 10)):
            self.bench.pass_time(0.1)
            self.look()

    def look(self) -> None:
        self.received = sum(len(codec.encode(packet)) for to, packet in self.bench.sent if to == EVIL)
        assert self.received <= REFLECTED * self.sent


@pytest.mark.long
@pytest.mark.parametrize("topic", [TOGETHER, COMMANDS, None])
@pytest.mark.parametrize("travels", [(COMMANDS, 1), ("drone1/bulk", 0)])
def test_an_address_that_never_answered_gets_no_more_than_three_times_what_came_in_its_name(
    topic: int | str | None, travels: tuple[str, int]
) -> None:
    air = AirBench()
    victim = Victim(air)
    victim.is_named_in(Connect("evil", 15))
    if topic is not None:
        victim.is_named_in(packets.Subscribe(1, topic))
    victim.is_named_in(packets.Subscribe(2, id_of("drone1/bulk")))
    for number in range(200):
        air.sides[0].client().on_message(Inbound(travels[0], bytes(1000), travels[1]), air.now_s)
        victim.is_named_in(packets.Puback(id_of(COMMANDS), 1 + number % 3))
        victim.is_named_in(packets.Pingreq())
        victim.waits(0.1)
    victim.waits(30)


def test_who_guesses_what_the_gateway_asked_is_not_served_any_longer(air: AirBench) -> None:
    stranger(air)
    air.says(packets.Subscribe(1, TOGETHER), EVIL)
    (asked,) = [packet for packet in air.to_clients(Message) if isinstance(packet, Message)]
    assert air.says(packets.Puback(TOGETHER, asked.msg_id % 65_535 + 1), EVIL) == [packets.Disconnect()]
    assert air.sides[0].closed == [True]


def test_what_a_gateway_asks_cannot_be_known_beforehand() -> None:
    asked = set()
    for _ in range(20):
        air = AirBench()
        air.up()
        asked |= {packet.msg_id for packet in air.to_clients(Message) if isinstance(packet, Message)}
    assert len(asked) > 15


def test_an_address_that_answered_is_told_all_at_once(air: AirBench, uav: BenchClient) -> None:
    for number in range(50):
        air.sides[0].client().on_message(Inbound(COMMANDS, bytes((number,)) * 1000, 1), air.now_s)
    assert [heard.payload[0] for heard in uav.heard] == list(range(50))


@pytest.mark.parametrize("lost", range(1, 4))
def test_a_client_is_told_all_though_the_proof_of_its_address_is_lost(air: AirBench, lost: int) -> None:
    air.lose = Losing(packets.Puback, lost)
    uav = air.up()
    air.sides[0].client().on_message(Inbound(COMMANDS, bytes(1000), 1), air.now_s)
    assert uav.heard == []
    air.pass_time(5)
    assert [heard.payload for heard in uav.heard] == [bytes(1000)]
    assert uav.ended == 0


def test_an_address_that_never_answers_is_given_up(air: AirBench) -> None:
    air.lose = lambda port, packet: port != GATEWAY and isinstance(packet, Message)
    uav = air.up()
    air.pass_time(16)
    assert uav.ended == 1
    assert air.sides[0].closed == [True]


@pytest.mark.long
async def test_each_address_of_a_gateway_s_name_is_tried_and_no_return_code_ends_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody is at the first address; at the second somebody refuses every client for good."""
    came: asyncio.Queue[Address] = asyncio.Queue()

    class Refusing(asyncio.DatagramProtocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            self.transport = transport

        def datagram_received(self, data: bytes, addr: Address) -> None:
            if isinstance(codec.decode(data), Connect):
                came.put_nowait(addr)
                self.transport.sendto(codec.encode(packets.Connack(0x87)), addr)  # type: ignore[attr-defined]

    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(Refusing, local_addr=("127.0.0.1", 0))
    port = transport.get_extra_info("sockname")[1]
    found = [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", (host, port)) for host in ("127.0.0.2", "127.0.0.1")]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    address = BrokerAddress.parse(f"mqtt-sn://fog:{port}", datagrams=True)
    link = MqttLink("fog", address, "drone1-a", None, create_autospec(LinkEvents))
    running = asyncio.ensure_future(link.run())
    try:
        async with asyncio.timeout(60):
            await came.get()
            await came.get()
        assert not running.done()
    finally:
        running.cancel()
        transport.close()


async def test_what_keeps_the_activator_busy_does_not_keep_datagrams_from_it() -> None:
    """Of a broker it reads 256 packets in a turn of its loop: a datagram in each would be some forty in a second."""
    port = free_port(socket.SOCK_DGRAM)
    air = Air("127.0.0.1", port, BrokerAddress("127.0.0.1", 1), "", lambda kind, detail: None)
    serving = asyncio.create_task(air.run())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as drones:
        drones.setblocking(False)
        drones.connect(("127.0.0.1", port))
        await eventually(lambda: air._transport is not None, "it listens")
        for _ in range(50):
            drones.send(codec.encode(packets.Pingreq()))
        for _ in range(3):
            await asyncio.sleep(0)
        answers = [codec.decode(drones.recv(100)) for _ in range(50)]
    serving.cancel()
    await asyncio.wait({serving})
    assert answers == [packets.Disconnect()] * 50
