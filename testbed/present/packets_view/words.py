"""A captured message in a line of text: MQTT-XT payloads by their topics, MAVLink messages by their fields."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from pymavlink.dialects.v20 import development as dialect

from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.state_payload import message_class
from mqttxt.protocol.topic_table import CLOUD_SIDE, FOG_SIDE, SENSOR_SIDE, TopicRow
from mqttxt.protocol.values import Encoding

from ...numbers.dissect.mavlink import MAVLink, Message
from ...numbers.dissect.mavlink_fields import CharArray, Number
from ...numbers.packets.signed import by_drone, inside

_LEVELS = {
    "fogX": r"fog\d+",
    "droneY": r"drone\d+",
    "sensorS": r"sensor\d+",
    "Z": r"(?P<state>(?:mavlink/)?[^/]+)",
    "C": "[^/]+",
    "G": "[^/]+",
    "K": "[^/]+",
}
"""The placeholders of the topic table, as regular expressions."""
_SHOWN_BYTES = 24


def said_by_publish(topic: str, body: bytes) -> str:
    """The payload of a PUBLISH as JSON if MQTT-XT has a message for its topic, else its first bytes.

    A signed payload is shown without its signature.
    """
    found = payload_class(topic)
    if found is not None:
        try:
            said = {drone: _json(found, payload) for drone, payload in by_drone(body).items()}
            return ", ".join(f"drone {drone}: {text}" for drone, text in said.items()) or _json(found, inside(body))
        except PayloadError:
            pass
    if not body:
        return "empty"
    rest = f" … {len(body)} bytes" if len(body) > _SHOWN_BYTES else ""
    return body[:_SHOWN_BYTES].hex(" ") + rest


def _json(message: type[Any], payload: bytes) -> str:
    return encode(decode(message, payload), Encoding.JSON).decode()


@cache
def payload_class(topic: str) -> type[Any] | None:
    """MQTT-XT's message class for a topic; None for a topic that MQTT-XT does not have.

    States on cloud-side topics have the activator's stamp, those on fog-side topics do not.
    """
    for row, pattern in _patterns():
        found = pattern.fullmatch(topic)
        if found is None:
            continue
        if isinstance(row.payload, type):
            return row.payload
        try:
            return message_class(found["state"], row in CLOUD_SIDE)
        except (PayloadError, IndexError):
            return None
    return None


@cache
def _patterns() -> tuple[tuple[TopicRow, re.Pattern[str]], ...]:
    return tuple(
        (row, re.compile("/".join(_LEVELS.get(level, re.escape(level)) for level in row.topic.split("/"))))
        for row in (*CLOUD_SIDE, *FOG_SIDE, *SENSOR_SIDE)
    )


def said_by_frame(frame: MAVLink) -> str:
    """A message's sender (system:component), and its fields that are not zero, in the order of common.xml."""
    message = frame.getfieldval("message")
    whose = f"{frame.getfieldval('sysid')}:{frame.getfieldval('compid')}"
    if not isinstance(message, Message):
        return f"{whose} message {frame.getfieldval('msgid')}, {len(message)} bytes"
    fields = [f"{name}={value}" for name, value in _fields_said(message)]
    return " ".join([whose, *fields])


def _fields_said(message: Message) -> Iterator[tuple[str, str]]:
    own = {field.name: field for field in message.fields_desc}
    for name in dialect.mavlink_map[message.msgid].fieldnames:
        field, value = own[name], message.getfieldval(name)
        if isinstance(field, Number) and field.names and not field.bits:
            yield name, field.names.get(value, str(value))
        elif isinstance(field, CharArray):
            yield name, field.i2repr(message, value)
        elif isinstance(value, list):
            if any(value):
                yield name, "[" + ",".join(f"{item:.6g}" for item in value) + "]"
        elif value:
            yield name, f"{value:.6g}" if isinstance(value, float) else str(value)
