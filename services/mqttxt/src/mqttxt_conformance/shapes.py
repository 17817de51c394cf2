"""What a payload must look like, read off the specification's tables by hand: nothing here uses mqttxt's codec."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import isfinite
from typing import Any

import cbor2

from .registry import Broken

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
ANSWERS = ("", "have", "piece", "refused", "unchanged")
FIRST_WORDS = ("accepted", "in_progress")
CONTROLS = ("none", "want", "take")
COMMANDS = (
    *("", "arm", "disarm", "takeoff", "land", "goto", "hold", "return", "offboard", "stream", "mavlink"),
    *("upload_plan", "clear_plan", "start_mission", "pause", "resume", "set_current_item", "set_parameter"),
)

Judge = Callable[[Any, bool], bool]
"""Whether a value may stand in a field; the flag: the payload is JSON."""


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


_U32, _SESSION, _STAMP = _whole(0, 2**32 - 1), _whole(1, 2**32 - 1), _whole(0, 2**16 - 1)
_MS, _VERSION, _REASON = _whole(0, 2**53 - 1), _whole(1, 1), _text(200)
_LATITUDE, _LONGITUDE, _ALTITUDE = _scaled(-90, 90, 10**7), _scaled(-180, 180, 10**7), _scaled(-100_000, 100_000, 1000)
_SPEED, _SPEED_ALONG = _scaled(0, 655, 100), _scaled(-327.68, 327.67, 100)
_FIXES = ("no_gps", "no_fix", "fix_2d", "fix_3d", "dgps", "rtk_float", "rtk_fixed", "static", "ppp")
_SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_MODES = (
    *("unknown", "manual", "altitude", "position", "acro", "stabilized", "offboard", "hold", "mission", "takeoff"),
    *("return", "land", "follow", "precision_land", "orbit"),
)
_ID = {"version": _VERSION, "gs_session": _SESSION, "seq": _U32}

MESSAGES: dict[str, dict[str, Judge]] = {
    "presence": {"version": _VERSION, "session": _SESSION, "up": _flag, "revoked": _U32},
    "beacon": {"session": _SESSION, "now_ms": _MS, "nonce": _U32, "held_ms": _MS, "revoked": _U32},
    "result": {
        **_ID,
        "session": _SESSION,
        "relay_stamp": _STAMP,
        "stamp": _STAMP,
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
        "stamp": _STAMP,
        "roster": _container,
        "denied": _REASON,
        "beacon": _container,
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
        "stamp": _STAMP,
        "listed": _container,
        "left_out": _container,
        "chosen": _whole(1, 250),
        "hold_until_ms": _MS,
    },
    "qods": {"version": _VERSION, "session": _SESSION, "stamp": _STAMP, "ranking": _container},
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
"""Messages whose last field here says which fields of its own follow behind it."""

_REQUIRED = {
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
_NULLABLE = {("result", "relay_stamp"), ("command", "deadline_ms")}

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
    "mission": {"current": _STAMP, "reached": _STAMP, "total": _STAMP, "mission": _hash},
    "fence": {"breached": _flag, "fence": _hash},
}
"""Each state's own fields; `stamp` goes before them, and `relay_stamp` before that on the cloud side."""

_STATE_OPTIONAL = {"gps": 2, "power": 1, "airframe": 1, "mission": 1, "fence": 1}
"""How many fields of a state may be missing at its end."""


def read(kind: str, payload: bytes) -> dict[str, Any]:
    """A message's fields by name, codes as their labels; raises Broken where the specification is not followed."""
    table = MESSAGES[kind]
    found = _fields(kind, table, payload, _REQUIRED[kind], open_ended=kind in OPEN_ENDED)
    for name, labels in (("word", WORDS), ("control", CONTROLS), ("command", COMMANDS), ("answer", ANSWERS)):
        if type(found.get(name)) is int and name in table:
            found[name] = labels[found[name]]
    return found


