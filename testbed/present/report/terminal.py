"""The summary on the terminal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...fly.results import Attempt, Series
from ...numbers import words
from ...numbers.attempt_entry import AttemptEntry
from ...numbers.observed import observe_attempt
from ...numbers.quantities import OF_ATTEMPT, of_attempt
from ...numbers.written import Metrics
from ...plan import wording
from . import comparison, details, factors, message_set, readings, sentences, thesis_rows
from .attempt_page import with_losses
from .message_terminal import print_kinds
from .tables import plain_table

MOST_STREAMS = 8
ROOM_FOR_BOTH = 105
"""The width of the terminal, in columns, from which both sides' links are in one table."""


def print_summary(series: Series, metrics: Metrics, console: Console) -> None:
    """Print the notes, the finding, and how it was flown; then both sides compared, every attempt, every link."""
    console.print()
    for note in sentences.notes(metrics):
        console.print(note, soft_wrap=True, markup=False)
    said = [sentences.finding(metrics), sentences.basis(metrics)]
    console.print(" ".join(line for line in said if line), soft_wrap=True, markup=False)
    for line in _flown(series, metrics):
        console.print(line, soft_wrap=True, markup=False)
    if message_set.is_message_set(metrics):
        print_kinds(metrics, console)
    else:
        console.print(comparison_table(metrics))
    for sentence in readings.said(metrics):
        console.print(sentence, soft_wrap=True, markup=False)
    if thesis_rows.rows(metrics):
        console.print(thesis_table(metrics))
    if any(len(side["attempts"]) + len(side["void"]) > 1 for side in metrics["protocols"].values()):
        console.print(attempts_table(metrics))
    shown = comparison.shown(metrics)
    measured = {p: with_losses(_attempt_of(series, p, one["attempt"]), one) for p, one in shown.items()}
    if details.measured_links(measured):
        console.print(measured_table(measured))
    for part in [shown] if console.width >= ROOM_FOR_BOTH else [{name: one} for name, one in shown.items()]:
        console.print(links_table(part))
    if "mavlink" in shown:
        _print_mavlink(shown["mavlink"], console)


def comparison_table(metrics: Metrics) -> Table:
    """A row per metric, a column per protocol, and the ratio of the two."""
    sides = [protocol for protocol, _ in words.sides(metrics)]
    table = plain_table(f"arm {metrics['arm']}, profile {metrics['profile']}", "")
    for protocol in sides:
        table.add_column(wording.name_of(protocol), justify="right")
    if len(sides) > 1:
        table.add_column("ratio", justify="right")
    for row in comparison.rows(metrics).values():
        cells = [row.cells[protocol].text for protocol in sides]
        ratio = f"{words.ratio(row.ratio)}×" if row.ratio is not None else words.NOTHING
        table.add_row(row.name, *cells, *([ratio] if len(sides) > 1 else []))
    return table


def thesis_table(metrics: Metrics) -> Table:
    """Means here and the thesis's, a row per metric; the caveats on the thesis's figures are on the page."""
    rows = thesis_rows.rows(metrics)
    table = plain_table("means here, and the thesis's (the report says what to know)", "")
    for protocol in rows[0].cells:
        table.add_column(wording.name_of(protocol), justify="right")
        table.add_column("thesis", justify="right")
    if rows[0].ratio is not None:
        table.add_column("ratio", justify="right")
        table.add_column("thesis", justify="right")
    for row in rows:
        pairs = [*row.cells.values(), *([row.ratio] if row.ratio is not None else [])]
        table.add_row(row.name, *(text for pair in pairs for text in (pair.here, pair.thesis)))
    return table


def measured_table(shown: details.Shown) -> Table:
    """Links by class and direction: configured figures, and the least and greatest measured, over both protocols."""
    table = plain_table("links as configured, and as measured", "link")
    for heading in ("delay", "measured", "rate", "measured", "loss", "measured"):
        table.add_column(heading, justify="right")
    kinds: dict[str, list[dict[str, details.LinkFigure]]] = {}
    for name, by in details.measured_links(shown):
        kind, _, way = name.split(":")
        kinds.setdefault(f"{kind} {way}", []).extend(by.values())
    for kind, links in kinds.items():
        cells = []
        for figure, text in _FIGURES:
            known = [link[figure] for link in links if figure in link]
            cells.append(_span([one.configured for one in known], text))
            cells.append(_span([one.measured for one in known], text))
        table.add_row(kind, *cells)
    return table


_FIGURES: tuple[tuple[str, Callable[[float], str]], ...] = (
    ("delay_ms", words.short_delay),
    ("rate_bps", words.bit_rate),
    ("loss", words.share),
)


