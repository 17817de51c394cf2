"""The message set in numbers for its tables: each kind on each side, for one message, means over attempts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from statistics import mean
from typing import Any

from ...numbers import words
from . import thesis
from .comparison import Cell, completed, quotient
from .comparison import Row as Compared

EXPERIMENT = thesis.MESSAGE_SET
COMMANDS = ("arm", "takeoff", "land", "offboard", "goto")
STATES = ("battery", "location", "groundspeed", "flight_mode", "heading")
_ANSWERS = ("result", "ack")
"""How the two sides' answers are named: MQTT-XT's results, MAVLink's COMMAND_ACK."""


@dataclass(frozen=True)
class Amount:
    """Frames and their bytes for one message of a kind."""

    packets: float
    bytes: float


@dataclass(frozen=True)
class Frame:
    """The frame that carries one message between two nodes, in bytes; `ack` is the mean cost of what acknowledges it
    on a link, None where nothing does."""

    mean: float
    least: int
    most: int
    ack: float | None

    @property
    def span(self) -> str:
        """'86 to 91', empty where all are the same."""
        return f"{self.least} to {self.most}" if self.least != self.most else ""


@dataclass(frozen=True)
class Side:
    """A kind on one side, over its completed attempts.

    `with_states` counts everything on the links meanwhile, `alone` its own messages; `delay_ms` is one way by capture,
    `app_ms` from the call to its first word, both means; `sent` and `lost` are messages, `known` those of them whose
    end the captures tell; `failed` are calls or values that were not what was asked, by reason.
    """

    asked: int
    received: int
    failed: dict[str, int]
    with_states: Amount
    alone: Amount
    setpoints: Amount | None
    frame: Frame | None
    answer: Frame | None
    delay_ms: float | None
    app_ms: float | None
    sent: int
    known: int
    lost: int
    frames_per_call: float | None

    @property
    def loss(self) -> str:
        return words.loss(self.lost / self.known if self.known else None, self.known)


@dataclass(frozen=True)
class Row:
    """A kind on all sides, and the thesis's figures of it by protocol, as `thesis.of_kind` has them.

    `printed_frame` are its bytes of a packet, `computed` whether its MQTT-XT bytes are no measurement.
    """

    name: str
    form: str
    sides: dict[str, Side]
    printed: dict[str, dict[str, float]]
    printed_frame: dict[str, int]
    computed: bool

    def amounts(self, how: str, what: str) -> dict[str, float]:
        """By protocol the `packets` or `bytes` for one message, counted `with_states` or `alone`."""
        return {p: getattr(getattr(side, how), what) for p, side in self.sides.items()}

    def ratio(self, how: str, what: str) -> float | None:
        """MAVLink / MQTT-XT of these amounts; None where there is none."""
        by = self.amounts(how, what)
        return quotient(by.get("mavlink"), by.get("mqttxt"))

    def printed_ratio(self, what: str) -> float | None:
        """The thesis's."""
        by = self.printed.get(what, {})
        return quotient(by.get("mavlink"), by.get("mqttxt"))


def is_message_set(metrics: dict[str, Any]) -> bool:
    return bool(metrics["experiment"] == EXPERIMENT)


def rows(metrics: dict[str, Any]) -> list[Row]:
    """A row for each kind of which a completed attempt has numbers: commands, then states."""
    entries = {p: _kinds(completed(side)) for p, side in words.sides(metrics)}
    table = []
    for form, names in (("command", COMMANDS), ("state", STATES)):
        for name in names:
            sides = {p: side_of(name, kinds[name]) for p, kinds in entries.items() if kinds.get(name)}
            if sides:
                printed = thesis.of_kind(name), thesis.packet_sizes().get(name, {}), thesis.bytes_were_computed(name)
                table.append(Row(name, form, sides, *printed))
    return table


def totals(table: list[Row]) -> list[Row]:
    """A row for one command and one for one state: means over the kinds of each form that all sides have."""
    found = []
    for form, label in (("command", "mean command"), ("state", "mean state")):
        kinds = [row for row in table if row.form == form]
        protocols = {p for row in kinds for p in row.sides}
        whole = [row for row in kinds if set(row.sides) == protocols]
        if len(whole) > 1:
            sides = {p: _mean_side([row.sides[p] for row in whole]) for p in kinds[0].sides}
            printed = {
                what: {p: mean(row.printed[what][p] for row in whole) for p in whole[0].printed[what]}
                for what in whole[0].printed
            }
            found.append(Row(label, form, sides, printed, {}, any(row.computed for row in whole)))
    return found


