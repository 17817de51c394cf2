"""The activator's relay of states: topics and bundles in, topics and bundles out, and QoDS (protocol, 6, 8, 10)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..core.clock import STAMP_MODULUS, STAMP_TICK_MS, stamp
from ..core.effects import Effect, Inbound, Publish
from ..core.settings import next_turn_ms
from ..protocol.bundles import encode_fog_bundles, plain_states
from ..protocol.codec import encode
from ..protocol.policies import URGENT
from ..protocol.rankings import QodsMessage
from ..protocol.state_payload import PlainState, encode_relayed, plain_state
from ..protocol.states import CODES
from ..protocol.topics import DroneTopic
from . import qods
from .drone_link import DroneLink, Known
from .drones import CLOUD, Drones
from .part import Part, Site

PATIENCE = 0.75
"""Fraction of a bundle's interval: a state whose values are at least this far apart comes about as often as bundles."""


@dataclass(slots=True)
class Waiting:
    """Values of a state that wait for the next bundle, each with its relay stamp; `came_ms`: arrival of the newest."""

    came_ms: int
    states: list[tuple[int, PlainState]]


class StateRelay(Part):
    """Keeps every drone's states and publishes them for the registered stations, as topics, bundles or both."""

    def __init__(self, site: Site, drones: Drones) -> None:
        super().__init__(site)
        self.qods = qods.QodsTurns()
        self._settings = site.to_cloud.settings
        self._drones = drones
        self._bundled: dict[tuple[int, str], Waiting] = {}
        self._paces: dict[tuple[int, str], tuple[int, bool]] = {}
        self._next_bundle_ms = 0
        self._is_urgent = False

    def on_states(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """`droneY/state/Z`, or a bundle on `droneY/states`."""
        link = self._drones.links.get(topic.drone)
        clock = link.clock if link is not None else None
        payload = self._to_fog.opened_state(message, f"drone{topic.drone}", clock, now_ms)
        states = plain_states(payload) if topic.kind == "states" else [plain_state(topic.name, payload)]
        if link is None:
            return []
        out: list[Effect] = []
        for state in states:
            known = self._kept(link, state, now_ms)
            if known is not None and self._leases:
                self._relay(link, known, now_ms, out)
        return out

    def relay_all(self, links: Iterable[DroneLink], now_ms: int) -> list[Effect]:
        """Publish the last known states of reachable drones, for stations that did not receive them."""
        if not self._leases:
            return []
        out: list[Effect] = []
        for link in links:
            for known in link.states.values() if link.announced else ():
                self._relay(link, known, now_ms, out)
        return out

    def tick(self, now_ms: int) -> list[Effect]:
        """Publish bundles and rankings that are due."""
        if not self._leases:
            self._bundled.clear()
            self._paces.clear()
            return []
        out: list[Effect] = []
        if self._bundled and (now_ms >= self._next_bundle_ms or self._is_urgent):
            self._is_urgent = False
            self._next_bundle_ms = next_turn_ms(self._next_bundle_ms, now_ms, self._settings.bundle_ms)
            out += self._bundles(now_ms)
        ranking = self.qods.due(self._drones.links.values(), self._settings.state_limit_ms, now_ms)
        if ranking is not None:
            message = QodsMessage(session=self._session, stamp=stamp(now_ms), ranking=ranking)
            payload = encode(message, self._settings.encoding)
            payload = self._to_cloud.dated_payload(self._cloud.qods, payload, self._session, now_ms)
            out.append(Publish(CLOUD, self._cloud.qods, payload))
        return out

    def beside_words(self, now_ms: int) -> list[Effect]:
        """Publish the next bundle early: together with words it needs no TCP segment of its own (R10.7)."""
        if not self._bundled or not self._leases:
            return []
        self._is_urgent = False
        self._next_bundle_ms = now_ms + self._settings.bundle_ms
        return self._bundles(now_ms)

    def _kept(self, link: DroneLink, state: PlainState, now_ms: int) -> Known | None:
        """Keep a state and return it; None, if it is older than the known one."""
        name = state.name
        before = link.states.get(name)
        known = link.keep_state(state, before, now_ms)
        if known is None:
            return None
        if name in URGENT and (before is None or before.state.item != state.item):
            self._is_urgent = True
        if name in qods.USED:
            self.qods.touched = True
        return known

    def _relay(self, link: DroneLink, known: Known, now_ms: int, out: list[Effect]) -> None:
        """Publish a state for the stations, with a conservative relay stamp; nothing before the drone's first echo."""
        said_ms = link.said_ms(known, now_ms)
        if said_ms is None:
            return
        state, relay_stamp = known.state, stamp(said_ms)
        name, leases = state.name, self._leases
        if name in CODES:
            if leases.want_bundles:
                self._bundle((link.number, name), state, relay_stamp, now_ms, out)
            if not leases.want_topics:
                return
        topic = self._cloud.drone_state(link.number, name)
        payload = encode_relayed(state, relay_stamp, self._settings.encoding)
        out.append(Publish(CLOUD, topic, self._to_cloud.state_payload(topic, payload, self._session, now_ms)))

    def _bundle(
        self, key: tuple[int, str], state: PlainState, relay_stamp: int, now_ms: int, out: list[Effect]
    ) -> None:
        """Keep a state for the next bundle.

        A state that arrives about as often as bundles leave must not lose a value to the next one because two clocks
        drift: then the bundle leaves first, and the next one half a turn later. If the drone's link brought both
        values together, or the next one is an urgent change, the bundle carries both. Of faster states only the newest
        value is kept.
        """
        interval_ms = self._settings.bundle_ms
        waiting = self._bundled.get(key)
        if waiting is not None and now_ms - waiting.came_ms >= PATIENCE * interval_ms:
            self._next_bundle_ms = now_ms + interval_ms // 2
            out += self._bundles(now_ms)
            waiting = None
        is_slow = self._is_slow(key, state.stamp)
        if waiting is None:
            self._bundled[key] = Waiting(now_ms, [(relay_stamp, state)])
            return
        newest = waiting.states[-1][1]
        if not is_slow and not (state.name in URGENT and newest.item != state.item):
            waiting.states.pop()
        waiting.states.append((relay_stamp, state))
        waiting.came_ms = now_ms

    def _is_slow(self, key: tuple[int, str], origin: int) -> bool:
        """Whether a state comes about as often as bundles leave, by the stamps of its last three values.

        One early value among them, sent along with an urgent one, does not make the state fast.
        """
        before, was_slow = self._paces.get(key, (origin, True))
        apart_ms = (origin - before) % STAMP_MODULUS * STAMP_TICK_MS
        is_slow = apart_ms >= PATIENCE * self._settings.bundle_ms
        self._paces[key] = origin, is_slow
        return is_slow or was_slow

    def _bundles(self, now_ms: int) -> list[Effect]:
        relayed = (
            (drone, relay_stamp, state)
            for (drone, _), waiting in self._bundled.items()
            for relay_stamp, state in waiting.states
        )
        bundles, topic = encode_fog_bundles(relayed, self._settings.encoding), self._cloud.states
        self._bundled.clear()
        return [
            Publish(CLOUD, topic, self._to_cloud.state_payload(topic, bundle, self._session, now_ms))
            for bundle in bundles
        ]
