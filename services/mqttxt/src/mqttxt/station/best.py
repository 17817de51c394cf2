"""The choice of a drone across fogs: each fog reserves its best, one gets the command (docs/protocol.md, section 7)."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Sequence

from ..core.clock import SessionClock
from ..errors import FogUnreachable, MqttxtError
from ..protocol.commands import Command
from ..protocol.messages import Word
from ..protocol.rankings import Candidate, SelectMode
from ..protocol.words import PASSED_OVER
from .commands import check_limit, ttl_ms_of
from .heard import SentCommand
from .outcomes import Outcome, PsmiList
from .process import StationRunner

HOLD_S = 5.0
"""How much longer a fog's reservation lasts than the time that the drone has to start."""

_RELEASE_TTL_S = 5.0
_SHORTEST_S = 0.001
_CANCELLED = "cancelled"
_NONE_ELIGIBLE = "none_eligible"

Place = tuple[StationRunner, int]
"""A fog by its number, and the station that is registered at it: each of several fleets has its own."""
Asked = SentCommand[Outcome, Outcome | PsmiList]
Answer = tuple[StationRunner, Outcome | PsmiList]
Offer = tuple[StationRunner, PsmiList]


def best(places: Sequence[Place], command: Command, ttl_s: float, limit_s: float | None) -> Asked:
    """`GroundStation.best` and `Fleets.best`: one fog that does not sign chooses itself, else the station does."""
    if not places:
        raise FogUnreachable(f"no fog is connected; {command.name} was not sent")
    runner, fog = places[0]
    if len(places) == 1 and not runner.station.signs:
        return runner.select(fog, command, SelectMode.SELECT, ttl_s, limit_s)
    check_limit(limit_s)
    runners = {runner: runner.station.commands.overriding_seq for runner, _ in places}
    latest_ms = runner.clock.now_ms() + 2 * ttl_ms_of(ttl_s)
    asked = _ask(places, command, ttl_s, ttl_s)
    return asked[0][0].choices.begin(_choose(command, asked, runners, runner.clock, latest_ms, ttl_s, limit_s))


async def _choose(
    command: Command,
    asked: list[tuple[StationRunner, Asked]],
    stopped_before: dict[StationRunner, int],
    clock: SessionClock,
    latest_ms: int,
    ttl_s: float,
    limit_s: float | None,
) -> AsyncIterator[Outcome | PsmiList]:
    """Choose by the fogs' offers; yields the events from those to the last word of the drone that was sent.

    `stopped_before` has the number of each station's last hold, land or return before the choice. Nobody is sent after
    `latest_ms` of the clock, whenever the offers came: a process that stood still finds them in its socket.
    """
    held: list[Offer] = []
    try:
        offers = await _answers(asked, ttl_s / 2)
        if not any(_reserved(answer) for answer in offers):
            offers = await _answers(asked, ttl_s / 2)
        if not offers:
            raise FogUnreachable(f"{command.name}: no fog answered within {ttl_s:g} s; no drone was sent")
        for answer in offers:
            held += _reserved(answer)
            yield answer[1]
        lists = [event for _, event in offers if isinstance(event, PsmiList)]
        if not held and len(lists) == len(offers):  # the words of the fogs have not come
            yield _ended(lists[0], command, _NONE_ELIGIBLE)
        start_until_ms = min(clock.now_ms() + ttl_ms_of(ttl_s), latest_ms)

        def end() -> str | None:
            """Why nobody is sent any more."""
            if clock.now_ms() >= start_until_ms:
                return Word.EXPIRED.label
            return _CANCELLED if _is_overridden(stopped_before) else None

        while held:
            offer = min(held, key=_arrival)
            runner, chosen = offer
            if (reason := end()) is not None:
                yield _ended(chosen, command, reason)
                return
            held.remove(offer)
            last = None
            left_s = _left_s(clock, start_until_ms)
            try:
                sent = runner.select(
                    chosen.fog, command, SelectMode.COMMIT, left_s, limit_s, chosen.id.seq, chosen.chosen
                )
            except MqttxtError:  # it was not sent
                if not held:
                    raise
                last = Word.UNREACHABLE
            else:
                async for event in sent:
                    if isinstance(event, PsmiList):  # the offer had the list
                        continue
                    last = Word.UNCONFIRMED if runner.station.is_doubtful(event) else event.word
                    if last not in PASSED_OVER:
                        _release(command, held)  # the drone may fly, so no other is sent
                    yield event
            if last not in PASSED_OVER:
                return
            if (reason := end()) is not None:
                yield _ended(chosen, command, reason)
                return
            for answer in await _next_offer(offer, command, _left_s(clock, start_until_ms)):
                held += _reserved(answer)
                yield answer[1]
    finally:
        _release(command, held)


