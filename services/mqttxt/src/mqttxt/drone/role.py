"""The UAV client: the MAVLink <-> MQTT interpreter on the drone, as a state machine (docs/protocol.md)."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Inbound, Log, Publish, Stop, Subscribe, Will
from ..core.session_owners import SessionOwners
from ..core.settings import Rebirth, Settings, next_turn_ms
from ..errors import PayloadError
from ..protocol.bundles import drone_bundle
from ..protocol.codec import decode, encode
from ..protocol.messages import BeaconMessage, CommandId, DroneLease, Grant, Presence
from ..protocol.policies import URGENT, Policy, Throttle
from ..protocol.state_payload import StampedState, encode_state
from ..protocol.states import State
from ..protocol.topics import DroneTopic, FogSide, station_reachable
from ..security.cose import Envelope
from ..security.seal import Seal, is_station
from .commands import LINK, CommandDesk, Unfinished
from .effects import Effect, Transmit
from .endurance import EnduranceMeter
from .enquiries import Enquiries
from .grants import Grants
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .options import UavOptions
from .sensors.carrier import SENSORS, Carrier, is_carried

MAV_HEARTBEAT_MS = 1000


class UavClient:
    """One drone's side of the fog link. Times are milliseconds of the session clock.

    With a `seal` messages are signed, and leases are taken of the activator of `fog` alone.
    """

    def __init__(
        self,
        drone: int,
        session: int,
        settings: Settings,
        topics: FogSide | None = None,
        policies: dict[str, Policy] | None = None,
        unfinished: list[Unfinished] | None = None,
        remembers: bool = True,
        options: UavOptions | None = None,
        seal: Seal | None = None,
        fog: int = 0,
    ) -> None:
        options = options or UavOptions()
        self.drone = drone
        self.session = session
        self.settings = settings
        self.topics = topics or FogSide()
        self.vehicle = Vehicle(drone)
        self._channel = Channel(LINK, self.topics.root, settings, seal)
        self._activator = f"fog{fog}"
        self._owners = SessionOwners()
        self._grants = Grants()
        self.desk = CommandDesk(
            drone,
            session,
            self._channel,
            self.topics,
            self.vehicle,
            unfinished or [],
            self._owners,
            remembers,
            options.limits,
        )
        self.carrier = Carrier(drone, LINK, settings, self.topics) if options.carries_sensors else None
        self.connected = False
        self._streams = self.desk.executor.streams
        self._throttle = Throttle(policies)
        self._enquiries = Enquiries(self.vehicle)
        self._endurance = EnduranceMeter(self.vehicle, options.endurance_s)
        self._awaited_subacks = 0
        self._next_beacon_ms = 0
        self._next_mav_heartbeat_ms = 0
        self._next_bundle_ms = 0
        self._for_bundle: dict[str, State] = {}
        self._rebirth = Rebirth()
        self._lease: DroneLease | None = None
        self._listener: int | None = None
        """The activator's session that was there, by its lease, since this connection began."""

    @property
    def born(self) -> bool:
        """Whether this session's birth is published, so that words and states may be."""
        return self.desk.may_publish

    def will(self) -> Will:
        """The will of the connection to the fog broker."""
        return Will(self.topics.reachable(self.drone), self._presence(up=False))

    def is_ready(self, now_ms: int) -> bool:
        """Whether the drone has a session with its broker and a heartbeat from its autopilot."""
        return self.born and self.vehicle.is_alive(now_ms)

    def on_connected(self, link: str, now_ms: int) -> list[Effect]:
        if link == SENSORS and self.carrier is not None:
            return self.carrier.on_connected(now_ms)
        self.connected = True
        self._awaited_subacks = 2
        commands = Subscribe(LINK, (self.topics.commands(self.drone),), live_only=True)
        others = [self.topics.init_connect(self.drone), self.topics.reachable(self.drone)]
        if self._channel.seal is not None:
            others += [self.topics.stations(self.drone), self.topics.control(self.drone)]
        if self.carrier is not None:
            others.append(self.topics.sensor_ack(self.drone))
        return [commands, Subscribe(LINK, tuple(others))]

    def on_disconnected(self, link: str, now_ms: int) -> list[Effect]:
        if link == SENSORS:
            return []
        self.connected = self.desk.may_publish = False
        if self.carrier is not None:
            self.carrier.on_fog_down()
        return []

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Effect]:
        """Commands can be heard from now on: say so, then everything that may not have been heard before."""
        if subscribe.link == SENSORS:
            return []
        self._awaited_subacks -= 1
        if self._awaited_subacks != 0:
            return []
        self.desk.may_publish = True
        self._throttle.forget_published()
        self._listener = None
        out: list[Effect] = [self._birth(), self._beacon(now_ms)]
        out += self.desk.close_restored(now_ms) + self.desk.republish()
        return out + (self.carrier.on_fog_up(now_ms) if self.carrier is not None else [])

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from the fog broker, or from the drone's own, where sensors publish."""
        if link == SENSORS and self.carrier is not None:
            return self.carrier.on_message(message, now_ms)
        try:
            topic = self.topics.parse(message.topic)
            if topic.drone != self.drone:
                raise PayloadError(f"topic {message.topic!r}: not drone {self.drone}'s", "topic")
            if topic.kind == "commands":
                return self.desk.on_payload(message, now_ms)
            return self._on_other(topic, message, now_ms)
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Any, code: int, now_ms: int) -> list[Effect]:
        """A QoS 1 publish with `ref` was acknowledged with an MQTT reason code."""
        if link == SENSORS:
            return []
        if self.carrier is not None and is_carried(ref):
            return self.carrier.on_published(ref, code, now_ms)
        return self.desk.on_published(ref, code, now_ms)

    def on_journalled(self, command_id: CommandId, now_ms: int) -> list[Effect]:
        """The journal has it that a command is open."""
        return self.desk.on_journalled(command_id, now_ms)

    def on_not_journalled(self, command_id: CommandId, now_ms: int) -> list[Effect]:
        """The disk did not take that a command is open."""
        return self.desk.on_not_journalled(command_id, now_ms)

    def on_mavlink(self, message: Any, now_ms: int) -> list[Effect]:
        """A message from the autopilot's link."""
        out: list[Effect] = []
        try:
            for state in self.vehicle.update(message, now_ms):
                self._throttle.update(state)
        except PayloadError as error:
            out.append(Log("autopilot_value", str(error)))
        endurance = self._endurance.on_message(message, now_ms)
        if endurance is not None:
            self._throttle.update(endurance)
        out += self.desk.carry_out(self.desk.executor.on_message(message, now_ms), now_ms)
        streamed = self._without_bundled(self._streams.on_message(message, now_ms))
        return out + [effect for state in streamed for effect in self._publish_state(state, now_ms)]

    def on_transmitted(self, ref: Any, now_ms: int) -> list[Effect]:
        return self.desk.carry_out(self.desk.executor.on_transmitted(ref, now_ms), now_ms)

    def on_refused(self, ref: Any, late: bool, now_ms: int) -> list[Effect]:
        return self.desk.carry_out(self.desk.executor.on_refused(ref, late, now_ms), now_ms)

    def tick(self, now_ms: int) -> list[Effect]:
        """Everything that is due by time; to be called at least ten times a second."""
        out = self.desk.tick(now_ms)
        if now_ms >= self._next_mav_heartbeat_ms:
            self._next_mav_heartbeat_ms = now_ms + MAV_HEARTBEAT_MS
            out.append(Transmit(_heartbeat(mavlink.MAV_TYPE_ONBOARD_CONTROLLER)))
            if self.is_controlled(now_ms):
                out.append(Transmit(_heartbeat(mavlink.MAV_TYPE_GCS), source=Source.GCS))
        for question in (*self._enquiries.due(now_ms), *self._streams.reminders(now_ms)):
            out += self.desk.carry_out(self.desk.executor.ask(question, now_ms), now_ms)
        if not self.born:
            return out
        if now_ms >= self._next_beacon_ms:
            out.append(self._beacon(now_ms))
        if self._rebirth.is_due(now_ms):
            out.append(self._birth())
        if self.carrier is not None:
            out += self.carrier.tick(now_ms)
        return out + self._publish_states(now_ms)

    def is_controlled(self, now_ms: int) -> bool:
        """Whether a ground station controls this drone: the lease that the activator handed down has not ended."""
        until_ms = self.desk.executor.lease_until_ms
        return until_ms is not None and now_ms <= until_ms

    def goodbye(self, now_ms: int) -> list[Effect]:
        """A clean stop leaves no set-points behind, and says that the drone is no longer reachable."""
        self.desk.may_publish = False
        if self.carrier is not None:
            self.carrier.on_fog_down()
        out = self.desk.carry_out(self.desk.executor.leave(), now_ms)
        return [*out, self._publish_presence(up=False)] if self.connected else out

    def _on_other(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        if topic.kind == "reachable":
            return self._on_own_presence(message, now_ms)
        if topic.kind == "init_connect":
            lease = decode(DroneLease, self._channel.opened(message, self._activator))
            if lease.drone_session != self.session:
                return []
            if not lease.bound:
                return [Stop(f"refused: another live UAV client is drone {self.drone} already")]
            if self.carrier is not None and (
                self._lease is None or self._lease.activator_session != lease.activator_session
            ):
                self.carrier.on_new_activator(now_ms)
            self._take_lease(lease)
            return [self._beacon(now_ms, lease.nonce)]
        if topic.kind == "sensor_ack" and self.carrier is not None:
            return self.carrier.on_ack(self._channel.opened(message, self._activator), now_ms)
        if topic.kind == "stations" and self._channel.seal is not None:
            return self._on_station(self._channel.seal, message)
        if topic.kind == "control" and self._channel.seal is not None:
            return self._on_grant(self._channel.seal, message)
        raise PayloadError(f"topic {message.topic!r}: not a UAV client's", "topic")

    def _on_own_presence(self, message: Inbound, now_ms: int) -> list[Effect]:
        """The birth is said again where the topic shows anything else; who signs knows its own by the bytes."""
        if self._channel.seal is not None:
            is_own = message.payload == self._birth().payload
        else:
            seen = decode(Presence, message.payload)
            is_own = seen.session == self.session and seen.up
        if self.born and not is_own:
            self._rebirth.arm(now_ms)
        return []

    def _on_station(self, seal: Seal, message: Inbound) -> list[Effect]:
        """A ground station's birth as it was signed: from now on the drone knows its certificate and its session."""
        signed = seal.verified(
            Envelope.parse(message.payload), lambda station: station_reachable(station.node.label), is_station
        )
        presence = decode(Presence, signed.payload)
        if not self._owners.claim(presence.session, signed.signer):
            return [Log("foreign_session", f"{signed.signer}: session {presence.session:08x} is another station's")]
        return []

    def _on_grant(self, seal: Seal, message: Inbound) -> list[Effect]:
        """A station's own word on its control, which no activator can make last longer."""
        signed = seal.open_of_station(self._channel.signed_topic(message.topic), Envelope.parse(message.payload))
        grant = decode(Grant, signed.payload)
        is_own = self._owners.is_of(grant.gs_session, signed.signer)
        if not is_own or not signed.certificate.rights.may_command(self.drone):
            raise PayloadError(f"grant of {signed.signer}: expected its own session and the right", "foreign_session")
        if grant.drone_session == self.session:
            self._grants.take(grant)
            self._apply_lease()
        return []

    def _take_lease(self, lease: DroneLease) -> None:
        """The newest word on who controls this drone; a lower epoch of the same activator is an old one."""
        known = self._lease
        if known is not None and known.activator_session == lease.activator_session and lease.epoch < known.epoch:
            return
        if lease.activator_session != self._listener:
            self._throttle.repeat_published()  # what was published before it listened is lost, and some change rarely
            self._listener = lease.activator_session
        self._lease = lease
        self._apply_lease()

    def _apply_lease(self) -> None:
        """Where messages are signed control lasts no longer than its station has granted."""
        lease = self._lease
        if lease is None:
            return
        until_ms, offboard_ms = lease.deadline_ms, lease.offboard_until_ms
        if self._channel.seal is not None:
            until_ms, offboard_ms = self._grants.bound(lease.holder_session, until_ms, offboard_ms)
        self.desk.epoch = lease.epoch
        self.desk.executor.lease_until_ms = until_ms
        self.desk.executor.offboard_until_ms = offboard_ms
        self.desk.executor.holder_session = lease.holder_session

    def _without_bundled(self, streamed: list[State]) -> list[State]:
        """Keep for the next bundle what is streamed no faster than bundles leave; the rest leaves alone."""
        if not self.settings.bundles:
            return streamed
        waiting = [state for state in streamed if self._streams.waits(state.name, self.settings.bundle_ms)]
        self._for_bundle |= {state.name: state for state in waiting}
        return [state for state in streamed if state not in waiting]

    def _publish_states(self, now_ms: int) -> list[Effect]:
        """What is due by policy or by a rate of its own, bundled if so set."""
        self._throttle.apart = self._streams.names
        current = (self._throttle.current(name) for name in self._streams.due(now_ms))
        alone = self._without_bundled([state for state in current if state is not None])
        out = [effect for state in alone for effect in self._publish_state(state, now_ms)]
        if self.settings.bundles:
            return out + self._publish_bundle(now_ms)
        return out + [effect for state in self._throttle.due(now_ms) for effect in self._publish_state(state, now_ms)]

    def _publish_bundle(self, now_ms: int) -> list[Effect]:
        """Once in a bundle's time, or when something urgent is due: everything that is due, in one message."""
        if now_ms < self._next_bundle_ms and not self._throttle.is_due(URGENT, now_ms):
            return []
        self._next_bundle_ms = next_turn_ms(self._next_bundle_ms, now_ms, self.settings.bundle_ms)
        due = {state.name: state for state in self._throttle.due(now_ms)}
        due |= {name: self._throttle.current(name) or state for name, state in self._for_bundle.items()}
        self._for_bundle.clear()
        told = [(state, self._publish_state(state, now_ms)) for state in due.values()]
        refused: list[Effect] = [effect for _, effects in told for effect in effects if isinstance(effect, Log)]
        together = [state for state, effects in told if not any(isinstance(effect, Log) for effect in effects)]
        if not together:
            return refused
        payload = encode(drone_bundle(together, stamp(now_ms)), self.settings.encoding)
        return [Publish(LINK, self.topics.states(self.drone), payload, qos=0), *refused]

    def _publish_state(self, state: State, now_ms: int) -> list[Effect]:
        if not self.born:
            return []
        try:
            payload = encode_state(StampedState(state, stamp(now_ms)), self.settings.encoding)
        except PayloadError as error:
            return [Log("autopilot_value", f"{state.name}: {error}")]
        return [Publish(LINK, self.topics.state(self.drone, state.name), payload, qos=0)]

    def _presence(self, up: bool) -> bytes:
        message = Presence(session=self.session, up=up)
        return self._channel.payload(self.topics.reachable(self.drone), message, with_certificate=up)

    def _publish_presence(self, up: bool) -> Publish:
        return Publish(LINK, self.topics.reachable(self.drone), self._presence(up), qos=1, retain=True)

    def _birth(self) -> Publish:
        return self._publish_presence(up=True)

    def _beacon(self, now_ms: int, nonce: int | None = None) -> Publish:
        self._next_beacon_ms = now_ms + self.settings.beacon_interval_ms
        held_ms = 0 if nonce is not None else None
        message = BeaconMessage(session=self.session, now_ms=now_ms, nonce=nonce, held_ms=held_ms)
        return self._channel.publish(self.topics.clock(self.drone), message, qos=0)


def _heartbeat(kind: int) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)
