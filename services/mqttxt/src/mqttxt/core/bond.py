"""Several connections as one link of a role: up while one of them is (docs/protocol.md, section 19)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, Protocol

from .address import BrokerAddress
from .effects import Inbound, Publish, Subscribe, Unsubscribe
from .shared_lists import LISTS, SharedLists

logger = logging.getLogger("mqttxt")

PROBE_S = 0.4
"""How often each connection is measured."""
LOOK_S = 0.05
LATE_S = 0.3
"""After a first connection brought a proof, another has this long, plus its usual round trip, to bring it too."""
MOST_PROOFS = 256
UNLED_S = 25.0
"""A connection that brought no proof for this long, two and a half intervals of leases, is logged."""
BETTER = 0.7
"""Another connection is taken below this fraction of the present one's delay, so that two equal ones do not alternate.
"""


def connections(link: str, broker: BrokerAddress, second: BrokerAddress | None) -> dict[str, BrokerAddress]:
    """The brokers of a link, by connection name; a single connection has the link's own name."""
    return {link: broker} if second is None else {f"{link} 1": broker, f"{link} 2": second}


class Path(Protocol):
    """One of the connections: `mqtt.link.MqttLink`, for example."""

    @property
    def address(self) -> BrokerAddress: ...
    def publish(self, effect: Publish, /) -> object: ...
    def subscribe(self, effect: Subscribe, /) -> None: ...
    def unsubscribe(self, effect: Unsubscribe, /) -> None: ...
    def give_up(self, reason: str, /) -> None: ...
    def ping(self) -> None: ...
    def usual_s(self) -> float: ...


class Owner(Protocol):
    """The runner of the role that has the link."""

    lists: SharedLists

    def connected(self, link: str) -> None: ...
    def disconnected(self, link: str) -> None: ...
    def received(self, link: str, message: Inbound) -> None: ...
    def subscribed(self, subscribe: Subscribe) -> None: ...
    def published(self, link: str, ref: Hashable, code: int) -> None: ...
    def count(self, kind: str, detail: str) -> None: ...
    def carry_out(self, outputs: Iterable[Any]) -> None: ...


@dataclass
class _Member:
    path: Path
    is_up: bool = False
    awaited: list[Subscribe] = field(default_factory=list)
    probe_at_s: float = 0.0
    is_stuck: bool = False
    is_led: bool = True
    """Whether it leads to the other role, as far as is known."""
    unled_s: float | None = None
    """When it was first up without leading there; infinite once that was logged."""

    @property
    def is_ready(self) -> bool:
        return self.is_up and not self.awaited


@dataclass
class _Proof:
    """A message that the other role sends over each of its connections; `missing`: those that have not brought it."""

    missing: set[str]
    heard: set[str] = field(default_factory=set)
    came_s: float | None = None


@dataclass(eq=False)
class _Sent:
    """A publish with the number of PUBACKs that it awaits, and the connections over which it was sent."""

    publish: Publish
    awaited: int = 0
    tried: set[str] = field(default_factory=set)
    is_done: bool = False


