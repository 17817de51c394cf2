"""The choice of a drone across fogs: each fog reserves its best, one gets the command (docs/protocol.md, section 7)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any

from ..errors import FogUnreachable
from ..protocol.commands import Command
from ..protocol.messages import CommandId, Word
from ..protocol.rankings import SelectMode
from ..protocol.words import DEFINITE_NO
from .commands import ttl_ms_of
from .outcomes import Outcome, PsmiList

if TYPE_CHECKING:
    from .ground_station import GroundStation

HOLD_S = 5.0
"""How much longer than its answer may take a fog keeps the drone that it offered."""

_RELEASE_TTL_S = 5.0
_SHORTEST_S = 0.001

Start = Callable[[], tuple[CommandId, list[Any]]]
"""Sends one message; returns its id and the effects."""


async def best(
    station: GroundStation, command: Command, fogs: list[int], ttl_s: float, limit_s: float | None
) -> AsyncIterator[Outcome | PsmiList]:
    """`GroundStation.best`, for fogs that are connected."""
    if len(fogs) == 1:
        async for event in station.follow(_select(station, fogs[0], command, SelectMode.SELECT, None, ttl_s, limit_s)):
            yield event
        return
    held: list[PsmiList] = []
    try:
        for event in await _offers(station, command, fogs, ttl_s):
            held += _reserved(event)
            yield event
        start_until_s = asyncio.get_running_loop().time() + ttl_s
        while held:
            chosen = min(held, key=lambda offer: (offer.listed[0].arrival_s or 0.0, offer.listed[0].drone))
            held.remove(chosen)
            last = None
            try:
                async for event in _commit(station, command, chosen, start_until_s, limit_s):
                    last = event.word
                    if last not in DEFINITE_NO:
                        _release(station, command, held)  # it may fly: nobody else will
                    yield event
            except FogUnreachable:  # it was not sent
                if not held:
                    raise
                last = Word.UNREACHABLE
            if last not in DEFINITE_NO:
                return
            reason = _why_to_end(station, chosen, start_until_s)
            if reason is not None:
                yield Outcome(chosen.id, chosen.fog, None, command.name, Word.DENIED, reason)
                return
            for event in await _next_offer(station, command, chosen, start_until_s):
                held += _reserved(event)
                yield event
    finally:
        _release(station, command, held)


async def _commit(
    station: GroundStation, command: Command, chosen: PsmiList, start_until_s: float, limit_s: float | None
) -> AsyncIterator[Outcome]:
    """Send the command to the drone that a fog has reserved; raises FogUnreachable where the fog is gone."""
    left_s = max(_SHORTEST_S, start_until_s - asyncio.get_running_loop().time())
    start = _select(station, chosen.fog, command, SelectMode.COMMIT, chosen.id.seq, left_s, limit_s)
    async for event in station.follow(start):
        if isinstance(event, Outcome):  # the list was said with the offer
            yield event


async def _next_offer(
    station: GroundStation, command: Command, tried: PsmiList, start_until_s: float
) -> list[Outcome | PsmiList]:
    """What a fog has to offer beside the drone that said no."""
    left_s = max(_SHORTEST_S, start_until_s - asyncio.get_running_loop().time())
    with contextlib.suppress(FogUnreachable):
        return await _offers(station, command, [tried.fog], left_s, tried.id.seq)
    return []


def _why_to_end(station: GroundStation, chosen: PsmiList, start_until_s: float) -> str | None:
    """Why nobody is sent in place of who said no, None where somebody is."""
    if station.station.commands.is_overridden(chosen.id):
        return "cancelled"
    return Word.EXPIRED.label if asyncio.get_running_loop().time() >= start_until_s else None


def _reserved(event: Outcome | PsmiList) -> list[PsmiList]:
    """The offer among what a fog said, if it is one."""
    return [event] if isinstance(event, PsmiList) and event.chosen is not None else []


def _release(station: GroundStation, command: Command, held: list[PsmiList]) -> None:
    """Give up what is reserved; where the fog is gone it lapses by itself."""
    while held:
        offer = held.pop()
        with contextlib.suppress(FogUnreachable):
            start = _select(station, offer.fog, command, SelectMode.RELEASE, offer.id.seq, _RELEASE_TTL_S, None)
            station.carry_out(start()[1])


async def _offers(
    station: GroundStation, command: Command, fogs: list[int], ttl_s: float, tried: int | None = None
) -> list[Outcome | PsmiList]:
    """Each fog's list with what it has reserved, or why it has nothing; raises FogUnreachable where none is live.

    `tried` is the number of an offer whose drone, and those before it, are left out.
    """
    starts = [_select(station, fog, command, SelectMode.OFFER, tried, ttl_s, HOLD_S + ttl_s) for fog in fogs]
    answers = await asyncio.gather(*(_answers(station, start, ttl_s) for start in starts))
    unreachable = [answer for answer in answers if isinstance(answer, FogUnreachable)]
    if len(unreachable) == len(fogs):
        raise unreachable[0]
    return [event for answer in answers if isinstance(answer, list) for event in answer]


async def _answers(station: GroundStation, start: Start, limit_s: float) -> list[Outcome | PsmiList] | FogUnreachable:
    """What a fog answers to an offer within a time."""
    found: list[Outcome | PsmiList] = []
    try:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                async for event in station.follow(start):
                    found.append(event)
    except FogUnreachable as error:
        return error
    return found


def _select(
    station: GroundStation,
    fog: int,
    command: Command,
    mode: SelectMode,
    reservation: int | None,
    ttl_s: float,
    limit_s: float | None,
) -> Start:
    ttl_ms = ttl_ms_of(ttl_s)
    return lambda: station.station.select(
        fog, command, station.clock.now_ms(), mode=mode, reservation=reservation, ttl_ms=ttl_ms, limit_s=limit_s
    )
