"""The states that a drone publishes: by their policies or at requested rates, singly or in bundles."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Log, Publish
from ..core.settings import next_turn_ms
from ..errors import PayloadError
from ..protocol.bundles import drone_bundle
from ..protocol.codec import encode
from ..protocol.policies import ON_REQUEST, URGENT, Policy, Throttle
from ..protocol.state_payload import StampedState, encode_state
from ..protocol.states import STATES, Fence, Home, Mission, State
from ..protocol.topics import FogSide
from .effects import Effect
from .mavlink.vehicle import LOST_MS, SOURCES, Vehicle
from .streams import Streams
from .texts import Texts

_SELDOM = frozenset({Home.name, Mission.name, Fence.name})
"""States whose messages may be rare."""
_STREAMED = frozenset(SOURCES) - _SELDOM
"""States that are not known any more once no message has carried a value of them; others end with the heartbeats."""


class PublishedStates:
    """Decides when one UAV client session publishes which state. `throttle` has the newest value of each.

    With `all_states` the states on request are published too, and so are the autopilot's `texts`, otherwise None.
    """

    def __init__(
        self,
        drone: int,
        session: int,
        channel: Channel,
        topics: FogSide,
        streams: Streams,
        vehicle: Vehicle,
        policies: dict[str, Policy] | None,
        all_states: bool = False,
    ) -> None:
        self.throttle = Throttle(policies)
        self.texts = Texts() if all_states else None
        self._unasked = frozenset() if all_states else ON_REQUEST
        self._drone = drone
        self._session = session
        self._channel = channel
        self._settings = channel.settings
        self._topics = topics
        self._streams = streams
        self._vehicle = vehicle
        self._next_bundle_ms = 0
        self._for_bundle: dict[str, State] = {}

    def streamed(self, message: Any, now_ms: int) -> list[State]:
        """The states whose requested rate is served by this message, after the vehicle was updated by it."""
        return self._without_bundled(self._streams.on_message(message, now_ms))

    def due(self, now_ms: int) -> list[State]:
        """The states to publish singly now: at requested rates and, without bundles, by their policies."""
        lost = self._leave_out(now_ms)
        current = (self.throttle.current(name) for name in self._streams.due(now_ms) if name not in lost)
        alone = self._without_bundled([state for state in current if state is not None])
        alone += self.texts.due(now_ms) if self.texts is not None else []
        return alone if self._settings.bundles else [*alone, *self.throttle.due(now_ms)]

    def _leave_out(self, now_ms: int) -> frozenset[str]:
        """Set the states that the throttle leaves out; returns those that are not known any more (R3.5)."""
        is_silent = self._vehicle.arrivals.silence_ms("HEARTBEAT", now_ms) > LOST_MS
        lost = frozenset(
            name
            for name in STATES
            if (self._vehicle.age_ms(name, now_ms) > LOST_MS if name in _STREAMED else is_silent)
        )
        self.throttle.apart = self._unasked | self._streams.names | lost
        return lost

    def _without_bundled(self, streamed: list[State]) -> list[State]:
        """Keep the states streamed no faster than bundles leave for the next bundle, and return the others."""
        if not self._settings.bundles:
            return streamed
        waiting = [state for state in streamed if self._streams.waits(state.name, self._settings.bundle_ms)]
        self._for_bundle |= {state.name: state for state in waiting}
        return [state for state in streamed if state not in waiting]

    def bundle(self, now_ms: int, early: bool = False) -> list[Effect]:
        """All due states in one message: once per bundle interval, when an urgent state is due, or if `early`."""
        if not self._settings.bundles:
            return []
        lost = self._leave_out(now_ms)
        if not early and now_ms < self._next_bundle_ms and not self.throttle.is_due(URGENT, now_ms):
            return []
        on_schedule_ms = self._next_bundle_ms
        self._next_bundle_ms = next_turn_ms(on_schedule_ms, now_ms, self._settings.bundle_ms)
        due = {state.name: state for state in self.throttle.due(now_ms)}
        waiting = {name: state for name, state in self._for_bundle.items() if name not in lost}
        due |= {name: self.throttle.current(name) or state for name, state in waiting.items()}
        self._for_bundle.clear()
        together, refused = list(due.values()), list[Effect]()
        try:
            encoded = self._encoded_together(together, now_ms)
        except PayloadError:  # encode each singly, to find those that cannot be carried
            alone = [(state, self._encoded(state, now_ms)) for state in together]
            refused += [found for _, found in alone if isinstance(found, Log)]
            together = [state for state, found in alone if not isinstance(found, Log)]
            encoded = self._encoded_together(together, now_ms)
        if not together:
            self._next_bundle_ms = on_schedule_ms if early else self._next_bundle_ms
            return refused
        topic = self._topics.states(self._drone)
        payload = self._channel.state_payload(topic, encoded, self._session, now_ms)
        return [Publish(self._channel.link, topic, payload), *refused]

    def _encoded_together(self, states: list[State], now_ms: int) -> bytes:
        """An encoded bundle. Raises PayloadError if a value cannot be carried."""
        return encode(drone_bundle(states, stamp(now_ms)), self._settings.encoding)

    def publish(self, states: Iterable[State], now_ms: int) -> list[Effect]:
        """Publish each state on its own topic; a value that cannot be carried is counted."""
        out: list[Effect] = []
        for state in states:
            encoded, topic = self._encoded(state, now_ms), self._topics.state(self._drone, state.name)
            if isinstance(encoded, Log):
                out.append(encoded)
            else:
                payload = self._channel.state_payload(topic, encoded, self._session, now_ms)
                out.append(Publish(self._channel.link, topic, payload))
        return out

    def _encoded(self, state: State, now_ms: int) -> bytes | Log:
        try:
            return encode_state(StampedState(state, stamp(now_ms)), self._settings.encoding)
        except PayloadError as error:
            return Log("autopilot_value", f"{state.name}: {error}")
