"""The state `endurance`: configured or measured, never above the truth (section 3)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.endurance import EnduranceMeter
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.state_payload import decode_state
from mqttxt.protocol.states import Endurance
from tests.simulation.world import UAV_SESSION, from_autopilot, heartbeat, landed, ready

GROUND, AIR = 1, 2


def cruise(speed_m_s: float = 5.0, name: bytes = b"MPC_XY_CRUISE") -> Any:
    return from_autopilot(mavlink.MAVLink_param_value_message(name, speed_m_s, 9, 1, 0))


def battery(percent: int) -> Any:
    return from_autopilot(mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, percent))


class Drained:
    """A battery that drains evenly, told every two seconds in whole percents."""

    def __init__(self, true_s: int, full_pct: float = 100.0, configured_s: int | None = None) -> None:
        self.vehicle = Vehicle(1)
        self.meter = EnduranceMeter(self.vehicle, configured_s)
        self.true_s = true_s
        self.left_pct = full_pct
        self.now_ms = 0
        self.hear(heartbeat())
        self.hear(cruise())

    def hear(self, message: Any) -> Endurance | None:
        self.vehicle.update(message, self.now_ms)
        return self.meter.on_message(message, self.now_ms)

    def spend(self, seconds: int, state: int = AIR) -> list[Endurance]:
        told = []
        self.hear(landed(state))
        for _ in range(0, seconds, 2):
            self.now_ms += 2000
            self.left_pct -= 200 / self.true_s * (1.0 if state == AIR else 0.05)
            told.append(self.hear(battery(int(self.left_pct))))
        return [state for state in told if state is not None]


@pytest.mark.parametrize("true_s", [300, 1000, 3333])
@pytest.mark.parametrize("full_pct", [100.0, 87.7, 60.2])
def test_what_is_measured_is_near_the_truth_and_never_above(true_s: int, full_pct: float) -> None:
    told = Drained(true_s, full_pct).spend(true_s // 2)
    assert all(state.endurance_s <= true_s for state in told)
    assert told[-1].endurance_s > 0.9 * true_s
    assert told[0].endurance_s >= 0.6 * true_s


def test_nothing_is_said_before_three_percent_have_drained() -> None:
    drone = Drained(1000)
    assert drone.spend(28) == []
    assert len(drone.spend(10)) == 1


def test_time_on_the_ground_is_no_flight() -> None:
    drone = Drained(1000)
    drone.spend(600, GROUND)
    told = drone.spend(300) + drone.spend(3000, GROUND)
    assert 0 < max(state.endurance_s for state in told) <= 1000


def test_another_battery_is_measured_anew_and_what_was_known_stays() -> None:
    drone = Drained(1000)
    known = drone.spend(100)[-1]
    drone.left_pct = 100.0
    assert drone.spend(24) == []
    assert drone.meter.on_message(battery(100), drone.now_ms) is None
    assert 0 < drone.spend(200)[-1].endurance_s <= 1000 >= known.endurance_s


def test_a_configured_one_is_said_at_once_with_the_cruise_speed() -> None:
    vehicle = Vehicle(1)
    vehicle.update(heartbeat(), 0)
    meter = EnduranceMeter(vehicle, 1200)
    for message, told in ((battery(50), None), (cruise(7.5), Endurance(1200, 7.5)), (cruise(7.5), None)):
        vehicle.update(message, 0)
        assert meter.on_message(message, 0) == told


@pytest.mark.parametrize("endurance_s", [59, 86_401, -1])
def test_an_endurance_that_cannot_be_is_one_line(endurance_s: int) -> None:
    with pytest.raises(ConfigurationError, match="--endurance-s"):
        UavOptions(endurance_s=endurance_s)


def test_the_uav_client_publishes_it() -> None:
    uav = UavClient(1, UAV_SESSION, Settings(), options=UavOptions(endurance_s=900))
    ready(uav)
    uav.on_mavlink(cruise(5.0), 100)
    effects = [e for e in uav.tick(200) if isinstance(e, Publish) and e.topic == "drone1/state/endurance"]
    assert [decode_state("endurance", e.payload, relayed=False).state for e in effects] == [Endurance(900, 5.0)]
