"""Metrics of a series whose answers were counted by hand."""

from __future__ import annotations

import json

import pytest

from mqttxt.protocol.bundles import drone_bundle, fog_bundles
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Resume
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.state_payload import StampedState
from mqttxt.protocol.states import Battery, Groundspeed, Heading
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from testbed.errors import ResultsError
from testbed.fly.results import Series
from testbed.numbers.metrics import measure_series
from tests.handmade.attempts import SECOND, T0, add_event, arm_command, called, frame, make_attempt, publish, write_pcap


def test_every_number_of_a_tiny_attempt(series: Series) -> None:
    make_attempt(series)
    metrics = measure_series(series)
    (measured,) = metrics["protocols"]["mqttxt"]["attempts"]

    assert measured["status"] == "completed"
    assert measured["mission_s"] == 9.0  # the command left at 0, the drone disarmed at 4 + 5
    assert measured["packets"] == 7
    # headers 54, MQTT 5 beside its topic, payload 12; the topic has 13 characters on wan and backhaul, 15 on air
    command = 54 + 5 + 12
    state_up, state_down = 54 + 5 + 20 + 6, 54 + 5 + 25 + 7
    expected = {
        "wan:gs:up": (1, command + 13),
        "backhaul:fog1:down": (1, command + 13),
        "air:uav1:down": (1, command + 15),
        "air:uav1:up": (2, state_up + 54),
        "backhaul:fog1:up": (1, state_down),
        "wan:gs:down": (1, state_down),
    }
    assert {name: (link["packets"], link["bytes"]) for name, link in measured["links"].items()} == expected
    assert measured["size_bytes"] == sum(size for _, size in expected.values())
    assert {name: link["lost"] for name, link in measured["links"].items() if link["lost"]} == {"air:uav1:up": 1}
    assert measured["wire_loss"] == pytest.approx(1 / 7)
    assert measured["message_loss"] == {"commands": 0.0, "states": 0.0}
    assert (measured["commands_sent"], measured["states_sent"]) == (1, 1)
    assert measured["delay_ms"] == {"arm": [2.5]}  # by the capture at uav1: 2 ms and half a millisecond of air
    assert measured["outcomes"] == {"1": [{"command": "arm", "word": "completed", "reason": None, "after_ms": 10.0}]}
    assert measured["mqtt"] == {"publish": 6}
    assert measured["before_mission"] == {"packets": 1, "bytes": 54, "other": 0}
    assert measured["foreign"] == {"arp": 1}
    assert measured["truncated"] == []
    assert measured["frames_per_call"] == {"arm": 1.0}
    assert (measured["mavlink"], measured["cpu_s"]) == (None, {})
    assert json.loads((series.path / "metrics.json").read_text()) == metrics


def test_a_capture_that_dropped_packets_makes_the_attempt_void(series: Series) -> None:
    make_attempt(series)
    make_attempt(series, number=2, dropped=3)
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [attempt["attempt"] for attempt in side["attempts"]] == [1]
    assert side["void"] == [{"attempt": 2, "reason": "captures dropped packets: gs 3, cloud 3, fog1 3, uav1 3"}]


def test_a_failed_attempt_stays_with_its_reason_and_without_a_mission_time(series: Series) -> None:
    make_attempt(series, status="failed", reason="takeoff: drone 1: denied")
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["status"], measured["reason"]) == ("failed", "takeoff: drone 1: denied")
    assert measured["mission_s"] is None
    assert measured["packets"] == 7


def test_an_attempt_that_never_flew_has_no_traffic(series: Series) -> None:
    attempt = make_attempt(series, status="failed", reason="connect: fog 1")
    (attempt.path / "events.jsonl").unlink()
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["packets"], measured["mission_s"], measured["wire_loss"]) == (0, None, None)


def test_a_failed_attempt_is_never_void(series: Series) -> None:
    make_attempt(series, dropped=3, status="failed", reason="takeoff: drone 1: denied")
    second = make_attempt(series, number=2, status="failed", reason="net ended with exit code 137")
    (second.path / "pcap" / "captures.json").unlink()
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [attempt["status"] for attempt in side["attempts"]] == ["failed", "failed"]
    assert side["void"] == []


@pytest.mark.parametrize(
    ("others", "notes"),
    [(0.249, []), (0.62, ["other programs took 62 % of the processors' time: delays contain waiting for them"])],
)
def test_a_flight_beside_programs_that_took_much_of_the_machine_says_so(
    series: Series, others: float, notes: list[str]
) -> None:
    make_attempt(series, host={"cores": 2, "machine": "x86_64", "python": "3.11.7", "others": others})
    (attempt,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert attempt["notes"] == notes


def test_a_command_sent_again_by_whichever_layer_is_one_command_in_several_frames(series: Series) -> None:
    attempt = make_attempt(series)
    body = publish("fog1/commands", arm_command())
    first, again = frame("gs", "cloud", body, 1), frame("gs", "cloud", body, 9, sequence=len(body))
    by_tcp = frame("gs", "cloud", body, 10)
    sent = [(T0, first), (T0 + SECOND, by_tcp), (T0 + 2 * SECOND, again)]
    write_pcap(attempt.path / "pcap" / "gs.pcap", sent)
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["commands_sent"], measured["frames_per_call"]) == (1, {"arm": 3.0})
    assert measured["mqtt"]["publish"] == 5 + 2  # those of the other hops, and the station's two


