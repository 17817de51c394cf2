"""The cases: what is done to an autopilot to see how it answers; each begins disarmed, on the ground and at rest."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import development as mavlink

from . import noise
from .channel import Heard
from .pilot import Pilot

HEIGHT_M = 10.0
FLIGHT_S = 120.0
"""Longer than any step of a flight takes."""
SPOOL_UP_S = 1.5
"""An autopilot lets its motors speed up first: so long after arming that is over."""
STREAMS_S = 20.0
HOVER_S = 40.0


@dataclass(frozen=True)
class Procedure:
    """A case by name, and on which of the autopilot's links it is flown."""

    fly: Callable[[Pilot], None]
    link: str = "onboard"
    counts: bool = False
    """Whether every message is of interest, not only those that tell the state."""


CASES: dict[str, Procedure] = {}


def case(name: str, link: str = "onboard", *, counts: bool = False) -> Callable[[Callable[[Pilot], None]], None]:
    """Enter a function among CASES."""

    def enter(fly: Callable[[Pilot], None]) -> None:
        CASES[name] = Procedure(fly, link, counts)

    return enter


# -- flights --------------------------------------------------------------------------------------------------------


def _up(pilot: Pilot, height_m: float = HEIGHT_M) -> None:
    """Armed and hovering."""
    pilot.arm()
    pilot.until("armed", lambda: pilot.armed, 10)
    pilot.wait(SPOOL_UP_S)
    pilot.takeoff(height_m)
    pilot.until("takeoff half way", lambda: pilot.position[2] > height_m / 2, FLIGHT_S)
    pilot.until("takeoff", lambda: pilot.position[2] > height_m - 0.5, FLIGHT_S)
    pilot.until("takeoff to hold", lambda: pilot.rests, FLIGHT_S)
    pilot.wait(3)


def _down(pilot: Pilot) -> None:
    """From landing or returning to disarmed; then what becomes of the mode."""
    pilot.until("landed", lambda: pilot.landed, FLIGHT_S)
    pilot.until("disarmed", lambda: not pilot.armed, 30)
    pilot.wait(4)


def _near(pilot: Pilot, north_m: float, up_m: float, within_m: float) -> Callable[[], bool]:
    return lambda: abs(pilot.position[0] - north_m) < within_m and abs(pilot.position[2] - up_m) < within_m


@case("takeoff and land")
def _takeoff_and_land(pilot: Pilot) -> None:
    pilot.track()
    _up(pilot)
    pilot.land()
    pilot.until("land to 5 m", lambda: pilot.position[2] < 5, FLIGHT_S)
    _down(pilot)


@case("goto and return")
def _goto_and_return(pilot: Pilot) -> None:
    pilot.track()
    _up(pilot)
    pilot.goto(60, 0, HEIGHT_M)
    pilot.until("goto half way", lambda: pilot.position[0] > 30, FLIGHT_S)
    pilot.until("goto to 1 m", _near(pilot, 60, HEIGHT_M, 1), FLIGHT_S)
    pilot.until("goto at rest", lambda: pilot.speed_m_s < 0.2, FLIGHT_S)
    pilot.wait(3)
    pilot.set_mode("return")
    pilot.until("return near home", lambda: abs(pilot.position[0]) < 2, FLIGHT_S)
    _down(pilot)


@case("return from near")
def _return_from_near(pilot: Pilot) -> None:
    pilot.track()
    _up(pilot)
    pilot.goto(4, 0, HEIGHT_M)
    pilot.until("goto to 1 m", _near(pilot, 4, HEIGHT_M, 1), FLIGHT_S)
    pilot.wait(3)
    pilot.set_mode("return")
    _down(pilot)


