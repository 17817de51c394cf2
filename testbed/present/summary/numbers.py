"""A cell's numbers: its series in one row."""

from __future__ import annotations

from dataclasses import dataclass

from ...numbers import words
from ...numbers.quantities import COMPLETED, COUNTED_BYTES_PER_S, DELAY, MISSION, PACKETS, SIZE, row
from ...numbers.quantity import Quantity
from ...plan import wording
from ..report import comparison
from ..report.compare import change
from . import losses
from .cells import SIDES, Cell

NOT_FLOWN = "not flown"
COLUMNS = {
    "completed": "completed",
    "packets": "packets",
    "bytes": "bytes",
    "rate": "bytes a second",
    "rates": "×",
    "mission": "mission time",
    "change": "change",
    **{quantity.name: quantity.name for quantity in losses.QUANTITIES},
    "delay": "command delay",
    "delay ratio": "its ratio",
}
"""The columns of a cell's row, with their headings; where a column has both sides, MQTT-XT is first."""
READING = (
    "In each column MQTT-XT comes first, then MAVLink; an arm without a row was not flown. Packets and bytes: how many "
    "times those of MQTT-XT MAVLink "
    "needed for the mission, made only where both sides completed an attempt, as is the change of the mission time "
    "(MQTT-XT's against MAVLink's). Bytes a second are over every attempt that counts, so that a failed one, which "
    "ends early, can be compared too; × is MAVLink's over MQTT-XT's. Medians of the attempts; losses are of all "
    f"completed attempts together, with {losses.FAILED} of failed ones until they gave up, and where nothing was lost "
    "the 95 % bound is beside it, as if each message were lost by itself, not several at once. Command delay: from "
    "the ground station to the drone, by capture; its ratio is MQTT-XT's over MAVLink's."
)


@dataclass(frozen=True)
class TextPair:
    """The texts of both sides in a column."""

    mqttxt: str
    mavlink: str

    def __str__(self) -> str:
        return f"{self.mqttxt} / {self.mavlink}"


@dataclass(frozen=True)
class NumbersRow:
    """A row: its arm, the text of each column, and the cell, None if it was not flown.

    `packets`, `bytes`, `rate` (bytes per second) and `mission` are ratios of MAVLink's to MQTT-XT's, None if there is
    none.
    """

    arm: str
    texts: dict[str, str | TextPair]
    cell: Cell | None = None
    packets: float | None = None
    bytes: float | None = None
    rate: float | None = None
    mission: float | None = None


def not_flown(arm: str) -> NumbersRow:
    """The row of a cell without a finished series."""
    return NumbersRow(arm, {name: NOT_FLOWN if name == "completed" else "" for name in COLUMNS})


def numbers_of(cell: Cell) -> NumbersRow:
    """The row of a cell."""
    packets, size, mission, delay, rate = (
        row(quantity, cell.sides).ratio for quantity in (PACKETS, SIZE, MISSION, DELAY, COUNTED_BYTES_PER_S)
    )
    texts: dict[str, str | TextPair] = {
        "completed": completed_of(cell),
        "packets": _times(packets),
        "bytes": _times(size),
        "rate": _both(cell, COUNTED_BYTES_PER_S),
        "rates": _times(rate),
        "mission": _both(cell, MISSION),
        "change": change(1 / mission) if mission else words.NOTHING,
        **{quantity.name: TextPair(*losses.both_sides(cell, quantity)) for quantity in losses.QUANTITIES},
        "delay": _both(cell, DELAY),
        "delay ratio": words.digits(1 / delay) if delay else words.NOTHING,
    }
    return NumbersRow(cell.arm, texts, cell, packets, size, rate, mission)


def attempts_of(cell: Cell, protocol: str) -> str:
    """The completed attempts of a side, of how many that count, and the void ones: '2 of 3 (1 void)'."""
    return COMPLETED.figure(cell.sides[protocol]).text if protocol in cell.metrics["protocols"] else NOT_FLOWN


def completed_of(cell: Cell) -> TextPair:
    """As `attempts_of`, for both sides."""
    return TextPair(*(attempts_of(cell, protocol) for protocol in SIDES))


def troubles(cell: Cell) -> list[str]:
    """A line for each reason why attempts failed, and for each reason of void ones without a repeat that counts."""
    said = []
    for protocol, done in comparison.completion(cell.metrics).items():
        name = wording.name_of(protocol)
        for reason, attempts in done.failed:
            said.append(f"{name}, {_numbered(attempts)} failed: {reason}")
        counted = {attempt["attempt"] for attempt in cell.metrics["protocols"][protocol]["attempts"]}
        for reason, attempts in done.void:
            left = tuple(number for number in dict.fromkeys(attempts) if number not in counted)
            if left:
                said.append(f"{name}, {_numbered(left)} void: {reason}")
    return said


def _both(cell: Cell, quantity: Quantity) -> TextPair:
    return TextPair(*(quantity.figure(cell.sides[protocol]).text for protocol in SIDES))


def _times(ratio: float | None) -> str:
    return words.NOTHING if ratio is None else f"{words.ratio(ratio)}×"


def _numbered(attempts: tuple[int, ...]) -> str:
    plural = "attempt" if len(attempts) == 1 else "attempts"
    return f"{plural} {wording.listed([str(number) for number in attempts])}"
