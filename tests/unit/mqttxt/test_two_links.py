"""Two links of a drone at once (docs/protocol.md, section 19): rules without a broker, and 1,000 cuts in true time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from mqttxt.core.effects import Inbound, Publish, Subscribe, Unsubscribe
from mqttxt.core.mqtt.measure import MOST_PATIENCE_MS, Measure
from mqttxt.core.mqtt.two_links import PRESENCE, TwoLinks
from mqttxt.drone.process import shared_topics
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import Arm, Hold, Land, Return
from mqttxt.protocol.messages import DroneRecord, Presence, Word
from mqttxt.protocol.topics import FogSide
from tests.examples import first_quick
from tests.simulation.adversary import Dangers
from tests.simulation.fogs import ActivatorBench, of, ready, words
from tests.simulation.signed import kinds, outcomes
from tests.simulation.signing import seal
from tests.simulation.two_links import CALM_COMMANDS, GEO, LEO, LTE, TwoLinkSimulation
from tests.simulation.world import FOG_SESSION, UAV_SESSION, World, ack
from tests.simulation.world import ready as made_ready

FIRST, SECOND = "fog-1", "fog-2"
SHARED = shared_topics(FogSide(), 1)
BOTH, ALONE, LEASE = "drone1/both_links", "drone1/commands", "drone1/init_connect"
NEWCOMER = 0x99


@dataclass
class Way:
    """One link whose broker is the test: what was said, in its order, and which PINGREQ waits for its answer."""

    said: list[Any] = field(default_factory=list)
    asked: list[Callable[[], None]] = field(default_factory=list)
    given_up: int = 0

    def publish(self, effect: Publish) -> None:
        self.said.append(effect)

    def subscribe(self, effect: Subscribe) -> None:
        self.said.append(effect)

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self.said.append(effect)

    def probe(self, answered: Callable[[], None]) -> None:
        self.asked.append(answered)

    def give_up(self, reason: str) -> None:
        self.given_up += 1

    def topics(self) -> list[str]:
        return [effect.topic for effect in self.said if isinstance(effect, Publish)]

    def filters(self) -> list[str]:
        return [topic for effect in self.said if isinstance(effect, Subscribe) for topic in effect.filters]


class Bench:
    """Two links, and the role above them: it subscribes as a UAV client does, and notes what it hears."""

    def __init__(self) -> None:
        self.now_ms = 0
        self.ways = {FIRST: Way(), SECOND: Way()}
        self.two = TwoLinks("fog", (FIRST, SECOND), SHARED, self, lambda: self.now_ms)
        self.two.ways = tuple(self.ways.values())
        self.heard: list[Inbound] = []
        self.happened: list[str] = []
        self.under_way: list[tuple[int, Callable[[], None]]] = []

    # What the role hears.

    def connected(self, link: str) -> None:
        self.happened.append("connected")
        self.two.subscribe(Subscribe(link, (ALONE,), live_only=True))
        self.two.subscribe(Subscribe(link, (LEASE, SHARED.presence[0])))

    def disconnected(self, link: str) -> None:
        self.happened.append("disconnected")

    def received(self, link: str, message: Inbound) -> None:
        self.heard.append(message)

    def subscribed(self, subscribe: Subscribe) -> None:
        self.happened.append(f"subscribed to {subscribe.filters[0]}")

    def published(self, link: str, ref: Hashable, code: int) -> None:
        self.happened.append(f"{ref} {code}")

    def count(self, kind: str, detail: str) -> None:
        self.happened.append(kind)

    # What the test does.

    def grant(self, link: str) -> None:
        """SUBACK for each subscription of a link that waits for it."""
        said = self.ways[link].said
        waiting = [effect for effect in said if isinstance(effect, Subscribe)]
        self.ways[link].said = [effect for effect in said if not isinstance(effect, Subscribe)]
        for effect in waiting:
            self.two.subscribed(effect)

    def up(self, *links: str) -> Bench:
        for link in links:
            self.two.connected(link)
            self.grant(link)
        return self

    def hear(self, link: str, topic: str, payload: bytes = b"") -> None:
        self.two.received(link, Inbound(topic, payload, 1))

    def say(self, topic: str) -> Publish:
        effect = Publish("fog", topic, b"", qos=1, retain=topic in SHARED.presence)
        self.two.publish(effect)
        return effect

    def pass_time(self, milliseconds: int, **round_trips_ms: int | None) -> None:
        """The links answer after so long (`first`, `second`), or, with None, not at all."""
        until_ms = self.now_ms + milliseconds
        trips = dict(zip((FIRST, SECOND), (round_trips_ms["first"], round_trips_ms["second"]), strict=True))
        while self.now_ms < until_ms:
            self.now_ms += 10
            due = [one for one in self.under_way if one[0] <= self.now_ms]
            self.under_way = [one for one in self.under_way if one[0] > self.now_ms]
            for _, answered in due:
                answered()
            if self.now_ms % 50 == 0:
                self.two.tick()
            for link, way in self.ways.items():
                trip_ms = trips[link]
                if trip_ms is not None:
                    self.under_way += [(self.now_ms + trip_ms, answered) for answered in way.asked]
                    way.asked.clear()

    @property
    def main(self) -> str | None:
        return None if self.two.main is None else (FIRST, SECOND)[self.two.main]


# R19.3, R19.4: presence, and what each link hears.


def test_the_link_that_is_up_first_is_the_main_one_and_both_hear_what_is_for_both() -> None:
    """R19.4."""
    bench = Bench()
    bench.two.connected(SECOND)
    bench.two.connected(FIRST)
    assert bench.main == SECOND
    assert bench.ways[SECOND].filters() == [BOTH, "drone1/second/reachable", ALONE, LEASE]
    assert bench.ways[FIRST].filters() == [BOTH, "drone1/reachable"]
    live_only = [effect.live_only for effect in bench.ways[FIRST].said if BOTH in effect.filters]
    assert live_only == [True]
    assert bench.happened == ["connected"]


def test_each_link_says_its_own_presence_once_it_hears_what_is_for_both() -> None:
    """R19.3."""
    bench = Bench().up(FIRST)
    bench.two.connected(SECOND)
    bench.say("drone1/reachable")
    assert bench.ways[FIRST].topics() == ["drone1/reachable"]
    assert bench.ways[SECOND].topics() == []
    bench.grant(SECOND)
    assert bench.ways[SECOND].topics() == ["drone1/second/reachable"]
    assert all(way.said[-1].retain for way in bench.ways.values())


def test_what_a_link_hears_of_its_own_presence_the_role_hears_as_of_the_one_it_knows() -> None:
    """R9.1 holds for both topics; and what is for both is a command like any other."""
    bench = Bench().up(FIRST, SECOND)
    bench.hear(SECOND, "drone1/second/reachable", b"a")
    bench.hear(SECOND, BOTH, b"b")
    assert [(each.topic, each.payload) for each in bench.heard] == [("drone1/reachable", b"a"), (ALONE, b"b")]


def test_of_what_a_link_says_of_itself_the_role_hears_nothing() -> None:
    """R19.3: it is up once the broker has that; a word's acknowledgement is the role's."""
    bench = Bench().up(FIRST)
    bench.say("drone1/reachable")
    bench.two.published(FIRST, bench.ways[FIRST].said[-1].ref, 0)
    bench.two.published(FIRST, "a word", 0)
    assert bench.happened[-1] == "a word 0"
    assert not any(PRESENCE in each for each in bench.happened)


# R19.7, R19.8: what goes out where, and what counts.


@pytest.mark.parametrize("command", [Hold(), Land(), Return()])
def test_words_about_a_halt_go_over_both_links_all_else_over_the_main_one(command: Any) -> None:
    """R19.7."""
    bench = Bench().up(FIRST, SECOND)
    for topic in (f"drone1/commands_result/{command.name}", "drone1/commands_result/arm", "drone1/state/armed"):
        bench.say(topic)
    assert len(bench.ways[FIRST].topics()) == 3
    assert bench.ways[SECOND].topics() == [f"drone1/commands_result/{command.name}"]


def test_a_lease_counts_over_the_main_link_alone() -> None:
    """R19.8."""
    bench = Bench().up(FIRST, SECOND)
    bench.hear(SECOND, LEASE)
    assert bench.heard == []
    bench.hear(FIRST, LEASE)
    assert len(bench.heard) == 1


def test_a_lease_that_was_under_way_on_a_link_before_it_became_the_main_one_does_not_count() -> None:
    """R19.8: the first link's stream still has leases that are older than those of the second one."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(1000, first=50, second=50)
    bench.pass_time(1000, first=None, second=50)
    assert bench.main == SECOND
    bench.grant(SECOND)
    bench.hear(SECOND, LEASE, b"newer")
    bench.pass_time(3000, first=50, second=None)
    assert bench.main == FIRST
    bench.hear(FIRST, LEASE, b"older")
    assert [each.payload for each in bench.heard] == [b"newer"]
    bench.grant(FIRST)
    bench.hear(FIRST, LEASE, b"newest")
    assert [each.payload for each in bench.heard] == [b"newer", b"newest"]


