"""Each quantity of the registries is told by the same figure wherever it is told, for series that were recorded."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pytest
from rich.table import Table

from testbed.fly.results import Series, new_series, read_json
from testbed.numbers import kinds
from testbed.numbers.observed import Sides, observe
from testbed.numbers.quantities import (
    COMPARED,
    COMPLETED,
    COUNTED_BYTES_PER_S,
    DELAY,
    MISSION,
    PACKETS,
    QUANTITIES,
    SIZE,
    SPREAD,
    row,
)
from testbed.numbers.quantity import Quantity, QuantityFigure, Share
from testbed.numbers.statistics import significant
from testbed.plan.documents import ROOT
from testbed.present.report import compare, message_set, terminal
from testbed.present.report.message_terminal import delay_table, traffic_table
from testbed.present.summary.cells import SIDES, Cell
from testbed.present.summary.claims import claims
from testbed.present.summary.kinds import rows_of
from testbed.present.summary.numbers import TextPair, numbers_of
from tests.handmade.both_sides import make_series
from tests.handmade.pages import page_of

PAGE = ROOT / "docs" / "results.md"
RECORDED = "scenario-4/five-states-bundled-thesis"
"""Frames found sensors' links closed in it, and something was lost on either side."""
MESSAGES = "messages/thesis-thesis"
IN_A_ROW = {COMPLETED: "completed", MISSION: "mission", DELAY: "delay", COUNTED_BYTES_PER_S: "rate"}
CLAIMED = {"command_bytes": 0, "state_bytes_per_s": 1, "messages_lost": 3}
"""Which claims of the thesis are judged by a quantity; messages lost by this one and the next."""


@dataclass(frozen=True)
class Recorded:
    """A series that is kept in docs/findings, and everything that is made of it."""

    series: Series
    metrics: dict[str, Any]

    @cached_property
    def sides(self) -> Sides:
        return observe(self.metrics["protocols"])

    @cached_property
    def cell(self) -> Cell:
        metrics = self.metrics
        return Cell(metrics["experiment"], metrics["arm"], metrics["profile"], self.series, metrics)

    @cached_property
    def page(self) -> list[list[str]]:
        return page_of(self.series, self.metrics).rows

    @cached_property
    def compared(self) -> Mapping[tuple[str, str], compare.ComparedMetric]:
        one = compare.ComparedSeries("A", self.series, self.metrics, ())
        return {(row.name, row.protocol): row for row in compare.rows(one, one)}

    @cached_property
    def findings(self) -> list[list[str]]:
        """Rows of docs/results.md's tables of its experiment, with its arm in them."""
        tables = re.findall(rf"<!-- summary:\w+:{self.cell.experiment}[: ].*?<!-- /summary -->", PAGE.read_text(), re.S)
        rows = [[cell.strip() for cell in line.split("|")] for table in tables for line in table.splitlines()]
        return [row for row in rows if f"`{self.cell.arm}`" in row]


