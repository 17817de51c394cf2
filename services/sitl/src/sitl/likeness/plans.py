"""Cases of plans: how an autopilot takes them, gives them back, refuses them, and flies a mission."""

from __future__ import annotations

import math
from dataclasses import replace

from pymavlink.dialects.v20 import development as mavlink

from ..plans import FENCE, MISSION, RALLY, Item
from .channel import Heard
from .pilot import Pilot
from .planner import Planner
from .procedures import FLIGHT_S, Procedures, arm, case, down

PLANS: Procedures = {}
_RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
END_S = 20.0
"""Longer than any autopilot waits for an item."""


def _place(pilot: Pilot, command: int, north_m: float, east_m: float, up_m: float, *params: float) -> Item:
    """An item with a place, in metres from the drone."""
    here = pilot.last["GLOBAL_POSITION_INT"]
    metre = 180e7 / (math.pi * 6_371_000.0)
    x, y = here.lat + north_m * metre, here.lon + east_m * metre / math.cos(math.radians(here.lat / 1e7))
    four = [*params, *[0.0] * (4 - len(params))]
    return Item(_RELATIVE, command, (four[0], four[1], four[2], four[3]), round(x), round(y), up_m)


def _plain(command: int, *params: float) -> Item:
    """An item without a place."""
    four = [*params, *[0.0] * (4 - len(params))]
    return Item(mavlink.MAV_FRAME_MISSION, command, (four[0], four[1], four[2], four[3]), 0, 0, 0.0)


