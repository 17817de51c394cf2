"""The message set's tables on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from ...numbers import words
from ...numbers.written import Metrics
from ...plan import wording
from . import message_sentences
from .message_set import KindRow, rows, totals
from .tables import plain_table


def print_kinds(metrics: Metrics, console: Console) -> None:
    """Print the traffic, delay and loss of each kind, then failed calls and late values."""
    table = rows(metrics)
    if not table:
        return
    console.print(traffic_table(metrics, [*table, *totals(metrics)]))
    console.print(delay_table(metrics, table))
    for said in message_sentences.shortfalls(metrics):
        console.print(said, soft_wrap=True, markup=False)


def traffic_table(metrics: Metrics, table: list[KindRow]) -> Table:
    """Frames and bytes per message, all and then its own alone, and the thesis's packet ratio."""
    protocols = [protocol for protocol, _ in words.sides(metrics)]
    made = _table("for one message: all frames on the links meanwhile, and its own alone")
    for protocol in protocols:
        for heading in ("packets", "bytes"):
            made.add_column(f"{wording.name_of(protocol)}\n{heading}", justify="right")
    if len(protocols) > 1:
        for heading in ("ratio\npackets", "\nbytes", "thesis\npackets"):
            made.add_column(heading, justify="right")
    for row in table:
        for how, name in (("with_states", row.name), ("alone", "  its own")):
            cells = []
            for protocol in protocols:
                amount = getattr(row.sides[protocol], how) if protocol in row.sides else None
                cells.append(words.digits(amount.packets if amount else None))
                cells.append(words.size(amount.bytes if amount else None))
            if len(protocols) > 1:
                cells += [_times(row.ratio(how, what)) for what in ("packets", "bytes")]
                cells.append(_times(row.printed_ratio("packets")) if how == "with_states" else "")
            made.add_row(name, *cells)
    return made


def delay_table(metrics: Metrics, table: list[KindRow]) -> Table:
    """The mean delay per message and how many were lost, with the thesis's figures."""
    protocols = [protocol for protocol, _ in words.sides(metrics)]
    made = _table("one message: one-way delay (mean) and loss, and the thesis's")
    for protocol in protocols:
        for heading in ("delay", "thesis", "lost", "thesis"):
            above = wording.name_of(protocol) if heading == "delay" else ""
            made.add_column(f"{above}\n{heading}", justify="right", no_wrap=True)
    for row in table:
        cells = []
        for protocol in protocols:
            side = row.sides.get(protocol)
            lost = f"{side.loss.lost:,}/{side.loss.known:,}" if side else words.NOTHING
            cells += [words.milliseconds(side.delay_ms if side else None)]
            cells += [words.milliseconds(row.printed["delay_ms"][protocol]), lost]
            cells += [words.share(row.printed["loss"][protocol])]
        made.add_row(row.name, *cells)
    return made


def _times(ratio: float | None) -> str:
    return words.NOTHING if ratio is None else f"{words.ratio(ratio)}×"


def _table(title: str) -> Table:
    made = plain_table(title)
    made.add_column("", no_wrap=True)
    return made