# R19.9 to R19.13: measuring, and changing places.


def test_a_link_that_is_silent_is_left_at_once() -> None:
    """R19.10, within the bound of section 19."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(3000, first=60, second=600)
    assert bench.main == FIRST
    bench.pass_time(700, first=None, second=600)
    assert bench.main == SECOND
    assert bench.happened.count("connected") == 2
    assert "disconnected" not in bench.happened


def test_the_new_main_link_subscribes_before_the_old_one_unsubscribes() -> None:
    """R19.12."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(1000, first=50, second=50)
    bench.pass_time(1000, first=None, second=50)
    assert ALONE in bench.ways[SECOND].filters()
    gone = [effect for effect in bench.ways[FIRST].said if isinstance(effect, Unsubscribe)]
    assert gone == []
    bench.grant(SECOND)
    (gave_up,) = [effect for effect in bench.ways[FIRST].said if isinstance(effect, Unsubscribe)]
    assert gave_up.filters == tuple(sorted((ALONE, LEASE)))


def test_a_suback_of_the_link_that_was_the_main_one_says_nothing_of_the_new_one() -> None:
    """R19.12."""
    bench = Bench()
    bench.two.connected(FIRST)
    late = [effect for effect in bench.ways[FIRST].said if ALONE in effect.filters]
    bench.up(SECOND)
    bench.two.disconnected(FIRST)
    bench.happened.clear()
    bench.two.subscribed(late[0])
    assert bench.happened == []
    bench.grant(SECOND)
    assert bench.happened == [f"subscribed to {ALONE}", f"subscribed to {LEASE}"]


