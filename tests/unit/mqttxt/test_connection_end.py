"""How a connection ends: cleanly, refused, taken over, against a broker that takes nothing more."""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Publish, Subscribe, Will
from mqttxt.core.mqtt import connection as connection_module
from mqttxt.core.mqtt import link as mqtt_module
from mqttxt.core.mqtt import outgoing
from mqttxt.core.mqtt.client import CONNECT_THREAD, KEEPALIVE_S
from mqttxt.core.mqtt.keep_alive import PROOFS, KeepAlive
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.errors import BrokerRefused
from tests.rigs.linked import RECEIVE_MAXIMUM_2, WITH_WILL, Heard, linked, state
from tests.rigs.mqtt_server import CONNECT, DISCONNECT, PINGREQ, PUBLISH, SILENCE, Server, publish, read_packet
from tests.rigs.processes import eventually

TAKEN_OVER = b"\xe0\x02\x8e\x00"
PINGRESP = b"\xd0\x00"


def test_a_broker_that_never_shakes_hands_does_not_hold_up_the_end() -> None:
    def connecting() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name == CONNECT_THREAD]

    async def begin_and_end(port: int) -> None:
        link = MqttLink("cloud", BrokerAddress("127.0.0.1", port, tls=True), "client-1", None, Heard())
        running = asyncio.create_task(link.run())
        await eventually(lambda: connecting() != [], "a thread that connects")
        running.cancel()
        await asyncio.wait({running}, timeout=10)

    with socket.create_server(("127.0.0.1", 0)) as silent:
        asyncio.run(begin_and_end(silent.getsockname()[1]))
        left = connecting()
        assert left != []
    for thread in left:  # reset with the listening socket
        thread.join(10)
        assert not thread.is_alive()


async def test_a_refusal_that_cannot_be_mended_ends_the_link() -> None:
    async with Server(code=0x86) as server:
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, Heard())
        with pytest.raises(BrokerRefused, match="0x86"):
            async with asyncio.timeout(10):
                await link.run()


async def test_a_client_that_took_over_is_left_in_peace() -> None:
    async with Server() as server:
        heard = Heard()
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[0].send(TAKEN_OVER)
        with pytest.raises(BrokerRefused, match="another client took over"):
            async with asyncio.timeout(10):
                await running
        assert len(server.sessions) == 1


async def test_a_connect_without_an_answer_does_not_come_after_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system would repeat it for minutes, and the broker then end the newer connection of the same id."""
    monkeypatch.setattr(connection_module, "CONNECT_TIMEOUT_S", 0.1)
    came: asyncio.Future[BaseException | None] = asyncio.get_running_loop().create_future()

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await read_packet(reader)
            await reader.read()
        except ConnectionError as error:
            came.set_result(error)
        else:
            came.set_result(None)
        writer.close()

    async with await asyncio.start_server(silent, "127.0.0.1", 0) as server:
        port = int(server.sockets[0].getsockname()[1])
        link = MqttLink("fog", BrokerAddress("127.0.0.1", port), "client-1", lambda: Will("a", b"down"), Heard())
        running = asyncio.create_task(link.run())
        async with asyncio.timeout(10):
            assert isinstance(await came, ConnectionResetError)
        running.cancel()
        await asyncio.wait({running})


async def test_an_own_connect_that_comes_late_all_the_same_ends_no_role(monkeypatch: pytest.MonkeyPatch) -> None:
    """A middlebox may hold it back: then the broker takes its sender for another client with the id."""
    monkeypatch.setattr(connection_module, "CONNECT_TIMEOUT_S", 0.1)
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server() as server:
        server.answers.clear()
        heard = Heard()
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: link.failure is not None, "no answer in time")
        server.answers.set()
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[-1].send(TAKEN_OVER)
        await eventually(lambda: heard.connections == 2 or running.done(), "connected again")
        server.sessions[-1].send(TAKEN_OVER)
        with pytest.raises(BrokerRefused, match="another client took over"):
            async with asyncio.timeout(10):
                await running
        assert heard.connections == 2


async def test_who_reached_no_broker_for_a_while_does_not_come_back_against_its_successor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No CONNECT of its own can come late that never left."""
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    reach, attempts = connection_module.connect, 0

    def connect(*args: Any) -> None:
        nonlocal attempts
        attempts += 1
        if attempts == 1:
            raise TimeoutError("timed out")
        reach(*args)

    monkeypatch.setattr(connection_module, "connect", connect)
    async with Server() as server:
        heard = Heard()
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[-1].send(TAKEN_OVER)
        with pytest.raises(BrokerRefused, match="another client took over"):
            async with asyncio.timeout(10):
                await running
        assert len(server.sessions) == 1


