"""The activator's choice of a drone for a command on `fogX/commands/C`, and its reservations (protocol, section 7).

The next drone is tried only after a definite no. After silence, `failed` or `unconfirmed` the first may be flying.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..core.clock import stamp
from ..core.effects import Effect, Inbound
from ..core.ledger import Entry
from ..errors import PayloadError
from ..protocol.commands import Goto
from ..protocol.messages import CommandId, Word
from ..protocol.rankings import Candidate, PsmiMessage, SelectMessage, SelectMode
from ..protocol.topics import FogTopic
from ..protocol.words import CERTIFICATE_EXPIRED, PASSED_OVER
from .command_relay import CommandRelay
from .drones import Drones
from .legs import CHOSEN, Job, Leg, busy_drones
from .part import Part, Site
from .psmi import rank
from .signed_commands import SelectContents
from .together import WordsTogether

CANCELLED = "cancelled"
LONGEST_HOLD_MS = 60_000
MOST_RESERVATIONS = 256


@dataclass
class Choice:
    """A command for which a drone is being chosen: the list, and the index of the next drone.

    `is_said`: the list was published, and names `chosen`. `tried` are the drones of the earlier offers from which this
    one goes on (R7.7). `is_sending`: `Selector._try_next` waits for the relay's answer.
    """

    listed: tuple[Candidate, ...]
    left_out: tuple[Candidate, ...]
    next_index: int = 0
    is_sending: bool = False
    tried: frozenset[int] = frozenset()
    chosen: int | None = None
    is_said: bool = False


@dataclass
class Reservation:
    """A drone that is reserved by an offer, for its station's commit."""

    drone: int
    command: Goto
    until_ms: int