def recorded(name: str, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    (path,) = (ROOT / "docs" / "findings").glob(f"{name}/*/metrics.json")
    kept = read_json(path)
    series = new_series(tmp_path_factory.mktemp("recorded"), kept["experiment"], kept["arm"], kept["profile"])
    entries = [(p, one) for p, side in kept["protocols"].items() for one in side["attempts"]]
    made = make_series(series, *entries, **{name: kept[name] for name in ("experiment", "arm", "profile")})
    assert (made["statistics"], made["ratios"]) == (kept["statistics"], kept["ratios"])
    return Recorded(series, made)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(RECORDED, tmp_path_factory)


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(MESSAGES, tmp_path_factory)


def figures(quantity: Quantity, of: Recorded) -> dict[str, QuantityFigure]:
    return {protocol: quantity.figure(of.sides[protocol]) for protocol in SIDES}


def test_every_quantity_is_told_somewhere() -> None:
    told = {*COMPARED, *SPREAD, *IN_A_ROW} | {one for one in QUANTITIES if one.key in CLAIMED}
    assert told == set(QUANTITIES)
    assert len({one.key for one in QUANTITIES}) == len({one.name for one in QUANTITIES}) == len(QUANTITIES)


@pytest.mark.long
@pytest.mark.parametrize("quantity", COMPARED, ids=lambda one: one.key)
def test_terminal_page_and_comparison_tell_it_alike(quantity: Quantity, flown: Recorded) -> None:
    told = figures(quantity, flown)
    (on_terminal,) = [
        cells for cells in cells_of(terminal.comparison_table(flown.metrics)) if cells[0] == quantity.name
    ]
    assert on_terminal[1:3] == [told[protocol].text for protocol in SIDES]
    on_page = next(cells for cells in flown.page if cells and cells[0] == quantity.name)
    shown = [told[protocol].text + told[protocol].more for protocol in SIDES]
    assert [cell.replace("\xa0", " ") for cell in on_page[1:3]] == shown
    for protocol in SIDES:
        compared = flown.compared[quantity.name, protocol]
        assert compared.first.text == compared.second.text == told[protocol].text


@pytest.mark.parametrize("quantity", [PACKETS, SIZE, MISSION], ids=lambda one: one.key)
def test_the_mean_beside_the_thesiss_is_that_beside_the_median(quantity: Quantity, flown: Recorded) -> None:
    (beside,) = [cells for cells in cells_of(terminal.thesis_table(flown.metrics)) if cells[0] == quantity.name]
    means = [quantity.write(figure.mean) for figure in figures(quantity, flown).values()]
    assert [beside[1], beside[3]] == means
    for protocol, mean in zip(SIDES, means, strict=True):
        assert flown.compared[quantity.name, protocol].first.more == f"mean {mean}"


@pytest.mark.parametrize("quantity", SPREAD, ids=lambda one: one.key)
def test_metrics_json_tells_it_alike(quantity: Quantity, flown: Recorded) -> None:
    known = flown.metrics["statistics"]["metrics"][quantity.key]
    for protocol, figure in figures(quantity, flown).items():
        assert figure.mean is not None
        assert known[protocol]["mean"] == significant(figure.mean)
        assert [significant(value) for value in figure.points] == list(known[protocol]["points"].values())
        if isinstance(quantity, Share):
            assert figure.loss is not None
            pooled = flown.metrics["statistics"]["losses"][quantity.name.removesuffix(" lost")][protocol]
            assert (pooled["lost"], pooled["sent"]) == (figure.loss.lost, figure.loss.known)
        else:
            assert figure.value == pytest.approx(known[protocol]["median"])


@pytest.mark.parametrize(
    "quantity", [*IN_A_ROW, *(one for one in COMPARED if isinstance(one, Share))], ids=lambda one: one.key
)
def test_summary_and_findings_tell_it_alike(quantity: Quantity, flown: Recorded) -> None:
    pair = numbers_of(flown.cell).texts[IN_A_ROW.get(quantity, quantity.name)]
    told = [figure.brief for figure in figures(quantity, flown).values()]
    assert isinstance(pair, TextPair)
    assert [pair.mqttxt, pair.mavlink] == told
    assert any(" / ".join(told) in line for line in flown.findings)


@pytest.mark.parametrize("key", CLAIMED)
def test_claims_and_findings_judge_by_it(key: str, flown: Recorded) -> None:
    quantity = next(one for one in QUANTITIES if one.key == key)
    judged = [claim.judge(flown.cell) for claim in claims()]
    first = CLAIMED[key]
    if isinstance(quantity, Share):
        said = [one.text if one.value else one.counts for one in figures(quantity, flown).values()]
        assert [one.figure for one in judged[first : first + 2]] == said
    else:
        ratio = row(quantity, flown.sides).ratio
        assert ratio is not None
        assert judged[first].figure == f"{ratio:.{2 if ratio < 1.095 else 1}f}×"
        said = [judged[first].figure]
    assert any(text in cell for text in said for line in flown.findings for cell in line)


def test_every_attempts_row_is_the_same_on_terminal_and_page(flown: Recorded) -> None:
    on_terminal = [cells[2:] for cells in cells_of(terminal.attempts_table(flown.metrics))]
    on_page = [cells[1:8] for cells in flown.page if cells and re.match(r"(MQTT-XT|MAVLink) \d$", cells[0])]
    assert len(on_page) == 6
    assert on_terminal == on_page


@pytest.mark.long
@pytest.mark.parametrize("quantity", kinds.QUANTITIES, ids=lambda one: one.key)
@pytest.mark.parametrize("name", [*kinds.COMMANDS, *kinds.STATES])
def test_a_kind_of_message_is_told_alike(name: str, quantity: kinds.KindQuantity, messages: Recorded) -> None:
    sides = kinds.kinds_of(messages.sides)[name]
    told = [quantity.figure(sides[protocol]).text for protocol in SIDES]
    table = message_set.rows(messages.metrics)
    own = quantity in (kinds.OWN_PACKETS, kinds.OWN_SIZE)
    tables = traffic_table(messages.metrics, table), delay_table(messages.metrics, table)
    traffic, delays = (cells_of(one) for one in tables)
    at = next(number for number, cells in enumerate(traffic) if cells[0] == name) + own
    delay = next(cells for cells in delays if cells[0] == name)
    on_terminal = [delay[1], delay[5]] if quantity is kinds.DELAY else traffic[at][1:5]
    on_page = next(cells for cells in messages.page if cells and cells[0] == ("its own" if own else name))
    in_summary = next(cells for cells in rows_of(messages.cell) if cells[0] == name)
    assert set(told) <= set(on_terminal)
    assert own or set(told) <= set(on_page)
    assert any(isinstance(cell, TextPair) and [cell.mqttxt, cell.mavlink] == told for cell in in_summary)
    (line,) = [line for line in messages.findings if f"`{name}`" in line]
    assert " / ".join(told) in line
    if quantity in (kinds.OWN_SIZE, kinds.DELAY):
        assert [messages.compared[f"{name}: {quantity.name}", protocol].first.text for protocol in SIDES] == told


def cells_of(table: Table) -> list[list[str]]:
    """The texts of a table's rows."""
    return [list(map(str, cells)) for cells in zip(*(column.cells for column in table.columns), strict=True)]
