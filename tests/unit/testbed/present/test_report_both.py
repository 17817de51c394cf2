"""A series of both protocols: the sentence that compares them, the tables, and what is said when a side failed."""

from __future__ import annotations

import re

import pytest

from testbed.fly.results import Series, write_json
from testbed.present.report import comparison, details, factors, sentences
from testbed.present.report.attempt_page import with_losses
from testbed.present.report.html import write_report
from tests.handmade.both_sides import entry, failed, make_series, messages, rich_entry
from tests.handmade.pages import cells_of, page_of, terminal_of

ROUTER_DIED = "router-fog1 ended with exit code 1; its last log lines:\n    chain of uav2: mavp2p <ended>"


def test_the_finding_says_which_by_how_much_on_what(series: Series) -> None:
    metrics = make_series(series, ("mavlink", entry("mavlink")), ("mqttxt", entry("mqttxt")))
    assert sentences.finding(metrics) == (
        "Over MAVLink the same mission took 60.2 s, 450,500 packets and 42.0 MB: "
        "265 times the packets, 288 times the bytes and 1.6 times the mission time of MQTT-XT."
    )
    assert sentences.basis(metrics) == (
        "MQTT-XT took 36.5 s, 1,700 packets and 146 kB. A command reached its drone in 3.00 ms over MAVLink, "
        "in 3.00 ms over MQTT-XT (medians). Six drones on two fogs flew scenario 1 on links of profile ideal; "
        "one attempt each."
    )