class Selector(Part):
    """The choices of one activator session."""

    def __init__(self, site: Site, drones: Drones, relay: CommandRelay, together: WordsTogether) -> None:
        super().__init__(site)
        self._drones = drones
        self._relay = relay
        self._together = together
        self._choices: dict[CommandId, Choice] = {}
        self._reservations: dict[CommandId, Reservation] = {}
        relay.words.on_last_word = self._on_last_word

    def on_select(self, topic: FogTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A message on `fogX/commands/C`.

        Where messages are signed, raises PayloadError before anything is answered or entered.
        """
        read = self._relay.signed.select if self._relay.signed is not None else _unsigned
        contents = read(self._to_cloud.signed_topic(message.topic), message.payload)
        try:
            wanted, signed = contents.read()
            if wanted.command.name != topic.name or not isinstance(wanted.command, Goto):
                raise PayloadError(f"command {wanted.command.name}: expected {topic.name}, as the topic says")
        except PayloadError as error:
            return self._relay.on_malformed(CHOSEN, replace(message, payload=contents.payload), error, now_ms)
        key = (wanted.mode, wanted.reservation, wanted.command)
        entry, out = self._relay.enter(wanted.as_command(), CHOSEN, key, message.retain, now_ms, signed, wanted)
        if entry is None:
            return out
        if contents.is_expired and wanted.mode is not SelectMode.RELEASE:
            return [*out, *self._relay.refuse(entry, CERTIFICATE_EXPIRED, now_ms)]
        return [*out, *self._proceed(entry, wanted, wanted.command, now_ms)]

    def _proceed(self, entry: Entry[Job], wanted: SelectMessage, command: Goto, now_ms: int) -> list[Effect]:
        if entry.record.query and wanted.mode in (SelectMode.SELECT, SelectMode.COMMIT):
            return self._ask_everyone(entry, now_ms)
        if self._relay.ledger.may_have_forgotten(entry.id):
            return self._close(entry, now_ms)
        if now_ms >= entry.record.deadline_ms:
            return self._relay.refuse(entry, Word.EXPIRED.label, now_ms)
        if wanted.mode is SelectMode.RELEASE:
            return self._release(entry, wanted, now_ms)
        if wanted.mode is SelectMode.COMMIT:
            return self._commit(entry, wanted, now_ms)
        return self._choose(entry, wanted, command, now_ms)

    def tick(self, now_ms: int) -> None:
        """End lapsed reservations, and forget the lists of forgotten commands."""
        for key in [key for key, held in self._reservations.items() if now_ms > held.until_ms]:
            del self._reservations[key]
        for key in [key for key in self._choices if self._relay.ledger.get(key) is None]:
            del self._choices[key]

    def _choose(self, entry: Entry[Job], wanted: SelectMessage, command: Goto, now_ms: int) -> list[Effect]:
        if self._is_overridden(entry.id):
            return self._relay.refuse(entry, CANCELLED, now_ms)
        tried: frozenset[int] = frozenset()
        if wanted.mode is SelectMode.OFFER and wanted.reservation is not None:
            before = self._choices.get(CommandId(wanted.gs_session, wanted.reservation))
            if before is None or not before.is_said:
                return self._relay.refuse(entry, "no_reservation", now_ms)
            tried = before.tried | {before.chosen or 0}
        listed, left_out = self._rank(wanted, command, tried, now_ms)
        choice = self._choices[entry.id] = Choice(listed, left_out, tried=tried)
        if not listed:
            reasons = "; ".join(f"drone {candidate.drone} {candidate.reason}" for candidate in left_out)
            out = self._say(entry, choice, None, None, now_ms)
            return out + self._relay.refuse(entry, f"none_eligible: {reasons or 'no drones'}"[:200], now_ms)
        if wanted.mode is SelectMode.OFFER:
            return self._reserve(entry, choice, wanted, command, now_ms)
        return self._try_next(entry, choice, now_ms)

    def _rank(
        self, wanted: SelectMessage, command: Goto, tried: frozenset[int], now_ms: int
    ) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...]]:
        return rank(
            command,
            self._drones.links.values(),
            leases=self._leases,
            gs_session=wanted.gs_session,
            epoch=wanted.epoch,
            busy=self._busy(),
            tried=tried,
            stale_ms=self._to_cloud.settings.state_limit_ms,
            now_ms=now_ms,
        )

    def _reserve(
        self, entry: Entry[Job], choice: Choice, wanted: SelectMessage, command: Goto, now_ms: int
    ) -> list[Effect]:
        if len(self._reservations) >= MOST_RESERVATIONS:
            return self._relay.refuse(entry, "too_many_reservations", now_ms)
        drone = choice.listed[0].drone
        until_ms = now_ms + min(round(wanted.limit_s * 1000), LONGEST_HOLD_MS)
        self._reservations[entry.id] = Reservation(drone, command, until_ms)
        self._relay.ledger.close(entry, now_ms)
        return self._say(entry, choice, drone, until_ms, now_ms)

    def _commit(self, entry: Entry[Job], wanted: SelectMessage, now_ms: int) -> list[Effect]:
        held = self._reservations.pop(CommandId(wanted.gs_session, wanted.reservation or 0), None)
        if self._is_overridden(entry.id):
            return self._relay.refuse(entry, CANCELLED, now_ms)
        if held is None or now_ms > held.until_ms:
            return self._relay.refuse(entry, "no_reservation", now_ms)
        if held.command != wanted.command:
            return self._relay.refuse(entry, "other_than_reserved", now_ms)
        offered = self._choices.get(CommandId(wanted.gs_session, wanted.reservation or 0))
        listed = tuple(c for c in offered.listed if c.drone == held.drone) if offered is not None else ()
        choice = self._choices[entry.id] = Choice(listed or (Candidate(drone=held.drone),), ())
        return self._try_next(entry, choice, now_ms)

    def _release(self, entry: Entry[Job], wanted: SelectMessage, now_ms: int) -> list[Effect]:
        self._reservations.pop(CommandId(wanted.gs_session, wanted.reservation or 0), None)
        return self._close(entry, now_ms)

    def _try_next(self, entry: Entry[Job], choice: Choice, now_ms: int) -> list[Effect]:
        """Send the command to the next drone; those that the relay refuses at once are passed over.

        A loop: all 250 may be refused, after a takeover for example, and as many calls in each other are too deep.
        """
        entry.record.choosing = choice.is_sending = True
        out: list[Effect] = []
        end: list[Effect] | None = None
        while end is None:
            drone = choice.listed[choice.next_index].drone
            choice.next_index += 1
            out += self._say(entry, choice, drone, None, now_ms)
            out += self._relay.forward(entry, drone, now_ms)
            leg = entry.record.legs[drone]
            end = self._end(entry, choice, leg, now_ms) if leg.is_closed else []
        choice.is_sending = False
        return out + end

    def _on_last_word(self, entry: Entry[Job], leg: Leg, now_ms: int) -> list[Effect]:
        """A chosen drone has sent its last word: after a definite no, and only then, try the next."""
        choice = self._choices.get(entry.id)
        if choice is None:
            return self._on_answer(entry, now_ms)
        if choice.is_sending:
            return []
        self._leave_out_busy(choice)
        end = self._end(entry, choice, leg, now_ms)
        return self._try_next(entry, choice, now_ms) if end is None else end

    def _leave_out_busy(self, choice: Choice) -> None:
        """Leave out drones that are another command's or another offer's since the list was made (R7.6)."""
        busy, rest = self._busy(), choice.listed[choice.next_index :]
        free = tuple(candidate for candidate in rest if candidate.drone not in busy)
        taken = [replace(candidate, reason="busy") for candidate in rest if candidate.drone in busy]
        choice.listed = choice.listed[: choice.next_index] + free
        choice.left_out = tuple(sorted([*choice.left_out, *taken], key=lambda candidate: candidate.drone))

    def _busy(self) -> set[int]:
        """The drones that are flying a command, or are reserved."""
        reserved = {held.drone for held in self._reservations.values()}
        return reserved | busy_drones(self._relay.ledger.open_entries())

    def _end(self, entry: Entry[Job], choice: Choice, leg: Leg, now_ms: int) -> list[Effect] | None:
        """End a choice after a drone's last word; None if the next drone is to be tried."""
        if leg.words[-1].word not in PASSED_OVER:
            return self._close(entry, now_ms)
        if self._is_overridden(entry.id):
            return self._relay.refuse(entry, CANCELLED, now_ms)
        if now_ms >= entry.record.deadline_ms:
            return self._relay.refuse(entry, Word.EXPIRED.label, now_ms)
        if choice.next_index >= len(choice.listed):
            return self._relay.refuse(entry, "none_left", now_ms)
        return None

    def _ask_everyone(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """Send a query to every drone: an earlier session of this activator may have sent the command to any (R7.8).

        A signed command can only have gone to the drones that it is signed for.
        """
        signed = entry.record.signed
        asked = [listed.drone for listed in self._drones.asked()]
        drones = [drone for drone in asked if signed is None or drone in signed.envelopes]
        if not drones:
            return self._nobody_has_it(entry, now_ms)
        entry.record.choosing = True
        return [effect for drone in drones for effect in self._relay.forward(entry, drone, now_ms)]

    def _on_answer(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """A drone's last word on a query: once all have answered, close the command, or deny it if no drone has it."""
        legs = entry.record.legs.values()
        if not all(leg.is_closed for leg in legs):
            return []
        if all(leg.words[-1].word in PASSED_OVER for leg in legs):
            return self._nobody_has_it(entry, now_ms)
        return self._close(entry, now_ms)

    def _nobody_has_it(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """No known drone has the command: denied only if the broker has shown the records of all drones (R7.8)."""
        if self._drones.were_shown:
            return self._relay.refuse(entry, Word.EXPIRED.label, now_ms)
        return self._close(entry, now_ms)

    def _close(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """Say nothing more of a choice as a whole."""
        entry.record.choosing = False
        self._relay.ledger.close(entry, now_ms)
        return []

    def _is_overridden(self, command_id: CommandId) -> bool:
        """Whether a later hold, land or return of the same station has come: no drone, or no other one, is sent."""
        return self._relay.later_holds.overrides_choice(command_id.gs_session, command_id.seq)

    def _say(
        self, entry: Entry[Job], choice: Choice, chosen: int | None, hold_until_ms: int | None, now_ms: int
    ) -> list[Effect]:
        message = PsmiMessage(
            gs_session=entry.id.gs_session,
            seq=entry.id.seq,
            session=self._session,
            stamp=stamp(now_ms),
            listed=choice.listed,
            left_out=choice.left_out,
            chosen=chosen,
            hold_until_ms=hold_until_ms,
        )
        choice.chosen, choice.is_said = chosen, True
        entry.record.listed = self._to_cloud.publish(self._cloud.psmi, message)
        return [*self._together.flush(now_ms), entry.record.listed]


def _unsigned(topic: str, payload: bytes) -> SelectContents:
    return SelectContents(payload)
