"""PSMI, prioritization on selectable mission items: which drone arrives first (docs/protocol.md, section 7)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

from ..protocol.commands import Goto, haversine_m
from ..protocol.rankings import Candidate
from ..protocol.states import Armed, Battery, Endurance, Landed, LandedState, Location, MaxGroundspeed, VitalState
from .drone_link import DroneLink
from .leases import Leases

RESERVE_PCT = 20
"""Charge that must be left in the battery on arrival, %."""
SLOWEST_S = 100_000_000.0
"""The longest time to arrive that a list can carry, s: a drone's own speed must not keep the list from leaving."""
USED = (Location, Battery, MaxGroundspeed, Endurance, Armed, LandedState)
"""The states by which drones are chosen."""

Value = TypeVar("Value", bound=VitalState)


def rank(
    command: Goto,
    links: Iterable[DroneLink],
    *,
    leases: Leases,
    gs_session: int,
    epoch: int,
    busy: set[int],
    tried: frozenset[int] = frozenset(),
    stale_ms: int,
    now_ms: int,
) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...]]:
    """The drones that can execute a goto, soonest arrival first, and those left out, each with its reason (R7.3).

    Time to arrive is the great-circle distance over the largest groundspeed; ties go by number. Range is
    (remaining - 20 %) x endurance x cruise speed. A drone with a state older than `stale_ms` is left out, and so is one
    that is disarmed or on the ground: a goto makes no drone take off. `tried` has the drones of earlier offers.
    """
    found = [_candidate(command, link, now_ms) for link in links]
    known = {link.number: link for link in links}
    judged = []
    for candidate in found:
        link = known[candidate.drone]
        control = leases.refusal(candidate.drone, gs_session, epoch, now_ms)
        reason = None
        if not link.announced:
            reason = "unreachable"
        elif control is not None:
            reason = control
        elif candidate.drone in tried:
            reason = "tried"
        elif candidate.drone in busy:
            reason = "busy"
        else:
            reason = _unfit(candidate, link, stale_ms, now_ms)
        judged.append((candidate, reason))
    listed = [candidate for candidate, reason in judged if reason is None]
    listed.sort(key=lambda candidate: (candidate.arrival_s, candidate.drone))
    left_out = [_with_reason(candidate, reason) for candidate, reason in judged if reason is not None]
    return tuple(listed), tuple(sorted(left_out, key=lambda candidate: candidate.drone))


def _candidate(command: Goto, link: DroneLink, now_ms: int) -> Candidate:
    """A drone with every known figure."""
    place, battery = _value(link, Location), _value(link, Battery)
    fastest, endurance = _value(link, MaxGroundspeed), _value(link, Endurance)
    ages = [age for age in (link.age_ms(state.name, now_ms) for state in USED) if age is not None]
    distance_m = arrival_s = range_m = None
    if place is not None:
        distance_m = haversine_m(place.latitude_deg, place.longitude_deg, command.latitude_deg, command.longitude_deg)
        if fastest is not None and fastest.max_groundspeed_m_s > 0:
            arrival_s = min(SLOWEST_S, distance_m / fastest.max_groundspeed_m_s)
    if battery is not None and endurance is not None:
        usable = max(0, battery.remaining_pct - RESERVE_PCT) / 100
        range_m = usable * endurance.endurance_s * endurance.cruise_m_s
    return Candidate(
        drone=link.number,
        distance_m=distance_m,
        arrival_s=arrival_s,
        max_groundspeed_m_s=fastest.max_groundspeed_m_s if fastest is not None else None,
        remaining_pct=battery.remaining_pct if battery is not None else None,
        range_m=range_m,
        age_s=min(1000.0, max(ages) / 1000) if ages else None,
    )


def _unfit(candidate: Candidate, link: DroneLink, stale_ms: int, now_ms: int) -> str | None:
    """Why a drone that is free for the command cannot execute it; None if it can."""
    for state in USED:
        age_ms = link.age_ms(state.name, now_ms)
        if age_ms is None:
            return f"unknown({state.name})"
        if age_ms > stale_ms:
            return f"stale({state.name})"
    armed, landed = _value(link, Armed), _value(link, LandedState)
    if armed is not None and not armed.armed:
        return "disarmed"
    if landed is not None and landed.landed is Landed.ON_GROUND:
        return "on_ground"
    if landed is not None and landed.landed is Landed.UNDEFINED:
        return f"unknown({LandedState.name})"
    if candidate.arrival_s is None:
        return f"unknown({MaxGroundspeed.name})"
    if candidate.range_m is None or candidate.distance_m is None or candidate.range_m < candidate.distance_m:
        return "out_of_range"
    return None


def _value(link: DroneLink, cls: type[Value]) -> Value | None:
    known = link.states.get(cls.name)
    return known.state.state if known is not None and isinstance(known.state.state, cls) else None


def _with_reason(candidate: Candidate, reason: str) -> Candidate:
    return replace(candidate, reason=reason)
