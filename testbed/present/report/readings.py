"""The page's section on sensors: the series of the attempts in detail, the results of all attempts, the traffic."""

from __future__ import annotations

from dataclasses import dataclass

from ...numbers import words
from ...numbers.attempt_entry import AmountEntry, AttemptEntry, ReadingsEntry
from ...numbers.written import Metrics
from ...plan import wording
from .details import Shown

LINKS = ("sense", "air", "backhaul", "wan")
PURPOSES = (("sensor", "frames"), ("acknowledgement", "ACKs"), ("upkeep", "upkeep"))
_NOTHING: AmountEntry = {"packets": 0, "bytes": 0}


@dataclass(frozen=True)
class ReadingsRow:
    """A series, with the entry in `metrics.json` of each side's attempt in detail."""

    drone: int
    kind: str
    unit: str
    by: dict[str, ReadingsEntry]


def rows_of(shown: Shown) -> list[ReadingsRow]:
    """The rows, sorted by drone, one per kind; empty without sensors."""
    found: dict[tuple[int, str], ReadingsRow] = {}
    for protocol, attempt in shown.items():
        for one in attempt["series"]:
            key = one["drone"], one["kind"]
            found.setdefault(key, ReadingsRow(*key, unit_of(one["unit"]), {})).by[protocol] = one
    return [found[key] for key in sorted(found, key=lambda key: key[0])]


def unit_of(unit: str) -> str:
    """A unit as it is written in text, from its ASCII form in messages."""
    return "°C" if unit == "degC" else unit


def said(metrics: Metrics) -> list[str]:
    """Sentences for each side: in how many attempts every series arrived complete, and what the others lack."""
    sentences = []
    for protocol, side in words.sides(metrics):
        flown = [attempt for attempt in side["attempts"] if attempt["series"]]
        if not flown:
            continue
        name, count = wording.name_of(protocol), len(flown[0]["series"])
        whole = sum(not missing(attempt) for attempt in flown)
        which = "the attempt" if len(flown) == 1 else f"{whole} of {len(flown)} attempts"
        if whole == len(flown):
            how = "" if len(flown) == 1 else f" in each of {len(flown)} attempts"
            sentences.append(f"{name}: all {count} series arrived whole, as they were measured{how}.")
            continue
        sentences.append(f"{name}: not every series arrived whole" + (f", in {which} they did." if whole else "."))
        for attempt in flown:
            if gone := missing(attempt):
                sentences.append(f"{name}, attempt {attempt['attempt']}: {'; '.join(gone)}.")
    return sentences


def missing(attempt: AttemptEntry) -> list[str]:
    """The incomplete series of an attempt, drone by drone."""
    by_drone: dict[int, list[ReadingsEntry]] = {}
    for one in attempt["series"]:
        if not one["whole"]:
            by_drone.setdefault(one["drone"], []).append(one)
    found = []
    for drone, broken in by_drone.items():
        if all(one["measured"] == 0 for one in broken):
            found.append(f"drone {drone}: its sensor {broken[0]['sensor']} was never reached and measured nothing")
        else:
            found.append(f"drone {drone}: {', '.join(_of(one) for one in broken)}")
    return found


def _of(one: ReadingsEntry) -> str:
    wrong = f", {one['wrong']} wrong" if one["wrong"] else ""
    return f"{one['kind']} {one['delivered']} of {one['samples']}{wrong}"


def traffic_of(shown: Shown) -> list[tuple[str, dict[str, list[AmountEntry]]]]:
    """Packets and bytes by PURPOSES for each class of link, and for all links; empty if nothing was counted."""
    counted = {p: attempt["reading_traffic"] for p, attempt in shown.items()}
    if not any(counted.values()):
        return []
    table = [
        (link, {p: [by.get(link, {}).get(purpose, _NOTHING) for purpose, _ in PURPOSES] for p, by in counted.items()})
        for link in LINKS
    ]
    sums = {p: [_sum([row[p][at] for _, row in table]) for at in range(len(PURPOSES))] for p in counted}
    return [*table, ("all links", sums)]


def _sum(amounts: list[AmountEntry]) -> AmountEntry:
    return {"packets": sum(one["packets"] for one in amounts), "bytes": sum(one["bytes"] for one in amounts)}


def cost(shown: Shown) -> str | None:
    """A sentence on the bytes of the frames with readings, per value that arrived; None if none did."""
    parts = []
    for protocol, attempt in shown.items():
        arrived = sum(one["delivered"] for one in attempt["series"])
        traffic = attempt["reading_traffic"]
        carried = sum(by.get("sensor", _NOTHING)["bytes"] for by in traffic.values())
        if arrived and carried:
            parts.append(f"{carried / arrived:,.0f} bytes over {_CARRIER.get(protocol, wording.name_of(protocol))}")
    return f"A value that arrived took {wording.listed(parts)}, on all four links together." if parts else None


_CARRIER = {"mavlink": "the plain brokers beside MAVLink"}
