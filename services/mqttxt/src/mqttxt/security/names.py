"""The names of nodes in certificates: `fog1`, `drone3`, `gs-ops`, `sensor2`, `broker-cloud`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, MAX_FOG, MAX_SENSOR

_STATION, _BROKER = "gs-", "broker-"
_LABEL = r"[A-Za-z0-9_.-]{1,%d}"
_LONGEST = 64
"""The longest common name (RFC 5280, ub-common-name)."""
_GRAMMAR = re.compile(
    r"(?P<kind>fog|drone|sensor)(?P<number>[1-9][0-9]{0,8})"
    f"|{_STATION}(?P<station>{_LABEL % (_LONGEST - len(_STATION))})"
    f"|{_BROKER}(?P<broker>{_LABEL % (_LONGEST - len(_BROKER))})"
)
NAME_EXPECTED = "expected fogX, droneY (Y at most 250), gs-NAME (NAME at most 61 characters), sensorS or broker-WHERE"


class Kind(StrEnum):
    """The kind of a node."""

    FOG = "fog"
    DRONE = "drone"
    STATION = "station"
    SENSOR = "sensor"
    BROKER = "broker"


_MOST = {Kind.DRONE: MAX_DRONE, Kind.SENSOR: MAX_SENSOR, Kind.FOG: MAX_FOG}


@dataclass(frozen=True)
class NodeName:
    """A node's name: its kind with a number (fog, drone, sensor), or with a label (station, broker)."""

    kind: Kind
    number: int = 0
    label: str = ""

    @classmethod
    def parse(cls, text: str) -> NodeName:
        """Parse a node's name; raises ConfigurationError if `text` is none."""
        found = _GRAMMAR.fullmatch(text)
        if found is None:
            raise ConfigurationError(f"node name {text[:80]!r}: {NAME_EXPECTED}")
        if found["station"] is not None:
            return cls(Kind.STATION, label=found["station"])
        if found["broker"] is not None:
            return cls(Kind.BROKER, label=found["broker"])
        name = cls(Kind(found["kind"]), int(found["number"]))
        if name.number > _MOST[name.kind]:
            raise ConfigurationError(f"node name {text!r}: {NAME_EXPECTED}")
        return name

    def __str__(self) -> str:
        if self.kind is Kind.STATION:
            return _STATION + self.label
        if self.kind is Kind.BROKER:
            return _BROKER + self.label
        return f"{self.kind}{self.number}"
