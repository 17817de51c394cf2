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
from mqttxt.activator.command_relay import CommandRelay
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
from mqttxt.core.mqtt.sn import address_proof, air_client, client, codec, packets
from mqttxt.core.mqtt.sn.air import _ToBroker
from mqttxt.core.mqtt.sn.air_client import AirClient
from mqttxt.core.mqtt.sn.client import SnClient
from mqttxt.core.mqtt.sn.gateway import AirGateway
from mqttxt.core.mqtt.sn.own_topics import OwnTopics
from mqttxt.core.mqtt.sn.sender import Receiver, Sender
from mqttxt.core.mqtt.sn.together import Unpacker
from mqttxt.core.overriding import LaterHolds
from mqttxt.core.session_owners import SessionOwners
from mqttxt.drone import bulk, command_writer, executor, interruptions, offboard, parameter_settings, published_states
from mqttxt.drone.acknowledgements import Acknowledgements
from mqttxt.drone.answers import Answers
from mqttxt.drone.command_writer import CommandWriter
from mqttxt.drone.commands import CommandDesk
from mqttxt.drone.executor import Executor
from mqttxt.drone.grants import Grants
from mqttxt.drone.holder import Holder
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
Replacement = Callable[..., Any]
VARIANTS: dict[str, Patch] = {}
"""What takes a rule away, by the variant's name."""


def replaced(owner: Any, name: str, by: Replacement) -> Patch:
    """Puts `by` in the place of a method or a function, which it gets as its first argument."""

    def patch() -> None:
        original = getattr(owner, name)
        setattr(owner, name, lambda *given, **named: by(original, *given, **named))

    return patch


def variant(owner: Any, name: str, *others: str) -> Callable[[Replacement], Replacement]:
    """A function that takes a method's place is a variant, called as the function is, with dashes, and as `others`."""

    def register(by: Replacement) -> Replacement:
        for called in (by.__name__.replace("_", "-"), *others):
            VARIANTS[called] = replaced(owner, name, by)
        return by

    return register


def with_values(module: Any, **values: Any) -> Patch:
    """Gives names of a module other values."""
    return lambda: vars(module).update(values)


def both(*patches: Patch) -> Patch:
    def patch() -> None:
        for each in patches:
            each()

    return patch


def unsigned(cls: type) -> Patch:
    """Messages of a class leave without a signature."""

    def payload(original: Any, self: Any, topic: str, message: Any, *more: Any, **how: Any) -> Any:
        return encode(message) if isinstance(message, cls) else original(self, topic, message, *more, **how)

    return replaced(Channel, "payload", payload)


def planned(**changed: Any) -> Patch:
    """Plans of commands have other fields."""
    return replaced(
        CommandWriter,
        "plan",
        lambda original, self, command, now_ms: replace(original(self, command, now_ms), **changed),
    )


@variant(CommandDesk, "_on_command")
def uav_starts_late(original: Any, self: Any, command: Any, retained: bool, now_ms: int) -> Any:
    if command.deadline_ms and command.deadline_ms < now_ms:
        command = replace(command, deadline_ms=now_ms + 3000)
    return original(self, command, retained, now_ms)


@variant(CommandDesk, "_on_command")
def uav_takes_any_session(original: Any, self: Any, command: Any, *more: Any) -> Any:
    return original(self, replace(command, executor_session=self._session), *more)


@variant(CommandDesk, "_on_command")
def uav_takes_retained(original: Any, self: Any, command: Any, retained: bool, now_ms: int) -> Any:
    return original(self, command, False, now_ms)


@variant(Ledger, "examine", "uav-executes-each-copy")
def uav_executes_duplicates(original: Any, self: Any, command_id: Any, *more: Any) -> Any:
    verdict = original(self, command_id, *more)
    entry = self.get(command_id)
    last = entry.record.last if verdict is Admission.DUPLICATE else None
    if last is not None and last.word is Word.COMPLETED:
        del self._entries[command_id]
        return Admission.NEW
    return verdict


@variant(CommandWriter, "_write")
def uav_repeats_late(original: Any, self: Any, run: Any, now_ms: int) -> Any:
    run.deadline_ms += 60_000
    return original(self, run, now_ms)


@variant(CommandDesk, "_refusal")
def uav_forgets_the_order(original: Any, self: Any, *arguments: Any) -> Any:
    self.order = StartOrder()
    return original(self, *arguments)