def test_a_connection_that_ends_is_left_at_once_and_the_last_one_is_the_end() -> None:
    """R19.10."""
    bench = Bench().up(FIRST, SECOND)
    bench.two.disconnected(FIRST)
    assert (bench.main, bench.happened.count("disconnected")) == (SECOND, 0)
    bench.say("drone1/state/armed")
    assert bench.ways[SECOND].topics() == ["drone1/state/armed"]
    bench.two.disconnected(SECOND)
    assert (bench.main, bench.happened[-1]) == (None, "disconnected")
    bench.up(FIRST)
    assert (bench.main, bench.happened.count("connected")) == (FIRST, 3)


def test_where_both_are_silent_nothing_changes() -> None:
    """R19.10."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(3000, first=60, second=60)
    bench.pass_time(600, first=60, second=None)
    changes = bench.happened.count("connected")
    bench.pass_time(3000, first=None, second=None)
    assert bench.happened.count("connected") <= changes + 1
    assert sum(way.given_up for way in bench.ways.values()) == 0


@pytest.mark.parametrize(
    ("first_ms", "second_ms", "is_left"), [(300, 60, True), (90, 60, False), (60, 90, False), (200, 150, False)]
)
def test_a_better_link_becomes_the_main_one_only_if_it_is_clearly_better_for_long(
    first_ms: int, second_ms: int, is_left: bool
) -> None:
    """R19.11."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(4000, first=first_ms, second=second_ms)
    assert bench.main == FIRST
    bench.pass_time(20_000, first=first_ms, second=second_ms)
    assert (bench.main == SECOND) is is_left


def test_two_links_of_changing_quality_do_not_take_turns() -> None:
    """R19.11: none is clearly better for 5 s."""
    bench = Bench().up(FIRST, SECOND)
    for _ in range(20):
        bench.pass_time(3000, first=60, second=300)
        bench.pass_time(3000, first=300, second=60)
    assert bench.happened.count("connected") == 1


