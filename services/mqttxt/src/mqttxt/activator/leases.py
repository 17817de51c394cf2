"""The stations registered at a fog, and which of them controls which drone (docs/protocol.md, section 6).

A free drone is given to the first registered station that wants it. Another station gets it only by an explicit
takeover, which raises the fog's epoch: commands sent under a lower epoch are refused. Whoever is given a drone is given
it under the fog's epoch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ..protocol.control import Control, Registration
from ..protocol.words import NOT_IN_CONTROL

RESTORED_MS = 10_000
"""How long a new activator session keeps a drone for the station that controlled it before."""
MAX_EPOCH = 2**32 - 1
"""The highest epoch that a payload can carry; at this one no takeover is possible any more."""

Key = tuple[str, int]
"""A station's name and session."""


@dataclass
class Lease:
    """A station's registration. `sent_ms` is the earliest time, in our clock, at which its newest renewal was sent."""

    key: Key
    until_ms: int
    sent_ms: int | None
    control: Control
    bundles: bool
    drones: frozenset[int] | None

    def wants(self, drone: int) -> bool:
        return self.control is not Control.NONE and (self.drones is None or drone in self.drones)


@dataclass(frozen=True)
class Restored:
    """The station that controlled a drone according to an earlier activator session."""

    key: Key
    until_ms: int