@case("return at the height of flight")
def _return_at_flight_height(pilot: Pilot) -> None:
    """As the experiments fly: it returns at the height of flight, and the fleet's speed is 12 m/s."""
    before = {name: pilot.parameter(name) for name in pilot.manners.experiments}
    for name, value in pilot.manners.experiments.items():
        pilot.set_parameter(name, value)
    pilot.track()
    _up(pilot)
    pilot.goto(100, 0, HEIGHT_M)
    pilot.until("goto to 1 m", _near(pilot, 100, HEIGHT_M, 1), FLIGHT_S)
    pilot.until("goto at rest", lambda: pilot.speed_m_s < 0.2, FLIGHT_S)
    pilot.set_mode("return")
    pilot.until("return near home", lambda: abs(pilot.position[0]) < 2, FLIGHT_S)
    _down(pilot)
    for name, was in before.items():
        if was is not None:
            pilot.set_parameter(name, was)


@case("climb and descend")
def _climb_and_descend(pilot: Pilot) -> None:
    pilot.track()
    _up(pilot, 5)
    pilot.goto(0, 0, 25, "climb")
    pilot.until("climb", _near(pilot, 0, 25, 1), FLIGHT_S)
    pilot.wait(4)
    pilot.goto(0, 0, 12, "descend")
    pilot.until("descend", _near(pilot, 0, 12, 1), FLIGHT_S)
    pilot.wait(4)
    pilot.goto(30, 0, 20, "climb and go")
    pilot.until("climb and go", _near(pilot, 30, 20, 1), FLIGHT_S)
    pilot.wait(3)
    pilot.land()
    _down(pilot)


@case("stop in a goto")
def _stop_in_a_goto(pilot: Pilot) -> None:
    pilot.track()
    _up(pilot)
    pilot.goto(150, 0, HEIGHT_M)
    pilot.wait(8)
    pilot.rest()
    pilot.wait(3)
    pilot.case.numbers["speed 3 s after hold"] = round(pilot.speed_m_s, 2)
    pilot.stop_here()
    pilot.until("stop", lambda: pilot.speed_m_s < 0.3, 30)
    pilot.wait(3)
    pilot.set_mode("land")
    _down(pilot)


@case("stop in a takeoff")
def _stop_in_a_takeoff(pilot: Pilot) -> None:
    pilot.track()
    pilot.arm()
    pilot.takeoff(30)
    pilot.until("takeoff to 6 m", lambda: pilot.position[2] > 6, FLIGHT_S)
    pilot.rest()
    pilot.wait(5)
    pilot.case.numbers["height after hold"] = round(pilot.position[2], 1)
    pilot.takeoff(12)
    pilot.wait(8)
    pilot.stop_here()
    pilot.wait(2)
    pilot.land()
    _down(pilot)


@case("offboard, and its client ends")
def _offboard(pilot: Pilot) -> None:
    pilot.track()
    pilot.set_mode("offboard")
    pilot.wait(2)
    pilot.arm()
    pilot.rest()
    pilot.wait(2)
    _up(pilot)
    pilot.set_mode("offboard")
    pilot.wait(3)
    pilot.rest()
    pilot.wait(2)
    pilot.repeat = lambda: pilot.velocity(2, 0, 0)
    pilot.wait(1)
    pilot.set_mode("offboard")
    pilot.until("offboard", lambda: pilot.mode == "offboard", 5)
    pilot.wait(6)
    pilot.case.numbers["offboard speed"] = round(pilot.last["LOCAL_POSITION_NED"].vx, 2)
    pilot.repeat = None
    mode = pilot.mode
    pilot.until("", lambda: pilot.mode != mode, 10)
    pilot.wait(3)
    pilot.rest()
    pilot.wait(3)
    pilot.land()
    _down(pilot)


@case("velocity, and its client ends")
def _velocity(pilot: Pilot) -> None:
    pilot.track()
    pilot.repeat = lambda: pilot.velocity(0, 0, -1)
    pilot.arm()
    pilot.wait(4)
    pilot.case.numbers["height after a velocity on the ground"] = round(pilot.position[2], 1)
    pilot.repeat = None
    pilot.wait(1)
    _up(pilot)
    pilot.repeat = lambda: pilot.velocity(2, 0, 0)
    pilot.wait(6)
    pilot.case.numbers["velocity's speed"] = round(pilot.last["LOCAL_POSITION_NED"].vx, 2)
    pilot.repeat = None
    pilot.mark()
    pilot.until("slower", lambda: pilot.speed_m_s < 1, 30)
    pilot.until("stands", lambda: pilot.speed_m_s < 0.3, 30)
    pilot.wait(3)
    pilot.land()
    _down(pilot)


