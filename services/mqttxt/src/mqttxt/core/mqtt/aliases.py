"""Topic aliases of one connection (MQTT 5.0, 3.3.2.3.4): a topic goes out in full once, as two bytes afterwards."""

from __future__ import annotations


class AliasTable:
    """The aliases that a connection has given to topics, at most `maximum` of them.

    First come, first served, and kept: with more topics than aliases the later ones go out in full, which costs
    what it would without aliases. Replacing the least recently used one would cost three bytes a message more as
    soon as the topics take turns, as states do.
    """

    def __init__(self, maximum: int) -> None:
        self._maximum = maximum
        self._aliases: dict[str, int] = {}

    def shorten(self, topic: str) -> tuple[str, int | None]:
        """The topic name and the alias to publish with; the caller has to send what it gets, in this order."""
        alias = self._aliases.get(topic)
        if alias is not None:
            return "", alias
        if len(self._aliases) >= self._maximum:
            return topic, None
        self._aliases[topic] = alias = len(self._aliases) + 1
        return topic, alias
