"""Which stations' commands a drone obeys, by its newest lease (docs/protocol.md, R5.4, R6.8, R12.17)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..protocol.messages import CommandId
from .held_lease import HeldLease

MOST_REPLACED = 64
"""Stations without control of which it is remembered that an earlier activator session led them."""


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
        self._replaced: dict[int, None] = {}
        """Stations that an earlier activator session led, until a lease names them again."""

    def authority(self, epoch: int) -> Authority:
        """The authority of a command of an epoch that is admitted now."""
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
        commands = list(begun)
        if session is not None and self._activator not in (None, activator):
            led = [self._lease.holder_session, *(command_id.gs_session for command_id, _ in commands)]
            self._replaced |= dict.fromkeys(one for one in led if one is not None)
            while len(self._replaced) > MOST_REPLACED:
                del self._replaced[next(iter(self._replaced))]
        if session is not None:
            self._replaced.pop(session, None)
        self._lease.holder_session = session
        self.epoch, self.until_ms, self._activator = epoch, until_ms, activator
        for command_id, authority in commands:
            if self._has_replaced(command_id.gs_session, authority.epoch, authority.activator):
                authority.is_lost = True

    def _has_replaced(self, gs_session: int, epoch: int, activator: int | None) -> bool:
        """Whether another station has the place of one that commands under `epoch`, as `activator` counts it.

        One whose epoch is higher is a newer holder. Epochs of two activator sessions do not compare, so one that an
        earlier session led is not until a lease names it; and a station that signs may name any epoch.
        """
        is_comparable = activator == self._activator
        is_newer = is_comparable and epoch > self.epoch and gs_session not in self._replaced
        if gs_session == self._lease.holder_session or (is_newer and not self._is_signed):
            return False
        return self._lease.holder_session is not None or (is_comparable and epoch < self.epoch)