@pytest.mark.parametrize("turns", range(8))
@pytest.mark.parametrize("end", ["cancelled", "closed"])
async def test_an_end_is_not_lost_that_comes_with_the_connack(
    end: str, turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many turns of the event loop lie between the broker's answer and the end."""
    answered = asyncio.Event()
    on_connect = connection_module.Connection._on_connect

    def notes(self: connection_module.Connection, *args: Any) -> None:
        on_connect(self, *args)
        answered.set()

    monkeypatch.setattr(connection_module.Connection, "_on_connect", notes)
    async with Server() as server:
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, Heard())
        running = asyncio.create_task(link.run())
        await answered.wait()
        for _ in range(turns):
            await asyncio.sleep(0)
        if end == "cancelled":
            running.cancel()
        else:
            await link.close()
        done, _ = await asyncio.wait({running}, timeout=10)
        running.cancel()
        assert done, "goes on"
        assert running.cancelled() == (end == "cancelled")
        await eventually(lambda: server.sessions[0].ended, "the end")
        assert [packet.kind for packet in server.sessions[0].packets] == [CONNECT, DISCONNECT]


async def test_a_clean_end_waits_for_its_last_words_to_be_acknowledged() -> None:
    async with Server(acknowledges=False) as server, linked(server) as (link, _):
        (session,) = server.sessions
        link.publish(Publish("fog", "drone1/reachable", b"down", 1, retain=True))
        closing = asyncio.create_task(link.close())
        await eventually(lambda: len(session.of(PUBLISH)) == 1, "the last word")
        assert session.of(DISCONNECT) == []
        session.acknowledge(session.of(PUBLISH)[0].publish()[3])
        await closing
        await eventually(lambda: session.ended, "the end")
        assert [packet.kind for packet in session.packets] == [CONNECT, PUBLISH, DISCONNECT]


async def test_a_clean_end_is_told_though_messages_wait_that_nobody_will_read() -> None:
    """A socket that is closed over unread bytes is reset, and its broker publishes the will."""
    async with Server() as server, linked(server) as (link, _):
        (session,) = server.sessions
        session.send(publish("drone1/commands", b"x" * 100) * 2000)
        await link.close()
        await eventually(lambda: session.ended, "the end")
        assert [packet.kind for packet in session.packets] == [CONNECT, DISCONNECT]
        assert not session.was_reset


@pytest.mark.long
async def test_a_last_word_that_the_broker_leaves_no_room_for_is_the_wills() -> None:
    async with Server(RECEIVE_MAXIMUM_2, acknowledges=False) as server, linked(server) as (link, _):
        (session,) = server.sessions
        for number in range(2):
            link.publish(Publish("fog", f"drone{number}/reachable", b"up", 1, retain=True))
        link.publish(Publish("fog", "drone1/reachable", b"down", 1, retain=True))
        await link.close()
        await eventually(lambda: session.ended, "the end")
        assert [packet.kind for packet in session.packets] == [CONNECT, PUBLISH, PUBLISH, DISCONNECT]
        assert session.packets[-1].body == WITH_WILL


async def test_who_ends_without_a_clean_stop_leaves_the_last_word_to_the_will() -> None:
    async with Server() as server:
        async with linked(server):
            (session,) = server.sessions
        await eventually(lambda: session.ended, "the end")
        assert [(packet.kind, packet.body) for packet in session.packets[1:]] == [(DISCONNECT, WITH_WILL)]


@pytest.mark.long
async def test_a_broker_that_takes_no_bytes_ends_no_role_with_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_module, "GOODBYE_S", 0.1)
    async with Server() as server:
        heard = Heard()
        link = MqttLink("fog", BrokerAddress("127.0.0.1", server.port), "client-1", None, heard)
        running = asyncio.create_task(link.run())
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[0].reads.clear()
        async with asyncio.timeout(20):
            while "held_up" not in heard.counted:
                link.publish(state("location", bytes(15_000)))
                await asyncio.sleep(0)
        await link.close()
        await asyncio.wait({running}, timeout=10)
        assert running.done()
        assert running.exception() is None


