"""The choice of a drone across fogs: each fog reserves its best, one gets the command (docs/protocol.md, section 7)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any

from .commands import Command
from .errors import FogUnreachable
from .messages import CommandId
from .outcomes import Outcome, PsmiList
from .rankings import SelectMode
from .roles.station_commands import ttl_ms_of

if TYPE_CHECKING:
    from .gs import GroundStation

HOLD_S = 5.0
"""How much longer than its answer may take a fog keeps the drone that it offered."""

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
    offers = await _offers(station, command, fogs, ttl_s)
    for offered in offers:
        yield offered
    lists = [offer for offer in offers if isinstance(offer, PsmiList) and offer.chosen is not None]
    if not lists:
        return
    chosen = min(lists, key=lambda offer: (offer.listed[0].arrival_s or 0.0, offer.listed[0].drone))
    for other in (offer for offer in lists if offer is not chosen):
        station.carry_out(_select(station, other.fog, command, SelectMode.RELEASE, other.id.seq, ttl_s, None)()[1])
    commit = _select(station, chosen.fog, command, SelectMode.COMMIT, chosen.id.seq, ttl_s, limit_s)
    async for event in station.follow(commit):
        if isinstance(event, Outcome):  # the list was said with the offer
            yield event


async def _offers(station: GroundStation, command: Command, fogs: list[int], ttl_s: float) -> list[Outcome | PsmiList]:
    """Each fog's list with what it has reserved, or why it has nothing; raises FogUnreachable where none is live."""
    starts = [_select(station, fog, command, SelectMode.OFFER, None, ttl_s, HOLD_S + ttl_s) for fog in fogs]
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