def _arrival(offer: Offer) -> tuple[float, int]:
    chosen = _chosen(offer[1])
    assert chosen is not None
    return chosen.arrival_s if chosen.arrival_s is not None else math.inf, chosen.drone


def _chosen(said: PsmiList) -> Candidate | None:
    """The entry of the drone that a list names: None without one, and where the list has no such drone."""
    return next((candidate for candidate in said.listed if candidate.drone == said.chosen), None)


def _left_s(clock: SessionClock, start_until_ms: int) -> float:
    """How long a drone still has to start, by a session clock: the event loop's clock may stand still in suspend."""
    return max(_SHORTEST_S, (start_until_ms - clock.now_ms()) / 1000)


async def _next_offer(tried: Offer, command: Command, left_s: float) -> list[Answer]:
    """A fog's next offer, without the drone that refused; half of the time that is left is kept for the commit."""
    runner, before = tried
    wait_s = max(_SHORTEST_S, left_s / 2)
    with contextlib.suppress(MqttxtError):
        return await _answers(_ask([(runner, before.fog)], command, wait_s, left_s, before.id.seq), wait_s)
    return []


def _is_overridden(stopped_before: dict[StationRunner, int]) -> bool:
    """Whether a hold, land or return was sent since: it ends the choice, and no other drone is sent."""
    return any(runner.station.commands.overriding_seq != before for runner, before in stopped_before.items())


def _ended(chosen: PsmiList, command: Command, reason: str) -> Outcome:
    return Outcome(chosen.id, chosen.fog, None, command.name, Word.DENIED, reason, fleet=chosen.fleet)


def _reserved(answer: Answer) -> list[Offer]:
    """The offer in a fog's answer, if there is one."""
    runner, event = answer
    return [(runner, event)] if isinstance(event, PsmiList) and _chosen(event) is not None else []


def _release(command: Command, held: list[Offer]) -> None:
    """Release the reservations; where the fog or the station is gone, they lapse by themselves."""
    while held:
        runner, offer = held.pop()
        with contextlib.suppress(MqttxtError):
            runner.select(offer.fog, command, SelectMode.RELEASE, _RELEASE_TTL_S, reservation=offer.id.seq)


def _ask(
    places: Sequence[Place], command: Command, ttl_s: float, left_s: float, tried: int | None = None
) -> list[tuple[StationRunner, Asked]]:
    """Ask each fog to reserve its best within `ttl_s`; raises FogUnreachable where none is live.

    `left_s` is the time within which the drone must start. `tried` is the number of an offer: its drone, and those
    of the offers before it, are left out. An error in one fleet does not keep the others from being asked.
    """
    asked, wrong = [], None
    for runner, fog in places:
        try:
            asked.append((runner, runner.select(fog, command, SelectMode.OFFER, ttl_s, HOLD_S + left_s, tried)))
        except MqttxtError as error:
            wrong = error
    if wrong is not None and not asked:
        raise wrong
    return asked


async def _answers(asked: list[tuple[StationRunner, Asked]], limit_s: float) -> list[Answer]:
    """The fogs' answers within a time: lists with their reservations, or the reason why there is none.

    Raises the first one's error where every station that was asked has ended.
    """
    answers = await asyncio.gather(*(_answer(one, limit_s) for _, one in asked))
    ended = [answer for answer in answers if isinstance(answer, MqttxtError)]
    if len(ended) == len(answers):
        raise ended[0]
    return [
        (runner, event)
        for (runner, _), answer in zip(asked, answers, strict=True)
        if not isinstance(answer, MqttxtError)
        for event in answer
    ]


async def _answer(asked: Asked, limit_s: float) -> list[Outcome | PsmiList] | MqttxtError:
    heard: list[Outcome | PsmiList] = []
    try:
        async with asyncio.timeout(limit_s):
            async for event in asked:
                heard.append(event)
    except TimeoutError:
        pass
    except MqttxtError as error:
        return error
    return heard
