"""Where the stand-in differs from an autopilot for good, which cases are not flown with it, and why."""

from __future__ import annotations

_DRIFTS = "PX4's estimate drifts by metres in minutes; the stand-in's errors stay about nothing, so that flights repeat"
_SPEED = "ArduCopter flew on at 10 m/s after WPNAV_SPEED was set to 12 m/s; the stand-in flies what is set"
_ASKED = "PX4 says what it says without being asked"
_ONE_LINK = "ArduCopter says the same on each of its links: what it is asked for there"

APART: dict[str, dict[tuple[str, str], str]] = {
    "px4": {
        ("goto and return", "goto at rest"): _DRIFTS,
        ("idle, onboard link", "relative_altitude_m"): _DRIFTS,
        ("idle, onboard link", "changes of home"): _DRIFTS,
        ("idle, onboard link", "largest jump of home_m"): _DRIFTS,
    },
    "ardupilot": {
        ("requests", "acknowledgement 15"): "The stand-in has no raw sensors to tell of",
        ("return at the height of flight", "fastest"): _SPEED,
        ("return at the height of flight", "return near home"): _SPEED,
    },
}
"""By family, case and the beginning of a fact's name."""
NOT_FLOWN: dict[str, dict[str, str]] = {
    "px4": {
        "takeoff in modes of the sticks": "PX4's takeoff is a mode of its own",
        "unasked": _ASKED,
        "velocity, and its client ends": "PX4 follows set-points in a mode of their own: offboard, and its client ends",
    },
    "ardupilot": {
        "idle, ground station's link": _ONE_LINK,
        "idle, normal link": _ONE_LINK,
        "logs listed and read": "not recorded yet: what the stand-in does is from ArduPilot's sources",
        "offboard, and its client ends": "ArduCopter has no such mode: velocity, and its client ends",
    },
}
"""By family, cases that do not apply to it."""
OF_ITSELF: dict[str, tuple[str, ...]] = {
    "px4": (
        "With a fleet's capacity and charge a battery is an energy, not PX4's simulated one, which drains to 50 % in "
        "half a minute: rankings would have nothing to rank.",
        "Where PX4 main took a goto in MAV_FRAME_GLOBAL_INT alone, which was undone later, the stand-in takes the "
        "others.",
        "Parameters are those that change its flight, not PX4's thousand; there is no file to download. A value out of "
        "range, and NaN, is refused, where PX4 takes it.",
        "Of a mission's items it flies takeoff, waypoint, loiter, land, return, change of speed and jump; others are "
        "over at once. Fences and rally points are kept, and not acted upon.",
        "The land detector is a time on the ground, so a landing takes as long as the quicker half of PX4's.",
        "An offboard attitude is flown as a velocity.",
    ),
    "ardupilot": (
        "It has no messages of ArduPilot's own dialect, and does not answer REQUEST_DATA_STREAM.",
        "Parameters are those that change its flight, not ArduCopter's thousand; whole ones are all said as INT32. A "
        "value out of range is refused, where ArduCopter takes any that the type holds.",
        "Of a mission's items it knows a dozen; fences and rally points are kept, and not acted upon. There is no file "
        "to download.",
        "A NaN in NAV_TAKEOFF is refused, where ArduCopter ends with a floating point exception.",
        "An offboard attitude is flown as a velocity.",
    ),
}
"""By family, the differences that no case shows."""


def reason(like: str, case: str, name: str) -> str | None:
    """Why a fact may differ; None for one that has to agree."""
    return next((why for (at, what), why in APART[like].items() if at == case and name.startswith(what)), None)


def not_flown(like: str, case: str) -> str | None:
    """Why a case does not apply; None for one that is flown."""
    return NOT_FLOWN[like].get(case)
