"""What differs between kinds of autopilots, behind one interface; each kind has a package of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot
from .dynamics import Energy
from .fleet import DroneConfig
from .logs import LogLink
from .outputs import Output
from .parameters import Parameters
from .plan_link import PlanLink
from .telemetry import Telemetry

Own = TypeVar("Own", bound=Autopilot)


class Personality(ABC, Generic[Own]):
    """One kind of autopilot. It keeps nothing: what it makes for a drone does.

    `title` is its name for people; `release` and `capabilities` are AUTOPILOT_VERSION's. `silent` are messages that it
    takes an interval for, although nothing makes it say them here. `no_interval`, `no_interval_told` and `no_message`
    are the results of asking it to set the interval of a message that it does not have, to tell it, and for that
    message. `tells_modes_at_once`: a change of mode is told by a heartbeat of its own. `answers_pings`: PING has one.
    `unsigned` are the messages that it takes without a signature although it has a key.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    release: ClassVar[int]
    capabilities: ClassVar[int] = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )
    silent: ClassVar[frozenset[int]] = frozenset()
    no_interval: ClassVar[int]
    no_interval_told: ClassVar[int]
    no_message: ClassVar[int]
    tells_modes_at_once: ClassVar[bool]
    answers_pings: ClassVar[bool]
    unsigned: ClassVar[frozenset[int]]

    @abstractmethod
    def rates_hz(self, chosen: str) -> Mapping[str, float]:
        """Hz of each message that it can say, on a link for which the set of streams `chosen` was asked for."""

    @abstractmethod
    def parameters(self, config: DroneConfig) -> Parameters:
        """A drone's own; raises SitlError for one that this kind does not have."""

    @abstractmethod
    def battery(self, parameters: Parameters) -> Energy:
        """What its own simulation has, for a drone whose battery the fleet does not name."""

    @abstractmethod
    def autopilot(self, config: DroneConfig, battery: Energy, parameters: Parameters) -> Own:
        """The autopilot of a drone."""

    @abstractmethod
    def telemetry(self, autopilot: Own, seed: int, *, quiet: bool) -> Telemetry:
        """What makes its messages."""

    @abstractmethod
    def plan_link(self, autopilot: Own) -> PlanLink:
        """The mission protocol on one more link."""

    @abstractmethod
    def log_link(self, autopilot: Own) -> LogLink:
        """The log protocol on one more link."""

    @abstractmethod
    def handle(self, autopilot: Own, message: Any) -> list[Output]:
        """Carry out a command, a mode change or a set-point that is for this system; others have no answer."""
