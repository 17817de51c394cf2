"""The UAV client: the MAVLink <-> MQTT interpreter on the drone, as a state machine (docs/protocol.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..core.channel import Channel
from ..core.effects import Inbound, Log, Publish, Subscribe, Will
from ..core.hearing import Hearing
from ..core.own_presence import OwnPresence
from ..core.session_owners import SessionOwners
from ..core.settings import Settings
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.control import DroneLease
from ..protocol.logs import LOGS
from ..protocol.messages import BeaconMessage, CommandId, Presence
from ..protocol.parameters import PARAMETERS, ParameterSet
from ..protocol.plans import PLAN
from ..protocol.policies import Policy
from ..protocol.states import Armed
from ..protocol.topics import CloudSide, DroneTopic, FogSide
from ..security.cose import Envelope
from ..security.seal import Seal
from .answers import Unfinished
from .bulk import BulkPort, BulkStore
from .commands import LINK, CommandDesk
from .control import SessionControl
from .effects import Effect
from .endurance import EnduranceMeter
from .enquiries import Enquiries
from .executor import Executor
from .heartbeats import Heartbeats
from .log_work import LogDone, LogFault, LogLoaded
from .mavlink.vehicle import Vehicle
from .options import UavOptions
from .paths import Paths
from .published_states import PublishedStates
from .sensors.carrier import SENSORS, Carrier, is_carried


class UavClient:
    """One drone's side of the fog link. Times are milliseconds of the session clock.

    With a `seal` messages are signed, and only the activator of `fog` may give leases. `paths` is set if the client
    has several connections to the fog. `is_audited` is `CommandDesk`'s.
    """

    def __init__(
        self,
        drone: int,
        session: int,
        settings: Settings,
        topics: FogSide | None = None,
        policies: dict[str, Policy] | None = None,
        unfinished: list[Unfinished] | None = None,
        forgotten: list[CommandId] | None = None,
        remembers: bool = True,
        options: UavOptions | None = None,
        seal: Seal | None = None,
        fog: int = 0,
        kept_parameters: ParameterSet | None = None,
        paths: Paths | None = None,
        is_audited: Callable[[], bool] | None = None,
    ) -> None:
        options = options or UavOptions()
        self.drone = drone
        self.session = session
        self.settings = settings
        self.topics = topics or FogSide()
        self.vehicle = Vehicle(drone)
        self._channel = Channel(LINK, self.topics.root, settings, seal)
        self._presence = OwnPresence(self._channel, self.topics.reachable(drone), session)
        self._hearing = Hearing(LINK, lambda: [self._presence.say(up=True)])
        self._activator = f"fog{fog}"
        self._signed_clock = CloudSide(fog).signed_drone_clock(drone) if seal is not None else None
        owners, staged = SessionOwners(lambda session: session == self.executor.lease.holder_session), BulkStore()
        self.executor = Executor(self.vehicle, options.limits, staged.staged, kept_parameters)
        self.desk = CommandDesk(
            drone,
            session,
            self._channel,
            self.topics,
            self.executor,
            owners,
            unfinished=unfinished or [],
            forgotten=forgotten or [],
            remembers=remembers,
            has_paths=paths is not None,
            is_audited=is_audited,
        )
        self._answers = self.desk.answers
        self.parameters = self.executor.parameters
        staged.sources[PLAN] = self.executor.plans.fetch
        staged.sources[PARAMETERS] = self.parameters.fetch
        if options.keeps_logs:
            staged.logs = self.executor.logs
            staged.sources[LOGS] = staged.logs.listed
        self._bulk = BulkPort(drone, self._channel, self.topics, owners, staged)
        self.carrier = Carrier(drone, self._channel, self.topics) if options.carries_sensors else None
        self.connected = False
        self._streams = self.executor.streams
        self._states = PublishedStates(
            drone, session, self._channel, self.topics, self._streams, self.vehicle, policies, options.all_states
        )
        self._control = SessionControl(drone, session, self._channel, self.desk, owners)
        self._enquiries = Enquiries(self.vehicle, self._streams.client_hz, options.all_states)
        self._endurance = EnduranceMeter(self.vehicle, options.endurance_s)
        self._awaited_subacks = 0
        self._next_beacon_ms = 0
        self._heartbeats = Heartbeats()
        self.paths = paths
        self._listener: int | None = None
        """The activator's session in the newest lease since this connection began."""

    @property
    def born(self) -> bool:
        """Whether this session's birth is published. Before it no word and no state is."""
        return self._answers.may_publish

    def will(self) -> Will:
        """The will of a connection to the fog broker."""
        return self._presence.will(several=self.paths is not None)

    def is_ready(self, now_ms: int) -> bool:
        """Whether the birth is published and the autopilot's heartbeat is recent."""
        return self.born and self.vehicle.is_alive(now_ms)

    def on_connected(self, link: str, now_ms: int) -> list[Effect]:
        if link == SENSORS and self.carrier is not None:
            return self.carrier.on_connected(now_ms)
        self.connected = True
        self._hearing.connected(now_ms)
        self._awaited_subacks = 2
        commands = Subscribe(LINK, (self.topics.commands(self.drone),), live_only=True)
        others = [f(self.drone) for f in (self.topics.init_connect, self.topics.reachable, self.topics.bulk)]
        if self._channel.seal is not None:
            others += [self.topics.stations(self.drone), self.topics.control(self.drone)]
        if self.carrier is not None:
            others.append(self.topics.sensor_ack(self.drone))
        return [commands, Subscribe(LINK, tuple(others))]

    def on_disconnected(self, link: str, now_ms: int) -> list[Effect]:
        if link == SENSORS:
            return []
        self.connected = self._answers.may_publish = False
        self._hearing.end()
        if self.paths is not None:
            self.paths.on_lost(None)
        if self.carrier is not None:
            self.carrier.on_fog_down()
        return []

    def on_path(self, lost: str | None, now_ms: int) -> list[Effect]:
        """One of several connections to the fog came up, is lost (`lost`), stuck, or no longer the best."""
        if self.paths is not None and lost is not None:
            self.paths.on_lost(lost)
        if not self.born:
            return []
        self._states.throttle.repeat_published()  # states sent over another one may not have arrived
        readings = self.carrier.on_path() if self.carrier is not None else []
        return [self._beacon(now_ms), *self._answers.republish(), *readings]

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Effect]:
        """Once all subscriptions are granted, publish birth, beacon, and undelivered words and readings."""
        if subscribe.link == SENSORS:
            return []
        self._awaited_subacks -= 1
        if self._awaited_subacks != 0:
            return []
        self._answers.may_publish = True
        self._hearing.granted(now_ms)
        self._states.throttle.forget_published()
        self._listener = None
        out: list[Effect] = [self._presence.say(up=True), self._beacon(now_ms)]
        out += self._answers.close_restored(now_ms) + self._answers.republish()
        return out + (self.carrier.on_fog_up(now_ms) if self.carrier is not None else [])

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from the fog broker, or from the drone's own broker, to which sensors publish."""
        if link == SENSORS and self.carrier is not None:
            return self.carrier.on_message(message, now_ms)
        self._hearing.heard(now_ms)
        try:
            topic = self.topics.parse(message.topic)
            if topic.drone != self.drone:
                raise PayloadError(f"topic {message.topic!r}: not drone {self.drone}'s", "topic")
            if topic.kind == "commands":
                return self.desk.on_message(message, now_ms) if not self.executor.permit.is_leaving else []
            return self._on_other(topic, message, now_ms)
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Any, code: int, now_ms: int) -> list[Effect]:
        """A QoS 1 publish with `ref` was acknowledged with an MQTT reason code."""
        if link == SENSORS or self._hearing.published(ref, code, now_ms):
            return []
        if self.carrier is not None and is_carried(ref):
            return self.carrier.on_published(ref, code, now_ms)
        return self._answers.on_published(ref, code, now_ms)

    def on_mavlink(self, message: Any, now_ms: int) -> list[Effect]:
        """A message from the autopilot's link."""
        out: list[Effect] = []
        try:
            for state in self.vehicle.update(message, now_ms):
                self._states.throttle.update(state)
        except PayloadError as error:
            out.append(Log("autopilot_value", str(error)))
        texts = self._states.texts
        if texts is not None and message.get_type() == "STATUSTEXT" and self.vehicle.is_own(message):
            texts.on_message(message, now_ms)
        endurance = self._endurance.on_message(message, now_ms)
        if endurance is not None:
            self._states.throttle.update(endurance)
        out += self._answers.give(self.executor.on_message(message, now_ms), now_ms)
        streamed = self._states.streamed(message, now_ms)
        return self._with_bundle(out + self._states.publish(streamed, now_ms), now_ms) if self.born else out

    def on_transmitted(self, ref: Any, now_ms: int) -> list[Effect]:
        return self._answers.give(self.executor.on_transmitted(ref, now_ms), now_ms)

    def on_refused(self, ref: Any, late: bool, now_ms: int) -> list[Effect]:
        return self._answers.give(self.executor.on_refused(ref, late, now_ms), now_ms)

    def on_log(self, done: LogDone, now_ms: int) -> list[Effect]:
        """The result of work on the folder of logs."""
        if isinstance(done, LogLoaded):
            return self._bulk.on_loaded(done) if self.born else []
        out: list[Effect] = [Log("logs", done.detail)] if isinstance(done, LogFault) else []
        return out + self._answers.give(self.executor.logs.on_done(done, now_ms), now_ms)

    def on_identity(self, now_ms: int) -> list[Effect]:
        """Publish birth and beacon for the identity's new key, or the fleet's newer revocation list."""
        if self._channel.seal is None:
            return []
        self._channel.seal.on_identity()
        return [self._presence.say(up=True), self._beacon(now_ms)] if self.born else []

    def tick(self, now_ms: int) -> list[Effect]:
        """Everything that is due by time. Call it at least ten times per second."""
        if self._control.is_refused and not self._is_armed:
            return [self._control.stop()]
        out = self.desk.tick(now_ms)
        out += self._heartbeats.due(now_ms, self.is_controlled(now_ms))
        for question in (*self._enquiries.due(now_ms), *self._streams.reminders(now_ms)):
            out += self._answers.give(self.executor.ask(question, now_ms), now_ms)
        if not self.born:
            return out
        if now_ms >= self._next_beacon_ms:
            out.append(self._beacon(now_ms))
        if self._presence.rebirth.is_due(now_ms):
            out.append(self._presence.say(up=True))
        if not self._control.is_refused:  # its topic may show another's birth
            out += self._hearing.tick(now_ms)
        if self.carrier is not None:
            out += self.carrier.tick(now_ms)
        out += self._bulk.tick(now_ms) + self._states.publish(self._states.due(now_ms), now_ms)
        bundle = self._states.bundle(now_ms)
        return out + self._answers.say_first_words() + bundle if bundle else self._with_bundle(out, now_ms)

    def _with_bundle(self, out: list[Effect], now_ms: int) -> list[Effect]:
        """Add the waiting states if `out` has a word: messages of one turn share a TCP segment (R10.7)."""
        return out + self._states.bundle(now_ms, early=True) if any(map(self._answers.is_word, out)) else out

    def is_controlled(self, now_ms: int) -> bool:
        """Whether a ground station controls this drone: its lease from the activator has not ended."""
        return self.executor.lease.is_held(now_ms)

    def goodbye(self, now_ms: int) -> list[Effect]:
        """Stop cleanly: end set-points with a hold, publish waiting words, then `down`."""
        self._hearing.end()
        said = self._answers.say_first_words()
        self._answers.may_publish = False
        if self.carrier is not None:
            self.carrier.on_fog_down()
        out = [*said, *self._answers.give(self.executor.leave(now_ms), now_ms)]
        return [*out, self._presence.say(up=False)] if self.connected else out

    def _on_other(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        if topic.kind == "reachable":
            return self._on_own_presence(message, now_ms)
        if topic.kind == "init_connect":
            lease = decode(DroneLease, self._channel.opened(message, self._activator))
            if lease.drone_session != self.session:
                return []
            if self._control.is_of_before(lease):
                return [Log("old_lease", f"a lease over {message.path}: of an earlier activator session")]
            is_plain = self._channel.seal is None  # a signed lease is always from the drone's fog
            if self.paths is not None and is_plain and not self.paths.takes(lease, message.path, now_ms):
                return [
                    Log("other_activator", f"a lease over {message.path}: not of the activator of the first broker")
                ]
            if not lease.bound:
                return self._on_refusal(lease)
            self._on_lease(lease, now_ms)
            out: list[Effect] = [] if self.paths is None else [self.paths.led(lease, message.path)]
            return [*out, self._beacon(now_ms, lease.nonce)]
        if topic.kind == "sensor_ack" and self.carrier is not None:
            return self.carrier.on_ack(message, now_ms)
        if topic.kind == "bulk":
            holder = self.executor.lease.holder_session if self.is_controlled(now_ms) else None
            return self._bulk.on_message(message, holder, now_ms)
        if topic.kind == "stations" and self._channel.seal is not None:
            return self._control.on_station(self._channel.seal, message)
        if topic.kind == "control" and self._channel.seal is not None:
            return self._control.on_grant(self._channel.seal, message)
        raise PayloadError(f"topic {message.topic!r}: not a UAV client's", "topic")

    def _on_refusal(self, lease: DroneLease) -> list[Effect]:
        out = self._control.on_refusal(lease, self._is_armed)
        if self._control.is_refused:
            self._presence.rebirth.disarm()
        return [*out]

    @property
    def _is_armed(self) -> bool:
        return self.vehicle.seen(Armed) == Armed(True)

    def _on_lease(self, lease: DroneLease, now_ms: int) -> None:
        before = self._control.lease
        if not self._control.take(lease):
            return
        if self.carrier is not None and (before is None or before.activator_session != lease.activator_session):
            self.carrier.on_new_activator(now_ms)
        if lease.activator_session != self._listener or lease.anew:
            self._states.throttle.repeat_published()  # it lacks the earlier ones, and some change rarely
            self._listener = lease.activator_session

    def _on_own_presence(self, message: Inbound, now_ms: int) -> list[Effect]:
        """Keep the birth on its topic. A refused client leaves another's birth there, whoever signed it (R9.5)."""
        if self._control.is_refused and decode(Presence, Envelope.parse(message.payload).payload).up:
            return []
        if not self._presence.is_shown(message) and self.born:
            self._presence.rebirth.arm(now_ms)
        return []

    def _beacon(self, now_ms: int, nonce: int | None = None) -> Publish:
        self._next_beacon_ms = now_ms + self.settings.beacon_interval_ms
        held_ms = 0 if nonce is not None else None
        message = BeaconMessage(
            session=self.session, now_ms=now_ms, nonce=nonce, held_ms=held_ms, revoked=self._channel.list_number
        )
        return self._channel.publish(self.topics.clock(self.drone), message, qos=0, signed_as=self._signed_clock)
