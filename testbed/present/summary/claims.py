"""What the thesis claims, and whether it holds in a cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

from ...numbers import words
from ...plan.experiments import MESSAGES
from ..report import thesis
from ..report.comparison import completed, quotient
from . import losses
from .cells import Cell
from .kinds import kinds_in
from .numbers import rate_of

READING = (
    "Bytes of commands (with their results, for the whole mission, of completed attempts) and of states (a second, of "
    "all attempts that count): MAVLink's over MQTT-XT's, each with its part of the acknowledgements; in the "
    "message set all bytes while a kind was on, as the thesis counts. Loss: of commands "
    "and states of all attempts that count, those of which no copy arrived. A dash: nothing to judge by."
)


@dataclass(frozen=True)
class Judged:
    """A claim in a cell: whether it holds and the figure that says so; None where there is nothing to judge by."""

    holds: bool | None
    figure: str = ""

    def __str__(self) -> str:
        return words.NOTHING if self.holds is None else f"{'yes' if self.holds else 'no'}: {self.figure}"


@dataclass(frozen=True)
class Claim:
    """What is claimed, as a heading, and how a cell is judged by it."""

    heading: str
    judge: Callable[[Cell], Judged]


def claims() -> tuple[Claim, ...]:
    """The claims of the thesis's abstract, with its figures from `thesis.yaml`."""
    printed = thesis.everything()["claims"]
    commands, states = printed["command_bytes_ratio"], printed["status_bytes_ratio"]
    shorter, loss = printed["mission_time_saving"], printed["loss_pct"]
    return (
        Claim(f"commands: {commands} times fewer bytes", lambda cell: _times(_command_bytes(cell), commands)),
        Claim(f"states: {states} times fewer bytes", lambda cell: _times(_state_bytes(cell), states)),
        Claim(f"missions {words.share(shorter)} shorter", lambda cell: _shorter(cell, shorter)),
        Claim(f"MQTT-XT loses {loss['mqttxt']} % at most", lambda cell: _loses(cell, "mqttxt", most=loss["mqttxt"])),
        Claim(f"MAVLink loses {loss['mavlink']} %", lambda cell: _loses(cell, "mavlink", least=loss["mavlink"])),
    )


def purpose_bytes(attempt: dict[str, Any], *purposes: str) -> float:
    """Bytes for some purposes, with their part of what acknowledges: shared out by bytes."""
    told = {name: float(count["bytes"]) for name, count in attempt["purposes"].items()}
    acknowledging = told.pop("acknowledgement", 0.0)
    own, all_ = sum(told.get(name, 0.0) for name in purposes), sum(told.values())
    return own + (acknowledging * own / all_ if all_ else 0.0)


def _command_bytes(cell: Cell) -> float | None:
    found = {}
    for protocol, side in cell.metrics["protocols"].items():
        done = completed(side)
        kinds = kinds_in(done, "command")
        sums = [float(sum(kind["with_states"]["bytes"] for kind in one)) for one in kinds]
        sums = sums or [purpose_bytes(attempt, "command", "result") for attempt in done]
        found[protocol] = median(sums) if sums else None
    return quotient(found.get("mavlink"), found.get("mqttxt"))


def _state_bytes(cell: Cell) -> float | None:
    found = {}
    for protocol, side in cell.metrics["protocols"].items():
        found[protocol] = rate_of(cell, protocol, lambda attempt: purpose_bytes(attempt, "state"))
        kinds = [kind for one in kinds_in(side["attempts"], "state") for kind in one]
        seconds = sum(kind["seconds"] for kind in kinds)
        if seconds:
            found[protocol] = sum(kind["with_states"]["bytes"] for kind in kinds) / seconds
    return quotient(found.get("mavlink"), found.get("mqttxt"))


def _times(ratio: float | None, claimed: float) -> Judged:
    return Judged(None) if ratio is None else Judged(ratio >= claimed, f"{words.ratio(ratio)}×")


def _shorter(cell: Cell, claimed: float) -> Judged:
    mission = cell.metrics["ratios"].get("mission")
    if mission is None or cell.experiment == MESSAGES:  # which is no mission
        return Judged(None)
    saved = 1 - 1 / mission
    said = f"{words.share(abs(saved))} {'shorter' if saved > 0 else 'longer'}"
    return Judged(saved >= claimed, said)


def _loses(cell: Cell, protocol: str, most: float | None = None, least: float | None = None) -> Judged:
    """Against percents: at most, or at least."""
    attempts = cell.metrics["protocols"].get(protocol, {"attempts": []})["attempts"]
    found = losses.loss(attempts, "commands") + losses.loss(attempts, "states")
    if not found.known:
        return Judged(None)
    percent = 100 * found.lost / found.known
    holds = (most is None or percent <= most) and (least is None or percent >= least)
    return Judged(holds, f"{words.percent(percent) if found.lost else '0'} of {found.known:,}")