@variant(Holder, "_has_replaced")
def uav_obeys_everybody(original: Any, self: Any, gs_session: int, epoch: int, activator: int | None) -> Any:
    return epoch < self.epoch


@variant(CommandDesk, "_has_control")
def uav_writes_for_a_former_holder(original: Any, self: Any, command_id: Any) -> bool:
    return True


@variant(Bond, "publish", "activator-speaks-over-one")
def uav_speaks_over_one(original: Any, self: Any, effect: Any) -> Any:
    return original(self, replace(effect, everywhere=False))


@variant(Acknowledgements, "_on_refusal")
def uav_takes_one_refusal_for_all(original: Any, self: Any, run: Any, *more: Any) -> Any:
    run.acks = run.sends
    return original(self, run, *more)


@variant(CommandWriter, "await_ack")
def uav_arms_again(original: Any, self: Any, run: Any, now_ms: int) -> Any:
    run.has_shown = False
    return original(self, run, now_ms)


@variant(px4.Px4, "_hold")
def uav_holds_by_mode_alone(original: Any, self: Any, vehicle: Any, now_ms: int) -> Any:
    return self._mode(vehicle, FlightModeName.HOLD, px4.holds)


def observe_offboard(original: Any, self: Any, run: Any, now_ms: int) -> Any:
    is_running = run.phase is Phase.RUNNING
    reason = executor.interrupted(run, self._runs, self.vehicle, now_ms) if is_running else None
    return self._pilot.stop(run, Word.FAILED, reason, now_ms) if reason is not None else []


@variant(UavClient, "_on_lease")
def uav_says_nothing_anew(original: Any, self: Any, lease: Any, now_ms: int) -> Any:
    return original(self, replace(lease, anew=None), now_ms)


@variant(parameter_protocol, "read")
def uav_writes_parameters_again(
    original: Any, system: int, name: str, bytewise: bool, sends: int = parameter_protocol.SENDS
) -> Any:
    found = yield from original(system, name, bytewise, sends)
    is_before = sends == parameter_protocol.FEW_SENDS
    return replace(found, value=found.value + 1) if is_before else found


@variant(ParameterSettings, "start")
def uav_sets_parameters_late(
    original: Any, self: Any, command_id: Any, command: Any, deadline_ms: int, *more: Any
) -> Any:
    return original(self, command_id, command, deadline_ms + 60_000, *more)


@variant(Answers, "_audited")
def uav_audits_no_words(original: Any, self: Any, word: Any, now_ms: int) -> Any:
    return replace(original(self, word, now_ms), event="said")


@variant(Seal, "verified")
def uav_verifies_nothing(original: Any, self: Any, envelope: Any, topic: Any, expected: Any) -> Any:
    try:
        return original(self, envelope, topic, expected)
    except PayloadError as error:
        if error.kind != "forged":
            raise
        known = [each for certificates in self._known.values() for each in certificates if expected(each)]
        return Signed(known[0], envelope)


@variant(CommandDesk, "_tightened")
def uav_believes_the_route(original: Any, self: Any, command: Any, route: Any) -> Any:
    return command if route is None else replace(command, deadline_ms=route)


@variant(Channel, "opened")
def uav_takes_anybodys_lease(original: Any, self: Any, message: Any, *more: Any) -> Any:
    try:
        return original(self, message, *more)
    except PayloadError:
        return Envelope.parse(message.payload).payload


@variant(bulk, "_answered")
def uav_forgets_the_question(original: Any, ask: Any, answer: Any) -> Any:
    return original(replace(ask, nonce=0), answer)


def topics_stay_wanted(original: Any, self: Any, *arguments: Any) -> None:
    original(self, *arguments)
    self.want_topics = self.want_topics or not self._leases


@variant(CommandRelay, "_audited")
def activator_audits_nobody(original: Any, self: Any, *arguments: Any) -> Any:
    return replace(original(self, *arguments), who=None)


@variant(CommandRelay, "_publish_command")
def activator_forwards_the_deadline(original: Any, self: Any, entry: Any, leg: Any, remaining_ms: int) -> Any:
    if leg.sent.deadline_ms > 0:
        leg.sent = replace(leg.sent, deadline_ms=entry.record.deadline_ms)
    return original(self, entry, leg, remaining_ms)


@variant(CommandRelay, "_publish_command")
def activator_believes_every_epoch(original: Any, self: Any, entry: Any, leg: Any, remaining_ms: int) -> Any:
    leg.sent = replace(leg.sent, epoch=entry.record.message.epoch)
    return original(self, entry, leg, remaining_ms)