async def test_a_broker_that_takes_no_bytes_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outgoing, "MOST_HELD", 10)
    async with Server() as server, linked(server) as (link, heard):
        (session,) = server.sessions
        session.reads.clear()
        link.publish(state("battery"))  # the server's reader is inside its read until this has come
        await eventually(lambda: len(session.of(PUBLISH)) == 1, "the first message")
        sent = 0
        async with asyncio.timeout(20):
            while "held_up" not in heard.counted:
                link.publish(state("location", sent.to_bytes(4, "big") + bytes(15_000)))
                sent += 1
                await asyncio.sleep(0)
        session.reads.set()
        await eventually(lambda: len(session.of(PUBLISH)) == sent, "all that were not dropped")
        link.publish(state("heading"))
        await eventually(lambda: session.of(PUBLISH)[-1].publish()[0].endswith("heading"), "the next one")
        assert heard.counted == ["held_up"]
        assert heard.losses == 0


async def test_a_broker_that_leaves_out_an_acknowledgement_is_connected_to_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever else it acknowledges: each one takes a place in flight for good."""
    monkeypatch.setattr(connection_module, "_MISC_S", 0.01)
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server(acknowledges=False) as server, linked(server) as (link, heard):
        (session,) = server.sessions
        for number in range(3):
            link.publish(state("armed", qos=1, ref=number))
        await eventually(lambda: len(session.of(PUBLISH)) == 3, "sent")
        for packet in session.of(PUBLISH)[1:]:
            session.acknowledge(packet.publish()[3])
        for number in range(1, PROOFS + 1):
            await eventually(lambda n=number: len(session.of(PINGREQ)) == n, "asked")  # type: ignore[misc]
            session.send(PINGRESP)
        await eventually(lambda: heard.connections == 2, "connected again")
        (left,) = session.of(DISCONNECT)
        assert left.body[:1] == WITH_WILL
        assert heard.acknowledged == [(1, 0), (2, 0)]


async def test_so_is_one_that_leaves_out_the_answer_to_a_subscribe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it acknowledges: no other subscription is asked for before that one."""
    monkeypatch.setattr(connection_module, "_MISC_S", 0.01)
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    async with Server(granted=[SILENCE]) as server, linked(server) as (link, heard):
        (session,) = server.sessions
        link.subscribe(Subscribe("fog", ("drone1/commands",)))
        for number in range(1, PROOFS + 1):
            await eventually(lambda n=number: len(session.of(PINGREQ)) == n, "asked")  # type: ignore[misc]
            link.publish(state("armed", qos=1))
            session.send(PINGRESP)
        await eventually(lambda: heard.connections == 2, "connected again")


def looks(keep_alive: KeepAlive, oldest: int | None, answers: int = KEEPALIVE_S) -> int:
    """How often of so many times the publish counts as left out; the first `answers` times a ping is answered."""
    found = 0
    for now_s in range(KEEPALIVE_S):
        found += keep_alive.is_left_out(oldest, KEEPALIVE_S)
        if now_s < answers:
            keep_alive.ask(now_s)
            keep_alive.answered(now_s)
    return found


def test_messages_that_are_acknowledged_late_end_no_connection() -> None:
    keep_alive = KeepAlive()
    assert [looks(keep_alive, oldest) for oldest in (1, 2, None, 2, 3)] == [0] * 5
    assert keep_alive.is_left_out(3, KEEPALIVE_S)


def test_nor_does_a_broker_that_stands_still() -> None:
    keep_alive = KeepAlive()
    assert [looks(keep_alive, 1, answers) for answers in (PROOFS - 1, 0, 0)] == [0, 0, 0]
    assert [looks(keep_alive, 1, answers) for answers in (1, 0)] == [KEEPALIVE_S - 1, KEEPALIVE_S]


@pytest.mark.parametrize(("heard_s", "is_lost"), [(2 * KEEPALIVE_S, False), (0, True)])
def test_nor_does_a_slow_link_that_has_much_to_send_before_the_question(heard_s: float, is_lost: bool) -> None:
    """What the broker says comes all the same, a command to a drone too."""
    keep_alive = KeepAlive()
    looks(keep_alive, 1, 0)
    keep_alive.is_left_out(1, KEEPALIVE_S)
    assert keep_alive.is_due(KEEPALIVE_S, KEEPALIVE_S, KEEPALIVE_S)
    keep_alive.ask(KEEPALIVE_S)
    keep_alive.heard_s = heard_s
    assert keep_alive.is_lost(2 * KEEPALIVE_S + 1, KEEPALIVE_S) == is_lost
