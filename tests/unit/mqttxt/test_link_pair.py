"""A link by two addresses against two brokers' sides on loopback: what runs it; `test_two_links` has the rules."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from time import monotonic_ns

from mqttxt.core.effects import Subscribe, Will
from mqttxt.core.mqtt.link import BrokerAddress
from mqttxt.core.mqtt.pair import MqttLinkPair
from mqttxt.drone.process import shared_topics
from mqttxt.protocol.topics import FogSide
from tests.rigs.linked import Heard, linked, state
from tests.rigs.mqtt_server import CONNECT, DISCONNECT, PUBLISH, SUBSCRIBE, Server, Session
from tests.rigs.processes import eventually

PINGREQ = 12
PINGRESP = b"\xd0\x00"


@asynccontextmanager
async def paired(*servers: Server) -> AsyncIterator[tuple[MqttLinkPair, Heard]]:
    """Two links, both of which are up."""
    heard, (first, second) = Heard(), (BrokerAddress("127.0.0.1", server.port) for server in servers)
    will, shared = Will("drone1/reachable", b"down"), shared_topics(FogSide(), 1)
    pair = MqttLinkPair(
        "fog", (first, second), "client", lambda: will, shared, heard, lambda: monotonic_ns() // 1_000_000
    )
    running = asyncio.create_task(pair.run())
    try:
        await eventually(lambda: all(server.sessions for server in servers), "both links")
        await eventually(lambda: all(server.sessions[0].of(PINGREQ) for server in servers), "both are asked")
        yield pair, heard
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def said(session: Session) -> list[str]:
    return [packet.publish()[0] for packet in session.of(PUBLISH)]


async def test_the_questions_of_a_link_are_answered_in_their_order() -> None:
    answers: list[int] = []
    async with Server() as server, linked(server) as (link, _):
        (session,) = server.sessions
        link.probe(lambda: answers.append(1))
        link.probe(lambda: answers.append(2))
        await eventually(lambda: len(session.of(PINGREQ)) == 2, "both questions")
        session.send(PINGRESP)
        await eventually(lambda: answers == [1], "the first answer")
        session.send(PINGRESP)
        await eventually(lambda: answers == [1, 2], "the second answer")


async def test_each_connection_has_a_client_id_and_a_will_of_its_own() -> None:
    """R19.2, R19.3."""
    async with Server() as one, Server() as two, paired(one, two) as (_, heard):
        (first,), (second,) = one.sessions, two.sessions
        bodies = [session.of(CONNECT)[0].body for session in (first, second)]
        assert b"\x00\x06client" in bodies[0]
        assert b"\x00\x08client-2" in bodies[1]
        assert b"drone1/reachable" in bodies[0]
        assert b"drone1/second/reachable" in bodies[1]
        assert heard.connections == 1


async def test_when_one_connection_ends_all_goes_on_over_the_other() -> None:
    """R19.10, R19.12."""
    async with Server() as one, Server() as two, paired(one, two) as (pair, heard):
        sessions = {one.port: one.sessions[0], two.port: two.sessions[0]}
        main = sessions.pop(pair.address.port)
        (other,) = sessions.values()
        pair.publish(state("armed"))
        await eventually(lambda: said(main) == ["drone1/state/armed"], "over the main link")
        main.end()
        await eventually(lambda: heard.connections == 2, "over the other one")
        pair.subscribe(Subscribe("fog", ("drone1/commands",), live_only=True))
        pair.publish(state("heading"))
        await eventually(lambda: said(other) == ["drone1/state/heading"], "what is said then")
        await eventually(lambda: any(b"drone1/commands" in p.body for p in other.of(SUBSCRIBE)), "subscribed")
        assert heard.losses == 0


async def test_a_broker_that_answers_nothing_is_left() -> None:
    """R19.10: no connection ends."""
    async with Server() as one, Server() as two, paired(one, two) as (pair, heard):
        silent = one if pair.address.port == one.port else two
        (answering,) = {one, two} - {silent}
        session, done = answering.sessions[0], 0

        def answers() -> bool:
            nonlocal done
            while done < len(session.of(PINGREQ)):
                done += 1
                session.send(PINGRESP)
            return pair.address.port == answering.port

        await eventually(answers, "over the link that answers")
        assert heard.losses == 0


async def test_a_clean_end_takes_leave_on_both() -> None:
    """R9.3."""
    async with Server() as one, Server() as two, paired(one, two) as (pair, _):
        closing = asyncio.create_task(pair.close())
        await eventually(lambda: all(server.sessions[0].of(DISCONNECT) for server in (one, two)), "DISCONNECT")
        for server in (one, two):
            server.sessions[0].end()
        await closing
        assert [server.sessions[0].of(DISCONNECT)[0].body for server in (one, two)] == [b"", b""]