@variant(CommandRelay, "_publish_command")
def activator_copies_the_expiry(original: Any, self: Any, *arguments: Any) -> Any:
    return replace(original(self, *arguments), expiry_s=3600)


@variant(RelayWords, "on_result")
def activator_says_two_last_words(original: Any, self: Any, link: Any, payload: bytes, name: str, now_ms: int) -> Any:
    result = decode(ResultMessage, payload)
    entry = self._ledger.get(result.id)
    leg = entry.record.legs.get(link.number) if entry is not None else None
    if leg is not None and leg.is_closed and leg.words[-1].word is Word.COMPLETED:
        return [self._publish(link.number, name, replace(result, relay_stamp=stamp(now_ms)))]
    return original(self, link, payload, name, now_ms)


@variant(StateRelay, "_relay")
def activator_stamps_on_arrival(original: Any, self: Any, link: Any, known: Any, now_ms: int, out: Any) -> Any:
    if link.said_ms(known, now_ms) is not None:
        known.said_ms = known.received_ms
    return original(self, link, known, now_ms, out)


def unless_of_flight(original: Any, link: Any, cls: Any) -> Any:
    return None if cls in (Armed, LandedState) else original(link, cls)


@variant(SensorRelay, "on_published")
def activator_believes_every_puback(original: Any, self: Any, carried: Any, code: int, now_ms: int) -> Any:
    self._safe.setdefault(carried.drone, []).append(carried.key)
    return []


@variant(SignedCommand, "for_drone")
def activator_forgets_the_route(original: Any, self: Any, drone: int, deadline_ms: int) -> Any:
    return self.envelopes[drone].encode()


@variant(SignedRegistrations, "read")
def activator_registers_whatever_is_signed(
    original: Any, self: Any, topic: str, payload: bytes, leases: Any, now_ms: int
) -> Any:
    return decode(Registration, Envelope.parse(payload).payload)


@variant(Drones, "on_presence")
def activator_believes_every_will(original: Any, self: Any, number: int, presence: Any, *more: Any) -> Any:
    return original(self, number, replace(presence, several=None), *more)


@variant(Drones, "_publish_lease")
def activator_names_no_holder(original: Any, self: Any, link: Any, lease: Any) -> Any:
    return original(self, link, replace(lease, holder=None))


@variant(RelayWords, "may_ask")
def activator_asks_all_at_once(original: Any, self: Any, *arguments: Any) -> bool:
    return True


@variant(RelayWords, "_publish")
def activator_signs_drones_words(
    original: Any, self: Any, drone: Any, name: Any, result: Any, signed: Any = None
) -> Any:
    return original(self, drone, name, result)


@variant(WordsTogether, "flush")
def activator_loses_a_word(original: Any, self: Any, now_ms: int) -> Any:
    self._waiting = self._waiting[-1:]
    return original(self, now_ms)


@variant(WordsTogether, "flush")
def activator_forgets_the_roster(original: Any, self: Any, now_ms: int) -> Any:
    self._roster = None if self._waiting else self._roster
    return original(self, now_ms)


@variant(StationCommands, "_addressed")
def gs_counts_nothing(original: Any, self: Any, *arguments: Any) -> Any:
    self._seq = 0
    return original(self, *arguments)


@variant(StationCommands, "_addressed")
def gs_gives_more_time(original: Any, self: Any, *arguments: Any) -> Any:
    fields = original(self, *arguments)
    return fields | {"deadline_ms": fields["deadline_ms"] + 200}


@variant(StationCommands, "_pend")
def gs_retains_commands(original: Any, self: Any, *arguments: Any) -> Any:
    pending = original(self, *arguments)
    pending.publish = replace(pending.publish, retain=True)
    return pending


@variant(FogView, "tick")
def gs_never_renews(original: Any, self: Any, now_ms: int) -> Any:
    self._next_registration_ms = now_ms + 1000
    return original(self, now_ms)


@variant(StationCommands, "_tick_one")
def gs_refreshes_what_it_sends_again(original: Any, self: Any, *arguments: Any) -> Any:
    found = original(self, *arguments)
    for index, effect in enumerate(found):
        if isinstance(effect, Publish):
            again = decode(CommandMessage, effect.payload)
            again = replace(again, deadline_ms=again.deadline_ms + 5000)
            found[index] = replace(effect, payload=encode(again))
    return found


