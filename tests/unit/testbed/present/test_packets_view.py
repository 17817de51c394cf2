"""`testbed packets`: the right frames, what they say, dissected in full, counted by kind; mistakes in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common
from scapy.layers.l2 import Ether
from typer.testing import CliRunner, Result

from mqttxt.protocol.messages import BeaconMessage, CommandMessage, Presence
from mqttxt.protocol.rankings import SelectMessage
from mqttxt.protocol.topic_table import CLOUD_SIDE, FOG_SIDE, SENSOR_SIDE
from mqttxt.protocol.topics import REVOKED
from testbed.cli import packets as cli
from testbed.cli.commands import app
from testbed.errors import UserError
from testbed.fly.results import Series, point_latest
from testbed.numbers.dissect import mqtt5
from testbed.present.packets_view.choice import find_attempts
from testbed.present.packets_view.dissected import dissect
from testbed.present.packets_view.words import payload_class, said_by_publish
from tests.handmade.attempts import SECOND, T0, frame, make_attempt, publish
from tests.handmade.mavlink_attempts import Chain, long_command, make_mavlink_attempt, packed, sender, stream_message


def call(*words: object) -> Result:
    return CliRunner().invoke(app, ["packets", *map(str, words)])


@pytest.fixture
def mqtt_series(tmp_path: Path) -> Series:
    series = Series(tmp_path / "scenario-1" / "thesis-ideal" / "20260101T000000Z")
    make_attempt(series)
    return series


@pytest.fixture
def mavlink_series(tmp_path: Path) -> Series:
    """Drone 3 is armed at T0; its ACK comes back with a heartbeat; one heartbeat is lost on the air link."""
    series = Series(tmp_path / "scenario-1" / "thesis-ideal" / "20260101T000001Z")
    chain = Chain((3,))
    station, drone = sender(245, 190), sender(3)
    chain.send(T0, packed(station, long_command(400, 3, 1.0)), 3, up=False)
    answer = common.MAVLink_command_ack_message(400, 0)
    beat = common.MAVLink_heartbeat_message(2, 12, 0x81, 0x40000, 4, 3)
    chain.send(T0 + SECOND // 100, packed(drone, answer) + packed(drone, beat), 3, up=True)
    chain.send(T0 + SECOND, packed(drone, beat), 3, up=True, lost_on="fog1")
    chain.send(T0 + SECOND * 2, packed(drone, stream_message("ATTITUDE", 7)), 3, up=True)
    asked = {"t_ns": T0 - 5, "event": "command", "call": 1, "command": "arm", "fog": None, "drone": 3}
    make_mavlink_attempt(series, 1, chain, [asked], disarmed_s=3.0)
    return series


def test_frames_of_a_link_are_listed_with_what_they_say(mqtt_series: Series) -> None:
    done = call(mqtt_series.path, "--link", "air:uav1")
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert lines[0].endswith("mqttxt/attempt-01")
    assert lines[1].split() == ["t", "[s]", "link", "bytes", "protocol", "kind", "left", "[ms]", "says"]
    assert lines[2].split()[:6] == ["0.002000", "air:uav1:down", "86", "mqtt", "publish", "0.500"]
    assert 'drone1/commands {"version":1,"gs_session":7,"seq":1,' in lines[2]
    assert lines[3].split()[:6] == ["4.000000", "air:uav1:up", "85", "mqtt", "publish", "0.500"]
    assert 'drone1/state/battery {"stamp":1234,"remaining_pct":90}' in lines[3]
    assert lines[4].split() == ["5.000000", "air:uav1:up", "54", "mqtt", "-", "lost"]


def test_messages_are_counted_by_kind_on_every_link_that_they_cross(mqtt_series: Series) -> None:
    done = call(mqtt_series.path, "--summary", "--from", "0")
    assert done.exit_code == 0, done.output
    assert "publish" in done.output
    row = next(line.split() for line in done.output.splitlines() if "publish" in line)
    assert row[:3] == ["mqtt", "publish", "6"]
    assert row[-1] == "1.20"  # 6 in the 5 s until the last frame
    assert "7 frames, " in done.output
    assert "1 lost, in 5.000 s" in done.output
    assert "in 1 of them (54 bytes) no message begins" in done.output


def test_only_the_asked_time_and_way_are_shown_and_rates_are_of_that_time(mqtt_series: Series) -> None:
    done = call(mqtt_series.path, "--link", "air:uav1:up", "--from", "3.5", "--to", "4.5")
    assert [line.split()[:2] for line in done.output.splitlines() if "air:" in line] == [["4.000000", "air:uav1:up"]]
    assert "1 frames, 85 bytes with all headers, 0 lost, in 1.000 s" in done.output


def test_a_mavlink_message_is_told_by_its_fields(mavlink_series: Series) -> None:
    done = call(mavlink_series.path / "mavlink" / "attempt-01", "--link", "air:uav3")
    assert done.exit_code == 0, done.output
    rows = [line for line in done.output.splitlines() if "air:" in line]
    assert rows[0].split()[:6] == ["0.002000", "air:uav3:down", "86", "mavlink", "COMMAND_LONG", "0.500"]
    assert "245:190 target_system=3 target_component=1 command=MAV_CMD_COMPONENT_ARM_DISARM param1=1" in rows[0]
    assert rows[1].split()[4:7] == ["COMMAND_ACK", "+1", "0.500"]
    assert "3:1 command=MAV_CMD_COMPONENT_ARM_DISARM result=MAV_RESULT_ACCEPTED; 3:1 type=MAV_TYPE_ …" in rows[1]
    assert rows[2].split()[4:6] == ["HEARTBEAT", "lost"]


def test_a_kind_is_found_in_any_place_of_a_frame(mavlink_series: Series) -> None:
    done = call(mavlink_series.path, "--link", "air", "--kind", "heartbeat")
    rows = [line.split() for line in done.output.splitlines() if "air:" in line]
    assert [row[4] for row in rows] == ["COMMAND_ACK", "HEARTBEAT"]
    counted = [line.split()[:3] for line in done.output.splitlines() if line.startswith(" mavlink")]
    assert counted == [["mavlink", "HEARTBEAT", "2"]]


def test_the_first_frames_are_dissected_in_full(mavlink_series: Series, mqtt_series: Series) -> None:
    done = call(mavlink_series.path, "--link", "air:uav3:up", "--show", "1")
    assert done.exit_code == 0, done.output
    for text in (
        "air:uav3:up  77 bytes, uav3:14543>fog1:14543, 0.500 ms on the link",
        "###[ Ethernet ]###",
        "src       = 198.18.23.3",
        "dport     = 14543",
        "###[ MAVLink 2 ]###",
        "###[ COMMAND_ACK ]###",
        "result    = 0 (MAV_RESULT_ACCEPTED)",
        "###[ HEARTBEAT ]###",
        "… and 2 more",
    ):
        assert text in done.output
    done = call(mqtt_series.path, "--link", "wan", "--kind", "publish", "--show", "2")
    assert done.output.count("###[ MQTT PUBLISH ]###") == 2
    assert 'fog1/drone1/state/battery: {"relay_stamp":5,"stamp":1234,"remaining_pct":90}' in done.output


def test_all_attempts_of_a_series_are_shown_and_none_matching_is_said(
    mqtt_series: Series, mavlink_series: Series
) -> None:
    (mavlink_series.path / "mavlink").rename(mqtt_series.path / "mavlink")
    done = call(mqtt_series.path, "--protocol", "mqtt", "--summary")
    assert done.exit_code == 0
    assert done.output.count("attempt-01") == 2
    assert done.output.splitlines()[1] == "  no frame matches"  # mavlink comes first


def test_latest_is_the_newest_series_of_all_experiments(
    tmp_path: Path, mqtt_series: Series, mavlink_series: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    point_latest(mavlink_series)
    monkeypatch.setattr(cli, "RESULTS", tmp_path)
    assert "COMMAND_LONG" in call("latest").output
    (attempt,) = find_attempts(str(tmp_path / "scenario-1" / "latest"), tmp_path)
    assert (attempt.protocol, attempt.number) == ("mavlink", 1)
    with pytest.raises(UserError, match="latest: no results in"):
        find_attempts("latest", tmp_path / "nothing")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--link", "air:uav9"), "--link air:uav9: expected one of wan:gs:up, wan:gs:down, backhaul:fog1:up"),
        (("--kind", "HEARTBEET"), "--kind HEARTBEET: expected one of publish"),
        (("--protocol", "amqp"), "--protocol amqp: expected one of mqtt"),
        (("--from", "3", "--to", "2"), "--from 3 --to 2: expected --from to be the earlier one"),
        (("--to", "nan"), "--to nan: expected seconds since the mission's start"),
        (("--show", "0"), "--show 0: expected a whole number from 1 on"),
        (("--rows", "-1"), "--rows -1: expected a whole number from 1 on"),
        (("--show", "1", "--summary"), "--show and --summary: expected one of them"),
    ],
)
def test_a_mistake_is_one_line(mqtt_series: Series, options: tuple[str, ...], said: str) -> None:
    done = call(mqtt_series.path, *options)
    assert done.exit_code == 2
    assert done.output.startswith(f"testbed: {said}")
    assert len(done.output.splitlines()) == 1


def test_a_folder_that_is_no_run_is_one_line(tmp_path: Path) -> None:
    done = call(tmp_path)
    assert (done.exit_code, len(done.output.splitlines())) == (2, 1)
    assert "expected a series (with <protocol>/attempt-NN in it), an attempt's folder, or latest" in done.output


def test_a_file_that_is_no_capture_is_one_line(mqtt_series: Series) -> None:
    (mqtt_series.path / "mqttxt" / "attempt-01" / "pcap" / "cloud.pcap").write_text("nothing of the kind")
    done = call(mqtt_series.path)
    assert (done.exit_code, len(done.output.splitlines())) == (2, 1)
    assert "cloud.pcap: not a capture" in done.output


def test_a_capture_that_is_cut_off_is_read_up_to_the_cut_and_it_is_said(mqtt_series: Series) -> None:
    pcap = mqtt_series.path / "mqttxt" / "attempt-01" / "pcap" / "uav1.pcap"
    pcap.write_bytes(pcap.read_bytes()[:-3])
    done = call(mqtt_series.path, "--link", "air:uav1")
    assert done.exit_code == 0
    assert done.output.splitlines()[1] == "cut off, read up to the cut: uav1.pcap"
    assert "5.000000" not in done.output


def test_a_segment_that_begins_within_a_packet_is_left_as_bytes() -> None:
    whole = publish("drone1/state/battery", b"\x30\x02ab" * 9)
    for body, kinds, found in (
        (whole, ["publish"], True),
        (whole + whole[:9], ["publish", "publish"], True),
        (whole[24:], [], False),
        (whole[24:] + b"\xc0\x00", ["pingreq"], False),
    ):
        packet = dissect(Ether(frame("uav1", "fog1", body, 1)), "mqtt", kinds)
        assert (mqtt5.Publish in packet) == found
        assert bytes(packet)[54:] == body


def test_every_topic_of_the_table_names_its_message() -> None:
    rows = [row for row in (*CLOUD_SIDE, *FOG_SIDE, *SENSOR_SIDE) if row.topic != REVOKED]  # its payload is DER
    for row in rows:
        topic = row.topic.replace("fogX", "fog1").replace("droneY", "drone2").replace("sensorS", "sensor3")
        for letter, name in (("/Z", "/battery"), ("/C", "/goto"), ("/K", "/temperature"), ("gs/G", "gs/me")):
            topic = topic.replace(letter, name) if letter == "gs/G" or topic.endswith(letter) else topic
        found = payload_class(topic)
        assert found is row.payload or (isinstance(row.payload, str) and found is not None), topic
    assert payload_class("fog1/commands") is CommandMessage
    assert payload_class("fog1/commands/goto") is SelectMessage
    assert payload_class("drone12/clock") is BeaconMessage
    assert payload_class("gs/me/reachable") is Presence
    assert payload_class("drone1/state/battery") is not payload_class("fog1/drone1/state/battery")
    assert payload_class("elsewhere") is None
    assert payload_class("fog1/drone1/state/unheard") is None


def test_a_payload_that_is_none_of_mqttxts_is_shown_as_bytes() -> None:
    assert said_by_publish("elsewhere", b"\x01\xff") == "01 ff"
    assert said_by_publish("drone1/clock", b"") == "empty"
    assert said_by_publish("drone1/state/battery", b"\0" * 30).endswith("… 30 bytes")
