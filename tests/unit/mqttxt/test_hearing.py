"""A connection over which nothing comes is tried, and given up where it delivers nothing (R9.17)."""

from __future__ import annotations

import pytest

from mqttxt.core.effects import Publish, Reconnect
from mqttxt.core.hearing import ANSWER_MS, SILENT_MS, Hearing
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.world import CLOUD, FOG, World, ack

SAID = Publish(CLOUD, "own", b"")
LINKS = {"gs": CLOUD, "activator": CLOUD, "uav": FOG}


def hearing() -> Hearing:
    return Hearing(CLOUD, lambda: [SAID])


def test_nothing_is_said_before_the_subscriptions_and_after_the_end() -> None:
    tried = hearing()
    assert tried.tick(10 * SILENT_MS) == []
    tried.heard(0)
    tried.end()
    assert tried.tick(10 * SILENT_MS) == []


def test_who_hears_something_says_nothing() -> None:
    tried = hearing()
    for now_ms in range(0, 10 * SILENT_MS, SILENT_MS - 1):
        assert tried.tick(now_ms) == []
        tried.heard(now_ms)


def test_silence_is_asked_once_and_then_the_connection_is_given_up_once() -> None:
    tried = hearing()
    tried.heard(0)
    assert tried.tick(SILENT_MS - 1) == []
    assert tried.tick(SILENT_MS) == [SAID]
    for now_ms in range(SILENT_MS + 100, SILENT_MS + ANSWER_MS, 100):
        assert tried.tick(now_ms) == []
    (given_up,) = tried.tick(SILENT_MS + ANSWER_MS)
    assert isinstance(given_up, Reconnect)
    assert given_up.link == CLOUD
    assert tried.tick(10 * SILENT_MS) == []


def test_an_answer_in_time_begins_the_silence_anew() -> None:
    tried = hearing()
    tried.heard(0)
    assert tried.tick(SILENT_MS) == [SAID]
    answered_ms = SILENT_MS + ANSWER_MS - 1
    tried.heard(answered_ms)
    assert tried.tick(answered_ms + SILENT_MS - 1) == []
    assert tried.tick(answered_ms + SILENT_MS) == [SAID]


def test_a_process_that_stood_still_asks_before_it_gives_up() -> None:
    tried = hearing()
    tried.heard(0)
    assert tried.tick(100 * SILENT_MS) == [SAID]
    assert tried.tick(100 * SILENT_MS + 1) == []


def test_a_process_that_stood_still_after_it_asked_reads_first_what_has_come() -> None:
    tried = hearing()
    tried.heard(0)
    assert tried.tick(SILENT_MS) == [SAID]
    goes_on_ms = 5 * SILENT_MS
    assert tried.tick(goes_on_ms) == []
    for now_ms in range(goes_on_ms + 100, goes_on_ms + ANSWER_MS, 100):
        assert tried.tick(now_ms) == []
    (given_up,) = tried.tick(goes_on_ms + ANSWER_MS)
    assert isinstance(given_up, Reconnect)


@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_nothing_is_tried_behind_the_goodbye(name: str, link: str) -> None:
    world = World().start()
    world.pass_time(1_000)
    role = getattr(world, name)
    world.lose_subscriptions(name, link)
    list(role.goodbye(world.now_ms))
    ticks = range(world.now_ms, world.now_ms + 2 * (SILENT_MS + ANSWER_MS), 100)
    said = [effect for now_ms in ticks for effect in role.tick(now_ms)]
    assert not [effect for effect in said if isinstance(effect, Reconnect)]
    births = ("gs/g/reachable", "fog1/reachable", "drone1/reachable")
    assert not [effect for effect in said if isinstance(effect, Publish) and effect.topic in births]


@pytest.mark.parametrize("signed", [False, True], ids=["plain", "signed"])
@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_a_role_whose_subscriptions_the_broker_lost_connects_anew_and_commands_are_executed(
    name: str, link: str, signed: bool
) -> None:
    world = World(signed=signed).start()
    world.pass_time(5_000)
    world.lose_subscriptions(name, link)
    world.pass_time(SILENT_MS + ANSWER_MS + 1_000)
    assert [(who, effect.link) for who, effect in world.reconnects] == [(name, link)]
    world.pass_time(5_000)
    fog = world.gs.fogs[1]
    assert fog.drones[1].reachable
    assert fog.controls(1)
    command = world.send(Arm())
    world.pass_time(300)
    world.autopilot(ack(400))
    assert [said.word for said in world.heard if isinstance(said, Outcome) and said.id == command] == [Word.ACCEPTED]
    assert len(world.wrote) == 1
    assert not world.stops


@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_who_is_alone_hears_itself_and_stays_connected(name: str, link: str) -> None:
    world = World().start()
    world.pass_time(1_000)
    for other in LINKS.keys() - {name}:
        world.lose_subscriptions(other, LINKS[other])
    world.sent.clear()
    for now_ms in range(world.now_ms, world.now_ms + 10 * SILENT_MS, 100):
        world.now_ms = now_ms
        world.run(name, getattr(world, name).tick(now_ms))
    births = [said for who, said in world.sent if who == name and said.link == link and said.retain]
    assert len(births) >= 9
    assert world.reconnects == []


def test_an_activator_that_is_not_born_connects_anew_where_its_beacon_does_not_come_back() -> None:
    world = World()
    world.run("activator", world.activator.on_connected(FOG, 0))
    world.drop = {"clock"}
    world.run("activator", world.activator.on_connected(CLOUD, 0))
    for now_ms in range(0, SILENT_MS + ANSWER_MS + 100, 100):
        world.now_ms = now_ms
        world.run("activator", world.activator.tick(now_ms))
    assert [who for who, _ in world.reconnects] == ["activator"]
    assert not any(said.retain for _, said in world.sent if said.topic == "fog1/reachable")