@variant(FogView, "registration")
def gs_is_never_anew(original: Any, self: Any, *arguments: Any, **how: Any) -> Any:
    publish = original(self, *arguments, **how)
    return replace(publish, payload=encode(replace(decode(Registration, publish.payload), anew=None)))


@variant(FogView, "registration")
def gs_counts_no_registrations(original: Any, self: Any, *arguments: Any, **how: Any) -> Any:
    self._counter = 1
    return original(self, *arguments, **how)


@variant(FogView, "_grant")
def gs_grants_too_much(original: Any, self: Any, drone: Any, clock: Any, now_ms: int) -> Any:
    return original(self, drone, clock, now_ms + 60_000)


@variant(StationRole, "goodbye")
def gs_leaves_its_lease(original: Any, self: Any, now_ms: int) -> Any:
    return original(self, now_ms)[-1:]


@variant(DroneWords, "result")
def gs_believes_anybody(original: Any, self: Any, fog: Any, topic: Any, message: Any) -> Any:
    return decode(ResultMessage, without_signature(message.payload)), f"drone{topic.drone}"


@variant(StationRole, "_on_fog_result")
def gs_reads_no_words_together(original: Any, self: Any, fog: Any, topic: Any, message: Any, now_ms: int) -> Any:
    if decode(FogResultMessage, message.payload).words is not None:
        return []
    return original(self, fog, topic, message, now_ms)


@variant(Channel, "opened_reading", "activator-takes-any-reading")
def gs_takes_any_reading(original: Any, self: Any, payload: bytes, *more: Any) -> bytes:
    return without_signature(payload)


def without_signature(payload: bytes) -> bytes:
    """What a payload carries, whoever signed it, if anybody."""
    try:
        return Envelope.parse(payload).payload
    except PayloadError:
        return payload


@variant(Receiver, "is_new", "air-activator-takes-repetitions")
def air_uav_takes_repetitions(original: Any, self: Any, msg_id: int) -> bool:
    return original(self, msg_id) or self.is_last(msg_id)


@variant(codec, "encode", "air-activator-marks-no-repetition")
def air_uav_marks_no_repetition(original: Any, packet: Any) -> bytes:
    return original(replace(packet, dup=False) if hasattr(packet, "dup") else packet)


@variant(Sender, "_next_id")
def air_uav_skips_message_ids(original: Any, self: Any) -> int:
    original(self)
    return original(self)


@variant(SnClient, "__init__")
def air_uav_greets_without_a_will(original: Any, self: Any, client_id: str, will: Any, *more: Any) -> None:
    original(self, client_id, None, *more)


@variant(SnClient, "subscribe")
def air_uav_subscribes_to_what_is_kept(original: Any, self: Any, effect: Any, *more: Any) -> Any:
    return original(self, replace(effect, live_only=False), *more)


@variant(Unpacker, "take")
def air_uav_forgets_pieces(original: Any, self: Any, piece: bytes) -> Any:
    self._came = b""
    return original(self, piece)


@variant(AirGateway, "_on_connect")
def air_activator_lets_newcomers_in(original: Any, self: Any, packet: Any, *more: Any) -> Any:
    rivals = [known for known in self._at.values() if known.client_id == packet.client_id]
    for rival in rivals:
        rival.stage, ours = air_client.Stage.GONE, rival.stage
    answer = original(self, packet, *more)
    for rival in rivals:
        rival.stage = ours
    return answer


@variant(_ToBroker, "open")
def air_activator_keeps_the_will(original: Any, self: Any, client_id: str, will: Any) -> Any:
    return original(self, client_id, None)


@variant(AirGateway, "received")
def air_activator_says_nothing_to_strangers(
    original: Any, self: Any, datagram: bytes, address: Any, now_s: float
) -> Any:
    if address in self._at or isinstance(codec.decode(datagram), packets.Connect):
        return original(self, datagram, address, now_s)
    return None


