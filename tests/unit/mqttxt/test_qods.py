"""QoDS: by battery decile, then speed, then number; published when that changes and every 30 s (section 8)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.activator.qods import decile
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import Presence
from mqttxt.protocol.rankings import QodsMessage
from mqttxt.protocol.states import Battery, MaxGroundspeed
from tests.simulation.fogs import ActivatorBench, of
from tests.simulation.world import UAV_SESSION


def flock(*drones: tuple[int, float], registered: bool = True) -> ActivatorBench:
    """Drones 1, 2, … with a battery and a largest groundspeed each."""
    bench = ActivatorBench(drones=tuple(range(1, len(drones) + 1)))
    for number, (remaining, speed) in enumerate(drones, start=1):
        bench.appear(number, UAV_SESSION + number)
        bench.tell(Battery(remaining), MaxGroundspeed(speed), drone=number)
    if registered:
        bench.register()
    return bench


def rankings(effects: list[Any]) -> list[list[int]]:
    messages = [decode(QodsMessage, publish.payload) for publish in of(effects, "fog1/QoDS")]
    return [[ranked.drone for ranked in message.ranking] for message in messages]


@pytest.mark.parametrize(("percent", "group"), [(0, 0), (9, 0), (10, 1), (89, 8), (90, 9), (99, 9), (100, 9)])
def test_there_are_ten_groups(percent: int, group: int) -> None:
    assert decile(percent) == group


def test_battery_decile_goes_before_speed_and_speed_before_number() -> None:
    bench = flock((81, 20), (92, 5), (89, 25), (99, 5))
    assert rankings(bench.until(bench.now_ms + 100)) == [[2, 4, 3, 1]]


def test_it_is_published_again_only_when_order_or_a_decile_changes_and_every_30_s() -> None:
    bench = flock((95, 10), (85, 10))
    assert len(rankings(bench.until(bench.now_ms + 100))) == 1
    bench.tell(Battery(93), drone=1)
    assert rankings(bench.until(bench.now_ms + 1000)) == []
    bench.tell(Battery(89), drone=1)
    assert rankings(bench.until(bench.now_ms + 1000)) == [[1, 2]]
    bench.tell(Battery(79), drone=1)
    assert rankings(bench.until(bench.now_ms + 1000)) == [[2, 1]]
    for _ in range(3):
        bench.register()
        for drone in (1, 2):
            bench.echo(drone=drone, session=UAV_SESSION + drone)
        assert rankings(bench.until(bench.now_ms + 9500)) == []
    assert len(rankings(bench.until(bench.now_ms + 1000))) == 1


def test_a_drone_that_is_not_reachable_or_not_known_enough_is_not_ranked() -> None:
    bench = flock((95, 10), (85, 10))
    bench.until(bench.now_ms + 100)
    bench.appear(3, UAV_SESSION + 3)
    bench.tell(Battery(99), drone=3)
    bench.fog("drone1/reachable", Presence(session=UAV_SESSION + 1, up=False))
    assert rankings(bench.until(bench.now_ms + 600)) == [[2]]


def test_without_a_registered_station_nothing_is_published() -> None:
    bench = flock((95, 10), registered=False)
    assert rankings(bench.until(bench.now_ms + 40_000)) == []


def test_a_new_station_is_told_at_once() -> None:
    bench = flock((95, 10))
    bench.until(bench.now_ms + 100)
    bench.register(name="beta", session=9)
    assert rankings(bench.until(bench.now_ms + 100)) == [[1]]
