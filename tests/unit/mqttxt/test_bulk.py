"""Objects in pieces: what is lost is sent again and nothing else, at most 1 KiB is under way, and nobody else pays."""

from __future__ import annotations

import os
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from mqttxt.activator.unanswered import MOST_UNANSWERED
from mqttxt.core.effects import Inbound, Publish
from mqttxt.drone.bulk import KEPT_MS, MOST_STAGED, BulkStore
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.bulk import (
    MOST_RANGES,
    PIECE_BYTES,
    WINDOW_BYTES,
    BulkAnswer,
    BulkAsk,
    Get,
    Have,
    Partial,
    Piece,
    Put,
    Range,
    Refused,
)
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import ClearPlan, UploadPlan
from mqttxt.protocol.messages import Word
from mqttxt.protocol.plans import PLAN, hash_of
from mqttxt.security.rights import UPLOAD_PLAN, Rights
from mqttxt.station.signing import CommandSigner
from mqttxt.station.transfers import Fetching, Staging
from tests.simulation.flight import Flight
from tests.simulation.signing import seal
from tests.simulation.world import World

SOME = os.urandom(5000)


def asked(ask: Put) -> BulkAsk:
    return BulkAsk(gs_session=1, kind=PLAN, nonce=3, ask=ask)


def put(data: bytes, offset: int, hash: bytes | None = None) -> BulkAsk:
    return asked(Put(hash or hash_of(data), len(data), offset, data[offset : offset + PIECE_BYTES]))


def pieces(data: bytes) -> list[BulkAsk]:
    return [put(data, offset) for offset in range(0, len(data), PIECE_BYTES)]


def answer(store: BulkStore, ask: BulkAsk, now_ms: int = 0) -> Any:
    (said,) = store.on_ask(ask, now_ms)
    return said.answer


# -- what the drone keeps ---------------------------------------------------------------------------------------------


def test_pieces_in_any_order_and_twice_make_the_object() -> None:
    store, some = BulkStore(), pieces(SOME) * 2
    random.Random(1).shuffle(some)
    for ask in some:
        answer(store, ask)
    assert store.staged(hash_of(SOME)) == SOME


def test_an_answer_says_which_ranges_are_there() -> None:
    store, some = BulkStore(), pieces(SOME)
    assert answer(store, some[0]).ranges == (Range(0, 512),)
    assert answer(store, some[2]).ranges == (Range(0, 512), Range(1024, 1536))
    assert answer(store, some[1]).ranges == (Range(0, 1536),)
    assert store.staged(hash_of(SOME)) is None


@pytest.mark.parametrize(
    ("asks", "reason"),
    [
        ([replace(put(SOME, 0), kind="nonsense")], "unknown_kind"),
        ([asked(Put(bytes(16), 70_000, 0, b"x"))], "too_long, 65536"),
        ([asked(Put(bytes(16), 10, 8, b"xyz"))], "inconsistent"),
        ([put(SOME, 0), asked(Put(hash_of(SOME), 4999, 512, b"x"))], "inconsistent"),
        ([put(b"short", 0, bytes(16))], "wrong_hash"),
    ],
)
def test_what_cannot_be_is_refused_and_dropped(asks: list[BulkAsk], reason: str) -> None:
    store = BulkStore()
    said = [answer(store, ask) for ask in asks]
    assert isinstance(said[-1], Refused)
    assert said[-1].reason == reason
    assert all(store.staged(ask.ask.hash) is None for ask in asks if isinstance(ask.ask, Put))


def test_scattered_bytes_do_not_grow_the_answer() -> None:
    store, data = BulkStore(), bytes(2 * PIECE_BYTES * (MOST_RANGES + 2))
    said = [answer(store, put(data, offset)) for offset in range(0, len(data), 2 * PIECE_BYTES)]
    assert max(len(one.ranges) for one in said if isinstance(one, Have)) == MOST_RANGES
    assert isinstance(said[MOST_RANGES], Refused)


def test_what_was_touched_longest_ago_makes_room_and_ages() -> None:
    store = BulkStore()
    objects = [bytes([number]) * 300 for number in range(MOST_STAGED + 1)]
    for at_ms, data in enumerate(objects):
        answer(store, put(data, 0), at_ms)
    assert [store.staged(hash_of(data)) is None for data in objects] == [True, *[False] * MOST_STAGED]
    store.tick(KEPT_MS + MOST_STAGED)
    assert [store.staged(hash_of(data)) is None for data in objects] == [*[True] * MOST_STAGED, False]


def test_the_newest_object_is_given_once_it_is_made() -> None:
    made: list[bytes | str | None] = [None, None, SOME, "no_autopilot"]
    store = BulkStore({PLAN: lambda now_ms, known: made.pop(0)})
    ask = BulkAsk(gs_session=7, kind=PLAN, nonce=8, ask=Get(0, 0))
    assert store.on_ask(ask, 0) == []
    assert store.tick(0) == []
    ((said),) = store.tick(0)
    assert (said.gs_session, said.nonce, said.answer) == (7, 8, Have(hash_of(SOME), 5000, (Range(0, 5000),)))
    given = store.on_ask(replace(ask, ask=Get(4500, 1024, hash_of(SOME))), 0)
    assert [one.answer for one in given] == [Piece(hash_of(SOME), 5000, 4500, SOME[4500:])]
    assert answer(store, replace(ask, ask=Get(0, 10, bytes(16)))) == Refused("unknown_hash", bytes(16))
    assert answer(store, ask) == Refused("no_autopilot")
    assert answer(store, replace(ask, kind="nonsense")) == Refused("unknown_kind")


