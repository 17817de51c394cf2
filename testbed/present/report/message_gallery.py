"""The figures of a message set's report, in the page's order."""

from __future__ import annotations

from ...numbers import words
from ...numbers.kinds import COMMANDS, STATES
from ...numbers.written import Metrics
from . import details, message_set
from .comparison import completed
from .figures.figure import Figure
from .figures.kind_delays import delays_of, kind_delays
from .figures.kind_ratios import PANELS, Ratio, kind_ratios
from .figures.kind_sizes import counts_of, kind_sizes
from .gallery import DetailData, of_links, of_traffic


def figures_of(
    metrics: Metrics, shown: details.Shown, seen: dict[str, DetailData], links: list[tuple[str, str, str]]
) -> dict[str, Figure]:
    """The figures by name; those for which these results have no data are left out."""
    done = {p: attempts for p, side in words.sides(metrics) if (attempts := completed(side))}
    order = (*COMMANDS, *STATES)
    made = [
        of_links(metrics, shown, links),
        kind_ratios(_ratios(metrics)),
        kind_delays(delays_of(done, order)),
        kind_sizes(counts_of(done, order)),
        *of_traffic(shown, seen),
    ]
    return {figure.name: figure for figure in made if figure is not None}


def _ratios(metrics: Metrics) -> dict[str, dict[str, Ratio]]:
    return {row.name: {what: _ratio(row, what) for what in PANELS} for row in message_set.rows(metrics)}


def _ratio(row: message_set.KindRow, what: str) -> Ratio:
    amounts = {how: row.amounts(how, what) for how in ("with_states", "alone")}
    return Ratio(
        with_states=row.ratio("with_states", what),
        alone=row.ratio("alone", what),
        thesis=row.printed_ratio(what),
        contradicted=row.computed and what == "bytes",
        amounts=amounts | {"thesis": row.printed.get(what, {})},
    )
