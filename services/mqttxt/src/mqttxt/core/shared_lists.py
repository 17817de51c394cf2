"""The fleet's revocation list at its brokers: a node with a newer one publishes it (docs/protocol.md, R11.13)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..errors import ConfigurationError
from ..protocol.cbor import MAX_PAYLOAD
from .effects import Effect, Inbound, Log, Publish, Subscribe
from .floods import TokenBucket
from .settings import REBIRTH_MS, Rebirth

if TYPE_CHECKING:
    from ..security.fleet import Fleet

LISTS = "revocation lists"
"""The `ref` of these subscriptions."""
LISTS_PER_S, LISTS_AT_ONCE = 10, 100
"""How many lists of one broker are read: anyone who may publish one can make each node verify it."""


@dataclass
class _Place:
    """One broker: the numbers of the lists that it has `shown` and was `given` since it granted the subscription.

    From `due_ms` on this node publishes its own list there, if that one's number is higher than both. `missed` is
    armed when a list was dropped unread.
    """

    topic: str
    is_subscribed: bool = False
    shown: int = 0
    given: int = 0
    due_ms: int = 0
    missed: Rebirth = field(default_factory=Rebirth)


class SharedLists:
    """Takes newer lists from brokers, and publishes this node's list where a broker shows an older one or none.

    `topics` has the list's topic for each connection that subscribes to it. `patience_ms` is how long other nodes have
    to publish first; with None this node never publishes. `told` has the topics of connections on which this node
    publishes without subscribing. Without a fleet there are no lists. Times are milliseconds of the session clock.
    """

    def __init__(
        self,
        fleet: Fleet | None,
        topics: Mapping[str, str],
        patience_ms: int | None = REBIRTH_MS,
        told: Mapping[str, str] | None = None,
    ) -> None:
        self._fleet = fleet
        self._heard: Mapping[str, str] = topics if fleet is not None else {}
        self._told: Mapping[str, str] = told or {} if fleet is not None else {}
        self._gives = patience_ms is not None
        self._pause_ms = patience_ms or 0
        self._places = {link: _Place(topic) for link, topic in (*self._heard.items(), *self._told.items())}
        self._budget = TokenBucket(LISTS_PER_S, LISTS_AT_ONCE)

    def topic(self, link: str) -> str | None:
        """The topic of the list that a connection subscribes to; None if it does not."""
        return self._heard.get(link)

    def is_shown(self, link: str) -> bool:
        """Whether the broker has shown this node's list, or a newer one."""
        return self._fleet is not None and self._places[link].shown >= self._fleet.revoked.number

    def on_connected(self, link: str) -> list[Effect]:
        if link in self._told:
            self._places[link] = _Place(self._told[link], is_subscribed=True)
        topic = self.topic(link)
        return [Subscribe(link, (topic,), ref=LISTS)] if topic is not None else []

    def on_disconnected(self, link: str) -> None:
        if link in self._places:
            self._places[link].is_subscribed = False

    def on_subscribed(self, link: str, now_ms: int) -> None:
        """Start waiting for the list that the broker retains, if any: it follows the SUBACK."""
        place = self._places[link]
        place.is_subscribed, place.due_ms = True, now_ms + self._pause_ms
        place.shown = place.given = 0

    def on_message(self, link: str, message: Inbound, now_ms: int) -> tuple[list[Effect], bool]:
        """Read a list from a broker; returns effects, and whether it is newer than this node's and has replaced that.

        `tick` corrects an older list. Lists beyond the budget are dropped unread, and this node subscribes again.
        """
        fleet, place = self._fleet, self._places[link]
        assert fleet is not None
        if message.payload == fleet.revoked.der:
            self._show(place, fleet.revoked.number, now_ms)
            return [], False
        if not self._budget.takes(link, now_ms):
            place.missed.arm(now_ms)
            return [Log("flood", f"{message.topic}: too many")], False
        try:
            if len(message.payload) > MAX_PAYLOAD:
                raise ConfigurationError(f"revocation list: longer than {MAX_PAYLOAD} bytes")
            found = fleet.read(message.payload)
        except ConfigurationError as error:
            self._show(place, 0, now_ms)
            return [Log("revocation_list", f"{message.topic}: {error}")], False
        self._show(place, found.number, now_ms)
        return [], fleet.take(found)

    def on_newer(self, now_ms: int) -> None:
        """This node has a newer list: the next `tick` publishes it at every broker that has not shown it."""
        for place in self._places.values():
            place.due_ms = now_ms

    def tick(self, now_ms: int) -> list[Effect]:
        """Publish due lists, and subscribe again where lists were missed; call it at least ten times per second."""
        if self._fleet is None:
            return []
        out: list[Effect] = []
        own = self._fleet.revoked
        for link, place in self._places.items():
            if place.missed.is_due(now_ms) and place.is_subscribed:
                out += self.on_connected(link)
            is_behind = place.is_subscribed and max(place.shown, place.given) < own.number
            if self._gives and is_behind and now_ms >= place.due_ms:
                place.given = own.number
                out.append(Publish(link, place.topic, own.der, qos=1, retain=True))
        return out

    def _show(self, place: _Place, number: int, now_ms: int) -> None:
        """Note the number that the broker shows. Waiting begins when that falls; repeating it postpones nothing."""
        if number < max(place.shown, place.given):
            place.due_ms = now_ms + self._pause_ms
            place.given = 0
        place.shown = number
