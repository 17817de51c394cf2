"""The registry of quantities: the name and unit of each, how it is made from a side's attempts, how it is written.

Every figure in `metrics.json`, on the terminal, on a page or in a summary is made by its row here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from . import words
from .attempt_entry import LossEntry
from .observed import NOTHING_SENT, Loss, ObservedAttempt, Side, Sides
from .quantity import ABOVE, BELOW, ByCommand, Completed, Quantity, QuantityFigure, Share
from .statistics import loss_of, paired_test, significant
from .written import CompletionEntry, PairedTestEntry, SpreadEntry, Statistics


def share(key: str, name: str, count: Callable[[ObservedAttempt], Loss], *, counted: bool = False) -> Share:
    """A share; its value in an attempt is the share of `count`."""
    return Share(key, name, "share", words.share, lambda attempt: count(attempt).share, counted, count)


def per_second(amount: Callable[[ObservedAttempt], float]) -> Callable[[ObservedAttempt], float | None]:
    """An amount divided by the mission time; None if the mission was not completed."""
    return lambda attempt: amount(attempt) / attempt.mission_s if attempt.mission_s else None


def per_counted_second(amount: Callable[[ObservedAttempt], float]) -> Callable[[ObservedAttempt], float | None]:
    """An amount divided by the time in which it was counted; a failed attempt counts until it gave up."""
    return lambda attempt: amount(attempt) / attempt.window_s if attempt.window_s else None


def purpose_bytes(attempt: ObservedAttempt, *purposes: str) -> float:
    """Bytes for some purposes, with their part of the acknowledgements, which are shared out in proportion to bytes."""
    told = {name: float(count) for name, count in attempt.purposes.items()}
    acknowledging = told.pop("acknowledgement", 0.0)
    own, all_ = sum(told.get(name, 0.0) for name in purposes), sum(told.values())
    return own + (acknowledging * own / all_ if all_ else 0.0)


def _command_bytes(attempt: ObservedAttempt) -> float:
    """Bytes of commands and their results; in the message set all bytes while commands were measured."""
    kinds = [kind for kind in attempt.kinds.values() if kind.form == "command"]
    return sum(kind.with_states.bytes for kind in kinds) if kinds else purpose_bytes(attempt, "command", "result")


def _state_bytes_per_s(attempt: ObservedAttempt) -> float | None:
    """Bytes of states per second; in the message set all bytes while states were measured."""
    kinds = [kind for kind in attempt.kinds.values() if kind.form == "state"]
    seconds = sum(kind.seconds for kind in kinds)
    if seconds:
        return sum(kind.with_states.bytes for kind in kinds) / seconds
    return per_counted_second(lambda one: purpose_bytes(one, "state"))(attempt)


def _middle(values: Sequence[float]) -> float | None:
    return median(values) if values else None


def _total(by_container: Mapping[str, float]) -> float | None:
    return sum(by_container.values()) if by_container else None


COMPLETED = Completed("completed", "completed", "attempts", words.thousands, lambda _: None)
PACKETS = Quantity("packets", "packets", "frames", words.thousands, lambda one: one.packets)
PACKETS_PER_S = Quantity(
    "packets_per_s", "packets per second", "frames/s", words.digits, per_second(lambda one: one.packets)
)
SIZE = Quantity("size_bytes", "bytes", "B", words.size, lambda one: one.size_bytes)
BYTES_PER_S = Quantity("bytes_per_s", "bytes per second", "B/s", words.size, per_second(lambda one: one.size_bytes))
MISSION = Quantity("mission_s", "mission time", "s", words.seconds, lambda one: one.mission_s)
COMMANDS_LOST = share("commands_lost", "commands lost", lambda one: one.commands)
STATES_LOST = share("states_lost", "states lost", lambda one: one.states)
FRAMES_LOST = share("wire_loss", "frames lost", lambda one: one.frames)
DELAY = Quantity("delay_ms", "delay of commands", "ms", words.milliseconds, lambda one: _middle(one.delays_ms))
"""An attempt's value is the median over its commands and drones."""
LONGEST_STATE = Quantity(
    "longest_state_ms", "longest delay of a state", "ms", words.milliseconds, lambda one: one.longest_state_ms
)
"""From leaving the drone to reaching the ground station, by the captures."""
DOUBLED = Quantity(
    "doubled", "commands received again", "commands", words.thousands, lambda one: one.doubled, counted=True
)
LATE = Quantity(
    "late", "commands received after their last word", "commands", words.thousands, lambda one: one.late, counted=True
)
SUCCESS = Quantity(
    "success", "completed attempts", "share", words.share, lambda one: float(one.completed), counted=True
)
FRAMES_PER_CALL = ByCommand(
    "frames_per_call", "frames per call", "frames", words.digits, lambda _: None, values=lambda one: one.frames_per_call
)
RETRANSMITTED = Quantity("retransmissions", "frames sent again", "frames", words.thousands, lambda a: a.retransmitted)
CPU = Quantity("cpu_s", "CPU of all containers", "s", words.seconds, lambda one: _total(one.cpu_s))
MEMORY = Quantity("memory_bytes", "memory of all containers", "B", words.size, lambda one: _total(one.memory_bytes))
COMMAND_BYTES = Quantity("command_bytes", "bytes for commands", "B", words.size, _command_bytes)
STATE_BYTES_PER_S = Quantity(
    "state_bytes_per_s", "bytes for states per second", "B/s", words.size, _state_bytes_per_s, counted=True
)
COUNTED_BYTES_PER_S = Quantity(
    "counted_bytes_per_s",
    "bytes per second, failed attempts too",
    "B/s",
    words.size,
    per_counted_second(lambda one: one.size_bytes),
    counted=True,
)
MESSAGES_LOST = share("messages_lost", "commands and states lost", lambda one: one.commands + one.states, counted=True)

