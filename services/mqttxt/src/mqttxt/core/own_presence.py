"""A process's own birth and will, retained on a topic that shows nothing else while it runs (protocol, section 9)."""

from __future__ import annotations

from ..protocol.codec import decode
from ..protocol.messages import Presence
from .channel import Channel
from .effects import Inbound, Publish, Will
from .settings import Rebirth


class OwnPresence:
    """The presence of a ground station's or a UAV client's `session`, on `topic` of a channel.

    Its owner arms `rebirth` when the topic shows anything else, and publishes the birth again when that is due.
    """

    def __init__(self, channel: Channel, topic: str, session: int) -> None:
        self.topic = topic
        self.rebirth = Rebirth()
        self._channel = channel
        self._session = session

    def will(self, *, several: bool = False) -> Will:
        """The will of a connection; `several`: the client has other connections too."""
        return Will(self.topic, self._payload(up=False, several=several))

    def say(self, *, up: bool) -> Publish:
        """Publish the birth, or, at a clean stop, the end of the session."""
        return Publish(self._channel.link, self.topic, self._payload(up), qos=1, retain=True)

    def is_shown(self, message: Inbound) -> bool:
        """Whether a message on the topic is the birth, byte for byte if signed; raises PayloadError if malformed."""
        if self._channel.seal is not None:
            return message.payload == self._payload(up=True)
        seen = decode(Presence, message.payload)
        return seen.session == self._session and seen.up

    def _payload(self, up: bool, several: bool = False) -> bytes:
        revoked = self._channel.list_number if up else None
        message = Presence(session=self._session, up=up, revoked=revoked, several=several or None)
        return self._channel.payload(self.topic, message, with_certificate=up)
