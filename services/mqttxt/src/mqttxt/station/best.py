"""The choice of a drone across fogs: each fog reserves its best, one gets the command (docs/protocol.md, section 7)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence

from ..errors import FogUnreachable, MqttxtError
from ..protocol.commands import Command
from ..protocol.messages import Word
from ..protocol.rankings import SelectMode
from ..protocol.words import PASSED_OVER
from .heard import SentCommand
from .outcomes import Outcome, PsmiList
from .process import StationRunner

HOLD_S = 5.0
"""How much longer than a drone has to start a fog keeps the one that it offered."""

_RELEASE_TTL_S = 5.0
_SHORTEST_S = 0.001

Asked = SentCommand[Outcome, Outcome | PsmiList]


def best(runner: StationRunner, command: Command, fogs: Sequence[int], ttl_s: float, limit_s: float | None) -> Asked:
    """`GroundStation.best`: one fog chooses by itself, of several this station does."""
    if not fogs:
        raise FogUnreachable(f"no fog is connected; {command.name} was not sent")
    if len(fogs) == 1 and not runner.station.signs:
        return runner.select(fogs[0], command, SelectMode.SELECT, ttl_s, limit_s)
    asked = _ask(runner, command, fogs, ttl_s, ttl_s)
    return runner.choose(_choose(runner, command, asked, ttl_s, limit_s))


async def _choose(
    runner: StationRunner, command: Command, asked: list[Asked], ttl_s: float, limit_s: float | None
) -> AsyncIterator[Outcome | PsmiList]:
    """The events from the fogs' offers to the last word of the drone that was sent."""
    held: list[PsmiList] = []
    try:
        offers = await _answers(asked, ttl_s / 2)
        if not any(_reserved(event) for event in offers):
            offers = await _answers(asked, ttl_s / 2)
        if not offers:
            raise FogUnreachable(f"{command.name}: no fog answered within {ttl_s:g} s; no drone was sent")
        for event in offers:
            held += _reserved(event)
            yield event
        start_until_s = asyncio.get_running_loop().time() + ttl_s
        while held:
            chosen = min(held, key=lambda offer: (offer.listed[0].arrival_s or 0.0, offer.listed[0].drone))
            held.remove(chosen)
            last = None
            try:
                async for event in _commit(runner, command, chosen, start_until_s, limit_s):
                    last = Word.UNCONFIRMED if runner.station.is_doubtful(event) else event.word
                    if last not in PASSED_OVER:
                        _release(runner, command, held)  # it may fly: nobody else will
                    yield event
            except FogUnreachable:  # it was not sent
                if not held:
                    raise
                last = Word.UNREACHABLE
            if last not in PASSED_OVER:
                return
            reason = _why_to_end(runner, chosen, start_until_s)
            if reason is not None:
                yield Outcome(chosen.id, chosen.fog, None, command.name, Word.DENIED, reason)
                return
            for event in await _next_offer(runner, command, chosen, start_until_s):
                held += _reserved(event)
                yield event
    finally:
        _release(runner, command, held)


async def _commit(
    runner: StationRunner, command: Command, chosen: PsmiList, start_until_s: float, limit_s: float | None
) -> AsyncIterator[Outcome]:
    """Send the command to the drone that a fog has reserved; raises FogUnreachable where the fog is gone."""
    left_s = max(_SHORTEST_S, start_until_s - asyncio.get_running_loop().time())
    async for event in runner.select(
        chosen.fog, command, SelectMode.COMMIT, left_s, limit_s, chosen.id.seq, chosen.chosen
    ):
        if isinstance(event, Outcome):  # the list came with the offer
            yield event


async def _next_offer(
    runner: StationRunner, command: Command, tried: PsmiList, start_until_s: float
) -> list[Outcome | PsmiList]:
    """A fog's next offer, beside the drone that refused; the second half of the time that is left is the commit's."""
    left_s = max(_SHORTEST_S, start_until_s - asyncio.get_running_loop().time())
    wait_s = max(_SHORTEST_S, left_s / 2)
    with contextlib.suppress(FogUnreachable):
        return await _answers(_ask(runner, command, [tried.fog], wait_s, left_s, tried.id.seq), wait_s)
    return []


def _why_to_end(runner: StationRunner, chosen: PsmiList, start_until_s: float) -> str | None:
    """Why no drone is sent in place of one that refused, None where one is."""
    if runner.station.commands.is_overridden(chosen.id):
        return "cancelled"
    return Word.EXPIRED.label if asyncio.get_running_loop().time() >= start_until_s else None


def _reserved(event: Outcome | PsmiList) -> list[PsmiList]:
    """The offer in a fog's answer, if there is one."""
    return [event] if isinstance(event, PsmiList) and event.chosen is not None else []


def _release(runner: StationRunner, command: Command, held: list[PsmiList]) -> None:
    """Give up what is reserved; where the fog or the station is gone it lapses by itself."""
    while held:
        offer = held.pop()
        with contextlib.suppress(MqttxtError):
            runner.select(offer.fog, command, SelectMode.RELEASE, _RELEASE_TTL_S, reservation=offer.id.seq)


def _ask(
    runner: StationRunner, command: Command, fogs: Sequence[int], ttl_s: float, left_s: float, tried: int | None = None
) -> list[Asked]:
    """Ask each fog to reserve its best within `ttl_s`; raises FogUnreachable where none is live.

    `left_s` is the time in which the drone has to start. `tried` is the number of an offer whose drone, and those
    before it, are left out.
    """
    asked, unreachable = [], None
    for fog in fogs:
        try:
            asked.append(runner.select(fog, command, SelectMode.OFFER, ttl_s, HOLD_S + left_s, tried))
        except FogUnreachable as error:
            unreachable = error
    if unreachable is not None and not asked:
        raise unreachable
    return asked


async def _answers(asked: list[Asked], limit_s: float) -> list[Outcome | PsmiList]:
    """What the fogs answer within a time: their lists with what they have reserved, or why they have nothing."""
    answers = await asyncio.gather(*(_answer(one, limit_s) for one in asked))
    return [event for answer in answers for event in answer]


async def _answer(asked: Asked, limit_s: float) -> list[Outcome | PsmiList]:
    heard: list[Outcome | PsmiList] = []
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            async for event in asked:
                heard.append(event)
    return heard
