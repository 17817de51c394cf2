"""A mission's requests that need several calls of MAVSDK, or converted arguments."""

from __future__ import annotations

import math

from mavsdk.plugins.mission_raw import MissionItem
from pymavlink.dialects.v20 import common as mavlink

from .fleet import Point, Survey
from .mavsdk_drone import MavsdkDrone


async def take_off(drone: MavsdkDrone, altitude_m: float) -> None:
    """Take off. MAVSDK climbs to the vehicle's takeoff altitude, which is first set to `altitude_m` if it differs."""
    if drone.takeoff_altitude_m != altitude_m:
        await drone.action.set_takeoff_altitude(altitude_m)
        drone.takeoff_altitude_m = altitude_m
    await drone.action.takeoff()


async def go_to(drone: MavsdkDrone, point: Point) -> None:
    """Fly to a point. MAVSDK takes altitudes above sea level: home's is the difference of the drone's own two."""
    amsl_m = drone.view.home_amsl_m + point.altitude_m
    await drone.action.goto_location(point.latitude_deg, point.longitude_deg, amsl_m, math.nan)


def items_of(survey: Survey) -> list[MissionItem]:
    """A survey as the items that MAVSDK uploads."""
    first, *_ = survey.points
    there = [(mavlink.MAV_CMD_NAV_TAKEOFF, first), *((mavlink.MAV_CMD_NAV_WAYPOINT, point) for point in survey.points)]
    items = [_item(seq, command, point) for seq, (command, point) in enumerate(there)]
    return [*items, _item(len(items), mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, None)]


def _item(seq: int, command: int, point: Point | None) -> MissionItem:
    """An item at a point above home, or without a position; its heading is not set."""
    frame, x, y, z = mavlink.MAV_FRAME_MISSION, 0, 0, 0.0
    if point is not None:
        frame, z = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, point.altitude_m
        x, y = round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7)
    heading = math.nan if point is not None else 0.0
    return MissionItem(seq, frame, command, int(seq == 0), 1, 0.0, 0.0, 0.0, heading, x, y, z, 0)