def _span(values: list[float | None], text: Callable[[float], str]) -> str:
    """'40 ms', '39 ms to 41 ms'; a dash if unknown, or for an unlimited rate."""
    known = [value for value in values if value is not None]
    if not known:
        return words.NOTHING
    least, most = text(min(known)), text(max(known))
    return least if least == most else f"{least} to {most}"


def attempts_table(metrics: Metrics) -> Table:
    """A row per attempt; failed ones are included, void ones are listed without figures."""
    table = plain_table("attempts", "protocol", "attempt", "status")
    for quantity in OF_ATTEMPT:
        table.add_column(quantity.name, justify="right")
    for protocol, side in words.sides(metrics):
        name = wording.name_of(protocol)
        for attempt in side["attempts"]:
            cells = of_attempt(observe_attempt(attempt)).values()
            table.add_row(name, str(attempt["attempt"]), attempt["status"], *cells)
        for void in side["void"]:
            table.add_row(name, str(void["attempt"]), "void", *[words.NOTHING] * len(OF_ATTEMPT))
    return table


def links_table(shown: details.Shown) -> Table:
    """Packets and bytes up and down each link, for both sides."""
    numbers = ", ".join(f"{wording.name_of(protocol)} attempt {one['attempt']}" for protocol, one in shown.items())
    table = plain_table(f"links, up (towards the cloud) / down: {numbers}", "link")
    for protocol in shown:
        for heading in ("packets", "bytes", "lost"):
            table.add_column(f"{wording.name_of(protocol)}\n{heading}", justify="right")
    for name, by in details.links_of(shown):
        cells = []
        for up, down in by.values():
            cells.append(f"{words.thousands(up['packets'])} / {words.thousands(down['packets'])}")
            cells.append(f"{words.size(up['bytes'])} / {words.size(down['bytes'])}")
            cells.append(words.thousands(up["lost"] + down["lost"]))
        table.add_row(name, *cells)
    return table


def mix_table(mix: details.Mix) -> Table:
    """The drones' streams over MAVLink, largest first."""
    table = plain_table("what the drones send over MAVLink", "message")
    for heading in ("count", "Hz per drone", "bytes", "mean size", "share"):
        table.add_column(heading, justify="right")
    for stream in mix["streams"][:MOST_STREAMS]:
        table.add_row(
            stream["name"],
            words.thousands(stream["count"]),
            words.digits(stream["rate_hz"]),
            words.size(stream["bytes"]),
            f"{words.digits(stream['mean_size'])} B",
            words.percent(stream["percent"]),
        )
    rest = mix["streams"][MOST_STREAMS:]
    if rest:
        table.add_row(
            f"{len(rest)} other kinds",
            words.thousands(sum(stream["count"] for stream in rest)),
            words.digits(sum(stream["rate_hz"] for stream in rest)),
            words.size(sum(stream["bytes"] for stream in rest)),
            "",
            words.percent(sum(stream["percent"] for stream in rest)),
        )
    return table


def _print_mavlink(attempt: AttemptEntry, console: Console) -> None:
    mix = details.mix_of(attempt)
    if mix is not None and mix["streams"]:
        console.print(mix_table(mix))
    routers = details.routers_of(attempt)
    if routers:
        ways = [entry for _, by_way in routers for entry in by_way.values()]
        dropped = [f"{entry['node']} {entry['way']} {entry['dropped']:,}" for entry in ways if entry["dropped"]]
        said = f"dropped {', '.join(dropped)}" if dropped else "dropped none"
        console.print(f"routers {said} of {sum(entry['in'] for entry in ways):,} messages", soft_wrap=True)


def _attempt_of(series: Series, protocol: str, number: int) -> Attempt:
    """The flight that counts for a number: the last one, if void ones were flown again."""
    return [one for one in series.attempts() if (one.protocol, one.number) == (protocol, number)][-1]


def _flown(series: Series, metrics: Metrics) -> list[Text]:
    """A line per side on how it was flown; then what that means for the comparison."""
    configuration: dict[str, Any] = {}
    one_drone = message_set.is_message_set(metrics)
    for attempt in series.readable():
        configuration = {**attempt.manifest()["configuration"], **configuration}
    lines = []
    for protocol, _ in words.sides(metrics):
        flown = factors.factors_of(configuration, protocol, one_drone)
        if flown:
            lines.append(Text(f"{wording.name_of(protocol)}: {'; '.join(factor.words for factor in flown)}."))
    return lines + (
        [Text(said) for said in factors.fairness(configuration, one_drone)[:2]] if len(metrics["protocols"]) > 1 else []
    )