class Leases:
    """The leases of one activator session, in the order of registration. Changes return the drones they affect."""

    def __init__(self, drones: Iterable[int] = ()) -> None:
        self._leases: dict[Key, Lease] = {}
        self._drones = set(drones)
        self._holders: dict[int, Key] = {}
        self._epochs: dict[int, int] = {}
        self._restored: dict[int, Restored] = {}
        self._epoch = 0
        self.want_topics = self.want_bundles = False
        """Whether any station wants states by topic, and whether any wants bundles."""

    def __bool__(self) -> bool:
        """Whether the gate is open: any station is registered."""
        return bool(self._leases)

    def __len__(self) -> int:
        return len(self._leases)

    def __iter__(self) -> Iterator[Key]:
        return iter(self._leases)

    def __contains__(self, key: Key) -> bool:
        return key in self._leases

    def holder(self, drone: int) -> Lease | None:
        """The lease of the station that controls a drone."""
        key = self._holders.get(drone)
        return self._leases.get(key) if key is not None else None

    @property
    def newest_epoch(self) -> int:
        """The highest epoch of this session's drones."""
        return self._epoch

    def epoch(self, drone: int) -> int:
        return self._epochs.get(drone, 0)

    def controls(self, gs_session: int, drone: int | None) -> bool:
        """Whether a station controls a drone; with None, any drone of the fog."""
        keys = self._holders.values() if drone is None else [self._holders.get(drone)]
        return any(key is not None and key[1] == gs_session for key in keys)

    def held(self, key: Key) -> frozenset[int]:
        """The drones that a station controls."""
        return frozenset(drone for drone, holder in self._holders.items() if holder == key)

    def names(self, gs_session: int) -> bool:
        """Whether a session is registered, or controlled a drone according to an earlier activator session."""
        restored = (each.key for each in self._restored.values())
        return any(session == gs_session for keys in (self._leases, restored) for _, session in keys)

    def reads_together(self, gs_session: int) -> bool:
        """Whether a registered session asked for bundles, so that words for it may be sent together."""
        return any(key[1] == gs_session and lease.bundles for key, lease in self._leases.items())

    def station(self, gs_session: int) -> str | None:
        """The station of a registered session, by its name in certificates."""
        return next((f"gs-{name}" for name, session in self._leases if session == gs_session), None)

    def refusal(self, drone: int, gs_session: int, epoch: int, now_ms: int) -> str | None:
        """Why a station's command for a drone is refused (R6.6, R6.8); None if the station is in control.

        A lease that has lapsed gives no control, also before `tick` has ended it: the process may have stood still.
        """
        holder = self.holder(drone)
        if holder is None or now_ms > holder.until_ms:
            return NOT_IN_CONTROL
        if holder.key[1] != gs_session or epoch < self.epoch(drone):
            return f"{NOT_IN_CONTROL}, {holder.key[0]}"
        return None

    def register(self, message: Registration, now_ms: int) -> set[int]:
        """Take, renew or, with a lease of 0 s, end a registration; one that arrives after its end changes nothing."""
        key = (message.name, message.session)
        if message.lease_s == 0:
            return self.end(key, now_ms)
        if message.until_ms is not None and message.until_ms < now_ms:
            return set()
        length_ms = message.lease_s * 1000
        until_ms, sent_ms = now_ms + length_ms, None
        if message.until_ms is not None:
            until_ms = min(until_ms, message.until_ms)
            sent_ms = min(now_ms, message.until_ms - length_ms)
        known = self._leases.get(key)
        if known is not None and known.sent_ms is not None:
            sent_ms = max(known.sent_ms, sent_ms) if sent_ms is not None else known.sent_ms
            until_ms = max(known.until_ms, until_ms)
        control = message.control or Control.NONE
        scope = frozenset(message.drones) if message.drones is not None else None
        taking = control is Control.TAKE
        wanted = known.drones if taking and known is not None and known.control is not Control.NONE else scope
        self._leases[key] = Lease(
            key, until_ms, sent_ms, Control.WANT if taking else control, bool(message.bundles), wanted
        )
        self._look_at_forms()
        changed = {drone for drone, holder in self._holders.items() if holder == key and not self._may_keep(drone)}
        for drone in changed:
            del self._holders[drone]
        if taking:
            known_drones = self._drones | self._restored.keys()
            changed |= self._take(key, known_drones if scope is None else known_drones & scope, message.epoch or 0)
        return changed | self._assign(now_ms)

    def end(self, key: Key, now_ms: int) -> set[int]:
        """End a station's registration; its drones are given to the next station that wants them."""
        if self._leases.pop(key, None) is None:
            return set()
        self._look_at_forms()
        freed = {drone for drone, holder in self._holders.items() if holder == key}
        for drone in freed:
            del self._holders[drone]
        return freed | self._assign(now_ms)

    def tick(self, now_ms: int) -> set[int]:
        """End lapsed leases, and free restored drones whose station has not registered again."""
        changed: set[int] = set()
        for key in [key for key, lease in self._leases.items() if now_ms > lease.until_ms]:
            changed |= self.end(key, now_ms)
        gone = [drone for drone, restored in self._restored.items() if now_ms > restored.until_ms]
        for drone in gone:
            del self._restored[drone]
        return changed | self._assign(now_ms) if gone else changed

    def add(self, drone: int, now_ms: int) -> set[int]:
        """Add a drone; does nothing if it is known."""
        if drone in self._drones:
            return set()
        self._drones.add(drone)
        return self._assign(now_ms)

    def restore(self, drone: int, key: Key | None, epoch: int, now_ms: int) -> None:
        """Take over a drone's holder and epoch from an earlier activator session; its station may register again."""
        self._epochs[drone] = max(self.epoch(drone), epoch)
        self._epoch = max(self._epoch, epoch)
        if key is not None and drone not in self._holders:
            self._restored[drone] = Restored(key, now_ms + RESTORED_MS)

    def _look_at_forms(self) -> None:
        self.want_topics = any(not lease.bundles for lease in self._leases.values())
        self.want_bundles = any(lease.bundles for lease in self._leases.values())

    def _may_keep(self, drone: int) -> bool:
        holder = self.holder(drone)
        return holder is not None and holder.wants(drone)

    def _take(self, key: Key, drones: set[int], epoch: int) -> set[int]:
        """Give drones to a station that names the newest epoch: an old takeover that was stalled takes nothing.

        Drones that are kept for another station are taken too.
        """
        if epoch < self._epoch or self._epoch >= MAX_EPOCH:
            return set()
        kept = {drone: restored.key for drone, restored in self._restored.items()}
        taken = {drone for drone in drones if (kept | self._holders).get(drone, key) != key}
        if taken:
            self._epoch += 1
        for drone in taken:
            self._holders[drone] = key
            self._epochs[drone] = self._epoch
            self._restored.pop(drone, None)
        return taken

    def _assign(self, now_ms: int) -> set[int]:
        changed: set[int] = set()
        free = self._drones - self._holders.keys()
        for lease in self._leases.values():
            if not free:
                break
            if lease.control is Control.NONE:
                continue
            for drone in free if lease.drones is None else free & lease.drones:
                restored = self._restored.get(drone)
                if restored is None or restored.key == lease.key:
                    self._holders[drone] = lease.key
                    self._epochs[drone] = self._epoch
                    self._restored.pop(drone, None)
                    changed.add(drone)
            free -= changed
        return changed
