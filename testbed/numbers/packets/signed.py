"""The signed content of a PUBLISH, in a fleet that signs (docs/protocol.md, section 12). No signature is verified."""

from __future__ import annotations

from mqttxt.errors import PayloadError
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope


def inside(body: bytes) -> bytes:
    """The payload of an envelope; a body that is not an envelope is returned as it is."""
    try:
        return Envelope.parse(body).payload
    except PayloadError:
        return body


def by_drone(body: bytes) -> dict[int, bytes]:
    """The command for each drone, if a body carries commands signed for drones; else an empty dict."""
    try:
        return {drone: envelope.payload for drone, envelope in Addressed.parse(body).entries.items()}
    except PayloadError:
        return {}