def to_compare(metrics: dict[str, Any]) -> list[Compared]:
    """The rows by which two message sets are compared: the mean command and state at length, each kind in brief."""
    table = rows(metrics)
    at_length: tuple[Quantity, ...] = (
        ("packets", lambda side: side.with_states.packets, words.digits),
        ("bytes", lambda side: side.with_states.bytes, words.size),
        ("its own packets", lambda side: side.alone.packets, words.digits),
        _OWN_BYTES,
        _DELAY,
    )
    wanted = [(row, at_length) for row in totals(table)] + [(row, (_OWN_BYTES, _DELAY)) for row in table]
    return [
        Compared(f"{row.name}: {what}", {p: _cell(value(side), text) for p, side in row.sides.items()})
        for row, quantities in wanted
        for what, value, text in quantities
    ]


def _cell(value: float | None, text: Callable[[float | None], str]) -> Cell:
    return Cell(text(value), value, () if value is None else (value,))


Quantity = tuple[str, Callable[[Side], float | None], Callable[[float | None], str]]
_DELAY: Quantity = ("delay", lambda side: side.delay_ms, words.milliseconds)
_OWN_BYTES: Quantity = ("its own bytes", lambda side: side.alone.bytes, words.size)


def side_of(name: str, entries: list[dict[str, Any]]) -> Side:
    """A kind on one side, from its entries in the attempts' `message_set`."""
    failed: dict[str, int] = {}
    for one in entries:
        for reason, count in one["reasons"].items():
            failed[reason] = failed.get(reason, 0) + count
    answers = [frame for answer in _ANSWERS if (frame := _frame(entries, f"{name} {answer}")) is not None]
    return Side(
        asked=sum(one["asked"] for one in entries),
        received=sum(one["received"] for one in entries),
        failed=failed,
        with_states=_amount(entries, lambda one: one["with_states"]),
        alone=_amount(entries, lambda one: one["alone"]),
        setpoints=_amount(entries, lambda one: one["setpoints"]) if entries[0]["setpoints"] is not None else None,
        frame=_frame(entries, name),
        answer=answers[0] if answers else None,
        delay_ms=_mean(ms for one in entries for ms in one["delay_ms"]),
        app_ms=_mean(ms for one in entries for ms in one["delay_app_ms"]),
        sent=sum(one["sent"] for one in entries),
        known=sum(one["sent"] - one["open"] for one in entries),
        lost=sum(one["lost"] for one in entries),
        frames_per_call=_mean(one["frames_per_call"] for one in entries),
    )


def _kinds(attempts: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """By kind its entry of each attempt that has it."""
    found: dict[str, list[dict[str, Any]]] = {}
    for attempt in attempts:
        for name, kind in (attempt.get("message_set") or {}).items():
            found.setdefault(name, []).append(kind)
    return found


def _amount(entries: list[dict[str, Any]], of: Callable[[dict[str, Any]], dict[str, int]]) -> Amount:
    asked = sum(one["asked"] for one in entries)
    return Amount(*(sum(of(one)[what] for one in entries) / asked for what in ("packets", "bytes")))


def _frame(entries: list[dict[str, Any]], message: str) -> Frame | None:
    sizes = [one["message_bytes"][message] for one in entries if message in one["message_bytes"]]
    if not sizes:
        return None
    acks = [(size["ack_bytes"], size["n"]) for size in sizes if size["ack_bytes"] is not None]
    return Frame(
        mean=sum(size["mean"] * size["n"] for size in sizes) / sum(size["n"] for size in sizes),
        least=min(size["min"] for size in sizes),
        most=max(size["max"] for size in sizes),
        ack=sum(ack * n for ack, n in acks) / sum(n for _, n in acks) if acks else None,
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return mean(known) if known else None


def _mean_side(sides: list[Side]) -> Side:
    """One message of several kinds: means of what is for one message, sums of what is counted."""

    def amount(of: Callable[[Side], Amount]) -> Amount:
        return Amount(mean(of(side).packets for side in sides), mean(of(side).bytes for side in sides))

    failed: dict[str, int] = {}
    for side in sides:
        for reason, count in side.failed.items():
            failed[reason] = failed.get(reason, 0) + count
    return Side(
        asked=sum(side.asked for side in sides),
        received=sum(side.received for side in sides),
        failed=failed,
        with_states=amount(lambda side: side.with_states),
        alone=amount(lambda side: side.alone),
        setpoints=None,
        frame=None,
        answer=None,
        delay_ms=_mean(side.delay_ms for side in sides),
        app_ms=_mean(side.app_ms for side in sides),
        sent=sum(side.sent for side in sides),
        known=sum(side.known for side in sides),
        lost=sum(side.lost for side in sides),
        frames_per_call=_mean(side.frames_per_call for side in sides),
    )
