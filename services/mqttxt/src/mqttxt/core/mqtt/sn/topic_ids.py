"""The predefined topic ids of the air leg, known to both ends, and how each topic travels there (R20.3, R20.4).

The id of a drone's topic has the drone's number in its upper byte, and a number from `_OF_NAME` in its lower byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

from ....errors import PayloadError
from ....protocol.commands import COMMANDS
from ....protocol.names import MAX_DRONE
from ....protocol.states import STATES, AutopilotText
from ....protocol.topic_table import FOG_NODES, FOG_SIDE, UAV
from ....protocol.topics import REVOKED, DroneTopic, FogSide

TOGETHER = 1
"""Not a topic: the stream of messages that are sent together, or in pieces (`together`)."""
_REVOKED = 2
_RESULTS = 64
_MALFORMED = "malformed"
_OTHERS = (
    "reachable", "clock", "init_connect", "stations", "control",
    "states", "commands", "bulk", "bulk_answer", "sensor_ack",
)  # fmt: skip
_OF_NAME = {
    **{f"state/{name}": code for code, name in enumerate(STATES, start=1)},
    f"commands_result/{_MALFORMED}": _RESULTS,
    **{f"commands_result/{name}": _RESULTS + code for code, name in enumerate(COMMANDS, start=1)},
    **{name: 128 + number for number, name in enumerate(_OTHERS)},
}
"""The lower byte of the id, by the part of the topic after `droneY/`."""
_NAME_OF = {low: name for name, low in _OF_NAME.items()}


def _kinds(is_sender: bool) -> frozenset[str]:
    """The kinds of topics (`DroneTopic.kind`) that a UAV client publishes or receives, its own retained too (R9.1)."""
    rows = [row for row in FOG_SIDE if row.topic != REVOKED]
    said = {row for row in rows if row.sender in (UAV, FOG_NODES)}
    found = said if is_sender else {row for row in rows if row.receiver in (UAV, FOG_NODES) or row.retained}
    return frozenset(row.topic.split("/")[1].removesuffix("S") for row in found)


_SAID, _HEARD = _kinds(True), _kinds(False)


class Travel(Enum):
    """How messages travel (R20.4): at QoS 0; at QoS 0 and, unless a newer one follows, again at QoS 1; at QoS 1."""

    ONCE = 0
    NEWEST = 1
    SURELY = 2


@dataclass(frozen=True)
class TopicIds:
    """The fog side's topics below `root`, and their ids on the air leg."""

    root: str = ""

    def id_of(self, topic: str) -> int | None:
        """The predefined id of a topic; None if it has none."""
        below = topic.removeprefix(self.root)
        if self.is_list(topic):
            return _REVOKED
        level, _, name = below.partition("/")
        low = _OF_NAME.get(name)
        if low is None or self.drone_of(topic) is None:
            return None
        return int(level.removeprefix("drone")) << 8 | low

    def topic_of(self, topic_id: int) -> str | None:
        """The topic of a predefined id; None for an unknown id."""
        if topic_id == _REVOKED:
            return self.root + REVOKED
        drone, name = topic_id >> 8, _NAME_OF.get(topic_id & 0xFF)
        return None if name is None or not 1 <= drone <= MAX_DRONE else f"{self.root}drone{drone}/{name}"

    def travel(self, topic: str) -> Travel:
        """How a topic's messages travel."""
        found = self._parsed(topic)
        if found is None:
            return Travel.SURELY
        if found.kind == "state":
            return Travel.SURELY if found.name == AutopilotText.name else Travel.NEWEST
        return Travel.ONCE if found.kind in ("bulk", "bulk_answer") else Travel.SURELY

    def drone_of(self, topic: str) -> int | None:
        """The drone of a topic; None for the revocation list, and for a topic that this side does not have."""
        found = self._parsed(topic)
        return found.drone if found is not None else None

    def is_list(self, topic: str) -> bool:
        """Whether it is the topic of the revocation list, to which every node subscribes."""
        return topic == self.root + REVOKED

    def is_birth(self, topic: str) -> bool:
        """Whether it is the topic of a drone's births and wills, to which the drone itself subscribes too."""
        found = self._parsed(topic)
        return found is not None and found.kind == "reachable"

    def may_retain(self, topic: str) -> bool:
        """Whether messages of a topic may be retained; there are others without end, and a broker would keep all."""
        return self.is_list(topic) or self.is_birth(topic)

    def may_say(self, drone: int | None, topic: str) -> bool:
        """Whether a UAV client of `drone` may publish on a topic."""
        return self._may(_SAID, drone, topic)

    def may_hear(self, drone: int | None, topic: str) -> bool:
        """Whether a UAV client of `drone` may subscribe to a topic; filters with wildcards are not allowed."""
        return self._may(_HEARD, drone, topic)

    def _may(self, kinds: frozenset[str], drone: int | None, topic: str) -> bool:
        if self.is_list(topic):
            return True
        found = self._parsed(topic)
        return found is not None and found.drone == drone and found.kind in kinds

    def _parsed(self, topic: str) -> DroneTopic | None:
        try:
            return _parsed(self.root, topic)
        except PayloadError:
            return None


@lru_cache(maxsize=8192)
def _parsed(root: str, topic: str) -> DroneTopic | None:
    """Parse a topic; only valid ones are cached. Raises PayloadError."""
    return FogSide(root).parse(topic)
