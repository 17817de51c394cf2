"""The topics of one client at the gateway: predefined ones, and those that it registered or subscribed to by name."""

from __future__ import annotations

from .packets import NORMAL, PREDEFINED
from .topic_ids import TopicIds

MOST_REGISTERED = 256
"""How many topics one client may register, or subscribe to by name."""


class OwnTopics:
    """Ids and names of the topics that one connection may use."""

    def __init__(self, ids: TopicIds) -> None:
        self._ids = ids
        self._registered: dict[str, int] = {}
        self._heard_by_name: set[str] = set()

    def name_of(self, topic: str | int, id_type: int = PREDEFINED) -> str | None:
        """The topic that a packet gives by name or id; None for an unknown id."""
        if isinstance(topic, str):
            return topic
        if id_type == PREDEFINED:
            return self._ids.topic_of(topic)
        return next((name for name, known in self._registered.items() if known == topic), None)

    def id_of(self, topic: str) -> tuple[int, int] | None:
        """The id, and its type, by which the client receives a topic; None if there is none."""
        if topic in self._heard_by_name:
            return self._registered[topic], NORMAL
        known = self._ids.id_of(topic)
        return (known, PREDEFINED) if known is not None else None

    def register(self, topic: str) -> int | None:
        """Give a topic an id on this connection; returns None if there are too many."""
        if topic not in self._registered and len(self._registered) < MOST_REGISTERED:
            self._registered[topic] = len(self._registered) + 1
        return self._registered.get(topic)

    def hear(self, topic: str | int) -> None:
        """The client subscribes; a topic given by name gets an id as if it were registered."""
        if isinstance(topic, str) and self.register(topic) is not None:
            self._heard_by_name.add(topic)

    def granted(self, topic: str | int) -> int:
        """The topic id for the SUBACK of a subscription."""
        return self._registered.get(topic, 0) if isinstance(topic, str) else topic
