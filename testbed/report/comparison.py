"""Both protocols beside each other: a row a metric, with medians of the completed attempts and their ratio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

from . import words

Attempt = dict[str, Any]


@dataclass(frozen=True)
class Cell:
    """One protocol's value: its text, the median where it is a quantity, and each completed attempt's own."""

    text: str
    middle: float | None = None
    points: tuple[float, ...] = ()


@dataclass(frozen=True)
class Row:
    """A metric by protocol; `ratio` is MAVLink / MQTT-XT, None where there is none to make."""

    name: str
    cells: dict[str, Cell]
    ratio: float | None = None

    @property
    def most(self) -> float:
        """The largest value in the row, the end of its scale."""
        return max([value for cell in self.cells.values() for value in cell.points], default=0.0)


def completed(side: dict[str, Any]) -> list[Attempt]:
    return [attempt for attempt in side["attempts"] if attempt["status"] == "completed"]


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
        _row(metrics, "packets", lambda a: a["packets"], words.thousands, made.get("packets")),
        _row(metrics, "packets per second", lambda a: _per_second(a, "packets"), words.digits),
        _row(metrics, "bytes", lambda a: a["size_bytes"], words.size, made.get("size")),
        _row(metrics, "bytes per second", lambda a: _per_second(a, "size_bytes"), words.size),
        _row(metrics, "mission time", lambda a: a["mission_s"], words.seconds, made.get("mission")),
    ]
    losses: list[tuple[str, Callable[[Attempt], float | None], Callable[[Attempt], int]]] = [
        ("commands lost", lambda a: a["message_loss"]["commands"], lambda a: a.get("commands_sent", 0)),
        ("states lost", lambda a: a["message_loss"]["states"], lambda a: a.get("states_sent", 0)),
        ("frames lost", lambda a: a["wire_loss"], lambda a: a["packets"]),
    ]
    for name, share, of in losses:
        cells = {protocol: _pooled_loss(completed(side), share, of) for protocol, side in words.sides(metrics)}
        table.append(Row(name, cells))
    table.append(_row(metrics, "delay of commands", _delay, words.milliseconds))
    table.append(
        Row("frames per call", {protocol: _frames(completed(side)) for protocol, side in words.sides(metrics)})
    )
    return table


def frames_per_call(attempts: list[Attempt]) -> dict[str, float]:
    """By command the mean over attempts of the frames that leave the ground station for one API call."""
    found: dict[str, list[float]] = {}
    for attempt in attempts:
        for command, mean in attempt.get("frames_per_call", {}).items():
            found.setdefault(command, []).append(mean)
    return {command: sum(means) / len(means) for command, means in found.items()}


def quotient(mavlink: float | None, mqttxt: float | None) -> float | None:
    """MAVLink / MQTT-XT; None where one is missing or there is nothing to divide by."""
    return mavlink / mqttxt if mavlink is not None and mqttxt else None


def _row(
    metrics: dict[str, Any],
    name: str,
    value: Callable[[Attempt], float | None],
    text: Callable[[float | None], str],
    made: float | None = None,
) -> Row:
    cells = {}
    for protocol, side in words.sides(metrics):
        points = [found for attempt in completed(side) if (found := value(attempt)) is not None]
        middle = median(points) if points else None
        cells[protocol] = Cell(text(middle), middle, tuple(points))
    both = {"mavlink", "mqttxt"} <= set(cells)
    ratio = quotient(cells["mavlink"].middle, cells["mqttxt"].middle) if both else None
    return Row(name, cells, made if made is not None and ratio is not None else ratio)


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
