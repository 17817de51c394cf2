"""Runs a link that has two connections (docs/protocol.md, section 19); `two_links` decides."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ..address import BrokerAddress
from ..effects import Publish, Subscribe, Unsubscribe, Will
from .events import LinkEvents
from .link import MqttLink
from .two_links import Shared, TwoLinks

if TYPE_CHECKING:
    from ...security.identity import Identity

_TICK_S = 0.05


class MqttLinkPair:
    """A link to one broker by two addresses: to a role as one `MqttLink`.

    `will` makes that of the first connection; the second one's is the same on its own topic. `clock` gives
    milliseconds. Nothing that a broker says ends it.
    """

    def __init__(
        self,
        name: str,
        addresses: tuple[BrokerAddress, BrokerAddress],
        client_id: str,
        will: Callable[[], Will],
        shared: Shared,
        events: LinkEvents,
        clock: Callable[[], int],
        *,
        identity: Identity | None = None,
    ) -> None:
        names = (f"{name}-1", f"{name}-2")
        self._two = TwoLinks(name, names, shared, events, clock)
        wills = (will, lambda: replace(will(), topic=shared.presence[1]))
        client_ids = (client_id, f"{client_id}-2")
        self._links = tuple(
            MqttLink(each, address, own_id, own_will, self._two, identity=identity, may_be_ended=False)
            for each, address, own_id, own_will in zip(names, addresses, client_ids, wills, strict=True)
        )
        self._two.ways = self._links

    @property
    def _main(self) -> MqttLink:
        """The main link, the first one where none is up."""
        return self._links[self._two.main or 0]

    @property
    def address(self) -> BrokerAddress:
        return self._main.address

    @property
    def failure(self) -> str | None:
        return self._main.failure

    def publish(self, effect: Publish) -> None:
        self._two.publish(effect)

    def subscribe(self, effect: Subscribe) -> None:
        self._two.subscribe(effect)

    def unsubscribe(self, effect: Unsubscribe) -> None:
        self._two.unsubscribe(effect)

    def check_broker(self) -> None:
        for link in self._links:
            link.check_broker()

    async def run(self) -> None:
        """Keep both connections up until they are closed."""
        running = [asyncio.create_task(link.run()) for link in self._links]
        try:
            waiting = set(running)
            while waiting:
                self._two.tick()
                done, waiting = await asyncio.wait(waiting, timeout=_TICK_S)
                for ended in done:
                    ended.result()
        finally:
            for task in running:
                task.cancel()
            await asyncio.wait(running)

    async def close(self) -> None:
        """A clean DISCONNECT of both, after what was handed over has left."""
        await asyncio.gather(*(link.close() for link in self._links))