def test_missing_ranges() -> None:
    part = Partial(2000)
    assert part.missing() == [Range(0, 2000)]
    assert part.put(512, bytes(512))
    assert part.missing() == [Range(0, 512), Range(1024, 2000)]
    assert not part.put(1999, b"ab")


# -- from the station to the drone ------------------------------------------------------------------------------------


class Far(World):
    """What is said of objects takes a step of time for each hop; `loses` says of each message whether it is lost."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.loses: Callable[[str, Publish], bool] = lambda name, publish: False
        self._under_way: list[tuple[str, Publish]] = []

    def route(self, name: str, publish: Publish) -> None:
        if publish.topic.endswith(("/bulk", "/bulk_answer")):
            self._under_way.append((name, publish))
        else:
            super().route(name, publish)

    def pass_time(self, milliseconds: int, step_ms: int = 100) -> None:
        for _ in range(milliseconds // step_ms):
            super().pass_time(step_ms, step_ms)
            arrived, self._under_way = self._under_way, []
            for name, publish in arrived:
                if not self.loses(name, publish):
                    super().route(name, publish)


def stage(world: World, data: bytes) -> Staging:
    staging = Staging(world.gs.fog(1), 1, PLAN, data)
    world.run("gs", world.gs.transfers.begin(staging, world.now_ms))
    return staging


def asks_sent(world: World, sender: str = "gs") -> list[BulkAsk]:
    return [decode(BulkAsk, p.payload) for who, p in world.sent if who == sender and p.topic.endswith("/bulk")]


def test_a_station_has_no_more_than_its_window_under_way() -> None:
    world = World().start()
    world.drop.add("bulk")
    stage(world, SOME)
    assert sum(len(ask.ask.data) for ask in asks_sent(world) if isinstance(ask.ask, Put)) == WINDOW_BYTES
    world.pass_time(1900)
    assert len(asks_sent(world)) == 2


@pytest.mark.parametrize("lost", ["bulk", "bulk_answer"])
def test_what_was_lost_is_sent_again_and_what_arrived_is_not(lost: str) -> None:
    world, rng, delivered = Far().start(), random.Random(3), Counter[int]()

    def loses(name: str, publish: Publish) -> bool:
        if publish.topic.endswith(f"/{lost}") and rng.random() < 0.3:
            return True
        if publish.topic == "drone1/bulk":
            ask = decode(BulkAsk, publish.payload).ask
            assert isinstance(ask, Put)
            delivered[ask.offset] += 1
        return False

    world.loses = loses
    staging = stage(world, SOME)
    world.pass_time(60_000)
    assert (staging.is_over, staging.error) == (True, None)
    assert sum(delivered.values()) <= {"bulk": 10, "bulk_answer": 20}[lost]


def test_a_staging_has_news_whenever_the_drone_has_more_of_it() -> None:
    world = Far().start()
    staging = stage(world, SOME)
    done = []
    while not staging.is_over:
        if staging.has_news:
            staging.told = staging.done
            done.append(staging.told)
        assert not staging.has_news
        world.pass_time(100)
    assert staging.has_news
    assert done == sorted(set(done))
    assert done[0] == 0
    assert len(done) > len(SOME) // PIECE_BYTES // 2
    assert staging.done == len(SOME)


def test_a_transfer_goes_on_where_a_lost_connection_broke_it_off() -> None:
    world = Far().start()
    broken = stage(world, SOME)
    world.pass_time(1000)
    assert not broken.is_over
    broken.end()
    there = len(asks_sent(world))
    world.sent.clear()
    again = stage(world, SOME)
    world.pass_time(5000)
    assert (again.is_over, again.error) == (True, None)
    assert len(asks_sent(world)) <= 10 - there + 2 * WINDOW_BYTES // PIECE_BYTES


def test_nothing_is_sent_to_a_drone_that_is_not_there() -> None:
    world = World().start()
    world.run("uav", world.uav.goodbye(world.now_ms))
    staging = stage(world, SOME)
    world.pass_time(60_000)
    assert asks_sent(world) == []
    assert not staging.is_over


def test_who_does_not_control_the_drone_is_not_heard() -> None:
    world = World().start()
    foreign = replace(put(SOME, 0), gs_session=0x99)
    world.run("activator", world.activator.on_message("cloud", Inbound("fog1/drone1/bulk", encode(foreign)), 0))
    world.run("uav", world.uav.on_message("fog", Inbound("drone1/bulk", encode(foreign)), 0))
    assert [log.kind for log in world.logs] == ["outsiders", "outsiders"]
    assert not any(p.topic.endswith(("drone1/bulk", "bulk_answer")) for _, p in world.sent)


@pytest.mark.parametrize("payload", [b"", b"\xff", b"{}", os.urandom(200), encode(put(SOME, 0))[:-1]])
def test_garbage_is_counted_and_costs_nothing(payload: bytes) -> None:
    world = World().start()
    staging = stage(world, SOME[:3000])
    for link, topic, role in (("cloud", "fog1/drone1/bulk", "activator"), ("fog", "drone1/bulk", "uav")):
        world.run(role, getattr(world, role).on_message(link, Inbound(topic, payload), world.now_ms))
    world.run("activator", world.activator.on_message("fog", Inbound("drone1/bulk_answer", payload), world.now_ms))
    world.run("gs", world.gs.on_message("cloud", Inbound("fog1/drone1/bulk_answer", payload), world.now_ms))
    assert len(world.logs) == 4
    world.pass_time(1000)
    assert (staging.is_over, staging.error) == (True, None)


def test_a_flood_ends_at_the_activator() -> None:
    world = World().start()
    world.drop.add("bulk_answer")
    for _ in range(100):
        message = Inbound("fog1/drone1/bulk", encode(replace(put(SOME, 0), gs_session=world.gs.session)))
        world.run("activator", world.activator.on_message("cloud", message, world.now_ms))
    assert len(asks_sent(world, "activator")) == MOST_UNANSWERED
    answer = BulkAnswer(gs_session=world.gs.session, kind=PLAN, nonce=1, answer=Have(bytes(16), 1, ()))
    world.run("activator", world.activator.on_message("fog", Inbound("drone1/bulk_answer", encode(answer)), 0))
    for _ in range(100):
        world.run("activator", world.activator.on_message("cloud", message, world.now_ms))
    assert len(asks_sent(world, "activator")) == MOST_UNANSWERED + 1, "one answer makes room for one more"


def test_an_answer_to_another_station_or_to_an_earlier_question_is_not_taken() -> None:
    world = World().start()
    world.drop.add("bulk")
    staging = stage(world, SOME[:100])
    whole = Have(staging.hash, 100, (Range(0, 100),))
    theirs = BulkAnswer(gs_session=0x99, kind=PLAN, nonce=staging.nonce, answer=whole)
    world.run("gs", world.gs.on_message("cloud", Inbound("fog1/drone1/bulk_answer", encode(theirs)), 0))
    assert not staging.is_over
    before = replace(theirs, gs_session=world.gs.session, nonce=staging.nonce ^ 1)
    world.run("gs", world.gs.on_message("cloud", Inbound("fog1/drone1/bulk_answer", encode(before)), 0))
    assert not staging.is_over
    mine = replace(theirs, gs_session=world.gs.session)
    world.run("gs", world.gs.on_message("cloud", Inbound("fog1/drone1/bulk_answer", encode(mine)), 0))
    assert staging.is_over


def test_a_fetched_object_with_another_hash_is_given_up() -> None:
    world = World().start()
    fetching = Fetching(world.gs.fog(1), 1, PLAN)
    for _ in range(3):
        fetching.take(Have(bytes(16), 4, (Range(0, 4),)), 0)
        fetching.take(Piece(bytes(16), 4, 0, b"abcd"), 0)
    assert (fetching.is_over, fetching.error, fetching.data) == (True, "wrong_hash", b"")


# -- signed -----------------------------------------------------------------------------------------------------------


def without_right(name: str) -> Any:
    return seal(name, Rights(None, take_over=True) if name == "gs-g" else None, fleet="plain")


def test_signed_objects_arrive_and_forged_ones_do_not() -> None:
    flight = Flight(signed=True).begin("px4")
    staging = stage(flight, SOME[:1500])
    flight.fly(1)
    assert (staging.is_over, staging.error) == (True, None)
    forged = replace(put(SOME, 0), gs_session=flight.gs.session)
    flight.run("uav", flight.uav.on_message("fog", Inbound("drone1/bulk", encode(forged)), flight.now_ms))
    envelope = seal("gs-two", Rights(frozenset({2}))).sign("drone1/bulk", encode(forged)).encode()
    flight.run("uav", flight.uav.on_message("fog", Inbound("drone1/bulk", envelope), flight.now_ms))
    assert flight.uav._bulk.store.staged(hash_of(SOME)) is None


@pytest.mark.parametrize("command", [UploadPlan(bytes(16)), ClearPlan()])
def test_without_the_right_a_plan_is_neither_staged_nor_changed(command: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a station that does not look at its own certificate."""
    flight = Flight(signed=True, seal=without_right).begin("px4")
    with pytest.raises(ConfigurationError, match=f"certificate has no {UPLOAD_PLAN}"):
        flight.send(command)
    monkeypatch.setattr(CommandSigner, "check_right", lambda *_: None)
    staging = stage(flight, SOME[:100])
    flight.fly(3)
    assert not staging.is_over
    assert flight.outcome(command) == (Word.DENIED, f"not_allowed, {UPLOAD_PLAN}")
