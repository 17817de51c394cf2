"""Scenario 4's sensors: where they stand, and what their containers and missions are told."""

from __future__ import annotations

from pathlib import Path

import pytest

from mission.points import all_points
from testbed.errors import UserError
from testbed.fly.containers import services_of
from testbed.plan.profiles.run_plan import Gate
from testbed.plan.sensors import closed_links, read_gates, sensor_profiles, sensor_settings, sensor_words
from testbed.plan.topology import read_topology


def test_a_sensor_stands_at_its_drones_point_and_reaches_50_m() -> None:
    points = all_points()
    assert read_gates() == tuple(
        Gate(f"sense:uav{drone}", drone, point.latitude_deg, point.longitude_deg, 50.0)
        for drone, point in points.items()
    )


def test_every_gate_is_a_link() -> None:
    links = {link.name for link in read_topology(sensors=True).links}
    assert closed_links(read_gates()).keys() == {name for name in links if name.startswith("sense:")}


@pytest.mark.parametrize("text", ["", "range_m: near\npoints: {}", "range_m: 50\npoints: {1: {latitude_deg: 47}}"])
def test_a_file_without_points_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "points.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=r"points\.yaml: expected range_m and points: "):
        read_gates(path)


def test_mavlinks_sensors_publish_to_plain_brokers_and_mqttxts_to_the_uav_clients() -> None:
    plain, carried = sensor_settings("mavlink", 5), sensor_settings("mqttxt", 5)
    assert (plain["SENSOR_FLAG"], plain["SENSORS_FLAG"]) == ("--plain", "")
    assert carried["SENSOR_FLAG"] == ""
    assert carried["SENSORS_FLAG"].startswith("--sensors 0.0.0.0:1883 ")
    same = ("SAMPLES", "SENSOR_NODES", "SENSOR_LINKS")
    assert {name: plain[name] for name in same} == {name: carried[name] for name in same}
    assert "sensor2=198.18.32.2,198.18.32.3" in plain["SENSOR_NODES"].split()
    assert "uav2-sensor2" in plain["SENSOR_LINKS"].split()


def test_only_mavlinks_mission_listens_at_a_broker_of_the_sensors_own() -> None:
    assert sensor_words("mqttxt", 7)[:2] == ["--samples", "7"]
    assert sensor_words("mavlink", 7)[-2:] == ["--sensor-broker", "mqtt://198.18.1.3:1883"]


def test_nothing_of_the_sensors_runs_in_other_scenarios() -> None:
    for protocol in ("mqttxt", "mavlink"):
        without, beside = services_of((protocol,)), services_of((protocol, *sensor_profiles(protocol)))
        assert not [name for name in without if name.startswith(("sensor", "meter", "bridge"))]
        more = 12 if protocol == "mqttxt" else 21
        assert len(beside) - len(without) == more