def test_commands_signed_for_drones_are_told_apart_and_found_again_at_each(series: Series) -> None:
    """A broadcast carries one for each drone of the fog; the drone gets its own in its envelope."""
    attempt = make_attempt(series)
    signed = Envelope(arm_command(), b"kid1", bytes(64))
    down = Addressed(9, 5000, {1: signed}).encode()
    sent = frame("gs", "cloud", publish("fog1/commands", down), 1)
    came = frame("fog1", "uav1", publish("drone1/commands", signed.routed(4000).encode()), 3, (1883, 6))
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0, sent)])
    write_pcap(attempt.path / "pcap" / "fog1.pcap", [(T0 + SECOND, came)])
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(T0 + 2 * SECOND, came)])
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert measured["messages"]["commands"]["arm"]["drones"] == {"1": {"sent": 1, "lost": 0, "open": 0}}
    assert (measured["delay_ms"], measured["frames_per_call"]) == ({"arm": [2000.0]}, {"arm": 1.0})


def test_an_attempt_in_tls_without_its_session_keys_has_no_numbers_and_says_so(series: Series) -> None:
    attempt = make_attempt(series)
    make_attempt(series, number=2)
    record = b"\x17\x03\x03\x00\x20" + bytes(32)
    hello = b"\x16\x03\x01\x00\x2a\x01" + bytes(41)
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(T0, frame("uav1", "fog1", hello + record, 1, (40_000, 8883)))])
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [counted["attempt"] for counted in side["attempts"]] == [2]
    expected = "tls/keys.log: expected the session keys of every connection, 1 directions cannot be read to their ends"
    assert [void["reason"] for void in side["void"]] == [f"mqttxt/attempt-01/{expected}"]


def test_a_command_for_whoever_arrives_first_is_in_frames_but_in_no_count_of_what_was_sent(series: Series) -> None:
    """What its fogs are asked, and what is chosen: three frames of one call."""
    attempt = make_attempt(series)
    add_event(attempt, called(T0 + SECOND // 2, 2, "goto", fog=None))
    arm = publish("fog1/commands", arm_command())
    asked = [publish(f"fog{fog}/commands/goto", b"asked") for fog in (1, 2, 1)]
    bodies, place = [arm, *asked], 0
    frames = []
    for number, body in enumerate(bodies):
        frames.append((T0 + number * SECOND, frame("gs", "cloud", body, 1 + 20 * number, sequence=place)))
        place += len(body)
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames)
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert measured["frames_per_call"] == {"arm": 1.0, "goto": 3.0}
    assert set(measured["messages"]["commands"]) == {"arm"}


def test_a_start_that_leaves_the_gateway_as_resume_is_no_lost_call(series: Series) -> None:
    attempt = make_attempt(series)
    add_event(attempt, called(T0 + SECOND // 2, 2, "start_mission", 1))
    message = {"gs_session": 7, "seq": 2, "executor_session": 9, "deadline_ms": 9000, "limit_s": 10.0}
    resume = CommandMessage(**message, command=Resume(bytes(16)))
    arm, sent = publish("fog1/commands", arm_command()), publish("fog1/drone1/commands", encode(resume))
    frames = [
        (T0, frame("gs", "cloud", arm, 1)),
        (T0 + SECOND, frame("gs", "cloud", sent, 9, sequence=len(arm))),
    ]
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames)
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert measured["frames_per_call"] == {"arm": 1.0, "start_mission": 1.0}
    assert {name: found["sent"] for name, found in measured["messages"]["commands"].items()} == {"arm": 1, "resume": 1}


def test_states_in_bundles_are_found_one_by_one(series: Series) -> None:
    attempt = make_attempt(series)
    states = [Battery(90), Groundspeed(1.5), Heading(90.0)]
    carried = fog_bundles((1, StampedState(state, 77, relay_stamp=5)) for state in states[:2])
    up = frame("uav1", "fog1", publish("drone1/states", encode(drone_bundle(states, 77))), 20)
    down = frame("cloud", "gs", publish("fog1/states", encode(carried[0])), 21, (1883, 7))
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(T0 + SECOND, up)])
    write_pcap(attempt.path / "pcap" / "cloud.pcap", [(T0 + 2 * SECOND, down)])
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0 + 2 * SECOND + 1, down)])
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["states_sent"], measured["message_loss"]["states"]) == (3, pytest.approx(1 / 3))


def test_attempts_of_several_revisions_have_no_common_one(series: Series) -> None:
    make_attempt(series)
    make_attempt(series, number=2, revision={"commit": "c0ffee", "dirty": True})
    assert measure_series(series)["revision"] == "c0ffee"
    make_attempt(series, number=3, revision={"commit": "decade", "dirty": False})
    assert measure_series(series)["revision"] is None


def test_a_series_never_mixes_conditions(series: Series) -> None:
    make_attempt(series)
    make_attempt(series, number=2, profile="lte")
    with pytest.raises(ResultsError, match=r"attempt-02: profile is lte, in the first attempt ideal"):
        measure_series(series)
