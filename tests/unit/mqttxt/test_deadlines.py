"""No command late, none twice, each with its one last word: whole fogs against an adversary, judged by true time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from mqttxt.activator import selector
from mqttxt.activator.command_relay import CommandRelay
from mqttxt.core import clock as clocks
from mqttxt.core.ledger import Admission, Ledger
from mqttxt.drone.acknowledgements import Acknowledgements
from mqttxt.drone.commands import CommandDesk
from mqttxt.protocol.messages import CommandMessage, Word
from mqttxt.station.commands import StationCommands
from mqttxt.station.pending import Pending
from tests.examples import first_quick
from tests.simulation.adversary import CALM, MS, Dangers, S, Simulation
from tests.simulation.true_time import RHO_PPM
from tests.simulation.verdicts import Judge

LONG = pytest.mark.long
"""What the quick check leaves out."""

AIMED = replace(CALM, latencies_us=((100, 2000), (3 * MS, 40 * MS)), aims=0.5, ttls_ms=(600, 5000))
"""No danger but messages that come just around their deadlines."""
SKEWED = replace(AIMED, ppm=(-RHO_PPM, RHO_PPM), ttls_ms=(5000, 10_000))
STEADY = replace(SKEWED, latencies_us=((50, 300),), slow_drones=True, ttls_ms=(200, 600))
SELECTING = Dangers(commands_per_s=2, selects=1.0, ttls_ms=(1500, 10_000), mute=0.5)
"""The fog is asked to choose the drone, seldom enough that drones are free; autopilots often say nothing."""

SILENT = replace(CALM, commands_per_s=0.3, selects=1.0, ttls_ms=(10_000,), mute=0.8)
CROWDED = replace(CALM, commands_per_s=20, mute=0.2)
"""Holds come faster than their names get free, because autopilots often say nothing."""


def history(seed: int, dangers: Dangers | None = None, seconds: int = 30) -> Judge:
    return Simulation(seed, dangers, qos=seed % 2).live(seconds)


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_nothing_is_late_or_twice_and_each_command_has_one_last_word(seed: int) -> None:
    judge = history(seed)
    assert judge.violations == {}
    counts = judge.counts()
    assert counts["commands"] > 100
    assert counts["executed"] > 10
    assert counts["expired"] > 10


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_where_words_and_rosters_wait_for_others_each_command_has_one_last_word_too(seed: int) -> None:
    """R10.6 and R10.7: processes die, and connections are cut, while something waits."""
    dangers = Dangers(kills_per_s=0.03, cuts_per_s=0.05, dies_between=0.002)
    judge = Simulation(seed, dangers, qos=seed % 2, bundles=True).live(60)
    assert judge.violations == {}
    assert judge.counts()["executed"] > 0  # from few to 80, by what dies when


@pytest.mark.parametrize("seed", first_quick(range(2)))
def test_what_a_fog_chose_a_drone_for_is_done_by_one_at_most(seed: int) -> None:
    """After silence the first drone may be flying: no other one is sent."""
    judge = history(seed, SELECTING)
    assert judge.violations == {}
    assert any(sent.taken_on for sent in judge.sent.values() if sent.selected)


def test_a_seed_is_a_whole_history() -> None:
    assert history(3, seconds=15).counts() == history(3, seconds=15).counts()


@pytest.mark.parametrize("dangers", [AIMED, SKEWED, STEADY])
def test_what_comes_around_its_deadline_is_refused_no_earlier_than_the_formula_says(dangers: Dangers) -> None:
    judge = history(1, dangers)
    assert judge.violations == {}
    longest_s = max(dangers.ttls_ms) / 1000
    assert 0 < judge.worst_early_ms < 2 * (4 * (10 + longest_s) + 5) + 2 * 40


def test_without_danger_nothing_is_refused() -> None:
    judge = history(1, replace(CALM, ttls_ms=(5000, 10_000), mute=0), seconds=20)  # longer than a number rests
    assert judge.violations == {}
    assert judge.timely_refused == 0
    assert judge.counts()["executed"] > len(judge.sent) / 2


@pytest.mark.parametrize("seed", first_quick((3, 0, 7)))
def test_a_hold_that_shares_its_name_may_be_written_again_and_nothing_else(seed: int) -> None:
    """A fourth hold comes while the three names rest, and its own acknowledgement counts as an older one's."""
    judge = history(seed, CROWDED, seconds=20)
    assert judge.violations == {}
    shared = [(sent, drone) for sent in judge.sent.values() for drone in sent.acknowledged & sent.unidentified]
    assert any(len(sent.writes[drone]) > 1 for sent, drone in shared)


# Each rule is taken away, and the simulation has to notice.


def _time_to_live_from_arrival(patch: pytest.MonkeyPatch) -> None:
    on_command = CommandDesk._on_command

    def taken(self: Any, command: CommandMessage, retained: bool, now_ms: int) -> Any:
        return on_command(self, replace(command, deadline_ms=now_ms + 600), retained, now_ms)

    patch.setattr(CommandDesk, "_on_command", taken)


