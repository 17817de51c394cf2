"""Heights are above one home: what is told, and what takeoff and goto fly to (R3.10)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.errors import PayloadError
from mqttxt.protocol.commands import Goto, Takeoff
from mqttxt.protocol.states import Home, Location, State
from tests.simulation.world import HOME, from_autopilot, heartbeat

DRONE = 1
AMSL_M = HOME[2] / 1000
LATITUDE, LONGITUDE = HOME[0] / 1e7, HOME[1] / 1e7


def place(amsl_m: float, above_home_m: float) -> Any:
    heights = round(amsl_m * 1000), round(above_home_m * 1000)
    return from_autopilot(mavlink.MAVLink_global_position_int_message(0, *HOME[:2], *heights, 0, 0, 0, 9000))


def home_at(amsl_m: float, north_m: float = 0.0) -> Any:
    there = (HOME[0] + round(north_m * 90), HOME[1], round(amsl_m * 1000))
    return from_autopilot(mavlink.MAVLink_home_position_message(*there, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0))


class Heard:
    """A vehicle that heard messages, and what they told."""

    def __init__(self, *messages: Any) -> None:
        self.vehicle = Vehicle(DRONE)
        self.told: list[State] = []
        for message in messages:
            self.told += self.vehicle.update(message, 0)

    def heights(self) -> list[float]:
        return [state.altitude_m for state in self.told if isinstance(state, Location)]

    def homes(self) -> list[float]:
        return [state.altitude_amsl_m for state in self.told if isinstance(state, Home)]


IDLE, ARMED = heartbeat(armed=False), heartbeat(armed=True)


def test_a_home_that_is_corrected_in_flight_moves_no_height() -> None:
    flown = [place(AMSL_M + 10, 10.0), place(AMSL_M + 10, 11.4), home_at(AMSL_M - 1.4), place(AMSL_M + 10.1, 8.7)]
    heard = Heard(IDLE, home_at(AMSL_M), ARMED, place(AMSL_M, 0.0), *flown)
    assert heard.heights() == [0.0, 10.0, 10.0, 10.1]
    assert heard.homes() == [AMSL_M] * 3


def test_home_as_of_arming_is_known_before_its_own_message_comes() -> None:
    heard = Heard(IDLE, home_at(AMSL_M), place(AMSL_M + 0.3, 0.3), ARMED, place(AMSL_M + 0.3, 0.0))
    assert heard.homes() == [AMSL_M, AMSL_M + 0.3]
    assert heard.heights() == [0.3, 0.0]


def test_a_height_that_is_flown_is_the_one_that_is_told() -> None:
    corrected = (place(AMSL_M + 2, 3.5), home_at(AMSL_M - 1.5))
    vehicle = Heard(IDLE, home_at(AMSL_M - 0.7), ARMED, place(AMSL_M, 0.0), *corrected).vehicle
    takeoff = vehicle.autopilot.plan(Takeoff(10.0), vehicle, 0).message
    goto = vehicle.autopilot.plan(Goto(LATITUDE, LONGITUDE, 15.0), vehicle, 0).message
    for target_m, height_m in ((takeoff.param7, 10.0), (goto.z, 15.0)):
        (location,) = [state for state in vehicle.update(place(target_m, 0), 0) if isinstance(state, Location)]
        assert location.altitude_m == height_m


def test_home_that_is_put_elsewhere_is_another_home() -> None:
    heard = Heard(IDLE, home_at(AMSL_M), ARMED, place(AMSL_M, 0.0), home_at(AMSL_M + 6, north_m=50))
    assert heard.homes() == [AMSL_M, AMSL_M, AMSL_M + 6]
    assert heard.heights() == [0.0]
    assert [s.altitude_m for s in heard.vehicle.update(place(AMSL_M + 10, 4.0), 0) if isinstance(s, Location)] == [4.0]


def test_disarmed_both_are_the_autopilots_own() -> None:
    flown = (ARMED, place(AMSL_M, 0.0), home_at(AMSL_M - 1), IDLE, place(AMSL_M, 1.0), home_at(AMSL_M - 1))
    heard = Heard(IDLE, home_at(AMSL_M), *flown)
    assert heard.heights() == [0.0, 1.0]
    assert heard.homes()[-1] == AMSL_M - 1


def test_in_mid_flight_home_is_what_it_is_found_to_be() -> None:
    heard = Heard(ARMED, home_at(AMSL_M), place(AMSL_M + 10, 9.5), home_at(AMSL_M))
    assert heard.homes() == [AMSL_M, AMSL_M + 0.5, AMSL_M + 0.5]
    assert heard.heights() == [9.5]


@pytest.mark.parametrize(
    ("before", "unbelievable"),
    [
        ((), place(AMSL_M, -2_000_000.0)),
        ((), place(2_000_000.0, 0.0)),
        ((), place(90_000.0, -90_000.0)),
        ((), home_at(2_000_000.0, 50.0)),
        ((place(AMSL_M, 0.0),), place(AMSL_M, -2_000_000.0)),
        ((place(AMSL_M, 0.0),), home_at(2_000_000.0)),
        ((place(AMSL_M, 0.0),), home_at(2_000_000.0, 50.0)),
    ],
)
def test_what_is_not_believed_moves_no_height(before: tuple[Any, ...], unbelievable: Any) -> None:
    vehicle = Heard(IDLE, home_at(AMSL_M), ARMED, *before).vehicle
    with pytest.raises(PayloadError):
        vehicle.update(unbelievable, 0)
    told = [state for message in (place(AMSL_M + 10, 10.0), home_at(AMSL_M)) for state in vehicle.update(message, 0)]
    assert [state.altitude_m for state in told if isinstance(state, Location)] == [10.0]
    assert [state.altitude_amsl_m for state in told if isinstance(state, Home)][-1] == AMSL_M
