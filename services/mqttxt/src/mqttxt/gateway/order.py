"""The order in which the commands for a drone are sent: an older one never follows a newer one (docs/gateway.md)."""

from __future__ import annotations

import asyncio

from ..protocol.commands import Arm, Command, Mavlink, Resume, SetCurrentItem, StartMission, Stream, Takeoff
from .client_commands import ClientCommand
from .translation import CANCELLED, NOT_NOW, Declined, name_of

BY_THE_PLAN = (Arm, StartMission, Resume, SetCurrentItem)
"""Commands that rely on the plan that their client has uploaded."""
_BESIDE = (*BY_THE_PLAN, Takeoff, Stream, Mavlink)
"""Commands behind which an older one is still sent; behind any other command it is not."""


class CommandOrder:
    """The places of all clients' commands, counted in the order in which the gateway received them."""

    def __init__(self) -> None:
        self._places = 0
        self._newest: dict[int, int] = {}
        """Per drone the place of the newest command of a client that may command it."""
        self._earliest: dict[int, int] = {}
        """Per drone the first place that may still be sent: older commands come too late."""
        self._after_stall = 0
        """The first place behind the gateway's newest stall."""
        self._turns: dict[int, asyncio.Lock] = {}

    def next_place(self) -> int:
        self._places += 1
        return self._places

    def turn(self, drone: int) -> asyncio.Lock:
        """Held while a command for a drone gets control and is sent."""
        return self._turns.setdefault(drone, asyncio.Lock())

    def on_taken(self, drone: int) -> None:
        """Another station controls a drone now: nothing that was asked before is sent."""
        self._newest[drone] = self._earliest[drone] = self._places + 1

    def on_stall(self) -> None:
        """The gateway stood still: what waits here without counting that as the command's time is not sent."""
        self._after_stall = self._places + 1

    def on_permitted(self, entry: ClientCommand, command: Command) -> None:
        """The client of a command may command its drone."""
        if not isinstance(command, Stream | Mavlink):
            self._newest[entry.drone] = max(entry.place, self._newest.get(entry.drone, 0))

    def on_sent(self, entry: ClientCommand, command: Command, is_first: bool) -> None:
        """A command was sent; `is_first`: its client had no control before."""
        if is_first or not isinstance(command, _BESIDE):
            self.close_behind(entry)

    def close_behind(self, entry: ClientCommand) -> None:
        """Nothing older than a command is sent any more."""
        self._earliest[entry.drone] = entry.place

    def is_stale(self, entry: ClientCommand) -> bool:
        """Whether the gateway stood still since a command came."""
        return entry.place < self._after_stall

    def is_outdone(self, entry: ClientCommand) -> bool:
        """Whether a newer command came for its drone, another station took the drone, or the gateway stood still."""
        return self.is_stale(entry) or entry.place < self._newest.get(entry.drone, 0)

    def check(self, entry: ClientCommand) -> None:
        """Raises Declined for a command that waited while a newer one was sent, or while the drone was taken."""
        if entry.place < self._earliest.get(entry.drone, 0):
            raise self.given_up(entry)

    def given_up(self, entry: ClientCommand, what: str | None = None) -> Declined:
        """The error of a command that is not sent any more, or of `what`, which was to follow it."""
        what = what or name_of(entry.request.mav_cmd)
        if self.is_stale(entry):
            return Declined(f"{what} given up: the gateway stood still", NOT_NOW)
        return Declined(f"{what} given up: another command came", CANCELLED)
