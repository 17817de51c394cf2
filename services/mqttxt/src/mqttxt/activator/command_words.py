"""The words that an activator says of commands, and the topics that it says them on."""

from __future__ import annotations

from ..core.clock import stamp
from ..core.effects import Publish
from ..core.settings import Settings
from ..protocol.codec import encode
from ..protocol.messages import BeaconMessage, CommandId, FogResultMessage, ResultMessage, RosterEntry, Word
from ..protocol.topics import CloudSide
from ..protocol.words import NO_DEADLINE
from .drones import CLOUD


class RelayWords:
    """One activator session's own words, and its way of passing on those of drones."""

    def __init__(self, session: int, settings: Settings, cloud: CloudSide) -> None:
        self._session = session
        self._settings = settings
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

    def publish_result(self, drone: int, name: str, result: ResultMessage) -> Publish:
        topic = self._cloud.drone_result(drone, name)
        return Publish(CLOUD, topic, encode(result, self._settings.encoding), self._settings.qos)

    def publish_fog_result(self, name: str, result: FogResultMessage) -> Publish:
        topic = self._cloud.fog_result(name)
        return Publish(CLOUD, topic, encode(result, self._settings.encoding), self._settings.qos)
