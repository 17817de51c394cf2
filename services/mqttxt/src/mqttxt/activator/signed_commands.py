"""Commands signed by ground stations: one envelope per drone, due in the drone's clock (protocol, section 12)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from ..core.ledger import OVERRIDING
from ..core.session_owners import SessionOwners
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.commands import Command
from ..protocol.identify import identify
from ..protocol.messages import CommandHead, CommandMessage
from ..protocol.rankings import SelectMessage, SelectMode
from ..protocol.topics import FogSide
from ..protocol.words import CERTIFICATE_EXPIRED, NOT_ALLOWED, NOT_SIGNED
from ..security.addressed import Addressed
from ..security.certificate import Certificate
from ..security.cose import Envelope
from ..security.seal import Seal, Signed


@dataclass(frozen=True)
class SignedCommand:
    """A command that a station has signed: an envelope for each drone, and its deadline in that drone's clock, ms."""

    signer: Certificate
    is_expired: bool
    envelopes: dict[int, Envelope]
    deadlines_ms: dict[int, int]

    def signed_again(self, again: SignedCommand | None) -> SignedCommand:
        """Replace envelopes by those of a repetition with the same payload: the older key may be revoked by now."""
        newer = again.envelopes.items() if again is not None else ()
        return replace(
            self,
            envelopes=self.envelopes
            | {
                drone: one
                for drone, one in newer
                if drone in self.envelopes and one.payload == self.envelopes[drone].payload
            },
        )

    def refusal(self, command: Command, drone: int, is_query: bool) -> str | None:
        """Why a drone is not sent the command: not signed for it, not allowed, or certificate ended; None if it is.

        A query's certificate does not count: the one by which the command was sent may have been another.
        """
        missing = self.signer.rights.missing(command, drone)
        if not is_query and missing is not None:
            return f"{NOT_ALLOWED}, {missing}"
        if not is_query and self.is_expired and not isinstance(command, OVERRIDING):
            return CERTIFICATE_EXPIRED
        return None if drone in self.envelopes else NOT_SIGNED

    def for_drone(self, drone: int, deadline_ms: int) -> bytes:
        """The drone's envelope; `deadline_ms` is its route if it is earlier than the signed deadline (R12.8)."""
        is_earlier = deadline_ms < self.deadlines_ms[drone]
        return self.envelopes[drone].routed(deadline_ms if is_earlier else None).encode()


@dataclass(frozen=True)
class Verified:
    """A command with valid signatures of one station, for at least one drone."""

    addressed: Addressed
    entries: dict[int, Signed]

    @property
    def payload(self) -> bytes:
        """The signed payload of the first drone."""
        return next(iter(self.entries.values())).payload

    def read(self) -> tuple[CommandMessage, SignedCommand]:
        """The command, due at the activator, and its signed forms; raises PayloadError.

        An entry of a broadcast that differs from the first is left out, as if it were not signed.
        """
        commands = {drone: decode(CommandMessage, signed.payload) for drone, signed in self.entries.items()}
        first = _without_address(next(iter(commands.values())))
        same = {drone: command for drone, command in commands.items() if _without_address(command) == first}
        due = replace(first, executor_session=self.addressed.executor_session, deadline_ms=self.addressed.deadline_ms)
        return due, SignedCommand(
            next(iter(self.entries.values())).certificate,
            any(signed.is_expired for signed in self.entries.values()),
            {drone: self.entries[drone].envelope.bare() for drone in same},
            {drone: command.deadline_ms or 0 for drone, command in same.items()},
        )


@dataclass(frozen=True)
class SelectContents:
    """A signed message on `fogX/commands/C`; with a `commit` it is a command that is signed for one drone.

    `is_expired`: the station's certificate has ended; false for a commit, whose `SignedCommand` has that.
    """

    payload: bytes
    commit: Verified | None = None
    is_expired: bool = False

    def read(self) -> tuple[SelectMessage, SignedCommand | None]:
        """The message, and for a commit the command that is signed for its drone; raises PayloadError."""
        if self.commit is None:
            return decode(SelectMessage, self.payload), None
        command, signed = self.commit.read()
        head = {field.name: getattr(command, field.name) for field in fields(CommandHead)}
        reservation = self.commit.addressed.reservation
        return SelectMessage(**head, mode=SelectMode.COMMIT, reservation=reservation, command=command.command), signed


class SignedCommands:
    """Verifies the commands of stations to one activator session."""

    def __init__(self, seal: Seal, owners: SessionOwners) -> None:
        self._seal = seal
        self._owners = owners
        self._topics = FogSide()

    def verified(self, drone: int | None, payload: bytes) -> Verified:
        """Verify a command for one drone, or a broadcast (None); raises PayloadError if it must be dropped (R12.9)."""
        addressed = Addressed.parse(payload)
        if drone is not None and list(addressed.entries) != [drone]:
            raise PayloadError(f"signed for drones {list(addressed.entries)}: expected {drone} alone", "not_signed")
        entries: dict[int, Signed] = {}
        refusal: PayloadError | None = None
        for number, envelope in addressed.entries.items():
            try:
                signed = self._opened(number, envelope)
            except PayloadError as error:
                refusal = refusal or error
                continue
            if all(signed.signer == other.signer for other in entries.values()):
                entries[number] = signed
        if not entries:
            raise refusal or PayloadError("broadcast: expected a drone that it is signed for", "not_signed")
        return Verified(addressed, entries)

    def select(self, topic: str, payload: bytes) -> SelectContents:
        """Verify an offer, a release or a commit; raises PayloadError if it must be dropped (R12.9)."""
        try:
            envelope = Envelope.parse(payload)
        except PayloadError:
            commit = self.verified(None, payload)
            if commit.addressed.reservation is None or len(commit.entries) != 1:
                raise
            return SelectContents(commit.payload, commit)
        signed = self._of_own_session(self._seal.open_of_station(topic, envelope))
        contents = SelectContents(signed.payload, is_expired=signed.is_expired)
        if decode(SelectMessage, signed.payload).mode in (SelectMode.SELECT, SelectMode.COMMIT):
            raise PayloadError("select: expected an offer or a release, or a command that is signed", "not_signed")
        return contents

    def _opened(self, drone: int, envelope: Envelope) -> Signed:
        return self._of_own_session(self._seal.open_of_station(self._topics.commands(drone), envelope))

    def _of_own_session(self, signed: Signed) -> Signed:
        known = identify(signed.payload)
        if known is None or not self._owners.is_of(known.gs_session, signed.signer):
            raise PayloadError(f"command of {signed.signer}: expected a session of its own", "foreign_session")
        return signed


def _without_address(command: CommandMessage) -> CommandMessage:
    return replace(command, executor_session=0, deadline_ms=None)
