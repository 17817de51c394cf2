"""A cell of the message set, kind by kind: traffic in all and of its own, delay and loss."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ...numbers import words
from ...numbers.kinds import DELAY, OWN_PACKETS, OWN_SIZE, PACKETS, SIZE, KindOnSide, KindQuantity, kinds_of
from ...numbers.quantity import quotient
from .cells import SIDES, Cell
from .numbers import TextPair

HEADINGS = (
    *("kind", "arm", "received", "packets, all", "×", "bytes, all", "×", "packets, alone", "×", "bytes, alone", "×"),
    *("delay", "lost"),
)
READING = (
    "MQTT-XT comes first, then MAVLink; × is MAVLink's over MQTT-XT's. Received: calls whose acknowledgement came, or "
    "values that came in time, of those asked for. Packets and bytes are for one message, means of the completed "
    "attempts. All: every frame that entered any link while the kind was on, a command until its first word, as the "
    "thesis counts; alone: of those the kind's own messages, their answers and what acknowledges them. So neither "
    "MQTT-XT's words after the first one count nor what MAVSDK's repetitions put on the links after it. Delay: one way "
    "by capture, a mean; lost: messages of which no copy arrived."
)


def rows_of(cell: Cell) -> list[list[str | TextPair]]:
    """A row for each kind: commands, then states; empty if the cell is no message set."""
    return [_row(cell, name, sides) for name, sides in kinds_of(cell.sides).items()]


def _row(cell: Cell, name: str, sides: Mapping[str, KindOnSide]) -> list[str | TextPair]:
    row: list[str | TextPair] = [name, cell.arm, _pair(sides, lambda side: f"{side.received:,} of {side.asked:,}")]
    for quantity in (PACKETS, SIZE, OWN_PACKETS, OWN_SIZE):
        values = {protocol: quantity.of(side) for protocol, side in sides.items()}
        row += [_told(sides, quantity), words.ratio(quotient(values.get("mavlink"), values.get("mqttxt")))]
    return [*row, _told(sides, DELAY), _pair(sides, lambda side: side.lost.brief)]


def _told(sides: Mapping[str, KindOnSide], quantity: KindQuantity) -> TextPair:
    return _pair(sides, lambda side: quantity.figure(side).text)


def _pair(sides: Mapping[str, KindOnSide], text: Callable[[KindOnSide], str]) -> TextPair:
    return TextPair(*(text(sides[protocol]) if protocol in sides else words.NOTHING for protocol in SIDES))
