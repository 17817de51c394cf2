"""A fleet's revocation list at its brokers: who has the newer one gives it to the others (docs/protocol.md, R11.13)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..errors import ConfigurationError
from ..protocol.cbor import MAX_PAYLOAD
from .effects import Effect, Inbound, Log, Publish, Subscribe
from .floods import Budget
from .settings import REBIRTH_MS, Rebirth

if TYPE_CHECKING:
    from ..security.fleet import Fleet

LISTS = "revocation lists"
"""The `ref` of these subscriptions."""
LISTS_PER_S, LISTS_AT_ONCE = 10, 100
"""Lists that are read of one broker: whoever may publish one can make each node verify it."""


@dataclass
class _Place:
    """Numbers of lists: what a broker has shown since it granted the subscription, and what it was given since.

    From `due_ms` on it is given this node's, where that is higher than both. `missed`: it showed more than was read.
    """

    topic: str
    is_subscribed: bool = False
    shown: int = 0
    given: int = 0
    due_ms: int = 0
    missed: Rebirth = field(default_factory=Rebirth)


class SharedLists:
    """Takes newer lists from brokers, and publishes this node's where a broker shows an older one, or none.

    `topics` are those of the connections that have one, `patience_ms` is how long others have to do it first: None
    where a node only hears. `told` are those of connections that are only told. Without a fleet there are no lists.
    Times are milliseconds of the session clock.
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
        self._budget = Budget(LISTS_PER_S, LISTS_AT_ONCE)

    def topic(self, link: str) -> str | None:
        """Where the list is heard on a connection; None where it is not."""
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
        """What the broker retains comes now, if it retains anything."""
        place = self._places[link]
        place.is_subscribed, place.due_ms = True, now_ms + self._pause_ms
        place.shown = place.given = 0

    def on_message(self, link: str, message: Inbound, now_ms: int) -> tuple[list[Effect], bool]:
        """A list at a broker. Whether it is newer: then it counts from now on; one that is older is put right.

        What comes beyond the share is not read. The broker is asked again then for what it retains.
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
        """This node has a newer list: every broker that has not shown it is given it at once."""
        for place in self._places.values():
            place.due_ms = now_ms

    def tick(self, now_ms: int) -> list[Effect]:
        """What is due; to be called at least ten times a second."""
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
        """Waiting begins when the broker first shows less than before: nothing puts it off."""
        if number < max(place.shown, place.given):
            place.due_ms = now_ms + self._pause_ms
            place.given = 0
        place.shown = number
