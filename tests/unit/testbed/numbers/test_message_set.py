"""The message set's numbers: attempts whose answers were counted by hand, and what is said where something failed."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from testbed.fly.results import Series, new_series
from testbed.numbers.metrics import measure_series, verdict
from testbed.numbers.metrics.message_spans import kinds_of
from tests.handmade.attempts import make_attempt
from tests.handmade.mavlink_attempts import MS
from tests.handmade.message_attempts import (
    ANSWERED_MS,
    COMMANDS,
    STATES,
    call_times,
    make_mavlink_messages,
    make_mqttxt_messages,
    message_events,
    start_of,
)

GOLDEN = Path(__file__).parent / "golden_metrics" / "messages.json"
BARE = 54
"""Bytes of a TCP acknowledgement without data."""


@pytest.fixture(scope="module")
def metrics(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of both attempts as they come."""
    series = new_series(tmp_path_factory.mktemp("messages"), "messages", "thesis", "ideal")
    make_mavlink_messages(series)
    make_mqttxt_messages(series)
    return measure_series(series)


@pytest.fixture(scope="module")
def mavlink(metrics: dict[str, Any]) -> dict[str, Any]:
    return _kinds(metrics, "mavlink")


@pytest.fixture(scope="module")
def mqttxt(metrics: dict[str, Any]) -> dict[str, Any]:
    return _kinds(metrics, "mqttxt")


@pytest.fixture
def series(tmp_path: Path) -> Series:
    return new_series(tmp_path, "messages", "thesis", "ideal")


def _kinds(metrics: dict[str, Any], protocol: str) -> dict[str, Any]:
    (found,) = metrics["protocols"][protocol]["attempts"]
    return dict(found["message_set"])


def test_the_metrics_of_a_message_set_are_as_they_were_looked_at(metrics: dict[str, Any]) -> None:
    """UPDATE_GOLDEN=1 writes them anew; then look at what changed."""
    text = json.dumps(metrics, indent=1) + "\n"
    if os.environ.get("UPDATE_GOLDEN"):
        GOLDEN.write_text(text)
    assert text == GOLDEN.read_text()


@pytest.mark.parametrize("protocol", ["mavlink", "mqttxt"])
def test_the_window_ends_with_the_last_kind_and_every_kind_is_there_in_its_order(
    metrics: dict[str, Any], protocol: str
) -> None:
    (found,) = metrics["protocols"][protocol]["attempts"]
    assert found["window"] == {"start_ns": call_times("arm")[0], "seconds": 93.0}
    assert list(found["message_set"]) == [*COMMANDS, *STATES]
    assert {kind["asked"] for kind in found["message_set"].values()} == {2}
    assert {kind["received"] for kind in found["message_set"].values()} == {2}


def test_a_scenario_has_no_message_set(tmp_path: Path) -> None:
    scenario = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(scenario)
    (found,) = measure_series(scenario)["protocols"]["mqttxt"]["attempts"]
    assert found["message_set"] is None


def test_over_mavlink_a_command_is_counted_with_and_without_what_streams_beside_it(
    mavlink: dict[str, Any],
) -> None:
    command, ack, attitude = 14 + 20 + 8 + 12 + 32, 14 + 20 + 8 + 12 + 10, 14 + 20 + 8 + 12 + 28
    # a call takes 12 ms: three hops there, three back, and an attitude on its three hops 3 ms after the call
    assert mavlink["land"]["with_states"] == {"packets": 2 * 9, "bytes": 2 * 3 * (command + ack + attitude)}
    assert mavlink["land"]["alone"] == {"packets": 2 * 6, "bytes": 2 * 3 * (command + ack)}
    assert mavlink["land"]["setpoints"] is None
    assert mavlink["land"]["seconds"] == pytest.approx(2 * ANSWERED_MS / 1000, abs=1e-5)
    assert (mavlink["land"]["delay_ms"], mavlink["land"]["frames_per_call"]) == ([2.5, 2.5], 1.0)
    assert mavlink["land"]["delay_app_ms"] == [ANSWERED_MS + 0.001] * 2
    assert mavlink["land"]["size_histogram"] == {"40-79": 2 * 3, "80-159": 2 * 6}
    assert {name: size["mean"] for name, size in mavlink["land"]["message_bytes"].items()} == {
        **{"land": command, "land ack": ack}
    }


def test_repetitions_belong_to_their_call_and_its_delay_is_that_of_the_first_copy(mavlink: dict[str, Any]) -> None:
    takeoff = mavlink["takeoff"]
    assert takeoff["delay_ms"] == [2.5, 6.5]
    assert takeoff["frames_per_call"] == 2.0
    assert (takeoff["sent"], takeoff["lost"]) == (2, 0)
    assert takeoff["alone"]["packets"] == (3 + 3) + (3 * 3 + 3)


def test_setpoints_are_a_third_figure_apart(mavlink: dict[str, Any]) -> None:
    offboard = mavlink["offboard"]
    assert offboard["setpoints"]["packets"] == 2 * 3
    assert offboard["alone"]["packets"] == 2 * 6
    assert offboard["with_states"]["packets"] == 2 * (6 + 3 + 3)


