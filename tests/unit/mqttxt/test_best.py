"""A choice across fogs: who says a definite no is passed over, in its fog and in others, and nobody is sent twice."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from mqttxt.core.clock import SessionClock
from mqttxt.errors import BrokerRefused, ConfigurationError, FogUnreachable
from mqttxt.protocol.commands import Goto
from mqttxt.protocol.messages import CommandId, Word
from mqttxt.protocol.rankings import Candidate, SelectMode
from mqttxt.station.best import best
from mqttxt.station.heard import Record, SentCommand
from mqttxt.station.outcomes import Outcome, PsmiList, last_word

TARGET = Goto(47.4, 8.5, 20)


class Station:
    """A station and its fogs: each has drones with the seconds to arrive, and each drone has its words."""

    signs = False

    def __init__(self, fogs: dict[int, dict[int, float]], words: dict[int, list[Word]]) -> None:
        self.fogs = fogs
        self.words = words
        self.station = self
        self.commands = SimpleNamespace(overriding_seq=-1)
        self.choices = SimpleNamespace(begin=lambda choice: choice)
        self.clock = SessionClock()
        self.reserved: dict[int, tuple[int, int]] = {}
        self.tried: dict[int, set[int]] = {}
        self.sent: list[int] = []
        self.gone: set[int] = set()
        self.offers_s: dict[int, list[float]] = {}
        self.commit_ttls_s: list[float] = []
        self.lands_behind: int | None = None
        self._seq = 0

    def is_doubtful(self, outcome: Outcome) -> bool:
        return False

    def select(
        self,
        fog: int,
        command: Any,
        mode: SelectMode,
        ttl_s: float,
        limit_s: float | None = None,
        reservation: int | None = None,
        drone: int | None = None,
    ) -> SentCommand[Any, Any]:
        if fog in self.gone:
            raise FogUnreachable(f"fog {fog}: no live activator")
        self._seq += 1
        seq, record = self._seq, Record[Any]()
        if mode is SelectMode.RELEASE:
            del self.reserved[reservation or 0]
        elif mode is SelectMode.OFFER and self.offers_s.get(fog):
            after_s = self.offers_s[fog].pop(0)
            asyncio.get_running_loop().call_later(after_s, self._offer_late, record, CommandId(1, seq), fog)
            return SentCommand(record, last_word)
        elif mode is SelectMode.OFFER:
            record.hear(self._offer(CommandId(1, seq), fog, reservation))
        elif mode is SelectMode.COMMIT:
            _, drone = self.reserved.pop(reservation or 0)
            self.sent.append(drone)
            self.commit_ttls_s.append(ttl_s)
            for word in self.words[drone]:
                record.hear(Outcome(CommandId(1, seq), fog, drone, "goto", word))
            if drone == self.lands_behind:
                self.commands.overriding_seq = seq + 1
        record.end()
        return SentCommand(record, last_word)

    def _offer_late(self, record: Record[Any], command_id: CommandId, fog: int) -> None:
        record.hear(self._offer(command_id, fog, None))
        record.end()

    def _offer(self, command_id: CommandId, fog: int, before: int | None) -> PsmiList:
        tried = self.tried.get(before, set()) if before is not None else set()
        free = {drone: at for drone, at in self.fogs[fog].items() if drone not in tried}
        listed = tuple(Candidate(drone=d, arrival_s=free[d]) for d in sorted(free, key=lambda d: free[d]))
        chosen = listed[0].drone if listed else None
        if chosen is not None:
            self.reserved[command_id.seq] = (fog, chosen)
        self.tried[command_id.seq] = tried | ({chosen} if chosen is not None else set())
        return PsmiList(fog, command_id, listed, (), chosen)


def choice(*stations: Station, ttl_s: float = 5.0, limit_s: float | None = None) -> SentCommand[Any, Any]:
    """A choice across all fogs of these stations."""
    return best([(one, fog) for one in stations for fog in one.fogs], TARGET, ttl_s, limit_s)  # type: ignore[misc]


async def choose(*stations: Station, ttl_s: float = 5.0) -> list[Any]:
    return [event async for event in choice(*stations, ttl_s=ttl_s)]


FLEET = {1: {1: 10.0, 2: 30.0}, 2: {4: 20.0}}
FLIES = [Word.ACCEPTED, Word.COMPLETED]


async def test_the_first_that_does_not_refuse_is_sent_in_the_order_of_arrival_over_all_fogs() -> None:
    station = Station(FLEET, {1: [Word.DENIED], 4: [Word.UNSUPPORTED], 2: FLIES})
    heard = await choose(station)
    assert station.sent == [1, 4, 2]
    assert (heard[-1].drone, heard[-1].word) == (2, Word.COMPLETED)
    assert station.reserved == {}


@pytest.mark.parametrize("said", [[Word.FAILED], [Word.UNCONFIRMED], [Word.OVERTAKEN], [Word.SUPERSEDED], []])
async def test_behind_silence_and_anything_but_a_definite_no_nobody_else_is_sent(said: list[Word]) -> None:
    station = Station(FLEET, {1: said, 4: FLIES, 2: FLIES})
    await choose(station)
    assert station.sent == [1]
    assert station.reserved == {}


async def test_who_is_reserved_elsewhere_is_released_as_soon_as_one_may_fly() -> None:
    station = Station(FLEET, {1: FLIES})
    async for event in choice(station):
        if isinstance(event, Outcome) and event.word is Word.ACCEPTED:
            assert station.reserved == {}
    assert station.sent == [1]


async def test_a_fog_that_is_gone_is_passed_over() -> None:
    station = Station(FLEET, {1: FLIES, 4: FLIES})
    events = aiter(choice(station))
    await anext(events)
    station.gone.add(1)
    heard = [event async for event in events]
    assert station.sent == [4]
    assert heard[-1].word is Word.COMPLETED


async def test_a_hold_or_landing_of_the_same_station_ends_the_search() -> None:
    station = Station(FLEET, {1: [Word.DENIED], 4: FLIES})
    station.lands_behind = 1
    heard = await choose(station)
    assert station.sent == [1]
    assert (heard[-1].drone, heard[-1].word, heard[-1].reason) == (None, Word.DENIED, "cancelled")
    assert station.reserved == {}


async def test_behind_a_hold_that_came_before_the_offers_nobody_is_sent() -> None:
    """R7.7: a hold while the fogs are asked is the newer command."""
    station = Station(FLEET, {1: FLIES, 4: FLIES})
    events = aiter(choice(station))
    await anext(events)
    station.commands.overriding_seq = 7
    heard = [event async for event in events]
    assert station.sent == []
    assert (heard[-1].drone, heard[-1].word, heard[-1].reason) == (None, Word.DENIED, "cancelled")
    assert station.reserved == {}


async def test_among_fleets_each_is_sent_its_own_drone_alone() -> None:
    """R2.4: offers of two fleets with the same numbers; the commit and every release go where the offer is from."""
    near = Station({1: {1: 10.0}}, {1: [Word.DENIED]})
    far = Station({1: {1: 20.0, 2: 30.0}}, {1: FLIES})
    heard = await choose(near, far)
    assert (near.sent, far.sent) == ([1], [1])
    assert heard[-1].word is Word.COMPLETED
    assert near.reserved == far.reserved == {}


@pytest.mark.parametrize("when", [SelectMode.OFFER, SelectMode.COMMIT])
async def test_a_fleet_that_ends_while_it_is_asked_leaves_the_drones_of_the_others(when: SelectMode) -> None:
    ending, other = Ending({1: {1: 10.0}}, {}, when), Station({1: {4: 20.0}}, {4: FLIES})
    heard = await choose(ending, other, ttl_s=0.4)
    assert (ending.sent, other.sent) == ([], [4])
    assert heard[-1].completed
    assert other.reserved == {}


async def test_where_the_only_fleet_ends_the_choice_ends_with_its_error() -> None:
    for when in (SelectMode.OFFER, SelectMode.COMMIT):
        with pytest.raises(BrokerRefused):
            await choose(Ending(FLEET, {}, when))


class Ending(Station):
    """A station that its broker ends at one of its steps."""

    def __init__(self, fogs: dict[int, dict[int, float]], words: dict[int, list[Word]], when: SelectMode) -> None:
        super().__init__(fogs, words)
        self.when = when

    def select(self, fog: int, command: Any, mode: SelectMode, *how: Any, **more: Any) -> SentCommand[Any, Any]:
        error = BrokerRefused("cloud: refused")
        if mode is not self.when:
            return super().select(fog, command, mode, *how, **more)
        if mode is SelectMode.COMMIT:
            raise error
        record = Record[Any]()
        record.end(error)
        return SentCommand(record, last_word)


async def test_a_hold_in_any_fleet_of_a_choice_ends_it() -> None:
    near = Station({1: {1: 10.0}}, {1: [Word.DENIED]})
    far = Station({1: {1: 20.0}}, {1: FLIES})
    near.lands_behind = 1
    heard = await choose(far, near)
    assert (near.sent, far.sent, heard[-1].reason) == ([1], [], "cancelled")
    assert near.reserved == far.reserved == {}


async def test_when_all_refuse_that_is_the_end() -> None:
    station = Station(FLEET, {1: [Word.DENIED], 4: [Word.EXPIRED], 2: [Word.UNREACHABLE]})
    heard = await choose(station)
    assert station.sent == [1, 4, 2]
    assert heard[-1].chosen is None
    assert station.reserved == {}


NEVER_S = 3600.0


async def test_a_fog_that_says_nothing_any_more_leaves_the_next_one_its_time() -> None:
    station = Station(FLEET, {1: [Word.DENIED], 4: FLIES})
    station.offers_s[1] = [0.0, NEVER_S]
    await choose(station, ttl_s=0.4)
    assert station.sent == [1, 4]
    assert 0.1 < station.commit_ttls_s[-1] <= 0.2


async def test_a_fog_that_says_nothing_at_all_leaves_the_others_reservations_their_time() -> None:
    station = Station(FLEET, {4: FLIES})
    station.offers_s[1] = [NEVER_S]
    began_s = asyncio.get_running_loop().time()
    await choose(station, ttl_s=0.4)
    assert station.sent == [4]
    assert asyncio.get_running_loop().time() - began_s < 0.35


async def test_while_nothing_is_reserved_a_late_offer_is_waited_for() -> None:
    station = Station({1: {1: 10.0}, 2: {}}, {1: FLIES})
    station.offers_s[1] = [0.3]
    await choose(station, ttl_s=0.4)
    assert station.sent == [1]


class Suspended(Station):
    """A station whose machine sleeps for a minute at one of its messages: the event loop's clock does not count that.

    `at` is the number of the message, from 1 on.
    """

    def __init__(self, fogs: dict[int, dict[int, float]], words: dict[int, list[Word]], at: int) -> None:
        super().__init__(fogs, words)
        self.slept_ns = 0
        self.clock = SessionClock(lambda: self.slept_ns)
        self.at = at

    def select(self, fog: int, command: Any, mode: SelectMode, *how: Any, **more: Any) -> SentCommand[Any, Any]:
        if self._seq + 1 == self.at:
            self.slept_ns += 60_000_000_000
        return super().select(fog, command, mode, *how, **more)


@pytest.mark.parametrize("offer", [1, 2])
async def test_who_is_offered_after_the_machine_slept_is_not_sent(offer: int) -> None:
    """R7.7: it would start a minute after its caller wanted it, and `ttl_s` was 5 s."""
    station = Suspended(FLEET, {1: FLIES, 4: FLIES}, at=offer)
    heard = await choose(station)
    assert station.sent == []
    assert (heard[-1].drone, heard[-1].word, heard[-1].reason) == (None, Word.DENIED, "expired")
    assert station.reserved == {}


async def test_while_the_next_offer_is_waited_for_the_machine_may_sleep_too() -> None:
    station = Suspended(FLEET, {1: [Word.DENIED], 4: FLIES}, at=4)
    heard = await choose(station)
    assert station.sent == [1]
    assert (heard[-1].word, heard[-1].reason) == (Word.DENIED, "expired")
    assert station.reserved == {}


async def test_the_time_to_start_goes_on_while_the_machine_sleeps() -> None:
    station = Suspended(FLEET, {1: [Word.DENIED], 4: FLIES}, at=3)
    heard = await choose(station)
    assert station.sent == [1]
    assert (heard[-1].word, heard[-1].reason) == (Word.DENIED, "expired")
    assert station.reserved == {}


async def test_empty_lists_whose_denials_are_lost_are_an_answer_all_the_same() -> None:
    station = Station({1: {}, 2: {}}, {})
    answer = last_word(await choose(station, ttl_s=0.01))
    assert (answer.drone, answer.word, answer.reason) == (None, Word.DENIED, "none_eligible")


@pytest.mark.parametrize("listed", [(), (Candidate(drone=7, arrival_s=1.0),), (Candidate(drone=4),)])
async def test_an_offer_without_its_drones_arrival_goes_before_no_other(listed: tuple[Candidate, ...]) -> None:
    class Strange(Station):
        def _offer(self, command_id: CommandId, fog: int, before: int | None) -> PsmiList:
            said = super()._offer(command_id, fog, before)
            return replace(said, listed=listed) if fog == 2 else said

    station = Strange(FLEET, {1: FLIES})
    assert last_word(await choose(station)).drone == 1
    assert station.sent == [1]


def test_a_list_with_figures_missing_is_shown_without_them() -> None:
    listed = (Candidate(drone=1, distance_m=0.0, arrival_s=0.0), Candidate(drone=2, arrival_s=5.0))
    shown = str(PsmiList(1, CommandId(1, 1), listed, (), 1))
    assert shown.splitlines() == ["fog 1: PSMI [1, 2]", "  drone 1: 0 m, 0.0 s"]


async def test_a_limit_that_no_command_can_have_is_refused_before_any_fog_is_asked() -> None:
    station = Station(FLEET, {})
    with pytest.raises(ConfigurationError, match="limit 0 s: expected"):
        choice(station, limit_s=0)
    assert station.reserved == {}
