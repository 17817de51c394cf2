"""The fields of payloads and their permitted values, copied by hand from the specification's tables."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import Any

WORDS = (
    "",
    "accepted",
    "in_progress",
    "completed",
    "denied",
    "unsupported",
    "failed",
    "expired",
    "overtaken",
    "superseded",
    "unreachable",
    "unconfirmed",
)
ANSWERS = ("", "have", "piece", "refused", "unchanged", "making")
FIRST_WORDS = ("accepted", "in_progress")
CONTROLS = ("none", "want", "take")
COMMANDS = (
    "", "arm", "disarm", "takeoff", "land", "goto", "hold", "return", "offboard", "stream", "mavlink",
    "upload_plan", "clear_plan", "start_mission", "pause", "resume", "set_current_item", "set_parameter",
)  # fmt: skip

Judge = Callable[[Any, bool], bool]
"""Whether a value is permitted in a field; the flag is true for JSON."""


def _whole(low: int, high: int) -> Judge:
    return lambda value, _: type(value) is int and low <= value <= high


def _scaled(low: float, high: float, per_unit: int) -> Judge:
    def judge(value: Any, is_json: bool) -> bool:
        if is_json:
            return type(value) in (int, float) and isfinite(value) and low <= value <= high
        return type(value) is int and low * per_unit <= value <= high * per_unit

    return judge


def _coded(*labels: str) -> Judge:
    def judge(value: Any, is_json: bool) -> bool:
        if is_json:
            return isinstance(value, str) and value in labels and value != ""
        return type(value) is int and 0 <= value < len(labels) and labels[value] != ""

    return judge


def _text(most: int) -> Judge:
    return lambda value, _: isinstance(value, str) and len(value) <= most


def _name(value: Any, _: bool) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 64 and value.isascii() and all(_is_of_name(c) for c in value)


def _is_of_name(character: str) -> bool:
    return character.isalnum() or character in "_.-"


def _hash(value: Any, is_json: bool) -> bool:
    if is_json:
        return isinstance(value, str) and len(value) == 32 and set(value) <= set("0123456789abcdef")
    return isinstance(value, bytes) and len(value) == 16


def _flag(value: Any, _: bool) -> bool:
    return type(value) is bool


def _container(value: Any, _: bool) -> bool:
    return isinstance(value, list | dict)


_U32, _SESSION, STAMP = _whole(0, 2**32 - 1), _whole(1, 2**32 - 1), _whole(0, 2**16 - 1)
_MS, _VERSION, _REASON = _whole(0, 2**53 - 1), _whole(1, 1), _text(200)
_LATITUDE, _LONGITUDE, _ALTITUDE = _scaled(-90, 90, 10**7), _scaled(-180, 180, 10**7), _scaled(-100_000, 100_000, 1000)
_SPEED, _SPEED_ALONG = _scaled(0, 655, 100), _scaled(-327.68, 327.67, 100)
_FIXES = ("no_gps", "no_fix", "fix_2d", "fix_3d", "dgps", "rtk_float", "rtk_fixed", "static", "ppp")
_SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_MODES = (
    "unknown", "manual", "altitude", "position", "acro", "stabilized", "offboard", "hold", "mission", "takeoff",
    "return", "land", "follow", "precision_land", "orbit",
)  # fmt: skip
_ID = {"version": _VERSION, "gs_session": _SESSION, "seq": _U32}

MESSAGES: dict[str, dict[str, Judge]] = {
    "presence": {"version": _VERSION, "session": _SESSION, "up": _flag, "revoked": _U32, "several": _flag},
    "beacon": {"session": _SESSION, "now_ms": _MS, "nonce": _U32, "held_ms": _MS, "revoked": _U32},
    "result": {
        **_ID,
        "session": _SESSION,
        "relay_stamp": STAMP,
        "stamp": STAMP,
        "word": _coded(*WORDS),
        "reason": _REASON,
        "percent": _whole(0, 100),
        "late_ms": _MS,
        "by": _container,
        "settled": _flag,
        "beacon": _container,
        "observed": _flag,
    },
    "fog-result": {
        **_ID,
        "session": _SESSION,
        "stamp": STAMP,
        "roster": _container,
        "denied": _REASON,
        "beacon": _container,
        "words": _container,
    },
    "drone-record": {
        "version": _VERSION,
        "activator_session": _SESSION,
        "up": _flag,
        "drone_session": _SESSION,
        "holder": _name,
        "holder_session": _SESSION,
        "epoch": _U32,
    },
    "fog-presence": {
        "version": _VERSION,
        "session": _SESSION,
        "up": _flag,
        "broker": _REASON,
        "authenticated": _flag,
        "drones": _container,
        "revoked": _U32,
    },
    "registration": {
        "version": _VERSION,
        "name": _name,
        "session": _SESSION,
        "nonce": _U32,
        "lease_s": _whole(0, 3600),
        "control": _coded(*CONTROLS),
        "bundles": _flag,
        "drones": _container,
        "until_ms": _MS,
        "epoch": _U32,
        "activator_session": _SESSION,
        "counter": _U32,
        "anew": _flag,
    },
    "drone-lease": {
        "version": _VERSION,
        "activator_session": _SESSION,
        "drone_session": _SESSION,
        "nonce": _U32,
        "bound": _flag,
        "epoch": _U32,
        "holder_session": _SESSION,
        "deadline_ms": _MS,
        "offboard_until_ms": _MS,
        "counter": _U32,
        "heard_ms": _MS,
        "anew": _flag,
        "holder": _name,
    },
    "command": {
        **_ID,
        "executor_session": _U32,
        "deadline_ms": _MS,
        "limit_s": _scaled(0.1, 86_400, 10),
        "epoch": _U32,
        "command": _coded(*COMMANDS),
    },
    "reading-ack": {"version": _VERSION, "readings": _container},
    "grant": {
        "version": _VERSION,
        "gs_session": _SESSION,
        "drone_session": _SESSION,
        "until_ms": _MS,
        "offboard_until_ms": _MS,
    },
    "psmi": {
        **_ID,
        "session": _SESSION,
        "stamp": STAMP,
        "listed": _container,
        "left_out": _container,
        "chosen": _whole(1, 250),
        "hold_until_ms": _MS,
    },
    "qods": {"version": _VERSION, "session": _SESSION, "stamp": STAMP, "ranking": _container},
    "bulk-answer": {
        "version": _VERSION,
        "gs_session": _SESSION,
        "kind": _name,
        "nonce": _U32,
        "answer": _coded(*ANSWERS),
    },
}
"""Each message's fields in the order of the CBOR array."""
OPEN_ENDED = {"command": "command", "bulk-answer": "answer"}
"""Messages with further fields behind their last one here, which determines those fields."""

