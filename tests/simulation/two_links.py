"""A world whose fog has two brokers: each end of each connection can be cut, or held back and released at once."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.core.address import BrokerAddress
from mqttxt.core.bond import Bond, connections
from mqttxt.core.effects import Inbound, Publish, Reconnect, Subscribe
from mqttxt.core.shared_lists import SharedLists
from mqttxt.drone.effects import Led
from mqttxt.drone.paths import Paths
from mqttxt.drone.role import UavClient
from mqttxt.protocol.policies import POLICIES
from tests.simulation.world import World, matches, on_the_ground

LINKS_TO = connections(FOG, BrokerAddress("lte", 1883), BrokerAddress("sat", 1883))
LINKS = tuple(LINKS_TO)
USUAL_S = dict(zip(LINKS, (0.05, 0.6), strict=True))
OFTEN = POLICIES | {"location": replace(POLICIES["location"], min_interval_ms=50)}
NOTICED_MS = 600
"""When a frozen end is noticed: a PINGREQ every 0.4 s, and its answer's allowed delay."""


class Path:
    """One end of a connection."""

    def __init__(self, world: TwoLinks, name: str, link: str) -> None:
        self._world = world
        self._name = name
        self._link = link

    @property
    def address(self) -> BrokerAddress:
        return LINKS_TO[self._link]

    def publish(self, effect: Publish, /) -> None:
        self._world.leave(self._name, effect)

    def subscribe(self, effect: Subscribe, /) -> None:
        self._world.subscribe(self._name, effect)

    def unsubscribe(self, effect: Any, /) -> None:
        raise AssertionError(effect)

    def give_up(self, reason: str, /) -> None:
        if (self._name, self._link) in self._world.up:
            self._world.cut(self._name, self._link)
            self._world.connect(self._name, self._link)

    def ping(self) -> None:
        """Nothing to do: `usual_s` shows a missing answer."""

    def usual_s(self) -> float:
        since_ms = self._world.stuck.get((self._name, self._link))
        is_noticed = since_ms is not None and self._world.now_ms - since_ms >= NOTICED_MS
        return float("inf") if is_noticed else self._world.usual_s[self._link]


class Owner:
    """The runner of one role."""

    def __init__(self, world: TwoLinks, name: str) -> None:
        self.lists = SharedLists(None, {})
        self._world = world
        self._name = name

    def _run(self, method: str, *args: Any) -> None:
        role = getattr(self._world, self._name)
        self._world.run(self._name, getattr(role, method)(*args, self._world.now_ms))

    def connected(self, link: str) -> None:
        self._run("on_connected", link)

    def disconnected(self, link: str) -> None:
        self._run("on_disconnected", link)

    def received(self, link: str, message: Inbound) -> None:
        self._run("on_message", link, message)

    def subscribed(self, subscribe: Subscribe) -> None:
        self._run("on_subscribed", subscribe)

    def published(self, link: str, ref: Hashable, code: int) -> None:
        self._run("on_published", link, ref, code)

    def count(self, kind: str, detail: str) -> None:
        raise AssertionError(kind, detail)

    def carry_out(self, outputs: Iterable[Any]) -> None:
        self._world.run(self._name, outputs)