def read_state(name: str, payload: bytes, relayed: bool) -> dict[str, Any]:
    """A state's fields and stamps by name; raises Broken."""
    if name not in STATES:
        raise Broken(f"state {name!r}: not in the specification's table")
    stamps: dict[str, Judge] = {"relay_stamp": _STAMP, "stamp": _STAMP} if relayed else {"stamp": _STAMP}
    table = {**stamps, **STATES[name]}
    required = len(table) - _STATE_OPTIONAL.get(name, 0)
    return _fields(f"state {name}", table, payload, required, open_ended=False)


def unbundled(payload: bytes) -> list[tuple[str, bytes]]:
    """Each state of a drone's bundle by name, as it would be on a topic of its own; raises Broken."""
    raw, known = plain(payload), ["", *STATES]
    try:
        if isinstance(raw, dict):
            rows = [(str(row["state"]), {k: v for k, v in row.items() if k != "state"}) for row in raw["states"]]
            return [(name, json.dumps({"stamp": raw["stamp"], **row}).encode()) for name, row in rows]
        stamp, states = raw
        return [(known[row[0]], cbor2.dumps([stamp, *row[1:]])) for row in states]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise Broken(f"bundle {shown(payload)}: expected a stamp, and states with their codes") from None


def nested(kind: str, value: Any) -> dict[str, Any]:
    """A message inside another one, as an answer's beacon."""
    plain = value if isinstance(value, dict) else dict(zip(MESSAGES[kind], value, strict=False))
    return {name: item for name, item in plain.items() if item is not None}


def plain(payload: bytes) -> Any:
    """What is in a payload, whatever it is; raises Broken where it is neither CBOR nor JSON."""
    try:
        return json.loads(payload) if payload[:1] == b"{" else cbor2.loads(payload)
    except (ValueError, cbor2.CBORError) as error:
        raise Broken(f"payload {payload[:24].hex(' ')}: neither CBOR nor JSON: {error}") from error


def _fields(kind: str, table: dict[str, Judge], payload: bytes, required: int, open_ended: bool) -> dict[str, Any]:
    raw = plain(payload)
    is_json = payload[:1] == b"{"
    if is_json:
        values = dict(raw)
    else:
        if not isinstance(raw, list):
            raise Broken(f"{kind} {shown(payload)}: expected an array")
        values = dict(zip(table, raw, strict=False))
        if len(raw) > len(table) and not open_ended:
            raise Broken(f"{kind} {shown(payload)}: expected at most {len(table)} fields")
        if raw and raw[-1] is None and len(raw) > required:
            raise Broken(f"{kind} {shown(payload)}: expected trailing nulls to be left out")
    for index, (name, judge) in enumerate(table.items()):
        value = values.get(name)
        if value is None and (index >= required or (kind, name) in _NULLABLE):
            continue
        if not judge(value, is_json):
            raise Broken(f"{kind} {shown(payload)}: {name} may not be {value!r}")
    unknown = [name for name in values if name not in table]
    if unknown and not open_ended:
        raise Broken(f"{kind} {shown(payload)}: unknown field {unknown[0]!r}")
    return {name: value for name, value in values.items() if value is not None}


def shown(payload: bytes) -> str:
    """A payload as a person reads it, shortened."""
    try:
        text = payload.decode() if payload[:1] == b"{" else repr(cbor2.loads(payload))
    except (ValueError, cbor2.CBORError):
        text = payload.hex(" ")
    return text if len(text) <= 120 else text[:117] + "..."


def reading_key(value: Any) -> tuple[Any, ...]:
    """Sensor, boot and seq of a reading in an acknowledgement."""
    return tuple(value.get(name) for name in ("sensor", "boot", "seq")) if isinstance(value, dict) else tuple(value)


def roster_entry(value: Any) -> tuple[int, int | None]:
    """A drone's number and session in a roster."""
    row: list[Any] = [value.get("drone"), value.get("session")] if isinstance(value, dict) else [*value, None]
    return row[0], row[1]