# -- answers --------------------------------------------------------------------------------------------------------


@case("takeoff while disarmed")
def _takeoff_while_disarmed(pilot: Pilot) -> None:
    pilot.track()
    pilot.takeoff(5)
    pilot.wait(3)
    pilot.arm()
    pilot.wait(8)
    pilot.case.numbers["height 8 s after arming"] = round(pilot.position[2], 1)
    pilot.land()
    _down(pilot)


@case("arm in land mode")
def _arm_in_land_mode(pilot: Pilot) -> None:
    pilot.set_mode("land")
    pilot.wait(2)
    pilot.arm()
    pilot.wait(2)
    pilot.set_mode("return")
    pilot.wait(2)
    pilot.arm()
    pilot.wait(2)
    pilot.rest()
    pilot.wait(2)
    pilot.arm()
    pilot.wait(2)
    pilot.arm()
    pilot.set_mode("land")
    pilot.wait(2)
    pilot.disarm()
    pilot.wait(3)


@case("reposition on the ground, disarmed")
def _reposition_disarmed(pilot: Pilot) -> None:
    pilot.goto(20, 0, HEIGHT_M)
    pilot.wait(2)
    pilot.stop_here()
    pilot.wait(2)


@case("reposition on the ground, armed")
def _reposition_armed(pilot: Pilot) -> None:
    pilot.track()
    pilot.arm()
    pilot.wait(2)
    pilot.stop_here()
    pilot.wait(4)
    pilot.case.numbers["height after stop"] = round(pilot.position[2], 1)
    pilot.goto(10, 0, HEIGHT_M)
    pilot.wait(12)
    pilot.case.numbers["height after goto"] = round(pilot.position[2], 1)
    pilot.land()
    _down(pilot)


@case("disarmed by itself")
def _disarmed_by_itself(pilot: Pilot) -> None:
    pilot.arm()
    pilot.until("", lambda: pilot.armed, 5)
    pilot.until("disarmed", lambda: not pilot.armed, 30)
    pilot.wait(2)


@case("modes on the ground")
def _modes_on_the_ground(pilot: Pilot) -> None:
    _modes(pilot, pilot.manners.on_ground)


@case("modes in the air")
def _modes_in_the_air(pilot: Pilot) -> None:
    _up(pilot, 8)
    pilot.disarm()
    _modes(pilot, pilot.manners.in_air)
    pilot.takeoff(12)
    pilot.wait(2)
    pilot.land()
    _down(pilot)


def _modes(pilot: Pilot, tried: Sequence[str]) -> None:
    for mode in tried:
        pilot.set_mode(mode)
        pilot.wait(1.5)
    for name, params in pilot.manners.odd_modes.items():
        pilot.command(name, mavlink.MAV_CMD_DO_SET_MODE, *params)
        pilot.wait(1.5)
    pilot.rest()
    pilot.wait(1.5)