def _no_margin_for_rates(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(clocks, "_SLOWEST", 1000)


def _the_clock_is_where_the_middle_of_the_round_trip_was(patch: pytest.MonkeyPatch) -> None:
    observe = clocks.RemoteClock.observe

    def halved(self: Any, beacon: Any, received_ms: int, asked_ms: int | None = None) -> None:
        observe(self, beacon, received_ms if asked_ms is None else (asked_ms + received_ms) // 2, asked_ms)
        self.last_beacon_ms = received_ms

    patch.setattr(clocks.RemoteClock, "observe", halved)


def _a_relay_starts_the_time_anew(patch: pytest.MonkeyPatch) -> None:
    deadline_ms = clocks.RemoteClock.deadline_ms
    forward = CommandRelay.forward

    def fresh(self: Any, entry: Any, drone: int, now_ms: int) -> Any:
        with pytest.MonkeyPatch.context() as inner:
            inner.setattr(clocks.RemoteClock, "deadline_ms", lambda c, now, ttl: deadline_ms(c, now, max(ttl, 600)))
            return forward(self, entry, drone, now_ms)

    patch.setattr(CommandRelay, "forward", fresh)


def _no_duplicates_in_the_ledger(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Ledger, "examine", lambda *arguments: Admission.NEW)


def _any_session_is_the_own_one(patch: pytest.MonkeyPatch) -> None:
    on_command = CommandDesk._on_command

    def taken(self: Any, command: CommandMessage, retained: bool, now_ms: int) -> Any:
        return on_command(self, replace(command, executor_session=self._session), retained, now_ms)

    patch.setattr(CommandDesk, "_on_command", taken)


def _repeated_after_its_acknowledgement(patch: pytest.MonkeyPatch) -> None:
    on_ack = Acknowledgements.on_ack

    def deaf(self: Any, message: Any, now_ms: int) -> Any:
        return [] if message.result == 0 and now_ms % 3 == 0 else on_ack(self, message, now_ms)

    patch.setattr(Acknowledgements, "on_ack", deaf)


def _the_next_drone_after_any_last_word(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(
        selector, "PASSED_OVER", frozenset(word for word in Word if word.is_last and word is not Word.COMPLETED)
    )


def _every_word_is_passed_on(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Pending, "hear", lambda self, outcome, qos, now_ms: [outcome])


def _nobody_closes_what_stays_unanswered(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(StationCommands, "_give_up", lambda self, pending, now_ms: [])
    patch.setattr(CommandRelay, "tick", lambda self, now_ms: [])


def _a_margin_ten_times_too_large(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(clocks, "_SLOWEST", 980)


@LONG
@pytest.mark.parametrize(
    ("take_away", "kind", "dangers"),
    [
        (_time_to_live_from_arrival, "late", None),
        (_no_margin_for_rates, "late", STEADY),
        (_the_clock_is_where_the_middle_of_the_round_trip_was, "late", None),
        (_a_relay_starts_the_time_anew, "late", None),
        (_no_duplicates_in_the_ledger, "again", None),
        (_any_session_is_the_own_one, "late", replace(Dangers(), kills_per_s=0.05, repeats=0.4)),
        (_repeated_after_its_acknowledgement, "again", None),
        (_the_next_drone_after_any_last_word, "again", SILENT),
        (_every_word_is_passed_on, "words", None),
        (_nobody_closes_what_stays_unanswered, "words", None),
        (_a_margin_ten_times_too_large, "early", SKEWED),
    ],
)
def test_a_rule_taken_away_is_noticed(
    take_away: Callable[[pytest.MonkeyPatch], None], kind: str, dangers: Dangers | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_away(monkeypatch)
    assert any(history(seed, dangers).violations.get(kind) for seed in range(8))


@LONG
def test_without_the_last_look_before_the_write_a_pause_makes_commands_late() -> None:
    pausing = replace(AIMED, pauses=0.05, pausing="drone")
    assert history(1, pausing).violations == {}
    careless = replace(pausing, looks_before_the_write=False)
    assert any("late" in history(seed, careless).violations for seed in range(6))


# Outside of the bound: a session clock that is stepped, as when a virtual machine is paused with its clocks.

STEP_MS, STEP_AT_S, BEACON_S = 4000, 10, 10


@LONG
@pytest.mark.parametrize(
    ("who", "step_ms", "late"),
    [
        ("executor", STEP_MS, False),
        ("executor", -STEP_MS, True),
        ("sender", STEP_MS, True),
        ("sender", -STEP_MS, False),
    ],
)
def test_what_a_stepped_clock_does(who: str, step_ms: int, late: bool) -> None:
    """An executor's jump ahead only refuses; another step can make late by its length, until the next echo."""
    was_late = False
    for seed in range(4 if late else 2):
        simulation = Simulation(seed, AIMED)
        nodes = simulation.drones if who == "executor" else [simulation.station]
        step = [partial(node.hardware.step, step_ms) for node in nodes]
        judge = simulation.live(24, befalls={STEP_AT_S: lambda step=step: [one() for one in step]})
        assert set(judge.violations) <= ({"late", "early"} if late else {"early"})
        assert judge.worst_late_ms < STEP_MS
        assert judge.last_late_call_us < (3 + STEP_AT_S + BEACON_S + 1) * S
        was_late = "late" in judge.violations
        if was_late:
            break
    assert was_late is late


@pytest.mark.parametrize("seed", first_quick(range(3)))
@pytest.mark.parametrize("dangers", first_quick([Dangers(), SELECTING]), ids=["commands", "choices"])
def test_a_cloud_broker_that_shows_nothing_of_what_it_retains_makes_nothing_late_or_double(
    seed: int, dangers: Dangers
) -> None:
    judge = history(seed, replace(dangers, shows_retained=False))
    assert judge.violations == {}
    assert judge.counts()["executed"] > 0
