"""Which messages are due when, and how a ground station changes that."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.px4.modes import Mode
from sitl.px4.streams import PX4_SETS, RATES_HZ, SILENT, rates_hz
from sitl.px4.telemetry import Px4Telemetry
from sitl.streams import Streams

BATTERY, ATTITUDE, PING = 147, 30, 4


def made(chosen: str) -> Streams:
    return Streams(rates_hz(chosen), SILENT)


def count(streams: Streams, seconds: float, start_s: float = 0.0, tick_s: float = 0.01) -> Counter[str]:
    found: Counter[str] = Counter()
    for tick in range(round(seconds / tick_s)):
        found.update(streams.due(start_s + tick * tick_s))
    return found


@pytest.mark.parametrize("chosen", PX4_SETS)
def test_rates_are_px4s(chosen: str) -> None:
    found = count(made(chosen), 20)
    assert set(found) <= set(RATES_HZ)
    for name, rates in RATES_HZ.items():
        assert found[name] == pytest.approx(rates[PX4_SETS.index(chosen)] * 20, abs=1), name


def test_the_sum_is_px4s_load() -> None:
    """In automatic modes; 413 messages a second on the onboard link otherwise."""
    totals = [sum(rates[i] for rates in RATES_HZ.values()) for i in range(3)]
    assert totals == pytest.approx([420, 58, 373], abs=2)


def test_a_global_target_is_told_in_automatic_flight_only(drone: Any) -> None:
    telemetry = drone.vehicle.telemetry
    assert telemetry.make("POSITION_TARGET_GLOBAL_INT") is None
    drone.take_off()
    assert telemetry.make("POSITION_TARGET_GLOBAL_INT").lat_int == pytest.approx(473_977_420, abs=1)


@pytest.mark.parametrize("tick_s", [0.017, 0.02, 0.09])
def test_a_caller_that_is_late_does_not_make_the_streams_slower(tick_s: float) -> None:
    assert count(made("px4-onboard"), 10, tick_s=tick_s)["ATTITUDE"] == pytest.approx(1000, abs=10)


def test_after_a_standstill_it_goes_on_without_making_up_for_it() -> None:
    streams = made("px4-onboard")
    count(streams, 1)
    assert Counter(streams.due(31.0)) == Counter({name: 1 for name, rates in RATES_HZ.items() if rates[0] > 0.1})
    assert count(streams, 10, 31.01)["ATTITUDE"] == pytest.approx(1000, abs=1)


def test_five_states_are_only_heartbeats_until_someone_asks() -> None:
    streams = made("five-states")
    assert count(streams, 10) == {"HEARTBEAT": 10}
    assert streams.set_interval(BATTERY, 1_000_000)
    assert count(streams, 10, 10) == {"HEARTBEAT": 10, "BATTERY_STATUS": 10}
    streams.set_interval(BATTERY, 0)
    assert count(streams, 10, 20) == {"HEARTBEAT": 10}, "its default is none"


def test_modes_are_told_one_after_the_other(drone: Any) -> None:
    telemetry = drone.vehicle.telemetry
    told = [telemetry.make("AVAILABLE_MODES") for _ in Mode]
    assert [one.mode_index for one in told] == list(range(1, len(Mode) + 1))
    assert {one.custom_mode for one in told} == {mode.custom_mode for mode in Mode}
    now = telemetry.make("CURRENT_MODE")
    assert now.custom_mode == now.intended_custom_mode == drone.vehicle.autopilot.mode.custom_mode


def test_messages_do_not_all_fall_on_one_tick() -> None:
    streams = made("px4-normal")
    assert max(len(streams.due(tick * 0.01)) for tick in range(300)) <= 8


def test_every_streamed_message_can_be_made() -> None:
    assert set(Px4Telemetry.makers) == set(RATES_HZ)


def test_an_interval_is_set_at_once_stopped_and_put_back() -> None:
    streams = made("px4-onboard")
    count(streams, 10)
    assert streams.set_interval(BATTERY, 100_000)
    assert "BATTERY_STATUS" in streams.due(10.0)
    assert count(streams, 10, 10.01)["BATTERY_STATUS"] == pytest.approx(100, abs=1)
    streams.set_interval(BATTERY, -1)
    assert count(streams, 10, 20)["BATTERY_STATUS"] == 0
    assert streams.interval_us(BATTERY) == -1
    streams.set_interval(BATTERY, 0)
    assert streams.interval_us(BATTERY) == 2_000_000


def test_intervals_by_command(drone: Any) -> None:
    assert drone.command(511, ATTITUDE, 20_000) == 0
    (ack, answer) = drone.tell(mavlink.MAVLink_command_long_message(1, 1, 510, 0, ATTITUDE, 0, 0, 0, 0, 0, 0))
    assert (ack.result, answer.message_id, answer.interval_us) == (0, ATTITUDE, 20_000)
    assert drone.command_int(511, ATTITUDE, -1) == 0, "COMMAND_INT carries the same parameters"
    assert drone.vehicle.links[0].interval_us(ATTITUDE) == -1


def test_an_interval_longer_than_its_message_can_say_is_told_as_the_longest(drone: Any) -> None:
    assert drone.command(511, ATTITUDE, 1e38) == 0
    (_, answer) = drone.tell(mavlink.MAVLink_command_long_message(1, 1, 510, 0, ATTITUDE, 0, 0, 0, 0, 0, 0))
    answer.pack(mavlink.MAVLink(None, 1, 1))
    assert answer.interval_us == 2**31 - 1


def test_the_interval_of_an_unknown_message_fails(drone: Any) -> None:
    assert drone.command(511, 9999, 20_000) == mavlink.MAV_RESULT_FAILED
    assert drone.command(511, ATTITUDE, float("nan")) == mavlink.MAV_RESULT_FAILED
    gps2_raw = mavlink.MAVLINK_MSG_ID_GPS2_RAW
    assert drone.command(511, gps2_raw, 1e6) == mavlink.MAV_RESULT_ACCEPTED, "PX4 would say it, if it had a second GPS"
    assert drone.vehicle.links[0].interval_us(9999) == 0
