"""The message set's page and tables: what they say of attempts made by hand, and beside the thesis."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest

from testbed.fly.results import Series, new_series, write_json
from testbed.numbers.metrics import measure_series
from testbed.present.report import compare, message_sentences, message_set, sentences, thesis
from testbed.present.report.compare import result_of
from testbed.present.report.compare_page import write_comparison
from testbed.present.report.figures.draw import NARROW, WIDE
from testbed.present.report.figures.kind_delays import GROUPS, MOST_DOTS, delays_of, kind_delays
from testbed.present.report.figures.kind_ratios import Ratio, kind_ratios
from testbed.present.report.html import write_report
from tests.handmade.attempts import write_lines
from tests.handmade.message_attempts import (
    COMMANDS,
    STATES,
    call_times,
    make_mavlink_messages,
    make_mqttxt_messages,
    message_events,
)
from tests.handmade.pages import Page, sketched_papers, terminal_of

Metrics = dict[str, Any]


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Series:
    made = new_series(tmp_path_factory.mktemp("messages"), "messages", "thesis", "ideal")
    make_mavlink_messages(made, silent=("takeoff",))
    make_mqttxt_messages(made)
    return made


@pytest.fixture(scope="module")
def metrics(series: Series) -> Metrics:
    return measure_series(series)


@pytest.fixture(scope="module")
def page(series: Series, metrics: Metrics) -> str:
    with sketched_papers():
        return write_report(series, metrics, papers=True).read_text()


@pytest.mark.long
def test_a_row_is_of_one_message(metrics: Metrics) -> None:
    land = next(row for row in message_set.rows(metrics) if row.name == "land")
    assert land.sides["mavlink"].with_states.packets == 9
    assert land.sides["mavlink"].alone.packets == 6
    assert land.sides["mqttxt"].alone.packets == 12
    assert land.ratio("alone", "packets") == 0.5
    assert land.ratio("with_states", "packets") == 0.75
    assert land.printed_ratio("packets") == pytest.approx(17742 / 5117)


def test_the_mean_command_is_the_mean_of_all_kinds_on_both_sides(metrics: Metrics) -> None:
    table = message_set.rows(metrics)
    command, state = message_set.totals(metrics)
    each = [row.sides["mqttxt"].alone.bytes for row in table if row.form == "command"]
    assert command.sides["mqttxt"].alone.bytes == pytest.approx(sum(each) / len(each))
    assert state.sides["mavlink"].lost.counts == "1 of 10"
    assert command.printed["packets"]["mavlink"] == pytest.approx((17100 + 24585 + 17742 + 27217 + 16524) / 500)


def test_the_finding_says_both_ways_of_counting_and_its_basis_what_was_lost(metrics: Metrics) -> None:
    said = sentences.finding(metrics)
    assert said.startswith("Over MAVLink, with all that went over the links meanwhile: a command ")
    assert "Of its own frames alone: a command 55 % of the packets and " in said  # (4 x 6 + 9) / (4 x 12 + 12.5)
    basis = str(sentences.basis(metrics))
    assert "States lost: 10 % of 10 over MQTT-XT, 10 % of 10 over MAVLink." in basis
    assert (
        "The thesis has 3.2 to 5.3 times the packets for commands and 16 to 23 times the packets for states." in basis
    )
    assert basis.endswith("2 of each kind, one drone, on links of profile ideal; one attempt each.")


def test_what_was_not_as_asked_is_said(metrics: Metrics) -> None:
    assert message_sentences.shortfalls(metrics) == [
        "MAVLink, takeoff: 1 of 2 calls were not acknowledged (1 no word about it)"
    ]


def test_one_side_alone_is_told_without_ratios(tmp_path: Path) -> None:
    alone = new_series(tmp_path, "messages", "thesis", "ideal")
    make_mqttxt_messages(alone)
    metrics = measure_series(alone)
    assert sentences.finding(metrics).startswith("Over MQTT-XT one drone on one fog flew the message set in ")
    assert all(row.ratio("alone", "packets") is None for row in message_set.rows(metrics))
    text = write_report(alone, metrics).read_text()
    assert "MAVLink / MQTT-XT" not in Page(text).sections["kinds"]
    terminal_of(alone, metrics)


def test_the_page_has_both_tables_with_the_thesis_beside_and_its_caveats(page: str) -> None:
    found = Page(page)
    rows = [[cell.strip() for cell in row] for row in found.rows]
    kinds = [row[0] for row in rows if len(row) > 1 and row[1] == "all frames"]
    assert kinds == [*COMMANDS, *STATES, "mean command", "mean state"]
    thesis_rows = [row for row in rows if row[0] == "thesis"]
    assert thesis_rows[0][1:5] == ["51.4", "3.49 kB", "719 ms", "0 %"]
    assert thesis_rows[0][5:] == ["171", "15.9 kB", "549 ms", "0 %", "3.3×", "4.5×"]
    assert len(thesis_rows) == len(kinds)
    frames = next(row for row in rows if row[0] == "arm" and "95" in row)
    assert frames[5:] == ["86", "86", "–", "64"]
    for said in thesis.caveats("messages"):
        assert said in found.sections["kinds"]
    assert "set-points apart" in found.sections["kinds"]
    assert "1 of 2 calls were not acknowledged" in found.sections["kinds"]


def test_the_page_is_whole_and_self_contained(series: Series, page: str) -> None:
    found = Page(page)
    assert not re.search(r"""(src|href)=["'](https?:)?//""", page)
    assert all((series.path / link).exists() for link in found.links if not link.startswith("#"))
    assert {link[1:] for link in found.links if link.startswith("#")} <= found.ids
    for name in ("ratio-by-kind", "delay-by-kind", "sizes-by-kind"):
        assert (series.path / "figures" / f"{name}.csv").exists()
        assert (series.path / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.long
def test_the_same_results_give_the_same_page(series: Series, metrics: Metrics, page: str) -> None:
    with sketched_papers():
        assert write_report(series, measure_series(series), papers=True).read_text() == page


def test_the_figures_data_have_what_was_lost_in_its_place(series: Series, page: str) -> None:
    rows = list(csv.DictReader((series.path / "figures" / "delay-by-kind.csv").open()))
    battery = [row["delay_ms"] for row in rows if (row["kind"], row["protocol"]) == ("battery", "mavlink")]
    assert battery == ["2.5", ""]
    assert "A cross on top is a message that never arrived;" in page
    sizes = csv.DictReader((series.path / "figures" / "sizes-by-kind.csv").open())
    land = {row["from_bytes"]: row["packets"] for row in sizes if (row["kind"], row["protocol"]) == ("land", "mavlink")}
    assert land == {"40": "6", "80": "12"}


@pytest.mark.parametrize("width", [NARROW, WIDE])
def test_many_messages_are_drawn_in_groups_and_stay_one_by_one_in_the_data(width: float) -> None:
    delays = [float(number % 7 + 1) if number % 10 else None for number in range(MOST_DOTS * 5)]
    attempt = {"attempt": 1, "message_set": {"location": {"delay_ms": delays}}}
    figure = kind_delays(delays_of({"mavlink": [attempt]}, ("location",)))
    assert figure is not None
    assert len(figure.rows) == len(delays)
    dots = [mark for mark in figure.draw(width).marks if type(mark).__name__ == "Dot"]
    assert len(dots) == GROUPS + 1  # and the legend's
    assert f"{MOST_DOTS} messages" in figure.note


def test_nothing_that_arrived_draws_nothing() -> None:
    assert kind_delays(delays_of({"mavlink": [{"attempt": 1, "message_set": None}]}, ("arm",))) is None
    assert kind_ratios({"arm": dict.fromkeys(("packets", "bytes"), Ratio(None, None, 3.0))}) is None


def test_the_terminal_fits_eighty_columns(series: Series, metrics: Metrics) -> None:
    shown = terminal_of(series, metrics, width=80)
    tables = shown[shown.index("for one message") : shown.index("MAVLink, takeoff: 1 of 2")]
    assert max(len(line.rstrip()) for line in tables.splitlines()) <= 80
    assert re.search(r"land +12\.0 +863 B +9\.00 +696 B +0\.75× +0\.81× +3\.5×", tables)
    assert re.search(r"battery +2\.50 ms +738 ms +0/2 +0 % +2\.50 ms +720 ms +1/2 +8 %", tables)


def test_how_the_one_drone_is_commanded_is_not_said(page: str) -> None:
    assert "commanded one after the other" not in page
    assert "broadcast a fog" not in page


def test_two_message_sets_are_compared_for_one_message(series: Series, metrics: Metrics, tmp_path: Path) -> None:
    slower = json.loads(json.dumps(metrics))
    for kind in slower["protocols"]["mavlink"]["attempts"][0]["message_set"].values():
        kind["delay_ms"] = [None if delay is None else 3 * delay for delay in kind["delay_ms"]]
    both = result_of("A", series, metrics), result_of("B", series, slower)
    changes = {(row.name, row.protocol): row.change for row in compare.rows(*both)}
    assert changes["mean command: delay", "mavlink"] == pytest.approx(3.0)
    assert changes["land: its own bytes", "mqttxt"] == 1.0
    assert "mean command: delay ×3.0" in " ".join(compare.sentences(*both))
    with sketched_papers():
        write_comparison(*both, tmp_path / "compare.html")
    assert "For one message, means of the completed attempts" in (tmp_path / "compare.html").read_text()


def test_a_message_set_that_broke_off_says_how_far_it_came(tmp_path: Path) -> None:
    broken = new_series(tmp_path, "messages", "thesis", "ideal")
    attempt = make_mqttxt_messages(broken)
    events = [event for event in message_events() if event["t_ns"] < call_times("land")[0]]
    write_lines(attempt.path / "events.jsonl", events)
    write_json(attempt.path / "manifest.json", attempt.manifest() | {"status": "failed", "reason": "arm: nothing came"})
    metrics = measure_series(broken)
    assert list(metrics["protocols"]["mqttxt"]["attempts"][0]["message_set"]) == ["arm", "takeoff", "land"]
    text = write_report(broken, metrics).read_text()
    assert "Done before: arm, takeoff. It ended in the step land." in text
    assert "kinds" not in Page(text).sections
    assert "Over MQTT-XT the only attempt failed (arm: nothing came)" in terminal_of(broken, metrics)
