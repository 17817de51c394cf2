"""Metrics of a MAVLink attempt whose answers were counted by hand."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from testbed.fly.results import Series
from testbed.numbers.metrics import measure_series
from tests.handmade.attempts import SECOND, T0, called, make_attempt
from tests.handmade.mavlink_attempts import (
    HOP,
    MS,
    Chain,
    armed,
    fill_streams,
    long_command,
    make_mavlink_attempt,
    mission,
    packed,
    sender,
)

pytestmark = pytest.mark.long

HEARTBEAT = common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3)
SEEN = 2 * HOP + HOP // 2
"""From leaving the one end to the capture of the last link at the other."""


def measured(
    series: Series, chain: Chain, calls: list[dict[str, Any]], disarmed_s: float = 9.0, routers: str = "per-uav"
) -> dict[str, Any]:
    make_mavlink_attempt(series, 1, chain, mission(chain, calls), disarmed_s, routers=routers)
    (found,) = measure_series(series)["protocols"]["mavlink"]["attempts"]
    assert isinstance(found, dict)
    return found


def test_every_number_of_a_tiny_attempt(series: Series) -> None:
    chain, drone, station = Chain(), sender(1), sender(245, 190)
    chain.send(T0 - SECOND, packed(drone, HEARTBEAT), 1, up=True)  # before the mission
    chain.send(T0 - MS, packed(station, long_command(400, 1, 0.0)), 1, up=False)  # disarms, and is no first command
    chain.send(T0, packed(station, long_command(400, 1, 1.0)), 1, up=False)
    chain.send(T0 + SECOND, packed(drone, HEARTBEAT), 1, up=True)
    chain.send(T0 + 2 * SECOND, packed(drone, HEARTBEAT), 1, up=True, lost_on="gs")
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])

    assert found["mission_s"] == 9.0
    heartbeat, command = 14 + 20 + 8 + 12 + 9, 14 + 20 + 8 + 12 + 32  # the confirmation's zero is not sent
    assert {name: (link["packets"], link["bytes"], link["lost"]) for name, link in found["links"].items()} == {
        "air:uav1:up": (2, 2 * heartbeat, 0),
        "backhaul:fog1:up": (2, 2 * heartbeat, 0),
        "wan:gs:down": (2, 2 * heartbeat, 1),
        # the command to disarm is still under way when the mission begins
        "wan:gs:up": (1, command, 0),
        "backhaul:fog1:down": (2, 2 * command, 0),
        "air:uav1:down": (2, 2 * command, 0),
    }
    assert (found["packets"], found["wire_loss"]) == (11, pytest.approx(1 / 11))
    assert found["layers"] == {
        **{"ethernet": 11 * 14, "ip": 11 * 20, "udp": 11 * 8, "mavlink": 11 * 12},
        "payload": 6 * 9 + 5 * 32,
    }
    assert (found["commands_sent"], found["states_sent"]) == (1, 2)
    assert found["message_loss"] == {"commands": 0.0, "states": 0.5}
    assert found["delay_ms"] == {"arm": [SEEN / MS]}
    assert found["frames_per_call"] == {"arm": 1.0}
    assert found["before_mission"]["packets"] == 3 + 1
    assert found["cpu_s"] == {"gs": 1.5, "router-gs": 0.25}
    assert found["mqtt"] == {}
    assert found["mavlink"]["streams"] == [
        {"name": "HEARTBEAT", "count": 2, "rate_hz": round(2 / 9, 3), "bytes": 2 * heartbeat, "mean_size": 63.0}
    ]
    assert found["mavlink"]["commands"] == [{"name": "COMMAND_LONG 400", "count": 1, "bytes": command}]
    assert found["mavlink"]["routers"] == [
        {"node": "cloud", "way": "up", "in": 2, "out": 2, "dropped": 0},
        {"node": "cloud", "way": "down", "in": 1, "out": 2, "dropped": 0},  # one had come before the mission
        {"node": "fog1", "way": "up", "in": 2, "out": 2, "dropped": 0},
        {"node": "fog1", "way": "down", "in": 2, "out": 2, "dropped": 0},
    ]


def test_what_a_router_drops_is_not_what_a_link_loses(series: Series) -> None:
    chain, drone = armed(), sender(1)
    for number in range(5):
        until = "cloud" if number in (1, 3) else None
        lost_on = "fog1" if number == 4 else None
        chain.send(T0 + (number + 1) * SECOND, packed(drone, HEARTBEAT), 1, up=True, until=until, lost_on=lost_on)
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])
    dropped = {(entry["node"], entry["way"]): entry for entry in found["mavlink"]["routers"]}
    assert dropped["cloud", "up"] == {"node": "cloud", "way": "up", "in": 4, "out": 2, "dropped": 2}
    assert dropped["fog1", "up"] == {"node": "fog1", "way": "up", "in": 4, "out": 4, "dropped": 0}
    assert {name: link["lost"] for name, link in found["links"].items() if link["lost"]} == {"air:uav1:up": 1}
    assert found["message_loss"]["states"] == 3 / 5


def test_a_drop_shows_although_the_same_bytes_come_again_after_256_messages(series: Series) -> None:
    chain, drone = armed(), sender(1)
    for number, until in enumerate((None, "cloud", None)):
        drone.seq = 7
        chain.send(T0 + (number + 1) * SECOND, packed(drone, HEARTBEAT), 1, up=True, until=until)
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])
    assert found["mavlink"]["routers"][0]["dropped"] == 1
    assert (found["states_sent"], found["message_loss"]["states"]) == (3, pytest.approx(1 / 3))


@pytest.mark.parametrize(("routers", "dropped"), [("shared", 2), ("per-uav", 0)])
def test_a_shared_router_owes_what_names_no_target_to_every_neighbour(
    series: Series, routers: str, dropped: int
) -> None:
    chain, station = Chain((1, 2, 3)), sender(245, 190)
    for number, body in enumerate((packed(station, long_command(400, 1, 1.0)), packed(station, HEARTBEAT))):
        at = T0 + number * SECOND
        chain.send(at, body, 1, up=False)
    again = packed(station, HEARTBEAT)
    chain.send(T0 + 2 * SECOND, again, 1, up=False)
    chain.send(T0 + 2 * SECOND + 2 * HOP, again, 2, up=False, since="fog1")
    chain.send(T0 + 2 * SECOND + 2 * HOP, again, 3, up=False, since="fog1")
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)], routers=routers)
    assert found["mavlink"]["routers"][3] == {"node": "fog1", "way": "down", "in": 3, "out": 5, "dropped": dropped}


def test_the_routers_own_heartbeats_are_told_apart(series: Series) -> None:
    chain, router = armed(), sender(231, 191)
    chain.send(T0 + SECOND, packed(router, HEARTBEAT, version_1=True), 1, up=True, until="fog1")
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])
    assert found["mavlink"]["own_heartbeats"] == 1
    assert found["mavlink"]["streams"] == []
    assert found["states_sent"] == 0
    assert {entry["in"] for entry in found["mavlink"]["routers"] if entry["way"] == "up"} == {0}


def test_repetitions_belong_to_their_call_and_its_first_copy_counts(series: Series) -> None:
    chain, station = Chain((1, 2)), sender(245, 190)
    arm = T0, T0 + SECOND // 2  # the first one is lost, the second arrives
    chain.send(arm[0], packed(station, long_command(400, 1, 1.0)), 1, up=False, lost_on="uav1")
    chain.send(arm[1], packed(station, long_command(400, 1, 1.0)), 1, up=False)
    for at in (T0 + 2 * SECOND, T0 + 3 * SECOND):  # none of drone 2's arrives
        chain.send(at, packed(station, long_command(400, 2, 1.0)), 2, up=False, until="fog1")
    mode = long_command(176, 1, 1.0, 4.0, 3.0)
    goto = common.MAVLink_command_int_message(1, 1, 6, 192, 0, 0, -1.0, 1.0, 0.0, 0.0, 473977000, 85455000, 500.0)
    chain.send(T0 + 4 * SECOND, packed(station, mode), 1, up=False)
    chain.send(T0 + 5 * SECOND, packed(station, goto), 1, up=False)
    chain.send(T0 + 6 * SECOND, packed(station, long_command(512, 1, 242.0)), 1, up=False)  # belongs to no call
    calls = [
        called(T0 - 500, 1, "arm", 1),
        called(T0 + 2 * SECOND - 500, 2, "arm", 2),
        called(T0 + 4 * SECOND, 3, "goto", 1),
    ]
    found = measured(series, chain, [*calls, called(T0 + 7 * SECOND, 4, "land", 1)])
    assert (found["commands_sent"], found["message_loss"]["commands"]) == (4, 0.5)
    assert found["frames_per_call"] == {"arm": 2.0, "goto": 2.0, "land": 0.0}
    assert found["delay_ms"] == {"arm": [(arm[1] - arm[0] + SEEN) / MS], "goto": [SEEN / MS]}


def test_the_same_command_called_again_is_a_call_of_its_own(series: Series) -> None:
    chain, station = Chain(), sender(245, 190)
    for number in range(2):
        chain.send(T0 + number * SECOND, packed(station, long_command(400, 1, 1.0)), 1, up=False)
    calls = [called(T0 + number * SECOND - 500, number, "arm", 1) for number in range(2)]
    found = measured(series, chain, calls)
    assert found["frames_per_call"] == {"arm": 1.0}
    assert found["delay_ms"] == {"arm": [SEEN / MS] * 2}


def test_the_start_of_an_uploaded_mission_is_a_command(series: Series) -> None:
    chain = armed()
    chain.send(T0 + SECOND, packed(sender(245, 190), long_command(176, 1, 1.0, 4.0, 4.0)), 1, up=False)
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1), called(T0 + SECOND - 500, 2, "start_mission", 1)])
    assert found["commands_sent"] == 2
    assert found["delay_ms"] == {"arm": [SEEN / MS], "start_mission": [SEEN / MS]}


def test_a_message_that_shares_its_datagram_answers_for_its_part_of_the_frame(series: Series) -> None:
    chain, drone = armed(), sender(1)
    other = common.MAVLink_system_time_message(1, 1)  # 9 bytes of payload, as the heartbeat
    chain.send(T0 + SECOND, packed(drone, HEARTBEAT) + packed(drone, other), 1, up=True)
    streams = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])["mavlink"]["streams"]
    assert [(stream["name"], stream["bytes"]) for stream in streams] == [("HEARTBEAT", 42), ("SYSTEM_TIME", 42)]


@pytest.mark.parametrize("direct", [False, True])
def test_streams_have_the_rates_at_which_they_were_sent(series: Series, direct: bool) -> None:
    chain = armed((1, 4), direct)
    fill_streams(chain, 2.0, {"ATTITUDE": 20, "VFR_HUD": 10})
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)], disarmed_s=2.0)
    rates = {stream["name"]: (stream["count"], stream["rate_hz"]) for stream in found["mavlink"]["streams"]}
    assert rates == {"ATTITUDE": (80, 20.0), "VFR_HUD": (40, 10.0)}
    assert (found["states_sent"], found["message_loss"]["states"]) == (40, 0.0)
    cloud = found["mavlink"]["routers"][0]
    assert (cloud["node"], cloud["way"], cloud["in"], cloud["dropped"]) == ("cloud", "up", 120, 0)


def test_both_sides_give_ratios(series: Series) -> None:
    make_attempt(series)  # 7 packets, 575 bytes, 9 s
    chain = armed()
    measured(series, chain, [called(T0 - 500, 1, "arm", 1)], disarmed_s=4.5)
    ratios = measure_series(series)["ratios"]
    assert ratios == {"packets": round(3 / 7, 4), "size": round(3 * 86 / 575, 4), "mission": 0.5}


def test_what_a_drones_own_queue_dropped_shows_in_its_sequence_numbers(series: Series) -> None:
    chain = armed((1, 2, 3))
    for drone, sequences in ((1, (254, 255, 2, 3)), (2, (7, 8, 9)), (3, (254, 0, 255, 2, 1, 3))):  # drone 3's overtake
        link = sender(drone)
        for number, sequence in enumerate(sequences):
            link.seq = sequence
            chain.send(T0 + (number + 1) * SECOND, packed(link, HEARTBEAT), drone, up=True)
    found = measured(series, chain, [called(T0 - 500, 1, "arm", 1)])
    assert found["mavlink"]["unsent"] == {"1": 2}
    assert found["notes"] == [
        "messages dropped before they entered a link, by sequence numbers, of unknown kinds: 2 of drone 1"
    ]
    assert found["message_loss"]["states"] == 0.0
