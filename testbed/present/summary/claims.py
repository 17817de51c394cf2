"""The thesis's claims, and whether they hold in a cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...numbers import words
from ...numbers.quantities import COMMAND_BYTES, MESSAGES_LOST, MISSION, STATE_BYTES_PER_S, row
from ...numbers.quantity import Quantity
from ...plan.experiments import MESSAGES
from ..report import thesis
from .cells import Cell

READING = (
    "Bytes of commands (with their results, for the whole mission, of completed attempts) and of states (a second, of "
    "all attempts that count): MAVLink's over MQTT-XT's, each with its part of the acknowledgements; in the "
    "message set all bytes while a kind was on, as the thesis counts. Loss: of commands "
    "and states of all attempts that count, those of which no copy arrived. A dash: nothing to judge by."
)


@dataclass(frozen=True)
class JudgedClaim:
    """A claim in a cell: whether it holds (None: it cannot be judged), and the figure that decides it."""

    holds: bool | None
    figure: str = ""

    def __str__(self) -> str:
        return words.NOTHING if self.holds is None else f"{'yes' if self.holds else 'no'}: {self.figure}"


@dataclass(frozen=True)
class Claim:
    """A claim: its heading, and the function that judges a cell by it."""

    heading: str
    judge: Callable[[Cell], JudgedClaim]


def claims() -> tuple[Claim, ...]:
    """The claims in the thesis's abstract, with the figures from `thesis.yaml`."""
    printed = thesis.everything()["claims"]
    commands, states = printed["command_bytes_ratio"], printed["status_bytes_ratio"]
    shorter, loss = printed["mission_time_saving"], printed["loss_pct"]
    return (
        Claim(f"commands: {commands} times fewer bytes", lambda cell: _times(cell, COMMAND_BYTES, commands)),
        Claim(f"states: {states} times fewer bytes", lambda cell: _times(cell, STATE_BYTES_PER_S, states)),
        Claim(f"missions {words.share(shorter)} shorter", lambda cell: _shorter(cell, shorter)),
        Claim(f"MQTT-XT loses {loss['mqttxt']} % at most", lambda cell: _loses(cell, "mqttxt", most=loss["mqttxt"])),
        Claim(f"MAVLink loses {loss['mavlink']} %", lambda cell: _loses(cell, "mavlink", least=loss["mavlink"])),
    )


def _times(cell: Cell, quantity: Quantity, claimed: float) -> JudgedClaim:
    ratio = row(quantity, cell.sides).ratio
    return JudgedClaim(None) if ratio is None else JudgedClaim(ratio >= claimed, f"{words.ratio(ratio)}×")


def _shorter(cell: Cell, claimed: float) -> JudgedClaim:
    mission = row(MISSION, cell.sides).ratio
    if not mission or cell.experiment == MESSAGES:  # the message set is no mission
        return JudgedClaim(None)
    saved = 1 - 1 / mission
    said = f"{words.share(abs(saved))} {'shorter' if saved > 0 else 'longer'}"
    return JudgedClaim(saved >= claimed, said)


def _loses(cell: Cell, protocol: str, most: float | None = None, least: float | None = None) -> JudgedClaim:
    """Judge the messages lost over a protocol against percentages: at most, or at least."""
    found = MESSAGES_LOST.figure(cell.sides[protocol])
    if found.loss is None or found.value is None:
        return JudgedClaim(None)
    percent = 100 * found.value
    holds = (most is None or percent <= most) and (least is None or percent >= least)
    return JudgedClaim(holds, f"{words.percent(percent) if found.loss.lost else '0'} of {found.loss.known:,}")
