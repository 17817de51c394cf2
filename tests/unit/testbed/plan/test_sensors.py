"""Scenario 4's sensors: where they stand, and what their containers and missions are told."""

from __future__ import annotations

from mission.points import all_points
from net.link_plan import Gate
from testbed.fly.containers import services_of
from testbed.plan.fleets import standard_fleet
from testbed.plan.sensors import closed_links, gates_of, sensor_profiles, sensor_settings, sensor_words


def test_a_sensor_stands_at_its_drones_point_and_reaches_50_m() -> None:
    points = all_points()
    assert gates_of(standard_fleet()) == tuple(
        Gate(f"sense:uav{drone}", drone, point.latitude_deg, point.longitude_deg, 50.0)
        for drone, point in points.items()
    )


def test_every_gate_is_a_link() -> None:
    links = {link.name for link in standard_fleet().topology(sensors=True).links}
    assert closed_links(gates_of(standard_fleet())).keys() == {name for name in links if name.startswith("sense:")}


def test_mavlinks_sensors_publish_to_plain_brokers_and_mqttxts_to_the_uav_clients() -> None:
    plain, carried = sensor_settings(standard_fleet(), "mavlink", 5), sensor_settings(standard_fleet(), "mqttxt", 5)
    assert (plain["SENSOR_FLAG"], plain["SENSORS_FLAG"]) == ("--plain", "")
    assert carried["SENSOR_FLAG"] == ""
    assert carried["SENSORS_FLAG"].startswith("--sensors 0.0.0.0:1883 ")
    same = ("SAMPLES", "SENSOR_NODES", "SENSOR_LINKS")
    assert {name: plain[name] for name in same} == {name: carried[name] for name in same}
    assert "sensor2=198.19.21.130,198.19.21.131" in plain["SENSOR_NODES"].split()
    assert "uav2-sensor2" in plain["SENSOR_LINKS"].split()


def test_only_mavlinks_mission_listens_at_a_broker_of_the_sensors_own() -> None:
    assert sensor_words(standard_fleet(), "mqttxt", 7)[:2] == ["--samples", "7"]
    assert sensor_words(standard_fleet(), "mavlink", 7)[-2:] == ["--sensor-broker", "mqtt://198.18.1.3:1883"]


def test_nothing_of_the_sensors_runs_in_other_scenarios() -> None:
    for protocol in ("mqttxt", "mavlink"):
        without, beside = services_of((protocol,)), services_of((protocol, *sensor_profiles(protocol)))
        assert not [name for name in without if name.startswith(("sensor", "meter", "bridge"))]
        more = 12 if protocol == "mqttxt" else 21
        assert len(beside) - len(without) == more
