"""The activator's way with states: topics and bundles in, topics and bundles out, and QoDS (protocol, 6, 8, 10)."""

from __future__ import annotations

from collections.abc import Iterable

from ..core.channel import Channel
from ..core.clock import STAMP_MODULUS, STAMP_TICK_MS, stamp
from ..core.effects import Effect
from ..core.settings import next_turn_ms
from ..protocol.bundles import DroneBundle, fog_bundles
from ..protocol.codec import decode, encode
from ..protocol.policies import URGENT
from ..protocol.rankings import QodsMessage
from ..protocol.state_payload import StampedState, decode_state, encode_state
from ..protocol.states import AutopilotText
from ..protocol.topics import MAVLINK_STATE, CloudSide
from . import qods
from .drones import DroneLink, Drones
from .leases import Leases

PATIENCE = 0.75
"""Of a bundle's interval: a state that comes no more often than that comes as often as bundles leave."""


class StateRelay:
    """Keeps every drone's states and tells them to the registered stations, in the form that each asked for."""

    def __init__(self, session: int, to_cloud: Channel, cloud: CloudSide, drones: Drones, leases: Leases) -> None:
        self.qods = qods.QodsTurns()
        self._session = session
        self._channel = to_cloud
        self._settings = to_cloud.settings
        self._cloud = cloud
        self._drones = drones
        self._leases = leases
        self._bundled: dict[tuple[int, str], list[StampedState]] = {}
        self._came_ms: dict[tuple[int, str], int] = {}
        self._paces: dict[tuple[int, str], tuple[int, bool]] = {}
        self._next_bundle_ms = 0
        self._is_urgent = False

    def on_state(self, link: DroneLink | None, name: str, payload: bytes, now_ms: int) -> list[Effect]:
        """`droneY/state/Z`."""
        return self._take(link, decode_state(name, payload, relayed=False), now_ms)

    def on_bundle(self, link: DroneLink | None, payload: bytes, now_ms: int) -> list[Effect]:
        """`droneY/states`."""
        bundle = decode(DroneBundle, payload)
        states = [StampedState(bundled.state, bundle.stamp) for bundled in bundle.states]
        return [effect for state in states for effect in self._take(link, state, now_ms)]

    def relay_all(self, links: Iterable[DroneLink], now_ms: int) -> list[Effect]:
        """The last known states of reachable drones, for those who did not hear them."""
        if not self._leases:
            return []
        known = [(link, name) for link in links if link.announced for name in link.states]
        return [effect for link, name in known for effect in self._relay(link, name, now_ms)]

    def tick(self, now_ms: int) -> list[Effect]:
        """Bundles and rankings that are due."""
        if not self._leases:
            self._bundled.clear()
            self._came_ms.clear()
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
            out.append(self._channel.dated(self._cloud.qods, payload, self._session, now_ms))
        return out

    def _take(self, link: DroneLink | None, state: StampedState, now_ms: int) -> list[Effect]:
        name = state.state.name
        known = link.states.get(name) if link is not None else None
        if link is None or not self._drones.keep_state(link, name, state, now_ms):
            return []
        if name in URGENT and (known is None or known.state.state != state.state):
            self._is_urgent = True
        if name in qods.USED:
            self.qods.touched = True
        return self._relay(link, name, now_ms) if self._leases else []

    def _relay(self, link: DroneLink, name: str, now_ms: int) -> list[Effect]:
        relayed = self._drones.relayed(link, name, now_ms)
        if relayed is None:
            return []
        bundles = name != AutopilotText.name and not name.startswith(MAVLINK_STATE)
        out = self._bundle((link.number, name), relayed, now_ms) if bundles and self._leases.want_bundles else []
        if bundles and not self._leases.want_topics:
            return out
        payload = encode_state(relayed, self._settings.encoding)
        topic = self._cloud.drone_state(link.number, name)
        return [*out, self._channel.state(topic, payload, self._session, now_ms)]

    def _bundle(self, key: tuple[int, str], state: StampedState, now_ms: int) -> list[Effect]:
        """Keep a state for the next bundle.

        One that comes about as often as bundles leave must not be overtaken by its next value because the two clocks
        drift: then the bundle leaves first, and the next one half a turn later. Where the drone's link brought both
        together, or the next is a change that is not to be missed, it carries both. Of faster ones the newest counts.
        """
        out: list[Effect] = []
        interval_ms = self._settings.bundle_ms
        if key in self._bundled and now_ms - self._came_ms[key] >= PATIENCE * interval_ms:
            self._next_bundle_ms = now_ms + interval_ms // 2
            out = self._bundles(now_ms)
        waiting = self._bundled.setdefault(key, [])
        is_slow = self._is_slow(key, state.stamp)
        is_change = bool(waiting) and state.state.name in URGENT and waiting[-1].state != state.state
        if waiting and not (is_slow or is_change):
            waiting.pop()
        waiting.append(state)
        self._came_ms[key] = now_ms
        return out

    def _is_slow(self, key: tuple[int, str], origin: int) -> bool:
        """Whether a drone tells a state about as often as bundles leave, by the stamps of its last three values.

        One that is early among them, because it left with something urgent, makes no fast state.
        """
        before, was_slow = self._paces.get(key, (origin, True))
        apart_ms = (origin - before) % STAMP_MODULUS * STAMP_TICK_MS
        is_slow = apart_ms >= PATIENCE * self._settings.bundle_ms
        self._paces[key] = origin, is_slow
        return is_slow or was_slow

    def _bundles(self, now_ms: int) -> list[Effect]:
        pairs = [(drone, state) for (drone, _), waiting in self._bundled.items() for state in waiting]
        self._bundled.clear()
        self._came_ms.clear()
        return [
            self._channel.state(self._cloud.states, encode(bundle, self._settings.encoding), self._session, now_ms)
            for bundle in fog_bundles(pairs)
        ]
