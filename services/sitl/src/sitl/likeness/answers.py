"""Cases of an autopilot's answers: on the ground, to modes, and to requests."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from pymavlink.dialects.v20 import development as mavlink

from .channel import Heard
from .pilot import Pilot
from .procedures import HEIGHT_M, Procedures, case, down, up

ANSWERS: Procedures = {}


@case(ANSWERS, "takeoff while disarmed")
def _takeoff_while_disarmed(pilot: Pilot) -> None:
    pilot.track()
    pilot.takeoff(5)
    pilot.wait(3)
    pilot.arm()
    pilot.wait(8)
    pilot.case.numbers["height 8 s after arming"] = round(pilot.position[2], 1)
    pilot.land()
    down(pilot)


@case(ANSWERS, "arm in land mode")
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


@case(ANSWERS, "refusals in words")
def _refusals_in_words(pilot: Pilot) -> None:
    """Count the refusals whose STATUSTEXT arrives before the acknowledgement."""
    pilot.set_mode("land")
    pilot.wait(2)
    told = 0
    for _ in range(10):
        heard: list[Heard] = []
        pilot.tap(heard.append)
        pilot.arm()
        pilot.wait(1)
        pilot.untap(heard.append)
        kinds = [one.kind for one in heard if one.kind in ("STATUSTEXT", "COMMAND_ACK")]
        told += kinds[:1] == ["STATUSTEXT"]
    pilot.case.numbers["told before the acknowledgement"] = told
    pilot.rest()
    pilot.wait(2)


@case(ANSWERS, "takeoff in modes of the sticks")
def _takeoff_in_modes_of_the_sticks(pilot: Pilot) -> None:
    pilot.track()
    for mode in ("loiter", "poshold", "alt_hold", "stabilize"):
        pilot.set_mode(mode)
        pilot.arm()
        pilot.wait(3)
        pilot.takeoff(5)
        pilot.wait(5)
        pilot.case.numbers[f"height after a takeoff in {mode}"] = round(pilot.position[2], 1)
        pilot.land()
        down(pilot)


@case(ANSWERS, "reposition on the ground, disarmed")
def _reposition_disarmed(pilot: Pilot) -> None:
    pilot.goto(20, 0, HEIGHT_M)
    pilot.wait(2)
    pilot.stop_here()
    pilot.wait(2)


@case(ANSWERS, "reposition on the ground, armed")
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
    down(pilot)


@case(ANSWERS, "disarmed by itself")
def _disarmed_by_itself(pilot: Pilot) -> None:
    pilot.arm()
    pilot.until("", lambda: pilot.armed, 5)
    pilot.until("disarmed", lambda: not pilot.armed, 30)
    pilot.wait(2)


@case(ANSWERS, "modes on the ground")
def _modes_on_the_ground(pilot: Pilot) -> None:
    _modes(pilot, pilot.manners.on_ground)


@case(ANSWERS, "modes in the air")
def _modes_in_the_air(pilot: Pilot) -> None:
    up(pilot, 8)
    pilot.disarm()
    _modes(pilot, pilot.manners.in_air)
    pilot.takeoff(12)
    pilot.wait(2)
    pilot.land()
    down(pilot)


def _modes(pilot: Pilot, tried: Sequence[str]) -> None:
    for mode in tried:
        pilot.set_mode(mode)
        pilot.wait(1.5)
    for name, params in pilot.manners.odd_modes.items():
        pilot.command(name, mavlink.MAV_CMD_DO_SET_MODE, *params)
        pilot.wait(1.5)
    pilot.rest()
    pilot.wait(1.5)


@case(ANSWERS, "requests")
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


@case(ANSWERS, "acknowledgement to heartbeat")
def _acknowledgement_to_heartbeat(pilot: Pilot) -> None:
    """Measure how long after an acknowledgement a heartbeat reports the change, at moments spread over a second."""
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
