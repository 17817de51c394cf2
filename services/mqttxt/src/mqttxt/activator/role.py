"""The activator of one fog: gate, presence and command relay between two brokers, as a state machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ..core.channel import Channel
from ..core.effects import Effect, Inbound, Log, Publish, Subscribe, Will
from ..core.floods import TokenBucket
from ..core.hearing import Hearing
from ..core.session_owners import SessionOwners
from ..core.settings import Settings
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.messages import BeaconMessage, Presence
from ..protocol.topics import CloudSide, DroneTopic, FogSide, FogTopic, StationTopic, Topic
from ..security.seal import Seal
from .births import Births
from .bulk_relay import BulkRelay
from .command_relay import CommandRelay
from .drones import CLOUD, FOG, Drones
from .leases import Leases
from .ownership import Ownership
from .part import Site
from .selector import Selector
from .sensor_relay import Carried, SensorRelay
from .state_relay import StateRelay
from .stations import Stations
from .together import WordsTogether

DRONE_PER_S, DRONE_AT_ONCE = 2000, 4000
"""Limits for states and readings of one drone: about forty states at the highest rate that `stream` allows.

Its words have such limits of their own: none is lost for states.
"""
PRESENCE_PER_S, PRESENCE_AT_ONCE = 50, 200
"""Limits for births and beacons of one drone, each of which makes the activator publish."""
_ASKING = frozenset({"commands", "select", "init_connect"})
"""Kinds of topics that are left to another activator while that may own the fog."""
_ONCE_BORN = frozenset({"bulk_answer", "sensor"})
"""Kinds of the drones' topics that are dropped until this session is the fog's activator."""

Handler = Callable[[Any, Inbound, int], list[Effect]]


class Activator:
    """One activator session. Times are milliseconds of its session clock. With a `seal` messages are signed.

    `has_paths` and `is_audited` are `CommandRelay`'s.
    """

    def __init__(
        self,
        fog: int,
        session: int,
        settings: Settings,
        *,
        drones: tuple[int, ...] = (),
        broker: str | None = None,
        cloud: CloudSide | None = None,
        fog_side: FogSide | None = None,
        seal: Seal | None = None,
        has_paths: bool = False,
        is_audited: Callable[[], bool] | None = None,
    ) -> None:
        self.fog = fog
        self.session = session
        self.settings = settings
        self.cloud = cloud or CloudSide(fog)
        self.fog_side = fog_side or FogSide()
        self.leases = Leases(drones)
        self._to_cloud = Channel(CLOUD, self.cloud.prefix, settings, seal)
        self._to_fog = Channel(FOG, self.fog_side.root, settings, seal)
        self.owners = SessionOwners(self.leases.names)
        site = Site(session, self._to_cloud, self._to_fog, self.cloud, self.fog_side, self.leases, self.owners)
        self.drones = Drones(site, drones)
        self.together = WordsTogether(session, self._to_cloud, self.cloud)
        self.relay = CommandRelay(site, self.drones, self.together, has_paths=has_paths, is_audited=is_audited)
        self.selector = Selector(site, self.drones, self.relay, self.together)
        self.states = StateRelay(site, self.drones)
        self.sensors = SensorRelay(site)
        self.bulk = BulkRelay(site, self.drones)
        self._births = Births(site, self.drones)
        self.ownership = Ownership(site, self.drones, self._births, broker)
        self._hearing = Hearing(CLOUD, self.ownership.introduction)
        self._stations = Stations(site, self.drones, self._births, self.ownership, self.states, self.sensors)
        self._of_drones = TokenBucket(DRONE_PER_S, DRONE_AT_ONCE)
        self._presence_of_drones = TokenBucket(PRESENCE_PER_S, PRESENCE_AT_ONCE)
        self._seal = seal
        self._sides: Mapping[str, CloudSide | FogSide] = {CLOUD: self.cloud, FOG: self.fog_side}
        self._handlers = self._made_handlers(seal)
        self.connected = {CLOUD: False, FOG: False}
        self._subacks = {CLOUD: 0, FOG: 0}

    @property
    def born(self) -> bool:
        """Whether this session is the fog's activator."""
        return self.ownership.born

    def will(self) -> Will:
        """The will of the connection to the cloud broker; the fog broker needs none."""
        return self.ownership.will()

    def is_ready(self, now_ms: int) -> bool:
        """Whether the activator is born at the cloud broker and subscribed at the fog broker."""
        return self.born and self.connected[FOG] and self._subacks[FOG] == 0

    def on_connected(self, link: str, now_ms: int) -> list[Effect]:
        self.connected[link] = True
        if link == FOG:
            self._subacks[FOG] = 1
            return [Subscribe(FOG, self.fog_side.activator_filters())]
        self._hearing.connected(now_ms)
        self._subacks[CLOUD] = 3
        return [
            Subscribe(CLOUD, self.cloud.activator_command_filters(), live_only=True),
            Subscribe(CLOUD, self.cloud.activator_filters(signed=self._seal is not None)),
            Subscribe(CLOUD, (self.cloud.clock,)),
        ]

    def on_disconnected(self, link: str, now_ms: int) -> list[Effect]:
        self.connected[link] = False
        if link == CLOUD:
            self._hearing.end()
            self.ownership.on_cloud_down()
            self.sensors.on_cloud_down()
            return self.drones.on_cloud_down(now_ms)
        self.relay.fog_connected = False
        gone = self.drones.forget_connections()
        return [self.drones.record_of(number) for number in gone] if self.born else []

    def on_path(self, lost: str | None, now_ms: int) -> list[Effect]:
        """One of several connections to the fog is up, lost (`lost`), stuck, or no longer the best (R19.2, R19.5)."""
        gone = self._watched(self.drones.forget_path(lost), now_ms) if lost is not None else []
        return gone + self.relay.on_path(now_ms) + self.drones.ask_all(now_ms)

    def path_of(self, topic: str) -> str | None:
        """The better connection to the drone of a topic of the fog's side."""
        return self.drones.path_of(self.fog_side.parse(topic).drone)

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Effect]:
        link = subscribe.link
        self._subacks[link] = max(0, self._subacks[link] - 1)
        if self._subacks[link] != 0:
            return []
        if link == FOG:
            self.relay.fog_connected = True
            return []
        self._hearing.granted(now_ms)
        # The broker sends its retained messages before this beacon returns: then any other activator is known.
        return self.ownership.on_subscribed(now_ms)

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from one of the two brokers; one that breaks the specification is counted and dropped."""
        if link == CLOUD:
            self._hearing.heard(now_ms)
        try:
            topic = self._sides[link].parse(message.topic)
            refusal = self._refusal(link, topic, message, now_ms)
            if refusal is not None:
                return [refusal]
            take = self._handlers.get((link, type(topic), topic.kind))
            if take is None:
                raise PayloadError(f"topic {message.topic!r}: not for an activator", "topic")
            return take(topic, message, now_ms) if self.ownership.born or topic.kind not in _ONCE_BORN else []
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Any, code: int, now_ms: int) -> list[Effect]:
        if link == CLOUD and self._hearing.published(ref, code, now_ms):
            return []
        if isinstance(ref, Carried):
            return self.sensors.on_published(ref, code, now_ms)
        return self.relay.on_published(ref, code, now_ms) if link == FOG else []

    def on_identity(self, now_ms: int) -> list[Effect]:
        """The identity has a new key, whose certificate is then shown, or its fleet a newer revocation list."""
        if self._seal is None:
            return []
        is_renewed = self._seal.on_identity()
        out = [*self._stations.end_revoked(self._seal, now_ms), *self.ownership.on_identity(is_renewed, now_ms)]
        return out + (self.drones.show_certificate(now_ms) if is_renewed else [])

    def tick(self, now_ms: int) -> list[Effect]:
        """Do everything that is due; to be called at least ten times per second."""
        out = [*self.say_together(now_ms), *self.drones.controlled_anew(self.leases.tick(now_ms), now_ms)]
        out += self._watched(self.drones.tick(now_ms), now_ms) + self.relay.tick(now_ms)
        self.selector.tick(now_ms)
        out += self._stations.tick(now_ms) + self._hearing.tick(now_ms)
        return out + self.states.tick(now_ms) + self.sensors.tick(now_ms) + self.ownership.tick(now_ms)

    @property
    def together_due_ms(self) -> int | None:
        """When words that wait for others must be sent; None if none wait."""
        return self.together.due_ms

    def say_together(self, now_ms: int) -> list[Effect]:
        """Publish the words that have waited for others long enough; to be called at `together_due_ms` too."""
        return self._with_bundle([*self.together.tick(now_ms)], now_ms)

    def goodbye(self, now_ms: int) -> list[Effect]:
        """Publish waiting words, then that neither the fog nor its drones are reachable."""
        self._hearing.end()
        self.together.is_ended = True
        return [*self.together.flush(now_ms), *self.ownership.goodbye()]

    def _made_handlers(self, seal: Seal | None) -> dict[tuple[str, type[Topic], str], Handler]:
        """The handlers of messages, by broker and kind of topic."""
        handlers: dict[tuple[str, type[Topic], str], Handler] = {
            (CLOUD, DroneTopic, "bulk"): self.bulk.on_ask,
            (CLOUD, DroneTopic, "commands"): self.relay.on_command,
            (CLOUD, DroneTopic, "reachable"): self.ownership.on_record,
            (CLOUD, FogTopic, "clock"): self.ownership.on_clock,
            (CLOUD, FogTopic, "commands"): self.relay.on_command,
            (CLOUD, FogTopic, "init_connect"): self._stations.on_registration,
            (CLOUD, FogTopic, "reachable"): self.ownership.on_presence,
            (CLOUD, FogTopic, "select"): self.selector.on_select,
            (CLOUD, StationTopic, "reachable"): self._stations.on_presence,
            (FOG, DroneTopic, "bulk_answer"): self.bulk.on_answer,
            (FOG, DroneTopic, "clock"): self._on_drone_beacon,
            (FOG, DroneTopic, "commands_result"): self._on_result,
            (FOG, DroneTopic, "reachable"): self._on_drone_presence,
            (FOG, DroneTopic, "sensor"): self.sensors.on_reading,
            (FOG, DroneTopic, "state"): self.states.on_states,
            (FOG, DroneTopic, "states"): self.states.on_states,
        }
        if seal is not None:
            handlers[CLOUD, DroneTopic, "control"] = partial(self._stations.on_grant, seal)
            handlers[CLOUD, DroneTopic, "sensor_ack"] = partial(self._stations.on_heard, seal)
        return handlers

    def _refusal(self, link: str, topic: Topic, message: Inbound, now_ms: int) -> Log | None:
        """Why a message is dropped unread; None if it is not."""
        if isinstance(topic, DroneTopic) and link == FOG:
            budget = self._presence_of_drones if topic.kind in ("reachable", "clock") else self._of_drones
            if not budget.takes((topic.drone, topic.kind == "commands_result"), now_ms):
                return Log("flood", f"{message.topic}: too many of drone {topic.drone}")
        elif self.ownership.is_doubtful and topic.kind in _ASKING:
            return Log("not_born", f"{message.topic}: left to the activator that may own fog {self.fog}")
        return None

    def _on_result(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's word about a command."""
        link = self.drones.links.get(topic.drone)
        if link is None:
            raise PayloadError(f"topic {message.topic!r}: a drone that was never reachable", "topic")
        if self._seal is None:
            return self._with_bundle(self.relay.words.on_result(link, message.payload, topic.name, now_ms), now_ms)
        said_on = self._to_fog.signed_topic(message.topic)
        signed = self._seal.open(said_on, message.payload, f"drone{topic.drone}")
        said = self.relay.words.on_result(link, signed.payload, topic.name, now_ms, signed.envelope.bare())
        return self._with_bundle(said, now_ms)

    def _with_bundle(self, said: list[Effect], now_ms: int) -> list[Effect]:
        """Add waiting states to messages about commands: both leave in one TCP segment to the cloud broker (R10.7)."""
        is_said = any(isinstance(effect, Publish) and effect.link == CLOUD for effect in said)
        return [*said, *self.states.beside_words(now_ms)] if is_said else said

    def _on_drone_presence(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's birth or will; a signed birth is passed on to stations, which verify the drone's messages by it."""
        drone = topic.drone
        presence = decode(Presence, self._to_fog.opened(message, f"drone{drone}"))
        passed_on = self._births.on_drone(drone, message.payload) if self._seal is not None and presence.up else []
        return passed_on + self._watched(self.drones.on_presence(drone, presence, now_ms, message.path), now_ms)

    def _on_drone_beacon(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's beacon; a signed one is passed on to stations, which compute the deadlines of commands from it."""
        drone = topic.drone
        signed_as = self.cloud.signed_drone_clock(drone)
        beacon = decode(BeaconMessage, self._to_fog.opened(message, f"drone{drone}", signed_as))
        out = self._watched(self.drones.on_beacon(drone, beacon, now_ms, message.path), now_ms)
        link = self.drones.links.get(drone)
        if self._seal is not None and self.born and link is not None and link.session == beacon.session:
            out = [*out, Publish(CLOUD, self.cloud.drone_clock(drone), message.payload, qos=0)]
        return out

    def _watched(self, out: list[Effect], now_ms: int) -> list[Effect]:
        """Add the effects of drones that became reachable: open commands are sent again, known states relayed.

        A changed roster touches the ranking.
        """
        appeared, self.drones.appeared = self.drones.appeared, []
        for link in appeared:
            out = out + self.relay.on_drone_reachable(link, now_ms) + self.states.relay_all([link], now_ms)
        if self.drones.roster_changed:
            self.states.qods.touched = True
        return out