@case("requests")
def _requests(pilot: Pilot) -> None:
    interval, message = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
    pilot.command("interval of BATTERY_STATUS 1 Hz", interval, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 1e6)
    pilot.command("interval of BATTERY_STATUS default", interval, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 0)
    pilot.command("interval of RC_CHANNELS 1 Hz", interval, mavlink.MAVLINK_MSG_ID_RC_CHANNELS, 1e6)
    pilot.command("interval of RC_CHANNELS default", interval, mavlink.MAVLINK_MSG_ID_RC_CHANNELS, 0)
    pilot.command("interval of GPS2_RAW 1 Hz", interval, mavlink.MAVLINK_MSG_ID_GPS2_RAW, 1e6)
    pilot.command("interval of GPS2_RAW default", interval, mavlink.MAVLINK_MSG_ID_GPS2_RAW, 0)
    pilot.command("interval of RAW_IMU 1 Hz", interval, mavlink.MAVLINK_MSG_ID_RAW_IMU, 1e6)
    pilot.command("interval of 9999 1 Hz", interval, 9999, 1e6)
    pilot.command("interval of 9999 stopped", interval, 9999, -1)
    pilot.command("get interval of ATTITUDE", mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE)
    pilot.command("get interval of 9999", mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 9999)
    pilot.command("message HOME_POSITION", message, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    pilot.command("message AUTOPILOT_VERSION", message, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    pilot.command("message 9999", message, 9999)
    pilot.command("message RAW_IMU", message, mavlink.MAVLINK_MSG_ID_RAW_IMU)
    pilot.command("capabilities", mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1)
    for number in (31_000, 203, 204, 205, 206, 2000, 530, 195, 178, 183, 246, 241, 115, 300, 252):
        pilot.command(f"MAV_CMD {number}", number)
    pilot.command("arm by 2", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 2)
    pilot.disarm()


@case("acknowledgement to heartbeat")
def _acknowledgement_to_heartbeat(pilot: Pilot) -> None:
    """How long after an acknowledgement a heartbeat tells the change; the moments are spread over a second."""
    delays = []
    for number in range(12):
        mode = "land" if pilot.rests else pilot.manners.rest
        pilot.wait(0.37 + 0.13 * (number % 5))
        pilot.set_mode(mode)
        answered_s = pilot.now_s
        pilot.until("", lambda wanted=mode: pilot.mode == wanted, 5)  # type: ignore[misc]
        delays.append(pilot.now_s - answered_s)
    pilot.case.numbers["median"] = round(statistics.median(delays), 2)
    pilot.case.numbers["longest"] = round(max(delays), 2)
    pilot.case.events.clear()
    if not pilot.rests:
        pilot.rest()


# -- streams and noise ----------------------------------------------------------------------------------------------


@case("idle, onboard link", counts=True)
def _idle_onboard(pilot: Pilot) -> None:
    heard = pilot.collect(STREAMS_S)
    pilot.count_streams(heard)
    pilot.case.numbers.update(noise.of(heard))


@case("idle, ground station's link", "gcs", counts=True)
def _idle_gcs(pilot: Pilot) -> None:
    pilot.count_streams(pilot.collect(STREAMS_S))


@case("idle, normal link", "normal", counts=True)
def _idle_normal(pilot: Pilot) -> None:
    pilot.count_streams(pilot.collect(STREAMS_S))


@case("unasked", counts=True)
def _unasked(pilot: Pilot) -> None:
    """What it says by itself, beside ATTITUDE, which is the clock."""
    for name in pilot.manners.asks.keys() - {"ATTITUDE"}:
        pilot.unask(name)
    pilot.wait(1)
    pilot.count_streams(pilot.collect(STREAMS_S))
    pilot.ask()


@case("hover", counts=True)
def _hover(pilot: Pilot) -> None:
    _up(pilot)
    pilot.wait(2)
    heard = pilot.collect(HOVER_S)
    pilot.count_streams(heard)
    pilot.case.numbers.update(noise.of(heard))
    pilot.land()
    _down(pilot)
    pilot.wait(3)
    pilot.case.numbers["battery_pct after landing"] = pilot.last["BATTERY_STATUS"].battery_remaining


@case("state messages of a flight", counts=True)
def _changes(pilot: Pilot) -> None:
    """How often home, battery and heading change from the start to the end of a short flight."""
    tap: list[Heard] = []
    pilot.tap(tap.append)
    _up(pilot)
    pilot.goto(30, 30, HEIGHT_M)
    pilot.wait(15)
    pilot.set_mode("return")
    _down(pilot)
    pilot.untap(tap.append)
    pilot.case.numbers.update(noise.changes(tap))


@case("parameters")
def _parameters(pilot: Pilot) -> None:
    for name in pilot.manners.parameters:
        value = pilot.parameter(name)
        if value is not None:
            pilot.case.numbers[name] = round(value, 4)
