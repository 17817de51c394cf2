"""The signatures of a station's commands: one for each drone, with a deadline in that drone's clock (protocol, 12)."""

from __future__ import annotations

from dataclasses import replace

from ..errors import ConfigurationError, FogUnreachable, PayloadError
from ..protocol.codec import encode
from ..protocol.commands import Command
from ..protocol.messages import CommandMessage
from ..protocol.topics import FogSide
from ..protocol.values import Encoding
from ..security.addressed import Addressed
from ..security.cose import Envelope
from ..security.seal import Seal
from .drone_view import DroneView
from .fog import FogView


class CommandSigner:
    """Signs the commands of one ground station."""

    def __init__(self, seal: Seal, encoding: Encoding) -> None:
        self._seal = seal
        self._encoding = encoding

    def check_right(self, drone: int, command: Command) -> None:
        """Raises ConfigurationError where the station's certificate does not allow a command."""
        right = self._seal.certificate.rights.missing(command, drone)
        if right is not None:
            raise ConfigurationError(
                f"drone {drone}: {self._seal.name}'s certificate has no {right}; {command.name} was not sent"
            )

    def check(self, fog: FogView, drone: int, command: Command) -> None:
        """Raises ConfigurationError for a missing right, FogUnreachable while the drone's clock is not known."""
        self.check_right(drone, command)
        view = fog.drones.get(drone)
        if view is None or view.signing_clock is None:
            raise FogUnreachable(f"fog {fog.number}: no signed beacon of drone {drone}; {command.name} was not sent")

    def sign(
        self,
        fog: FogView,
        drone: int | None,
        message: CommandMessage,
        ttl_ms: int,
        now_ms: int,
        reservation: int | None = None,
    ) -> Addressed:
        """Sign a command for a drone, or with None for each whose clock is known; raises FogUnreachable for none."""
        views = fog.drones.values() if drone is None else [fog.drones[drone]]
        rights = self._seal.certificate.rights
        entries = {
            view.number: envelope
            for view in views
            if rights.may_command(view.number)
            for envelope in [self._for_drone(view, message, ttl_ms, now_ms)]
            if envelope is not None
        }
        if not entries:
            raise FogUnreachable(f"fog {fog.number}: no signed beacon of a drone; {message.command.name} was not sent")
        return Addressed(message.executor_session, message.deadline_ms or 0, entries, reservation)

    def sign_again(self, topic: str, payload: bytes) -> bytes:
        """Sign anew, with the newest key, a command, an offer or a release that an older key signed."""
        try:
            addressed = Addressed.parse(payload)
        except PayloadError:  # an offer or a release, which no drone gets
            return self._seal.sign(topic, Envelope.parse(payload).payload).encode()
        topics = FogSide()
        entries = {
            drone: self._seal.sign(topics.commands(drone), signed.payload)
            for drone, signed in addressed.entries.items()
        }
        return replace(addressed, entries=entries).encode()

    def _for_drone(self, view: DroneView, message: CommandMessage, ttl_ms: int, now_ms: int) -> Envelope | None:
        """A command signed for one drone, with its session and a deadline in its clock; None without that clock."""
        clock = view.signing_clock
        deadline_ms = clock.deadline_ms(now_ms, ttl_ms) if clock is not None else None
        if clock is None or deadline_ms is None:
            return None
        own = replace(message, executor_session=clock.session, deadline_ms=max(0, deadline_ms))
        return self._seal.sign(FogSide().commands(view.number), encode(own, self._encoding))
