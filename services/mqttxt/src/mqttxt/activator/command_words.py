"""The words that an activator says of commands, and the topics that it says them on."""

from __future__ import annotations

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Publish
from ..protocol.messages import BeaconMessage, CommandId, FogResultMessage, ResultMessage, RosterEntry, Word
from ..protocol.topics import CloudSide
from ..protocol.words import NO_DEADLINE
from ..security.cose import Envelope


class RelayWords:
    """One activator session's own words, and its way of passing on those of drones."""

    def __init__(self, session: int, channel: Channel, cloud: CloudSide) -> None:
        self._session = session
        self._channel = channel
        self._cloud = cloud

    def own_word(self, command_id: CommandId, word: Word, reason: str | None, now_ms: int) -> ResultMessage:
        return ResultMessage(
            gs_session=command_id.gs_session,
            seq=command_id.seq,
            session=self._session,
            relay_stamp=stamp(now_ms),
            stamp=stamp(now_ms),
            word=word,
            reason=reason,
            beacon=self.beacon(now_ms) if reason == NO_DEADLINE else None,
        )

    def fog_result(
        self, command_id: CommandId, now_ms: int, roster: tuple[RosterEntry, ...] | None, denied: str | None
    ) -> FogResultMessage:
        return FogResultMessage(
            gs_session=command_id.gs_session,
            seq=command_id.seq,
            session=self._session,
            stamp=stamp(now_ms),
            roster=roster,
            denied=denied,
            beacon=self.beacon(now_ms) if denied == NO_DEADLINE else None,
        )

    def beacon(self, now_ms: int) -> BeaconMessage:
        return BeaconMessage(session=self._session, now_ms=now_ms)

    def publish_result(self, drone: int, name: str, result: ResultMessage, signed: Envelope | None = None) -> Publish:
        """A word; one that its drone signed as it is, with what the relay says of it beside it (R12.11)."""
        topic = self._cloud.drone_result(drone, name)
        if signed is None:
            return self._channel.publish(topic, result)
        payload = signed.routed([result.relay_stamp, bool(result.settled)]).encode()
        return Publish(self._channel.link, topic, payload, self._channel.settings.qos)

    def publish_fog_result(self, name: str, result: FogResultMessage) -> Publish:
        return self._channel.publish(self._cloud.fog_result(name), result)
