"""What is signed inside a PUBLISH of a fleet that signs (docs/protocol.md, section 12). Nothing here verifies it."""

from __future__ import annotations

from mqttxt.errors import PayloadError
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope


def inside(body: bytes) -> bytes:
    """What an envelope is around; a body that is none as it is."""
    try:
        return Envelope.parse(body).payload
    except PayloadError:
        return body


def by_drone(body: bytes) -> dict[int, bytes]:
    """The command for each drone, of a body that carries commands signed for drones; of another nothing."""
    try:
        return {drone: envelope.payload for drone, envelope in Addressed.parse(body).entries.items()}
    except PayloadError:
        return {}
