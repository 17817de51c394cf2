"""Topics: built and parsed in one place, numbers and prefixes as section 2 says."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mqttxt.errors import ConfigurationError, PayloadError
from mqttxt.protocol.names import check_prefix, in_fleet, parse_in_fleet
from mqttxt.protocol.topics import CloudSide, DroneTopic, FogSide, FogTopic, StationTopic, station_reachable
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


@pytest.mark.parametrize(
    "prefix", ["a//b", "+/", "#", "$SYS/", "/", "a/+/b", "a\0", "a\n/", "\udc80/", "\u200b/", "é" * 128 + "/"]
)
def test_a_prefix_that_mqtt_could_not_carry_is_refused(prefix: str) -> None:
    with pytest.raises(ConfigurationError, match="topic prefix"):
        check_prefix(prefix)


@pytest.mark.parametrize("prefix", ["fog1/", "fog1/local/", "acme/fog7", "gs/", "acme/gs/eu"])
def test_a_prefix_that_leads_topics_of_a_fleet_is_refused(prefix: str) -> None:
    """R2.2: below it a fleet's topics would be another one's too."""
    with pytest.raises(ConfigurationError, match="leads topics of a fleet"):
        check_prefix(prefix)


LEVELS = st.sampled_from(["acme", "fleet", "drone1", "state", "local", "commands", "fog", "fog0", "GS", "é"])
PREFIXES = st.lists(LEVELS, max_size=3).map(lambda levels: check_prefix("/".join(levels)))


@given(PREFIXES, PREFIXES, st.integers(1, 3), st.integers(1, 3))
def test_no_filter_of_one_fleet_has_a_topic_of_another(one: str, other: str, fog: int, drone: int) -> None:
    """R2.2: also where one prefix is the beginning of the other."""
    assume(one != other)
    cloud, theirs = CloudSide(fog, one), CloudSide(drone, other)
    shared = FogSide(cloud.local_root())
    filters = (
        *(*cloud.station_filters(signed=True), *cloud.activator_command_filters()),
        *(*cloud.activator_filters(signed=True), *shared.activator_filters(), cloud.revoked, shared.revoked),
        *(station_reachable("fog1", one), shared.commands(drone)),
    )
    topics = (
        *(theirs.reachable, theirs.broadcast, theirs.init_connect, theirs.revoked, theirs.states, theirs.clock),
        *(theirs.drone_commands(drone), theirs.drone_state(drone, "home"), theirs.drone_result(drone, "arm")),
        *(theirs.select("goto"), theirs.fog_result("arm"), theirs.drone_sensor(drone, 1, "temperature")),
        *(theirs.drone_state(drone, "mavlink/VFR_HUD"), theirs.drone_control(drone), theirs.drone_bulk(drone)),
        *(station_reachable("fog1", other), FogSide(theirs.local_root()).commands(drone)),
    )
    assert [(wanted, topic) for wanted in filters for topic in topics if matches(wanted, topic)] == []


@given(PREFIXES, st.integers(1, 250))
def test_a_name_with_its_fleet_comes_back_as_it_was_written(prefix: str, number: int) -> None:
    """R2.4."""
    fleet = prefix.removesuffix("/")
    assert parse_in_fleet("drone", in_fleet(fleet, number), 250) == (fleet, number)


@pytest.mark.parametrize(
    "text", ["", "/1", "acme/", "acme/0", "acme/251", "acme//1", "#/1", "acme/1/x", "acme/٣", "01", "gs/1", "fog1/1"]
)
def test_what_names_no_drone_of_a_fleet_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError):
        parse_in_fleet("--drone", text, 250)


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
