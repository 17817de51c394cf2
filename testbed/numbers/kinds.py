"""The message set in numbers: each kind on each side, per message, over the side's completed attempts.

`QUANTITIES` is for a kind what `quantities` is for a mission: each has its name, its unit, and how it is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean

from . import words
from .observed import NOTHING_SENT, Amount, FrameSizes, Loss, ObservedKind, Sides
from .quantities import QuantityRow
from .quantity import QuantityFigure

COMMANDS = ("arm", "takeoff", "land", "offboard", "goto")
STATES = ("battery", "location", "groundspeed", "flight_mode", "heading")
_ANSWERS = ("result", "ack")
"""The names of both sides' answers: MQTT-XT's results, MAVLink's COMMAND_ACK."""


@dataclass(frozen=True)
class KindOnSide:
    """A kind on one side.

    `with_states` counts everything on the links meanwhile, `alone` only the kind's own messages. `delay_ms` is one way
    by the captures, `app_ms` from the call to its first word, both means. `failed` counts by reason the calls that
    failed and the values that did not arrive in time.
    """

    asked: int
    received: int
    failed: Mapping[str, int]
    with_states: Amount
    alone: Amount
    setpoints: Amount | None
    frame: FrameSizes | None
    answer: FrameSizes | None
    delay_ms: float | None
    app_ms: float | None
    loss: Loss
    frames_per_call: float | None

    @property
    def lost(self) -> QuantityFigure:
        """The share of messages of which no copy arrived."""
        return QuantityFigure.of_loss(self.loss)


@dataclass(frozen=True)
class KindQuantity:
    """A number of a kind on one side, per message: a mean over all messages of the attempts."""

    key: str
    name: str
    unit: str
    write: Callable[[float | None], str]
    of: Callable[[KindOnSide], float | None]

    def figure(self, side: KindOnSide) -> QuantityFigure:
        value = self.of(side)
        return QuantityFigure(self.write(value), value, {} if value is None else {1: value}, self.write)


PACKETS = KindQuantity("packets", "packets", "frames", words.digits, lambda side: side.with_states.packets)
SIZE = KindQuantity("bytes", "bytes", "B", words.size, lambda side: side.with_states.bytes)
OWN_PACKETS = KindQuantity("own_packets", "its own packets", "frames", words.digits, lambda side: side.alone.packets)
OWN_SIZE = KindQuantity("own_bytes", "its own bytes", "B", words.size, lambda side: side.alone.bytes)
DELAY = KindQuantity("delay_ms", "delay", "ms", words.milliseconds, lambda side: side.delay_ms)
QUANTITIES: tuple[KindQuantity, ...] = (PACKETS, SIZE, OWN_PACKETS, OWN_SIZE, DELAY)

_IN_BRIEF: tuple[KindQuantity, ...] = (OWN_SIZE, DELAY)


def kinds_of(sides: Sides) -> dict[str, dict[str, KindOnSide]]:
    """The sides by kind, commands before states; a side is left out if none of its completed attempts has the kind."""
    found: dict[str, dict[str, KindOnSide]] = {}
    for name in (*COMMANDS, *STATES):
        for protocol, side in sides.items():
            entries = [attempt.kinds[name] for attempt in side.completed if name in attempt.kinds]
            if entries:
                found.setdefault(name, {})[protocol] = side_of(entries)
    return found


def form_of(name: str) -> str:
    """`command` or `state`."""
    return "command" if name in COMMANDS else "state"


def means_of(kinds: Mapping[str, Mapping[str, KindOnSide]]) -> dict[str, tuple[tuple[str, ...], dict[str, KindOnSide]]]:
    """By form the mean command and the mean state, with the kinds that they are means of: those that all sides have."""
    found = {}
    for form in ("command", "state"):
        own = {name: sides for name, sides in kinds.items() if form_of(name) == form}
        protocols = {protocol for sides in own.values() for protocol in sides}
        whole = tuple(name for name, sides in own.items() if set(sides) == protocols)
        if len(whole) > 1:
            found[form] = whole, {p: _mean_side([own[name][p] for name in whole]) for p in own[whole[0]]}
    return found


def compared(sides: Sides) -> list[QuantityRow]:
    """The rows that compare two message sets: the mean command and state with all quantities, each kind in brief."""
    kinds = kinds_of(sides)
    wanted = [(f"mean {form}", of, QUANTITIES) for form, (_, of) in means_of(kinds).items()]
    wanted += [(name, of, _IN_BRIEF) for name, of in kinds.items()]
    return [
        QuantityRow(f"{name}: {quantity.name}", {protocol: quantity.figure(side) for protocol, side in of.items()})
        for name, of, quantities in wanted
        for quantity in quantities
    ]


def side_of(entries: Sequence[ObservedKind]) -> KindOnSide:
    """A kind on one side, from its entries in the attempts."""
    name = entries[0].name
    answers = [frame for answer in _ANSWERS if (frame := _frame(entries, f"{name} {answer}")) is not None]
    return KindOnSide(
        asked=sum(one.asked for one in entries),
        received=sum(one.received for one in entries),
        failed=_sum(one.reasons for one in entries),
        with_states=_amount(entries, [one.with_states for one in entries]),
        alone=_amount(entries, [one.alone for one in entries]),
        setpoints=_amount(entries, found) if (found := [one.setpoints for one in entries if one.setpoints]) else None,
        frame=_frame(entries, name),
        answer=answers[0] if answers else None,
        delay_ms=_mean(ms for one in entries for ms in one.delays_ms),
        app_ms=_mean(ms for one in entries for ms in one.app_ms),
        loss=sum((one.loss for one in entries), NOTHING_SENT),
        frames_per_call=_mean(one.frames_per_call for one in entries),
    )


def _mean_side(sides: Sequence[KindOnSide]) -> KindOnSide:
    """The mean message of several kinds: means of the figures per message, sums of the counts."""

    def amount(amounts: Sequence[Amount]) -> Amount:
        return Amount(mean(one.packets for one in amounts), mean(one.bytes for one in amounts))

    return KindOnSide(
        asked=sum(side.asked for side in sides),
        received=sum(side.received for side in sides),
        failed=_sum(side.failed for side in sides),
        with_states=amount([side.with_states for side in sides]),
        alone=amount([side.alone for side in sides]),
        setpoints=None,
        frame=None,
        answer=None,
        delay_ms=_mean(side.delay_ms for side in sides),
        app_ms=_mean(side.app_ms for side in sides),
        loss=sum((side.loss for side in sides), NOTHING_SENT),
        frames_per_call=_mean(side.frames_per_call for side in sides),
    )


def _sum(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for several in counts:
        for reason, count in several.items():
            found[reason] = found.get(reason, 0) + count
    return found


def _amount(entries: Sequence[ObservedKind], amounts: Sequence[Amount]) -> Amount:
    asked = sum(one.asked for one in entries)
    return Amount(sum(one.packets for one in amounts) / asked, sum(one.bytes for one in amounts) / asked)


def _frame(entries: Sequence[ObservedKind], message: str) -> FrameSizes | None:
    sizes = [one.frames[message] for one in entries if message in one.frames]
    if not sizes:
        return None
    acks = [(size.ack, size.count) for size in sizes if size.ack is not None]
    count = sum(size.count for size in sizes)
    return FrameSizes(
        count,
        mean=sum(size.mean * size.count for size in sizes) / count,
        least=min(size.least for size in sizes),
        most=max(size.most for size in sizes),
        ack=sum(ack * count for ack, count in acks) / sum(count for _, count in acks) if acks else None,
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return mean(known) if known else None
