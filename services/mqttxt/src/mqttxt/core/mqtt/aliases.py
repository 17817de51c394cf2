"""Topic aliases of one connection (MQTT 5.0, 3.3.2.3.4): a topic is sent in full once, as two bytes afterwards."""

from __future__ import annotations

MOST_BYTES = 2**20
"""The most bytes of all topics that a broker gives aliases to."""


class AliasTable:
    """The aliases that a connection has given to topics, at most `maximum` of them.

    First come, first served, and kept: with more topics than aliases the later ones are sent in full, which costs
    no more than without aliases. To replace the least recently used alias would cost three bytes more per message as
    soon as the topics take turns, as states do.
    """

    def __init__(self, maximum: int) -> None:
        self._maximum = maximum
        self._aliases: dict[str, int] = {}

    def shorten(self, topic: str) -> tuple[str, int | None]:
        """The topic name and the alias to publish with; the caller must send each result, in the order of its calls."""
        alias = self._aliases.get(topic)
        if alias is not None:
            return "", alias
        if len(self._aliases) >= self._maximum:
            return topic, None
        self._aliases[topic] = alias = len(self._aliases) + 1
        return topic, alias


class BrokersAliases:
    """The aliases that the broker has given to topics, from 1 to `maximum`; with 0 it may give none."""

    def __init__(self, maximum: int) -> None:
        self.maximum = maximum
        self._topics: dict[int, bytes] = {}
        self._bytes = 0

    def topic(self, name: bytes, alias: int | None) -> bytes:
        """The topic of a PUBLISH; a name with an alias sets the alias's topic. Raises ValueError for a wrong alias."""
        if alias is None:
            return name
        if not 0 < alias <= self.maximum:
            raise ValueError(f"topic alias {alias}; expected 1 to {self.maximum}")
        known = self._topics.get(alias, b"")
        if name and name != known:
            self._bytes += len(name) - len(known)
            if self._bytes > MOST_BYTES:
                raise ValueError(f"topic aliases for more than {MOST_BYTES} bytes of topics")
            self._topics[alias] = name
        return name or known