COMPARED: tuple[Quantity, ...] = (
    *(COMPLETED, PACKETS, PACKETS_PER_S, SIZE, BYTES_PER_S, MISSION, COMMANDS_LOST, STATES_LOST, FRAMES_LOST, DELAY),
    FRAMES_PER_CALL,
)
"""The rows that compare both protocols, or two results."""
QUANTITIES: tuple[Quantity, ...] = (
    *COMPARED,
    *(RETRANSMITTED, CPU, MEMORY, COMMAND_BYTES, STATE_BYTES_PER_S, COUNTED_BYTES_PER_S, MESSAGES_LOST),
)
OF_ATTEMPT = (MISSION, PACKETS, SIZE, COMMANDS_LOST, STATES_LOST, FRAMES_LOST)
"""The quantities in an attempt's row."""
SPREAD = (
    *(MISSION, PACKETS, SIZE, PACKETS_PER_S, BYTES_PER_S, COMMANDS_LOST, STATES_LOST, FRAMES_LOST, DELAY),
    *(RETRANSMITTED, CPU, MEMORY),
)
"""The quantities whose points `metrics.json` has, one per completed attempt."""
RATIOS = {"packets": PACKETS, "size": SIZE, "mission": MISSION}
"""The ratios in `metrics.json`, by their names there."""
_LOSSES = {"commands": COMMANDS_LOST, "states": STATES_LOST, "frames": FRAMES_LOST}


@dataclass(frozen=True)
class QuantityRow:
    """A quantity by protocol; `ratio` is MAVLink's figure over MQTT-XT's, None where there is none.

    `test` is the result of the paired permutation test, from six attempts on.
    """

    name: str
    cells: Mapping[str, QuantityFigure]
    ratio: float | None = None
    test: str = ""

    @property
    def most(self) -> float:
        """The largest value in the row, the end of its scale; 0 without values."""
        scaled = [cell.points for cell in self.cells.values() if cell.loss is None]
        return max((value for points in scaled for value in points), default=0.0)


def row(quantity: Quantity, sides: Sides) -> QuantityRow:
    """A quantity's row of both sides."""
    cells = {protocol: quantity.figure(side) for protocol, side in sides.items()}
    test = None if isinstance(quantity, Share) else _test(cells)
    said = f"p {_probability(test['p'])}, effect {test['effect']:.2g}" if test else ""
    return QuantityRow(quantity.name, cells, quantity.ratio(cells), said)


def rows(sides: Sides) -> dict[str, QuantityRow]:
    """The row of every compared quantity, by its key."""
    return {quantity.key: row(quantity, sides) for quantity in COMPARED}


def of_attempt(attempt: ObservedAttempt) -> dict[str, str]:
    """The texts of an attempt's row by key, whether completed or failed; a share as two counts."""
    return {
        one.key: one.together([attempt]).counts if isinstance(one, Share) else one.write(one.of(attempt))
        for one in OF_ATTEMPT
    }


def ratios(sides: Sides) -> dict[str, float]:
    """The ratios for `metrics.json`; none where a side has no completed attempt."""
    made = {name: row(quantity, sides).ratio for name, quantity in RATIOS.items()}
    return {name: round(ratio, 4) for name, ratio in made.items() if ratio is not None}


def statistics(sides: Sides) -> Statistics:
    """The statistics for `metrics.json`: completion, each quantity over attempts, losses over all attempts together."""
    return {
        "completion": {name: _completion(side) for name, side in sides.items()},
        "metrics": {quantity.key: _spread(quantity, sides) for quantity in SPREAD},
        "losses": {what: {p: _pooled(one, side) for p, side in sides.items()} for what, one in _LOSSES.items()},
    }


def _completion(side: Side) -> CompletionEntry:
    done, flown = len(side.completed), len(side.attempts)
    return {"flown": flown, "completed": done, "failed": flown - done, "void": side.void}


def _spread(quantity: Quantity, sides: Sides) -> dict[str, SpreadEntry | PairedTestEntry | None]:
    found: dict[str, SpreadEntry | PairedTestEntry | None] = {}
    figures = {protocol: QuantityFigure("", None, quantity.points(side)) for protocol, side in sides.items()}
    for protocol, one in figures.items():
        found[protocol] = {
            "n": len(one.points),
            "mean": significant(one.mean) if one.mean is not None else None,
            "median": significant(median(one.points)) if one.points else None,
            "interval": list(one.interval) if one.interval is not None else None,
            "points": {str(number): significant(value) for number, value in one.by_attempt.items()},
        }
    return {**found, "test": _test(figures)}


def _test(figures: Mapping[str, QuantityFigure]) -> PairedTestEntry | None:
    """The paired test over the attempts that both sides have."""
    above, below = (figures[name].by_attempt if name in figures else {} for name in (ABOVE, BELOW))
    return paired_test([above[number] - below[number] for number in sorted(set(above) & set(below))])


def _pooled(quantity: Share, side: Side) -> LossEntry:
    loss = quantity.figure(side).loss or NOTHING_SENT
    return loss_of(loss.known + loss.open, loss.lost, loss.open)


def _probability(p: float) -> str:
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"
