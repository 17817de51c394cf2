"""Topics: built and parsed in one place, numbers and prefixes as section 2 says."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.errors import ConfigurationError, PayloadError
from mqttxt.protocol.topics import (
    CloudSide,
    DroneTopic,
    FogSide,
    FogTopic,
    StationTopic,
    check_prefix,
    station_reachable,
)
from tests.simulation.world import matches

DRONES = st.integers(1, 250)


@given(DRONES, st.sampled_from(["", "fog1/local/", "acme/"]))
def test_fog_side_topics_come_back_as_they_were_built(drone: int, root: str) -> None:
    side = FogSide(root)
    built = {
        side.reachable(drone): DroneTopic(drone, "reachable"),
        side.clock(drone): DroneTopic(drone, "clock"),
        side.init_connect(drone): DroneTopic(drone, "init_connect"),
        side.commands(drone): DroneTopic(drone, "commands"),
        side.state(drone, "battery"): DroneTopic(drone, "state", "battery"),
        side.commands_result(drone, "arm"): DroneTopic(drone, "commands_result", "arm"),
    }
    assert {topic: side.parse(topic) for topic in built} == built


@given(st.integers(1, 999), DRONES, st.sampled_from(["", "acme/", "a/b/"]))
def test_cloud_side_topics_come_back_as_they_were_built(fog: int, drone: int, prefix: str) -> None:
    side = CloudSide(fog, prefix)
    assert side.parse(side.reachable) == FogTopic("reachable")
    assert side.parse(side.broadcast) == FogTopic("commands")
    assert side.parse(side.fog_result("land")) == FogTopic("commands_result", "land")
    assert side.parse(side.drone_state(drone, "home")) == DroneTopic(drone, "state", "home")
    assert side.parse(side.drone_commands(drone)) == DroneTopic(drone, "commands")
    assert side.parse(station_reachable("me", prefix)) == StationTopic("me")


@pytest.mark.parametrize(
    "topic",
    [
        *("drone0/clock", "drone01/clock", "drone251/clock", "drone٣/clock", "drone/clock", "drone-1/clock"),
        *("drone1", "drone1/", "drone1/state", "drone1/state/", "drone1/state/a/b", "drone1/clock/x", "Drone1/clock"),
        *("", "/", "drone1/unknown", "fog1/drone1/clock", "drone1/state/ä", "drone1/state/mavlink/+"),
        f"drone1/commands_result/{'x' * 65}",
    ],
)
def test_what_is_no_topic_is_refused_with_a_reason(topic: str) -> None:
    with pytest.raises(PayloadError) as refusal:
        FogSide().parse(topic)
    assert refusal.value.kind == "topic"


@given(st.text(max_size=40))
def test_no_text_raises_anything_else(topic: str) -> None:
    for side in (FogSide(), CloudSide(1), CloudSide(2, "acme/")):
        try:
            side.parse(topic)
        except PayloadError:
            continue


@pytest.mark.parametrize("prefix", ["a//b", "+/", "#", "$SYS/", "/", "a/+/b"])
def test_a_prefix_that_mqtt_could_not_carry_is_refused(prefix: str) -> None:
    with pytest.raises(ConfigurationError, match="topic prefix"):
        check_prefix(prefix)


def test_a_prefix_ends_in_a_slash() -> None:
    assert check_prefix("acme") == check_prefix("acme/") == "acme/"


def test_no_topic_matches_two_filters_of_one_subscriber() -> None:
    """Two matching filters would deliver a command twice."""
    cloud, fog = CloudSide(1), FogSide()
    topics = [
        *(cloud.broadcast, cloud.drone_commands(3), cloud.reachable, cloud.clock, cloud.init_connect),
        *(
            cloud.fog_result("arm"),
            cloud.drone_result(3, "arm"),
            cloud.drone_state(3, "home"),
            cloud.drone_reachable(3),
        ),
        *(fog.reachable(3), fog.clock(3), fog.state(3, "home"), fog.commands_result(3, "arm")),
    ]
    subscribers = (
        cloud.station_filters(),
        cloud.activator_command_filters() + cloud.activator_filters(),
        fog.activator_filters(),
    )
    for filters in subscribers:
        for topic in topics:
            assert sum(matches(wanted, topic) for wanted in filters) <= 1, (topic, filters)
