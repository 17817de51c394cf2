"""Decodes and checks payloads by the specification's tables, without mqttxt's codec."""

from __future__ import annotations

import json
from typing import Any

import cbor2

from .fields import (
    ANSWERS,
    COMMANDS,
    CONTROLS,
    MESSAGES,
    NULLABLE,
    OPEN_ENDED,
    REQUIRED,
    STAMP,
    STATE_OPTIONAL,
    STATES,
    WORDS,
    Judge,
)
from .registry import Broken


def read(kind: str, payload: bytes) -> dict[str, Any]:
    """A message's fields by name, with labels for codes; raises Broken if it does not follow the specification."""
    table = MESSAGES[kind]
    found = _fields(kind, table, payload, REQUIRED[kind], open_ended=kind in OPEN_ENDED)
    for name, labels in (("word", WORDS), ("control", CONTROLS), ("command", COMMANDS), ("answer", ANSWERS)):
        if type(found.get(name)) is int and name in table:
            found[name] = labels[found[name]]
    return found


def read_state(name: str, payload: bytes, relayed: bool) -> dict[str, Any]:
    """A state's fields and stamps by name; raises Broken as `read` does."""
    if name not in STATES:
        raise Broken(f"state {name!r}: not in the specification's table")
    stamps: dict[str, Judge] = {"relay_stamp": STAMP, "stamp": STAMP} if relayed else {"stamp": STAMP}
    table = {**stamps, **STATES[name]}
    required = len(table) - STATE_OPTIONAL.get(name, 0)
    return _fields(f"state {name}", table, payload, required, open_ended=False)


def unbundled(payload: bytes) -> list[tuple[str, bytes]]:
    """The name of each state in a drone's bundle, and its payload as on its own topic; raises Broken."""
    raw, known = plain(payload), dict(enumerate(STATES, start=1))
    try:
        if isinstance(raw, dict):
            rows = [(str(row["state"]), {k: v for k, v in row.items() if k != "state"}) for row in raw["states"]]
            return [(name, json.dumps({"stamp": raw["stamp"], **row}).encode()) for name, row in rows]
        stamp, states = raw
        return [(known[row[0]], cbor2.dumps([stamp, *row[1:]])) for row in states]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise Broken(f"bundle {shown(payload)}: expected a stamp, and states with their codes") from None


def apart(payload: bytes) -> list[tuple[int, bytes]]:
    """The drone of each word in a fog-result, and the word as a result of its own; raises Broken."""
    fields = read("fog-result", payload)
    found: list[tuple[int, bytes]] = []
    try:
        for row in fields.get("words", ()):
            about = {name: fields[name] for name in ("version", "gs_session", "seq")}
            if isinstance(row, dict):
                said = {name: value for name, value in row.items() if name != "drone"}
                found.append((int(row["drone"]), json.dumps({**about, **said}).encode()))
            else:
                found.append((int(row[0]), cbor2.dumps([*about.values(), *row[1:]])))
    except (KeyError, IndexError, TypeError, ValueError):
        raise Broken(f"words {shown(payload)}: expected each with its drone") from None
    return found


def nested(kind: str, value: Any) -> dict[str, Any]:
    """The fields of a message inside another one, such as an answer's beacon."""
    plain = value if isinstance(value, dict) else dict(zip(MESSAGES[kind], value, strict=False))
    return {name: item for name, item in plain.items() if item is not None}


def plain(payload: bytes) -> Any:
    """A payload decoded without further checks; raises Broken if it is neither CBOR nor JSON."""
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
        if value is None and (index >= required or (kind, name) in NULLABLE):
            continue
        if not judge(value, is_json):
            raise Broken(f"{kind} {shown(payload)}: {name} may not be {value!r}")
    unknown = [name for name in values if name not in table]
    if unknown and not open_ended:
        raise Broken(f"{kind} {shown(payload)}: unknown field {unknown[0]!r}")
    return {name: value for name, value in values.items() if value is not None}


def shown(payload: bytes) -> str:
    """A payload as readable text of at most 120 characters."""
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
