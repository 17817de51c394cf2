"""The clauses of docs/results.md that tell a figure, each made from the series of docs/findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any

from testbed.report import words
from testbed.report.comparison import completed
from testbed.summary.cells import SIDES, Cell
from testbed.summary.losses import loss
from testbed.summary.numbers import Pair, numbers_of

PX4 = "thesis"
"""The arm in which PX4 streams its onboard set and drones are asked one by one."""
FIVE, BUNDLED = "five-states", "five-states-bundled"


class Findings:
    """The cells by experiment, arm and profile, and what the tables have of them."""

    def __init__(self, cells: Sequence[Cell]) -> None:
        self._cells = {(cell.experiment, cell.arm, cell.profile): cell for cell in cells}

    def cell(self, arm: str, profile: str, experiment: str = "scenario-1") -> Cell:
        return self._cells[experiment, arm, profile]

    def both(self, arm: str, profile: str, column: str, experiment: str = "scenario-1") -> tuple[str, str]:
        """A column of MQTT-XT and of MAVLink."""
        pair = numbers_of(self.cell(arm, profile, experiment)).texts[column]
        assert isinstance(pair, Pair)
        return pair.mqttxt, pair.mavlink

    def one(self, arm: str, profile: str, column: str, experiment: str = "scenario-1") -> str:
        """A column with one figure for both, without its sign."""
        return str(numbers_of(self.cell(arm, profile, experiment)).texts[column]).removesuffix("×").removeprefix("−")

    def attempts(self, protocol: str, arm: str, profile: str, experiment: str = "scenario-1") -> list[dict[str, Any]]:
        """All that count, failed ones too."""
        side: dict[str, Any] = self.cell(arm, profile, experiment).metrics["protocols"][protocol]
        return list(side["attempts"])

    def purpose(self, protocol: str, arm: str, profile: str, name: str, unit: str) -> float:
        """The median of a purpose's packets or bytes over completed attempts, without what acknowledges them."""
        side = self.cell(arm, profile).metrics["protocols"][protocol]
        return median(one["purposes"][name][unit] for one in completed(side))


def said(found: Findings) -> Iterator[str]:
    yield (
        f"MAVLink sends {found.one(PX4, 'thesis', 'rates')} times the bytes a second of MQTT-XT where PX4 streams "
        f"its onboard set, and {found.one(FIVE, 'thesis', 'rates')} times where both sides carry"
    )
    yield f"With bundles MQTT-XT makes {found.one(BUNDLED, 'thesis', 'rates')} of the"
    yield from _commands(found)
    yield from _missions(found)
    yield from _losses(found)
    yield from _delays(found)
    yield from _targets(found)


def _commands(found: Findings) -> Iterator[str]:
    told = {
        (side, name): words.size(found.purpose(side, BUNDLED, "lte", name, "bytes"))
        for side in SIDES
        for name in ("command", "result")
    }
    frames = {side: f"{found.purpose(side, BUNDLED, 'lte', 'command', 'packets'):g} frames" for side in SIDES}
    yield f"{frames['mqttxt']} and {told['mqttxt', 'command']} a mission"
    yield f"against {frames['mavlink']} and {told['mavlink', 'command']}"
    yield f"{told['mqttxt', 'result']} against the {told['mavlink', 'result']} of MAVLink's acknowledgements"


def _missions(found: Findings) -> Iterator[str]:
    for number in (2, 3):
        ours, theirs = found.both(PX4, "thesis", "mission", f"scenario-{number}")
        shorter = found.one(PX4, "thesis", "change", f"scenario-{number}")
        yield f"scenario {number} takes {ours} instead of {theirs}, {shorter} less"
    for profile in ("lte", "lossy"):
        ours, theirs = found.both(PX4, profile, "mission")
        yield f"{ours} instead of {theirs} on `{profile}`"
    for profile in ("thesis", "lte"):
        yield " and ".join(found.both(FIVE, profile, "mission")) + f" on `{profile}`"
    yield " and ".join(found.both(PX4, "ideal", "mission")) + " on `ideal`"


def _losses(found: Findings) -> Iterator[str]:
    shares = [
        loss(found.attempts("mavlink", arm, "thesis", experiment), "states")
        for experiment, arm in (
            *(("scenario-1", arm) for arm in (PX4, "thesis-concurrent", "direct")),
            *((f"scenario-{number}", PX4) for number in (2, 3)),
        )
    ]
    least, *_, most = sorted((str(share) for share in shares), key=lambda text: float(text.split()[0]))
    yield f"{least.removesuffix(' %')} to {most} of MAVLink's states are lost"
    of_five = loss(found.attempts("mavlink", FIVE, "thesis"), "states")
    yield f"there MAVLink loses {of_five}, and completes every mission"
    lossy = loss(found.attempts("mavlink", PX4, "lossy"), "states")
    ours = loss(found.attempts("mqttxt", FIVE, "lossy"), "states")
    yield f"MAVLink loses {lossy} of its states"
    yield f"MQTT-XT {'none' if not ours.lost else ours.lost} of {ours.known:,}, topic by topic"


def _delays(found: Findings) -> Iterator[str]:
    ours, theirs = found.both(PX4, "lossy", "delay")
    yield f"A command takes {ours} to its drone there, MAVLink's {theirs.removesuffix(' ms')}"
    ours, theirs = found.both(PX4, "ideal", "delay")
    yield f"On `ideal` one is at its drone in {theirs}, MQTT-XT's in {ours}"
    ours, theirs = found.both(PX4, "lte", "delay")
    yield f"on `lte` {ours} against {theirs.removesuffix(' ms')}"


def _targets(found: Findings) -> Iterator[str]:
    times = {
        profile: [found.one(PX4, profile, column) for column in ("packets", "bytes")]
        for profile in ("ideal", "lte", "lossy")
    }
    ratios = ", ".join(f"{packets} and {size} on `{profile}`" for profile, (packets, size) in times.items())
    yield f"| {ratios}; {found.one(PX4, 'thesis', 'rates')} times the bytes a second on `thesis` |"
    bundled = ", ".join(
        f"{found.one(BUNDLED, profile, 'bytes')} on `{profile}`" for profile in ("thesis", "lte", "lossy")
    )
    yield f"| {bundled} |"
    second, third = (found.one(PX4, "thesis", "change", f"scenario-{number}") for number in (2, 3))
    yield f"| −{second} in scenario 2, −{third} in scenario 3; in scenario 1 MAVLink completed"
    concurrent = ("thesis-concurrent", FIVE, BUNDLED)
    yield "| " + ", ".join(f"{_ours_over_theirs(found, arm)} in `{arm}`" for arm in concurrent) + " |"
    commands = loss(found.attempts("mqttxt", PX4, "thesis"), "commands")
    states = (loss(found.attempts("mqttxt", arm, "thesis"), "states") for arm in (FIVE, BUNDLED))
    told = ", ".join(
        f"{one.lost} of {one.known:,} in `{arm}`" for arm, one in zip((FIVE, BUNDLED), states, strict=True)
    )
    yield f"| {commands.lost} of {commands.known}; {told} |"
    delays = ", ".join(f"{found.one(arm, 'lte', 'delay ratio')} in `{arm}`" for arm in (PX4, FIVE, BUNDLED))
    yield f"| {delays} |"
    alone, _ = found.both(PX4, "ideal", "mission")
    yield f"Scenario 1 takes {alone} of flight and holding"


def _ours_over_theirs(found: Findings, arm: str) -> str:
    """MQTT-XT's mission time on `lossy` over MAVLink's."""
    return f"{1 / found.cell(arm, 'lossy').metrics['ratios']['mission']:.2f}"
