"""Metrics of attempts on shaped links, counted by hand: causes, times, sizes, load, and what is said beside them."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import Presence
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery
from mqttxt.protocol.values import Encoding
from testbed.fly.results import Attempt, Series, write_json
from testbed.numbers.metrics import measure_series
from tests.handmade.attempts import (
    SECOND,
    T0,
    add_event,
    arm_command,
    called,
    frame,
    make_attempt,
    publish,
    write_lines,
    write_only,
    write_pcap,
)
from tests.handmade.mavlink_attempts import (
    HOP,
    MS,
    armed,
    long_command,
    make_mavlink_attempt,
    mission,
    packed,
    sender,
)

pytestmark = pytest.mark.long

HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)
BATTERY = common.MAVLink_battery_status_message(0, 1, 1, 300, [4000] * 10, 100, 1, 1, 90)


def measured(series: Series, protocol: str = "mqttxt") -> dict[str, Any]:
    (found,) = measure_series(series)["protocols"][protocol]["attempts"]
    assert isinstance(found, dict)
    return found


def write_links(attempt: Attempt, **files: Any) -> None:
    folder = attempt.path / "links"
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        if isinstance(content, list):
            write_lines(folder / f"{name}.jsonl", content)
        else:
            write_json(folder / f"{name}.json", content)


def counters(void: str | None = None, **links: dict[str, int]) -> dict[str, Any]:
    named = {name.replace("_", ":"): {"entered": 9, "left": 8, **counts} for name, counts in links.items()}
    return {"version": 1, "shaper": "nfqueue", "profile": "lossy", "links": named, "late_ms": None, "void": void}


def test_without_a_shaper_the_cause_of_a_loss_is_unknown(series: Series) -> None:
    make_attempt(series)  # loses one frame on air:uav1:up, and one on wan:gs:up before the mission
    losses = measured(series)["losses"]
    one = {"random": 0, "queue": 0, "closed": 0, "overload": 0, "corrupted": 0, "unknown": 1, "captured": 1, "open": 0}
    assert losses["links"] == {"air:uav1:up": one, "wan:gs:up": one}
    assert (losses["unknown"], losses["captured"], losses["random"]) == (2, 2, 0)


def test_causes_are_the_shapers_and_both_counts_stand_beside_each_other(series: Series) -> None:
    attempt = make_attempt(series)
    write_links(attempt, counters=counters(air_uav1_up={"queue": 1}, wan_gs_up={"random": 3}))
    found = measured(series)
    assert (found["losses"]["queue"], found["losses"]["random"], found["losses"]["unknown"]) == (1, 3, 0)
    assert found["losses"]["captured"] == 2
    assert found["notes"] == []  # two frames may be the first and the last


def test_where_shaper_and_captures_disagree_it_is_said(series: Series) -> None:
    attempt = make_attempt(series)
    write_links(attempt, counters=counters(wan_gs_up={"random": 4}))
    found = measured(series)
    assert found["notes"] == ["wan:gs:up: the shaper counts 4 frames lost, the captures 1"]
    assert found["losses"]["links"]["air:uav1:up"]["unknown"] == 1


def test_frames_that_were_under_way_at_the_end_may_be_lost_or_not(series: Series) -> None:
    attempt = make_attempt(series)
    frames = [(T0, frame("gs", "cloud", publish("fog1/reachable", b"1"), 1))]
    end = T0 + 10 * SECOND  # the mission's last event
    late = [(end - SECOND // n, frame("gs", "cloud", publish("fog1/reachable", b"1"), 1 + n)) for n in (2, 3, 4, 5, 6)]
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames + late)
    write_pcap(attempt.path / "pcap" / "cloud.pcap", [(T0 + SECOND, frames[0][1])])
    write_links(attempt, counters=counters(wan_gs_up={"queue": 5}))
    found = measured(series)
    link = found["losses"]["links"]["wan:gs:up"]
    assert (link["queue"], link["captured"], link["open"], link["unknown"]) == (5, 0, 5, 0)
    assert not any("shaper counts" in note for note in found["notes"])


def test_what_the_probes_lost_is_not_the_missions(series: Series) -> None:
    attempt = make_attempt(series)
    probe = bytearray(frame("gs", "cloud", b"probe", 40, (5005, 5006)))
    gs = attempt.path / "pcap" / "gs.pcap"
    write_pcap(gs, [(T0 - 2 * SECOND, bytes(probe)), (T0, frame("gs", "cloud", publish("fog1/reachable", b"1"), 1))])
    found = measured(series)
    assert found["before_mission"] == {"packets": 0, "bytes": 0, "other": 1}
    calibration = {"version": 1, "links": {"wan:gs:up": {}}, "off": []}
    write_links(attempt, calibration=calibration, counters=counters(wan_gs_up={"queue": 50, "random": 1}))
    assert "losses by cause have those of the links' probes in them" in measured(series)["notes"]
    at_start = {"wan:gs:up": {"queue": 50}}
    write_links(
        attempt,
        counters=counters(wan_gs_up={"queue": 50, "random": 1}) | {"at_start": at_start},
        events=[{"t_ns": T0 - SECOND, "event": "start"}],
    )
    after = measured(series)
    assert (after["losses"]["queue"], after["losses"]["random"]) == (0, 1)
    assert after["losses"]["links"]["wan:gs:up"]["captured"] == 1
    assert not any("probes" in note or "shaper counts" in note for note in after["notes"])


def test_a_shaper_that_did_not_keep_up_makes_both_attempts_of_the_number_void(series: Series) -> None:
    attempt = make_attempt(series)
    write_links(attempt, counters=counters("the emulator did not keep up: 31.0 ms late at p99"))
    chain = armed()
    make_mavlink_attempt(series, 1, chain, mission(chain, [called(T0 - 500, 1, "arm", 1)]), 9.0)
    make_attempt(series, number=2)
    sides = measure_series(series)["protocols"]
    late = "the emulator did not keep up: 31.0 ms late at p99"
    assert sides["mqttxt"]["void"] == [{"attempt": 1, "reason": late}]
    assert sides["mavlink"]["void"] == [{"attempt": 1, "reason": "mqttxt was void in the same attempt"}]
    assert [one["attempt"] for one in sides["mqttxt"]["attempts"]] == [2]


def test_what_the_probes_measured_and_what_changed_links_is_carried_over(series: Series) -> None:
    attempt = make_attempt(series)
    probed = {"delay_ms": {"configured": 45.0, "measured": 45.2}}
    write_links(
        attempt,
        calibration={"version": 1, "profile": "lte", "links": {"air:uav1:up": probed}, "off": []},
        events=[
            {"t_ns": T0 - 5, "event": "start"},
            {"t_ns": T0 + SECOND // 2, "link": "air:uav1:up", "change": {"loss": 0.2}, "cause": "hand"},
            {"t_ns": T0 + SECOND, "link": "air:uav1:up", "change": None, "cause": "hand"},
        ],
    )
    found = measured(series)
    assert found["links_measured"] == {"air:uav1:up": probed}
    assert found["links_events"] == [
        {"t_s": 0.5, "link": "air:uav1:up", "change": {"loss": 0.2}, "cause": "hand"},
        {"t_s": 1.0, "link": "air:uav1:up", "change": None, "cause": "hand"},
    ]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("counters.json", "{", "links/counters.json: not JSON"),
        ("counters.json", '{"links": 3}', "links/counters.json: links: expected an object for each link"),
        ("calibration.json", "[]", "links/calibration.json: expected an object"),
        ("events.jsonl", '{"link": 1}\n', "links/events.jsonl, line 1: expected an event with t_ns"),
    ],
)
def test_a_damaged_file_of_the_links_is_a_line_and_the_rest_is_measured(
    series: Series, name: str, text: str, said: str
) -> None:
    attempt = make_attempt(series)
    (attempt.path / "links").mkdir(exist_ok=True)
    (attempt.path / "links" / name).write_text(text)
    found = measured(series)
    assert found["packets"] == 7
    (note,) = found["notes"]
    assert note.startswith(said)


def test_delays_by_the_applications_stand_beside_the_captures(series: Series) -> None:
    attempt = make_attempt(series)  # the call is 500 ns before the command leaves, its first word comes after 9 ms
    log = attempt.path / "sitl" / "uav1.jsonl"
    took = {"t_ns": T0 + 3 * MS, "event": "command", "command": 400, "params": [1.0], "arrived_ns": T0 + 2_699_500}
    log.write_text(json.dumps(took) + "\n" + log.read_text())
    heard = {"t_ns": T0 + 4 * SECOND + 3 * MS, "event": "state", "drone": 1, "name": "battery", "age_ms": 40}
    add_event(attempt, heard)
    found = measured(series)
    assert found["delay_ms"] == {"arm": [2.5]}
    assert found["delay_app_ms"] == {"arm": [9.001]}
    assert found["delay_received_ms"] == {"arm": [2.7]}
    assert found["receipts"] == {"calls": 1, "doubled": 0, "late": 0}
    one = {"n": 1, "p99": None}
    assert found["state_delay_ms"] == {
        "battery": {
            "captures": {**one, "mean": 2.5, "p50": 2.5, "p90": 2.5, "max": 2.5},
            "app": {**one, "mean": 40.0, "p50": 40.0, "p90": 40.0, "max": 40.0},
        }
    }


def test_each_message_kind_has_its_frames_size_and_what_its_acknowledgement_costs(series: Series) -> None:
    attempt = make_attempt(series)
    body = publish("fog1/commands", arm_command())
    size = 54 + len(body)
    arrived = T0 + MS // 2
    bare = frame("cloud", "gs", b"", 30, (1883, 40_000))  # what the kernel answers the command with
    command = frame("gs", "cloud", body, 1)
    write_only(attempt, gs=[(T0, command), (arrived + MS, bare)], cloud=[(arrived, command), (arrived + 100, bare)])
    found = measured(series)
    assert found["message_sizes"] == {
        "arm": {"n": 1, "mean": size, "min": size, "max": size, "share": size, "ack_bytes": 54.0}
    }
    assert found["purposes"] == {
        "acknowledgement": {"bytes": 54, "packets": 1},
        "command": {"bytes": size, "packets": 1},
    }
    assert found["size_histogram"] == {"40-79": 1, "80-159": 1}


def test_messages_that_share_a_frame_share_its_bytes(series: Series) -> None:
    attempt = make_attempt(series)
    one, other = publish("drone1/state/battery", b"\x01" * 10), publish("drone1/commands_result/arm", b"\x02" * 30)
    both = frame("uav1", "fog1", one + other, 1)
    write_only(attempt, uav1=[(T0, both)])
    found = measured(series)
    assert len(both) == 54 + len(one) + len(other)
    first = len(both) * len(one) // (len(one) + len(other))
    assert found["purposes"] == {
        "result": {"bytes": len(both) - first, "packets": 0},  # the frame itself counts for its first message
        "state": {"bytes": first, "packets": 1},
    }
    sizes = found["message_sizes"]
    assert sizes["battery"]["mean"] == sizes["arm result"]["mean"] == len(both)
    assert sizes["battery"]["share"] + sizes["arm result"]["share"] == pytest.approx(len(both))


def test_load_is_what_crosses_each_drones_air_link_second_by_second(series: Series) -> None:
    chain = armed((1, 4))
    for drone, at in ((1, SECOND), (1, SECOND + MS), (4, 3 * SECOND)):
        chain.send(T0 + at, packed(sender(drone), HEARTBEAT), drone, up=True)
    make_mavlink_attempt(series, 1, chain, mission(chain, [called(T0 - 500, 1, "arm", 1)]), 3.5)
    found = measured(series, "mavlink")
    heartbeat, command = 63, 86
    assert found["load"] == {
        "fog1": {"uav1": [command, 2 * heartbeat, 0, 0]},
        "fog2": {"uav4": [0, 0, 0, heartbeat]},
        "total": [command, 2 * heartbeat, 0, heartbeat],
    }
    # and over each kind of link, all of them together
    assert found["traffic"] == {kind: [command, 2 * heartbeat, 0, heartbeat] for kind in ("air", "backhaul", "wan")}
    assert found["window"] == {"start_ns": T0, "seconds": 3.5}


def test_messages_are_counted_by_name_and_drone(series: Series) -> None:
    chain = armed((1, 2))
    chain.send(T0 + MS, packed(sender(245, 190), long_command(400, 2, 1.0)), 2, up=False, lost_on="uav2")
    links = {drone: sender(drone) for drone in (1, 2)}
    for drone, lost_on in ((1, None), (1, "gs"), (2, None)):
        chain.send(T0 + SECOND, packed(links[drone], BATTERY), drone, up=True, lost_on=lost_on)
    calls = [called(T0 - 500, 1, "arm", 1), called(T0 + MS - 500, 2, "arm", 2), called(T0 + 2 * SECOND, 3, "land", 1)]
    make_mavlink_attempt(series, 1, chain, mission(chain, calls), 9.0)
    messages = measured(series, "mavlink")["messages"]
    none = {"sent": 1, "lost": 0, "open": 0}
    lost = {"sent": 1, "lost": 1, "open": 0}
    assert messages["commands"] == {
        "arm": {**{"sent": 2, "lost": 1, "share": 0.5, "below": None, "open": 0}, "drones": {"1": none, "2": lost}},
        # no frame of it ever left the station: lost too
        "land": {**{"sent": 1, "lost": 1, "share": 1.0, "below": None, "open": 0}, "drones": {"1": lost}},
    }
    assert messages["states"]["battery"]["drones"] == {"1": {"sent": 2, "lost": 1, "open": 0}, "2": none}


def test_a_call_whose_command_stayed_in_the_senders_queue_is_lost(series: Series) -> None:
    attempt = make_attempt(series)
    add_event(attempt, called(T0 + SECOND, 2, "land"))
    found = measured(series)
    assert found["messages"]["commands"]["land"]["lost"] == 1
    assert (found["commands_sent"], found["message_loss"]["commands"]) == (2, 0.5)
    assert found["frames_per_call"] == {"arm": 1.0, "land": 0.0}


def test_a_state_that_was_under_way_when_the_captures_ended_is_open_and_not_lost(series: Series) -> None:
    chain, drone = armed(), sender(1)
    chain.send(T0 + SECOND, packed(drone, HEARTBEAT), 1, up=True)  # takes two and a half hops
    chain.send(T0 + 2 * SECOND, packed(drone, HEARTBEAT), 1, up=True, lost_on="gs")
    chain.send(T0 + 10 * SECOND - HOP, packed(drone, HEARTBEAT), 1, up=True, lost_on="cloud")
    make_mavlink_attempt(series, 1, chain, mission(chain, [called(T0 - 500, 1, "arm", 1)]), 10.0)
    mode = measured(series, "mavlink")["messages"]["states"]["flight_mode"]
    assert (mode["sent"], mode["lost"], mode["open"]) == (3, 1, 1)


def test_a_state_that_its_fog_still_held_when_the_ground_station_left_is_open_and_not_lost(series: Series) -> None:
    attempt = make_attempt(series)
    state = encode_state(StampedState(Battery(80), 9999), Encoding.CBOR)
    held = frame("uav1", "fog1", publish("drone1/state/battery", state), 21, (40_001, 1883))
    left = frame("gs", "cloud", publish("gs/g/reachable", encode(Presence(session=1, up=False))), 22, (40_002, 1883))
    write_pcap(attempt.path / "pcap" / "uav1.pcap", [(T0 + 6 * SECOND - MS, held)], append=True)
    write_pcap(attempt.path / "pcap" / "fog1.pcap", [(T0 + 6 * SECOND, held)], append=True)
    assert measured(series)["messages"]["states"]["battery"]["lost"] == 1  # the station listened for seconds more
    write_pcap(attempt.path / "pcap" / "gs.pcap", [(T0 + 6 * SECOND, left)], append=True)
    battery = measured(series)["messages"]["states"]["battery"]
    assert (battery["sent"], battery["lost"], battery["open"]) == (2, 0, 1)


def test_retransmissions_are_counted_by_link(series: Series) -> None:
    attempt = make_attempt(series)
    body = publish("fog1/commands", arm_command())
    frames = [(T0, frame("gs", "cloud", body, 1)), (T0 + SECOND, frame("gs", "cloud", body, 2))]
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames)
    write_pcap(attempt.path / "pcap" / "cloud.pcap", [(t + MS, data) for t, data in frames])
    found = measured(series)
    size = 54 + len(body)
    assert found["retransmissions"] == {"packets": 1, "bytes": size, "needless": 1, "links": {"wan:gs:up": 1}}


def test_a_clock_that_was_set_back_makes_the_attempt_void(series: Series) -> None:
    attempt = make_attempt(series)
    events = attempt.path / "events.jsonl"
    first, *rest = events.read_text().splitlines()
    late = json.loads(first) | {"t_ns": T0 + 2 * SECOND - 500}
    events.write_text("\n".join([json.dumps(late), *rest]) + "\n")
    make_attempt(series, number=2)
    side = measure_series(series)["protocols"]["mqttxt"]
    assert side["void"] == [
        {"attempt": 1, "reason": "the clock was set back by 2.000 s during the attempt (events.jsonl)"}
    ]
    assert len(side["attempts"]) == 1


def test_a_clock_that_was_set_back_shows_in_the_captures_too(series: Series) -> None:
    attempt = make_attempt(series)
    frames = [(T0 + 3 * SECOND, frame("gs", "cloud", b"", 1)), (T0, frame("gs", "cloud", b"", 2))]
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames)
    make_attempt(series, number=2)
    (void,) = measure_series(series)["protocols"]["mqttxt"]["void"]
    assert void["reason"] == "the clock was set back by 3.000 s during the attempt (gs.pcap)"


def test_foreign_traffic_is_said_and_counted_apart(series: Series) -> None:
    attempt = make_attempt(series)
    stranger = bytearray(frame("gs", "cloud", b"hello", 1))
    stranger[26:30] = bytes([10, 0, 0, 1])  # an address that no node has
    ssh = frame("gs", "cloud", b"hello", 2, (40_000, 22))
    frames = [(T0 + n, data) for n, data in enumerate((frame("gs", "cloud", b"", 3), bytes(stranger), ssh))]
    write_pcap(attempt.path / "pcap" / "gs.pcap", frames)
    write_pcap(attempt.path / "pcap" / "cloud.pcap", [(t + MS, data) for t, data in frames])
    found = measured(series)
    assert found["notes"][:2] == [
        "frames from or to addresses of no node are not counted: 2 mqtt",
        "1 frames on links are of no message of the experiment",
    ]
