"""The messages of one connection: encoded and, where the node signs, signed on the way out, verified on the way in."""

from __future__ import annotations

from collections.abc import Hashable

from ..protocol.codec import encode
from ..security.seal import Seal
from .effects import Inbound, Publish
from .settings import Settings


class Channel:
    """What a role says and hears on `link`, below `root`. Without a `seal` messages are not signed (section 12)."""

    def __init__(self, link: str, root: str, settings: Settings, seal: Seal | None = None) -> None:
        self.link = link
        self.seal = seal
        self.settings = settings
        self._root = root

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
    ) -> Publish:
        """Say a message; at the QoS of commands where none is named."""
        return Publish(
            self.link,
            topic,
            self.payload(topic, message, with_certificate),
            self.settings.qos if qos is None else qos,
            retain=retain,
            expiry_s=expiry_s,
            ref=ref,
        )

    def payload(self, topic: str, message: object, with_certificate: bool = False) -> bytes:
        """A message's bytes on a topic; raises PayloadError when a field cannot be carried."""
        encoded = self.encoded(message)
        if self.seal is None:
            return encoded
        return self.seal.sign(self.signed_topic(topic), encoded, with_certificate).encode()

    def encoded(self, message: object) -> bytes:
        """A message's bytes before anybody signs them; raises PayloadError when a field cannot be carried."""
        return encode(message, self.settings.encoding)

    def opened(self, message: Inbound, signer: str) -> bytes:
        """What `signer` said; raises PayloadError where messages are signed and this one is not by them."""
        if self.seal is None:
            return message.payload
        return self.seal.open(self.signed_topic(message.topic), message.payload, signer).payload

    def signed_topic(self, topic: str) -> str:
        """A topic as signatures name it (R12.3)."""
        return topic.removeprefix(self._root)
