"""The messages of one connection: encoded and, where the node signs, signed on the way out, verified on the way in."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

from ..errors import PayloadError
from ..protocol.codec import encode
from ..protocol.topics import SensorSide
from .clock import RemoteClock
from .effects import Inbound, Publish
from .settings import Settings

if TYPE_CHECKING:
    from ..security.seal import Seal


SPAN_MS = 327_680
"""Half of the time that stamps can tell apart (R3.6)."""
LATE_MS = 60_000
"""How late a signed state of the previous span may arrive; one of the current span may arrive at any time in it."""
MOST_SPANS = 3
"""How many spans before the newest one are tried for a state whose sender's clock is known only roughly."""


class Channel:
    """A role's messages on `link`, on topics below `root`. Without a `seal` messages are not signed (section 12)."""

    def __init__(self, link: str, root: str, settings: Settings, seal: Seal | None = None) -> None:
        self.link = link
        self.seal = seal
        self.settings = settings
        self._root = root

    @property
    def list_number(self) -> int | None:
        """The number of the newest revocation list that this node has; None where messages are not signed."""
        return self.seal.identity.fleet.revoked.number if self.seal is not None else None

    def publish(
        self,
        topic: str,
        message: object,
        *,
        qos: int | None = None,
        retain: bool = False,
        expiry_s: int | None = None,
        ref: Hashable = None,
        with_certificate: bool = False,
        signed_as: str | None = None,
        everywhere: bool = False,
    ) -> Publish:
        """Publish a message, by default at the QoS of commands; `signed_as`: the topic to sign if it is another."""
        return Publish(
            self.link,
            topic,
            self.payload(topic, message, with_certificate, signed_as),
            self.settings.qos if qos is None else qos,
            retain=retain,
            expiry_s=expiry_s,
            ref=ref,
            everywhere=everywhere,
        )

    def payload(
        self, topic: str, message: object, with_certificate: bool = False, signed_as: str | None = None
    ) -> bytes:
        """Encode a message and, with a seal, sign it for its topic; raises PayloadError for an impossible field."""
        encoded = encode(message, self.settings.encoding)
        if self.seal is None:
            return encoded
        return self.seal.sign(signed_as or self.signed_topic(topic), encoded, with_certificate).encode()

    def opened(self, message: Inbound, signer: str, signed_as: str | None = None) -> bytes:
        """The payload of a message; if messages are signed, raises PayloadError unless `signer` has signed it."""
        if self.seal is None:
            return message.payload
        return self.seal.open(signed_as or self.signed_topic(message.topic), message.payload, signer).payload

    @property
    def signs_states(self) -> bool:
        """Whether states are signed."""
        return self.seal is not None and self.seal.signs_states

    def state_payload(self, topic: str, payload: bytes, session: int, now_ms: int) -> bytes:
        """The bytes to publish for a state or a bundle: signed for this node's session if states are signed."""
        return self.dated_payload(topic, payload, session, now_ms) if self.signs_states else payload

    def dated_payload(self, topic: str, payload: bytes, session: int, now_ms: int) -> bytes:
        """The bytes to publish for a stamped payload: if messages are signed, for this session and span (R12.20)."""
        if self.seal is None:
            return payload
        said_as = _dated_as(self.signed_topic(topic), session, now_ms // SPAN_MS)
        return self.seal.sign(said_as, payload).encode()

    def opened_state(self, message: Inbound, signer: str, clock: RemoteClock | None, now_ms: int) -> bytes:
        """The payload of a state or a bundle of `signer`; `clock` is the clock of the signer's session.

        If states are signed, raises PayloadError for one that another node signed, of another session, or too old.
        """
        return self.opened_dated(message, signer, clock, now_ms) if self.signs_states else message.payload

    def opened_dated(self, message: Inbound, signer: str, clock: RemoteClock | None, now_ms: int) -> bytes:
        """The payload that `dated_payload` signed; if messages are signed, raises PayloadError like `opened_state`."""
        if self.seal is None:
            return message.payload
        least_ms = clock.deadline_ms(now_ms, 0) if clock is not None else None
        if clock is None or least_ms is None:
            raise PayloadError(f"{message.topic} of {signer}: expected a beacon before", "unknown_session")
        most_ms = max(least_ms, clock.latest_now_ms(now_ms) or 0)
        first, last = max(0, least_ms - LATE_MS) // SPAN_MS, most_ms // SPAN_MS
        topic = self.signed_topic(message.topic)
        refusal: PayloadError | None = None
        for span in range(last, max(first, last - MOST_SPANS) - 1, -1):
            try:
                return self.seal.open(_dated_as(topic, clock.session, span), message.payload, signer).payload
            except PayloadError as error:
                refusal = refusal or error
        assert refusal is not None
        raise refusal

    @property
    def signs_readings(self) -> bool:
        """Whether sensors sign their readings."""
        return self.seal is not None and self.seal.signs_readings

    def opened_reading(self, payload: bytes, sensor: int, kind: str) -> bytes:
        """A sensor's reading; if readings are signed, raises PayloadError unless this sensor has signed it."""
        if self.seal is None or not self.seal.signs_readings:
            return payload
        return self.seal.open(SensorSide().sensor(sensor, kind), payload, f"sensor{sensor}").payload

    def signed_topic(self, topic: str) -> str:
        """The form of a topic that is signed (R12.3)."""
        return topic.removeprefix(self._root)


def _dated_as(topic: str, session: int, span: int) -> str:
    """The signed form of the topic of a state or a ranking: by the stamp alone an old message would pass as new."""
    return f"{topic}@{session}.{span}"