def test_a_mission_that_takes_as_long_is_said_so(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink", mission_s=36.9)))
    assert sentences.finding(metrics) == (
        "Over MAVLink the same mission took 36.9 s, 450,500 packets and 42.0 MB: "
        "265 times the packets and 288 times the bytes of MQTT-XT, in about the same mission time."
    )


@pytest.mark.parametrize(("lost", "share"), [(8_060, "12 %"), (130, "0.2 %")])
def test_what_was_lost_is_said_in_the_finding(series: Series, lost: int, share: str) -> None:
    lossy = entry("mavlink", messages=messages(18, 65_000, states_lost=lost), delay_ms={})
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", lossy))
    assert str(sentences.basis(metrics)).startswith(
        "MQTT-XT took 36.5 s, 1,700 packets and 146 kB. "
        f"States lost: {share} of 65,000 over MAVLink, 0 of 225 (< 1.3 %) over MQTT-XT. Six drones"
    )


def test_the_mean_beside_a_median_lies_in_its_interval(series: Series) -> None:
    delays = [[1.0, 1.0, 100.0], [2.0, 2.0, 200.0], [3.0, 3.0, 300.0]] * 2
    flown = [("mqttxt", entry("mqttxt", n, delay_ms={"arm": values})) for n, values in enumerate(delays, 1)]
    metrics = make_series(series, *flown)
    cell = comparison.rows(metrics)["delay_ms"].cells["mqttxt"]
    known = metrics["statistics"]["metrics"]["delay_ms"]["mqttxt"]
    assert cell.interval is not None
    assert cell.interval[0] < (cell.mean or 0.0) < cell.interval[1]
    assert (known["mean"], known["median"], known["interval"]) == (cell.mean, cell.value, list(cell.interval))
    assert cell.more.startswith("mean 2.00 ms (1.")


def test_a_mavlink_that_needs_less_is_said_as_plainly(series: Series) -> None:
    lean = entry("mavlink", packets=850, size_bytes=146_000, mission_s=30.0)
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", lean))
    assert sentences.finding(metrics) == (
        "Over MAVLink the same mission took 30.0 s, 850 packets and 146 kB: "
        "50 % of the packets, 1.00 times the bytes and 82 % of the mission time of MQTT-XT."
    )


def test_a_failed_side_leaves_the_other_ones_numbers_and_makes_no_ratio(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", failed("mavlink", ROUTER_DIED)))
    assert sentences.finding(metrics) == (
        "Over MAVLink the only attempt failed (router-fog1 ended with exit code 1). Over MQTT-XT six drones on two "
        "fogs flew scenario 1 in 36.5 s, with 1,700 packets and 146 kB on all links. There is no ratio to make."
    )
    assert sentences.basis(metrics) is None
    rows = comparison.rows(metrics).values()
    assert all(row.ratio is None for row in rows)
    table = {row.name: {p: cell.text for p, cell in row.cells.items()} for row in rows}
    assert table["completed"] == {"mqttxt": "1 of 1", "mavlink": "0 of 1"}
    assert table["packets"] == {"mqttxt": "1,700", "mavlink": "–"}


def test_both_sides_failed_or_void_is_said(series: Series) -> None:
    void = {**entry("mqttxt"), "status": "void", "reason": "captures dropped packets: gs 1"}
    late = [("mavlink", failed("mavlink", "vehicle 3 never appeared", n)) for n in (1, 2)]
    metrics = make_series(series, ("mqttxt", void), *late)
    assert sentences.finding(metrics) == (
        "Over MQTT-XT no attempt counts (captures dropped packets: gs 1). "
        "Over MAVLink none of 2 attempts was completed (vehicle 3 never appeared). There is no ratio to make."
    )
    page_of(series, metrics)
    assert "MAVLink, attempt 2 failed: vehicle 3 never appeared" in terminal_of(series, metrics)


def test_medians_are_of_the_completed_attempts_only(series: Series) -> None:
    several = [("mqttxt", entry("mqttxt", n, packets=1000 + 100 * n)) for n in (1, 2, 3)]
    several += [("mavlink", entry("mavlink", n, packets=120_000 * n)) for n in (1, 3)]
    metrics = make_series(series, *several, ("mavlink", failed("mavlink", "arm: drone 1: denied", 2)))
    row = comparison.rows(metrics)["packets"]
    assert (row.cells["mqttxt"].value, row.cells["mavlink"].value, row.ratio) == (1200, 240_000, 200)
    assert row.cells["mavlink"].points == (120_000, 360_000)
    assert str(sentences.basis(metrics)).endswith(
        "medians of the completed attempts, 3 of 3 over MQTT-XT and 2 of 3 over MAVLink."
    )


def test_the_attempt_shown_is_the_first_that_all_sides_completed(series: Series) -> None:
    metrics = make_series(
        series,
        *(("mqttxt", entry("mqttxt", n)) for n in (1, 2)),
        ("mavlink", failed("mavlink", "denied", 1)),
        ("mavlink", entry("mavlink", 2)),
    )
    assert {protocol: one["attempt"] for protocol, one in comparison.shown(metrics).items()} == {
        "mqttxt": 2,
        "mavlink": 2,
    }


def test_the_page_sets_both_sides_beside_each_other(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")))
    page = page_of(series, metrics)
    assert ["packets", "1,700", "450,500", "265×", ""] in page.rows
    assert ["frames per call", "1.00", "1.00 to 2.50", "", ""] in page.rows
    assert [
        "takeoff",
        "2",
        "1.00",
        "3.00 ms",
        "2.00 ms",
        "4.00 ms",
        "6",
        "2.50",
        "3.00 ms",
        "2.00 ms",
        "4.00 ms",
    ] in page.rows
    assert [
        "air:uav6",
        "94",
        "94",
        "8.11 kB",
        "8.11 kB",
        "0",
        "25,027",
        "25,027",
        "2.34 MB",
        "2.34 MB",
        "0",
    ] in page.rows
    assert ["drone 6", *["✓ 14 ms", "✓ 7.10 s", "✓ 14.30 s"] * 2] in page.rows
    assert {"comparison", "flights", "layers", "links", "commands", "mix", "routers", "cpu", "conditions"} <= set(
        page.sections
    )
    assert all((series.path / link).exists() for link in page.links if not link.startswith("#"))
    assert {link[1:] for link in page.links if link.startswith("#")} <= page.ids


def test_the_message_mix_is_ordered_by_bytes_and_summed(series: Series) -> None:
    metrics = make_series(series, ("mavlink", entry("mavlink")))
    page = page_of(series, metrics)
    names = [row[0] for row in page.rows if row[0] in ("ATTITUDE", "HIGHRES_IMU", "ODOMETRY", "HEARTBEAT")]
    assert names[:4] == ["ATTITUDE", "ODOMETRY", "HIGHRES_IMU", "HEARTBEAT"]
    assert ["ODOMETRY", "10,836", "30.0", "2.94 MB", "271 B", "37 %", ""] in page.rows
    assert "65,377 messages of 4 kinds, 181 a second from each drone" in page.sections["mix"]
    assert ["COMMAND_LONG 400", "6", "498 B"] in page.rows
    assert ["ODOMETRY", "10,836", "30.0", "2.94 MB", "271 B", "37 %"] in cells_of(terminal_of(series, metrics))


def test_nothing_is_broken_over_lines_on_a_terminal_of_80_columns(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")))
    shown = terminal_of(series, metrics, width=80)
    assert ["frames lost", "0 of 1,700 (< 0.18 %)", "0 of 450,500 (< 0.00067 %)", "–"] in cells_of(shown)
    assert ["air:uav6", "94 / 94", "8.11 kB / 8.11 kB", "0"] in cells_of(shown)
    assert ["air:uav6", "25,027 / 25,027", "2.34 MB / 2.34 MB", "0"] in cells_of(shown)


def test_the_terminal_sets_links_and_the_thesis_beside_what_was_measured(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", rich_entry("mqttxt")), ("mavlink", rich_entry("mavlink")))
    shown = cells_of(terminal_of(series, metrics, width=80))
    assert ["air up", "25 ms", "25 ms", "1.45 Mbit/s", "1.45 Mbit/s", "1 %", "1.1 %"] in shown
    assert ["packets", "1,700", "7,716", "450,500", "512,827", "265×", "66×"] in shown


def test_random_loss_is_what_the_shaper_counted_of_what_could_be_lost(series: Series) -> None:
    make_series(series, ("mqttxt", entry("mqttxt")))
    attempt = series.attempts()[0]
    counted = {"random": 5, "left": 95, "queue": 900, "closed": 3}
    write_json(attempt.path / "links" / "counters.json", {"links": {"air:uav1:up": counted}})
    write_json(attempt.path / "links" / "plan.json", {"plan": {"links": {"air:uav1:up": {"loss": 0.04}}}})
    found = with_losses(attempt, rich_entry("mqttxt", links_measured={"air:uav1:up": {}}))
    assert found["links_measured"]["air:uav1:up"]["loss"] == {"configured": 0.04, "measured": 0.05}


def test_attempts_that_were_not_flown_alike_are_said(series: Series) -> None:
    make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")))
    manifests = [attempt.manifest() for attempt in series.attempts()]
    assert factors.mixed(manifests) == []
    manifests[0]["revision"]["commit"] = "decaf"
    manifests[0]["configuration"]["qos"] = 1
    assert factors.mixed(manifests) == [
        "The attempts were flown at 2 different revisions; each one's is among its conditions.",
        "The attempts were not all flown alike: qos was 0 and 1.",
    ]


def test_what_a_router_drops_is_named(series: Series) -> None:
    metrics = make_series(series, ("mavlink", entry("mavlink")))
    page = page_of(series, metrics)
    assert ["fog1", "1,000", "997", "3 (0.3 %)", "1,000", "1,000", "0"] in page.rows
    assert [row[0] for row in page.rows if row[0] in ("fog2", "cloud", "fog1")] == ["cloud", "fog1", "fog2"]
    assert "routers dropped fog1 up 3 of 6,000 messages" in terminal_of(series, metrics)
    assert "1,234 on all links" in page.sections["routers"]


def test_cpu_seconds_are_summed_by_role(series: Series) -> None:
    metrics = make_series(series, ("mqttxt", entry("mqttxt")), ("mavlink", entry("mavlink")))
    roles = details.roles_of({p: a["cpu_s"] for p, a in comparison.shown(metrics).items()})
    sums = {role.name: role.sums for role in roles}
    assert sums["routers"] == {"mavlink": 21.0}
    assert sums["autopilots"] == {"mqttxt": 2.0, "mavlink": 6.0}
    assert sums["nodes that only hold an address"] == {"mqttxt": 0.01}
    own = details.protocols_own(roles)
    assert own == {"mqttxt": pytest.approx(4.81), "mavlink": pytest.approx(42.0)}


@pytest.mark.long
def test_a_failure_comes_first_with_its_reason_and_where_to_look(series: Series) -> None:
    metrics = make_series(
        series, ("mqttxt", entry("mqttxt")), ("mavlink", failed("mavlink", ROUTER_DIED, truncated=["uav3.pcap"]))
    )
    text = write_report(series, metrics).read_text()
    assert text.index("MAVLink, attempt 1 failed.") < text.index("Comparison")
    assert "mavp2p &lt;ended&gt;" in text
    assert "It ended in the step takeoff." in text
    assert "Done before: arm." in text
    assert "counted up to the cut: uav3.pcap" in text
    assert "gave up after" in text
    assert re.search(r'href="mavlink/attempt-01/logs"', text)
    shown = terminal_of(series, metrics)
    assert shown.index("MAVLink, attempt 1 failed: router-fog1 ended") < shown.index("Over MAVLink")


def test_what_each_drone_last_said_is_with_the_failure(series: Series) -> None:
    said = {"1": "completed", "2": "denied", "3": "unconfirmed"}
    reasons = {"denied": "not healthy"}
    outcomes = {
        drone: [{"command": "takeoff", "word": word, "reason": reasons.get(word), "after_ms": 5.0}]
        for drone, word in said.items()
    }
    metrics = make_series(series, ("mavlink", failed("mavlink", "takeoff: drone 2: denied", outcomes=outcomes)))
    text = write_report(series, metrics).read_text()
    assert "<p>drone 3: takeoff unconfirmed.</p>" in text  # what the reason says is not said again


def test_a_mission_that_never_began_is_said(series: Series) -> None:
    metrics = make_series(
        series, ("mavlink", failed("mavlink", "vehicle 3 never appeared", outcomes={}, links={}, window=None))
    )
    (series.path / "mavlink" / "attempt-01" / "events.jsonl").unlink()
    text = write_report(series, metrics).read_text()
    assert "The mission never began." in text
    assert 'id="flights"' not in text


def test_several_attempts_are_points_and_rows(series: Series) -> None:
    several = [(p, entry(p, n)) for p in ("mqttxt", "mavlink") for n in (1, 2)]
    void = {**entry("mqttxt", 3), "status": "void", "reason": "captures dropped packets: gs 1"}
    metrics = make_series(series, *several, ("mqttxt", void))
    text = write_report(series, metrics).read_text()
    assert text.count("<u style=") == 6 * 4  # six quantities, four completed attempts
    assert "void, not counted" in text
    assert "attempt 1 over MQTT-XT and attempt 1 over MAVLink are shown in detail" in text
    assert all(
        text.count(f'"{shown}-wide-title"') == 1 for shown in ("flights", "flights-mavlink-2", "flights-mqttxt-2")
    )
    assert write_report(series, metrics).read_text() == text


def test_factors_are_said_in_words_and_what_they_mean() -> None:
    base = {"streams": "px4-onboard", "commanding": "one-by-one", "qos": 0, "chain": "per-uav", "states": "on-change"}
    assert [factor.value for factor in factors.factors_of(base, "mavlink")] == ["px4-onboard", "one-by-one", "per-uav"]
    assert "do not carry the same content" in factors.fairness(base)[0]
    assert "COMMANDING=concurrent" in factors.fairness(base)[1]
    same = base | {
        "streams": "five-states",
        "states": "bundle",
        "commanding": "concurrent",
        "qos": 1,
        "chain": "direct",
    }
    assert "compare the same content" in factors.fairness(same)[0]
    assert "wait up to a second for their bundle" in factors.fairness(same)[0]
    assert "bundle" not in factors.fairness(same | {"states": "fixed"})[0]
    assert "mission times compare directly" in factors.fairness(same)[1]
    assert not any("QoS 0" in said for said in factors.fairness(same))
    assert factors.fairness({"fogs": 3, "drones": 6}) == [
        "Another fleet than the thesis's flew: six drones on three fogs. "
        "The thesis's figures, of six drones on two fogs, are left out."
    ]
    assert factors.fairness({"fogs": 2, "drones": 6}) == [
        "Another fleet than the thesis's flew: six drones on two fogs."
    ]
    assert factors.fairness({"fogs": 3, "drones": 1}, one_drone=True) == []
    assert factors.fairness({}) == factors.factors_of({}, "mqttxt") == []


def test_changed_factors_are_read_from_the_manifest() -> None:
    own = {"streams": "five-states", "commanding": "concurrent", "qos": 1, "chain": "shared", "states": "bundle"}
    changed = own | {"streams": "px4-gcs", "qos": 0}
    assert factors.deviations(changed, "five-states-bundled") == [("streams", "px4-gcs"), ("qos", "0")]
    assert factors.deviations(own, "five-states-bundled") == []
    assert factors.deviations(own, "an arm of old") == []