REQUIRED = {
    "presence": 3,
    "beacon": 2,
    "result": 7,
    "fog-result": 5,
    "drone-record": 3,
    "fog-presence": 3,
    "registration": 5,
    "drone-lease": 6,
    "command": 8,
    "reading-ack": 2,
    "grant": 4,
    "psmi": 7,
    "qods": 4,
    "bulk-answer": 5,
}
NULLABLE = {("result", "relay_stamp"), ("command", "deadline_ms")}

STATES: dict[str, dict[str, Judge]] = {
    "battery": {"remaining_pct": _whole(0, 100)},
    "location": {
        "latitude_deg": _LATITUDE,
        "longitude_deg": _LONGITUDE,
        "altitude_amsl_m": _ALTITUDE,
        "altitude_m": _ALTITUDE,
    },
    "heading": {"heading_deg": _scaled(0, 359.99, 100)},
    "groundspeed": {"groundspeed_m_s": _SPEED},
    "flight_mode": {"mode": _coded(*_MODES)},
    "armed": {"armed": _flag},
    "landed_state": {"landed": _coded("undefined", "on_ground", "in_air", "takeoff", "landing")},
    "max_groundspeed": {"max_groundspeed_m_s": _SPEED},
    "home": {"latitude_deg": _LATITUDE, "longitude_deg": _LONGITUDE, "altitude_amsl_m": _ALTITUDE},
    "health": {"armable": _flag, "unhealthy_sensors": _U32},
    "endurance": {"endurance_s": _whole(60, 86_400), "cruise_m_s": _SPEED},
    "velocity": {"north_m_s": _SPEED_ALONG, "east_m_s": _SPEED_ALONG, "down_m_s": _SPEED_ALONG},
    "gps": {"fix": _coded(*_FIXES), "satellites": _whole(0, 254), "hdop": _scaled(0, 655.34, 100)},
    "power": {"voltage_v": _scaled(0, 65.534, 1000), "current_a": _scaled(0, 327.67, 100)},
    "airframe": {"autopilot": _whole(0, 255), "kind": _whole(0, 255), "version": _U32},
    "text": {"severity": _coded(*_SEVERITIES), "text": _text(200)},
    "mission": {"current": STAMP, "reached": STAMP, "total": STAMP, "mission": _hash},
    "fence": {"breached": _flag, "fence": _hash},
}
"""Each state's own fields; `stamp` precedes them, and on the cloud side `relay_stamp` precedes that."""

STATE_OPTIONAL = {"gps": 2, "power": 1, "airframe": 1, "mission": 1, "fence": 1}
"""How many fields at a state's end may be missing."""
