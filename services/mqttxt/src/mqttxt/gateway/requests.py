"""The commands that clients asked for: the open ones, and those that may still be repeated (docs/gateway.md)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

from .client_commands import ClientCommand
from .clients import Client
from .endpoints import Peer
from .translation import Request

MOST_OF_STRANGERS = 64
"""Commands that are remembered of all clients of one socket that send no HEARTBEAT."""


class Requests:
    """Per client and drone the commands in their order; `knows` says whether a client sends HEARTBEATs."""

    def __init__(self, knows: Callable[[Client], bool]) -> None:
        self._knows = knows
        self._entries: dict[tuple[Client, int], dict[Request, ClientCommand]] = {}
        self._strangers = Counter[Peer]()

    def __iter__(self) -> Iterator[ClientCommand]:
        return (entry for own in self._entries.values() for entry in own.values())

    def repeated(
        self, client: Client, drone: int, request: Request, confirmation: int, now_ms: int
    ) -> ClientCommand | None:
        """The command of which a request is a repetition, None for a new one."""
        if confirmation:
            self._bring(client, drone, request)
        own = self._entries.get((client, drone), {})
        known = own.get(request)
        if known is None:
            return None
        newest = next(one for one in reversed(own.values()) if one is known or not one.is_declined)
        return known if known.is_repeated(confirmation, newest, now_ms) else None

    def _bring(self, client: Client, drone: int, request: Request) -> None:
        """Give a client the command that it asked for over a connection that is gone, and repeats over this one."""
        if request in self._entries.get((client, drone), {}):
            return
        for (other, number), entries in self._entries.items():
            is_it = (other.system, other.component) == (client.system, client.component) and not self._knows(other)
            if number == drone and is_it and request in entries:
                entry = entries.pop(request)
                entry.client = client
                self._entries.setdefault((client, drone), {})[request] = entry
                return

    def has_room(self, client: Client) -> bool:
        """Whether one more command of a client is remembered."""
        return self._knows(client) or self._strangers[client.peer] < MOST_OF_STRANGERS

    def add(self, newest: ClientCommand) -> None:
        """Remember a command; older ones of the same MAV_CMD wait no longer for a COMMAND_ACK.

        COMMAND_ACK cannot tell them apart.
        """
        if not self._knows(newest.client):
            self._strangers[newest.client.peer] += 1
        own = self._entries.setdefault((newest.client, newest.drone), {})
        for entry in own.values():
            if entry.waits and entry.request.mav_cmd == newest.request.mav_cmd:
                entry.waits, entry.ended_ms = False, newest.asked_ms
        own.pop(newest.request, None)
        own[newest.request] = newest

    def drop_old(self, now_ms: int) -> None:
        """Forget the commands of which no repetition comes any more."""
        for key, own in list(self._entries.items()):
            for entry in list(own.values()):
                if entry.is_past(now_ms):
                    del own[entry.request]
            if not own:
                del self._entries[key]
        self._strangers.clear()
        for (client, _), own in self._entries.items():
            if not self._knows(client):
                self._strangers[client.peer] += len(own)
