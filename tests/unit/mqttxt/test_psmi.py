"""PSMI: who is chosen for a goto, who is left out and why, and when the next one is tried (section 7)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.core.ledger import KEEP_MS
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import Goto, Hold, Land
from mqttxt.protocol.control import Control, DroneRecord
from mqttxt.protocol.messages import BeaconMessage, CommandMessage, FogResultMessage, Word
from mqttxt.protocol.names import MAX_DRONE
from mqttxt.protocol.rankings import Candidate, PsmiMessage, SelectMode
from mqttxt.protocol.states import Armed, Battery, Endurance, Landed, LandedState, Location, MaxGroundspeed, State
from tests.simulation.fogs import BORN_MS, ActivatorBench, of, words
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION

TARGET = Goto(47.4, 8.5, 20)
ONE_KM = 1000 / 6_371_000 * 57.29577951308232
"""Degrees of latitude on the sphere that distances are measured on."""


def place(km_south: float) -> Location:
    return Location(47.4 - km_south * ONE_KM, 8.5, 500, 20)


def flock(*km_south: float, controlled: bool = True, **changed: Any) -> ActivatorBench:
    """Drones 1, 2, … so far from the target, each with all that a ranking needs."""
    bench = ActivatorBench(drones=tuple(range(1, len(km_south) + 1)))
    for drone, distance in enumerate(km_south, start=1):
        bench.appear(drone, UAV_SESSION + drone)
        states = {
            "place": place(distance),
            "battery": Battery(100),
            "speed": MaxGroundspeed(10),
            "endurance": Endurance(900, 10),
            "armed": Armed(armed=True),
            "landed": LandedState(Landed.IN_AIR),
        }
        states |= changed.get(f"drone{drone}", {})
        bench.tell(*(state for state in states.values() if state is not None), drone=drone)
    if controlled:
        bench.register()
    return bench


@pytest.fixture
def bench() -> ActivatorBench:
    """Of its two drones the second is nearer to the target."""
    return flock(2, 1)


def psmi(effects: list[Any]) -> list[PsmiMessage]:
    return [decode(PsmiMessage, publish.payload) for publish in of(effects, "fog1/PSMI")]


def numbers(candidates: tuple[Candidate, ...]) -> list[int]:
    return [candidate.drone for candidate in candidates]


def reasons(message: PsmiMessage) -> dict[int, str | None]:
    return {candidate.drone: candidate.reason for candidate in message.left_out}


def denial(effects: list[Any]) -> str | None:
    (publish,) = of(effects, "fog1/commands_result/goto")
    return decode(FogResultMessage, publish.payload).denied


def sent_to(effects: list[Any]) -> list[int]:
    return [drone for drone in range(1, 9) for _ in of(effects, f"drone{drone}/commands")]


def test_the_thesiss_example_of_two_drones_the_second_nearer_gives_2_1() -> None:
    effects = flock(2, 1).select(TARGET)
    (message,) = psmi(effects)
    assert numbers(message.listed) == [2, 1]
    assert (message.chosen, message.left_out) == (2, ())
    assert sent_to(effects) == [2]
    (publish,) = of(effects, "drone2/commands")
    assert decode(CommandMessage, publish.payload).command == TARGET


def test_the_list_has_every_figure_that_was_used() -> None:
    (message,) = psmi(flock(1).select(TARGET))
    (first,) = message.listed
    assert first.distance_m == pytest.approx(1000, abs=1)
    assert first.arrival_s == pytest.approx(100, abs=0.1)
    assert (first.max_groundspeed_m_s, first.remaining_pct) == (10, 100)
    assert first.range_m == pytest.approx(0.8 * 900 * 10)
    assert first.age_s is not None
    assert first.age_s < 0.1


def test_a_faster_drone_that_is_farther_away_may_arrive_first() -> None:
    bench = flock(1, 1.5, drone2={"speed": MaxGroundspeed(20)})
    assert numbers(psmi(bench.select(TARGET))[0].listed) == [2, 1]


def test_ties_go_by_number() -> None:
    assert numbers(psmi(flock(1, 1, 1).select(TARGET))[0].listed) == [1, 2, 3]


@pytest.mark.parametrize(("remaining", "listed"), [(32, [1]), (31, [])])
def test_a_drone_that_cannot_arrive_on_its_battery_is_not_listed(remaining: int, listed: list[int]) -> None:
    # (32 % - 20 %) x 900 s x 10 m/s = 1,080 m, just enough for 1,000 m; with 31 % it is 990 m
    (message,) = psmi(flock(1, drone1={"battery": Battery(remaining)}).select(TARGET))
    assert numbers(message.listed) == listed
    if not listed:
        assert reasons(message) == {1: "out_of_range"}


def test_what_is_not_known_leaves_a_drone_out_by_name() -> None:
    bench = flock(1, 1, 1, drone1={"place": None}, drone2={"endurance": None}, drone3={"speed": None})
    effects = bench.select(TARGET)
    assert reasons(psmi(effects)[0]) == {1: "unknown(location)", 2: "unknown(endurance)", 3: "unknown(max_groundspeed)"}
    assert denial(effects) == (
        "none_eligible: drone 1 unknown(location); drone 2 unknown(endurance); drone 3 unknown(max_groundspeed)"
    )
    assert sent_to(effects) == []


@pytest.mark.parametrize(
    ("told", "stale"), [((), "location"), ((place(1), Armed(armed=True)), "landed_state")], ids=["place", "landed"]
)
def test_old_figures_leave_a_drone_out(told: tuple[State, ...], stale: str) -> None:
    bench = flock(1)
    for _ in range(5):
        bench.until(bench.now_ms + 10_000)
        bench.echo(session=UAV_SESSION + 1)
        bench.register()
        bench.tell(*told, Battery(90), MaxGroundspeed(10), Endurance(900, 10))
    assert reasons(psmi(bench.select(TARGET))[0]) == {1: f"stale({stale})"}


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ({"armed": Armed(armed=False)}, "disarmed"),
        ({"landed": LandedState(Landed.ON_GROUND)}, "on_ground"),
        ({"landed": LandedState(Landed.UNDEFINED)}, "unknown(landed_state)"),
        ({"armed": None}, "unknown(armed)"),
        ({"landed": None}, "unknown(landed_state)"),
    ],
)
def test_a_drone_that_cannot_go_as_it_is_is_left_out_however_near_it_is(state: dict[str, Any], reason: str) -> None:
    effects = flock(1, 2, drone1=state).select(TARGET)
    (message,) = psmi(effects)
    assert (numbers(message.listed), reasons(message)) == ([2], {1: reason})
    assert sent_to(effects) == [2]


def test_an_offer_that_names_an_earlier_one_leaves_out_whom_that_was_for() -> None:
    bench = flock(3, 1, 2)
    assert psmi(bench.select(TARGET, seq=1, mode=SelectMode.OFFER))[0].chosen == 2
    bench.select(TARGET, seq=2, mode=SelectMode.COMMIT, reservation=1)
    bench.word(2, Word.DENIED, seq=2)
    (second,) = psmi(bench.select(TARGET, seq=3, mode=SelectMode.OFFER, reservation=1))
    assert (second.chosen, reasons(second)) == (3, {2: "tried"})
    (third,) = psmi(bench.select(TARGET, seq=4, mode=SelectMode.OFFER, reservation=3))
    assert (third.chosen, reasons(third)) == (1, {2: "tried", 3: "tried"})
    assert denial(bench.select(TARGET, seq=5, mode=SelectMode.OFFER, reservation=9)) == "no_reservation"


def test_a_drone_that_is_unreachable_or_another_stations_is_left_out() -> None:
    bench = flock(1, 1, controlled=False)
    bench.register(name="other", session=5, drones=(1,))
    bench.register()
    bench.role.drones.links[2].announced = False
    assert reasons(psmi(bench.select(TARGET))[0]) == {1: "not_in_control, other", 2: "unreachable"}


@pytest.mark.parametrize("word", [Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED])
def test_after_a_definite_no_the_next_one_is_tried(bench: ActivatorBench, word: Word) -> None:
    bench.select(TARGET)
    effects = bench.word(2, word)
    assert words_of(effects, 2) == [word]
    assert psmi(effects)[0].chosen == 1
    assert sent_to(effects) == [1]
    assert denial(bench.word(1, word)) == "none_left"


@pytest.mark.parametrize("mode", [SelectMode.SELECT, SelectMode.OFFER])
def test_a_drone_that_another_choice_has_since_is_not_tried(mode: SelectMode) -> None:
    bench = flock(3, 1, 2)
    bench.select(TARGET)
    assert psmi(bench.select(TARGET, seq=2, mode=mode))[0].chosen == 3
    effects = bench.word(2, Word.DENIED)
    assert sent_to(effects) == [1]
    (message,) = psmi(effects)
    assert (numbers(message.listed), reasons(message)) == ([2, 1], {3: "busy"})


def test_where_other_choices_have_all_the_rest_none_is_left(bench: ActivatorBench) -> None:
    bench.select(TARGET)
    bench.select(TARGET, seq=2, mode=SelectMode.OFFER)
    effects = bench.word(2, Word.DENIED)
    assert sent_to(effects) == []
    assert denial(effects) == "none_left"
    assert sent_to(bench.select(TARGET, seq=3, mode=SelectMode.COMMIT, reservation=2)) == [1]


@pytest.mark.parametrize("word", [Word.FAILED, Word.UNCONFIRMED, Word.SUPERSEDED, Word.OVERTAKEN, Word.COMPLETED])
def test_after_any_other_last_word_nobody_else_is_sent(bench: ActivatorBench, word: Word) -> None:
    bench.select(TARGET)
    assert sent_to(bench.word(2, word)) == []
    assert sent_to(bench.until(bench.now_ms + 20_000)) == []


def test_silence_sends_nobody_else(bench: ActivatorBench) -> None:
    bench.select(TARGET, limit_s=1.0)
    effects = bench.until(bench.now_ms + 12_000)
    assert set(sent_to(effects)) <= {2}
    assert words_of(effects, 2) == [Word.UNCONFIRMED]


def test_no_subscriber_is_a_definite_no(bench: ActivatorBench) -> None:
    (publish,) = of(bench.select(TARGET), "drone2/commands")
    effects = list(bench.role.on_published("fog", publish.ref, 0x10, bench.now_ms))
    assert words_of(effects, 2) == [Word.UNREACHABLE]
    assert sent_to(effects) == [1]


def test_past_the_deadline_nobody_else_is_tried(bench: ActivatorBench) -> None:
    bench.select(TARGET)
    bench.until(bench.now_ms + 5000)
    effects = bench.word(2, Word.EXPIRED)
    assert sent_to(effects) == []
    assert denial(effects) == "expired"


@pytest.mark.parametrize(("is_retained", "said"), [(False, []), (True, [(Word.DENIED, "retained")])])
def test_a_later_hold_cancels_what_would_be_tried_next_also_where_it_is_denied(
    bench: ActivatorBench, is_retained: bool, said: list[Any]
) -> None:
    bench.select(TARGET)
    assert words(bench.command(Hold(), to="drone2/commands", seq=2, retain=is_retained), 2) == said
    effects = bench.word(2, Word.DENIED)
    assert sent_to(effects) == []
    assert denial(effects) == "cancelled"


def test_an_earlier_hold_that_comes_late_cancels_nothing(bench: ActivatorBench) -> None:
    bench.select(TARGET, seq=2)
    bench.command(Hold(), to="drone1/commands", seq=1)
    assert sent_to(bench.word(2, Word.DENIED, seq=2)) == [1]


@pytest.mark.parametrize("mode", [SelectMode.SELECT, SelectMode.OFFER])
@pytest.mark.parametrize("to", ["drone1/commands", "commands"])
@pytest.mark.parametrize("is_retained", [False, True])
def test_a_choice_that_comes_behind_a_later_hold_is_cancelled(
    bench: ActivatorBench, mode: SelectMode, to: str, is_retained: bool
) -> None:
    """At QoS 0 a station repeats a select that was lost; the hold was for another drone, and may have been denied."""
    bench.command(Hold(), to=to, seq=2, retain=is_retained)
    effects = bench.select(TARGET, seq=1, mode=mode)
    assert sent_to(effects) == []
    assert denial(effects) == "cancelled"
    assert sent_to(bench.select(TARGET, seq=3)) == [2]


def test_a_commit_that_comes_behind_a_later_hold_is_cancelled_and_frees_its_drone(bench: ActivatorBench) -> None:
    bench.select(TARGET, seq=1, mode=SelectMode.OFFER)
    bench.command(Land(), to="drone1/commands", seq=3)
    effects = bench.select(TARGET, seq=2, mode=SelectMode.COMMIT, reservation=1)
    assert sent_to(effects) == []
    assert denial(effects) == "cancelled"
    assert sent_to(bench.select(TARGET, seq=4)) == [2]


def test_another_stations_hold_cancels_nothing(bench: ActivatorBench) -> None:
    bench.command(Hold(), to="drone1/commands", gs_session=GS_SESSION + 1, seq=2)
    assert sent_to(bench.select(TARGET, seq=1)) == [2]


def test_a_takeover_of_the_largest_fog_ends_the_search_with_a_word_for_each_drone() -> None:
    """All are refused in one turn: as many calls in each other would be too deep for Python."""
    bench = flock(*[1.0] * MAX_DRONE)
    bench.select(TARGET)
    bench.register(name="other", session=5, control=Control.TAKE)
    effects = bench.word(1, Word.DENIED)
    assert denial(effects) == "none_left"
    assert sent_to(effects) == []
    for drone in range(2, MAX_DRONE + 1):
        assert words(effects, drone) == [(Word.DENIED, "not_in_control, other")]
    assert not bench.role.relay.ledger.open_entries()


def test_a_drone_that_is_far_and_says_that_it_is_slow_keeps_no_list_from_leaving() -> None:
    other_side = Location(-47.4, -171.5, 500, 20)
    effects = flock(1, 1, drone2={"place": other_side, "speed": MaxGroundspeed(0.01)}).select(TARGET)
    (message,) = psmi(effects)
    assert reasons(message) == {2: "out_of_range"}
    assert sent_to(effects) == [1]


def test_a_chosen_drone_is_busy_until_its_last_word() -> None:
    bench = flock(1)
    bench.select(TARGET)
    assert reasons(psmi(bench.select(TARGET, seq=2))[0]) == {1: "busy"}
    bench.word(1, Word.COMPLETED)
    assert numbers(psmi(bench.select(TARGET, seq=3))[0].listed) == [1]


def test_a_duplicate_is_answered_and_sends_nobody(bench: ActivatorBench) -> None:
    bench.select(TARGET)
    bench.word(2, Word.ACCEPTED)
    effects = bench.select(TARGET)
    assert sent_to(effects) == []
    assert psmi(effects)[0].chosen == 2
    assert words_of(effects, 2) == [Word.ACCEPTED]


def test_an_offer_reserves_its_best_and_sends_nobody(bench: ActivatorBench) -> None:
    effects = bench.select(TARGET, mode=SelectMode.OFFER, limit_s=8.0)
    (message,) = psmi(effects)
    assert (message.chosen, message.hold_until_ms) == (2, BORN_MS + 8000)
    assert sent_to(effects) == []
    assert reasons(psmi(bench.select(TARGET, seq=2, mode=SelectMode.OFFER))[0]) == {2: "busy"}


def test_a_commit_goes_to_the_reserved_drone_alone(bench: ActivatorBench) -> None:
    bench.select(TARGET, seq=1, mode=SelectMode.OFFER)
    assert sent_to(bench.select(TARGET, seq=2, mode=SelectMode.COMMIT, reservation=1)) == [2]
    effects = bench.word(2, Word.DENIED, seq=2)
    assert sent_to(effects) == []
    assert denial(bench.select(TARGET, seq=3, mode=SelectMode.COMMIT, reservation=1)) == "no_reservation"


def test_a_commit_to_something_else_than_was_offered_is_denied() -> None:
    bench = flock(1)
    bench.select(TARGET, seq=1, mode=SelectMode.OFFER)
    other = Goto(47.5, 8.5, 20)
    assert denial(bench.select(other, seq=2, mode=SelectMode.COMMIT, reservation=1)) == "other_than_reserved"


def test_a_reservation_lapses_by_itself_and_nothing_flies() -> None:
    bench = flock(1)
    bench.select(TARGET, seq=1, mode=SelectMode.OFFER, limit_s=4.0)
    assert sent_to(bench.until(bench.now_ms + 4100)) == []
    assert denial(bench.select(TARGET, seq=2, mode=SelectMode.COMMIT, reservation=1)) == "no_reservation"
    assert numbers(psmi(bench.select(TARGET, seq=3))[0].listed) == [1]


def test_a_release_frees_the_drone_at_once() -> None:
    bench = flock(1)
    bench.select(TARGET, seq=1, mode=SelectMode.OFFER)
    bench.select(TARGET, seq=2, mode=SelectMode.RELEASE, reservation=1)
    assert numbers(psmi(bench.select(TARGET, seq=3))[0].listed) == [1]


def test_a_choice_of_an_earlier_session_is_asked_of_every_drone_because_any_may_fly_it(bench: ActivatorBench) -> None:
    effects = bench.select(TARGET, executor_session=77)
    assert sent_to(effects) == [1, 2]
    queries = [decode(CommandMessage, of(effects, f"drone{drone}/commands")[0].payload) for drone in (1, 2)]
    assert {query.deadline_ms for query in queries} == {0}
    assert words_of(bench.word(1, Word.EXPIRED), 1) == [Word.EXPIRED]
    assert words_of(bench.word(2, Word.COMPLETED), 2) == [Word.COMPLETED]


def restarted() -> ActivatorBench:
    """An activator that was started anew: the broker retains that drone 7 was there, which is not back yet."""
    bench = ActivatorBench(drones=(1,), born=False)
    bench.cloud("drone7/reachable", DroneRecord(activator_session=77, up=True, drone_session=5), retain=True)
    bench.cloud("clock", BeaconMessage(session=FOG_SESSION, now_ms=bench.now_ms))
    bench.appear(1, UAV_SESSION + 1)
    return bench


def test_a_choice_of_an_earlier_session_is_asked_of_a_drone_that_is_not_back_yet() -> None:
    """It may be the one that flies: that the others know nothing is no definite no."""
    bench = restarted()
    bench.select(TARGET, executor_session=77)
    assert of(bench.word(1, Word.EXPIRED), "fog1/commands_result/goto") == []
    assert sent_to(bench.appear(7, UAV_SESSION + 7)) == [7]
    assert words_of(bench.word(7, Word.COMPLETED), 7) == [Word.COMPLETED]


def test_a_broadcast_of_an_earlier_session_is_asked_of_a_drone_that_is_not_back_yet() -> None:
    bench = restarted()
    bench.command(Hold(), to="commands", executor_session=77)
    assert sent_to(bench.appear(7, UAV_SESSION + 7)) == [7]


def test_a_new_broadcast_concerns_nobody_who_is_only_remembered() -> None:
    bench = restarted()
    (roster,) = of(bench.command(Hold(), to="commands"), "fog1/commands_result/hold")
    assert [entry.drone for entry in decode(FogResultMessage, roster.payload).roster or ()] == [1]


def test_a_choice_of_an_earlier_session_that_nobody_has_is_expired() -> None:
    bench = restarted()
    bench.appear(7, UAV_SESSION + 7)
    bench.select(TARGET, executor_session=77)
    bench.word(1, Word.EXPIRED)
    assert denial(bench.word(7, Word.EXPIRED)) == "expired"


def test_a_choice_of_an_earlier_session_is_not_denied_where_the_broker_shows_no_records(bench: ActivatorBench) -> None:
    """That session may have chosen a drone of which nothing is known here: no other one may be sent."""
    effects = [*bench.select(TARGET, executor_session=77), *bench.word(1, Word.EXPIRED), *bench.word(2, Word.EXPIRED)]
    assert of(effects, "fog1/commands_result/goto") == []


def test_its_own_records_do_not_say_to_whom_an_earlier_session_spoke(bench: ActivatorBench) -> None:
    """After a reconnection the broker shows what this session has published, and nothing of the one before."""
    bench.role.on_disconnected("cloud", bench.now_ms)
    for subscribe in bench.role.on_connected("cloud", bench.now_ms):
        bench.role.on_subscribed(subscribe, bench.now_ms)  # type: ignore[arg-type]
    for number in (1, 2):
        own = DroneRecord(activator_session=FOG_SESSION, up=True, drone_session=UAV_SESSION + number)
        bench.cloud(f"drone{number}/reachable", own, retain=True)
    bench.be_shown()
    effects = [*bench.select(TARGET, executor_session=77), *bench.word(1, Word.EXPIRED), *bench.word(2, Word.EXPIRED)]
    assert of(effects, "fog1/commands_result/goto") == []


def test_records_that_only_full_names_show_do_not_say_who_else_was_there() -> None:
    bench = ActivatorBench(drones=(1,), born=False)
    bench.be_shown((1, DroneRecord(activator_session=77, up=True, drone_session=5)))
    bench.appear(1, UAV_SESSION + 1)
    bench.select(TARGET, executor_session=77)
    assert of(bench.word(1, Word.EXPIRED), "fog1/commands_result/goto") == []


def test_a_choice_that_may_have_been_forgotten_is_not_denied(bench: ActivatorBench) -> None:
    due_ms = bench.now_ms + 5000
    bench.select(TARGET, deadline_ms=due_ms)
    bench.word(2, Word.COMPLETED)
    bench.now_ms += KEEP_MS + 5001
    bench.command(Hold(), seq=2)
    assert of(bench.select(TARGET, deadline_ms=due_ms), "fog1/commands_result/goto") == []
    assert not bench.role.relay.ledger.open_entries()


def test_a_denied_choice_is_not_made_when_it_comes_again_after_the_ledger_has_dropped_it(bench: ActivatorBench) -> None:
    due_ms = bench.now_ms + 3_600_000
    bench.select(TARGET, deadline_ms=due_ms)
    bench.now_ms = due_ms - 1000
    bench.command(Hold(), gs_session=0xE7E)
    assert of(bench.select(TARGET, deadline_ms=due_ms), "fog1/commands_result/goto") == []
    assert not bench.role.relay.ledger.open_entries()


def test_a_command_that_is_not_the_topics_is_denied() -> None:
    effects = flock(1).cloud("commands/goto", b'{"version":1,"gs_session":17,"seq":9}')
    (publish,) = of(effects, "fog1/commands_result/malformed")
    assert "executor_session" in (decode(FogResultMessage, publish.payload).denied or "")


def words_of(effects: list[Any], drone: int) -> list[Word]:
    return [word for word, _ in words(effects, drone)]
