"""A connection over which nothing comes is tried, and given up where it delivers nothing (R9.17)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mqttxt.core.effects import Publish, Reconnect
from mqttxt.core.hearing import ANSWER_MS, ASKED, LONGEST_SILENT_MS, SILENT_MS, STALL_MS, UNANSWERED_MS, Hearing
from mqttxt.core.mqtt.client import KEEPALIVE_S
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.world import CLOUD, FOG, World, ack

SAID = Publish(CLOUD, "own", b"", 1)
ASKS = [replace(SAID, ref=ASKED)]
LINKS = {"gs": CLOUD, "activator": CLOUD, "uav": FOG}
TAKEN, REFUSED = 0, 0x87


def hearing(granted_ms: int | None = 0) -> Hearing:
    tried = Hearing(CLOUD, lambda: [SAID])
    if granted_ms is not None:
        tried.connected(granted_ms)
        tried.granted(granted_ms)
    return tried


def given_up(tried: Hearing, from_ms: int, until_ms: int) -> int | None:
    """When it gives the connection up, ticking every 100 ms; nothing else is said meanwhile."""
    for now_ms in range(from_ms, until_ms, 100):
        found = tried.tick(now_ms)
        if found:
            (reconnect,) = found
            assert isinstance(reconnect, Reconnect)
            assert reconnect.link == CLOUD
            return now_ms
    return None


@pytest.fixture
def tried() -> Hearing:
    """Of a connection whose subscriptions were granted."""
    return hearing()


def test_nothing_is_said_before_the_subscriptions_and_after_the_end() -> None:
    tried = hearing(None)
    assert tried.tick(10 * SILENT_MS) == []
    tried.granted(0)
    tried.end()
    tried.heard(1)
    assert tried.tick(10 * SILENT_MS) == []


def test_who_hears_something_says_nothing(tried: Hearing) -> None:
    for now_ms in range(0, 10 * SILENT_MS, SILENT_MS - 1):
        assert tried.tick(now_ms) == []
        tried.heard(now_ms)


def test_silence_is_asked_once_and_then_the_connection_is_given_up_once(tried: Hearing) -> None:
    assert tried.tick(SILENT_MS - 1) == []
    assert tried.tick(SILENT_MS) == ASKS
    assert tried.published(ASKED, TAKEN, SILENT_MS + 100)
    assert tried.published(ASKED, TAKEN, SILENT_MS + 200), "by the other of two connections"
    due_ms = SILENT_MS + 100 + ANSWER_MS
    assert given_up(tried, SILENT_MS + 200, 10 * SILENT_MS) == due_ms
    assert tried.tick(10 * SILENT_MS) == []


def test_the_keep_alive_has_its_time_where_the_broker_acknowledges_nothing(tried: Hearing) -> None:
    """A broker that stands still would publish the will, and control would go to somebody else."""
    assert tried.tick(SILENT_MS) == ASKS
    assert not tried.published("a command's", TAKEN, SILENT_MS + 100)
    assert given_up(tried, SILENT_MS + 100, 10 * SILENT_MS) == SILENT_MS + UNANSWERED_MS
    assert SILENT_MS + UNANSWERED_MS > 2 * 1000 * KEEPALIVE_S + SILENT_MS / 2, "a PINGREQ, and its time"


def test_a_refusal_shows_nothing(tried: Hearing) -> None:
    assert tried.tick(SILENT_MS) == ASKS
    assert tried.published(ASKED, REFUSED, SILENT_MS + 100)
    assert given_up(tried, SILENT_MS + 100, 2 * SILENT_MS + 100) is None
    assert tried.tick(2 * SILENT_MS + 100) == ASKS


def test_subscriptions_that_are_never_granted_are_asked_for_on_another_connection() -> None:
    tried = hearing(None)
    tried.connected(0)
    for now_ms in range(0, UNANSWERED_MS, 1_000):
        tried.heard(now_ms)
    assert given_up(tried, 0, 10 * SILENT_MS) == UNANSWERED_MS


def test_who_may_not_hear_itself_asks_ever_more_rarely_until_it_hears_something() -> None:
    tried, asked_after_ms = hearing(None), []
    now_ms = 0
    for _ in range(6):
        tried.connected(now_ms)
        tried.granted(now_ms)
        begun_ms = now_ms
        while not tried.tick(now_ms):
            now_ms += 100
        asked_after_ms.append(now_ms - begun_ms)
        tried.published(ASKED, TAKEN, now_ms)
        assert given_up(tried, now_ms + 100, now_ms + 10 * SILENT_MS) == now_ms + ANSWER_MS
        now_ms += ANSWER_MS
    assert asked_after_ms == [factor * SILENT_MS for factor in (1, 2, 4, 8, 8, 8)]
    tried.granted(now_ms)
    tried.heard(now_ms)
    assert tried.tick(now_ms + SILENT_MS) == ASKS


def test_an_answer_in_time_begins_the_silence_anew(tried: Hearing) -> None:
    assert tried.tick(SILENT_MS) == ASKS
    tried.published(ASKED, TAKEN, SILENT_MS)
    answered_ms = SILENT_MS + ANSWER_MS - 1
    tried.heard(answered_ms)
    assert tried.tick(answered_ms + SILENT_MS - 1) == []
    assert tried.tick(answered_ms + SILENT_MS) == ASKS


def test_a_process_that_stood_still_asks_before_it_gives_up(tried: Hearing) -> None:
    assert tried.tick(100 * SILENT_MS) == ASKS
    assert tried.tick(100 * SILENT_MS + 1) == []


@pytest.mark.parametrize("then_ms", [0, 50])
def test_a_process_that_stood_still_after_it_asked_reads_first_what_has_come(then_ms: int, tried: Hearing) -> None:
    """At whichever tick behind the pause its time was over."""
    assert tried.tick(SILENT_MS) == ASKS
    tried.published(ASKED, TAKEN, SILENT_MS)
    goes_on_ms = SILENT_MS + ANSWER_MS - then_ms
    assert tried.tick(goes_on_ms) == []
    assert given_up(tried, goes_on_ms + then_ms, 10 * SILENT_MS) == goes_on_ms + then_ms + ANSWER_MS


def test_a_process_that_is_slow_for_good_gives_up_all_the_same(tried: Hearing) -> None:
    ticks = range(0, 3 * SILENT_MS, STALL_MS + 100)
    found = []
    for now_ms in ticks:
        found += tried.tick(now_ms)
        tried.published(ASKED, TAKEN, now_ms)
    assert [type(one) for one in found] == [Publish, Reconnect]


@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_nothing_is_tried_behind_the_goodbye(name: str, link: str) -> None:
    world = World().start(1_000)
    role = getattr(world, name)
    world.lose_subscriptions(name, link)
    list(role.goodbye(world.now_ms))
    ticks = range(world.now_ms, world.now_ms + 2 * (SILENT_MS + ANSWER_MS), 100)
    said = [effect for now_ms in ticks for effect in role.tick(now_ms)]
    assert not [effect for effect in said if isinstance(effect, Reconnect)]
    births = ("gs/g/reachable", "fog1/reachable", "drone1/reachable")
    assert not [effect for effect in said if isinstance(effect, Publish) and effect.topic in births]


@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_no_role_gives_up_a_broker_that_stands_still_before_the_keep_alive_does(name: str, link: str) -> None:
    world = World().start(20_000)
    role, begun_ms = getattr(world, name), world.now_ms
    said = [effect for now_ms in range(begun_ms, begun_ms + 30_000, 50) for effect in role.tick(now_ms)]
    assert [effect for effect in said if isinstance(effect, Publish) and effect.ref == ASKED]
    assert not [effect for effect in said if isinstance(effect, Reconnect)]


def test_the_times_are_those_of_the_specification() -> None:
    times = (SILENT_MS, ANSWER_MS, UNANSWERED_MS, STALL_MS, LONGEST_SILENT_MS)
    assert times == (12_000, 5_000, 30_000, 1_000, 96_000)


@pytest.mark.parametrize("signed", [False, True], ids=["plain", "signed"])
@pytest.mark.parametrize(("name", "link"), LINKS.items())
def test_a_role_whose_subscriptions_the_broker_lost_connects_anew_and_commands_are_executed(
    name: str, link: str, signed: bool
) -> None:
    world = World(signed=signed).start(5_000)
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
    world = World().start(1_000)
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
    for now_ms in range(0, SILENT_MS + UNANSWERED_MS + 100, 100):
        world.now_ms = now_ms
        world.run("activator", world.activator.tick(now_ms))
    assert [who for who, _ in world.reconnects] == ["activator"]
    assert not any(said.retain for _, said in world.sent if said.topic == "fog1/reachable")
