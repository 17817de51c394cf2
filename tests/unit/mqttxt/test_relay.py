"""The activator's way with commands: forwarded in time, answered, closed once (sections 4 and 5)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.activator.legs import busy_drones
from mqttxt.activator.unanswered import MOST_UNANSWERED
from mqttxt.core.effects import Log, Publish
from mqttxt.core.ledger import FOG_CAPACITY, KEEP_MS
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import Arm, Command, Goto, Hold, Land, Takeoff
from mqttxt.protocol.control import Control, DroneLease
from mqttxt.protocol.messages import (
    BeaconMessage,
    CommandId,
    CommandMessage,
    FogResultMessage,
    Presence,
    ResultMessage,
    Word,
)
from mqttxt.protocol.names import MAX_DRONE
from mqttxt.protocol.rankings import SelectMode
from tests.simulation.fogs import BORN_MS, UAV_AHEAD_MS, ActivatorBench, of, ready, words
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION

EVE = 0xE7E


@pytest.fixture
def bench() -> ActivatorBench:
    return ready()


def test_a_command_goes_on_with_the_drones_session_and_a_deadline_of_its_clock(bench: ActivatorBench) -> None:
    (publish,) = bench.command(deadline_ms=BORN_MS + 5000)
    assert (publish.topic, publish.qos, publish.retain, publish.expiry_s) == ("drone1/commands", 1, False, 5)
    forwarded = decode(CommandMessage, publish.payload)
    assert forwarded.executor_session == UAV_SESSION
    assert forwarded.id == CommandId(GS_SESSION, 1)
    assert forwarded.deadline_ms is not None
    assert 0 <= BORN_MS + 5000 + UAV_AHEAD_MS - forwarded.deadline_ms <= 15


@pytest.mark.parametrize(
    ("changed", "word", "reason"),
    [
        ({"deadline_ms": BORN_MS}, Word.EXPIRED, None),
        ({"deadline_ms": None}, Word.DENIED, "no_deadline"),
        ({"executor_session": 0}, Word.DENIED, "no_deadline"),
        ({"deadline_ms": BORN_MS + 60_001}, Word.DENIED, "deadline_too_far"),
        ({"retain": True}, Word.DENIED, "retained"),
        ({"to": "drone2/commands"}, Word.UNREACHABLE, None),
    ],
)
def test_what_the_activator_closes_by_itself(changed: dict[str, Any], word: Word, reason: str | None) -> None:
    effects = ready().command(**changed)
    assert words(effects, 2 if "to" in changed else 1) == [(word, reason)]
    assert of(effects, "drone1/commands") == []


def just_started(bench: ActivatorBench) -> list[Any]:
    """The drone has a new session, whose clock reads 0."""
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    (asked,) = of(bench.fog("drone1/reachable", Presence(session=77, up=True)), "drone1/init_connect")
    nonce = decode(DroneLease, asked.payload).nonce
    return bench.fog("drone1/clock", BeaconMessage(session=77, now_ms=0, nonce=nonce, held_ms=0))


def test_what_cannot_be_due_in_a_drones_clock_is_not_sent(bench: ActivatorBench) -> None:
    """A deadline of 0 would make a question of the command (R4.5)."""
    just_started(bench)
    assert words(bench.command(deadline_ms=bench.now_ms + 1)) == [(Word.UNREACHABLE, "no_beacon")]
    (sent,) = of(bench.command(seq=2, deadline_ms=bench.now_ms + 2000), "drone1/commands")
    assert (decode(CommandMessage, sent.payload).deadline_ms or 0) > 0


def test_a_lease_that_has_no_end_in_a_drones_clock_hands_down_no_control() -> None:
    bench = ready(controlled=False)
    bench.register(lease_s=1)
    bench.now_ms += 1000
    given = decode(DroneLease, of(just_started(bench), "drone1/init_connect")[-1].payload)
    assert (given.holder_session, given.deadline_ms) == (None, None)


def test_no_subscriber_counts_as_not_published(bench: ActivatorBench) -> None:
    (publish,) = bench.command()
    assert words(list(bench.role.on_published("fog", publish.ref, 0x10, bench.now_ms))) == [
        (Word.UNREACHABLE, "no_subscriber")
    ]


def test_no_subscriber_of_a_later_copy_is_no_definite_no(bench: ActivatorBench) -> None:
    """The drone may have had the first one (R5.9)."""
    bench.command(deadline_ms=bench.now_ms + 30_000)
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    (again,) = of(bench.appear(), "drone1/commands")
    assert words(list(bench.role.on_published("fog", again.ref, 0x10, bench.now_ms))) == []


def test_no_subscriber_of_a_question_is_no_definite_no(bench: ActivatorBench) -> None:
    (asked,) = bench.command(executor_session=99)
    assert words(list(bench.role.on_published("fog", asked.ref, 0x10, bench.now_ms))) == []


def test_afterwards_only_the_drone_has_the_last_word(bench: ActivatorBench) -> None:
    (publish,) = bench.command()
    assert bench.role.on_published("fog", publish.ref, 0, bench.now_ms) == []
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    assert words(bench.until(BORN_MS + 20_000)) == []


def test_a_duplicate_is_answered_and_not_forwarded(bench: ActivatorBench) -> None:
    bench.command()
    bench.result(Word.ACCEPTED)
    again = bench.command(deadline_ms=BORN_MS + 5000)
    assert words(again) == [(Word.ACCEPTED, None)]
    assert of(again, "drone1/commands") == []


@pytest.mark.parametrize(("command", "to", "drone"), [(Hold(), "drone1/commands", 1), (Arm(), "drone2/commands", 2)])
def test_one_id_with_other_contents_or_another_drone_is_denied(command: Command, to: str, drone: int) -> None:
    bench = ready()
    bench.command()
    assert words(bench.command(command, to=to), drone) == [(Word.DENIED, "id_conflict")]


def test_a_command_for_an_earlier_session_is_only_a_question(bench: ActivatorBench) -> None:
    (publish,) = bench.command(executor_session=99)
    assert decode(CommandMessage, publish.payload).deadline_ms == 0
    assert words(bench.result(Word.EXPIRED)) == [(Word.EXPIRED, None)]


def test_a_drone_with_a_new_session_is_only_asked(bench: ActivatorBench) -> None:
    bench.command()
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    effects = bench.appear(session=77)
    (publish,) = of(effects, "drone1/commands")
    asked = decode(CommandMessage, publish.payload)
    assert (asked.executor_session, asked.deadline_ms) == (77, 0)


def test_what_is_sent_again_for_a_station_that_has_lost_control_is_only_a_question(bench: ActivatorBench) -> None:
    """The drone may not have it yet, and would obey a station that another one has followed."""
    bench.register(name="beta", session=5)
    bench.command(deadline_ms=bench.now_ms + 30_000)
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION, up=False))
    bench.register(lease_s=0)
    (publish,) = of(bench.appear(), "drone1/commands")
    asked = decode(CommandMessage, publish.payload)
    assert (asked.executor_session, asked.deadline_ms) == (UAV_SESSION, 0)


@pytest.mark.parametrize(("command", "is_question"), [(Goto(1, 2, 20), True), (Takeoff(10), True), (Land(), False)])
@pytest.mark.parametrize("to", ["drone1/commands", "commands"])
def test_what_is_sent_again_behind_a_later_hold_is_only_a_question(
    command: Command, is_question: bool, to: str
) -> None:
    """Both may have been lost: what the hold was to stop would fly until it comes. What stops the drone is repeated."""
    bench = ready(qos=0)
    bench.command(command, deadline_ms=bench.now_ms + 30_000)
    bench.command(Hold(), seq=2, to=to)
    again = [decode(CommandMessage, sent.payload) for sent in of(bench.until(BORN_MS + 2000), "drone1/commands")]
    assert [sent.deadline_ms == 0 for sent in again if sent.seq == 1] == [is_question]
    assert [sent.deadline_ms == 0 for sent in again if sent.seq == 2] == [False]


@pytest.mark.parametrize("to", ["drone1/commands", "commands"])
def test_what_comes_first_behind_a_later_hold_is_overtaken(bench: ActivatorBench, to: str) -> None:
    """R5.4. The hold may have been lost on the way to the drone, and the command is a repetition."""
    bench.command(Hold(), seq=2, to=to)
    effects = bench.command(Takeoff(10), to="commands")
    assert of(effects, "drone1/commands") == []
    assert words(effects) == [(Word.OVERTAKEN, None)]
    assert of(bench.command(Land(), seq=0), "drone1/commands")


def test_an_earlier_hold_and_one_to_another_drone_question_nothing() -> None:
    bench = ready(qos=0, drones=(1, 2))
    bench.command(seq=2, deadline_ms=bench.now_ms + 30_000)
    bench.command(Hold(), seq=1)
    bench.command(Hold(), seq=3, to="drone2/commands")
    again = [decode(CommandMessage, sent.payload) for sent in of(bench.until(BORN_MS + 2000), "drone1/commands")]
    assert [sent.deadline_ms == 0 for sent in again if sent.seq == 2] == [False]


@pytest.mark.parametrize("word", [word for word in Word if word.is_definite_no])
def test_a_definite_no_behind_a_first_word_settles_nothing(bench: ActivatorBench, word: Word) -> None:
    """R5.9. As of a drone that was started anew and remembers nothing; the truth may still come."""
    bench.command(limit_s=2.0)
    bench.result(Word.ACCEPTED)
    bench.until(BORN_MS + 12_100)
    assert bench.result(word) == []
    assert words(bench.result(Word.COMPLETED)) == [(Word.COMPLETED, None)]


def test_past_deadline_limit_and_grace_it_is_unconfirmed_and_the_truth_settles_it_once(bench: ActivatorBench) -> None:
    bench.command(limit_s=2.0)
    bench.result(Word.ACCEPTED)
    assert words(bench.until(BORN_MS + 12_000)) == []
    assert words(bench.until(BORN_MS + 12_100)) == [(Word.UNCONFIRMED, None)]
    assert bench.result(Word.UNCONFIRMED) == []
    (settled,) = of(bench.result(Word.COMPLETED), "fog1/drone1/commands_result/arm")
    assert decode(ResultMessage, settled.payload).settled
    assert bench.result(Word.COMPLETED) == []
    assert words(bench.command()) == [(Word.UNCONFIRMED, None), (Word.COMPLETED, None)]


def test_a_command_that_may_have_been_forgotten_is_not_denied(bench: ActivatorBench) -> None:
    """A station that was cut off for long asks: the drone may have flown, and the ledger has dropped the id."""
    due_ms = BORN_MS + 5000
    bench.command(deadline_ms=due_ms)
    bench.result(Word.COMPLETED)
    bench.now_ms += KEEP_MS + 5001
    bench.command(seq=2)
    bench.role.relay.is_audited = lambda: False
    assert words(bench.command(deadline_ms=due_ms)) == [(Word.UNCONFIRMED, None)]


def test_a_command_that_never_came_is_expired_however_late_it_is_asked_for(bench: ActivatorBench) -> None:
    """No id of its session that is as high was forgotten, so none of this number was ever known."""
    due_ms = BORN_MS + 5000
    bench.command(deadline_ms=due_ms)
    bench.result(Word.COMPLETED)
    bench.now_ms += KEEP_MS + 5001
    assert words(bench.command(seq=2, deadline_ms=due_ms)) == [(Word.EXPIRED, None)]


def test_a_denied_command_is_not_forwarded_when_it_comes_again_after_the_ledger_has_dropped_it() -> None:
    bench = ready()
    due_ms = BORN_MS + 3_600_000
    assert words(bench.command(deadline_ms=due_ms)) == [(Word.DENIED, "deadline_too_far")]
    bench.now_ms = due_ms - 1000
    bench.command(gs_session=EVE)
    again = bench.command(deadline_ms=due_ms)
    assert (words(again), of(again, "drone1/commands")) == ([(Word.UNCONFIRMED, None)], [])


def test_a_full_ledger_does_not_deny_what_may_still_be_in_time_when_it_has_room(bench: ActivatorBench) -> None:
    bench.register()
    bench.role.relay.ledger._capacity = 0
    assert words(bench.command(deadline_ms=BORN_MS + 5000)) == [(Word.DENIED, "ledger_full")]
    assert words(bench.command(seq=2, deadline_ms=BORN_MS + 3_600_000)) == []


def test_a_word_is_relayed_once_and_never_after_the_last_one(bench: ActivatorBench) -> None:
    bench.command()
    assert len(bench.result(Word.ACCEPTED)) == 1
    assert bench.result(Word.ACCEPTED) == []
    assert len(bench.result(Word.COMPLETED)) == 1
    assert bench.result(Word.FAILED) == []


def test_a_word_of_another_session_or_another_drone_is_no_word(bench: ActivatorBench) -> None:
    bench.command()
    (log,) = bench.result(Word.COMPLETED, session=77)
    assert log.kind == "unknown_session"


def test_a_broadcast_goes_to_its_drones_then_its_roster_to_the_station_and_then_a_word_for_each_entry() -> None:
    bench = ready(drones=(1, 2))
    effects = bench.command(to="commands")
    said = [effect for effect in effects if isinstance(effect, Publish)]
    topics = ["drone1/commands", "fog1/commands_result/arm", "fog1/drone2/commands_result/arm"]
    assert [publish.topic for publish in said] == topics
    roster = decode(FogResultMessage, said[1].payload).roster or ()
    assert [(entry.drone, entry.session) for entry in roster] == [(1, UAV_SESSION), (2, None)]
    assert words(effects, 2) == [(Word.UNREACHABLE, None)]
    assert of(bench.appear(2, 55), "drone2/commands") == []


def test_an_empty_fog_has_an_empty_roster() -> None:
    (publish,) = ActivatorBench(drones=()).command(to="commands")
    assert decode(FogResultMessage, publish.payload).roster == ()


@pytest.mark.parametrize(
    ("command", "changed", "reason"),
    [(Goto(47.0, 8.0, 10.0), {}, "not_broadcastable"), (Arm(), {"deadline_ms": None}, "no_deadline")],
)
def test_a_broadcast_that_cannot_be_is_denied_by_the_fog(command: Command, changed: Any, reason: str) -> None:
    (publish,) = ready().command(command, to="commands", **changed)
    assert decode(FogResultMessage, publish.payload).denied == reason


def test_at_qos_0_an_unanswered_command_is_sent_again_as_the_same_bytes() -> None:
    bench = ready(qos=0)
    (first,) = bench.command()
    (again,) = of(bench.until(BORN_MS + 2000), "drone1/commands")
    assert again.payload == first.payload


def test_an_unregistered_client_cannot_keep_a_drone_from_landing(bench: ActivatorBench) -> None:
    """Neither by commands that it may not give, nor by questions about an earlier session."""
    for seq in range(4200):
        asked = {"executor_session": 0x99} if seq % 2 else {}
        bench.command(Arm(), gs_session=0x77, seq=seq, **asked)
    assert of(bench.command(Land(), seq=5), "drone1/commands")


def test_clients_that_are_not_in_control_leave_room_however_many_they_are(bench: ActivatorBench) -> None:
    bench.role.relay.ledger._capacity = 800
    out = [bench.command(Land(), gs_session=0x1000 + number) for number in range(900)]
    assert any(isinstance(effect, Log) and "no room for it" in effect.detail for effects in out for effect in effects)
    assert of(bench.command(Land(), seq=5), "drone1/commands")


def test_the_answer_to_who_is_not_in_control_stays_the_same_once_it_is(bench: ActivatorBench) -> None:
    assert words(bench.command(Arm(), gs_session=0x77)) == [(Word.DENIED, "not_in_control, alpha")]
    bench.register(name="other", session=0x77, control=Control.TAKE)
    assert words(bench.command(Arm(), gs_session=0x77)) == [(Word.DENIED, "not_in_control, alpha")]
    assert of(bench.command(Arm(), gs_session=0x77, seq=2, epoch=1), "drone1/commands")


def test_a_station_without_control_that_asks_a_whole_fog_opens_no_more_legs_than_it_may_have_places() -> None:
    """At the true capacity: each query stays open for a day where a drone is away, and costs time in every tick."""
    bench = ActivatorBench(drones=tuple(range(1, MAX_DRONE + 1)))
    bench.register(name="eve", session=EVE, control=Control.NONE, lease_s=3600)
    old = {"executor_session": FOG_SESSION + 1, "limit_s": 86_400.0, "gs_session": EVE}
    for seq in range(1, 101):
        bench.now_ms += 100
        bench.command(Arm(), to="commands", seq=seq, **old)
    legs = sum(len(entry.record.legs) for entry in bench.role.relay.ledger.open_entries())
    assert FOG_CAPACITY // 8 - MAX_DRONE < legs <= FOG_CAPACITY // 8


def test_a_command_takes_as_many_places_as_drones_may_get_it_and_a_choice_what_its_list_needs() -> None:
    bench = ready(drones=tuple(range(1, 101)))
    bench.select(Goto(47.0, 8.0, 10.0), seq=1, executor_session=FOG_SESSION)
    bench.select(Goto(47.0, 8.0, 10.0), seq=2, executor_session=FOG_SESSION, mode=SelectMode.RELEASE, reservation=1)
    bench.command(seq=3)
    bench.command(Hold(), to="commands", seq=4)
    bench.command(Goto(47.0, 8.0, 10.0), to="commands", seq=5)
    places = [entry.places for entry in bench.role.relay.ledger.entries()]
    assert places == [10, 1, 1, 100, 1], "a goto is no broadcast, and is refused at once"


@pytest.mark.long
def test_a_station_whose_holds_of_a_whole_fog_are_denied_may_still_hold_one_drone() -> None:
    """The ledger has room for one place when it has none for 250."""
    bench = ready(drones=tuple(range(1, MAX_DRONE + 1)))
    bench.register(lease_s=3600)
    for seq in range(1, 1000, 2):
        bench.now_ms += 100
        denied = bench.command(Hold(), to="commands", seq=seq, deadline_ms=bench.now_ms + 60_000)
        if any(isinstance(effect, Publish) and b"ledger_full" in effect.payload for effect in denied):
            break
    else:
        pytest.fail("never full")
    alone = bench.command(Hold(), seq=seq + 1, deadline_ms=bench.now_ms + 60_000)
    assert len(of(alone, "drone1/commands")) == 1


@pytest.mark.parametrize("away", [1, 2])
def test_a_broadcast_stays_open_for_the_drones_that_have_it_whichever_is_away(away: int) -> None:
    there = 3 - away
    bench = ActivatorBench(drones=(1, 2))
    bench.appear(there)
    bench.register()
    bench.command(Takeoff(10.0), to="commands", limit_s=60.0)
    assert busy_drones(bench.role.relay.ledger.open_entries()) == {there}
    effects = bench.until(bench.now_ms + 100_000)
    assert of(effects, f"drone{there}/commands"), "it is said again"
    assert words(effects, there)[-1] == (Word.UNCONFIRMED, None)


@pytest.mark.parametrize("is_back", [False, True])
def test_a_drone_is_asked_in_turn_and_nobodys_questions_are_in_front_of_a_hold(is_back: bool) -> None:
    """A broker keeps 1,000 messages for a client: behind more of them a hold would be dropped."""
    bench = ActivatorBench()
    bench.register(lease_s=3600)
    out = bench.appear() if not is_back else []
    for seq in range(1, 51):
        out += bench.command(gs_session=EVE, seq=seq, executor_session=FOG_SESSION + 1, limit_s=600.0)
    out += bench.command(seq=1, executor_session=FOG_SESSION + 1, limit_s=600.0)
    out += bench.appear() if is_back else []
    sent = [decode(CommandMessage, publish.payload) for publish in of(out, "drone1/commands")]
    assert [asked.gs_session for asked in sent] == [EVE] * MOST_UNANSWERED + [GS_SESSION]
    assert len(of(bench.command(Hold(), seq=2), "drone1/commands")) == 1
    open_at_drone, answered = sent[:-1], set[int]()
    while open_at_drone:
        answered |= {asked.seq for asked in open_at_drone}
        for asked in open_at_drone:
            bench.result(Word.EXPIRED, gs_session=EVE, seq=asked.seq)
        again = [
            decode(CommandMessage, publish.payload)
            for publish in of(bench.until(bench.now_ms + 300), "drone1/commands")
        ]
        open_at_drone = [asked for asked in again if asked.gs_session == EVE]
        assert len(open_at_drone) <= MOST_UNANSWERED
    assert answered == set(range(1, 51))


def test_a_question_that_waited_is_asked_once_where_the_drone_has_the_command(bench: ActivatorBench) -> None:
    """The newest word of a command that has begun repeats an earlier one, which changes nothing."""
    for seq in range(1, 2 * MOST_UNANSWERED + 1):
        bench.command(Arm(), seq=seq, limit_s=600.0)
        bench.result(Word.ACCEPTED, seq=seq)
    bench.until(bench.now_ms + 6000)
    bench.role.on_disconnected("fog", bench.now_ms)
    for subscribe in bench.role.on_connected("fog", bench.now_ms):
        bench.role.on_subscribed(subscribe, bench.now_ms)  # type: ignore[arg-type]
    asked = len(of(bench.appear(), "drone1/commands"))
    for seq in range(1, MOST_UNANSWERED + 1):
        bench.result(Word.ACCEPTED, seq=seq)
    asked += len(of(bench.until(bench.now_ms + 20_000), "drone1/commands"))
    assert asked == 2 * MOST_UNANSWERED