VARIANTS |= {
    "uav-repeats-behind-a-pilot": with_values(command_writer, is_taken_over=lambda run, vehicle: False),
    "uav-writes-behind-a-pilot": with_values(command_writer, is_overridden=lambda run, runs, vehicle: False),
    "uav-gives-modes-no-time": with_values(interruptions, MODE_GRACE_MS=0),
    "uav-takes-any-hold-for-a-climbs-end": planned(near=None),
    "uav-arms-in-any-mode": planned(first_mode=None),
    "uav-holds-in-its-own-name": with_values(command_writer, HALTING=(Source.COMPANION,)),
    "uav-lets-a-disarm-wait": with_values(command_writer, COMMANDING=(Source.COMPANION,)),
    "uav-halts-by-heartbeats-alone": replaced(Vehicle, "is_heard", lambda _, self, now_ms: self.is_alive(now_ms)),
    "uav-writes-what-is-flown-later": with_values(command_writer, check=lambda command, vehicle, now_ms: None),
    "uav-believes-a-restart": replaced(Boots, "on_message", lambda _, self, *arguments: None),
    "uav-goes-on-after-a-stall": replaced(Executor, "stood_still", lambda _, self: None),
    "uav-holds-against-a-pilot": both(
        replaced(Executor, "_observe_offboard", observe_offboard),
        replaced(OffboardPilot, "_has_left", lambda _, self, run: False),
    ),
    "uav-holds-once": with_values(offboard, HOLD_AGAIN_MS=60_000),
    "uav-leaves-in-offboard": replaced(OffboardPilot, "leave", lambda _, self, now_ms: []),
    "uav-says-what-it-does-not-know": with_values(published_states, LOST_MS=1_000_000_000),
    "uav-does-not-ask-whether-it-is-heard": with_values(hearing, SILENT_MS=1_000_000_000),
    "gs-does-not-ask-whether-it-is-heard": with_values(hearing, SILENT_MS=1_000_000_000),
    "uav-stays-deaf": with_values(hearing, ANSWER_MS=1_000_000_000),
    "activator-stays-deaf": with_values(hearing, ANSWER_MS=1_000_000_000),
    "uav-guards-no-parameter": with_values(parameter_settings, is_guarded=lambda name: False),
    "uav-gives-every-set-whole": replaced(ParameterCopy, "_packed", lambda _, self, found, known: found.packed()),
    "uav-asks-for-logs-armed": replaced(LogReader, "_refusal", lambda _, self, now_ms: None),
    "uav-reads-logs-first": replaced(LogReader, "give_way", lambda _, self, now_ms: []),
    "uav-signs-for-another-link": with_values(signing, LINK_ID=1),
    "uav-hears-what-is-not-signed": replaced(signing.Signing, "judge", lambda _, self, message, now_s: message),
    "uav-is-always-a-ground-station": replaced(UavClient, "is_controlled", lambda _, self, now_ms: True),
    "uav-takes-everybodys-session": both(
        *(replaced(SessionOwners, name, lambda _, self, session, signer: True) for name in ("claim", "is_of"))
    ),
    "uav-asks-for-no-right": replaced(Rights, "may_command", lambda _, self, drone: True),
    "uav-outlives-its-grant": replaced(Grants, "bound", lambda _, self, station, session, *ends: ends),
    "uav-signs-no-words": unsigned(ResultMessage),
    "uav-goes-by-births-alone": replaced(SessionOwners, "restore", lambda _, self, session, station: None),
    "activator-keeps-the-gate-open": both(
        replaced(Leases, "__bool__", lambda _, self: True),
        *(replaced(Leases, name, topics_stay_wanted) for name in ("__init__", "_look_at_forms")),
    ),
    "activator-answers-nothing-anew": replaced(Stations, "_show", lambda _, self, what, now_ms: []),
    "activator-obeys-everybody": replaced(Leases, "refusal", lambda _, self, *arguments: None),
    "activator-chooses-who-cannot-go": both(
        with_values(psmi, USED=tuple(state for state in psmi.USED if state not in (Armed, LandedState))),
        replaced(psmi, "_value", unless_of_flight),
    ),
    "activator-chooses-behind-a-hold": replaced(LaterHolds, "overrides_choice", lambda _, self, sender, seq: False),
    "activator-signs-no-records": unsigned(DroneRecord),
    "air-uav-takes-every-puback": with_values(client, _in_mqtt_5=lambda done, code: done(0)),
    "air-uav-waits-for-a-word": with_values(client, QUIET_S=60.0),
    "air-uav-repeats-states-at-once": with_values(client, CONFIRM_S=0.2),
    "air-activator-knows-no-names": replaced(OwnTopics, "register", lambda _, self, topic: None),
    "air-activator-serves-every-topic": replaced(AirClient, "_may", lambda _, self, rule, topic, now_s: True),
    "air-activator-passes-every-list": replaced(AirClient, "_refusal", lambda _, self, told, now_s: None),
    "air-activator-reflects": with_values(address_proof, REFLECTED=1_000_000),
    "air-activator-tells-one-by-one": replaced(Sender, "_is_single", lambda _, self, told: self._fits_alone(told)),
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
