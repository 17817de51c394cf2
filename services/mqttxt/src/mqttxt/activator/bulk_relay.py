"""Relays objects in pieces, and keeps none of them (docs/protocol.md, section 16)."""

from __future__ import annotations

from ..core.effects import Effect, Inbound, Log, Publish
from ..protocol.bulk import BulkAnswer, BulkAsk
from ..protocol.codec import decode
from ..protocol.topics import DroneTopic
from ..security.cose import Envelope
from .drones import CLOUD, FOG, Drones
from .part import Part, Site
from .unanswered import Unanswered


class BulkRelay(Part):
    """Relays messages of the station in control to a drone, and the drone's answers."""

    def __init__(self, site: Site, drones: Drones) -> None:
        super().__init__(site)
        self._drones = drones
        self._unanswered = Unanswered()

    def on_ask(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """Relay a station's message on `fogX/droneY/bulk`; raises PayloadError."""
        drone, payload = topic.drone, message.payload
        to, seal = self._fog.bulk(drone), self._to_fog.seal
        if seal is None:
            ask = decode(BulkAsk, payload)
        else:
            signed = seal.open_of_station(self._to_fog.signed_topic(to), Envelope.parse(payload)).before_its_end()
            ask, payload = decode(BulkAsk, signed.payload), signed.envelope.bare().routed(None).encode()
            if not self._owners.is_of(ask.gs_session, signed.signer):
                return [Log("foreign_session", f"{message.topic}: not a session of {signed.signer}")]
        if not self._leases.controls(ask.gs_session, drone):
            return [Log("outsiders", f"{message.topic}: session {ask.gs_session:08x} is not in control")]
        link = self._drones.links.get(drone)
        if link is None or not link.announced or not self._unanswered.takes(drone, now_ms):
            return []
        return [Publish(FOG, to, payload, qos=0)]

    def on_answer(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """Relay a drone's message on `droneY/bulk_answer`; raises PayloadError."""
        decode(BulkAnswer, self._to_fog.opened(message, f"drone{topic.drone}"))
        self._unanswered.answered(topic.drone)
        return [Publish(CLOUD, self._cloud.drone_bulk_answer(topic.drone), message.payload, qos=0)]
