"""Objects in pieces through the activator: passed on as they come, nothing is kept (docs/protocol.md, section 16)."""

from __future__ import annotations

from ..core.channel import Channel
from ..core.effects import Effect, Inbound, Log, Publish
from ..core.session_owners import SessionOwners
from ..protocol.bulk import BulkAnswer, BulkAsk
from ..protocol.codec import decode
from ..protocol.topics import CloudSide, DroneTopic, FogSide
from ..security.cose import Envelope
from .drones import CLOUD, FOG, Drones
from .leases import Leases

MOST_UNANSWERED = 8
"""Messages to a drone without an answer: a station that keeps to the rules sends two."""
FORGIVEN_MS = 2000
"""How long it takes until what was not answered counts as lost."""


class BulkRelay:
    """What the station in control says to a drone, and what the drone answers."""

    def __init__(
        self,
        to_cloud: Channel,
        to_fog: Channel,
        cloud: CloudSide,
        fog_side: FogSide,
        drones: Drones,
        leases: Leases,
        owners: SessionOwners,
    ) -> None:
        self._to_cloud, self._to_fog = to_cloud, to_fog
        self._cloud, self._fog = cloud, fog_side
        self._drones = drones
        self._leases = leases
        self._owners = owners
        self._unanswered: dict[int, tuple[int, int]] = {}
        """By drone: how many, and since when."""

    def on_ask(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A station's message; raises PayloadError."""
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
        if link is None or not link.announced or not self._may_pass(drone, now_ms):
            return []
        return [Publish(FOG, to, payload, qos=0)]

    def on_answer(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's message; raises PayloadError."""
        decode(BulkAnswer, self._to_fog.opened(message, f"drone{topic.drone}"))
        self._unanswered.pop(topic.drone, None)
        return [Publish(CLOUD, self._cloud.drone_bulk_answer(topic.drone), message.payload, qos=0)]

    def _may_pass(self, drone: int, now_ms: int) -> bool:
        """Whether a drone has room for one more message: a flood stays on this side of its link."""
        count, since_ms = self._unanswered.get(drone, (0, now_ms))
        if now_ms - since_ms > FORGIVEN_MS:
            count, since_ms = 0, now_ms
        self._unanswered[drone] = (count + 1, since_ms)
        return count < MOST_UNANSWERED
