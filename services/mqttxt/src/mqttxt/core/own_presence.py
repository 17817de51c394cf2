"""A process's own birth and will, retained on a topic that shows nothing else while it lives (protocol, section 9)."""

from __future__ import annotations

from ..protocol.codec import decode
from ..protocol.messages import Presence
from .channel import Channel
from .effects import Inbound, Publish, Will
from .settings import Rebirth


class OwnPresence:
    """That of a ground station's or a UAV client's `session`, on `topic` of a channel.

    `rebirth` is for its owner: armed where the topic shows anything else, it says when to publish the birth again.
    """

    def __init__(self, channel: Channel, topic: str, session: int) -> None:
        self.topic = topic
        self.rebirth = Rebirth()
        self._channel = channel
        self._session = session

    def will(self, *, several: bool = False) -> Will:
        """The will of a connection; `several`: there are others beside it."""
        return Will(self.topic, self._payload(up=False, several=several))

    def say(self, *, up: bool) -> Publish:
        """The birth, or at a clean stop that the session is over."""
        return Publish(self._channel.link, self.topic, self._payload(up), qos=1, retain=True)

    def is_shown(self, message: Inbound) -> bool:
        """Whether a message on the topic is the birth; who signs knows its own by the bytes. Raises PayloadError."""
        if self._channel.seal is not None:
            return message.payload == self._payload(up=True)
        seen = decode(Presence, message.payload)
        return seen.session == self._session and seen.up

    def _payload(self, up: bool, several: bool = False) -> bytes:
        revoked = self._channel.list_number if up else None
        message = Presence(session=self._session, up=up, revoked=revoked, several=several or None)
        return self._channel.payload(self.topic, message, with_certificate=up)
