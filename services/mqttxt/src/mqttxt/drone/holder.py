"""Which stations' commands a drone obeys, by its newest lease (docs/protocol.md, R5.4, R6.8, R12.17)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..protocol.messages import CommandId
from .held_lease import HeldLease

MOST_LED = 1000
"""Stations of which it is remembered which activator session led them, the newest."""


@dataclass
class Authority:
    """By what its station sent a command: the epoch of the drone's control, as `activator` counts it.

    `activator` is the activator session of the lease at the command's admission. `is_lost`: another station has taken
    its station's place since.
    """

    epoch: int = 0
    activator: int | None = None
    is_lost: bool = False


class Holder:
    """The station that has control by the newest lease, until `until_ms`; its session is `lease`'s.

    Commands are judged by the lease alone, because they have their own deadline (R12.14). Where messages are signed,
    only a lease proves control; otherwise it is enough that the lease names no other station.
    """

    def __init__(self, lease: HeldLease, is_signed: bool) -> None:
        self.epoch = 0
        self.until_ms: int | None = None
        self._lease = lease
        self._is_signed = is_signed
        self._activator: int | None = None
        self._led: dict[int, int] = {}
        """The activator session that named a station last or, before any has, led the drone at its first command."""

    def authority(self, gs_session: int, epoch: int) -> Authority:
        """The authority of a station's command of an epoch that is admitted now."""
        if self._activator is not None:
            self._note(gs_session, self._led.get(gs_session, self._activator))
        return Authority(epoch, self._activator)

    def obeys(self, gs_session: int, epoch: int, now_ms: int) -> bool:
        """Whether to admit a station's command."""
        is_held = self.until_ms is not None and now_ms <= self.until_ms
        if epoch < self.epoch:
            return False
        if self._is_signed:
            return is_held and self._lease.holder_session == gs_session
        return not (is_held and self._has_replaced(gs_session, epoch, self._activator))

    def on_lease(
        self,
        session: int | None,
        epoch: int,
        activator: int,
        until_ms: int | None,
        begun: Iterable[tuple[CommandId, Authority]],
    ) -> None:
        """A newer lease; of the commands that have `begun`, those of other stations lose their authority for good."""
        if session is not None:
            self._note(session, activator)
        self._lease.holder_session = session
        self.epoch, self.until_ms, self._activator = epoch, until_ms, activator
        for command_id, authority in begun:
            if self._has_replaced(command_id.gs_session, authority.epoch, authority.activator):
                authority.is_lost = True

    def _note(self, gs_session: int, activator: int) -> None:
        self._led.pop(gs_session, None)
        self._led[gs_session] = activator
        if len(self._led) > MOST_LED:
            del self._led[next(iter(self._led))]

    def _has_replaced(self, gs_session: int, epoch: int, activator: int | None) -> bool:
        """Whether another station has the place of one that commands under `epoch`, as `activator` counts it.

        One whose epoch is higher is a newer holder. Epochs of two activator sessions do not compare, so one that an
        earlier session led is not until a lease names it; and a station that signs may name any epoch.
        """
        is_comparable = activator == self._activator
        is_newer = is_comparable and epoch > self.epoch and self._led.get(gs_session, activator) == activator
        if gs_session == self._lease.holder_session or (is_newer and not self._is_signed):
            return False
        return self._lease.holder_session is not None or (is_comparable and epoch < self.epoch)