@dataclass
class TwoLinks(World):
    """A `World` with two brokers, `LINKS`, between activator and UAV client; or two links to `one_broker`."""

    one_broker: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self.stuck: dict[tuple[str, str], int] = {}
        self.held: list[tuple[tuple[str, str], Any]] = []
        self.up: set[tuple[str, str]] = set()
        self.over: list[tuple[str, Publish]] = []
        self.usual_s = dict(USUAL_S)
        self.bonds: dict[str, Bond] = {}
        self.activator.relay.has_paths = True
        self.uav.paths = Paths(LINKS[0], self.uav.settings.beacon_interval_ms)
        for name in ("uav", "activator"):
            role = getattr(self, name)
            own = {"prefers": role.path_of} if name == "activator" else {"is_led": True}
            bond = Bond(name=FOG, owner=Owner(self, name), on_change=partial(self._changed, name), **own)
            for link in LINKS:
                bond.add(link, Path(self, name, link))
            self.bonds[name] = bond

    def _uav(self, session: int, **left: Any) -> UavClient:
        return super()._uav(session, policies=OFTEN, **left)

    def _changed(self, name: str, lost: str | None) -> Any:
        return getattr(self, name).on_path(lost, self.now_ms)

    def start(self, for_ms: int = 0) -> Self:
        self.gs.add_fogs([1])
        for message in on_the_ground():
            self.uav.on_mavlink(message, self.now_ms)
        self.run("activator", self.activator.on_connected(CLOUD, self.now_ms))
        for link in LINKS:
            self.connect("activator", link)
        for link in LINKS:
            self.connect("uav", link)
        self.run("gs", self.gs.on_connected(CLOUD, self.now_ms))
        self.pass_time(for_ms)
        return self

    def connect(self, name: str, link: str) -> None:
        self.up.add((name, link))
        self.bonds[name].connected(link)

    def _reconnect(self, name: str, effect: Reconnect) -> None:
        if effect.link == FOG:
            self.bonds[name].give_up(effect.reason)
        else:
            super()._reconnect(name, effect)

    def cut(self, name: str, link: str) -> None:
        """Cut one end: messages held at it are lost; the broker publishes a UAV client's will."""
        end, will = (name, link), self.uav.will()
        self.up.discard(end)
        self.stuck.pop(end, None)
        self.held = [held for held in self.held if held[0] != end]
        self.subscribed = [entry for entry in self.subscribed if entry[:2] != end]
        self.bonds[name].disconnected(link)
        if name == "uav":
            self._at_broker(name, Publish(link, will.topic, will.payload, 1, retain=True))

    def freeze(self, name: str, link: str) -> None:
        """Hold everything at this end, without any notice."""
        self.stuck.setdefault((name, link), self.now_ms)

    def thaw(self, name: str, link: str) -> None:
        """Deliver everything held at this end at once, late."""
        end = (name, link)
        self.stuck.pop(end, None)
        ours = [act for held, act in self.held if held == end]
        self.held = [held for held in self.held if held[0] != end]
        for act in ours:
            act()

    def pass_time(self, milliseconds: int, step_ms: int = 50) -> None:
        until = self.now_ms + milliseconds
        while self.now_ms < until:
            super().pass_time(min(step_ms, until - self.now_ms), step_ms)
            for bond in self.bonds.values():
                bond.look(self.now_ms / 1000)

    def run(self, name: str, outputs: Iterable[Any]) -> None:
        for output in outputs:
            if isinstance(output, Led):
                self.bonds[name].led(output.path, output.proof)
            else:
                super().run(name, [output])

    def route(self, name: str, publish: Publish) -> None:
        if publish.link == FOG:
            self.bonds[name].publish(publish)
        else:
            super().route(name, publish)

    def leave(self, name: str, publish: Publish) -> None:
        self.over.append((name, publish))
        self._pass(name, publish.link, partial(self._at_broker, name, publish))

    def subscribe(self, name: str, effect: Subscribe) -> None:
        self._pass(name, effect.link, partial(self._grant, name, effect))

    def _subscribe(self, name: str, effect: Subscribe) -> None:
        if effect.link == FOG:
            self.bonds[name].subscribe(effect)
        else:
            super()._subscribe(name, effect)

    def _pass(self, name: str, link: str, act: Any) -> None:
        """Act now, or when this end thaws; never if the connection has ended."""
        if (name, link) in self.stuck:
            self.held.append(((name, link), act))
        elif (name, link) in self.up:
            act()

    def _grant(self, name: str, effect: Subscribe) -> None:
        self.subscribed += [(name, effect.link, topic, effect.live_only) for topic in effect.filters]
        self.bonds[name].subscribed(effect)
        for link, topic in list(self.retained):
            if (
                link == self._broker(effect.link)
                and not effect.live_only
                and any(matches(one, topic) for one in effect.filters)
            ):
                self._hand(name, replace(self.retained[link, topic], link=effect.link), True)

    def _broker(self, link: str) -> str:
        return LINKS[0] if self.one_broker and link in LINKS else link

    def _at_broker(self, name: str, publish: Publish) -> None:
        broker = self._broker(publish.link)
        if publish.retain:
            self.retained[broker, publish.topic] = publish
        found = [s for s in self.subscribed if self._broker(s[1]) == broker and matches(s[2], publish.topic)]
        for receiver, link in dict.fromkeys(entry[:2] for entry in found):
            self._hand(receiver, replace(publish, link=link), False)
        if publish.ref is not None and publish.qos > 0:
            answer = partial(self.bonds[name].published, publish.link, publish.ref, 0 if found else 0x10)
            self._pass(name, publish.link, answer)

    def _hand(self, name: str, publish: Publish, retained: bool) -> None:
        message = Inbound(publish.topic, publish.payload, publish.qos, retained)
        self._pass(name, publish.link, partial(self.bonds[name].received, publish.link, message))