def test_loss_makes_a_link_worse() -> None:
    """R19.9."""
    clean, lossy = Measure(), Measure()
    for number in range(40):
        for measure in (clean, lossy):
            measure.on_asked(number * 1000)
            late = measure is lossy and number % 3 == 0
            for _ in range(30 if late else 1):
                measure.on_time(50)
            measure.on_answer(number * 1000 + (1500 if late else 50))
    assert clean.cost_ms == pytest.approx(50)
    assert clean.loss == 0
    assert lossy.loss > 0.15
    assert lossy.cost_ms is not None
    assert lossy.cost_ms > 300


def test_a_round_trip_that_has_grown_for_good_is_learned() -> None:
    """R19.9: else a satellite behind a fast network would be silent for ever."""
    measure = Measure()
    for number in range(60):
        trip_ms = 50 if number < 20 else 900
        measure.on_asked(number * 1000)
        for _ in range(trip_ms // 50):
            measure.on_time(50)
        measure.on_answer(number * 1000 + trip_ms)
    assert 450 < measure.patience_ms / 2 <= MOST_PATIENCE_MS / 2
    measure.on_asked(60_000)
    measure.on_time(100)
    assert not measure.is_silent


def test_time_in_which_the_process_stood_still_makes_no_link_silent() -> None:
    """R19.9."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(1000, first=50, second=50)
    bench.two.tick()
    bench.now_ms += 30_000
    bench.two.tick()
    assert bench.main == FIRST


def test_a_silent_link_is_given_up_after_5_s_and_only_beside_one_that_answers() -> None:
    """R19.13."""
    bench = Bench().up(FIRST, SECOND)
    bench.pass_time(3000, first=50, second=50)
    bench.pass_time(5000, first=None, second=50)
    assert bench.ways[FIRST].given_up == 0
    bench.pass_time(600, first=None, second=50)
    assert bench.ways[FIRST].given_up > 0
    assert bench.ways[SECOND].given_up == 0


def test_the_other_link_is_asked_less_often_than_the_main_one() -> None:
    """R19.9."""
    bench, asked = Bench().up(FIRST, SECOND), Counter[str]()
    for _ in range(1000):
        before = {link: len(way.asked) for link, way in bench.ways.items()}
        bench.now_ms += 10
        if bench.now_ms % 50 == 0:
            bench.two.tick()
        for link, way in bench.ways.items():
            asked[link] += len(way.asked) - before[link]
            for answered in way.asked:
                answered()
            way.asked.clear()
    assert asked == {FIRST: 50, SECOND: 5}


# R19.3 at the activator: presence.


def second(up: bool = True, session: int = UAV_SESSION) -> Presence:
    return Presence(session=session, up=up)


def up_words(effects: list[Any]) -> list[bool]:
    return [decode(DroneRecord, each.payload).up for each in of(effects, "fog1/drone1/reachable")]


@pytest.mark.parametrize("lost_first", ["drone1/reachable", "drone1/second/reachable"])
def test_a_drone_is_reachable_while_one_of_its_links_is_up(lost_first: str) -> None:
    """R19.3."""
    bench = ready()
    bench.fog("drone1/second/reachable", second())
    lost_last = "drone1/second/reachable" if lost_first == "drone1/reachable" else "drone1/reachable"
    assert up_words(bench.fog(lost_first, second(up=False))) == []
    assert up_words(bench.fog(lost_last, second(up=False))) == [False]


def test_a_link_that_comes_back_counts_again() -> None:
    """R19.3."""
    bench = ready()
    bench.fog("drone1/second/reachable", second())
    for lost in ("drone1/reachable", "drone1/second/reachable"):
        assert up_words(bench.fog(lost, second(up=False))) == []
        bench.fog(lost, second())


def test_a_drone_may_be_there_by_its_second_link_alone() -> None:
    """R19.3."""
    bench = ActivatorBench()
    bench.fog("drone1/second/reachable", second())
    nonces = bench.role.drones.links[1].nonces
    assert up_words(bench.echo(next(iter(nonces)))) == [True]


def test_the_second_link_of_another_session_is_a_newcomer() -> None:
    """R19.3, R9.5: it is contested, and bound with the links that it has shown."""
    bench = ready()
    out = bench.fog("drone1/second/reachable", second(session=NEWCOMER))
    assert [effect.kind for effect in out if hasattr(effect, "kind")] == ["contested"]
    bench.fog("drone1/reachable", second(session=NEWCOMER))
    bench.until(bench.now_ms + 2000)
    link = bench.role.drones.links[1]
    assert (link.session, link.ways, link.has_second) == (NEWCOMER, {"", "second"}, True)
    bench.fog("drone1/second/reachable", second(up=False, session=UAV_SESSION))
    assert link.ways == {"", "second"}


def test_after_the_fog_broker_was_lost_no_link_counts_that_does_not_say_so_again() -> None:
    """R19.3."""
    bench = ready()
    bench.fog("drone1/second/reachable", second())
    bench.role.on_disconnected("fog", bench.now_ms)
    assert bench.role.drones.links[1].ways == set()


# R19.5: commands.


def with_second(**how: Any) -> ActivatorBench:
    bench = ready(**how)
    bench.fog("drone1/second/reachable", second())
    return bench


@pytest.mark.parametrize("command", [Hold(), Land(), Return()])
def test_a_halt_goes_over_both_links(command: Any) -> None:
    """R19.5."""
    out = with_second().command(command)
    assert len(of(out, BOTH)) == 1
    assert of(out, ALONE) == []


def test_also_while_the_second_link_is_down() -> None:
    """R19.5: which one is the main one the activator does not know."""
    bench = with_second()
    bench.fog("drone1/second/reachable", second(up=False))
    assert len(of(bench.command(Hold()), BOTH)) == 1


def test_a_drone_with_one_link_hears_nothing_of_section_19() -> None:
    """R19.1."""
    bench = ready()
    out = bench.command(Hold()) + bench.command(Arm(), seq=2) + bench.until(bench.now_ms + 4000)
    assert of(out, BOTH) == []
    assert len(of(out, ALONE)) == 2


def test_another_command_goes_over_both_once_where_no_word_comes() -> None:
    """R19.5."""
    bench = with_second()
    out = bench.command()
    assert of(out, BOTH) == []
    (alone,) = of(out, ALONE)
    assert of(bench.until(bench.now_ms + 200), BOTH) == []
    (both,) = of(bench.until(bench.now_ms + 4000), BOTH)
    assert both.payload == alone.payload


def test_not_where_a_word_has_come() -> None:
    """R19.5."""
    bench = with_second()
    bench.command()
    bench.result(Word.ACCEPTED)
    assert of(bench.until(bench.now_ms + 4000), BOTH) == []


def test_nobody_at_the_main_link_is_no_reason_to_wait_and_nobody_at_either_is_unreachable() -> None:
    """R19.5, R5.9."""
    bench = with_second()
    (alone,) = of(bench.command(), ALONE)
    out = list(bench.role.on_published("fog", alone.ref, 0x10, bench.now_ms))
    (both,) = of(out, BOTH)
    assert words(out) == []
    out = list(bench.role.on_published("fog", both.ref, 0x10, bench.now_ms))
    assert words(out) == [(Word.UNREACHABLE, "no_subscriber")]


def test_one_copy_that_somebody_heard_keeps_the_command_open() -> None:
    """R19.5, R5.9."""
    bench = with_second()
    (alone,) = of(bench.command(), ALONE)
    bench.role.on_published("fog", alone.ref, 0, bench.now_ms)
    (both,) = of(bench.until(bench.now_ms + 400), BOTH)
    assert words(list(bench.role.on_published("fog", both.ref, 0x10, bench.now_ms))) == []


def test_a_query_goes_over_both_links() -> None:
    """R19.5, R5.11."""
    out = with_second().command(executor_session=FOG_SESSION + 1)
    assert len(of(out, BOTH)) == 1
    assert of(out, ALONE) == []


# R19.6, R19.12: the UAV client.


def test_the_second_copy_of_a_command_is_a_duplicate() -> None:
    """R19.6, in both orders of two copies: by the ledger."""
    world = World().start()
    world.pass_time(1000)
    sent = world.send(Hold())
    (forwarded,) = [publish for _, publish in world.sent if publish.topic == ALONE]
    wrote = len(world.wrote)
    assert wrote > 0
    again = Inbound(ALONE, forwarded.payload, 1)
    world.run("uav", world.uav.on_message("fog", again, world.now_ms))
    assert len(world.wrote) == wrote
    assert sent.seq == 1


def test_on_another_link_everything_is_said_again_at_once_and_nothing_begins_anew() -> None:
    """R19.12: subscriptions, then beacon and newest words without waiting; the birth behind the SUBACKs."""
    world = World().start()
    world.pass_time(1000)
    world.send(Arm())
    world.run("uav", world.uav.on_mavlink(ack(400), world.now_ms))
    moved = world.uav.on_connected("fog", world.now_ms)
    subscribes = [effect for effect in moved if isinstance(effect, Subscribe)]
    assert moved[:2] == subscribes
    said = [effect.topic for effect in moved if isinstance(effect, Publish)]
    assert said == ["drone1/clock", "drone1/commands_result/arm"]
    assert world.uav.born
    states = {effect.topic for effect in world.uav.tick(world.now_ms + 50) if isinstance(effect, Publish)}
    assert {"drone1/state/location", "drone1/state/armed"} <= states
    births = [effect for each in subscribes for effect in world.uav.on_subscribed(each, world.now_ms)]
    assert [effect.topic for effect in births if isinstance(effect, Publish)] == ["drone1/reachable"]


def test_a_client_that_is_connected_for_the_first_time_says_nothing_before_its_subacks() -> None:
    """R9.1: no change of links."""
    world = World()
    made_ready(world.uav)
    world.uav.on_disconnected("fog", 100)
    assert all(isinstance(effect, Subscribe) for effect in world.uav.on_connected("fog", 200))


# Signed.


def test_the_second_links_presence_is_signed_as_the_first_ones(world: World) -> None:
    """R19.3: and a command for both links as one for one (R19.5)."""
    (birth,) = {publish.payload for _, publish in world.sent if publish.topic == "drone1/reachable"}
    world.logs.clear()
    world.run(
        "activator", world.activator.on_message("fog", Inbound("drone1/second/reachable", birth, 1), world.now_ms)
    )
    assert world.logs == []
    assert world.activator.drones.links[1].ways == {"", "second"}
    world.subscribed.append(("uav", "fog", "nowhere", False))
    world.send(Hold())
    (both,) = [publish for _, publish in world.sent if publish.topic == BOTH]
    world.run("uav", world.uav.on_message("fog", Inbound(ALONE, both.payload, 1), world.now_ms))
    assert len(world.wrote) == 1
    assert all(signer == "drone1" for _, _, signer in outcomes(world))


def test_a_presence_of_the_second_link_by_anybody_else_is_dropped(world: World) -> None:
    """R19.3, R12.9."""
    forged = seal("drone2").sign("drone1/reachable", b"\x83\x01\x18\x33\xf4").encode()
    out = list(world.activator.on_message("fog", Inbound("drone1/second/reachable", forged, 1), world.now_ms))
    assert len(kinds(out)) == 1
    assert world.activator.drones.links[1].ways == {""}


# Everything at once, judged by true time.


@pytest.mark.parametrize("seed", first_quick(range(10)))
def test_cuts_of_either_link_cost_no_command_no_state_and_less_than_a_second(seed: int) -> None:
    """A hundred cuts or more of each seed: broken, or stuck in one direction or both, up to 2.5 s."""
    simulation = TwoLinkSimulation(seed, CALM_COMMANDS, qos=1, latencies=(LTE, LEO))
    simulation.cut_either(seconds=240)
    judge, watch = simulation.judge, simulation.watch
    assert simulation.cuts >= 100
    assert judge.violations == {}
    assert (judge.unsent, watch.losses) == (0, [])
    assert not {Word.EXPIRED, Word.UNREACHABLE} & {word for sent in judge.sent.values() for word in sent.words.values()}
    assert max(simulation.delays_ms()) < 1000
    assert watch.worst_ms < 1000


def test_cuts_beside_a_geostationary_satellite() -> None:
    simulation = TwoLinkSimulation(3, CALM_COMMANDS, latencies=(LTE, GEO))
    simulation.cut_either(seconds=120)
    assert simulation.judge.violations == {}
    assert (simulation.judge.unsent, simulation.watch.losses) == (0, [])
    assert max(simulation.delays_ms()) < 1000


@pytest.mark.parametrize("seed", first_quick(range(6)))
def test_with_two_links_nothing_is_late_or_twice_whatever_else_befalls(seed: int) -> None:
    """Processes, brokers and connections stall, break and die as in `test_deadlines`."""
    judge = TwoLinkSimulation(seed, replace(Dangers(), cuts_per_s=0.1), qos=seed % 2).live(30)
    assert judge.violations == {}
    assert judge.counts()["executed"] > 10