class Bond:
    """The link `name` of `owner`, over the connections that are added; these report to it.

    Messages with `everywhere` and retained ones are sent over all connections, others over the one that `prefers` names
    for their topic, else over the best. `on_change` returns the role's effects when a connection is up again, is stuck
    or was lost (its argument is the name of the lost one), or when another one became the best. With `is_led` a
    connection ranks below the others until a proof arrives over it that it leads to the other role, and again when a
    proof arrives over another one only.
    """

    def __init__(
        self,
        name: str,
        owner: Owner,
        on_change: Callable[[str | None], Iterable[Any]],
        prefers: Callable[[str], str | None] = lambda topic: None,
        is_led: bool = False,
    ) -> None:
        self.name = name
        self.best: str | None = None
        self._owner = owner
        self._on_change = on_change
        self._prefers = prefers
        self._is_led = is_led
        self._proofs: dict[Hashable, _Proof] = {}
        self._members: dict[str, _Member] = {}
        self._subscribes: list[Subscribe] = []
        self._granted: list[Subscribe] = []
        self._retained: dict[str, Publish] = {}

    def add(self, name: str, path: Path) -> None:
        self._members[name] = _Member(path)

    def led(self, link: str, proof: Hashable) -> None:
        """A proof arrived over a connection: it leads to the other role, which sends the proof over each of its own."""
        if proof not in self._proofs:
            others = {name for name, member in self._members.items() if member.is_ready}
            self._proofs[proof] = _Proof(others)
            while len(self._proofs) > MOST_PROOFS:
                del self._proofs[next(iter(self._proofs))]
        known = self._proofs[proof]
        if link not in known.heard:  # a broker may deliver it again at any time
            known.heard.add(link)
            known.missing.discard(link)
            self._members[link].is_led = True

    async def run(self) -> None:
        """Measure the connections until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            self.look(loop.time())
            await asyncio.sleep(LOOK_S)

    def look(self, now_s: float) -> None:
        """Measure the connections and take the best; to be called about twenty times per second."""
        for member in self._members.values():
            if member.is_ready and now_s >= member.probe_at_s:
                member.probe_at_s = now_s + PROBE_S
                member.path.ping()
        ready = {name: member.path.usual_s() for name, member in self._members.items() if member.is_ready}
        if not ready:
            return
        self._judge(ready, now_s)
        self._tell_unled(ready, now_s)
        newly_stuck = [name for name in ready if ready[name] == inf and not self._members[name].is_stuck]
        for name, usual_s in ready.items():
            self._members[name].is_stuck = usual_s == inf
        found, best = min(ready, key=lambda name: self._rank(name, ready[name])), self.best
        if best not in ready or self._rank(found, ready[found]) < self._rank(best, BETTER * ready[best]):
            self._take(found)
        elif newly_stuck:
            self._owner.carry_out(self._on_change(None))

    def _rank(self, name: str, usual_s: float) -> tuple[bool, bool, float]:
        return usual_s == inf, not self._members[name].is_led, usual_s

    def _judge(self, ready: dict[str, float], now_s: float) -> None:
        """Mark connections over which a proof is overdue: they do not lead to the other role."""
        for proof in self._proofs.values():
            if proof.came_s is None:
                proof.came_s = now_s
            for name in [name for name in proof.missing if now_s - proof.came_s > LATE_S + ready.get(name, 0.0)]:
                proof.missing.discard(name)
                if name in ready and self._members[name].is_led:
                    logger.info("%s: %s leads to no activator", self.name, self._address(name))
                    self._members[name].is_led = False

    def _tell_unled(self, ready: Iterable[str], now_s: float) -> None:
        """Warn of a connection that is up and carries nothing: to its owner it looks like one to rely on."""
        led = [name for name in ready if self._members[name].is_led]
        for name in ready:
            member = self._members[name]
            if member.is_led or not led:
                member.unled_s = None
            elif member.unled_s is None:
                member.unled_s = now_s
            elif now_s - member.unled_s > UNLED_S:
                member.unled_s = inf
                logger.warning(
                    "%s: %s is up but carries nothing: the activator is heard over %s alone; expected that it is "
                    "connected to this broker too (--second-fog-broker), or another address of its broker",
                    self.name,
                    self._address(name),
                    self._address(led[0]),
                )

    def publish(self, effect: Publish) -> None:
        if effect.retain:
            self._retained[effect.topic] = effect
        ready = [name for name, member in self._members.items() if member.is_ready]
        if not (effect.everywhere or effect.retain):
            wanted = self._prefers(effect.topic)
            if wanted not in ready or self._members[wanted].is_stuck:
                wanted = self.best if self.best in ready else None
            ready = [wanted] if wanted is not None else ready[:1]
        self._send(_Sent(effect), ready)

    def subscribe(self, effect: Subscribe) -> None:
        self._subscribes.append(effect)
        for name, member in self._members.items():
            if member.is_up:
                member.awaited.append(effect)
                member.path.subscribe(replace(effect, link=name))

    def unsubscribe(self, effect: Unsubscribe) -> None:
        for name, member in self._members.items():
            if member.is_up:
                member.path.unsubscribe(replace(effect, link=name))

    def give_up(self, reason: str) -> None:
        """End all connections; each is then opened anew."""
        for member in self._members.values():
            member.path.give_up(reason)

    def connected(self, link: str) -> None:
        member, is_first = self._members[link], not any(member.is_up for member in self._members.values())
        member.is_up, member.is_stuck, member.is_led = True, False, not self._is_led
        if not is_first and all(other.is_up for other in self._members.values()):
            logger.info("%s: both connections are up", self.name)
        self._owner.carry_out(self._owner.lists.on_connected(link))
        if is_first:
            self._owner.connected(self.name)
            return
        member.awaited = list(self._subscribes)
        for effect in self._subscribes:
            member.path.subscribe(replace(effect, link=link))

    def disconnected(self, link: str) -> None:
        member = self._members[link]
        member.is_up = False
        member.awaited.clear()
        self._owner.lists.on_disconnected(link)
        if self.best == link:
            self.best = None
        others = [name for name, other in self._members.items() if other.is_up]
        if others:
            logger.warning("%s: one of two connections is lost; %s carries all", self.name, self._address(others[0]))
            self._owner.carry_out(self._on_change(link))
            return
        self._subscribes.clear()
        self._granted.clear()
        self._retained.clear()
        self._owner.disconnected(self.name)

    def subscribed(self, subscribe: Subscribe) -> None:
        """A SUBACK: the role gets the first one for a subscription, further connections get the retained messages."""
        if subscribe.ref == LISTS:
            self._owner.subscribed(subscribe)
            return
        link, own = subscribe.link, replace(subscribe, link=self.name)
        member = self._members[link]
        member.awaited.remove(own)
        if self.best is None and member.is_ready:
            self._use(link)
        if own not in self._granted:
            self._granted.append(own)
            self._owner.subscribed(own)
        elif member.is_ready:
            for publish in self._retained.values():
                self._send(_Sent(publish), [link])
            self._owner.carry_out(self._on_change(None))

    def received(self, link: str, message: Inbound) -> None:
        if message.topic == self._owner.lists.topic(link):
            self._owner.received(link, message)
        else:
            self._owner.received(self.name, replace(message, path=link))

    def published(self, link: str, ref: Hashable, code: int) -> None:
        """A broker's PUBACK: a failure (no subscriber, say) is reported only after every ready connection was tried."""
        if not isinstance(ref, _Sent) or ref.is_done:
            return
        ref.awaited -= 1
        others = [name for name, member in self._members.items() if member.is_ready and name not in ref.tried]
        if code != 0 and (ref.awaited > 0 or others):
            self._send(ref, others)
            return
        ref.is_done = True
        self._owner.published(self.name, ref.publish.ref, code)

    def count(self, kind: str, detail: str) -> None:
        self._owner.count(kind, detail)

    def _address(self, name: str) -> BrokerAddress:
        return self._members[name].path.address

    def _use(self, link: str) -> None:
        logger.info("%s: the better connection is that to %s", self.name, self._address(link))
        self.best = link

    def _take(self, found: str) -> None:
        self._use(found)
        self._owner.carry_out(self._on_change(None))

    def _send(self, sent: _Sent, names: Iterable[str]) -> None:
        for name in names:
            sent.awaited += 1
            sent.tried.add(name)
            ref = sent if sent.publish.ref is not None else None
            self._members[name].path.publish(replace(sent.publish, link=name, ref=ref))
