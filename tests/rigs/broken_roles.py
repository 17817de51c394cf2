"""Starts a role of the project with one rule taken away: `python broken_roles.py VARIANT ROLE OPTIONS…`.

A ground station sends three commands, one after another, and a broadcast: `python broken_roles.py VARIANT gs CLOUD
FOG DRONE [IDENTITY [signed]]`; with `signed` it signs. The variant `none` takes nothing away.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mqttxt
from mqttxt.activator import psmi
from mqttxt.activator.command_relay import Relay
from mqttxt.activator.command_words import RelayWords
from mqttxt.activator.drones import Drones
from mqttxt.activator.leases import Leases
from mqttxt.activator.registrations import SignedRegistrations
from mqttxt.activator.sensor_relay import SensorRelay
from mqttxt.activator.signed_commands import SignedCommand
from mqttxt.activator.state_relay import StateRelay
from mqttxt.activator.stations import Stations
from mqttxt.activator.together import WordsTogether
from mqttxt.core import hearing
from mqttxt.core.bond import Bond
from mqttxt.core.channel import Channel
from mqttxt.core.clock import stamp
from mqttxt.core.effects import Publish
from mqttxt.core.ledger import Admission, Ledger
from mqttxt.core.mqtt.sn import address_proof, air_client, client, packets
from mqttxt.core.mqtt.sn.air import _ToBroker
from mqttxt.core.mqtt.sn.air_client import AirClient
from mqttxt.core.mqtt.sn.client import SnClient
from mqttxt.core.mqtt.sn.gateway import Gateway
from mqttxt.core.mqtt.sn.own_topics import OwnTopics
from mqttxt.core.mqtt.sn.sender import Receiver, Sender
from mqttxt.core.mqtt.sn.together import Unpacker
from mqttxt.core.session_owners import SessionOwners
from mqttxt.drone import bulk, command_writer, executor, interruptions, offboard, parameter_settings, published_states
from mqttxt.drone.acknowledgements import Acknowledgements
from mqttxt.drone.command_writer import CommandWriter
from mqttxt.drone.commands import CommandDesk
from mqttxt.drone.executor import Executor
from mqttxt.drone.grants import Grants
from mqttxt.drone.logs.reader import LogReader
from mqttxt.drone.mavlink import parameter_protocol, px4, signing
from mqttxt.drone.mavlink.boots import Boots
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.offboard import OffboardPilot
from mqttxt.drone.parameter_copy import ParameterCopy
from mqttxt.drone.parameter_settings import ParameterSettings
from mqttxt.drone.role import UavClient
from mqttxt.drone.runs import Phase
from mqttxt.drone.start_order import StartOrder
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import DroneRecord, Registration
from mqttxt.protocol.messages import CommandMessage, FogResultMessage, ResultMessage, Word
from mqttxt.protocol.states import Armed, FlightModeName, LandedState
from mqttxt.security.cose import Envelope
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal, Signed
from mqttxt.station.commands import StationCommands
from mqttxt.station.drone_words import DroneWords
from mqttxt.station.fog import FogView
from mqttxt.station.role import StationRole

Patch = Callable[[], None]


def wrap(cls: Any, name: str, make: Callable[[Any], Any]) -> None:
    """Replace a method by `make(original)`."""
    setattr(cls, name, make(getattr(cls, name)))


def uav_starts_late() -> None:
    def make(original: Any) -> Any:
        def on_command(self: Any, command: Any, retained: bool, now_ms: int) -> Any:
            if command.deadline_ms and command.deadline_ms < now_ms:
                command = replace(command, deadline_ms=now_ms + 3000)
            return original(self, command, retained, now_ms)

        return on_command

    wrap(CommandDesk, "_on_command", make)


def uav_takes_any_session() -> None:
    def make(original: Any) -> Any:
        def on_command(self: Any, command: Any, retained: bool, now_ms: int) -> Any:
            return original(self, replace(command, executor_session=self._session), retained, now_ms)

        return on_command

    wrap(CommandDesk, "_on_command", make)


def uav_executes_duplicates() -> None:
    def make(original: Any) -> Any:
        def examine(self: Any, command_id: Any, *more: Any) -> Any:
            verdict = original(self, command_id, *more)
            entry = self.get(command_id)
            last = entry.record.last if verdict is Admission.DUPLICATE else None
            if last is not None and last.word is Word.COMPLETED:
                del self._entries[command_id]
                return Admission.NEW
            return verdict

        return examine

    wrap(Ledger, "examine", make)


def uav_repeats_late() -> None:
    def make(original: Any) -> Any:
        def send(self: Any, run: Any, now_ms: int) -> Any:
            run.deadline_ms += 60_000
            return original(self, run, now_ms)

        return send

    wrap(CommandWriter, "_write", make)


def uav_forgets_the_order() -> None:
    def make(original: Any) -> Any:
        def refusal(self: Any, *arguments: Any) -> Any:
            self.order = StartOrder()
            return original(self, *arguments)

        return refusal

    wrap(CommandDesk, "_refusal", make)


def speaks_over_one() -> None:
    def make(original: Any) -> Any:
        return lambda self, effect: original(self, replace(effect, everywhere=False))

    wrap(Bond, "publish", make)


def uav_takes_retained() -> None:
    def make(original: Any) -> Any:
        return lambda self, command, retained, now_ms: original(self, command, False, now_ms)

    wrap(CommandDesk, "_on_command", make)


def uav_repeats_behind_a_pilot() -> None:
    command_writer.is_taken_over = lambda run, vehicle: False


def uav_takes_one_refusal_for_all() -> None:
    def make(original: Any) -> Any:
        def on_refusal(self: Any, run: Any, *more: Any) -> Any:
            run.acks = run.sends
            return original(self, run, *more)

        return on_refusal

    wrap(Acknowledgements, "_on_refusal", make)


def uav_arms_again() -> None:
    def make(original: Any) -> Any:
        def await_ack(self: Any, run: Any, now_ms: int) -> Any:
            run.has_shown = False
            return original(self, run, now_ms)

        return await_ack

    wrap(CommandWriter, "await_ack", make)


def uav_writes_behind_a_pilot() -> None:
    command_writer.is_overridden = lambda run, runs, vehicle: False


def uav_gives_modes_no_time() -> None:
    interruptions.MODE_GRACE_MS = 0


def uav_plans(**changed: Any) -> Patch:
    """Plans of commands with other fields."""

    def patch() -> None:
        def make(original: Any) -> Any:
            return lambda self, command, now_ms: replace(original(self, command, now_ms), **changed)

        wrap(CommandWriter, "plan", make)

    return patch


def uav_holds_in_its_own_name() -> None:
    command_writer.HALTING = (Source.COMPANION,)


def uav_lets_a_disarm_wait() -> None:
    command_writer.COMMANDING = (Source.COMPANION,)


def uav_holds_by_mode_alone() -> None:
    def make(original: Any) -> Any:
        return lambda self, vehicle, now_ms: self._mode(vehicle, FlightModeName.HOLD, px4.holds)

    wrap(px4.Px4, "_hold", make)


def uav_halts_by_heartbeats_alone() -> None:
    wrap(Vehicle, "is_heard", lambda original: lambda self, now_ms: self.is_alive(now_ms))


def uav_writes_what_is_flown_later() -> None:
    command_writer.check = lambda command, vehicle, now_ms: None


def uav_believes_a_restart() -> None:
    wrap(Boots, "on_message", lambda original: lambda self, *arguments: None)


def uav_goes_on_after_a_stall() -> None:
    wrap(Executor, "stood_still", lambda original: lambda self: None)


def uav_holds_against_a_pilot() -> None:
    def make(original: Any) -> Any:
        def observe_offboard(self: Any, run: Any, now_ms: int) -> Any:
            is_running = run.phase is Phase.RUNNING
            reason = executor.interrupted(run, self._runs, self.vehicle, now_ms) if is_running else None
            return self._pilot.stop(run, Word.FAILED, reason, now_ms) if reason is not None else []

        return observe_offboard

    wrap(Executor, "_observe_offboard", make)
    wrap(OffboardPilot, "_has_left", lambda original: lambda self, run: False)


def uav_holds_once() -> None:
    offboard.HOLD_AGAIN_MS = 60_000


def uav_leaves_in_offboard() -> None:
    wrap(OffboardPilot, "leave", lambda original: lambda self, now_ms: [])


def uav_says_nothing_anew() -> None:
    def make(original: Any) -> Any:
        return lambda self, lease, now_ms: original(self, replace(lease, anew=None), now_ms)

    wrap(UavClient, "_on_lease", make)


def uav_says_what_it_does_not_know() -> None:
    published_states.LOST_MS = 1_000_000_000


def does_not_ask_whether_it_is_heard() -> None:
    hearing.SILENT_MS = 1_000_000_000


def stays_deaf() -> None:
    hearing.ANSWER_MS = 1_000_000_000


def uav_writes_parameters_again() -> None:
    original = parameter_protocol.read

    def read(system: int, name: str, bytewise: bool, sends: int = parameter_protocol.SENDS) -> Any:
        found = yield from original(system, name, bytewise, sends)
        is_before = sends == parameter_protocol.FEW_SENDS
        return replace(found, value=found.value + 1) if is_before else found

    parameter_protocol.read = read


def uav_guards_no_parameter() -> None:
    parameter_settings.is_guarded = lambda name: False


def uav_sets_parameters_late() -> None:
    def make(original: Any) -> Any:
        def start(self: Any, command_id: Any, command: Any, deadline_ms: int, *more: Any) -> Any:
            return original(self, command_id, command, deadline_ms + 60_000, *more)

        return start

    wrap(ParameterSettings, "start", make)


def uav_gives_every_set_whole() -> None:
    wrap(ParameterCopy, "_packed", lambda original: lambda self, found, known: found.packed())


def uav_asks_for_logs_armed() -> None:
    wrap(LogReader, "_refusal", lambda original: lambda self, now_ms: None)


def uav_reads_logs_first() -> None:
    wrap(LogReader, "give_way", lambda original: lambda self, now_ms: [])


def uav_audits_no_words() -> None:
    def make(original: Any) -> Any:
        return lambda self, word, now_ms: replace(original(self, word, now_ms), event="said")

    wrap(CommandDesk, "_audited", make)


def uav_signs_for_another_link() -> None:
    signing.LINK_ID = 1


def uav_hears_what_is_not_signed() -> None:
    wrap(signing.Signing, "judge", lambda original: lambda self, message, now_s: message)


def uav_is_always_a_ground_station() -> None:
    wrap(UavClient, "is_controlled", lambda original: lambda self, now_ms: True)


def uav_verifies_nothing() -> None:
    def make(original: Any) -> Any:
        def verified(self: Any, envelope: Any, topic: Any, expected: Any) -> Any:
            try:
                return original(self, envelope, topic, expected)
            except PayloadError as error:
                if error.kind != "forged":
                    raise
                known = [each for certificates in self._known.values() for each in certificates if expected(each)]
                return Signed(known[0], envelope)

        return verified

    wrap(Seal, "verified", make)


def uav_takes_everybodys_session() -> None:
    for name in ("claim", "is_of"):
        wrap(SessionOwners, name, lambda original: lambda self, session, signer: True)


def uav_asks_for_no_right() -> None:
    wrap(Rights, "may_command", lambda original: lambda self, drone: True)


def uav_believes_the_route() -> None:
    def make(original: Any) -> Any:
        def tightened(self: Any, command: Any, route: Any) -> Any:
            return command if route is None else replace(command, deadline_ms=route)

        return tightened

    wrap(CommandDesk, "_tightened", make)


def uav_takes_anybodys_lease() -> None:
    def make(original: Any) -> Any:
        def opened(self: Any, message: Any, *more: Any) -> Any:
            try:
                return original(self, message, *more)
            except PayloadError:
                return Envelope.parse(message.payload).payload

        return opened

    wrap(Channel, "opened", make)


def uav_outlives_its_grant() -> None:
    wrap(Grants, "bound", lambda original: lambda self, station, session, *ends: ends)


def uav_goes_by_births_alone() -> None:
    wrap(SessionOwners, "restore", lambda original: lambda self, session, station: None)


def uav_signs_no_words() -> None:
    def make(original: Any) -> Any:
        def payload(self: Any, topic: str, message: Any, *more: Any, **how: Any) -> Any:
            return (
                encode(message) if isinstance(message, ResultMessage) else original(self, topic, message, *more, **how)
            )

        return payload

    wrap(Channel, "payload", make)


def uav_forgets_the_question() -> None:
    original = bulk._answered
    bulk._answered = lambda ask, answer: original(replace(ask, nonce=0), answer)


def activator_keeps_the_gate_open() -> None:
    def make(original: Any) -> Any:
        def changed(self: Any, *arguments: Any) -> None:
            original(self, *arguments)
            self.want_topics = self.want_topics or not self._leases

        return changed

    wrap(Leases, "__bool__", lambda original: lambda self: True)
    wrap(Leases, "__init__", make)
    wrap(Leases, "_look_at_forms", make)


def activator_audits_nobody() -> None:
    wrap(Relay, "_audited", lambda original: lambda self, *arguments: replace(original(self, *arguments), who=None))


def activator_forwards_the_deadline() -> None:
    def make(original: Any) -> Any:
        def publish(self: Any, entry: Any, leg: Any, remaining_ms: int) -> Any:
            if leg.sent.deadline_ms > 0:
                leg.sent = replace(leg.sent, deadline_ms=entry.record.deadline_ms)
            return original(self, entry, leg, remaining_ms)

        return publish

    wrap(Relay, "_publish_command", make)


def activator_says_two_last_words() -> None:
    def make(original: Any) -> Any:
        def on_result(self: Any, link: Any, payload: bytes, name: str, now_ms: int) -> Any:
            result = decode(ResultMessage, payload)
            entry = self._ledger.get(result.id)
            leg = entry.record.legs.get(link.number) if entry is not None else None
            if leg is not None and leg.is_closed and leg.words[-1].word is Word.COMPLETED:
                return [self._publish(link.number, name, replace(result, relay_stamp=stamp(now_ms)))]
            return original(self, link, payload, name, now_ms)

        return on_result

    wrap(RelayWords, "on_result", make)


def activator_copies_the_expiry() -> None:
    def make(original: Any) -> Any:
        return lambda self, *arguments: replace(original(self, *arguments), expiry_s=3600)

    wrap(Relay, "_publish_command", make)


def activator_stamps_on_arrival() -> None:
    def make(original: Any) -> Any:
        def relay(self: Any, link: Any, known: Any, now_ms: int, out: Any) -> Any:
            if link.said_ms(known, now_ms) is not None:
                known.said_ms = known.received_ms
            return original(self, link, known, now_ms, out)

        return relay

    wrap(StateRelay, "_relay", make)


def activator_answers_nothing_anew() -> None:
    wrap(Stations, "_show", lambda original: lambda self, what, now_ms: [])


def activator_obeys_everybody() -> None:
    wrap(Leases, "refusal", lambda original: lambda self, *arguments: None)


def activator_chooses_who_cannot_go() -> None:
    psmi.USED = tuple(state for state in psmi.USED if state not in (Armed, LandedState))
    value = psmi._value
    psmi._value = lambda link, cls: None if cls in (Armed, LandedState) else value(link, cls)


def activator_believes_every_puback() -> None:
    def make(original: Any) -> Any:
        def on_published(self: Any, carried: Any, code: int, now_ms: int) -> Any:
            self._safe.setdefault(carried.drone, []).append(carried.key)
            return []

        return on_published

    wrap(SensorRelay, "on_published", make)


def activator_forgets_the_route() -> None:
    wrap(SignedCommand, "for_drone", lambda original: lambda self, drone, deadline_ms: self.envelopes[drone].encode())


def activator_registers_whatever_is_signed() -> None:
    def make(original: Any) -> Any:
        def read(self: Any, topic: str, payload: bytes, leases: Any, now_ms: int) -> Any:
            return decode(Registration, Envelope.parse(payload).payload)

        return read

    wrap(SignedRegistrations, "read", make)


def activator_signs_no_records() -> None:
    def make(original: Any) -> Any:
        def payload(self: Any, topic: str, message: Any, *more: Any, **how: Any) -> Any:
            return encode(message) if isinstance(message, DroneRecord) else original(self, topic, message, *more, **how)

        return payload

    wrap(Channel, "payload", make)


def activator_believes_every_will() -> None:
    def make(original: Any) -> Any:
        def on_presence(self: Any, number: int, presence: Any, *more: Any) -> Any:
            return original(self, number, replace(presence, several=None), *more)

        return on_presence

    wrap(Drones, "on_presence", make)


def activator_names_no_holder() -> None:
    def make(original: Any) -> Any:
        return lambda self, link, lease: original(self, link, replace(lease, holder=None))

    wrap(Drones, "_publish_lease", make)


def activator_signs_drones_words() -> None:
    def make(original: Any) -> Any:
        return lambda self, drone, name, result, signed=None: original(self, drone, name, result)

    wrap(RelayWords, "_publish", make)


def gs_counts_nothing() -> None:
    def make(original: Any) -> Any:
        def addressed(self: Any, *arguments: Any) -> Any:
            self._seq = 0
            return original(self, *arguments)

        return addressed

    wrap(StationCommands, "_addressed", make)


def gs_retains_commands() -> None:
    def make(original: Any) -> Any:
        def pend(self: Any, *arguments: Any) -> Any:
            pending = original(self, *arguments)
            pending.publish = replace(pending.publish, retain=True)
            return pending

        return pend

    wrap(StationCommands, "_pend", make)


def gs_never_renews() -> None:
    def make(original: Any) -> Any:
        def tick(self: Any, now_ms: int) -> Any:
            self._next_registration_ms = now_ms + 1000
            return original(self, now_ms)

        return tick

    wrap(FogView, "tick", make)


def gs_gives_more_time() -> None:
    def make(original: Any) -> Any:
        def addressed(self: Any, *arguments: Any) -> Any:
            fields = original(self, *arguments)
            return fields | {"deadline_ms": fields["deadline_ms"] + 200}

        return addressed

    wrap(StationCommands, "_addressed", make)


def gs_refreshes_what_it_sends_again() -> None:
    def make(original: Any) -> Any:
        def tick_one(self: Any, *arguments: Any) -> Any:
            found = original(self, *arguments)
            for index, effect in enumerate(found):
                if isinstance(effect, Publish):
                    again = decode(CommandMessage, effect.payload)
                    again = replace(again, deadline_ms=again.deadline_ms + 5000)
                    found[index] = replace(effect, payload=encode(again))
            return found

        return tick_one

    wrap(StationCommands, "_tick_one", make)


def gs_is_never_anew() -> None:
    def make(original: Any) -> Any:
        def registration(self: Any, *args: Any, **how: Any) -> Any:
            publish = original(self, *args, **how)
            return replace(publish, payload=encode(replace(decode(Registration, publish.payload), anew=None)))

        return registration

    wrap(FogView, "registration", make)


def gs_leaves_its_lease() -> None:
    wrap(StationRole, "goodbye", lambda original: lambda self, now_ms: original(self, now_ms)[-1:])


def gs_believes_anybody() -> None:
    def make(original: Any) -> Any:
        def believed(self: Any, fog: Any, topic: Any, message: Any) -> Any:
            try:
                payload = Envelope.parse(message.payload).payload
            except PayloadError:
                payload = message.payload
            return decode(ResultMessage, payload), f"drone{topic.drone}"

        return believed

    wrap(DroneWords, "result", make)


def gs_reads_no_words_together() -> None:
    def make(original: Any) -> Any:
        def on_fog_result(self: Any, fog: Any, topic: Any, message: Any, now_ms: int) -> Any:
            if decode(FogResultMessage, message.payload).words is not None:
                return []
            return original(self, fog, topic, message, now_ms)

        return on_fog_result

    wrap(StationRole, "_on_fog_result", make)


def activator_loses_a_word() -> None:
    def make(original: Any) -> Any:
        def flush(self: Any, now_ms: int) -> Any:
            self._waiting = self._waiting[-1:]
            return original(self, now_ms)

        return flush

    wrap(WordsTogether, "flush", make)


def activator_forgets_the_roster() -> None:
    def make(original: Any) -> Any:
        def flush(self: Any, now_ms: int) -> Any:
            self._roster = None if self._waiting else self._roster
            return original(self, now_ms)

        return flush

    wrap(WordsTogether, "flush", make)


def gs_counts_no_registrations() -> None:
    def make(original: Any) -> Any:
        def registration(self: Any, *arguments: Any, **more: Any) -> Any:
            self._counter = 1
            return original(self, *arguments, **more)

        return registration

    wrap(FogView, "registration", make)


def gs_grants_too_much() -> None:
    def make(original: Any) -> Any:
        def grant(self: Any, drone: Any, clock: Any, now_ms: int) -> Any:
            return original(self, drone, clock, now_ms + 60_000)

        return grant

    wrap(FogView, "_grant", make)


def takes_any_reading() -> None:
    def make(original: Any) -> Any:
        def opened_reading(self: Any, payload: bytes, *more: Any) -> bytes:
            try:
                return Envelope.parse(payload).payload
            except PayloadError:
                return payload

        return opened_reading

    wrap(Channel, "opened_reading", make)


def takes_repetitions() -> None:
    def make(original: Any) -> Any:
        def is_new(self: Any, msg_id: int) -> bool:
            return original(self, msg_id) or self.is_last(msg_id)

        return is_new

    wrap(Receiver, "is_new", make)


def marks_no_repetition() -> None:
    original = packets.encode
    packets.encode = lambda packet: original(replace(packet, dup=False) if hasattr(packet, "dup") else packet)


def skips_message_ids() -> None:
    wrap(Sender, "_next_id", lambda original: lambda self: (original(self), original(self))[1])


def uav_greets_without_a_will() -> None:
    def make(original: Any) -> Any:
        return lambda self, client_id, will, *more: original(self, client_id, None, *more)

    wrap(SnClient, "__init__", make)


def uav_subscribes_to_what_is_kept() -> None:
    def make(original: Any) -> Any:
        return lambda self, effect, *more: original(self, replace(effect, live_only=False), *more)

    wrap(SnClient, "subscribe", make)


def uav_repeats_states_at_once() -> None:
    client.CONFIRM_S = 0.2


def uav_waits_for_a_word() -> None:
    client.QUIET_S = 60.0


def uav_takes_every_puback() -> None:
    client._in_mqtt_5 = lambda done, code: done(0)


def forgets_pieces() -> None:
    def make(original: Any) -> Any:
        def take(self: Any, piece: bytes) -> Any:
            self._came = b""
            return original(self, piece)

        return take

    wrap(Unpacker, "take", make)


def gateway_reflects() -> None:
    address_proof.REFLECTED = 1_000_000


def gateway_serves_every_topic() -> None:
    wrap(AirClient, "_may", lambda original: lambda self, rule, topic, now_s: True)


def gateway_passes_every_list() -> None:
    wrap(AirClient, "_refusal", lambda original: lambda self, told, now_s: None)


def gateway_lets_newcomers_in() -> None:
    def make(original: Any) -> Any:
        def on_connect(self: Any, packet: Any, *more: Any) -> Any:
            rivals = [known for known in self._at.values() if known.client_id == packet.client_id]
            for rival in rivals:
                rival.stage, ours = air_client.Stage.GONE, rival.stage
            answer = original(self, packet, *more)
            for rival in rivals:
                rival.stage = ours
            return answer

        return on_connect

    wrap(Gateway, "_on_connect", make)


def gateway_keeps_the_will() -> None:
    def make(original: Any) -> Any:
        return lambda self, client_id, will: original(self, client_id, None)

    wrap(_ToBroker, "open", make)


def gateway_says_nothing_to_strangers() -> None:
    def make(original: Any) -> Any:
        def received(self: Any, datagram: bytes, address: Any, now_s: float) -> Any:
            if address in self._at or isinstance(packets.decode(datagram), packets.Connect):
                return original(self, datagram, address, now_s)
            return None

        return received

    wrap(Gateway, "received", make)


def gateway_knows_no_names() -> None:
    wrap(OwnTopics, "register", lambda original: lambda self, topic: None)


def gateway_tells_one_by_one() -> None:
    wrap(Sender, "_is_single", lambda original: lambda self, told: self._fits_alone(told))


VARIANTS: dict[str, Patch] = {
    "air-uav-greets-without-a-will": uav_greets_without_a_will,
    "air-uav-subscribes-to-what-is-kept": uav_subscribes_to_what_is_kept,
    "air-uav-marks-no-repetition": marks_no_repetition,
    "air-uav-takes-repetitions": takes_repetitions,
    "air-uav-forgets-pieces": forgets_pieces,
    "air-uav-takes-every-puback": uav_takes_every_puback,
    "air-uav-waits-for-a-word": uav_waits_for_a_word,
    "air-uav-repeats-states-at-once": uav_repeats_states_at_once,
    "air-uav-skips-message-ids": skips_message_ids,
    "air-activator-marks-no-repetition": marks_no_repetition,
    "air-activator-takes-repetitions": takes_repetitions,
    "air-activator-knows-no-names": gateway_knows_no_names,
    "air-activator-serves-every-topic": gateway_serves_every_topic,
    "air-activator-passes-every-list": gateway_passes_every_list,
    "air-activator-keeps-the-will": gateway_keeps_the_will,
    "air-activator-lets-newcomers-in": gateway_lets_newcomers_in,
    "air-activator-says-nothing-to-strangers": gateway_says_nothing_to_strangers,
    "air-activator-reflects": gateway_reflects,
    "air-activator-tells-one-by-one": gateway_tells_one_by_one,
    "uav-starts-late": uav_starts_late,
    "uav-takes-any-session": uav_takes_any_session,
    "uav-executes-duplicates": uav_executes_duplicates,
    "uav-repeats-late": uav_repeats_late,
    "uav-forgets-the-order": uav_forgets_the_order,
    "uav-speaks-over-one": speaks_over_one,
    "activator-speaks-over-one": speaks_over_one,
    "activator-believes-every-will": activator_believes_every_will,
    "uav-executes-each-copy": uav_executes_duplicates,
    "uav-takes-retained": uav_takes_retained,
    "uav-repeats-behind-a-pilot": uav_repeats_behind_a_pilot,
    "uav-takes-one-refusal-for-all": uav_takes_one_refusal_for_all,
    "uav-arms-again": uav_arms_again,
    "uav-writes-behind-a-pilot": uav_writes_behind_a_pilot,
    "uav-gives-modes-no-time": uav_gives_modes_no_time,
    "uav-takes-any-hold-for-a-climbs-end": uav_plans(near=None),
    "uav-arms-in-any-mode": uav_plans(first_mode=None),
    "uav-holds-in-its-own-name": uav_holds_in_its_own_name,
    "uav-lets-a-disarm-wait": uav_lets_a_disarm_wait,
    "uav-holds-by-mode-alone": uav_holds_by_mode_alone,
    "uav-halts-by-heartbeats-alone": uav_halts_by_heartbeats_alone,
    "uav-writes-what-is-flown-later": uav_writes_what_is_flown_later,
    "uav-believes-a-restart": uav_believes_a_restart,
    "uav-goes-on-after-a-stall": uav_goes_on_after_a_stall,
    "uav-holds-against-a-pilot": uav_holds_against_a_pilot,
    "uav-holds-once": uav_holds_once,
    "uav-leaves-in-offboard": uav_leaves_in_offboard,
    "uav-says-nothing-anew": uav_says_nothing_anew,
    "uav-says-what-it-does-not-know": uav_says_what_it_does_not_know,
    "uav-does-not-ask-whether-it-is-heard": does_not_ask_whether_it_is_heard,
    "gs-does-not-ask-whether-it-is-heard": does_not_ask_whether_it_is_heard,
    "uav-stays-deaf": stays_deaf,
    "activator-stays-deaf": stays_deaf,
    "activator-audits-nobody": activator_audits_nobody,
    "uav-writes-parameters-again": uav_writes_parameters_again,
    "uav-guards-no-parameter": uav_guards_no_parameter,
    "uav-sets-parameters-late": uav_sets_parameters_late,
    "uav-gives-every-set-whole": uav_gives_every_set_whole,
    "uav-asks-for-logs-armed": uav_asks_for_logs_armed,
    "uav-reads-logs-first": uav_reads_logs_first,
    "uav-audits-no-words": uav_audits_no_words,
    "uav-signs-for-another-link": uav_signs_for_another_link,
    "uav-hears-what-is-not-signed": uav_hears_what_is_not_signed,
    "uav-is-always-a-ground-station": uav_is_always_a_ground_station,
    "uav-verifies-nothing": uav_verifies_nothing,
    "uav-takes-everybodys-session": uav_takes_everybodys_session,
    "uav-asks-for-no-right": uav_asks_for_no_right,
    "uav-believes-the-route": uav_believes_the_route,
    "uav-takes-anybodys-lease": uav_takes_anybodys_lease,
    "uav-outlives-its-grant": uav_outlives_its_grant,
    "uav-signs-no-words": uav_signs_no_words,
    "uav-forgets-the-question": uav_forgets_the_question,
    "uav-goes-by-births-alone": uav_goes_by_births_alone,
    "activator-keeps-the-gate-open": activator_keeps_the_gate_open,
    "activator-forwards-the-deadline": activator_forwards_the_deadline,
    "activator-says-two-last-words": activator_says_two_last_words,
    "activator-copies-the-expiry": activator_copies_the_expiry,
    "activator-stamps-on-arrival": activator_stamps_on_arrival,
    "activator-answers-nothing-anew": activator_answers_nothing_anew,
    "activator-loses-a-word": activator_loses_a_word,
    "activator-forgets-the-roster": activator_forgets_the_roster,
    "activator-obeys-everybody": activator_obeys_everybody,
    "activator-chooses-who-cannot-go": activator_chooses_who_cannot_go,
    "activator-believes-every-puback": activator_believes_every_puback,
    "activator-forgets-the-route": activator_forgets_the_route,
    "activator-registers-whatever-is-signed": activator_registers_whatever_is_signed,
    "activator-signs-no-records": activator_signs_no_records,
    "activator-signs-drones-words": activator_signs_drones_words,
    "activator-takes-any-reading": takes_any_reading,
    "activator-names-no-holder": activator_names_no_holder,
    "gs-counts-nothing": gs_counts_nothing,
    "gs-retains-commands": gs_retains_commands,
    "gs-never-renews": gs_never_renews,
    "gs-gives-more-time": gs_gives_more_time,
    "gs-refreshes-what-it-sends-again": gs_refreshes_what_it_sends_again,
    "gs-is-never-anew": gs_is_never_anew,
    "gs-leaves-its-lease": gs_leaves_its_lease,
    "gs-believes-anybody": gs_believes_anybody,
    "gs-reads-no-words-together": gs_reads_no_words_together,
    "gs-counts-no-registrations": gs_counts_no_registrations,
    "gs-grants-too-much": gs_grants_too_much,
    "gs-takes-any-reading": takes_any_reading,
}


async def send_three(cloud: str, fog: int, drone: int, identity: str | None = None, signed: str = "") -> None:
    """Run a ground station that sends three commands and a broadcast."""
    signing = {"signed": bool(signed), "signed_readings": bool(signed)}
    async with mqttxt.GroundStation(cloud, identity=identity, bundles=True, **signing) as station:
        for command in (mqttxt.Arm(), mqttxt.Hold(), mqttxt.Disarm()):
            (there,) = await station.connect([fog], timeout_s=60)
            await there.drone(drone).send(command)
        (there,) = await station.connect([fog], timeout_s=30)
        await there.broadcast(mqttxt.Hold())


if __name__ == "__main__":
    from mqttxt.cli import main

    variant = sys.argv.pop(1)
    if variant != "none":
        VARIANTS[variant]()
    if sys.argv[1] == "gs":
        asyncio.run(send_three(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), *sys.argv[5:]))
    else:
        main()
