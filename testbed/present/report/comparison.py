"""Both protocols beside each other: a row a metric, with medians of the completed attempts and their ratio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

from ...numbers import words
from ...plan import wording
from .frames import entered, share_lost

Attempt = dict[str, Any]


@dataclass(frozen=True)
class Cell:
    """One protocol's value: its text, the median where it is a quantity, and each completed attempt's own.

    `more` is what several attempts say beside the median: the mean, and its interval from six on.
    """

    text: str
    middle: float | None = None
    points: tuple[float, ...] = ()
    more: str = ""


@dataclass(frozen=True)
class Row:
    """A metric by protocol; `ratio` is MAVLink / MQTT-XT, None where there is none to make.

    `test` is what the paired permutation test says, from six attempts on.
    """

    name: str
    cells: dict[str, Cell]
    ratio: float | None = None
    test: str = ""

    @property
    def most(self) -> float:
        """The largest value in the row, the end of its scale."""
        return max([value for cell in self.cells.values() for value in cell.points], default=0.0)


def completed(side: dict[str, Any]) -> list[Attempt]:
    return [attempt for attempt in side["attempts"] if attempt["status"] == "completed"]


@dataclass(frozen=True)
class Completion:
    """How many attempts of a protocol were flown and what became of them; a reason and its attempts each."""

    flown: int
    completed: int
    failed: tuple[tuple[str, tuple[int, ...]], ...]
    void: tuple[tuple[str, tuple[int, ...]], ...]

    @staticmethod
    def count(reasons: tuple[tuple[str, tuple[int, ...]], ...]) -> int:
        return sum(len(attempts) for _, attempts in reasons)


def completion(metrics: dict[str, Any]) -> dict[str, Completion]:
    """By protocol. Void attempts are flown too, but they are not among those that count."""
    found = {}
    for protocol, side in words.sides(metrics):
        failed = [a for a in side["attempts"] if a["status"] != "completed"]
        flown = len(side["attempts"])
        found[protocol] = Completion(flown, len(completed(side)), _by_reason(failed), _by_reason(side["void"]))
    return found


def _by_reason(attempts: list[dict[str, Any]]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    found: dict[str, list[int]] = {}
    for attempt in attempts:
        found.setdefault(wording.first_line(attempt["reason"]), []).append(attempt["attempt"])
    return tuple((reason, tuple(numbers)) for reason, numbers in found.items())


def shown(metrics: dict[str, Any]) -> dict[str, Attempt]:
    """Which attempt of each protocol is shown in detail: the first number completed by all, else the first
    completed one, else the first. A protocol without any is left out."""
    numbers = [{attempt["attempt"] for attempt in completed(side)} for _, side in words.sides(metrics)]
    shared = set.intersection(*numbers) if numbers else set()
    chosen = {}
    for protocol, side in words.sides(metrics):
        candidates = [a for a in completed(side) if not shared or a["attempt"] in shared] or side["attempts"]
        if candidates:
            chosen[protocol] = candidates[0]
    return chosen


def rows(metrics: dict[str, Any]) -> list[Row]:
    """Completion first, then traffic, time, losses, delay and frames per call."""
    made = metrics["ratios"]
    table = [
        Row("completed", {protocol: Cell(_completion(side)) for protocol, side in words.sides(metrics)}),
        _row(metrics, "packets", "packets", lambda a: a["packets"], words.thousands, made.get("packets")),
        _row(metrics, "packets per second", "packets_per_s", lambda a: _per_second(a, "packets"), words.digits),
        _row(metrics, "bytes", "size_bytes", lambda a: a["size_bytes"], words.size, made.get("size")),
        _row(metrics, "bytes per second", "bytes_per_s", lambda a: _per_second(a, "size_bytes"), words.size),
        _row(metrics, "mission time", "mission_s", lambda a: a["mission_s"], words.seconds, made.get("mission")),
    ]
    losses: list[tuple[str, Callable[[Attempt], float | None], Callable[[Attempt], int]]] = [
        ("commands lost", lambda a: a["message_loss"]["commands"], lambda a: a.get("commands_sent", 0)),
        ("states lost", lambda a: a["message_loss"]["states"], lambda a: a.get("states_sent", 0)),
        ("frames lost", share_lost, entered),
    ]
    for name, share, of in losses:
        cells = {protocol: _pooled_loss(completed(side), share, of) for protocol, side in words.sides(metrics)}
        table.append(Row(name, cells))
    table.append(_row(metrics, "delay of commands", "delay_ms", _delay, words.milliseconds))
    table.append(
        Row("frames per call", {protocol: _frames(completed(side)) for protocol, side in words.sides(metrics)})
    )
    return table


def frames_per_call(attempts: list[Attempt]) -> dict[str, float]:
    """By command the mean over attempts of the frames that leave the ground station for one API call."""
    found: dict[str, list[float]] = {}
    for attempt in attempts:
        for command, frames in attempt.get("frames_per_call", {}).items():
            found.setdefault(command, []).append(frames)
    return {command: sum(means) / len(means) for command, means in found.items()}


def quotient(mavlink: float | None, mqttxt: float | None) -> float | None:
    """MAVLink / MQTT-XT; None where one is missing or there is nothing to divide by."""
    return mavlink / mqttxt if mavlink is not None and mqttxt else None


def _row(
    metrics: dict[str, Any],
    name: str,
    quantity: str,
    value: Callable[[Attempt], float | None],
    text: Callable[[float | None], str],
    made: float | None = None,
) -> Row:
    known = metrics.get("statistics", {}).get("metrics", {}).get(quantity, {})
    cells = {}
    for protocol, side in words.sides(metrics):
        points = [found for attempt in completed(side) if (found := value(attempt)) is not None]
        middle = median(points) if points else None
        more = _spread(points, known.get(protocol), text) if len(points) > 1 else ""
        cells[protocol] = Cell(text(middle), middle, tuple(points), more)
    both = {"mavlink", "mqttxt"} <= set(cells)
    ratio = quotient(cells["mavlink"].middle, cells["mqttxt"].middle) if both else None
    test = known.get("test")
    said = f"p {_probability(test['p'])}, effect {test['effect']:.2g}" if test else ""
    return Row(name, cells, made if made is not None and ratio is not None else ratio, said)


def _spread(points: list[float], known: dict[str, Any] | None, text: Callable[[float | None], str]) -> str:
    """'mean 36.5 s', and from six attempts on 'mean 36.5 s (36.1 s to 36.9 s)'."""
    bounds = known.get("interval") if known else None
    interval = f" ({text(bounds[0])} to {text(bounds[1])})" if bounds else ""
    return f"mean {text(mean(points))}{interval}"


def _probability(p: float) -> str:
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"


def _completion(side: dict[str, Any]) -> str:
    voids = f" ({len(side['void'])} void)" if side["void"] else ""
    return f"{len(completed(side))} of {len(side['attempts'])}{voids}"


def _per_second(attempt: Attempt, field: str) -> float | None:
    return attempt[field] / attempt["mission_s"] if attempt["mission_s"] else None


def _delay(attempt: Attempt) -> float | None:
    values = [value for of_command in attempt["delay_ms"].values() for value in of_command]
    return median(values) if values else None


def _pooled_loss(
    attempts: list[Attempt], share: Callable[[Attempt], float | None], of: Callable[[Attempt], int]
) -> Cell:
    """All completed attempts together: so many were lost of so many."""
    counted = [(found, of(attempt)) for attempt in attempts if (found := share(attempt)) is not None]
    sent = sum(n for _, n in counted)
    lost = sum(round(found * n) for found, n in counted)
    return Cell(words.loss(lost / sent if sent else None, sent))


def _frames(attempts: list[Attempt]) -> Cell:
    means = sorted(frames_per_call(attempts).values())
    if not means:
        return Cell(words.NOTHING)
    least, most = words.digits(means[0]), words.digits(means[-1])
    return Cell(least if least == most else f"{least} to {most}")