def test_a_state_is_counted_over_all_its_time_with_what_asks_for_it(mavlink: dict[str, Any]) -> None:
    assert mavlink["battery"]["seconds"] == 4.0
    assert mavlink["battery"]["alone"]["packets"] == 2 * 3 + 3 + 3
    assert mavlink["battery"]["with_states"]["packets"] == 12 + 4 * 4 * 3
    assert (mavlink["battery"]["sent"], mavlink["battery"]["lost"], mavlink["battery"]["share"]) == (2, 1, 0.5)
    assert mavlink["battery"]["delay_ms"] == [2.5, None]
    assert mavlink["battery"]["frames_per_call"] is None
    assert set(mavlink["battery"]["message_bytes"]) == {"battery", "request", "request ack"}


def test_one_message_carries_location_and_heading_and_each_kind_has_its_own(mavlink: dict[str, Any]) -> None:
    for name in ("location", "heading"):
        assert (mavlink[name]["sent"], mavlink[name]["delay_ms"]) == (2, [2.5, 2.5])
        assert mavlink[name]["message_bytes"][name]["n"] == 2 * 3


def test_over_mqttxt_acknowledgements_count_with_the_frames_that_they_answer(mqttxt: dict[str, Any]) -> None:
    land, arm = mqttxt["land"], mqttxt["arm"]
    assert land["alone"]["packets"] == 2 * (3 + 3) * 2
    assert land["message_bytes"]["land"]["ack_bytes"] == BARE
    assert land["message_bytes"]["land result"]["n"] == 2 * 3  # the last word comes after what is counted
    assert arm["alone"]["packets"] == land["alone"]["packets"]
    assert arm["with_states"]["packets"] == arm["alone"]["packets"] + 2 * 3 * 2  # a battery state beside each
    assert mqttxt["offboard"]["setpoints"] == {"packets": 0, "bytes": 0}


def test_a_frame_that_tcp_sends_again_belongs_to_its_message(mqttxt: dict[str, Any]) -> None:
    goto = mqttxt["goto"]
    assert goto["delay_ms"] == [2.5, 4.5]
    assert goto["alone"]["packets"] == 2 * 12 + 1
    assert goto["alone"] == goto["with_states"]
    assert goto["message_bytes"]["goto"]["n"] == 2 * 3


def test_a_message_that_never_arrives_is_null_in_its_place(mqttxt: dict[str, Any]) -> None:
    heading = mqttxt["heading"]
    assert (heading["sent"], heading["lost"], heading["delay_ms"]) == (2, 1, [2.5, None])


def test_what_failed_is_counted_with_its_reason_and_stays_in_its_place(series: Series) -> None:
    make_mqttxt_messages(series, refused=("arm",), silent=("takeoff", "battery"), unsent=("land",))
    kinds = _kinds(measure_series(series), "mqttxt")
    assert (kinds["arm"]["received"], kinds["arm"]["reasons"]) == (1, {"denied (not now)": 1})
    assert kinds["arm"]["delay_app_ms"] == [ANSWERED_MS + 0.001, None]
    assert kinds["arm"]["delay_ms"] == [2.5, 2.5]
    assert (kinds["takeoff"]["received"], kinds["takeoff"]["reasons"]) == (1, {"no word about it": 1})
    assert kinds["takeoff"]["seconds"] == pytest.approx(ANSWERED_MS / 1000 + 2.0, abs=1e-3)
    assert (kinds["battery"]["received"], kinds["battery"]["reasons"]) == (1, {"did not come in time": 1})
    assert (kinds["land"]["sent"], kinds["land"]["lost"]) == (3, 1)
    assert kinds["land"]["delay_ms"] == [2.5, 2.5, None]
    assert kinds["land"]["reasons"] == {"unconfirmed (timeout)": 1}
    assert kinds["land"]["frames_per_call"] == pytest.approx(2 / 3, abs=1e-3)


def test_a_span_is_a_call_up_to_its_first_word() -> None:
    (arm, *_) = kinds_of(message_events())
    assert arm.spans == tuple((t_ns - 1000, t_ns + ANSWERED_MS * MS) for t_ns in call_times("arm"))


def test_a_mission_that_broke_off_has_the_kinds_that_it_began() -> None:
    events = [event for event in message_events() if event["t_ns"] < start_of("land") + MS]
    kinds = kinds_of(events)
    assert [kind.name for kind in kinds] == ["arm", "takeoff", "land"]
    assert (kinds[-1].spans, kinds[-1].received, kinds[-1].end_ns) == ((), 0, start_of("land"))


def test_requirements_can_name_a_kinds_numbers(metrics: dict[str, Any]) -> None:
    for text in ("mqttxt.message_set.arm.alone.packets==24", "mqttxt.max.message_set.heading.delay_ms<=2.5"):
        assert verdict.judge(metrics, verdict.parse(text)).met, text
