"""All experiments, arms and profiles beside each other: which series counts, its numbers, the thesis's claims."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.commands import app
from testbed.errors import UserError
from testbed.fly.results import METRICS, write_json
from testbed.plan.experiments import ARMS
from testbed.present.summary import claims
from testbed.present.summary.cells import Cell, find_cells
from testbed.present.summary.markdown import fill
from testbed.present.summary.numbers import numbers_of, troubles
from testbed.present.summary.overview import overviews
from testbed.present.summary.page import finding, write_summary
from tests.handmade.finished import attempt, both, finished, gave_up, message_set
from tests.handmade.pages import sketched_papers


@pytest.fixture(autouse=True)
def _papers() -> Iterator[None]:
    with sketched_papers():
        yield


MARKED = "Before.\n\n<!-- summary:{name} -->\nold\n<!-- /summary -->\n\nAfter.\n"


def only_cell(root: Path) -> Cell:
    (cell,) = find_cells([root]).cells
    return cell


def filled(root: Path, name: str = "numbers:scenario-1") -> str:
    document = root / "document.md"
    document.write_text(MARKED.format(name=name))
    fill(document, find_cells([root]).cells)
    return document.read_text()


def judged(cell: Cell) -> dict[str, str]:
    return {claim.heading: str(claim.judge(cell)) for claim in claims.claims()}


def test_the_newest_finished_series_of_a_cell_counts(tmp_path: Path) -> None:
    finished(tmp_path, *both(), name="20260101T000000Z")
    newest = finished(tmp_path, *both(), name="20260102T000000Z")
    unfinished = newest.path.with_name("20260103T000000Z")
    (unfinished / "mqttxt" / "attempt-01").mkdir(parents=True)
    assert only_cell(tmp_path).name == "scenario-1/thesis-ideal/20260102T000000Z"


def test_a_mission_without_a_length_is_not_judged(tmp_path: Path) -> None:
    finished(tmp_path, [attempt("mqttxt")], [attempt("mavlink", mission_s=0.0)])
    assert {said for heading, said in judged(only_cell(tmp_path)).items() if heading.startswith("missions")} == {"–"}


def test_a_series_of_both_counts_before_a_newer_one_of_one_side(tmp_path: Path) -> None:
    finished(tmp_path, *both(), name="20260101T000000Z")
    finished(tmp_path, [attempt("mqttxt")], [], name="20260102T000000Z")
    assert only_cell(tmp_path).series.path.name == "20260101T000000Z"


def test_several_results_folders_are_one_table(tmp_path: Path) -> None:
    finished(tmp_path / "a", *both(), name="20260102T000000Z")
    finished(tmp_path / "b", *both(), name="20260101T000000Z")
    finished(tmp_path / "b", *both(), profile="lte")
    found = find_cells([tmp_path / "a", tmp_path / "b"]).cells
    assert [(cell.profile, cell.series.path.name) for cell in found] == [
        ("ideal", "20260102T000000Z"),
        ("lte", "20260101T000000Z"),
    ]


def test_metrics_of_another_version_are_named_and_an_older_series_counts(tmp_path: Path) -> None:
    finished(tmp_path, *both(), name="20260101T000000Z")
    newer = finished(tmp_path, *both(), name="20260102T000000Z")
    write_json(newer.path / METRICS, {"version": 0})
    found = find_cells([tmp_path])
    assert [cell.series.path.name for cell in found.cells] == ["20260101T000000Z"]
    assert len(found.unread) == 1
    assert f"type: testbed report {newer.path}" in found.unread[0]


def test_a_row_has_both_sides_and_their_ratios(tmp_path: Path) -> None:
    lossy = [attempt("mavlink", lost=23)]
    finished(tmp_path, [attempt("mqttxt")], lossy)
    row = numbers_of(only_cell(tmp_path))
    assert {name: str(text) for name, text in row.texts.items()} == {
        "completed": "1 of 1 / 1 of 1",
        "packets": "265×",
        "bytes": "288×",
        "rate": "3.99 kB / 697 kB",
        "rates": "175×",
        "mission": "36.6 s / 60.3 s",
        "change": "−39 %",
        "commands lost": "0 (< 17 %) / 0 (< 17 %)",
        "states lost": "0 (< 3 %) / 23 %",
        "frames lost": "0 (< 0.18 %) / 0 (< 0.00067 %)",
        "delay": "34 ms / 64 ms",
        "delay ratio": "0.53",
    }


def test_a_side_that_never_completes_makes_no_ratio_but_has_its_rate(tmp_path: Path) -> None:
    failures = [gave_up("mavlink", "arm: drone 2: unconfirmed", number) for number in (1, 2)]
    finished(tmp_path, [attempt("mqttxt", number) for number in (1, 2)], failures)
    cell = only_cell(tmp_path)
    row = numbers_of(cell)
    assert str(row.texts["completed"]) == "2 of 2 / 0 of 2"
    assert (row.texts["packets"], row.texts["bytes"], row.texts["change"]) == ("–", "–", "–")
    assert str(row.texts["rate"]).endswith("/ 10.0 kB")
    assert row.texts["rates"] == "2.5×"
    assert str(row.texts["mission"]).endswith("/ –")
    assert str(row.texts["states lost"]) == "0 (< 1.5 %) / 0 (< 1.5 %)†"
    assert troubles(cell) == ["MAVLink, attempts 1 and 2 failed: arm: drone 2: unconfirmed"]


def test_what_stayed_void_is_said_and_what_was_made_good_is_not(tmp_path: Path) -> None:
    finished(tmp_path, *both(), void=((1, "a link was off"), (2, "a link was off")))
    assert troubles(only_cell(tmp_path)) == [
        "MQTT-XT, attempt 2 void: a link was off",
        "MAVLink, attempt 2 void: a link was off",
    ]


def test_claims_hold_or_do_not_by_their_figures(tmp_path: Path) -> None:
    purposes = {"command": 4_000, "state": 1_000, "acknowledgement": 1_000}
    leaner = {name: {"bytes": count, "packets": 1} for name, count in purposes.items()}
    purposes = {"command": 10_000, "state": 90_000}
    busier = {name: {"bytes": count, "packets": 1} for name, count in purposes.items()}
    finished(
        tmp_path,
        [attempt("mqttxt", mission_s=40.0, window={"start_ns": 0, "seconds": 40.0}, purposes=leaner)],
        [attempt("mavlink", lost=30, mission_s=50.0, window={"start_ns": 0, "seconds": 50.0}, purposes=busier)],
    )
    assert judged(only_cell(tmp_path)) == {
        "commands: 5 times fewer bytes": "no: 2.1×",
        "states: 20 times fewer bytes": "yes: 60×",
        "missions 30 % shorter": "no: 20 % shorter",
        "MQTT-XT loses 2 % at most": "yes: 0 of 118",
        "MAVLink loses 20 %": "yes: 25 % of 118",
    }


def test_a_claim_without_completed_attempts_on_both_sides_is_left_open(tmp_path: Path) -> None:
    finished(tmp_path, [attempt("mqttxt")], [gave_up("mavlink", "denied")])
    said = judged(only_cell(tmp_path))
    assert said["commands: 5 times fewer bytes"] == said["missions 30 % shorter"] == "–"
    assert said["MQTT-XT loses 2 % at most"].startswith("yes")
    assert said["MAVLink loses 20 %"] == "no: 0 of 118"


def test_every_arm_has_a_row_flown_or_not_and_profiles_come_as_people_ask(tmp_path: Path) -> None:
    for profile in ("3g", "lossy", "ideal"):
        finished(tmp_path, *both(), profile=profile)
    finished(tmp_path, *both(), arm="thesis+qos-1", profile="ideal")
    (overview,) = overviews(find_cells([tmp_path]).cells)
    assert [block.profile for block in overview.blocks] == ["ideal", "lossy", "3g"]
    rows = {row.arm: str(row.texts["completed"]) for row in overview.blocks[0].rows}
    assert list(rows)[:3] == ["thesis", "thesis+qos-1", "thesis-concurrent"]
    assert rows["direct"] == "not flown"
    assert "thesis" in overview.missing
    assert "lossy" not in overview.missing


def test_a_table_in_a_document_is_written_between_its_markers(tmp_path: Path) -> None:
    finished(tmp_path, [attempt("mqttxt")], [gave_up("mavlink", "a | b * c")])
    text = filled(tmp_path)
    assert text.startswith("Before.\n\n<!-- summary:numbers:scenario-1 -->\n\n**Profile `ideal`**\n")
    assert text.endswith("\n\n<!-- /summary -->\n\nAfter.\n")
    assert "| `thesis` | 1 of 1 / 0 of 1 | – |" in text
    assert "| `direct` |" not in text, "it was not flown"
    assert "old" not in text
    assert "- `thesis-ideal`, MAVLink, attempt 1 failed: a \\| b \\* c\n" in filled(tmp_path, "series:scenario-1")


def test_filling_a_document_twice_changes_nothing(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    text = filled(tmp_path)
    document = tmp_path / "document.md"
    fill(document, find_cells([tmp_path]).cells)
    assert document.read_text() == text


def test_a_document_is_left_as_it_is_where_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def half(path: Path, text: str, **_: str) -> None:
        path.write_bytes(text[: len(text) // 2].encode())
        raise OSError(errno.ENOSPC, "No space left on device")

    finished(tmp_path, *both())
    document = tmp_path / "document.md"
    document.write_text(MARKED.format(name="numbers:scenario-1"))
    before = document.read_bytes()
    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(OSError, match="No space left on device"):
        fill(document, find_cells([tmp_path]).cells)
    assert document.read_bytes() == before


def test_an_experiment_that_was_not_flown_says_so(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    assert "Not flown on `ideal`, `thesis`, `lte`, `lossy`," in filled(tmp_path, "numbers:scenario-2")
    for kind in ("claims", "bytes", "series"):
        assert "-->\n\nNot flown.\n" in filled(tmp_path, f"{kind}:scenario-2")


def test_the_series_behind_the_numbers_are_named_with_their_revision(tmp_path: Path) -> None:
    finished(tmp_path, *both(), notes=["flown with changes that are in no revision: mqttxt 1"])
    text = filled(tmp_path, "series:scenario-1")
    assert "| `scenario-1/thesis-ideal/20260101T000000Z` | c0ffee | none | 1 of 1 / 1 of 1 | flown with changes" in text


@pytest.mark.long
def test_the_machine_of_each_series_is_named_where_one_is_known(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    finished(tmp_path, *both(), arm="direct", machine="lab-2")
    text = filled(tmp_path, "series:scenario-1")
    assert "| series | revision | machine | shaper | completed |" in text
    assert "| `scenario-1/direct-ideal/20260101T000000Z` | c0ffee | lab-2 | none | 1 of 1 / 1 of 1 |" in text
    assert "| `scenario-1/thesis-ideal/20260101T000000Z` | c0ffee |  | none | 1 of 1 / 1 of 1 |" in text
    write_summary(find_cells([tmp_path]), tmp_path / "summary.html")
    page = (tmp_path / "summary.html").read_text()
    assert '<th class="left">machine</th>' in page
    assert '<td class="left">lab-2</td>' in page


def test_the_bytes_of_each_side_are_shared_out_by_purpose_and_by_layer(tmp_path: Path) -> None:
    purposes = {"state": {"bytes": 300, "packets": 1}, "acknowledgement": {"bytes": 100, "packets": 1}}
    layers = {"payload": 200, "mqtt": 40, "tcp": 80, "ip": 48, "ethernet": 32}
    finished(tmp_path, [attempt("mqttxt", purposes=purposes, layers=layers)], [gave_up("mavlink", "denied")])
    lines = filled(tmp_path, "bytes:scenario-1:ideal").splitlines()
    assert "| arm |  | completed | bytes a second | command | result | state | acknowledgement | payload |" in lines[6]
    assert lines[8].startswith("| `thesis` | MQTT-XT | 1 of 1 | 3.99 kB | – | – | 75 % | 25 % | 50 % | 10 % | 20 % |")
    assert lines[9].startswith("| `thesis` | MAVLink | 0 of 1 | 10.0 kB | 25 % | 25 % |")


def messages_of_both(root: Path) -> None:
    mqttxt = attempt("mqttxt", message_set=message_set(2_000, 1_000))
    mavlink = attempt("mavlink", message_set=message_set(50_000, 500, lost=4))
    finished(root, [mqttxt], [mavlink], experiment="messages")


def test_the_message_set_is_told_kind_by_kind_with_what_ran_beside_and_alone(tmp_path: Path) -> None:
    messages_of_both(tmp_path)
    finished(tmp_path, *both(), experiment="messages", arm="direct")
    lines = filled(tmp_path, "kinds:messages:ideal").splitlines()
    amounts = "2.00 / 50.0 | 25 | 200 B / 5.00 kB | 25 | 1.00 / 0.50 | 0.50 | 100 B / 50 B | 0.50"
    assert lines[8] == f"| `arm` | `thesis` | 10 of 10 / 6 of 10 | {amounts} | 20 ms / 20 ms | 0 (< 30 %) / 40 % |"
    assert lines[9].startswith("| `battery` | `thesis` |")
    page = page_of(tmp_path)
    assert "<summary>Kind by kind: profile ideal, arm thesis</summary>" in page
    assert "Kind by kind: profile ideal, arm direct" not in page
    assert '<td>battery</td><td>thesis</td><td><span class="of-mqttxt">10 of 10</span>' in page


def test_claims_about_the_message_set_are_of_all_bytes_while_a_kind_was_on(tmp_path: Path) -> None:
    messages_of_both(tmp_path)
    said = judged(only_cell(tmp_path))
    assert said["commands: 5 times fewer bytes"] == said["states: 20 times fewer bytes"] == "yes: 25×"
    assert said["missions 30 % shorter"] == "–"


def test_a_scenario_has_no_kinds(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    assert "| arm |" not in filled(tmp_path, "kinds:scenario-1")
    assert "Kind by kind" not in page_of(tmp_path)


def test_a_table_of_one_profile_has_only_that_one(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    finished(tmp_path, *both(), profile="lte")
    text = filled(tmp_path, "numbers:scenario-1:lte")
    assert "**Profile `lte`**" in text
    assert "ideal" not in text
    assert "Not flown on `3g`." in filled(tmp_path, "numbers:scenario-1:3g")


def test_how_to_read_a_kind_of_table_is_said_once_in_a_document(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    document = tmp_path / "document.md"
    document.write_text(MARKED.format(name="claims:scenario-1") + MARKED.format(name="claims:scenario-2"))
    fill(document, find_cells([tmp_path]).cells)
    assert document.read_text().count(claims.READING) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nothing\n", "expected tables' markers in it, as <!-- summary:numbers:scenario-1 --> and <!-- /summary -->"),
        ("<!-- summary:x:y -->\n<!-- /summary -->\n", "summary:x:y: 'x': expected one of numbers, claims, bytes"),
        ("<!-- summary:claims:y -->\n<!-- /summary -->\n", "'y': expected one of scenario-1, scenario-2"),
        ("<!-- summary:bytes:scenario-1:z -->\n<!-- /summary -->\n", "'z': expected one of ideal, 3g, bursty"),
        ("<!-- summary:numbers:scenario-1 -->\n", "expected <!-- /summary --> on a line after every"),
        (
            "<!-- summary:claims:scenario-1 -->\n<!-- summary:claims:scenario-2 -->\n<!-- /summary -->\n",
            "summary:claims:scenario-1: expected <!-- /summary --> before the next table",
        ),
    ],
)
def test_a_document_with_wrong_markers_is_left_as_it_is(tmp_path: Path, text: str, said: str) -> None:
    finished(tmp_path, *both())
    document = tmp_path / "document.md"
    document.write_text(text)
    with pytest.raises(UserError) as caught:
        fill(document, find_cells([tmp_path]).cells)
    assert said in str(caught.value)
    assert document.read_text() == text


def page_of(root: Path, *, html: Path | None = None) -> str:
    target = html or root / "summary.html"
    write_summary(find_cells([root]), target, ("scenario-1", "scenario-2"))
    return target.read_text()


def test_the_page_has_each_cell_with_a_link_to_its_report_and_what_was_not_flown(tmp_path: Path) -> None:
    series = finished(tmp_path, *both())
    page = page_of(tmp_path, html=tmp_path / "pages" / "all.html")
    assert f'<a href="../{series.path.relative_to(tmp_path)}/report.html">thesis</a>' in page
    assert '<span class="of-mqttxt">36.6 s</span><span class="of-mavlink">60.3 s</span>' in page
    assert page.count(">not flown</td>") == len(ARMS) - 1
    assert '<h2>Scenario 2</h2>\n<p class="what">' in page
    assert page.count('<p class="note">Not flown.</p>') == 1


def test_the_page_begins_with_how_much_was_completed_and_between_what_the_ratios_lie(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    finished(tmp_path, [attempt("mqttxt")], [attempt("mavlink", size_bytes=292_000)], profile="lte")
    finished(tmp_path, [attempt("mqttxt")], [gave_up("mavlink", "denied")], profile="geo")
    assert finding(find_cells([tmp_path]).cells) == (
        "In 3 series MQTT-XT completed 3 of 3 attempts and MAVLink completed 2 of 3 attempts; where both completed a "
        "mission, MAVLink needed 2.0 to 288 times the bytes and 1.6 times the time."
    )


def test_without_a_pair_of_completed_attempts_the_page_says_so(tmp_path: Path) -> None:
    finished(tmp_path, [attempt("mqttxt")], [gave_up("mavlink", "denied <b>")])
    page = page_of(tmp_path)
    assert "in none of them did both complete a mission." in page
    assert "MAVLink, attempt 1 failed: denied &lt;b&gt;" in page


def test_the_figure_has_its_data_beside_the_page_and_pale_marks_where_there_is_no_ratio(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    finished(tmp_path, [attempt("mqttxt")], [gave_up("mavlink", "denied")], arm="direct", profile="lte")
    page = page_of(tmp_path)
    assert 'href="summary-ratios-scenario-1.csv"' in page
    header, ideal, lte = (tmp_path / "summary-ratios-scenario-1.csv").read_text().splitlines()
    assert header == "profile,arm,packets,bytes,bytes_per_s,mission_time"
    assert ideal.startswith("ideal,thesis,265,288,")
    assert lte.startswith("lte,direct,,,2.5")
    assert "lte, direct: 2.5× bytes a second" in page
    assert (tmp_path / "summary-ratios-scenario-1.pdf").read_bytes().startswith(b"%PDF")


def test_the_message_set_is_drawn_without_a_mission_time(tmp_path: Path) -> None:
    messages_of_both(tmp_path)
    page = page_of(tmp_path)
    assert (tmp_path / "summary-ratios-messages.csv").read_text().startswith("profile,arm,packets,bytes,bytes_per_s\n")
    assert "traffic, MAVLink over MQTT-XT" in page
    assert "mission time, MQTT-XT against MAVLink" not in page
    finished(tmp_path, *both())
    assert "mission time, MQTT-XT against MAVLink" in page_of(tmp_path)


def test_the_page_is_the_same_for_the_same_results(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    assert page_of(tmp_path) == page_of(tmp_path)


def test_an_experiment_of_one_side_only_has_numbers_and_no_figure(tmp_path: Path) -> None:
    finished(tmp_path, [attempt("mqttxt")], [], experiment="search")
    page = page_of(tmp_path)
    assert "<h2>search</h2>" in page
    assert "<figure>" not in page
    assert '<span class="of-mavlink">not flown</span>' in page


def test_a_folder_that_is_none_or_has_nothing_finished_is_said_in_one_line(tmp_path: Path) -> None:
    missing = CliRunner().invoke(app, ["summary", str(tmp_path / "none")])
    assert (missing.exit_code, missing.stderr.count("\n")) == (2, 1)
    assert "expected a results folder" in missing.stderr
    empty = CliRunner().invoke(app, ["summary", str(tmp_path)])
    assert (empty.exit_code, empty.stderr) == (1, f"testbed: {tmp_path}: expected a finished series in it\n")


def test_the_command_fills_a_document(tmp_path: Path) -> None:
    finished(tmp_path, *both())
    document = tmp_path / "document.md"
    document.write_text(MARKED.format(name="numbers:scenario-1"))
    result = CliRunner().invoke(app, ["summary", str(tmp_path), "--markdown", str(document)])
    assert (result.exit_code, result.stdout) == (0, f"{document}: numbers:scenario-1\n")
    assert "265×" in document.read_text()
    assert not (tmp_path / "summary.html").exists()
    assert CliRunner().invoke(app, ["summary", str(tmp_path)]).stdout == f"page: {tmp_path / 'summary.html'}\n"