def _mission(pilot: Pilot) -> list[Item]:
    """A home where one belongs, up, a square with changes of speed, and back."""
    waypoint = mavlink.MAV_CMD_NAV_WAYPOINT
    return [
        *([_place(pilot, waypoint, 0, 0, 0)] if pilot.manners.has_home_item else []),
        _place(pilot, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 10, 15, 0, 0, pilot.manners.unused),
        _place(pilot, waypoint, 30, 0, 10, 2, 0, 0, pilot.manners.unused),
        _plain(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 4, -1),
        _place(pilot, waypoint, 30, 20, 12, 0, 3, 1, 400),
        _place(pilot, mavlink.MAV_CMD_NAV_LOITER_TIME, 0, 20, 12, 3, 1, 5, 1),
        _plain(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    ]


def _fence(pilot: Pilot) -> list[Item]:
    inside, outside = (
        mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
    )
    corners = [(-200, -200), (200, -200), (200, 200), (-200, 200)]
    polygon = [_place(pilot, inside, north, east, 0, 4) for north, east in corners]
    return [*polygon, _place(pilot, outside, 150, 150, 0, 20)]


def _rally(pilot: Pilot) -> list[Item]:
    return [_place(pilot, mavlink.MAV_CMD_NAV_RALLY_POINT, north, 0, 15) for north in (20, 40)]


def _begin(pilot: Pilot, planner: Planner, items: list[Item]) -> None:
    """Upload a mission and start it on the ground, armed."""
    planner.upload(items)
    planner.follow()
    arm(pilot)
    pilot.set_mode(pilot.manners.mission)
    pilot.begin_mission()


def _end(pilot: Pilot, planner: Planner) -> None:
    down(pilot)
    planner.unfollow()
    planner.clear()


@case(PLANS, "plans up and down")
def _up_and_down(pilot: Pilot) -> None:
    """Each list is uploaded, read back, and cleared."""
    planner = Planner(pilot)
    for kind, items in ((MISSION, _mission(pilot)), (FENCE, _fence(pilot)), (RALLY, _rally(pilot))):
        planner.clear(kind)
        planner.list(kind)
        planner.end(kind)
        planner.upload(items, kind)
        planner.download(items, kind)
        planner.clear(kind)
    planner.list()
    planner.end()
    planner.upload(_mission(pilot)[:2])
    planner.count(0)
    planner.list()
    planner.end()
    planner.clear(mavlink.MAV_MISSION_TYPE_ALL)
    planner.clear()


@case(PLANS, "plans refused")
def _refused(pilot: Pilot) -> None:
    """Invalid lists, and messages out of turn."""
    planner, good = Planner(pilot), _mission(pilot)
    planner.upload(good)
    planner.want(0)
    planner.item(good[0], 0)
    planner.item(good[-1], len(good) - 1)
    planner.count(65_535)
    for wrong in (
        replace(good[1], command=31_999),
        replace(good[1], frame=mavlink.MAV_FRAME_LOCAL_NED),
        _place(pilot, mavlink.MAV_CMD_NAV_RALLY_POINT, 0, 0, 5),
    ):
        planner.count(2)
        planner.item(wrong, 0)
        planner.abandon()
    planner.count(3)
    planner.item(good[1], 1)
    planner.item(good[0], 0)
    planner.count(3)
    planner.abandon()
    planner.count(2, FENCE)
    planner.item(_place(pilot, mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, 0, 0, 0, 2), 0, FENCE)
    planner.abandon(FENCE)
    planner.list()
    planner.want(1)
    planner.want(0)
    planner.want(0)
    planner.want(1)
    planner.want(99)
    planner.end()
    planner.list()
    planner.end()
    planner.clear()


@case(PLANS, "an upload that stands still")
def _standing_still(pilot: Pilot) -> None:
    """How often and for how long an item is requested again, and which list remains afterwards."""
    planner, good = Planner(pilot), _mission(pilot)
    planner.upload(good[:2])
    planner.count(4)
    asked: list[float] = []
    ended: list[float] = []

    def take(heard: Heard) -> None:
        if heard.kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            asked.append(pilot.now_s)
        elif heard.kind == "STATUSTEXT" and "timeout" in heard.message.text.lower():
            ended.append(pilot.now_s)

    begun_s = pilot.now_s
    pilot.tap(take)
    pilot.until("", lambda: bool(ended), END_S)
    pilot.untap(take)
    pilot.case.numbers["delay of the first repetition"] = round(asked[0] - begun_s, 2)
    pilot.case.numbers["delay between repetitions"] = round((asked[-1] - asked[0]) / (len(asked) - 1), 2)
    pilot.case.durations_s["given up"] = round(ended[0] - begun_s, 2)
    planner.item(good[0], 0)
    planner.list()
    planner.end()
    planner.clear()


@case(PLANS, "a mission is flown")
def _flown(pilot: Pilot) -> None:
    """Armed and started on the ground; paused, continued, set back to its first waypoint, and flown to its end."""
    pilot.track()
    planner, items = Planner(pilot), _mission(pilot)
    first = len(items) - 6
    _begin(pilot, planner, items)
    pilot.until("mission", lambda: pilot.mode == pilot.manners.mission, 5)
    pilot.until("takeoff reached", lambda: planner.reached >= first, FLIGHT_S)
    pilot.mark()
    pilot.until("waypoint reached", lambda: planner.reached >= first + 1, FLIGHT_S)
    pilot.mark()
    pilot.wait(2)
    pilot.stop_here()
    pilot.wait(4)
    pilot.case.numbers["speed in the pause"] = round(pilot.speed_m_s, 1)
    pilot.set_mode(pilot.manners.mission)
    pilot.until("second waypoint reached", lambda: planner.reached >= first + 3, FLIGHT_S)
    planner.set_current(first + 1)
    pilot.until("back at the first", lambda: planner.current > first + 1, FLIGHT_S)
    pilot.mark()
    _end(pilot, planner)


@case(PLANS, "a mission that ends in the air")
def _ends_in_the_air(pilot: Pilot) -> None:
    planner = Planner(pilot)
    items = _mission(pilot)[:-4]
    _begin(pilot, planner, items)
    pilot.until("last reached", lambda: planner.reached >= len(items) - 1, FLIGHT_S)
    pilot.wait(4)
    pilot.land()
    _end(pilot, planner)


@case(PLANS, "a mission that lands")
def _lands(pilot: Pilot) -> None:
    planner = Planner(pilot)
    items = [*_mission(pilot)[:-5], _place(pilot, mavlink.MAV_CMD_NAV_LAND, 5, 0, 0)]
    _begin(pilot, planner, items)
    pilot.until("in the air", lambda: not pilot.landed, FLIGHT_S)
    _end(pilot, planner)
